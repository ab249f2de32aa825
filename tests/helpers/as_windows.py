"""A pytest plugin (`pytest -p as_windows`) that simulates Windows as far as possible on another system.

Modules and signals of POSIX do not exist; a file that this process has open cannot be renamed, replaced or deleted; a
broken pipe is EINVAL; and text files without an explicit encoding cause a warning. Not simulated: paths with drives,
device names, exclusive locks, and files that other processes have open.
"""

import errno
import os
import signal
import subprocess
import sys

import pytest

MODULES = ("fcntl", "pty", "resource", "termios")
NAMES = {
    os: "fork geteuid mkfifo register_at_fork killpg",
    signal: "SIGALRM SIGHUP SIGKILL SIGPROF alarm pthread_kill setitimer ITIMER_PROF ITIMER_REAL",
}


def pytest_configure():
    for module, names in NAMES.items():
        for name in names.split():
            if hasattr(module, name):
                delattr(module, name)
    for name in MODULES:
        sys.modules[name] = None
    for name in ("rename", "replace", "unlink", "remove", "rmdir"):
        setattr(os, name, refusing(getattr(os, name)))
    subprocess.Popen.kill = subprocess.Popen.terminate


def refusing(usual):
    """Return a function of the system that refuses open files."""

    def call(path, *others, **more):
        for one in (path, *others[:1]):
            if isinstance(one, str | bytes | os.PathLike) and (number := descriptor_of(one)) is not None:
                raise PermissionError(errno.EACCES, f"descriptor {number} has it open", os.fspath(one))
        return usual(path, *others, **more)

    return call


def descriptor_of(path):
    """Return a descriptor of this process through which a file, or a file in a directory, is open, or None."""
    wanted = os.path.realpath(os.fspath(path))
    for number in os.listdir("/proc/self/fd"):
        try:
            found = os.readlink(f"/proc/self/fd/{number}")
        except OSError:  # that of listdir itself
            continue
        if found == wanted or (os.path.isdir(wanted) and found.startswith(wanted + os.sep)):
            return number
    return None


@pytest.fixture(autouse=True)
def _nothing_waits(monkeypatch):
    monkeypatch.setattr("voxflat.io.files._WAITS", ())
