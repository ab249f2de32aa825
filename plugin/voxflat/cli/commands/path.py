"""The command `voxflat path`."""

from pathlib import Path
from typing import Any

import click
import cloup

from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.input import surface_of
from voxflat.cli.output import check_output, print_json
from voxflat.cli.parameter_options import option_of
from voxflat.distances.geodesic import SOLVERS
from voxflat.io.files import atomic_path
from voxflat.io.grid import in_unit
from voxflat.io.provenance import saving
from voxflat.pipeline.surface import Surface


@cloup.command(
    "path",
    epilog="""\b
Examples:
  voxflat path lh.white 1204 8811 9032 --geodesic edges -o cut.txt
  voxflat path wm.nii.gz 136,112,127 136,90,130 --threshold 0.5
""",
)
@options.input_
@cloup.argument("stops", metavar="I,J,K|V...", nargs=-1, required=True, callback=options.places)
@options.surface_options
@options.section(
    "Path",
    option_of(
        Surface.path,
        "geodesic",
        type=click.Choice([*SOLVERS, "edges", "chain"]),
        sentences=5,
        like=Surface.geodesic,
        note='"edges": paths along the edges of the triangles, as cuts need them.',
    ),
    options.link_lengths(Surface.path),
)
@options.output("Write the vertices along the path to this file, one per line, for --cuts.", required=False)
@options.run(options.memory_limit)
def command(
    input_: Path, stops: list[Any], output: Path | None, writing: dict[str, Any], as_json: bool, **given: Any
) -> None:
    """Find the shortest path through points of a surface.

    The command prints the length of the path. The points are voxel indices I,J,K or vertex numbers V, counted from 0.
    """
    if len(stops) < 2:
        raise click.UsageError(f"{len(stops)} stop is given. Give at least two stops.")
    if output is not None:
        if given["geodesic"] in ("marching", "exact"):
            raise click.UsageError("This path crosses triangles, so it cannot be a cut. Give --geodesic edges with -o.")
        check_output(output, **writing)
    elif writing["sidecar"]:
        raise click.UsageError("--sidecar requires -o.")
    with bars() as shown:
        whole = surface_of(input_, given, shown.progress)
        found = whole.path(*stops, geodesic=given["geodesic"], link_lengths=given["link_lengths"])
    if output is not None:
        with saving(output, found.provenance, **writing), atomic_path(output) as beside:
            beside.write_text("".join(f"{one}\n" for one in found.ids), encoding="utf-8", newline="\n")
    if as_json:
        points = {"points": found.points.tolist(), "space": found.space._described()}
        content = {"length": found.length, "ids": found.ids.tolist(), **points}
        print_json({**content, "provenance": found.provenance})
    else:
        saved = "" if output is None else f"\nsaved as {output}"
        click.echo(in_unit(f"{found.length:.3f} mm", whole.metadata) + f" through {len(found.ids)} points{saved}")
