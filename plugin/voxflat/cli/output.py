"""What a command writes: whether it can, and as JSON."""

import errno
import json
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from voxflat.errors import InputError
from voxflat.io.files import check_new
from voxflat.io.provenance import check_beside, sidecar_of

FIGURE_ENDINGS = (".png", ".pdf", ".svg")
"""How the name of a figure's file may end."""

READ, WRITTEN = "voxflat.read", "voxflat.written"
"""Under these keys of a command's context stand the files that it is told to read, and to write."""


def check_output(
    path: Path,
    endings: Sequence[str] = (),
    *,
    beside: Sequence[Path] = (),
    sidecar: bool = False,
    overwrite: bool = False,
) -> None:
    """Find out before the long work whether its result can be written.

    No file that is written may be one that is read, by any name, or another that is written. What the user named may
    replace a file; what is written beside it only what voxflat wrote, or with ``--overwrite``.

    `path`: the result. `endings`, sequence of str: how its name may end; any way by default. `beside`, sequence of
    Path: what is written beside it. `sidecar`: whether its record is, too. `overwrite`: whether files beside it may
    replace others.
    """
    if endings and not path.name.lower().endswith(tuple(endings)):
        raise InputError(f"cannot write {path}: its name must end in {' or '.join(endings)}")
    files = [*beside, *([sidecar_of(path)] if sidecar else [])]
    meta = click.get_current_context().meta
    for own in (path, *files):
        if any(_is_same(own, other) for other in meta.get(READ, {}).values()):
            raise InputError(f"cannot write {own}: it is an input; choose another name")
    written = [*meta.get(WRITTEN, {}).values(), *files]  # path among them
    for number, one in enumerate(written):
        if any(_is_same(one, other) for other in written[:number]):
            raise InputError(f"cannot write {one} twice; choose another name for one of the results")
    for file in files:
        check_beside(path, file, overwrite=overwrite)
    if path.suffix.lower() == ".zarr":
        check_new(path)
    try:
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error


def _is_same(a: Path, b: Path) -> bool:
    """Tell whether two names are of one file; of files that are not there yet, by their names alone."""
    if a.exists() and b.exists():
        return a.samefile(b)
    return os.path.realpath(a) == os.path.realpath(b)


def print_json(content: dict[str, Any]) -> None:
    """Print one JSON object to stdout."""
    click.echo(json.dumps(content, allow_nan=False))
