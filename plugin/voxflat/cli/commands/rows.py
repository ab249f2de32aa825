"""The command `voxflat rows`."""

from pathlib import Path
from typing import Any

import click
import cloup

from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.input import part_of, surface_of
from voxflat.cli.options import OUT
from voxflat.cli.output import print_json
from voxflat.cli.parameter_options import option_of
from voxflat.distances.geodesic import SOLVERS
from voxflat.pipeline.surface import Surface


@cloup.command(
    "rows",
    epilog="""\b
Examples:
  voxflat rows wm.nii.gz --threshold 0.5 --sources 1000 --store wm.rows
  voxflat rows lh.white --pial lh.pial --sources 500 --store lh.rows --json
  voxflat rows lh.white --pial lh.pial --sources 5000 --store lh.rows --dask tcp://node1:8786
""",
)
@options.input_
@options.surface_options
@options.region
@options.section("Cuts", options.where_cut[0])
@options.section(
    "Distances",
    option_of(Surface.geodesic, "geodesic", type=click.Choice([*SOLVERS, "chain"]), sentences=5),
    option_of(Surface.geodesic, "sources", type=int, required=True, metavar="N", until=", or "),
    options.sampling,
    options.link_lengths(Surface.geodesic),
)
@options.section(
    "Output", option_of(Surface.geodesic, "store", type=OUT, metavar="DIR", required=True), options.as_json
)
@options.run(options.dask, options.seed, options.threads, options.memory_limit, options.quiet)
def command(input_: Path, sources: int, as_json: bool, quiet: bool, **given: Any) -> None:
    """Measure geodesic distances and store them on disk.

    DIR receives the geodesic distances from N sources to all points of a surface as rows.npy (float32, mm), which
    voxflat.open_rows opens and NumPy can memory-map. Only a small part is in memory at any time. To resume an
    interrupted computation, run the same command again.
    """
    with bars(quiet) as shown:
        cuts, choose = given.pop("cuts"), part_of(given, shown.progress)
        part = choose(surface_of(input_, given, shown.progress))
        if cuts is not None:
            part = part.cut(cuts, relax=False, threads=given["threads"], progress=shown.progress).surface
        measured = part.geodesic(sources, progress=shown.progress, **given)
    if as_json:
        content = {"store": str(measured.store), "shape": list(measured.shape), "bytes": measured.nbytes}
        print_json({**content, "provenance": measured.provenance})
    elif not quiet:
        size = f"{measured.nbytes / 2**20:.0f} MiB"
        click.echo(f"{measured.shape[0]} x {measured.shape[1]} distances, {size}\nsaved in {measured.store}")
