"""Check the output files of a command before its work begins, and print JSON."""

import errno
import json
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from voxflat.errors import InputError
from voxflat.io.files import check_new
from voxflat.io.provenance import check_beside, sidecar_of

FIGURE_ENDINGS = (".png", ".pdf", ".svg")
"""The file name extensions of figures."""

_IGNORES_CASE = sys.platform in ("win32", "darwin")  # whether A.npz and a.npz are usually one file

READ, WRITTEN, JSON, SHOWN = "voxflat.read", "voxflat.written", "voxflat.json", "voxflat.shown"
"""Keys under which the context of a command stores the files that it reads and writes, whether it prints JSON, and the
surfaces that maps show."""


def check_output(
    path: Path,
    endings: Sequence[str] = (),
    *,
    beside: Sequence[Path] = (),
    sidecar: bool = False,
    overwrite: bool = False,
) -> None:
    """Check that a result can be written before it is computed.

    An output must not be an input under any name, or the same file as another output. An existing file that the user
    named is replaced. Files `beside` it, and the record (`sidecar`), are replaced only if voxflat wrote them or
    `overwrite` is set.
    """
    if endings and not path.name.lower().endswith(tuple(endings)):
        remedy = f"Choose a name that ends in {' or '.join(endings)}."
        raise InputError(f"cannot write {path}: unknown file format. {remedy}")
    files = [*beside, *([sidecar_of(path)] if sidecar else [])]
    meta = click.get_current_context().meta
    for target in (path, *files):
        if any(_is_same(target, other) for other in meta.get(READ, {}).values()):
            raise InputError(f"cannot write {target}: it is an input. Choose another name for the output.")
    written = [*meta.get(WRITTEN, {}).values(), *files]  # includes path
    for number, target in enumerate(written):
        if any(_is_same(target, other) for other in written[:number]):
            raise InputError(f"cannot write {target} twice. Choose another name for one of the outputs.")
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
    """Return whether two paths refer to the same file; paths of files that do not exist yet are compared by name."""
    if a.exists() and b.exists():
        return a.samefile(b)
    paths = [os.path.realpath(path) for path in (a, b)]
    return paths[0] == paths[1] or (_IGNORES_CASE and paths[0].casefold() == paths[1].casefold())


def print_json(content: dict[str, Any]) -> None:
    """Print one JSON object to stdout."""
    click.echo(json.dumps(content, allow_nan=False))


def is_json() -> bool:
    """Return whether ``--json`` was given."""
    return bool(click.get_current_context().meta.get(JSON))


def report(content: dict[str, Any], text: str, *, quiet: bool = False) -> None:
    """Print the result of a command: as one JSON object with ``--json``, or as text unless `quiet`."""
    if is_json():
        print_json(content)
    elif not quiet:
        click.echo(text)
