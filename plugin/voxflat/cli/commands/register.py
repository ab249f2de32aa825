"""The command `voxflat register`."""

from pathlib import Path
from typing import Any

import click
import cloup

from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.input import surface_of
from voxflat.cli.output import check_output, print_json
from voxflat.cli.parameter_options import option_of
from voxflat.pipeline.surface import Surface
from voxflat.surfaces.standard.pattern import SIDES


@cloup.command(
    "register",
    epilog="""\b
Examples:
  voxflat register lh.white -o lh.sphere.reg.surf.gii
  voxflat register wm.nii.gz --label 2 --repair voxels --side left -o lh.sphere.reg
""",
)
@options.input_
@options.surface_options
@options.section("Registration", option_of(Surface.register, "side", type=click.Choice(SIDES), sentences=3))
@options.output(
    "Output file for the registered sphere, of radius 100: .surf.gii, .vtp, .ply, .obj, or a FreeSurfer name such as "
    "lh.sphere.reg."
)
@options.run(options.threads, options.memory_limit)
def command(input_: Path, output: Path, writing: dict[str, Any], as_json: bool, **given: Any) -> None:
    """Register a hemisphere to the fsaverage sphere.

    The registration aligns the folding pattern of the surface with that of fsaverage. The output can be used instead of
    FreeSurfer's ?h.sphere.reg. Surfaces that are not recognised as a cerebral hemisphere are rejected.
    """
    check_output(output, **writing)
    with bars() as shown:
        whole = surface_of(input_, given, shown.progress)
        made = whole.register(given["side"], threads=given["threads"], progress=shown.progress)
    made.save(output, **writing)
    if as_json:
        size = {"output": str(output), "vertices": len(made.points), "side": made.side, "confidence": made.confidence}
        print_json({**size, **made.figures, "warnings": list(made.remarks), "provenance": made.provenance})
        return
    click.echo(
        f"{made.side} hemisphere, confidence {made.confidence:.2f}\n{len(made.points)} vertices\nsaved as {output}"
    )
