"""The command `voxflat rows`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.input import source_of
from voxflat.cli.output import print_json
from voxflat.distances.geodesic import SOLVERS, geodesic


@click.command(
    "rows",
    epilog="""\b
Examples:
  voxflat rows wm.nii.gz --threshold 0.5 --sources 1000 --store wm.rows
  voxflat rows lh.white --pial lh.pial --sources 500 --store lh.rows --json
  voxflat rows lh.white --pial lh.pial --sources 5000 --store lh.rows --dask tcp://node1:8786
""",
)
@options.input_
@options.store(required=True)
@click.option(
    "--geodesic",
    type=click.Choice([*SOLVERS, "chain"]),
    default=options.default_of(geodesic, "geodesic"),
    help="Over the triangles of a surface: by straight links, fast marching, or exactly; or by chain codes over the "
    "voxels of a volume.",
)
@options.making
@options.volume
@options.region
@options.memory_limit
@click.option("--sources", type=int, required=True, metavar="M", help="How many points distances are measured from.")
@options.sampling
@options.link_lengths("chain")
@options.dask
@options.seed
@options.threads
@options.as_json
@options.quiet
@options.debug
def command(input_: Path, sources: int, as_json: bool, quiet: bool, **given: Any) -> None:
    """Measure distances into a store on disk.

    DIR gets the geodesic distances from M sources to all points of a surface: rows.npy, float32, mm, which NumPy can
    map into memory, and voxflat.open_rows opens. Only a little of it is ever in memory. Give the same command again to
    resume what was interrupted.
    """
    with bars(quiet) as shown:
        measured = geodesic(source_of(input_, given, shown), sources, progress=shown.progress, **given)
    if as_json:
        told = {"store": str(measured.store), "shape": list(measured.shape), "bytes": measured.nbytes}
        print_json({**told, "provenance": measured.provenance})
    elif not quiet:
        size = f"{measured.nbytes / 2**20:.0f} MiB"
        click.echo(f"{measured.shape[0]} x {measured.shape[1]} distances, {size}\nsaved in {measured.store}")
