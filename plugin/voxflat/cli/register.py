"""The command `voxflat register`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.input import source_of
from voxflat.cli.output import check_output, print_json
from voxflat.surfaces.standard.pattern import SIDES
from voxflat.surfaces.standard.registration import register


@click.command(
    "register",
    epilog="""\b
Examples:
  voxflat register lh.white -o lh.sphere.reg.surf.gii
  voxflat register wm.nii.gz --label 2 --repair voxels --side left -o lh.sphere.reg
""",
)
@options.input_
@click.option(
    "-o",
    "--output",
    type=options.OUT,
    required=True,
    metavar="OUT",
    help="The sphere's file, of radius 100: .surf.gii, .vtp, .ply, .obj, or a FreeSurfer name such as lh.sphere.reg.",
)
@click.option("--side", type=click.Choice(SIDES), help="Which hemisphere it is.  [default: as its folds say]")
@options.volume
@options.making
@options.threads
@options.memory_limit
@options.beside
@options.as_json
@options.debug
def command(input_: Path, output: Path, sidecar: bool, overwrite: bool, as_json: bool, **given: Any) -> None:
    """Find where a hemisphere's vertices lie on fsaverage's sphere, by the pattern of its folds.

    The file takes the place of FreeSurfer's ?h.sphere.reg. What is no hemisphere is refused.
    """
    check_output(output, sidecar=sidecar, overwrite=overwrite)
    with bars() as shown:
        made = register(source_of(input_, given, shown), progress=shown.progress, **given)
    made.save(output, sidecar=sidecar, overwrite=overwrite)
    if as_json:
        told = {"output": str(output), "vertices": len(made.points), "side": made.side, "confidence": made.confidence}
        print_json({**told, **made.figures, "warnings": list(made.remarks), "provenance": made.provenance})
        return
    click.echo(
        f"{made.side} hemisphere, confidence {made.confidence:.2f}\n{len(made.points)} vertices\nsaved as {output}"
    )
