"""Names of temporary files and directories, and removal of those that killed processes left behind."""

import hashlib
import os
import platform
import re
import shutil
import sys
import uuid
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

_LONGEST_NAME = 255  # bytes, on all common file systems
_ADDED = 64  # no fewer than the bytes that are added to a name
_NAME = re.compile(r"\.voxflat-([0-9a-f]{8})-(\d{1,9})-(\d*)-[0-9a-f]{8}\.")  # system, process, its start; random
_QUERY, _NO_PROCESS, _STILL_ACTIVE = 0x1000, 87, 259  # of the Windows API
_ENDED = "ZX"  # states of processes that have ended, and whose parent has not noticed


def temporary_beside(path: Path) -> Path:
    """Return a new name in the same directory, with the same ending and no longer than file systems allow.

    Delete the temporary files and directories of killed processes of this system in that directory. The name contains
    the system, the process and its start, so that those of a running process, or of another system, stay.
    """
    _sweep(path.parent)
    name = path.name
    while len(os.fsencode(name)) > _LONGEST_NAME - _ADDED:
        name = name[1:]
    process = os.getpid()
    return path.with_name(f".voxflat-{_system()}-{process}-{_start(process)[1]}-{uuid.uuid4().hex[:8]}.{name}")


def _sweep(folder: Path) -> None:
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            match = _NAME.match(entry.name)
            if match is None or match[1] != _system() or _is_running(int(match[2]), match[3]):
                continue
            if entry.is_dir(follow_symlinks=False):
                shutil.rmtree(entry.path, ignore_errors=True)
            else:
                with suppress(OSError):  # of another user, or open on Windows
                    os.unlink(entry.path)


@lru_cache
def _system() -> str:
    """Return a hash of the host name, the machine and the container, within which process numbers are unique."""
    parts = [platform.node()]
    with suppress(OSError):
        parts.append(Path("/etc/machine-id").read_text(encoding="utf-8"))
    with suppress(OSError):
        parts.append(os.readlink("/proc/self/ns/pid"))
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:8]


def _is_running(process: int, start: str) -> bool:
    """Return whether a process of this system that started then may still be running."""
    if sys.platform == "win32":
        return _is_running_on_windows(process)
    try:
        os.kill(process, 0)  # sends no signal
    except ProcessLookupError:
        return False
    except OSError:  # it belongs to another user
        pass
    state, its_start = _start(process)
    return state not in _ENDED and (not its_start or not start or its_start == start)


def _start(process: int) -> tuple[str, str]:
    """Return the state of a process and its start in clock ticks since the system started, where Linux tells them."""
    with suppress(OSError):
        fields = Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
        return fields[0], fields[19]
    return " ", ""


if sys.platform == "win32":

    def _is_running_on_windows(process: int) -> bool:
        import ctypes

        kernel = ctypes.WinDLL("kernel32", use_last_error=True)
        kernel.OpenProcess.restype = ctypes.c_void_p
        handle = kernel.OpenProcess(_QUERY, False, process)
        if not handle:
            return ctypes.get_last_error() != _NO_PROCESS
        status = ctypes.c_ulong()
        kernel.GetExitCodeProcess(ctypes.c_void_p(handle), ctypes.byref(status))
        kernel.CloseHandle(ctypes.c_void_p(handle))
        return status.value == _STILL_ACTIVE
