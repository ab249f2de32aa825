"""Let only one process at a time write the same files."""

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

_PAUSE = 0.1  # seconds between attempts


@contextmanager
def locked(path: Path, tell: Callable[[], None]) -> Iterator[None]:
    """Hold a lock, a file that is deleted afterwards, while the block runs.

    If another process holds it, `tell` is called once, and the block waits. The system releases the lock of a process
    that is killed. On file systems without locks, the block runs without one.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = _acquired(path, tell)
    except OSError:  # nothing can be written here, which the block reports
        yield
        return
    try:
        yield
    finally:
        if sys.platform == "win32":  # which cannot delete an open file
            os.close(descriptor)
        with suppress(OSError):
            path.unlink()
        if sys.platform != "win32":
            os.close(descriptor)


def _acquired(path: Path, tell: Callable[[], None]) -> int:
    """Return the descriptor of the locked file."""
    is_told = False
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            if _lock(descriptor) and _is_file(descriptor, path):
                return descriptor
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)
        if not is_told:
            tell()
            is_told = True
        time.sleep(_PAUSE)


def _is_file(descriptor: int, path: Path) -> bool:
    """Return whether a file that was opened is still at its path; its last holder may have deleted it meanwhile."""
    with suppress(FileNotFoundError):
        return os.path.samestat(os.fstat(descriptor), path.stat())
    return False


def _lock(descriptor: int) -> bool:
    """Lock a file, if the file system can; return whether no other process holds the lock."""
    try:
        if sys.platform == "win32":
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:  # for example, some network file systems
        pass
    return True
