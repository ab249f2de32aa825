"""Record how a result was made, in the same way in all file formats.

A record contains the version, the function with its parameters, and the SHA-256 hashes of the files that were read. A
parameter that is itself a result, such as the surface of `flatten`, is described by its own record. The record
contains neither a time nor a machine name, so the same call with the same files gives the same bytes.
"""

import copy
import hashlib
import inspect
import json
import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from functools import wraps
from itertools import count
from numbers import Integral, Real
from pathlib import Path
from typing import Any, ClassVar, TypeVar, cast

import numpy as np

from voxflat._core import __version__
from voxflat.arguments import checked_path, checked_switch, shown
from voxflat.errors import InputError
from voxflat.io.files import atomic_path
from voxflat.io.reading import hash_of, reading

Record = dict[str, object]
"""``voxflat`` (the version), ``function``, ``parameters``, ``files`` (SHA-256 by path), and, for maps, ``figures``."""

_NAMES = {"self": "of", "of": "values"}  # of parameters in records, where "of" is the object
_UNRECORDED = ("progress", "threads", "memory_limit", "dask")  # parameters that do not affect the result
_MARKED = 4096  # voxflat's files contain its name in these first bytes
_LONGEST_PATH = 4096  # characters
_SHOWN = 32  # longest array that is recorded value by value
_BLOCK = 2**20  # values that are hashed together

_Function = TypeVar("_Function", bound=Callable[..., Any])


def recording(**told_as: Callable[[Any], Any]) -> Callable[[_Function], _Function]:
    """Add a provenance record to a function's result, and apply its ``memory_limit`` to the files that it reads."""

    def decorate(function: _Function) -> _Function:
        signature = inspect.signature(function)

        @wraps(function)
        def wrapped(*args: Any, **kwargs: Any) -> Any:
            bound = signature.bind(*args, **kwargs)
            bound.apply_defaults()
            values = bound.arguments
            chosen = _chosen.set({})
            try:
                with reading(values.get("memory_limit")) as files:
                    result = function(*args, **kwargs)
            finally:
                defaults = _chosen.get()
                _chosen.reset(chosen)
            if any(result is value for value in values.values()):  # the result is an argument
                return result
            call = {_NAMES.get(name, name): v for name, v in values.items() if name not in _UNRECORDED}
            call |= {name: tell(call[name]) for name, tell in told_as.items()}
            record = record_of(function.__name__, described(call), dict(sorted(files.items())))
            if isinstance(result, tuple):
                return tuple(part._with_provenance(resolved(record, defaults)) for part in result)
            return result._with_provenance(resolved(record, defaults))

        return cast("_Function", wrapped)

    return decorate


_chosen: ContextVar[dict[str, Any]] = ContextVar("voxflat_chosen", default={})  # noqa: B039  (set before each use)


def record_default(**values: Any) -> None:
    """Record the values that the function uses for parameters that were not given."""
    _chosen.set({**_chosen.get(), **values})


def record_of(function: str, parameters: dict[str, Any], files: dict[str, str]) -> Record:
    """Return the record of a function's result."""
    return {"voxflat": __version__, "function": function, "parameters": parameters, "files": files}


def resolved(record: Record, used: dict[str, Any]) -> Record:
    """Return a record completed with the values, keyed by name, that were used for parameters that were not given."""
    recorded: Any = record["parameters"]
    parameters: dict[str, Any] = copy.deepcopy(recorded)
    method = parameters.get("method")
    for values in (parameters, method) if isinstance(method, dict) else (parameters,):
        for name, value in values.items():
            if value is None and used.get(name) is not False:
                values[name] = described(used.get(name))
    return {**record, "parameters": parameters}


_Own = TypeVar("_Own", bound="Recorded")


def files_of(record: Record) -> dict[str, str]:
    """Return the files that a record lists, with their checksums."""
    files: Any = record.get("files", {})
    return dict(files)


class Recorded:
    """Base class of results with a field ``provenance`` that contains a provenance record."""

    _used: ClassVar[tuple[str, ...]] = ()
    """Fields with the values used for parameters that were not given."""

    def _with_provenance(self: _Own, record: Record) -> _Own:
        """Return the same object with a provenance record."""
        copied: Any = self
        used = {key: getattr(self, key) for key in self._used}
        return cast("_Own", replace(copied, provenance=resolved(record, used)))


def described(value: object) -> Any:
    """Return a parameter as JSON: the record of a result, the SHA-256 of a long array, or else its value or type."""
    if value is None or isinstance(value, str | bool | np.bool_):
        return bool(value) if isinstance(value, np.bool_) else value
    if isinstance(value, Integral):
        return int(value)
    if isinstance(value, Real):
        return float(value) if math.isfinite(value) else str(float(value))
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, dict):
        return {str(key): described(item) for key, item in value.items()}
    record = getattr(value, "provenance", None)
    if isinstance(record, dict):
        return record
    if isinstance(value, list | tuple) and len(value) <= _SHOWN:
        return [described(item) for item in value]
    if isinstance(value, list | tuple):
        text = json.dumps([described(item) for item in value])
        return {"length": len(value), "sha256": hashlib.sha256(text.encode()).hexdigest()}
    if isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
        if value.size <= _SHOWN:
            return described(value.tolist())
        digest, rows = hashlib.sha256(), max(1, _BLOCK * len(value) // value.size)
        for start in range(0, len(value), rows):  # in blocks, because Ctrl-C has no effect on a long copy
            values = np.ascontiguousarray(value[start : start + rows], dtype=value.dtype.newbyteorder("<"))
            digest.update(values.reshape(-1).view(np.uint8).data)
        return {"dtype": value.dtype.name, "shape": list(value.shape), "sha256": digest.hexdigest()}
    if isinstance(path := getattr(value, "path", None), os.PathLike):  # a Mesh or Volume from a file
        return os.fspath(path)
    return type(value).__name__


KEEP_PATHS = "VOXFLAT_KEEP_PATHS"  # environment variable: 1 keeps paths in files


def portable(content: Any) -> Any:
    """Replace paths, which can reveal people and projects, with file names, which are numbered if they clash."""
    if os.environ.get(KEEP_PATHS) == "1":
        return content
    names: dict[str, str] = {}
    for path in sorted(_paths(content), key=lambda path: (len(path), path)):
        name, taken = os.path.basename(path.rstrip("/\\")) or path, set(names.values())
        numbered = (f"{name} ({n})" for n in count(2))
        names[path] = name if name not in taken else next(other for other in numbered if other not in taken)
    return _renamed(content, sorted(names.items(), key=lambda item: -len(item[0])))


def _paths(content: Any) -> set[str]:
    """Return all paths that consist of more than a file name."""
    if isinstance(content, str):
        is_path = len(content) < _LONGEST_PATH and "\n" not in content and os.path.basename(content) != content
        return {content} if is_path and (os.path.isabs(content) or os.path.exists(content)) else set()
    if isinstance(content, list | tuple):
        return set().union(*map(_paths, content))
    if not isinstance(content, dict):
        return set()
    paths = set().union(*map(_paths, content.values()))
    files = content.get("files")
    return paths | ({path for path in files if os.path.basename(path) != path} if isinstance(files, dict) else set())


def _renamed(content: Any, names: list[tuple[str, str]]) -> Any:
    if isinstance(content, str):
        for path, name in names:
            content = content.replace(path, name)
        return content
    if isinstance(content, list | tuple):
        return [_renamed(item, names) for item in content]
    if isinstance(content, dict):
        return {_renamed(key, names): _renamed(value, names) for key, value in content.items()}
    return content


def as_text(record: Record, indent: int | None = None) -> str:
    """Return a record as JSON, without paths."""
    try:
        return json.dumps(portable(record), indent=indent, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"the record {shown(record)} cannot be written as JSON: {error}") from error


def _files(record: object) -> Iterator[tuple[str, str]]:
    """Yield the paths and hashes of all files in a record and in the records within it."""
    if isinstance(record, dict):
        files = record.get("files")
        yield from files.items() if isinstance(files, dict) else ()
        for value in record.values():
            yield from _files(value)


def check_not_read(path: Path, record: Record) -> None:
    """Raise an error instead of overwriting a file from which a result was made, even under another name."""
    if not path.exists():
        return
    for name, digest in _files(record):
        is_same = os.path.exists(name) and path.samefile(name)
        if is_same or (path.name == os.path.basename(name) and path.is_file() and digest == hash_of(path)):
            raise InputError(f"cannot write {path}: it is an input ({name}). Choose another name")


def check_beside(path: Path, beside: Path, *, overwrite: bool = False) -> None:
    """Raise an error instead of replacing a result's companion file, unless voxflat wrote it or `overwrite` is set."""
    if checked_switch(overwrite, "overwrite") or not beside.exists():
        return
    if beside.is_file():
        with beside.open("rb") as file:
            if b"voxflat" in file.read(_MARKED):
                return
    reason = f"{beside} exists and was not written by voxflat"
    raise InputError(f"cannot write {path}: {reason}. Choose another name, or pass overwrite=True")


def sidecar_of(path: str | os.PathLike[str]) -> Path:
    """Return the path of the JSON file that accompanies a result."""
    path = checked_path(path)
    return path.with_name(f"{path.name}.json")


@contextmanager
def saving(
    path: str | os.PathLike[str], record: Record, *, sidecar: bool = False, overwrite: bool = False
) -> Iterator[Path]:
    """Protect the sources of a result while it is written, and write its record to ``<path>.json`` on request."""
    path = checked_path(path)
    checked_switch(overwrite, "overwrite")
    check_not_read(path, record)
    if checked_switch(sidecar, "sidecar"):
        check_not_read(sidecar_of(path), record)
        check_beside(path, sidecar_of(path), overwrite=overwrite)
    yield path
    if sidecar:
        with atomic_path(sidecar_of(path)) as temporary:
            temporary.write_text(as_text(record, indent=2) + "\n", encoding="utf-8", newline="\n")
