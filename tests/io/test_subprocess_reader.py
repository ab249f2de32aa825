"""Readers written in C++ crash in their own process: the caller gets a one-line error, and reads the next file."""

import ctypes
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import psutil
import pytest
from refusals import refused

from voxflat.errors import InputError
from voxflat.io import subprocess_reader as module
from voxflat.io.meshes import Mesh, read_mesh, write_mesh
from voxflat.io.reading import reading
from voxflat.io.subprocess_reader import read_in_subprocess
from voxflat.io.volumes import read_volume

pytest.importorskip("vtkmodules")  # the package that is imported fastest


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "v.vtk"
    path.write_bytes(bytes(1770))
    return path


def size(path):
    """Return the size of a file, as the child reports it."""
    return read_in_subprocess(os.path.getsize, "vtkmodules", path)


# functions for the child, which finds this file through sys.path
def ends(path, how):
    os.kill(os.getpid(), how)


def computes(path):
    while True:
        pass


def holds(path, told):
    """Stay in C, with Python's lock held, as VTK does while it reads."""
    Path(told).write_text(str(os.getpid()))
    ctypes.PyDLL(None).sleep(60)


def takes(path, size):
    return np.ones(size, np.uint8)


def prints(path):
    os.write(1, b"out")
    os.write(2, b"err")
    return [None, 1.5, "é", {"a": np.arange(6).reshape(2, 3).T, "b": np.zeros((0, 3))}, np.True_.item()]


def fails(path, kind):
    raise {"Unicode": UnicodeDecodeError("ascii", b"\xff", 0, 1, "no"), "OS": FileNotFoundError(2, "gone", "x")}[kind]


@pytest.fixture(autouse=True)
def found_by_the_child(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    for function in (ends, computes, holds, takes, prints, fails):
        monkeypatch.setattr(function, "__module__", Path(__file__).stem)
    module._stop()  # the present child has another sys.path
    yield
    module._stop()


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_whatever_ends_the_child_is_one_line(path, monkeypatch):
    for number, name in [(signal.SIGSEGV, "SIGSEGV"), (signal.SIGABRT, "SIGABRT"), (signal.SIGKILL, "SIGKILL")]:
        with pytest.raises(InputError, match=rf"^VTK ended while .* \({name}, memory limit .*\). Copy or .*, or allow"):
            read_in_subprocess(ends, "vtkmodules", path, int(number))
    monkeypatch.setattr(module, "_SECONDS", 1)
    refused("VTK did not finish reading the file within 1 s", read_in_subprocess, computes, "vtkmodules", path)
    assert size(path) == 1770


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(psutil, "RLIMIT_AS"), reason="this system limits no memory of a process")
def test_it_takes_no_more_than_the_limit(path):
    limit = 1 << 28
    with reading(limit):
        refused("needs more memory|are needed, 256 MiB", read_in_subprocess, takes, "vtkmodules", path, 3 * limit)
    with reading(limit):
        assert len(read_in_subprocess(takes, "vtkmodules", path, limit // 2, size=limit)) == limit // 2
    with pytest.raises(InputError, match="needs more memory"):  # more than a file of 1 KB can contain
        read_in_subprocess(takes, "vtkmodules", path, 1 << 31)


@pytest.mark.slow
def test_a_package_is_imported_after_the_files_of_another(tmp_path):
    itk = pytest.importorskip("itk")
    itk.imwrite(itk.image_from_array(np.ones((4, 5, 6), np.uint8)), str(tmp_path / "v.nrrd"))
    write_mesh(tmp_path / "m.vtp", Mesh(np.eye(3), np.array([[0, 1, 2]])))
    assert len(read_mesh(tmp_path / "m.vtp").points) == 3  # within the limit of that file
    assert read_volume(tmp_path / "v.nrrd").data.shape == (6, 5, 4)


@pytest.mark.medium
def test_values_come_back_and_prints_do_not(path, capfd):
    none, number, text, named, true = read_in_subprocess(prints, "vtkmodules", path)
    assert (none, number, text, true) == (None, 1.5, "é", True)
    np.testing.assert_array_equal(named["a"], np.arange(6).reshape(2, 3).T)
    assert named["b"].shape == (0, 3)
    assert capfd.readouterr() == ("", "")
    with pytest.raises(RuntimeError, match="can't decode byte"):
        read_in_subprocess(fails, "vtkmodules", path, "Unicode")
    with pytest.raises(FileNotFoundError, match="gone: 'x'"):
        read_in_subprocess(fails, "vtkmodules", path, "OS")


@pytest.mark.medium
def test_threads_and_forks_share_no_answer(path):
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(size, [path] * 4)) == [1770] * 4
    if not hasattr(os, "fork"):
        return
    process = os.fork()
    if process == 0:
        os._exit(0 if size(path) == 1770 else 1)
    assert os.waitpid(process, 0)[1] == 0
    assert size(path) == 1770


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM, getattr(signal, "SIGKILL", 9), None])
def test_nothing_is_left_of_it(path, ending, tmp_path):
    """The child ends when the caller ends or is killed. It ignores modules in the working directory."""
    (tmp_path / "numpy.py").write_text("raise SystemExit('taken')")
    code = "import os, pathlib; from voxflat.io import subprocess_reader; "
    code += f"subprocess_reader.read_in_subprocess(os.path.getsize, 'vtkmodules', pathlib.Path({str(path)!r})); "
    code += "print(subprocess_reader._child.pid, flush=True); input()"
    is_safe = sys.version_info >= (3, 11)  # and knows -P
    command, pipe = [sys.executable, "-P" if is_safe else "-s", "-c", code], subprocess.PIPE
    caller = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, cwd=tmp_path if is_safe else None)
    child = psutil.Process(int(caller.stdout.readline()))  # alive while the caller waits
    if ending:
        caller.send_signal(ending)
    caller.communicate(b"\n")  # without a signal, the caller continues to its end
    assert ending or caller.returncode == 0
    child.wait(20)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere, it ends when C code returns")
def test_a_busy_child_ends_when_the_caller_is_killed(path, tmp_path):
    folder, told = Path(__file__).parent, tmp_path / "told"
    code = f"import sys, pathlib; sys.path.append({str(folder)!r}); import test_subprocess_reader as test; "
    code += f"test.read_in_subprocess(test.holds, 'vtkmodules', pathlib.Path({str(path)!r}), {str(told)!r})"
    helpers = os.pathsep.join(one for one in sys.path if one)
    caller = subprocess.Popen([sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": helpers})
    while not (told.exists() and told.read_text()):
        assert caller.poll() is None
    child = psutil.Process(int(told.read_text()))
    assert child.is_running()
    caller.kill()
    caller.wait()
    child.wait(20)


def test_a_child_outlives_the_thread_that_started_it(path):
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(size, path).result() == 1770
    child = module._child
    assert size(path) == 1770
    assert module._child is child


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_a_call_that_is_broken_off_ends_the_child(path):
    """A late answer of the child is not mistaken for the answer to the next request."""
    size(path)
    threading.Timer(0.3, lambda: signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)).start()
    start = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        read_in_subprocess(computes, "vtkmodules", path)
    assert time.monotonic() - start < 5
    assert size(path) == 1770
