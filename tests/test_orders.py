"""Calls of the Python API in any order with any options return a valid result or raise a one-line error.

``VOXFLAT_CASES=2000 pytest tests/test_orders.py`` tests 2,000 random orders.
"""

import os
import shutil
import tempfile
from pathlib import Path

import composed
import hard_shapes
import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import Bundle, RuleBasedStateMachine, initialize, multiple, rule

import voxflat

pytestmark = pytest.mark.slow

CASES = int(os.environ.get("VOXFLAT_CASES", "0"))

SIDE = 7
METHODS = ("voxflat", "grossmann2002", "zigelman2002", "schwartz1989", "saucan2006")
SIZES = st.sampled_from([1.0, 1.0, 1.0, 0.001, 30.0, 1e-8, 1e7, 1e-30, 1e19])
MAYBE = st.sampled_from([None, True, False])
CHOICES = {
    "method": st.sampled_from(METHODS),
    "sources": st.one_of(st.none(), st.integers(-1, 30), st.lists(st.integers(-1, 60), max_size=5)),
    "sampling": st.sampled_from([None, "farthest", "random", "decimation"]),
    "seed": st.integers(0, 3),
    "relax": MAYBE,
    "mirror": st.booleans(),
    "weighting": st.sampled_from([None, 0.0, 1.0, 2.0]),
    "scale": st.sampled_from([None, "distances", "areas", "none"]),
    "geodesic": st.sampled_from([None, "graph", "exact", "fast-marching"]),
    "rows": st.booleans(),
    "bound": st.sampled_from([None, 1.2, 3.0, 0.5]),
    "radius": st.sampled_from([None, 2.5, -1.0]),
    "seed_point": st.one_of(st.none(), st.integers(-1, 60), st.tuples(*[st.integers(0, SIDE)] * 3)),
    "threads": st.sampled_from([None, 1, 3]),
    "memory_limit": st.sampled_from([None, None, 10**9, 1000]),
}


def bumps():
    return hard_shapes.sheet(lambda u, v: (u, v, np.sin(2 * u) * np.cos(v)), (SIDE - 1, SIDE - 1), (SIDE, SIDE))


def options(*names):
    """Choose some of these options."""
    return st.fixed_dictionaries({}, optional={name: CHOICES[name] for name in names})


def outcome(call, *args, **given):
    """Return the result of a call, or None if it is refused with a one-line error or a system error with a path."""
    given = {name: value for name, value in given.items() if value is not None}
    refused = None
    try:
        return call(*args, **given)
    except (voxflat.VoxflatError, OSError) as error:
        refused = error
    if isinstance(refused, OSError):
        assert None not in (refused.errno, refused.filename), refused
    else:
        assert str(refused).strip(), call
        assert "\n" not in str(refused), refused
    return None


def with_results(*results):
    """Return the results that exist, for a bundle."""
    return multiple(*(result for result in results if result is not None))


class Orders(RuleBasedStateMachine):
    surfaces = Bundle("surfaces")
    maps = Bundle("maps")

    @initialize(target=surfaces)
    def begin(self):
        self.folder = Path(tempfile.mkdtemp())
        return multiple(voxflat.surface(np.ones((SIDE, SIDE, 1), np.uint8)), voxflat.surface(bumps()))

    def teardown(self):
        shutil.rmtree(self.folder, ignore_errors=True)

    @rule(target=surfaces, bits=st.integers(0, 2**27 - 1), size=SIZES, repair=st.sampled_from([None, "voxels", "cuts"]))
    def of_voxels(self, bits, size, repair):
        block = np.array([bits >> n & 1 for n in range(27)], np.uint8).reshape(3, 3, 3)
        volume = np.kron(block, np.ones((2, 2, 2), np.uint8))
        return with_results(outcome(voxflat.surface, volume, spacing=(size,) * 3, repair=repair))

    @rule(
        target=surfaces,
        size=SIZES,
        gone=st.lists(st.integers(0, 60), max_size=5),
        moved=st.dictionaries(st.integers(0, 48), st.tuples(*[st.floats(-3, 9)] * 3), max_size=3),
        repair=st.sampled_from([None, "none", "cuts"]),
    )
    def of_triangles(self, size, gone, moved, repair):
        points, faces = bumps()
        for vertex, place in moved.items():
            points[vertex] = place
        return with_results(outcome(voxflat.surface, (size * points, np.delete(faces, gone, axis=0)), repair=repair))

    @rule(target=maps, surface=surfaces, given=options(*CHOICES))
    def flatten(self, surface, given):
        flat = outcome(composed.flatten, surface, **given)
        if flat is not None:
            assert np.isfinite(flat.uv).all()
            assert len(flat.uv) == len(flat.points) == len(flat.ids) == len(flat)
            assert flat.faces.min() >= 0
            assert flat.faces.max() < len(flat)
        return with_results(flat)

    @rule(target=maps, flat=maps, name=st.sampled_from(["m.npz", "m.voxflat", "m.txt", "no/m.npz"]))
    def save_and_load(self, flat, name):
        outcome(flat.save, self.folder / name)
        again = outcome(voxflat.load, self.folder / name)
        if again is not None:
            np.testing.assert_array_equal(again.uv, flat.uv)
            np.testing.assert_array_equal(again.faces, flat.faces)
            assert again.distortion.figures() == flat.distortion.figures()
        return with_results(again)

    @rule(surface=surfaces, given=options("sources", "sampling", "seed", "geodesic", "threads", "memory_limit"))
    def geodesic(self, surface, given):
        rows = outcome(composed.geodesic, surface, given.pop("sources", None) or 3, **given)
        if rows is not None:
            assert (np.asarray(rows) >= 0).all()
            assert (rows[np.arange(len(rows)), rows.sources] == 0).all()

    @rule(surface=surfaces, given=options("sources", "sampling", "seed", "geodesic"), name=st.sampled_from("ab"))
    def store(self, surface, given, name):
        outcome(composed.geodesic, surface, given.pop("sources", None) or 3, **given, store=self.folder / name)
        rows = outcome(voxflat.open_rows, self.folder / name)
        if rows is not None:
            rows.verify()

    @rule(surface=surfaces, ends=st.tuples(st.integers(-1, 60), st.integers(-1, 60)))
    def path(self, surface, ends):
        outcome(composed.path, surface, *ends)

    @rule(surface=surfaces, given=options("threads", "memory_limit", "seed_point", "radius"))
    def check(self, surface, given):
        found = outcome(composed.check, surface, **given)
        assert found is None or found.table()

    @rule(target=surfaces, surface=surfaces, relax=MAYBE)
    def cut(self, surface, relax):
        done = outcome(composed.cut, surface, relax=relax)
        return with_results(None if done is None else done.surface)

    @rule(surface=surfaces, bound=st.sampled_from([1.05, 1.5, 0.9]), glue=st.booleans())
    def patches(self, surface, bound, glue):
        atlas = outcome(composed.patches, surface, bound=bound)
        if atlas is not None and glue:
            outcome(atlas.glue, 2 * bound)

    @rule(flat=maps, size=st.sampled_from([None, 0.5, 1e-9, -1.0]), depth=st.sampled_from([None, 0.0, 1.0, [0.0, 1.0]]))
    def image(self, flat, size, depth):
        heat = outcome(flat.heat_map, size)
        assert heat is None or heat.data.ndim == 2
        outcome(flat.image, np.ones((SIDE, SIDE, 1)), pixel_size=size, depth=depth)

    @rule(flat=maps, corners=st.lists(st.tuples(st.floats(-5, 5), st.floats(-5, 5)), max_size=5))
    def regions(self, flat, corners):
        outcome(flat.regions, {"a": np.array(corners, dtype=float).reshape(-1, 2)})

    @rule(flat=maps, shape=st.sampled_from([(4, 4), (4, 4, 3), (0, 4), (4,)]))
    def texture(self, flat, shape):
        outcome(flat.texture, np.zeros(shape, np.uint8))
        outcome(lambda: flat.textured(np.zeros(shape, np.uint8)).save(self.folder / "t.obj"))

    @rule(flat=maps)
    def worst(self, flat):
        outcome(voxflat.worst_places, flat)


LOOSE = {"deadline": None, "database": None, "suppress_health_check": list(HealthCheck)}
STEPS = 20 if CASES else 8
Orders.TestCase.settings = settings(max_examples=CASES or 8, stateful_step_count=STEPS, derandomize=CASES == 0, **LOOSE)
TestOrders = Orders.TestCase
