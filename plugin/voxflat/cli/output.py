"""What a command writes: whether it can, and as JSON."""

from __future__ import annotations

import errno
import json
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from voxflat.errors import InputError

__all__ = ["FIGURE_ENDINGS", "check_output", "print_json"]

FIGURE_ENDINGS = (".png", ".pdf", ".svg")
"""How the name of a figure's file may end."""


def check_output(path: Path, endings: Sequence[str], inputs: Sequence[Path | None]) -> None:
    """Find out before the long work whether its result can be written."""
    if endings and not path.name.lower().endswith(tuple(endings)):
        raise InputError(f"cannot write {path}: its name must end in {' or '.join(endings)}")
    for other in inputs:
        if other is not None and path.exists() and other.exists() and path.samefile(other):
            raise InputError(f"cannot write {path}: it is an input; choose another name")
    try:
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error


def print_json(content: dict[str, Any]) -> None:
    """Print one JSON object to stdout."""
    click.echo(json.dumps(content, allow_nan=False))
