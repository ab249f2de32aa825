"""Checks of what users hand over that are the same everywhere: kinds, numbers, places, memory, progress."""

import ctypes
import logging
import math
import os
import platform
from collections.abc import Callable, Iterable
from functools import lru_cache
from numbers import Integral, Real
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
import psutil
from numpy.typing import ArrayLike, NDArray

from voxflat.errors import InputError

Progress = Callable[[str, int, int], bool | None]  # called as ``progress(stage, done, total)``; returning False cancels

_PIXELS = (16, 16384)  # of a side of a picture; graphics cards draw no more
_MOST_THREADS = 256  # far more than cores only take turns, and starting them takes minutes
_LINE = 80  # characters of a value in a message

log = logging.getLogger("voxflat")  # says what memory is needed, and warns of what the user should know of a map


# -------------------------------------------------------------------------------------------- kinds


def shown(value: object) -> str:
    """Return what was handed over as one short line."""
    try:
        line = " ".join(repr(value).split())
    except ValueError:  # whole numbers of too many digits
        line = f"a number of the type {type(value).__name__}"
    return line if len(line) <= _LINE else line[: _LINE - 4] + " ..."


def checked_path(path: str | os.PathLike[str], name: str = "path") -> Path:
    """Return a path that the system takes."""
    text = os.fspath(path) if isinstance(path, str | os.PathLike) else None
    try:
        is_name = isinstance(text, str) and text and b"\0" not in os.fsencode(text)
    except UnicodeEncodeError:
        is_name = False
    if not is_name:
        raise InputError(f"the {name} is {shown(path)}; give the name of a file or directory")
    return Path(path)


def checked_kind(value: object, name: str, attribute: str, kind: str) -> None:
    """Refuse what lacks the attribute by which a kind of object is known."""
    if not hasattr(value, attribute):
        raise InputError(f"the {name} is {shown(value)}; give {kind}")


def checked_choice(value: object, name: str, choices: Iterable[str]) -> str:
    """Return which of several choices was made."""
    known = tuple(choices)
    if not isinstance(value, str) or value not in known:
        *others, last = map(repr, known)
        raise InputError(f"{name} is {shown(value)}; give {', '.join(others)} or {last}")
    return value


def checked_switch(value: object, name: str) -> bool:
    """Return True or False, of Python or of NumPy."""
    if not isinstance(value, bool | np.bool_):
        raise InputError(f"{name} is {shown(value)}; give True or False")
    return bool(value)


def checked_text(value: object, name: str) -> str:
    """Return a text; one that is not given is empty."""
    if value is not None and not isinstance(value, str):
        raise InputError(f"the {name} is {shown(value)}; give text")
    return value or ""


# ------------------------------------------------------------------------------------------ numbers


def is_number(value: object) -> TypeGuard[float]:
    """Say whether something is a number; True and False are none."""
    return isinstance(value, Real) and not isinstance(value, bool)


def is_whole(value: object) -> TypeGuard[int]:
    """Say whether something is a whole number; True and False are none."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def checked_seed(seed: int) -> int:
    """Return a seed that the core takes."""
    if not is_whole(seed) or not 0 <= seed < 2**64:
        raise InputError(f"the seed is {shown(seed)}; give a whole number from 0 to 2**64 - 1")
    return int(seed)


def checked_pixels(value: object, name: str) -> int:
    """Return a number of pixels along one side of a picture."""
    if not is_whole(value) or not _PIXELS[0] <= value <= _PIXELS[1]:
        raise InputError(f"the {name} is {shown(value)}; give {_PIXELS[0]} to {_PIXELS[1]} pixels")
    return int(value)


def checked_threads(threads: int | None) -> int | None:
    """Return a number of threads that can be started; None for one a core."""
    most = max(_MOST_THREADS, os.cpu_count() or 1)
    if threads is not None and not (is_whole(threads) and 1 <= threads <= most):
        raise InputError(f"threads is {shown(threads)}; give at least 1, at most {most}, or nothing for one a core")
    return threads


def workers(threads: int | None) -> int:
    """Return how many threads work."""
    return threads or os.cpu_count() or 1


def checked_number(value: float, name: str) -> float:
    """Return a number."""
    if not is_number(value):
        raise InputError(f"the {name} is {shown(value)}; give a number")
    return as_float(value)


def optional_number(value: float | None, name: str) -> float | None:
    """Return a number, or None where there is none."""
    return None if value is None else checked_number(value, name)


def as_float(value: float) -> float:
    """Return a number as a float; infinity for a whole one that none holds."""
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def array_of(values: object, name: str) -> NDArray[Any]:
    """Return an array of any type; rows of one length."""
    try:
        return np.asarray(values)
    except (TypeError, ValueError):  # ragged, or of a kind with a mind of its own
        raise InputError(f"the {name} are {shown(values)}; give rows of one length") from None


def numbers_of(values: ArrayLike, name: str) -> NDArray[np.float64]:
    """Return numbers as an array; nothing but numbers, and rows of one length."""
    try:
        array = np.asarray(values)
        if array.dtype.kind in "biuf" or array.size == 0:
            return array.astype(np.float64, copy=False)
    except (TypeError, ValueError):  # ragged, or of a kind with a mind of its own
        pass
    raise InputError(f"the {name} are {shown(values)}; give numbers")


def voxel_indices(values: ArrayLike, name: str) -> NDArray[np.int64]:
    """Return voxel indices of shape (m, 3)."""
    array = np.asarray(values)
    if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in "ui":
        raise InputError(
            f"{name} must be voxel indices of shape (m, 3), whole numbers, not {array.dtype} of shape {array.shape}"
        )
    return np.ascontiguousarray(array, dtype=np.int64)


def refuse(method: str, **options: object) -> None:
    """Refuse options that a method, or a kind of distances, does not know; None is not given."""
    for name, value in options.items():
        if value is not None:
            raise InputError(f"{name} is given, but the method {method!r} knows no {name}; leave it out")


# ------------------------------------------------------------------------------------------- memory


_MMAP_THRESHOLD, _ARENA_MAX = -3, -8  # of glibc's malloc.h
_LARGE_ARRAY = 1 << 20
_THREADS_ADDRESSES = 48 << 20  # that threads to come take for their stacks

_CGROUPS = Path("/sys/fs/cgroup")
_OWN_CGROUPS = Path("/proc/self/cgroup")


def free_memory() -> int:
    """Return how many bytes this process may take: of the machine, of its limit (`ulimit -v`), of its containers."""
    return int(max(0, min(psutil.virtual_memory().available, _free_addresses(), _free_in_cgroups())))


def _free_addresses() -> float:
    """Return what RLIMIT_AS leaves."""
    if not hasattr(psutil, "RLIMIT_AS"):  # not on every system
        return math.inf
    process = psutil.Process()
    limit, _ = process.rlimit(psutil.RLIMIT_AS)
    if limit == psutil.RLIM_INFINITY:
        return math.inf
    _share_one_heap()
    return limit - process.memory_info().vms - _THREADS_ADDRESSES


@lru_cache(maxsize=1)
def give_back_memory() -> None:
    """Let memory go back to the system: glibc keeps arrays up to 32 MiB, a third of all for 100,000 vertices."""
    if platform.libc_ver()[0] == "glibc":
        ctypes.CDLL(None).mallopt(_MMAP_THRESHOLD, _LARGE_ARRAY)


@lru_cache(maxsize=1)
def _share_one_heap() -> None:
    """Let threads share one heap where addresses are short: glibc reserves 64 MiB for each that has its own."""
    if platform.libc_ver()[0] == "glibc":
        ctypes.CDLL(None).mallopt(_ARENA_MAX, 1)


def _free_in_cgroups() -> float:
    """Return what the control groups leave that this process and those around it are in, of both versions."""
    try:
        lines = _OWN_CGROUPS.read_text().splitlines()
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
    """Return what one group leaves; pages of files that nobody uses any more are given back when they are needed."""
    try:
        most = int((group / limit).read_text())
        used = int((group / usage).read_text())
        words = [line.split() for line in (group / "memory.stat").read_text().splitlines()]
        return most - used + sum(int(value) for name, value in words if name == reclaimable)
    except (OSError, ValueError):  # there is no such group here, or no limit ("max")
        return math.inf


def checked_limit(limit: int | None) -> int | None:
    """Return a limit of memory that is a number of bytes; None for none."""
    if limit is None:
        return None
    if not is_number(limit) or not math.isfinite(limit):
        raise InputError(f"the memory limit is {shown(limit)}; give a number of bytes")
    return int(limit)


def check_memory(need: int, limit: int | None, remedy: str) -> None:
    """Refuse to start where there is not enough memory."""
    limit = checked_limit(limit)
    allowed = free_memory() if limit is None else limit
    if need > allowed:
        kind = "are free" if limit is None else "is the limit"
        raise InputError(f"{amount(need)} of memory are needed, {amount(allowed)} {kind}; {remedy}")


def amount(size: float) -> str:
    """Return an amount of memory as text."""
    for unit in ("bytes", "KiB", "MiB"):
        if size < 1024:
            return f"{size:.4g} {unit}"
        size /= 1024
    return f"{size:.2f} GiB"
