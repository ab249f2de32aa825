import _thread
import threading
import time
from functools import partial

import composed
import numpy as np
import pytest
import shapes
from command_line import succeed
from mesh_files import fsaverage5
from refusals import refused
from scipy.interpolate import RBFInterpolator
from scipy.spatial.transform import Rotation
from triangle_meshes import cylinder

import voxflat

grossmann2002 = partial(composed.flatten, method="grossmann2002")


@pytest.fixture(scope="module")
def bent():
    return shapes.curled_sheet(30, 20, 0.4, Rotation.random(None, np.random.default_rng(3)))


@pytest.fixture(scope="module")
def bent_map(bent):
    return grossmann2002(bent, sources=150, rows=True)


@pytest.fixture(scope="module")
def head():
    """Return the map of the paper's head, and the progress reports."""
    reports = []
    volume = shapes.depth_surface(shapes.head_depth())
    return grossmann2002(volume, progress=lambda *report: reports.append(report)), reports


class TestStages:
    """Every stage of `grossmann2002` against an independent computation."""

    def test_points_are_the_affines_image_of_the_voxels(self, bent):
        affine = np.array([[0, -2, 0, 5], [1.5, 0, 0, -7], [0, 0, 3, 1], [0, 0, 0, 1]], dtype=float)
        flat = grossmann2002(bent, affine=affine, sources=50)
        np.testing.assert_allclose(flat.points, flat.ids @ affine[:3, :3].T + affine[:3, 3])
        assert bent[tuple(flat.ids.T)].all()

    def test_the_rest_is_placed_by_radial_functions(self, bent_map):
        known = bent_map.sources
        oracle = RBFInterpolator(bent_map.points[known], bent_map.uv[known], kernel="linear", degree=1)
        np.testing.assert_allclose(bent_map.uv, oracle(bent_map.points), atol=1e-6)


class TestPaper:
    """The figures of Grossmann, Kiryati, Kimmel (2002); `make paper-grossmann` prints them all."""

    @pytest.mark.slow
    def test_curled_sheet_at_random_orientations(self):
        figures = []
        for seed in range(4):
            sheet = shapes.curled_sheet(rotation=Rotation.random(None, np.random.default_rng(seed)))
            count = len(voxflat.surface(sheet).geodesic(1, geodesic="chain").ids)
            distortion = grossmann2002(sheet, sources=count).distortion
            assert distortion.mean_geodesic == pytest.approx(35, abs=3)
            figures.append((distortion.raw.absolute_error, distortion.raw.relative_error))
        absolute, relative = np.mean(figures, axis=0)
        assert absolute <= 0.43
        assert relative <= 0.021

    @pytest.mark.slow
    def test_head(self, head):
        distortion = head[0].distortion
        assert distortion.mean_geodesic == pytest.approx(141.9, abs=2)
        assert distortion.raw.absolute_error < 9.04
        assert distortion.raw.relative_error < 0.0766


class TestInputs:
    """Any type and any strides of the same volume give the same map."""

    @pytest.mark.parametrize("dtype", ["?", "u1", "i1", "i2", "u2", "i8", "u8", ">i4", "f2", "f4", "f8"])
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
            view.setflags(write=False)  # it is left alone
            np.testing.assert_array_equal(grossmann2002(view, sources=150).uv, bent_map.uv)

    def test_labels_and_thresholds(self, bent, bent_map):
        labels = np.where(bent, 7, 0).astype(np.uint8)
        labels[0, 0, 0] = 3
        np.testing.assert_array_equal(grossmann2002(labels, label=7, sources=150).uv, bent_map.uv)
        intensities = np.where(bent, 0.9, 0.5).astype(np.float32)
        np.testing.assert_array_equal(grossmann2002(intensities, threshold=0.5, sources=150).uv, bent_map.uv)

        for label in (3.5, "1", np.nan):
            refused(r"the label is .*Pass a whole number", grossmann2002, bent, label=label)

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
            assert flat.distortion.figures() == bent_map.distortion.figures()

    def test_moving_the_volume_moves_only_the_points(self, bent, bent_map):
        padded = np.pad(bent, [(3, 0), (0, 5), (2, 2)])
        flat = grossmann2002(padded, sources=bent_map.ids[bent_map.sources] + [3, 0, 2])
        order = {tuple(v): n for n, v in enumerate((flat.ids - [3, 0, 2]).tolist())}
        same = [order[tuple(v)] for v in bent_map.ids.tolist()]
        np.testing.assert_allclose(flat.uv[same], bent_map.uv, atol=1e-3)


@pytest.mark.parametrize("flip", [(), (0,), (1,), (0, 1)])
def test_a_map_shows_the_surface_from_outside_with_superior_up(flip):
    ball = shapes.ball(14)
    last, affine = len(ball) - 1, np.eye(4)
    for axis in flip:  # the same ball stored the other way round
        affine[axis, axis], affine[axis, 3] = -1, last
    right = np.linalg.inv(affine) @ [last - 2, last // 2, last // 2, 1]
    flat = grossmann2002(ball, affine=affine, seed_point=np.round(right[:3]).astype(int), radius=16.0, sources=100)
    u, v = flat.uv.T
    assert np.corrcoef(v, flat.points[:, 2])[0, 1] > 0.95  # superior is up
    assert np.corrcoef(u, flat.points[:, 1])[0, 1] > 0.95  # seen from the right, anterior is to the right


class TestLongWork:
    @pytest.mark.slow
    def test_progress_names_the_stages(self, head):
        assert "measuring distances" in {stage for stage, _, _ in head[1]}
        assert all(0 <= done <= total for _, done, total in head[1])

    @pytest.mark.medium
    def test_ctrl_c_stops_the_core(self):
        volume = shapes.depth_surface(shapes.head_depth())
        amid, pressed = threading.Event(), []

        def press():
            amid.wait()
            pressed.append(time.perf_counter())
            _thread.interrupt_main()  # on Windows os.kill would end the process

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
@pytest.mark.parametrize(
    "options",
    [
        {"method": "zigelman2002", "sources": 50, "sampling": "farthest"},
        {"method": "schwartz1989", "sources": 30, "neighbourhood": 4, "starts": 2},
        {"method": "saucan2006", "bound": 1.3},
    ],
    ids=lambda options: options["method"],
)
def test_the_command_line_hands_on_what_methods_are_given(options, tmp_path):
    voxflat.surface(cylinder((21, 16))[0]).save(tmp_path / "mesh.ply")
    words = [word for name, value in options.items() for word in (f"--{name}", value)]
    succeed("flatten", tmp_path / "mesh.ply", "-o", tmp_path / "map.npz", *words, "--quiet")
    expected = composed.flatten(tmp_path / "mesh.ply", **options)
    np.testing.assert_array_equal(voxflat.load(tmp_path / "map.npz").uv, expected.uv)


@pytest.mark.slow
@pytest.mark.parametrize(("method", "radius"), [("zigelman2002", 45.0), ("schwartz1989", 26.0)])
def test_a_patch_of_the_cortex_is_flattened_by_other_papers_too(method, radius):
    white, pial = (str(fsaverage5(name)) for name in ("white_left", "pial_left"))
    patch = voxflat.surface(white, pial=pial).disk(4000, radius)
    flat, usual = (voxflat.flatten(patch, name) for name in (method, "voxflat"))
    assert np.isfinite(flat.uv).all()
    assert len(flat) == len(usual)
    assert flat.distortion.best_scale.relative_error < 1.5 * usual.distortion.best_scale.relative_error


@pytest.mark.medium
@pytest.mark.parametrize("method", ["zigelman2002", "schwartz1989"])
def test_volumes_are_flattened_by_other_papers_too(method):
    flat = composed.flatten(shapes.curled_sheet(20, 15, 0.5), method=method, sources=50)
    assert flat.is_voxels
    assert flat.distortion.raw.relative_error < 0.03
