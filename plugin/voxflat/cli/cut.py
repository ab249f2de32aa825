"""The command `voxflat cut`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.input import source_of
from voxflat.cli.output import check_output, print_json
from voxflat.io.patches import PATCH_ENDING
from voxflat.surfaces.cut import cut

_ENDINGS = (".json", ".surf.gii", ".vtp", ".ply", ".obj", PATCH_ENDING)


@click.command(
    "cut",
    epilog="""\b
Examples:
  voxflat cut lh.white --pial lh.pial --drop medial-wall --cuts automatic -o lh.cuts.json
  voxflat cut lh.white --drop lh.Medial_wall.label --relax-length 250 -o lh.cuts.json
  voxflat flatten lh.white --pial lh.pial --cuts lh.cuts.json -o lh.flat.surf.gii
  voxflat cut lh.white --pial lh.pial --drop medial-wall -o lh.cortex.patch.3d
  voxflat cut lh.white --seed-point 5000 --radius 40 --sphere lh.sphere.reg -o v1.json --save-template v1.template.json
""",
)
@options.input_
@click.option(
    "-o",
    "--output",
    type=options.OUT,
    required=True,
    metavar="OUT",
    help="The cuts' file (.json), for --cuts; or the cut surface's: .surf.gii, .vtp, .ply, .obj, or .patch.3d, which "
    "mris_flatten takes.",
)
@click.option(
    "--save-template",
    "template",
    type=options.OUT,
    metavar="FILE",
    help="Write the cuts and the border of what is left out as a template (.json), too: --cuts takes it for any "
    "surface with a sphere of the same side and space.",
)
@options.volume
@options.making
@options.region
@options.sphere
@options.relax
@options.threads
@options.memory_limit
@options.beside
@options.as_json
@options.debug
def command(
    input_: Path, output: Path, template: Path | None, sidecar: bool, overwrite: bool, as_json: bool, **given: Any
) -> None:
    """Cut a surface open, as voxflat flatten would.

    What is no disk becomes one; further cuts relieve the map where that pays.
    """
    check_output(output, _ENDINGS, sidecar=sidecar, overwrite=overwrite)
    if template is not None:
        check_output(template, (".json",))
    with bars() as shown:
        made = cut(source_of(input_, given, shown), progress=shown.progress, **given)
    result = made if output.suffix.lower() == ".json" else made.surface
    result.save(output, sidecar=sidecar, overwrite=overwrite)
    if template is not None:
        made.save_template(template, overwrite=overwrite)
    if as_json:
        cuts = [
            {"ids": one.ids.tolist(), "length": one.length, "reason": one.reason, "name": one.name} for one in made.cuts
        ]
        told = {"output": str(output), "vertices": len(made.surface), "cuts": cuts, "warnings": list(made.remarks)}
        print_json({**told, "provenance": made.provenance})
        return
    for number, one in enumerate(made.cuts):
        length = "" if one.length is None else f", {one.length:.1f} mm"
        click.echo(f"{made.title(number)}: {one.reason}, {len(one.ids)} vertices{length}")
    also = "" if template is None else f", template as {template}"
    click.echo(f"{len(made.surface)} vertices, {len(made.surface.faces)} triangles\nsaved as {output}{also}")
