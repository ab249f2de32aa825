"""The command `voxflat cut`."""

from pathlib import Path
from typing import Any

import click
import cloup

from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.input import part_of, surface_of
from voxflat.cli.output import check_output, print_json
from voxflat.io.grid import in_unit
from voxflat.io.patches import PATCH_ENDING

_ENDINGS = (".json", ".surf.gii", ".vtp", ".ply", ".obj", PATCH_ENDING)


@cloup.command(
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
@options.surface_options
@options.region
@options.cuts
@options.output(
    "Output file. A .json file holds the cuts, for --cuts; .surf.gii, .vtp, .ply, .obj and .patch.3d (for "
    "mris_flatten) hold the cut surface.",
    options.writes(
        "--save-template",
        "Also write the cuts and the border of the excluded region as a template (.json). Pass it to --cuts for "
        "any surface with a registered sphere of the same side and space.",
        "template",
    ),
)
@options.run(options.threads, options.memory_limit)
def command(
    input_: Path, output: Path, template: Path | None, writing: dict[str, Any], as_json: bool, **given: Any
) -> None:
    """Cut a surface open for flattening.

    The cuts are those that voxflat flatten would make: a surface that is not a disk is cut open to a disk, and
    relaxation cuts are added where they reduce the distortion of the map.
    """
    check_output(output, _ENDINGS, **writing)
    if template is not None:
        check_output(template, (".json",))
    with bars() as shown:
        choose = part_of(given, shown.progress)
        made = choose(surface_of(input_, given, shown.progress)).cut(progress=shown.progress, **given)
    made.save(output, **writing)
    if template is not None:
        made.save_template(template, overwrite=writing["overwrite"])
    if as_json:
        cuts = [{"ids": of.ids.tolist(), "length": of.length, "reason": of.reason, "name": of.name} for of in made.cuts]
        content = {"output": str(output), "vertices": len(made.surface), "cuts": cuts, "warnings": list(made.remarks)}
        print_json({**content, "provenance": made.provenance})
        return
    for number, one in enumerate(made.cuts):
        length = "" if one.length is None else in_unit(f", {one.length:.1f} mm", made.surface.metadata)
        click.echo(f"{made.title(number)}: {one.reason}, {len(one.ids)} vertices{length}")
    also = "" if template is None else f", template as {template}"
    click.echo(f"{len(made.surface)} vertices, {len(made.surface.faces)} triangles\nsaved as {output}{also}")
