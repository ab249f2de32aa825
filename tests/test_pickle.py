"""Results go to other processes: pickle, deepcopy, multiprocessing, joblib and Dask."""

import copy
import io
import multiprocessing
import pickle
from dataclasses import fields, is_dataclass
from operator import attrgetter, methodcaller

import dask
import joblib
import numpy as np
import pytest

import voxflat
from voxflat import _core

SMALL = 60_000  # bytes of names, records and figures beside the arrays


@pytest.fixture(scope="module")
def results():
    """One result of each kind, and a call whose result depends on all of it."""
    hill, ball = voxflat.samples.hill(), voxflat.samples.ball()
    opened = voxflat.surface(ball).cut()
    flat_map = opened.flatten()
    series = voxflat.flatten_series([ball, np.roll(ball, 1, axis=0)])
    values = np.arange(4.0 * 441).reshape(441, 4)
    rim = voxflat.rim(voxflat.samples.rim())
    of_mesh = hill.flatten()
    given = voxflat.load(of_mesh.uv, surface=hill)
    group = voxflat.flatten_group([hill, (1.1 * hill.points, hill.faces)])
    stack = flat_map.images(ball.astype(float), depth=[-1, 0, 1])
    movie = series.images([ball.astype(float)] * 2, depth=[-1, 1], metric=True)
    return {
        "surface": (hill, methodcaller("flatten")),
        "voxels": (voxflat.surface(ball), methodcaller("disk", (4, 12, 12), 6.0)),
        "part": (voxflat.surface(ball).disk((4, 12, 12), 6.0), methodcaller("geodesic", 5)),
        "cut surface": (opened, methodcaller("flatten")),
        "map": (flat_map, methodcaller("image", ball.astype(float), depth=[-1, 1])),
        "map of a mesh": (of_mesh, methodcaller("regions", {"V1": [[-5, -5], [5, -5], [0, 5]]})),
        "given map": (given, methodcaller("heat_map")),
        "map of a group": (group, methodcaller("heat_map", of="spread")),
        "series": (series, methodcaller("measure", 1)),
        "stack of values": (of_mesh.images(values), attrgetter("data")),
        "stack of depths": (stack, attrgetter("data")),
        "movie": (movie, attrgetter("data")),
        "rim": (rim, methodcaller("thickness")),
        "distortion": (flat_map.distortion, attrgetter("per_point")),
        "regions of pixels": (of_mesh.regions(of_mesh.image(np.arange(441) % 3)), methodcaller("at", of_mesh.uv)),
        "regions": (of_mesh.regions({"V1": [[-5, -5], [5, -5], [0, 5]]}), methodcaller("at", of_mesh.uv)),
    }


def parts(value):
    """Yield all arrays and plain values that a result holds, in a fixed order."""
    if isinstance(value, np.ndarray):
        yield value.dtype.str, value.shape, value.tobytes()
    elif isinstance(value, _core.Surface):
        yield from parts(value.__getnewargs__())
    elif isinstance(value, dict):
        yield from parts([*value.items()])
    elif isinstance(value, tuple | list):
        for item in value:
            yield from parts(item)
    elif is_dataclass(value):
        yield type(value).__name__
        state = {entry.name: getattr(value, entry.name) for entry in fields(value)}
        if "read" in state:
            state["read"] = [state["read"](n) for n in range(len(value))]
            state.pop("check", None)
        yield from parts(state)
    else:
        yield repr(value)


def size_of_arrays(value):
    return sum(len(part[2]) for part in parts(value) if isinstance(part, tuple))


def use(name, result):
    """Call what fills the caches."""
    if isinstance(result, voxflat.FlatMap):
        result.raster(result.pixel_size / 8)
        result.look_up(result.uv[:3])
        result.points_to_map(result.points[:3])
        result.vectors_to_map(result.points[:3], result.points[:3])
        result._repr_html_()
    if isinstance(result, voxflat.FlatSeries):
        use(name, result[1])
    if isinstance(result, voxflat.Regions):
        result.at(result.of.uv)
        use(name, result.of)


def copies(result):
    yield copy.deepcopy(result)
    for protocol in (2, pickle.HIGHEST_PROTOCOL):
        yield pickle.loads(pickle.dumps(result, protocol))


@pytest.mark.slow
def test_a_copy_is_the_same_bit_by_bit_before_and_after_use(results):
    for name, (result, call) in results.items():
        expected, answer = list(parts(result)), None
        for _ in range(2):
            for other in copies(result):
                assert type(other) is type(result)
                assert list(parts(other)) == expected, name
                answer = list(parts(call(result))) if answer is None else answer
                assert list(parts(call(other))) == answer, name
                assert list(parts(pickle.loads(pickle.dumps(other)))) == expected, name
            use(name, result)


@pytest.mark.slow
def test_a_pickle_has_the_size_of_its_arrays(results):
    for name, (result, call) in results.items():
        call(result)
        use(name, result)
        assert len(pickle.dumps(result)) < 1.05 * size_of_arrays(result) + SMALL, name


class Foreign(pickle.Pickler):
    """Refuses objects of packages that draw."""

    def reducer_override(self, obj):
        module = getattr(obj if isinstance(obj, type) else type(obj), "__module__", "") or ""
        assert not module.startswith(("pyvista", "vtk", "napari", "matplotlib", "nibabel")), module
        return NotImplemented


@pytest.mark.slow
def test_a_pickle_holds_no_object_of_a_package_that_draws(results):
    pytest.importorskip("pyvista")
    for result, _ in results.values():
        if hasattr(result, "to_pyvista"):
            result.to_pyvista()
        Foreign(io.BytesIO()).dump(result)


def test_a_single_cut_edge_stays_cut():
    """Both sides of a cut of a single edge have the same two vertices: the triangles alone do not tell of it."""
    hill = voxflat.samples.hill()
    core, _ = _core.Surface.from_triangles(hill.points, hill.faces.astype(np.int64))
    points, faces, twins, ids = core.__getnewargs__()
    inner = int(np.flatnonzero(twins.ravel() < len(twins) * 3)[600])
    opened = twins.copy().ravel()
    opened[[inner, opened[inner]]] = 2**32 - 1
    cut = _core.Surface(points, faces, opened.reshape(-1, 3), ids)
    again = pickle.loads(pickle.dumps(cut))
    np.testing.assert_array_equal(again.__getnewargs__()[2], opened.reshape(-1, 3))
    twins = twins.copy()
    twins[0], twins[1] = twins[1].copy(), twins[0].copy()
    with pytest.raises(voxflat.InputError, match="not on the other side of its twin"):
        _core.Surface(points, faces, twins, ids)


@pytest.mark.slow
def test_results_go_through_the_pools_of_python_joblib_and_dask(results):
    tasks = list(results.values())
    expected = [list(parts(call(result))) for result, call in tasks]
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        found = [pool.apply(call, (result,)) for result, call in tasks]
    assert [list(parts(each)) for each in found] == expected
    with joblib.parallel_config("loky", n_jobs=2):
        found = joblib.Parallel()(joblib.delayed(call)(result) for result, call in tasks)
    assert [list(parts(each)) for each in found] == expected
    delayed = [dask.delayed(call)(dask.delayed(result)) for result, call in tasks]
    found = dask.compute(*delayed, scheduler="processes", num_workers=1)
    assert [list(parts(each)) for each in found] == expected
