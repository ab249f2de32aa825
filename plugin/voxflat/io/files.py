"""Functions shared by readers and writers: atomic writing, optional imports, and errors that name the file."""

import errno
import gzip
import importlib
import json
import logging
import math
import os
import re
import shutil
import stat
import struct
import textwrap
import threading
import time
import warnings
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import amount, checked_path, log
from voxflat.errors import InputError
from voxflat.io.grid import FARTHEST
from voxflat.io.reading import allowed_memory, record_file
from voxflat.io.temporary import temporary_beside

REMEDY = "Check that the file is complete and that its ending matches its format"

SAVED_ENDINGS = (".npz", ".voxflat")
"""Endings of complete maps and atlases, which are NumPy archives; only voxflat uses the second ending."""

AGAIN = "Copy or download the file again"  # remedy for a truncated file

_BLOCK = 1 << 20
_WAITS = (0.1, 0.2, 0.4, 0.8) if os.name == "nt" else ()  # seconds between attempts to replace a file
_LONGEST_GIVEN = 100  # bytes of a file name that is made from another name
_RESERVED = {"CON", "PRN", "AUX", "NUL", *(f"{port}{n}" for port in ("COM", "LPT") for n in range(1, 10))}  # Windows
_LONGEST_ERROR = 2000  # characters
_OF_PYTHON = (LookupError, TypeError, AttributeError, ArithmeticError, RecursionError, AssertionError, struct.error)
_WORDS_OF_PYTHON = re.compile(
    "set_int_max_str_digits|values to unpack|with base 10|inhomogeneous|substring|subsection|cannot reshape|buffer size"
    "|to integer$|fixed-type"
)
OF_DAMAGE = (None, errno.EINVAL)  # errno if a file is damaged: none from readers, EINVAL for invalid offsets


def by_ending(path: Path, table: dict[str, Callable[..., Any]], more: str = "") -> Callable[..., Any]:
    """Return the entry of a table whose key is the ending of a file name."""
    for ending, entry in table.items():
        if path.name.lower().endswith(ending):
            return entry
    raise InputError(f"unknown file name ending {path.suffix!r}. Use one of {', '.join(table)}{more}")


_LAB = ("distributed", "h5py", "imageio_ffmpeg", "itk", "nilearn", "svgelements", "xatlas", "zarr")
EXTRAS = {
    **dict.fromkeys(("napari", "qtpy", "superqt"), "napari"),
    **dict.fromkeys(("pyvista", "vtkmodules"), "pyvista"),
    **dict.fromkeys(("autoflatten", "igl", "pygeodesic", "pymeshlab", "uvunwrap"), "bench"),
    **dict.fromkeys(_LAB, "lab"),
}
"""Optional packages, keyed by import name, with the extra that installs each of them."""


def require(module: str) -> Any:
    """Import a package that is optional, or whose import is deferred until it is used."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise InputError(f"requires {module}. Install it with {installing(module)}") from error


def installing(*modules: str) -> str:
    """Return the command that installs packages."""
    names = [module.partition(".")[0] for module in modules]
    extras = ",".join(sorted({EXTRAS[name] for name in names if name in EXTRAS}))
    return f"pip install 'voxflat[{extras}]'" if extras else f"pip install {' '.join(names)}"


def check_format(path: str | os.PathLike[str], format_: object, expected: str | int, remedy: str) -> None:
    """Raise an error if the format of a file (a version, or a name and a version) is not supported."""
    name, _, version = str(expected).rpartition(" ")
    its_name, _, its_version = str(format_).rpartition(" ")
    if its_name == name and its_version.isdecimal() and int(its_version) > int(version):
        raise InputError(f"{path} was made by a newer version of voxflat. Update voxflat")
    if format_ != expected:
        raise InputError(f"{path} has the format {format_!r}, but this version of voxflat reads {expected!r}. {remedy}")


_loading: ContextVar[object] = ContextVar("voxflat_loading", default=None)
_filters_lock = threading.Lock()


def nibabel_image(path: str | os.PathLike[str], **options: Any) -> Any:
    """Load an image with nibabel, and log nibabel's warnings about the header together with the file name."""
    nibabel = require("nibabel")
    check_regular(Path(path))
    try:
        with retelling(path, "nibabel.global"), warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            return nibabel.load(path, **options)
    finally:
        for warning in caught:
            if issubclass(warning.category, UserWarning):
                log.warning("%s: %s", path, " ".join(str(warning.message).split()))


@contextmanager
def retelling(path: str | os.PathLike[str], logger: str, take: Callable[[str], None] | None = None) -> Iterator[None]:
    """Redirect the log messages that another package emits in this context to a function, or to voxflat's log."""
    report = take or (lambda message: log.warning("%s: %s", path, message))
    other, here = logging.getLogger(logger), object()

    def redirect(record: logging.LogRecord) -> bool:
        is_ours = _loading.get() is here
        if is_ours:
            report(record.getMessage())
        return not is_ours

    token = _loading.set(here)
    with _filters_lock:
        other.filters = [*other.filters, redirect]  # a new list, because another thread may be using this one
    try:
        yield
    finally:
        with _filters_lock:
            other.filters = [entry for entry in other.filters if entry is not redirect]
        _loading.reset(token)


def one_line(error: Exception) -> str:
    """Shorten an error message to one line. For example, messages from ITK contain source positions and addresses."""
    if isinstance(error, InputError):
        return str(error)
    message = str(error)[:_LONGEST_ERROR]  # readers may repeat all their input, which slows down pattern matching
    text = re.sub(r"\S+\.[ch]xx:\d+:|(ITK|itk::) ?ERROR:|\w+\(0x[0-9a-fA-F]+\):", " ", message)
    return textwrap.shorten(text, 200, placeholder=" ...") or type(error).__name__


@contextmanager
def naming(name: object, remedy: str) -> Iterator[None]:
    """Convert non-system errors to one-line errors that begin with the name of a file or an object type."""
    name = name if isinstance(name, str | os.PathLike) else type(name).__name__
    try:
        yield
    except MemoryError:
        raise
    except InputError as error:
        if str(error).startswith(f"{name}: "):
            raise
        raise InputError(f"{name}: {error}") from error
    except Exception as error:
        if isinstance(error, OSError) and error.errno not in OF_DAMAGE:
            raise
        problem = one_line(error).removesuffix(".")
        if isinstance(error, _OF_PYTHON) or _WORDS_OF_PYTHON.search(problem):  # about a program rather than a file
            cause = f"{error}, which is missing or unknown" if isinstance(error, KeyError) else type(error).__name__
            problem = f"has invalid content ({cause})"
        raise InputError(f"{name}: {problem}. {remedy[:1].upper()}{remedy[1:]}") from error


@contextmanager
def holding(path: str | os.PathLike[str], kind: str) -> Iterator[None]:
    """Convert any error from reading one of voxflat's own files to an error that names the expected kind of file."""
    try:
        yield
    except InputError as error:
        if str(error).startswith(str(path)):
            raise
        raise InputError(f"{path}: {error}") from error
    except (FileNotFoundError, IsADirectoryError, PermissionError, MemoryError):
        raise
    except Exception as error:  # damage can cause any error: zlib.error, BadZipFile, KeyError, ...
        problem = f"is not {kind} of voxflat, or is damaged ({type(error).__name__})"
        raise InputError(f"{path} {problem}. Copy it again, or pass another file") from error


@contextmanager
def naming_file(path: Path, temporary: Path | None = None) -> Iterator[None]:
    """Add the name of a file to system errors such as a full disk, instead of the name of a temporary file."""
    try:
        yield
    except OSError as error:
        if error.errno is None or (error.filename is not None and str(error.filename) != str(temporary)):
            raise
        raise OSError(error.errno, error.strerror or os.strerror(error.errno), str(path)) from error


def check_regular(path: Path) -> os.stat_result:
    """Return the status of a file; raise an error if the file is not regular, because reading it could block."""
    status = path.stat()
    if stat.S_ISDIR(status.st_mode):
        raise InputError("is a directory. Pass a path to a file")
    if not stat.S_ISREG(status.st_mode):
        raise InputError("is not a regular file. Copy its content into a regular file")
    return status


def within(folder: Path, name: str, part: str) -> Path:
    """Return a path that a file names; it must be in the directory of that file or a subdirectory."""
    file = folder / name
    if not file.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"stores its {part} in {name!r:.80}, outside its directory. Copy that file into the directory")
    return file


def companion(path: Path, name: str, part: str) -> Path:
    """Return a file that another one names; it must be in the directory of that file or a subdirectory."""
    file = within(path.parent, name, part)
    if not file.exists():
        raise InputError(f"stores its {part} in {name!r:.80}, which does not exist. Copy that file too")
    if not file.is_file():
        raise InputError(f"stores its {part} in {name!r:.80}, which is not a regular file. Copy the original file")
    return file


def check_regular_within(folder: Path) -> None:
    """Raise an error if a directory contains anything other than directories and regular files."""
    for entry in folder.iterdir():
        if entry.exists() and not entry.is_file() and not entry.is_dir():
            raise InputError(f"{entry} is not a regular file. Copy its content into a regular file")


def from_json(text: str | bytes) -> Any:
    """Parse JSON; raise ValueError for nesting that is too deep and for numbers that JSON does not define."""
    try:
        return json.loads(text, parse_constant=_finite, parse_float=_finite)
    except RecursionError:
        raise ValueError("its lists are nested too deeply") from None


def _finite(number: str) -> float:
    if not math.isfinite(value := float(number)):
        raise ValueError(f"{number} is not a valid number in JSON")
    return value


def check_shapes(arrays: Mapping[str, NDArray[Any]], layout: Mapping[str, tuple[str, str]]) -> None:
    """Check that the arrays of a file have the expected kinds of types and consistent shapes.

    `layout` gives the NumPy type of each array after loading (`in_types`) and its axes, separated by spaces. An axis is
    a length, a name (axes with the same name must have equal lengths), or "?" for any length.
    """
    lengths: dict[str, tuple[int, str]] = {}
    for name, (wanted_type, axes) in layout.items():
        if name not in arrays:
            continue
        array, names = arrays[name], axes.split()
        kind = np.dtype(wanted_type).kind
        if array.dtype.kind not in ("iu" if kind in "iu" else kind) or array.ndim != len(names):
            raise InputError(f"its array {name} has an invalid type or shape ({array.dtype}, {array.shape}). {AGAIN}")
        for length, axis in zip(array.shape, names, strict=True):
            expected, by = (int(axis), "its definition") if axis.isdigit() else lengths.setdefault(axis, (length, name))
            if axis != "?" and length != expected:
                raise InputError(f"its array {name} has shape {array.shape}, which does not match {by}. {AGAIN}")


def in_types(arrays: Mapping[str, NDArray[Any]], layout: Mapping[str, tuple[str, str]]) -> dict[str, NDArray[Any]]:
    """Convert arrays to the types of a layout; raise an error for integers that are out of range."""
    converted = dict(arrays)
    for name in converted.keys() & layout.keys():
        array, dtype = converted[name], np.dtype(layout[name][0])
        if dtype.kind in "iu" and array.size:
            bounds = np.iinfo(dtype)
            if int(array.min()) < bounds.min or int(array.max()) > bounds.max:
                raise InputError(f"its array {name} has values outside the range {bounds.min} to {bounds.max}. {AGAIN}")
        converted[name] = array.astype(dtype, copy=False)
    return converted


def check_range(arrays: Mapping[str, NDArray[Any]], limits: Mapping[str, int]) -> None:
    """Check that arrays of row numbers, keyed by name, refer to existing rows."""
    for name, limit in limits.items():
        if name in arrays and arrays[name].size and not 0 <= arrays[name].min() <= arrays[name].max() < limit:
            raise InputError(f"its array {name} refers to rows that do not exist (there are {limit}). {AGAIN}")


def check_places(arrays: Mapping[str, NDArray[Any]]) -> None:
    """Check that arrays of coordinates, keyed by name, are finite and within the range that the core accepts."""
    for name, array in arrays.items():
        if not (np.abs(array.astype(np.float64)) <= FARTHEST).all():
            raise InputError(f"its array {name} has coordinates that are not finite or exceed {FARTHEST:g} mm. {AGAIN}")


def contents(path: Path) -> bytes:
    """Return the bytes of a file, decompressed if gzipped; raise an error if they exceed a quarter of the memory."""
    status = check_regular(path)
    limit = allowed_memory() // 4
    with path.open("rb") as file:
        is_gzipped = file.read(2) == b"\x1f\x8b"
        file.seek(0)
        stream: Any = gzip.GzipFile(fileobj=file) if is_gzipped else file
        blocks, size = [], 0
        try:
            while block := stream.read(_BLOCK):
                size += len(block)
                if size > limit:
                    text = f"expands from {amount(status.st_size)} to" if is_gzipped else "contains"
                    text = f"{text} more than {amount(limit)}, a quarter of the memory"
                    raise InputError(f"{text}. Check that it is a mesh")
                blocks.append(block)
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            raise InputError(f"its gzip data are damaged ({error}). {AGAIN}") from error
    if size == 0:
        raise InputError("is empty (0 bytes). Copy or download it again")
    record_file(path)
    return b"".join(blocks)


def check_size(data: bytes, need: int, kind: str, *, is_exact: bool = False) -> None:
    """Compare the length of a file with the length that its header specifies."""
    if need < 0:
        raise InputError(f"its header is damaged: it specifies {kind}. {AGAIN}")
    if len(data) < need:
        raise InputError(f"its header specifies {kind}, but the file ends after {len(data)} of {need} bytes. {AGAIN}")
    if is_exact and len(data) > need:
        raise InputError(f"its header specifies {kind}, but the file has {len(data) - need} extra bytes. {AGAIN}")


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Write a file completely or not at all.

    The file is written under a temporary name in the same directory, and renamed when it is complete. Temporary files
    that killed processes left in that directory are deleted.

    Parameters
    ----------
    path : path
        The file to create or replace.

    Yields
    ------
    Path
        A new empty file in the same directory whose name has the same ending. It replaces `path` when the block ends,
        and is deleted if the block raises an exception.

    Raises
    ------
    OSError
        Nothing can be written at `path`, for example because the disk is full. The error names `path`.

    See Also
    --------
    write_mesh : Write a mesh to a file.
    write_volume : Write a volume to a file.

    Examples
    --------
    >>> with voxflat.io.atomic_path("notes.txt") as temporary:
    ...     size = temporary.write_text("all of it, or nothing")
    """
    path = checked_path(path)
    temporary = temporary_beside(path)
    with naming_file(path, temporary):
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        try:
            temporary.open("xb").close()  # open(), unlike mkstemp(), applies the user's usual permissions
            yield temporary
            _replace(temporary, path)
        except Exception:
            if temporary.exists():  # raise the system's error, which some packages hide, if nothing can be written
                with temporary.open("ab") as file:
                    file.write(bytes(_BLOCK))
                    os.fsync(file.fileno())
            raise
        finally:
            with suppress(PermissionError):  # Windows cannot delete an open file, for example after an error
                temporary.unlink(missing_ok=True)


def _replace(temporary: Path, path: Path) -> None:
    """Rename a complete file; on Windows, wait briefly for programs that have it open, such as virus scanners."""
    for seconds in _WAITS:
        with suppress(PermissionError):
            temporary.replace(path)
            return
        time.sleep(seconds)
    temporary.replace(path)


@contextmanager
def atomic_directory(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Write a directory under a temporary name and rename it when it is complete; never replace an existing one."""
    path = checked_path(path)
    check_new(path)
    temporary = temporary_beside(path)
    with naming_file(path, temporary):
        try:
            temporary.mkdir()
            yield temporary
            temporary.rename(path)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


def check_new(path: Path) -> None:
    """Raise an error if a directory exists, because voxflat must not delete its files."""
    if path.exists() or path.is_symlink():
        raise InputError(f"{path} exists, and voxflat does not replace directories. Delete it, or choose another name")


def save_array(path: Path, array: NDArray[Any]) -> None:
    """Write a .npy file like `numpy.save`, but with a Python file object, which reports incomplete writes."""
    with path.open("wb") as file:
        np.lib.format.write_array(SimpleNamespace(write=file.write), np.asanyarray(array), allow_pickle=False)


def file_name(name: str) -> str:
    """Return a file name, without an ending, for a name from elsewhere, which may be a path or reserved on Windows."""
    base = re.sub(r"[^\w.-]+", "_", name).lstrip(".").encode()[:_LONGEST_GIVEN].decode(errors="ignore")
    return f"_{base}" if not base or base.split(".")[0].upper() in _RESERVED else base


def beside(path: Path, ending: str) -> Path:
    """Return the path of a surface's companion file, without spaces, because OBJ readers truncate names at spaces."""
    return path.with_name(re.sub(r"[\s#]+", "_", path.stem) + ending)
