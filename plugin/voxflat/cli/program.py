"""The program `voxflat`. Exit status: 0 success, 1 failure, 2 wrong usage, 130 cancelled, 143 terminated."""

import click
import cloup

from voxflat._core import __version__
from voxflat.cli.commands import (
    bids,
    check,
    cite,
    cut,
    demo,
    figure,
    flatten,
    freesurfer,
    image,
    measure,
    movie,
    patches,
    path,
    points,
    regions,
    register,
    rows,
    surface,
    texture,
    worst,
)
from voxflat.cli.console import Program


@cloup.group(
    cls=Program,
    context_settings={"help_option_names": ["-h", "--help"], "show_default": True},
    epilog='Try "voxflat demo" first. For help on a command, run for example "voxflat flatten --help".',
)
@click.version_option(__version__, message="voxflat %(version)s")
def main() -> None:
    """Flatten curved surfaces, such as the cerebral cortex, while preserving geodesic distances."""


_MAKING = (flatten, check, surface, cut, register, path, measure, worst, patches, rows)
_SHOWING = (image, figure, movie, points, regions, texture, cite)
for module in (*_MAKING, *_SHOWING, freesurfer, bids, demo):
    main.add_command(module.command)
