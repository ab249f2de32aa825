"""Run readers written in C++ in a child process.

ITK, VTK, HDF5 and the decoders of Zarr chunks and pictures trust the files that they read. A damaged file can crash the
process, take all its memory, print messages, or never finish. Therefore, they run in a child process, which starts on
first use and restarts after a crash. The system limits its memory and time for each file. Its output is discarded, and
its answers, JSON and the bytes of arrays, are checked here. If reading fails, the caller gets a one-line error. Windows
limits neither time nor memory, and macOS does not limit memory.
"""

import atexit
import contextlib
import importlib
import importlib.util
import json
import math
import os
import select
import signal
import stat
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import amount
from voxflat.errors import InputError
from voxflat.io.files import AGAIN, one_line, require
from voxflat.io.reading import allowed_memory, check_room, reading

_SECONDS, _RATE = 5, 1 << 20  # CPU seconds per file, and bytes per additional second
_WAITING = 10  # wall-clock seconds per CPU second, for busy machines and slow disks
_INFLATED = 1032  # largest compression ratio of zlib
_DYING = 1.0  # seconds to wait for the exit status of a child that does not answer
_OWN = 1 << 28  # bytes of address space for the package itself
_ARRAY = "voxflat array"  # key of the description of an array in an answer

# signals that stop a process even within C++ code: their clock, and a factor for the seconds
_TIMES = {}
if hasattr(signal, "setitimer"):  # not Windows
    _TIMES = {signal.SIGPROF: (signal.ITIMER_PROF, 1), signal.SIGALRM: (signal.ITIMER_REAL, _WAITING)}

_ENVIRONMENT = {
    # threads reserve far more address space than they use
    "ITK_GLOBAL_DEFAULT_NUMBER_OF_THREADS": "1",
    "MALLOC_ARENA_MAX": "1",
    # pages of 2 MiB, as in NumPy: ITK reads 100 MB in half the time
    "GLIBC_TUNABLES": ":".join(filter(None, (os.environ.get("GLIBC_TUNABLES"), "glibc.malloc.hugetlb=1"))),
}

# not -m, which would import modules from the working directory
_START = "import sys; sys.path[:] = sys.argv[1:]; from voxflat.io.subprocess_reader import serve; serve()"


def read_in_subprocess(
    function: Callable[..., Any],
    package: str,
    path: Path,
    *arguments: Any,
    size: int | None = None,
    inflated: int = _INFLATED,
) -> Any:
    """Call a module-level function in the child process that reads a file with a C++ package.

    The function returns an array or JSON; tuples become lists. `size` is the number of bytes to read if they are not
    all in that file, and `inflated` is the number of bytes that each of them can become. A crash of the child raises an
    `InputError`, and most other errors raise a `RuntimeError`.
    """
    global _child
    if importlib.util.find_spec(package) is None:
        require(package)
    size = path.stat().st_size if size is None else size
    asked = {
        "function": f"{function.__module__}:{function.__name__}",
        "package": package,
        "arguments": [str(path.absolute()), *arguments],
        "seconds": _SECONDS + size // _RATE,
        "memory": allowed_memory(),
        "contents": inflated * size,
    }
    with _lock:
        if _child is None or _child.poll() is not None:
            _stop()
            _child = _started()
        try:
            answer = _answer(_child, asked)
        except BaseException:  # do not pass its late answer to the next caller
            _stop()
            raise
    if "error" in answer:
        kind, *values = answer["error"]
        raise {"InputError": InputError, "OSError": OSError, "RuntimeError": RuntimeError}[kind](*values)
    return answer["value"]


# display name, and an attribute that triggers loading (ITK loads lazily)
_PACKAGES = {"itk": ("ITK", "ImageIOFactory"), "vtkmodules": ("VTK", "__name__")}
_PACKAGES |= {"PIL": ("Pillow", "__name__"), "zarr": ("Zarr", "__name__"), "h5py": ("HDF5", "__name__")}

_lock = threading.Lock()
_child: subprocess.Popen[bytes] | None = None
_life: IO[bytes] | None = None  # end of a pipe that the child watches: the system closes it when this process ends


def _started() -> subprocess.Popen[bytes]:
    """Start a child that ignores the caller's Ctrl-C and ends when the caller ends."""
    global _life
    watched, life = os.pipe()
    _life = os.fdopen(life, "wb", 0)
    try:
        return subprocess.Popen(
            [sys.executable, "-c", _START, *sys.path],
            bufsize=0,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=watched,
            pipesize=_RATE,
            start_new_session=True,
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
            env={**os.environ, **_ENVIRONMENT},
        )
    finally:
        os.close(watched)


def _answer(child: subprocess.Popen[bytes], asked: dict[str, Any]) -> dict[str, Any]:
    """Send a request to the child; return its answer, in which arrays replace their descriptions."""
    requests, answers, sizes = child.stdin, child.stdout, list[int]()
    assert requests is not None
    assert answers is not None

    def received(content: dict[str, Any]) -> Any:
        if not isinstance(described := content.get(_ARRAY), list):
            return content
        kind, shape, order = np.dtype(described[0]), described[1], described[2]
        if kind.hasobject:
            raise InputError(_end_of(child, asked))
        sizes.append(kind.itemsize * math.prod(shape))
        check_room(sum(sizes))
        array = np.empty(shape, kind)
        rest = array.reshape(-1).view(np.uint8).data
        while rest:
            if not (count := answers.readinto(rest)):  # type: ignore[attr-defined]
                raise InputError(_end_of(child, asked))
            rest = rest[count:]
        return array.transpose(order)

    line = b""
    with contextlib.suppress(OSError):  # the pipe is broken: EPIPE, or EINVAL on Windows
        requests.write(json.dumps(asked).encode() + b"\n")
        line = answers.readline()
    if not line.endswith(b"\n"):
        raise InputError(_end_of(child, asked))
    answer: dict[str, Any] = json.loads(line, object_hook=received)  # in the order of the text, as the child sends them
    return answer


def _end_of(child: subprocess.Popen[bytes], asked: dict[str, Any]) -> str:
    """Return the reason why a child ended."""
    _stop(_DYING)
    status, name = child.returncode, _PACKAGES[asked["package"]][0]
    for timer, (_, times) in _TIMES.items():
        if status == -timer:
            return f"{name} did not finish reading the file within {asked['seconds'] * times} s. {AGAIN}"
    end = signal.Signals(-status).name if status < 0 else f"status {status}"
    limit = amount(asked["memory"])
    return f"{name} ended while it read the file ({end}, memory limit {limit}). {AGAIN}, or allow more memory"


def _stop(patience: float = 0.0) -> None:
    """Stop the child, which only reads files, after giving it some seconds to end by itself."""
    global _child
    child, _child = _child, None
    if child is not None:
        _close(child)
        if patience:
            with contextlib.suppress(subprocess.TimeoutExpired):
                child.wait(patience)
        child.kill()
        child.wait()


def _close(child: subprocess.Popen[bytes]) -> None:
    for stream in (child.stdin, child.stdout, _life):
        assert stream is not None
        stream.close()


def _forget() -> None:
    """Forget the child of the process that forked this one."""
    global _child, _lock
    if _child is not None:
        _close(_child)
        _child.returncode = 0  # its parent waits for it
    _child, _lock = None, threading.Lock()


atexit.register(_stop)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)


def serve() -> None:
    """Answer the requests that `read_in_subprocess` sends to standard input, until the input ends."""
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    _end_with_caller(os.dup(2))
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(nowhere, stream)
    sys.addaudithook(_refuse_pipe)
    for line in requests:
        asked = json.loads(line)
        try:
            answer: dict[str, Any] = {"value": _called(**asked)}
        except Exception as error:
            answer = {"error": _as_answer(error, asked["arguments"][0])}
        _send(answers, answer)


def _end_with_caller(watched: int) -> None:
    """End this process when the other end of a pipe is closed, even while it reads a file.

    On Linux, the system sends a signal, which needs no Python, because C++ code may hold the interpreter. The death
    signal of Linux would come too early: when the thread of the caller ends that started this process.
    """
    if sys.platform == "linux":
        import fcntl

        fcntl.fcntl(watched, fcntl.F_SETOWN, os.getpid())
        fcntl.fcntl(watched, fcntl.F_SETFL, os.O_ASYNC)  # SIGIO, which ends a process
        if not select.select([watched], [], [], 0)[0]:
            return

    def wait() -> None:
        os.read(watched, 1)
        os._exit(0)

    threading.Thread(target=wait, daemon=True).start()


def _refuse_pipe(event: str, values: tuple[Any, ...]) -> None:
    """Prevent Python from opening a pipe, such as one in place of a Zarr chunk, because reading it would block."""
    mode = 0
    if event == "open" and isinstance(values[0], str | bytes | os.PathLike):
        with contextlib.suppress(OSError, ValueError):  # the file does not exist
            mode = os.stat(values[0]).st_mode
    if stat.S_ISFIFO(mode):
        raise InputError(f"{Path(os.fsdecode(values[0])).name} is not a regular file. Copy its content into a file")


def _as_answer(error: Exception, path: str) -> list[Any]:
    """Return the type of an error and its values; the caller adds the file name."""
    if isinstance(error, OSError) and error.errno is not None:  # readers of damaged files raise errors without errno
        return ["OSError", error.errno, error.strerror, error.filename]
    if isinstance(error, MemoryError):
        return ["InputError", "needs more memory than is available. Crop it, or allow more memory"]
    text = str(error).replace(path, Path(path).name)
    return ["InputError", text] if isinstance(error, InputError) else ["RuntimeError", one_line(RuntimeError(text))]


def _called(function: str, package: str, arguments: list[Any], seconds: int, memory: int, contents: int) -> Any:
    """Call a function within limits that do not include the import of its package."""
    _limit_addresses(None)  # remove the limit of the previous file
    getattr(require(package), _PACKAGES[package][1])
    module, _, name = function.partition(":")
    called = getattr(importlib.import_module(module), name)
    _limit_addresses(2 * (_OWN + min(memory, contents)))  # factor 2: conversion holds the data twice
    _limit_seconds(seconds)
    try:
        with reading(memory):
            return called(Path(arguments[0]), *arguments[1:])
    finally:
        _limit_seconds(0)


def _limit_seconds(seconds: int) -> None:
    """Stop this process after some seconds of CPU time; 0 means never."""
    for clock, times in _TIMES.values():
        signal.setitimer(clock, seconds * times)


def _limit_addresses(most: int | None) -> None:
    """Limit the additional address space, or remove the limit; disable core dumps."""
    import psutil

    try:
        import resource
    except ImportError:  # Windows
        return
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    soft = hard if most is None else min(psutil.Process().memory_info().vms + most, sys.maxsize)
    with contextlib.suppress(ValueError):  # macOS rejects limits below the reserved amount
        resource.setrlimit(resource.RLIMIT_AS, (soft if hard == resource.RLIM_INFINITY else min(soft, hard), hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _send(answers: IO[bytes], answer: dict[str, Any]) -> None:
    """Write an answer with descriptions of its arrays, and then the bytes of the arrays as they are in memory."""
    blocks: list[NDArray[Any]] = []

    def described(array: NDArray[Any]) -> dict[str, Any]:
        order = np.argsort([-abs(stride) for stride in array.strides], kind="stable")
        blocks.append(np.ascontiguousarray(array.transpose(order)))
        return {_ARRAY: [array.dtype.str, blocks[-1].shape, np.argsort(order).tolist()]}

    answers.write(json.dumps(answer, default=described).encode() + b"\n")
    for block in blocks:
        answers.write(block.reshape(-1).view(np.uint8).data)
    answers.flush()
