"""The command `voxflat check`."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
import cloup

from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.input import part_of, surface_of
from voxflat.cli.output import print_json
from voxflat.distortion.figures import json_ready
from voxflat.pipeline.check import check
from voxflat.pipeline.surface import Surface


@cloup.command(
    "check",
    epilog="""\b
Examples:
  voxflat check labels.nii.gz
  voxflat check wm.nii.gz --threshold 0.5 --seed-point 136,112,127 --radius 45
  voxflat check lh.white --pial lh.pial --drop lh.Medial_wall.label
""",
)
@options.input_
@options.surface_options
@options.region
@options.choice_of_cuts
@options.run(options.threads, options.memory_limit, options.as_json)
def command(input_: Path, as_json: bool, **given: Any) -> None:
    """Check whether a surface can be flattened.

    The check lists the components, boundary loops, handles and defects of INPUT (a volume or a mesh), reports what each
    remedy would change, and gives advice. The exit status is 0 if the surface can be flattened, and 1 otherwise.
    """
    with bars() as shown:
        part = part_of(given, shown.progress)
        source: Path | Surface = input_
        making = ("pial", "probability", "repair", "hemisphere", "unit")
        if any(given[name] is not None for name in making):
            source = surface_of(input_, given, shown.progress)
        else:
            given = {name: value for name, value in given.items() if name not in making}
        findings = check(source, part=part, progress=shown.progress, **given)
    if as_json:
        print_json(json_ready(asdict(findings)))
    else:
        click.echo(findings.table())
    if not findings.can_flatten:
        raise click.exceptions.Exit(1)
