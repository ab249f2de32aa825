"""Whether the result of a command can be written."""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

from voxflat.errors import InputError

__all__ = ["check_output"]


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
