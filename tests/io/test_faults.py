"""Faults: insufficient memory or disk space, signals, very long names, and files that change while they are read."""

import errno
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import contextmanager

import hard_shapes
import numpy as np
import pytest
from command_line import fail, run
from mesh_files import grid
from refusals import refused

import voxflat
from voxflat import figures, io
from voxflat.maps.raster import FlatImage
from voxflat.methods import Voxflat

resource = pytest.importorskip("resource", reason="Windows has neither limits of a process nor signals of POSIX")
pytestmark = pytest.mark.slow

MESH = grid(30, 0.1 * np.random.default_rng(0).random(900), step=1.0)


def sheet(n=60):
    i, j = np.indices((n, n))
    height = np.round(15 + 6 * np.sin(i / 19) * np.sin(j / 19)).astype(int)
    return (height[..., None] == np.arange(30)).astype(np.uint8)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def python(code, *arguments, **how):
    """Run a program in its own process."""
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, **how)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    io.write_volume("v.nii.gz", sheet(), np.eye(4))
    return tmp_path


@pytest.mark.parametrize("more", [60, 150, 250, 600])
def test_too_little_memory_is_one_line(tmp_path, more):
    """`ulimit -v` leaves this many MiB in addition to those that the package itself uses."""
    np.save(tmp_path / "v.npy", sheet(110))
    code = (
        "import psutil, resource, sys, scipy.ndimage, scipy.spatial, scipy.sparse.csgraph\n"
        "import voxflat.cli.commands.flatten\nfrom voxflat.cli import main\n"
        f"room = psutil.Process().memory_info().vms + ({more} << 20)\n"
        "resource.setrlimit(resource.RLIMIT_AS, (room, room))\n"
        "main(sys.argv[1:], prog_name='voxflat')"
    )
    command = ["flatten", "v.npy", "--sources", "600", "--threads", "4", "-o", "m.npz", "--quiet"]
    done = python(code, *command, cwd=tmp_path)
    if more == 600:  # enough, however much the threads need
        assert (done.returncode, names(tmp_path)) == (0, ["m.npz", "v.npy"]), done.stderr
        return
    assert (done.returncode, done.stderr.count("\n"), names(tmp_path)) == (1, 1, ["v.npy"]), done.stderr
    assert "memory" in done.stderr


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_signals_while_saving_leave_nothing(folder, number):
    code = (
        "import os, signal, sys\nfrom voxflat.cli import main\nimport numpy as np\n"
        "usual = np.savez_compressed\n"
        f"def save(*args, **more): usual(*args, **more); os.kill(os.getpid(), {int(number)}); usual(*args, **more)\n"
        "np.savez_compressed = save\n"
        "main(sys.argv[1:], prog_name='voxflat')"
    )
    np.save("v.npy", sheet())
    done = python(code, "flatten", "v.npy", "--label", "1", "--sources", "20", "-o", "m.npz", "--quiet")
    told = "terminated" if number == signal.SIGTERM else "cancelled"
    assert (done.stderr, done.returncode) == (f"voxflat: {told}\n", 128 + number)
    assert names(folder) == ["v.nii.gz", "v.npy"]


@pytest.mark.parametrize("letter", ["a", "ä"])
def test_names_as_long_as_the_system_takes(folder, letter):
    name = letter * ((255 - len(".npz")) // len(letter.encode())) + ".npz"
    flat_map = voxflat.surface(sheet(), label=1).flatten(Voxflat(sources=20))
    flat_map.save(name)
    assert len(voxflat.load(name)) == len(flat_map)
    store = letter * (255 // len(letter.encode()))
    voxflat.surface(sheet(), label=1).geodesic(5, store=store)
    assert voxflat.open_rows(store).shape == (5, len(flat_map))
    assert len(names(folder)) == 3


def test_of_two_results_neither_is_written_where_one_cannot_be(folder):
    surface = ("surface", "v.nii.gz", "--label", 1, "--repair")
    fail(1, "bad.ending: unknown", *surface, "voxels", "--repaired", "out.nii", "-o", "bad.ending")
    fail(1, "out.bad: unknown", *surface, "voxels", "--repaired", "out.bad", "-o", "s.vtp")
    fail(1, "--repair none does not change any voxels", *surface, "none", "--repaired", "out.nii", "-o", "s.vtp")
    assert names(folder) == ["v.nii.gz"]


def test_rows_that_are_cut_short_while_they_are_open(tmp_path):
    """The system would end the process with SIGBUS."""
    code = (
        "import os, sys, numpy as np, voxflat\n"
        "rows = voxflat.open_rows('store')\n"
        "os.truncate('store/rows.npy', 4096)\n"
        "for read in (lambda: rows[-1], lambda: np.asarray(rows), rows.verify, lambda: rows.rows[3:, 5]):\n"
        "    try: read()\n"
        "    except voxflat.InputError as error: print(error)\n"
    )
    voxflat.surface(sheet(), label=1).geodesic(20, store=tmp_path / "store")
    done = python(code, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert [line.count("rows.npy was truncated to 4096 of") for line in done.stdout.splitlines()] == [1, 1, 1, 1]


def test_memory_is_compared_before_the_surface_of_a_mesh_is_made():
    points, faces = hard_shapes.sheet(lambda u, v: (u, v, 0 * u), (50, 50), (51, 51))
    told = re.compile(r"1\.\d+ MiB of memory is needed, but the limit is 1 MiB")
    refused(told, voxflat.surface, (points, faces), memory_limit=1 << 20)
    found = voxflat.check((points, faces), memory_limit=1 << 20)
    assert not found.can_flatten
    assert told.search(found.advice[-1])
    assert voxflat.check((points, faces), memory_limit=1 << 26).can_flatten


FORKS = """
import os, sys, threading, time
import hard_shapes, numpy as np, voxflat
import numpy.ma
big, small = (hard_shapes.sheet(lambda u, v: (u, v, np.sin(u)), (9, 9), (n, n)) for n in (40, 6))
# import everything first: a child would wait forever for a module that another thread was importing at the fork
voxflat.flatten(small, voxflat.methods.Voxflat(sources=9), threads=2)
voxflat.surface(big).geodesic(9, threads=2)
over, forking = threading.Event(), threading.Event()
def work():
    while not over.is_set():
        forking.wait()
        voxflat.surface(big).geodesic(9, threads=2)
thread = threading.Thread(target=work)
thread.start()
for n in range(12):
    forking.set()
    time.sleep(0.01 * n)
    child = os.fork()
    if not child:
        made = voxflat.flatten(small, voxflat.methods.Voxflat(sources=9), threads=2)
        os._exit(0 if np.isfinite(made.uv).all() else 3)
    forking.clear()
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
over.set()
forking.set()
thread.join()
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork")
def test_a_fork_while_another_thread_links_does_not_hang():
    paths = os.pathsep.join(sys.path)
    done = python(FORKS, timeout=120, env={**os.environ, "PYTHONPATH": paths, "PYTHONWARNINGS": "ignore"})
    assert (done.returncode, done.stdout.split()) == (0, ["0"] * 12)


def test_ctrl_c_while_the_program_ends_is_no_traceback():
    """The work is already done, and the results are written."""
    code = (
        "import atexit, os, signal, sys\nfrom voxflat.cli import main\n"
        "atexit.register(lambda: os.kill(os.getpid(), signal.SIGINT))\n"
        "main(['--version'], prog_name='voxflat')"
    )
    done = python(code)
    assert (done.returncode, done.stderr) == (0, "")
    code = "import signal, voxflat; assert signal.getsignal(signal.SIGINT) is signal.default_int_handler"
    assert python(code).returncode == 0  # scripts keep their own handler


def test_a_reader_is_not_waited_for_after_ctrl_c(folder):
    """A reader may be busy for a long time; here it sleeps and does not receive Ctrl-C."""
    code = (
        "import os, signal, sys, threading, time\n"
        "from voxflat.io import subprocess_reader\n"
        "subprocess_reader._PACKAGES['time'] = ('sleep', 'time', 'sleep')\n"
        "subprocess_reader._START = 'import sys, time; print(end=\"\"); time.sleep(60)'\n"
        "threading.Timer(1, lambda: os.kill(os.getpid(), signal.SIGINT)).start()\n"
        "try: subprocess_reader.read_in_subprocess(time.sleep, 'time', __import__('pathlib').Path('v.nii.gz'))\n"
        "except KeyboardInterrupt: print(subprocess_reader._child)\n"
    )
    start = time.monotonic()
    done = python(code, timeout=50)
    assert (done.stdout, done.stderr, done.returncode) == ("None\n", "", 0)
    assert time.monotonic() - start < 40


@contextmanager
def no_room():
    """Limit files to 4,000 bytes, and do not write bytecode, because Python would leave incomplete files."""
    usual, keeps = resource.getrlimit(resource.RLIMIT_FSIZE), sys.dont_write_bytecode
    sys.dont_write_bytecode = True
    resource.setrlimit(resource.RLIMIT_FSIZE, (4000, usual[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, usual)
        sys.dont_write_bytecode = keeps


def writers():
    """Return a function that writes each kind of file, keyed by the name of the file."""
    random = np.random.default_rng(0)
    noise = random.integers(0, 255, (200, 200, 3)).astype(np.uint8)
    flat_map = voxflat.flatten(MESH, Voxflat(sources=30))
    image, textured = FlatImage(random.normal(size=(200, 200)), 0.5, (0.0, 0.0), "noise"), flat_map.textured(noise)
    volume = random.normal(size=(40, 40, 40)).astype(np.float32)
    write = {f"map.{ending}": flat_map.save for ending in ("npz", "surf.gii", "patch.flat", "vtp", "ply", "obj")}
    write |= {f"image.{ending}": image.save for ending in ("png", "tif", "nii", "nii.gz", "npy")}
    write |= {f"textured.{ending}": textured.save for ending in ("obj", "vtp", "glb", "ply")}
    write["atlas.npz"] = voxflat.surface(MESH).patches(5).save
    write["lh.white"] = lambda path: io.write_mesh(path, MESH)
    for ending in ("nii", "nrrd", "mha", "mgh", "mgz", "npy", "npz"):
        write[f"volume.{ending}"] = lambda path: io.write_volume(path, volume, np.eye(4))
    for ending in ("png", "pdf", "svg"):
        write[f"figure.{ending}"] = lambda path: figures.save(figures.scatter(flat_map), path)
    write["picture.png"] = lambda path: figures.save_picture(noise, path)
    return write


def test_every_writer_names_the_file_and_keeps_the_old_one(tmp_path):
    write = writers()
    for name in write:
        (tmp_path / name).write_text("old")
    told = []
    for name, save in write.items():
        with no_room(), pytest.raises(OSError, match="File too large") as caught:
            save(tmp_path / name)
        told.append((name, type(caught.value), caught.value.errno, caught.value.filename))
    assert len(told) > 25
    assert told == [(name, OSError, errno.EFBIG, str(tmp_path / name)) for name in write]
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {name: "old" for name in write}


def test_the_command_line_ends_with_one_line(tmp_path):
    io.write_mesh(tmp_path / "sheet.ply", MESH)
    with no_room():
        done = run("patches", tmp_path / "sheet.ply", "-o", tmp_path / "atlas.npz", "--quiet")
    assert (done.exit_code, done.stderr) == (1, f"voxflat: error: {tmp_path / 'atlas.npz'}: File too large\n")
    assert [path.name for path in tmp_path.iterdir()] == ["sheet.ply"]
