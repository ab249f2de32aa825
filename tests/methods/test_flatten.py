import os
import signal
import threading
import time
from functools import partial
from types import SimpleNamespace

import composed
import numpy as np
import pytest
import shapes
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import RBFInterpolator
from scipy.linalg import eigh
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial.transform import Rotation

import voxflat
from voxflat import _core

grossmann2002 = partial(composed.flatten, method="grossmann2002")


@pytest.fixture(scope="module")
def bent():
    return shapes.curled_sheet(30, 20, 0.4, Rotation.random(rng=3))


@pytest.fixture(scope="module")
def bent_map(bent):
    return grossmann2002(bent, sources=150, rows=True)


def head_map():
    """Return the map of the paper's head, made in a thread; what progress said, and how long Python stood still."""
    made, reports = [], []
    options = {"progress": lambda *report: reports.append(report)}
    volume = shapes.depth_surface(shapes.head_depth())
    worker = threading.Thread(target=lambda: made.append(grossmann2002(volume, **options)))
    worker.start()
    longest, last = 0.0, time.perf_counter()
    while worker.is_alive():
        time.sleep(0.001)
        now = time.perf_counter()
        longest, last = max(longest, now - last), now
    return SimpleNamespace(flat_map=made[0], reports=reports, longest_gap=longest)


@pytest.fixture(scope="module")
def head():
    return head_map()


def core_surface(volume, spacing=(1.0, 1.0, 1.0), link_lengths="chain-code"):
    return _core.VoxelSurface.from_mask(volume.astype(bool), np.diag([*spacing, 1.0]).tolist(), link_lengths)


def all_distances(surface):
    starts, neighbours, lengths = surface.csr
    shape = (len(surface),) * 2
    return dijkstra(csr_matrix((lengths.astype(float), neighbours.astype(int), starts.astype(int)), shape=shape))


class TestStages:
    """Every stage of `grossmann2002` against an independent computation."""

    def test_points_are_the_affines_image_of_the_voxels(self, bent):
        affine = np.array([[0, -2, 0, 5], [1.5, 0, 0, -7], [0, 0, 3, 1], [0, 0, 0, 1]], dtype=float)
        flat = grossmann2002(bent, affine=affine, sources=50)
        np.testing.assert_allclose(flat.points, flat.ids @ affine[:3, :3].T + affine[:3, 3])
        assert bent[tuple(flat.ids.T)].all()

    def test_rows_are_shortest_paths(self, bent):
        rows = voxflat.surface(bent, spacing=(1, 1.5, 0.8)).geodesic(20, geodesic="chain")
        expected = all_distances(core_surface(bent, (1, 1.5, 0.8)))[rows.sources]
        np.testing.assert_allclose(rows, expected, rtol=1e-5)
        assert rows.shape == (20, len(rows.ids)) == np.asarray(rows).shape
        assert np.asarray(rows).dtype == np.float32

    def test_source_places_are_classical_scaling(self, bent_map):
        delta = bent_map.rows[:, bent_map.sources].astype(float)
        delta = (delta + delta.T) / 2
        m = len(delta)
        centring = np.eye(m) - 1 / m
        values, vectors = eigh(-0.5 * centring @ delta**2 @ centring)
        places = vectors[:, -2:] * np.sqrt(values[-2:])
        expected = np.linalg.norm(places[:, None] - places[None], axis=2)
        found = bent_map.uv[bent_map.sources]
        np.testing.assert_allclose(np.linalg.norm(found[:, None] - found[None], axis=2), expected, atol=1e-5)
        np.testing.assert_allclose(np.sort(np.abs(values))[::-1][:12], np.abs(bent_map.eigenvalues), rtol=1e-6)
        share = (values[-2:] ** 2).sum() / (values**2).sum()
        assert bent_map.metadata["planarity"] == pytest.approx(share)

    def test_the_rest_is_placed_by_radial_functions(self, bent_map):
        known = bent_map.sources
        oracle = RBFInterpolator(bent_map.points[known], bent_map.uv[known], kernel="linear", degree=1)
        np.testing.assert_allclose(bent_map.uv, oracle(bent_map.points), atol=1e-6)

    def test_distortion_follows_its_definition(self, bent):
        flat = grossmann2002(bent, sources=100)
        distances = all_distances(core_surface(bent))
        apart = np.linalg.norm(flat.uv[:, None] - flat.uv[None], axis=2)
        pairs = ~np.eye(len(flat), dtype=bool)
        relative = (np.abs(apart - distances)[pairs] / distances[pairs]).mean()
        # 200 reference sources of many: the sample's mean is near the mean over all pairs
        assert flat.distortion.raw.relative_error == pytest.approx(relative, rel=0.05)
        assert flat.distortion.mean_geodesic == pytest.approx(distances[pairs].mean(), rel=0.03)
        assert flat.distortion.pairs == 200 * (len(flat) - 1)

    def test_a_path_is_as_long_as_its_distance(self, bent):
        rows = voxflat.surface(bent, spacing=(1, 2, 0.5)).geodesic(1, geodesic="chain")
        start, end = rows.ids[rows.sources[0]], rows.ids[rows[0].argmax()]
        path = voxflat.surface(bent, spacing=(1, 2, 0.5)).path(start, end, geodesic="chain")
        assert path.length == pytest.approx(rows[0].max())
        np.testing.assert_array_equal(path.ids[[0, -1]], [start, end])
        assert np.abs(np.diff(path.ids, axis=0)).max() == 1
        assert bent[tuple(path.ids.T)].all()

    def test_no_path_between_components(self):
        volume = np.zeros((9, 9, 3), dtype=np.uint8)
        volume[:3, :, 1] = volume[6:, :, 1] = 1
        with pytest.raises(voxflat.InputError, match=r"from \[0, 0, 1\] to \[8, 8, 1\]: they lie in different"):
            voxflat.surface(volume).path((0, 0, 1), (8, 8, 1), geodesic="chain")

    @pytest.mark.slow
    @settings(max_examples=30)
    @given(st.tuples(*[st.floats(0.3, 3.0)] * 3), st.integers(0, 2**32))
    def test_link_lengths_are_unbiased_for_any_spacing(self, spacing, seed):
        weights = np.array(_core.chain_weights(list(spacing), "chain-code"))
        rng = np.random.default_rng(seed)
        u = rng.normal(size=(4000, 3))
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        links = 20
        steps = (np.abs(u) / spacing).max(axis=1, keepdims=True)
        along = np.arange(links + 1)[:, None] * (u / spacing / steps)[:, None]
        at = np.round(rng.uniform(-0.5, 0.5, size=(len(u), 1, 3)) + along).astype(int)
        kinds = np.abs(np.diff(at, axis=1)) @ [1, 2, 4]
        errors = weights[kinds].sum(axis=1) / (links / steps[:, 0]) - 1
        assert abs(np.mean(errors)) < 0.001 + 5 * np.std(errors) / np.sqrt(len(errors))


class TestPaper:
    """The figures of Grossmann, Kiryati, Kimmel (2002); `make paper-grossmann` prints them all."""

    @pytest.mark.slow
    def test_curled_sheet_at_random_orientations(self):
        figures = []
        for seed in range(4):
            sheet = shapes.curled_sheet(rotation=Rotation.random(rng=seed))
            distortion = grossmann2002(
                sheet, sources=len(voxflat.surface(sheet).geodesic(1, geodesic="chain").ids)
            ).distortion
            assert distortion.mean_geodesic == pytest.approx(35, abs=3)
            figures.append((distortion.raw.absolute_error, distortion.raw.relative_error))
        absolute, relative = np.mean(figures, axis=0)
        assert absolute <= 0.43
        assert relative <= 0.021

    @pytest.mark.slow
    def test_head(self, head):
        distortion = head.flat_map.distortion
        assert distortion.mean_geodesic == pytest.approx(141.9, abs=2)
        assert distortion.raw.absolute_error < 9.04
        assert distortion.raw.relative_error < 0.0766


class TestInputs:
    """Any type and any strides of the same volume give the same map."""

    @pytest.mark.parametrize(
        "dtype", ["bool", "uint8", "int8", "int16", "uint16", "int64", "uint64", ">i4", "f2", "f4", "f8"]
    )
    def test_types(self, bent, bent_map, dtype):
        flat = grossmann2002(bent.astype(dtype), sources=150)
        np.testing.assert_array_equal(flat.uv, bent_map.uv)
        assert flat.metadata["input_sha256"] == bent_map.metadata["input_sha256"]

    def test_strides(self, bent, bent_map):
        wide = np.zeros([2 * n for n in bent.shape], dtype=np.int16)
        wide[::2, ::2, ::2] = bent
        backward = np.ascontiguousarray(bent[::-1, :, ::-1])[::-1, :, ::-1]
        swapped = np.ascontiguousarray(bent.transpose(2, 0, 1)).transpose(1, 2, 0)
        for view in (np.asfortranarray(bent), wide[::2, ::2, ::2], backward, swapped):
            np.testing.assert_array_equal(grossmann2002(view, sources=150).uv, bent_map.uv)

    def test_labels_and_thresholds(self, bent, bent_map):
        labels = np.where(bent, 7, 0).astype(np.uint8)
        labels[0, 0, 0] = 3
        np.testing.assert_array_equal(grossmann2002(labels, label=7, sources=150).uv, bent_map.uv)
        intensities = np.where(bent, 0.9, 0.5).astype(np.float32)
        np.testing.assert_array_equal(grossmann2002(intensities, threshold=0.5, sources=150).uv, bent_map.uv)

    @pytest.mark.parametrize("label", [3.5, "1", np.nan])
    def test_a_label_is_a_whole_number(self, bent, label):
        with pytest.raises(voxflat.InputError, match=r"the label is .*; give a whole number"):
            grossmann2002(bent, label=label)

    def test_a_limit_is_a_number(self, bent):
        with pytest.raises(voxflat.InputError, match="the memory limit is '4G'; give a number"):
            grossmann2002(bent, memory_limit="4G")

    def test_the_input_is_left_alone(self, bent):
        frozen = bent.copy()
        frozen.setflags(write=False)
        grossmann2002(frozen, sources=20)
        np.testing.assert_array_equal(frozen, bent)

    def test_a_mask_keeps_its_part(self, bent):
        keep = np.zeros(bent.shape, dtype=np.uint8)
        keep[:, : bent.shape[1] // 2] = 2
        flat = grossmann2002(bent, keep=keep, sources=50)
        np.testing.assert_array_equal(np.unique(keep[tuple(flat.ids.T)]), [2])
        assert len(flat) == (bent & (keep > 0)).sum()

    def test_given_sources_keep_their_order(self, bent, bent_map):
        voxels = bent_map.ids[bent_map.sources[:20]]
        flat = grossmann2002(bent, sources=voxels)
        np.testing.assert_array_equal(flat.ids[flat.sources], voxels)
        assert flat.metadata["sampling"] == "given"


class TestReproducible:
    def test_bits_do_not_depend_on_threads(self, bent, bent_map):
        for threads in (1, 2, 3):
            flat = grossmann2002(bent, sources=150, threads=threads)
            np.testing.assert_array_equal(flat.uv, bent_map.uv)
            np.testing.assert_array_equal(flat.distortion.per_point, bent_map.distortion.per_point)
            assert flat.distortion.raw == bent_map.distortion.raw

    def test_another_seed_gives_another_choice(self, bent, bent_map):
        for sampling in ("farthest", "random"):
            one, same, other = (grossmann2002(bent, sources=50, sampling=sampling, seed=s) for s in (1, 1, 2))
            np.testing.assert_array_equal(one.sources, same.sources)
            assert set(one.sources) != set(other.sources)

    def test_moving_the_volume_moves_only_the_points(self, bent, bent_map):
        padded = np.pad(bent, [(3, 0), (0, 5), (2, 2)])
        flat = grossmann2002(padded, sources=bent_map.ids[bent_map.sources] + [3, 0, 2])
        order = {tuple(v): n for n, v in enumerate((flat.ids - [3, 0, 2]).tolist())}
        same = [order[tuple(v)] for v in bent_map.ids.tolist()]
        np.testing.assert_allclose(flat.uv[same], bent_map.uv, atol=1e-3)


class TestView:
    """A map shows the surface from outside, superior up."""

    @pytest.mark.parametrize("flip", [(), (0,), (1,), (0, 1)])
    def test_a_ball_from_the_right(self, flip):
        ball = shapes.ball(14)
        size = np.array(ball.shape)
        affine = np.eye(4)
        for axis in flip:  # the same ball stored the other way round
            affine[axis, axis], affine[axis, 3] = -1, size[axis] - 1
        right = np.linalg.inv(affine) @ [size[0] - 3, size[1] // 2, size[2] // 2, 1]
        flat = grossmann2002(ball, affine=affine, seed_point=np.round(right[:3]).astype(int), radius=16.0, sources=100)
        u, v = flat.uv.T
        assert np.corrcoef(v, flat.points[:, 2])[0, 1] > 0.95  # superior is up
        assert np.corrcoef(u, flat.points[:, 1])[0, 1] > 0.95  # seen from the right, anterior is to the right


class TestLongWork:
    @pytest.mark.slow
    def test_progress_names_the_stages(self, head):
        stages = list(dict.fromkeys(stage for stage, _, _ in head.reports))
        assert "measuring distances" in stages
        assert all(0 <= done <= total for _, done, total in head.reports)

    @pytest.mark.slow
    @pytest.mark.parametrize("stage", ["choosing sources", "measuring distances", "scaling"])
    def test_cancelling_is_fast(self, stage):
        volume = shapes.depth_surface(shapes.head_depth())

        def latency():
            cancelled = []

            def progress(now, done, total):
                if now == stage and (done or total == 1):
                    cancelled.append(time.perf_counter())
                    return False
                return None

            with pytest.raises(voxflat.Cancelled):
                grossmann2002(volume, sources=3000, progress=progress)
            return time.perf_counter() - cancelled[0]

        # a busy machine may delay some attempts, but not each of them
        assert any(latency() < 0.1 for _ in range(8))

    def test_an_exception_of_progress_comes_through(self, bent):
        def progress(stage, done, total):
            raise ZeroDivisionError

        with pytest.raises(ZeroDivisionError):
            grossmann2002(shapes.depth_surface(shapes.head_depth()), progress=progress)

    def test_ctrl_c_stops_the_core(self):
        volume = shapes.depth_surface(shapes.head_depth())
        amid, pressed = threading.Event(), []

        def press():
            amid.wait()
            pressed.append(time.perf_counter())
            os.kill(os.getpid(), signal.SIGINT)

        def progress(stage, done, total):
            if stage == "measuring distances":
                amid.set()

        threading.Thread(target=press).start()
        try:
            with pytest.raises(KeyboardInterrupt):
                voxflat.surface(volume).geodesic(4000, geodesic="chain", progress=progress)  # takes several seconds
        finally:
            amid.set()
        assert time.perf_counter() - pressed[0] < 2

    @pytest.mark.slow
    def test_python_runs_on_meanwhile(self, head):
        # the GIL is released: only short calls of numpy hold it (on a busy machine in one attempt of several)
        assert head.longest_gap < 0.25 or any(head_map().longest_gap < 0.25 for _ in range(4))
