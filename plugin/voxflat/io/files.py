"""What all readers and writers share: files whole or not at all, optional packages, errors that name the file."""

from __future__ import annotations

import gzip
import importlib
import os
import re
import stat
import textwrap
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil

from voxflat.arguments import amount
from voxflat.errors import InputError

REMEDY = "is the file complete, and what its ending says?"

_BLOCK = 1 << 20


def by_ending(path: Path, table: dict[str, Callable[..., Any]], verb: str) -> Callable[..., Any]:
    """Return the entry of a table whose key ends the file's name."""
    for ending, entry in table.items():
        if path.name.lower().endswith(ending):
            return entry
    raise InputError(f"ending {path.suffix!r} is unknown; {', '.join(table)} can be {verb}")


def require(module: str) -> Any:
    """Import an optional package, which has the name of its extra."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise InputError(f"needs {module}: pip install 'voxflat[{module}]'") from error


def one_line(error: Exception) -> str:
    """Shorten a message, above all ITK's: lines of C++ places and addresses."""
    if isinstance(error, InputError):
        return str(error)
    text = re.sub(r"\S+\.[ch]xx:\d+:|(ITK|itk::) ?ERROR:|\w+\(0x[0-9a-fA-F]+\):", " ", str(error))
    return textwrap.shorten(text, 200, placeholder=" ...") or type(error).__name__


@contextmanager
def naming(name: object, remedy: str) -> Iterator[None]:
    """Turn whatever goes wrong with a file or object into one line that begins with its name."""
    try:
        yield
    except (FileNotFoundError, PermissionError, MemoryError):
        raise
    except InputError as error:
        raise InputError(f"{name}: {error}") from error
    except Exception as error:
        raise InputError(f"{name}: {one_line(error)}: {remedy}") from error


def contents(path: Path) -> bytes:
    """Return the bytes of a file, decompressed if they are gzipped; refuse more than a quarter of the free memory."""
    status = path.stat()
    if stat.S_ISDIR(status.st_mode):
        raise InputError("is a directory: name a file")
    if not stat.S_ISREG(status.st_mode):
        raise InputError("is no regular file: copy what it gives into a file")
    limit = psutil.virtual_memory().available // 4
    with path.open("rb") as file:
        is_gzipped = file.read(2) == b"\x1f\x8b"
        file.seek(0)
        stream: Any = gzip.GzipFile(fileobj=file) if is_gzipped else file
        blocks, size = [], 0
        while block := stream.read(_BLOCK):
            size += len(block)
            if size > limit:
                held = f"unpacks {amount(status.st_size)} to" if is_gzipped else "holds"
                raise InputError(f"{held} more than {amount(limit)}, a quarter of the free memory: is it a mesh?")
            blocks.append(block)
    if size == 0:
        raise InputError("is empty (0 bytes): copy or download it again")
    return b"".join(blocks)


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Write a file beside its place, and move it there once it is complete.

    Parameters
    ----------
    path : path
        The file to make or replace.

    Yields
    ------
    Path
        A new empty file in the same directory whose name has the same ending. It takes the place of
        `path` when the block ends, and is deleted when the block raises.

    Raises
    ------
    InputError
        Nothing can be written at `path`.
    """
    path = Path(path)
    temporary = path.with_name(f".{uuid.uuid4().hex[:8]}.{path.name}")
    try:
        if path.is_dir():
            raise IsADirectoryError(None, "it is a directory")
        temporary.open("xb").close()  # by open(), not mkstemp(), for the user's usual permissions
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror}; choose another place") from error
    try:
        yield temporary
        try:
            temporary.replace(path)
        except OSError as error:
            raise InputError(f"cannot replace {path}: {error.strerror}; is it in use?") from error
    finally:
        temporary.unlink(missing_ok=True)


def beside(path: Path, ending: str) -> Path:
    """Return the file that goes with a surface; its name has no spaces, at which readers of OBJ would end it."""
    return path.with_name(re.sub(r"[\s#]+", "_", path.stem) + ending)
