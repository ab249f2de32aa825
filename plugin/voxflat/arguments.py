"""Check arguments that many functions share: types, numbers, voxel indices and memory."""

import logging
import math
import os
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from numbers import Integral, Real
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat.errors import Cancelled, InputError

Progress = Callable[[str, int, int], bool | None]  # called as ``progress(stage, done, total)``; returning False cancels

_PIXELS = (16, 16384)  # limits of a picture's side length; graphics cards do not draw larger pictures
_MOST_THREADS = 256  # starting many more threads takes minutes, and they would wait for the cores
_LINE = 80  # characters of a value in a message
_UNPRINTABLE = re.compile("[\0-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff\ufffe\uffff]")  # neither text nor XML

log = logging.getLogger("voxflat")  # reports the memory that a computation needs, and warnings about maps


class Note(str):
    """A warning that describes a usual step, such as cutting; all other warnings are reasons to check the result."""

    __slots__ = ()


def poll(progress: Progress | None, stage: str, done: int = 0, total: int = 1) -> None:
    """Report progress, and raise `Cancelled` if the user has cancelled."""
    if progress is not None and progress(stage, done, total) is False:
        raise Cancelled(f"cancelled while {stage}")


def shown(value: object) -> str:
    """Return a short one-line representation of a value for a message."""
    try:
        line = " ".join(repr(value).split())
    except ValueError:  # integers with too many digits
        line = f"a number of the type {type(value).__name__}"
    return line if len(line) <= _LINE else line[: _LINE - 4] + " ..."


def checked_path(path: str | os.PathLike[str], name: str = "path") -> Path:
    """Return a path after checking that the file system accepts it."""
    text = os.fspath(path) if isinstance(path, str | os.PathLike) else None
    try:
        is_name = isinstance(text, str) and text and b"\0" not in os.fsencode(text)
    except UnicodeEncodeError:
        is_name = False
    if not is_name:
        raise InputError(f"the {name} is {shown(path)}. Pass a path to a file or directory")
    return Path(path)


def checked_instance(value: object, cls: type, name: str, kind: str) -> None:
    """Raise an error if a value is not an object of this class."""
    if not isinstance(value, cls):
        raise InputError(f"the {name} is {shown(value)}. Pass {kind}")


def checked_choice(value: object, name: str, choices: Iterable[str]) -> str:
    """Return a value after checking that it is one of the choices."""
    names = tuple(choices)
    if not isinstance(value, str) or value not in names:
        *others, last = map(repr, names)
        raise InputError(f"{name} is {shown(value)}. Pass {', '.join(others)} or {last}")
    return value


_SIDES = {"l": "left", "lh": "left", "left": "left", "r": "right", "rh": "right", "right": "right"}


@contextmanager
def collecting_warnings() -> Iterator[list[str]]:
    """Collect the warnings that this thread logs, instead of logging them."""
    warnings: list[str] = []
    token = _collected.set(warnings)
    try:
        yield warnings
    finally:
        _collected.reset(token)


_collected: ContextVar[list[str] | None] = ContextVar("voxflat_warnings", default=None)


def _is_logged(record: logging.LogRecord) -> bool:
    warnings = _collected.get()
    if warnings is None or record.levelno < logging.WARNING:
        return True
    warnings.append(record.getMessage())
    return False


log.addFilter(_is_logged)


def named_side(value: object, name: str) -> str:
    """Return "left" or "right" for any name of a hemisphere, such as L or lh, in upper or lower case."""
    side = _SIDES.get(value.lower()) if isinstance(value, str) else None
    if side is None:
        raise InputError(f"{name} is {shown(value)}. Pass 'left' or 'right' (or 'L', 'R', 'lh' or 'rh')")
    return side


def checked_switch(value: object, name: str) -> bool:
    """Return a Python or NumPy boolean as a bool."""
    if not isinstance(value, bool | np.bool_):
        raise InputError(f"{name} is {shown(value)}. Pass True or False")
    return bool(value)


def checked_text(value: object, name: str) -> str:
    """Return a string; None becomes an empty string."""
    if value is not None and not isinstance(value, str):
        raise InputError(f"the {name} is {shown(value)}. Pass a string")
    return value or ""


def printable(text: str) -> str:
    """Return a text on one line, in which whitespace and characters that files cannot hold are replaced."""
    return _UNPRINTABLE.sub(lambda match: " " if match[0].isspace() else "\N{REPLACEMENT CHARACTER}", text)


def is_number(value: object) -> TypeGuard[float]:
    """Return whether a value is a real number; True and False are not numbers."""
    return isinstance(value, Real) and not isinstance(value, bool)


def is_whole(value: object) -> TypeGuard[int]:
    """Return whether a value is an integer; True and False are not integers."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def checked_seed(seed: int) -> int:
    """Return a seed after checking that the core accepts it."""
    if not is_whole(seed) or not 0 <= seed < 2**64:
        raise InputError(f"the seed is {shown(seed)}. Pass a whole number from 0 to 2**64 - 1")
    return int(seed)


def checked_pixels(value: object, name: str) -> int:
    """Return the number of pixels along one side of a picture."""
    if not is_whole(value) or not _PIXELS[0] <= value <= _PIXELS[1]:
        raise InputError(f"the {name} is {shown(value)}. Pass {_PIXELS[0]} to {_PIXELS[1]} pixels")
    return int(value)


def checked_threads(threads: int | None) -> int | None:
    """Return a number of threads that can be started; None means one thread per core."""
    most = max(_MOST_THREADS, os.cpu_count() or 1)
    if threads is not None and not (is_whole(threads) and 1 <= threads <= most):
        raise InputError(f"threads is {shown(threads)}. Pass a number from 1 to {most}, or omit it for one per core")
    return threads


def workers(threads: int | None) -> int:
    """Return the number of worker threads."""
    return threads or os.cpu_count() or 1


def checked_number(value: float, name: str) -> float:
    """Return a number as a float."""
    if not is_number(value):
        raise InputError(f"the {name} is {shown(value)}. Pass a number")
    return as_float(value)


def optional_number(value: float | None, name: str) -> float | None:
    """Return a number as a float, or None."""
    return None if value is None else checked_number(value, name)


def as_float(value: float) -> float:
    """Return a number as a float; integers that are too large become infinite."""
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def unmasked(values: Any, name: str, *, as_nan: bool = False) -> Any:
    """Return values after checking that `numpy.asarray` will not reveal masked entries; if `as_nan`, they become NaN.

    Only floating-point numbers can become NaN.
    """
    parts = values if isinstance(values, list | tuple) else [values]
    count = sum(np.count_nonzero(np.ma.getmaskarray(part)) for part in parts if isinstance(part, np.ma.MaskedArray))
    if not count:
        return values
    if as_nan and isinstance(values, np.ma.MaskedArray) and values.dtype.kind == "f":
        return values.filled(np.nan)
    problem = f"{count:,} of the {name} are masked"
    raise InputError(f"{problem}. {'Convert them to floats' if as_nan else 'Fill them, for example with .filled(0)'}")


def array_of(values: object, name: str, *, as_nan: bool = False) -> NDArray[Any]:
    """Return values as an array of any type after checking that its rows have equal lengths; see `unmasked`."""
    values = unmasked(values, name, as_nan=as_nan)
    try:
        return np.asarray(values)
    except (TypeError, ValueError):  # ragged, or a type that NumPy cannot convert
        raise InputError(f"the {name} are {shown(values)}. Pass rows of equal length") from None


def numbers_of(values: ArrayLike, name: str, *, as_nan: bool = False) -> NDArray[np.float64]:
    """Return values as an array of floats after checking that they are numbers in equally long rows; see `unmasked`."""
    values = unmasked(values, name, as_nan=as_nan)
    try:
        array = np.asarray(values)
        if array.dtype.kind in "biuf" or array.size == 0:
            return array.astype(np.float64, copy=False)
    except (TypeError, ValueError):  # ragged, or a type that NumPy cannot convert
        pass
    raise InputError(f"the {name} are {shown(values)}. Pass numbers")


def voxel_indices(values: ArrayLike, name: str) -> NDArray[np.int64]:
    """Return voxel indices of shape (m, 3)."""
    array = array_of(values, name)
    if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in "ui":
        raise InputError(
            f"{name} must be voxel indices (integers) of shape (m, 3), but got data type {array.dtype} and shape "
            f"{array.shape}"
        )
    return np.ascontiguousarray(array, dtype=np.int64)


def refuse(method: str, **options: object) -> None:
    """Raise an error if any of these options, which the method or kind of distance does not have, is set."""
    for name, value in options.items():
        if value is not None:
            raise InputError(f"the method {method!r} does not have the option {name}. Omit it")


_STACK_ADDRESSES = 48 << 20  # address space for the stacks of threads that will be started

_CGROUPS = Path("/sys/fs/cgroup")
_OWN_CGROUPS = Path("/proc/self/cgroup")


def free_memory() -> int:
    """Return the bytes available to this process, given the limits of the machine, `ulimit -v` and the containers."""
    import psutil

    return int(max(0, min(psutil.virtual_memory().available, _free_addresses(), _free_in_cgroups())))


def _free_addresses() -> float:
    """Return the address space that RLIMIT_AS leaves, in bytes."""
    import psutil

    if not hasattr(psutil, "RLIMIT_AS"):  # the limit does not exist on every system
        return math.inf
    process = psutil.Process()
    limit, _ = process.rlimit(psutil.RLIMIT_AS)
    if limit == psutil.RLIM_INFINITY:
        return math.inf
    return limit - process.memory_info().vms - _STACK_ADDRESSES


def _free_in_cgroups() -> float:
    """Return the bytes that the control groups (version 1 or 2) of this process leave available."""
    try:
        lines = _OWN_CGROUPS.read_text("utf-8").splitlines()
    except OSError:
        return math.inf
    least = math.inf
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if controllers == "":
            root, names = _CGROUPS, ("memory.max", "memory.current", "inactive_file")
        elif "memory" in controllers.split(","):
            root, names = _CGROUPS / "memory", ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
        else:
            continue
        own = root / path.lstrip("/")
        for group in (own, *own.parents):
            least = min(least, _free_in(group, *names))
            if group == root:
                break
    return least


def _free_in(group: Path, limit: str, usage: str, reclaimable: str) -> float:
    """Return the bytes that one group leaves available; inactive pages of the file cache count as free."""
    try:
        most = int((group / limit).read_text("utf-8"))
        used = int((group / usage).read_text("utf-8"))
        words = [line.split() for line in (group / "memory.stat").read_text("utf-8").splitlines()]
        return most - used + sum(int(value) for name, value in words if name == reclaimable)
    except (OSError, ValueError):  # the group does not exist here, or has no limit ("max")
        return math.inf


def checked_limit(limit: int | None) -> int | None:
    """Return a memory limit in bytes; None means no limit."""
    if limit is None:
        return None
    if not is_number(limit) or not 1 <= limit < math.inf:
        raise InputError(f"the memory limit is {shown(limit)}. Pass a number of bytes")
    return int(limit)


def check_memory(need: int, limit: int | None, remedy: str) -> None:
    """Raise an error before a computation that needs more memory than available; `remedy` is an imperative sentence."""
    limit = checked_limit(limit)
    allowed = free_memory() if limit is None else limit
    if need > allowed:
        available = f"only {amount(allowed)} is free" if limit is None else f"the limit is {amount(allowed)}"
        raise InputError(f"{amount(need)} of memory is needed, but {available}. {remedy[0].upper()}{remedy[1:]}")


def amount(size: float) -> str:
    """Return a number of bytes as text with a binary unit."""
    for unit in ("bytes", "KiB", "MiB"):
        if size < 1024:
            return f"{size:.4g} {unit}"
        size /= 1024
    return f"{size:.2f} GiB"
