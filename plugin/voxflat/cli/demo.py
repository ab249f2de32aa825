"""The command `voxflat demo`."""

from __future__ import annotations

from pathlib import Path

import click

from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.options import FILE
from voxflat.errors import InputError


@click.command("demo")
@click.option(
    "-o",
    "--output",
    type=FILE,
    default=Path("voxflat-demo"),
    metavar="DIR",
    help="A directory for the results; made if it is missing.",
)
@options.debug
def command(output: Path) -> None:
    """Flatten a patch of human cortex.

    The cortex is the MNI152 template, which comes with nilearn: nothing is downloaded. The map, its figures and the
    pictures of it are written to a directory.
    """
    try:
        from voxflat.demo import run

        with bars() as shown:
            run(output, progress=shown.progress, tell=shown.tell)
    except ImportError as error:
        if error.name and error.name.startswith("voxflat"):
            raise
        raise InputError(f"the demo needs {error.name}: pip install 'voxflat[demo]'") from error
