"""The command `voxflat path`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np

from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.input import source_of
from voxflat.cli.options import OUT
from voxflat.cli.output import check_output, print_json
from voxflat.distances.geodesic import SOLVERS
from voxflat.distances.path import path
from voxflat.io.files import atomic_path
from voxflat.io.provenance import saving


@click.command(
    "path",
    epilog="""\b
Examples:
  voxflat path lh.white 1204 8811 9032 --geodesic edges -o cut.txt
  voxflat path wm.nii.gz 136,112,127 136,90,130 --threshold 0.5
""",
)
@options.input_
@click.argument("stops", metavar="I,J,K|V...", nargs=-1, required=True, callback=options.places)
@click.option("-o", "--output", type=OUT, metavar="OUT", help="Write what it passes, one in each line, for --cuts.")
@click.option(
    "--geodesic",
    type=click.Choice([*SOLVERS, "edges", "chain"]),
    default=options.default_of(path, "geodesic"),
    help="Straight links over the surface, back along the fronts of fast marching, the exact shortest path, along "
    "edges as cuts run, or the paper's links between voxels.",
)
@options.volume
@options.making
@options.memory_limit
@options.beside
@options.as_json
@options.debug
def command(
    input_: Path,
    stops: list[Any],
    output: Path | None,
    sidecar: bool,
    overwrite: bool,
    as_json: bool,
    **given: Any,
) -> None:
    """Find the shortest path through points of a surface.

    It prints the path's length and, with -o, writes the vertices (or voxel indices) that it passes.
    """
    if len(stops) < 2:
        raise click.UsageError("Give at least two stops.")
    if output is not None:
        if given["geodesic"] in ("marching", "exact"):
            raise click.UsageError("This path crosses triangles, no cut can: give --geodesic edges with -o.")
        check_output(output, sidecar=sidecar, overwrite=overwrite)
    elif sidecar:
        raise click.UsageError("--sidecar is for -o.")
    with bars() as shown:
        found = path(source_of(input_, given, shown), *stops, **given)
    if output is not None:
        with saving(output, found.provenance, sidecar=sidecar, overwrite=overwrite), atomic_path(output) as beside:
            np.savetxt(beside, found.ids, fmt="%d")
    if as_json:
        points = {"points": found.points.tolist(), "space": found.space.described()}
        told = {"length": found.length, "ids": found.ids.tolist(), **points}
        print_json({**told, "provenance": found.provenance})
    else:
        saved = "" if output is None else f"\nsaved as {output}"
        click.echo(f"{found.length:.3f} mm through {len(found.ids)} points{saved}")
