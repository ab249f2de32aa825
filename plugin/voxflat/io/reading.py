"""Track the files that are read within a call, and limit the memory used for reading them."""

import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

from voxflat.arguments import check_memory, checked_limit, free_memory

_BLOCK = 1 << 20


@dataclass
class _Reading:
    limit: int | None = None
    files: dict[str, str] = field(default_factory=dict)


_now: ContextVar[_Reading | None] = ContextVar("voxflat_reading", default=None)


@contextmanager
def reading(memory_limit: int | None = None) -> Iterator[dict[str, str]]:
    """Record the files that are read and their SHA-256, and limit memory in bytes; nested calls inherit the limit."""
    around = _now.get()
    checked_limit(memory_limit)
    limit = memory_limit if memory_limit is not None or around is None else around.limit
    now = _Reading(limit)
    token = _now.set(now)
    try:
        yield now.files
    finally:
        _now.reset(token)
        if around is not None:
            around.files.update(now.files)


def record_file(path: str | os.PathLike[str]) -> None:
    """Record that a file is read, if a call tracks its files."""
    if (now := _now.get()) is not None:
        now.files[os.fspath(path)] = hash_of(path)


def hash_of(path: str | os.PathLike[str]) -> str:
    """Return the SHA-256 of a file in hexadecimal."""
    status = os.stat(path)
    return _sha256(os.path.abspath(path), (status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns))


@lru_cache(maxsize=256)
def _sha256(path: str, state: tuple[int, ...]) -> str:
    """Return the hash of a file, computed once for each of its states."""
    hashed = hashlib.sha256()
    with Path(path).open("rb") as file:
        while block := file.read(_BLOCK):
            hashed.update(block)
    return hashed.hexdigest()


def allowed_memory() -> int:
    """Return how many bytes may currently be used: the limit of the call, or the free memory."""
    now = _now.get()
    return free_memory() if now is None or now.limit is None else int(now.limit)


def check_room(need: int, remedy: str = "crop or downsample it, or allow more memory") -> None:
    """Raise an error if a file needs more bytes than are available."""
    now = _now.get()
    check_memory(need, None if now is None else now.limit, remedy)
