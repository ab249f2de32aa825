"""The command `voxflat check`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.input import source_of
from voxflat.cli.output import print_json
from voxflat.distortion.figures import json_ready
from voxflat.surfaces.check import check


@click.command(
    "check",
    epilog="""\b
Examples:
  voxflat check labels.nii.gz
  voxflat check wm.nii.gz --threshold 0.5 --seed-point 136,112,127 --radius 45
  voxflat check lh.white --pial lh.pial --drop lh.Medial_wall.label
""",
)
@options.input_
@options.volume
@options.making
@options.region
@options.sphere
@options.threads
@options.memory_limit
@options.as_json
@options.debug
def command(input_: Path, as_json: bool, **given: Any) -> None:
    """Say whether a surface can be flattened.

    It lists what INPUT, a volume or a mesh, holds: components, boundary loops, handles, defects; what each remedy would
    change; and gives advice. The exit status is 0 if its surface can be flattened, and 1 if not.
    """
    with bars() as shown:
        findings = check(source_of(input_, given, shown), progress=shown.progress, **given)
    if as_json:
        print_json(json_ready(asdict(findings)))
    else:
        click.echo(findings.table())
    if not findings.can_flatten:
        raise click.exceptions.Exit(1)
