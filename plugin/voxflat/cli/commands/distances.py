"""The commands `voxflat path` and `voxflat rows`, which measure distances along a surface."""

from pathlib import Path
from typing import Any

import click
import cloup

from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.input import part_of, surface_of
from voxflat.cli.options import OUT
from voxflat.cli.output import check_output, report
from voxflat.cli.parameter_options import option_of
from voxflat.distances.geodesic import SOLVERS
from voxflat.io.files import atomic_path
from voxflat.io.grid import in_unit
from voxflat.io.provenance import saving
from voxflat.pipeline.surface import Surface

_WAYS = click.Choice([*SOLVERS, "edges", "chain"])
_EDGES = '"edges": paths along the edges of the triangles, as required for cuts.'


@options.command(
    "path",
    "voxflat path lh.white 1204 8811 9032 --geodesic edges -o cut.txt",
    "voxflat path wm.nii.gz 136,112,127 136,90,130 --threshold 0.5",
)
@options.input_
@cloup.argument("stops", metavar="I,J,K|V...", nargs=-1, required=True, callback=options.places)
@options.surface_options
@options.section(
    "Path",
    option_of(Surface.path, "geodesic", type=_WAYS, sentences=5, like=Surface.geodesic, note=_EDGES),
    options.link_lengths(Surface.path),
)
@options.output("Write the vertices along the path to this file, one per line, for use with --cuts.", required=False)
@options.run(options.memory_limit)
def path_command(input_: Path, stops: list[Any], output: Path | None, writing: dict[str, Any], **settings: Any) -> None:
    """Find the shortest path through points on a surface.

    The command prints the length of the path. The points are voxel indices I,J,K or vertex numbers V, counted from 0.
    """
    if len(stops) < 2:
        raise click.UsageError(f"{len(stops)} stop is given. Pass at least two stops.")
    if output is not None:
        if settings["geodesic"] in ("marching", "exact"):
            raise click.UsageError("This path crosses triangles, so it cannot be a cut. Pass --geodesic edges with -o.")
        check_output(output, **writing)
    elif writing["sidecar"]:
        raise click.UsageError("--sidecar requires -o.")
    with bars() as bar:
        whole = surface_of(input_, settings, bar.progress)
        path = whole.path(*stops, geodesic=settings["geodesic"], link_lengths=settings["link_lengths"])
    if output is not None:
        with saving(output, path.provenance, **writing), atomic_path(output) as beside:
            beside.write_text("".join(f"{point}\n" for point in path.ids), encoding="utf-8", newline="\n")
    content: dict[str, Any] = {"length": path.length, "ids": path.ids.tolist(), "points": path.points.tolist()}
    length = in_unit(f"{path.length:.3f} mm", whole.origin.named_unit)
    saved = "" if output is None else f"\nsaved as {output}"
    content |= {"space": path.space._described(), "provenance": path.provenance}
    report(content, f"{length} through {len(path.ids)} points{saved}")


@options.command(
    "rows",
    "voxflat rows wm.nii.gz --threshold 0.5 --sources 1000 --store wm.rows",
    "voxflat rows lh.white --pial lh.pial --sources 500 --store lh.rows --json",
    "voxflat rows lh.white --pial lh.pial --sources 5000 --store lh.rows --dask tcp://node1:8786",
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
def rows_command(input_: Path, sources: int, quiet: bool, **settings: Any) -> None:
    """Measure geodesic distances and store them on disk.

    The geodesic distances from N sources to all points of a surface are written to DIR/rows.npy (float32, in the unit
    of INPUT). To read them in Python, pass DIR to voxflat.open_rows, or memory-map the file with NumPy. Only a small
    part of the distances is held in memory at any time. To resume an interrupted computation, run the same command
    again.
    """
    with bars(quiet) as bar:
        cuts, choose = settings.pop("cuts"), part_of(settings, bar.progress)
        part = choose(surface_of(input_, settings, bar.progress))
        if cuts is not None:
            part = part.cut(cuts, relax=False, threads=settings["threads"], progress=bar.progress).surface
        measured = part.geodesic(sources, progress=bar.progress, **settings)
    size = {"shape": list(measured.shape), "bytes": measured.nbytes}
    named = "without a unit" if measured.unit == "unknown" else f"in {measured.unit}"
    text = f"{measured.shape[0]} x {measured.shape[1]} distances {named}, {measured.nbytes / 2**20:.0f} MiB"
    content = {"store": str(measured.store), **size, "unit": measured.unit, "provenance": measured.provenance}
    report(content, f"{text}\nsaved in {measured.store}", quiet=quiet)
