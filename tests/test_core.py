"""The compiled core lets other threads run during long computations."""

import sys
import threading
import time

import numpy as np
import pytest
import shapes
from triangle_meshes import square

import voxflat
from voxflat import _core

IDENTITY = np.eye(4).tolist()


@pytest.fixture(scope="module")
def surface():
    return _core.Surface.from_triangles(*square(60))[0]


@pytest.fixture(scope="module")
def voxels():
    return _core.VoxelSurface.from_mask(shapes.sheet((200, 200)) > 0, IDENTITY, "chain-code")


SURFACE = {
    "normals": lambda s: s.normals,
    "part": lambda s: s.part(np.ones(len(s), dtype=bool)),
    "part_of_faces": lambda s: s.part_of_faces(np.ones(len(s.faces), dtype=bool)),
    "largest_piece": lambda s: s.largest_piece(),
    "moved": lambda s: s.moved(s.points),
    "cut": lambda s: s.cut([[30, 31, 32, 33]]),
    "topology": lambda s: s.topology(),
    "choose_sources": lambda s: s.choose_sources("curvature", 5, 0),
    "fill_holes": lambda s: s.fill_holes(1.0),
    "rows": lambda s: s.rows(np.arange(3, dtype=np.uint32)),
    "error_of_distances": lambda s: s.error_of_distances(0),
    "reference_sources": lambda s: _core.reference_sources(len(s), 500, 0),
    "vertex_normals": lambda s: _core.vertex_normals(s.points, s.faces),
    "solve": lambda s: _core.solve(np.eye(9), np.ones(9)),
    "finder": lambda s: _core.TriangleFinder(s.points[:, :2][s.faces]).find(s.points[:9, :2]),
}
VOXELS = {
    "csr": lambda v: v.csr,
    "component_sizes": lambda v: v.component_sizes(),
    "find": lambda v: v.find(v.voxels.astype(np.int64)),
    "nearest": lambda v: v.nearest([3, 3, 3]),
    "topology": lambda v: v.topology(),
    "rows": lambda v: v.rows(np.arange(3, dtype=np.uint32)),
}


def lets_others_run(call, seconds=60):
    """Tell whether another thread runs during repeated calls, although threads never switch by themselves."""
    gate, has_run = threading.Event(), threading.Event()

    def other():
        gate.wait()
        has_run.set()

    interval = sys.getswitchinterval()
    thread = threading.Thread(target=other)
    thread.start()
    sys.setswitchinterval(1000.0)  # seconds: a thread keeps the interpreter until it releases it
    try:
        gate.set()
        end = time.monotonic() + seconds
        while not has_run.is_set() and time.monotonic() < end:
            assert call() is not None
        return has_run.is_set()
    finally:
        sys.setswitchinterval(interval)
        thread.join()


def test_what_keeps_the_interpreter_is_found_out():
    assert not lets_others_run(lambda: sorted(range(100)), seconds=0.2)


@pytest.mark.parametrize(("made", "name"), [("surface", name) for name in SURFACE] + [("voxels", n) for n in VOXELS])
def test_long_work_lets_other_threads_run(request, made, name):
    call, of = (SURFACE if made == "surface" else VOXELS)[name], request.getfixturevalue(made)
    assert lets_others_run(lambda: call(of))


@pytest.mark.medium
@pytest.mark.parametrize("name", ["topology", "largest_piece", "fill_holes"])
def test_work_is_cancelled_before_its_first_stage(name):
    large, _ = _core.Surface.from_triangles(*square(700))
    call = {
        "topology": large.topology,
        "largest_piece": large.largest_piece,
        "fill_holes": lambda progress: large.fill_holes(1.0, progress),
    }[name]
    stages = []

    def progress(stage, done, total):
        stages.append(stage)
        return False

    with pytest.raises(voxflat.Cancelled):
        call(progress)
    assert stages == ["preparing"]
