"""Curvature and sulcal depth, compared with analytic shapes and FreeSurfer's values."""

import hard_shapes
import lab
import nibabel as nib
import numpy as np
import pytest
import shapes
from mesh_files import fsaverage5
from refusals import refused
from textures import areas

import voxflat
from voxflat import Cancelled
from voxflat.methods import Grossmann2002


def sheet(n, step, height):
    """Return x and y of n x n vertices that are `step` mm apart, and the surface whose height depends on x."""
    points, faces = hard_shapes.sheet(lambda x, y: (x, y, height(x)), 2 * [np.arange(n) * step])
    return points[:, 0], points[:, 1], voxflat.surface((points, faces))


def ball(radius):
    """Return the surface of a ball of 1 mm voxels; its positions are finer than the grid."""
    grid = np.indices((2 * radius + 9,) * 3) - (radius + 4)
    return voxflat.surface((np.linalg.norm(grid, axis=0) < radius).astype(np.uint8), spacing=(1.0, 1.0, 1.0))


class TestCurvature:
    def test_a_ball_of_voxels_bends_by_its_radius(self):
        curvature = ball(15).mean_curvature()
        assert curvature.mean() == pytest.approx(1 / 15, rel=0.03)
        assert (curvature * 15).std() < 0.25  # steps of voxels are left, smoothed over 2 mm

    @pytest.mark.parametrize("step", [0.5, 1.0])
    def test_waves_bend_as_the_formula_says(self, step):
        k, a, smoothing = 2 * np.pi / 20, 0.2, 1.5
        x, y, surface = sheet(round(40 / step) + 1, step, lambda x: a * np.cos(k * x))
        expected = a * k**2 / 2 * np.cos(k * x) * np.exp(-(k**2) * smoothing**2 / 2)
        sign = np.sign(surface.core.normals[:, 2].mean())
        inner = (np.abs(x - 20) < 12) & (np.abs(y - 20) < 12)
        off = sign * surface.mean_curvature(smoothing) - expected
        assert np.abs(off[inner]).max() < 0.06 * a * k**2 / 2

    def test_without_smoothing_the_integral_is_that_of_the_sphere(self):
        surface = ball(12)
        area = np.bincount(surface.faces.ravel(), np.repeat(areas(surface.points, surface.faces) / 3, 3))
        raw, smooth = surface.mean_curvature(0), surface.mean_curvature(3)
        assert (raw * area).sum() == pytest.approx(4 * np.pi * 12, rel=0.03)
        assert (smooth * area).sum() == pytest.approx((raw * area).sum(), rel=5e-3)  # diffusion keeps it


class TestSulcalDepth:
    def test_a_ball_has_no_depth(self):
        assert np.abs(ball(20).sulcal_depth()).max() < 0.45  # half a voxel

    @pytest.mark.parametrize("step", [0.7, 1.0])
    def test_shallow_waves_have_their_height(self, step):
        x, y, surface = sheet(round(40 / step) + 1, step, lambda x: 0.5 * np.cos(2 * np.pi / 10 * x))
        height = 0.5 * np.cos(2 * np.pi / 10 * x)
        sign = np.sign(surface.core.normals[:, 2].mean())
        inner = (np.abs(x - 20) < 10) & (np.abs(y - 20) < 10)
        depth = sign * surface.sulcal_depth()
        assert np.abs((depth - depth[inner].mean() + height - height[inner].mean())[inner]).max() < 0.1

    @pytest.mark.medium
    def test_it_asks_not_for_the_triangles(self):
        white, _, faces = lab.hemisphere()
        fine = voxflat.surface(lab.fsaverage5("white_left"))
        coarse = voxflat.surface((white, faces))
        at = fine.sulcal_depth()[: lab.VERTICES]
        depth = coarse.sulcal_depth()
        assert np.corrcoef(depth, at)[0, 1] > 0.995
        assert np.abs(depth - at).mean() < 0.25

    def test_threads_change_no_bit(self):
        surface = voxflat.surface(lab.fsaverage5("white_left"))
        np.testing.assert_array_equal(surface.sulcal_depth(threads=1), surface.sulcal_depth(threads=2))

    def test_it_can_be_cancelled(self):
        with pytest.raises(Cancelled):
            voxflat.surface(lab.fsaverage5("white_left")).sulcal_depth(progress=lambda *_: False)


def test_wrong_lengths_are_refused():
    surface = ball(6)
    for smoothing in (-1, np.inf, np.nan, "wide"):
        refused("smoothing", surface.mean_curvature, smoothing)
    for flow in (0, -3.0, np.inf):
        refused("flow", surface.sulcal_depth, flow)


@pytest.mark.parametrize("side", ["left", "right"])
def test_they_agree_with_freesurfer(side):
    surface = voxflat.surface(lab.fsaverage5(f"white_{side}"))
    curv, sulc = (nib.load(fsaverage5(f"{name}_{side}")).agg_data() for name in ("curv", "sulc"))
    assert np.corrcoef(surface.mean_curvature(), curv)[0, 1] < -0.96  # the other sign
    assert np.corrcoef(surface.sulcal_depth(), sulc)[0, 1] > 0.97


def test_a_map_has_them_of_the_whole_surface(tmp_path):
    white, _, faces = lab.hemisphere()
    surface = voxflat.surface((white, faces))
    flat = surface.disk(1000, 25.0).flatten()
    assert len(flat) < 0.3 * len(surface)
    flat.save(tmp_path / "map.npz")
    for one in (flat, voxflat.load(tmp_path / "map.npz")):
        np.testing.assert_array_equal(one.curvature, surface.mean_curvature()[flat.ids])
        np.testing.assert_array_equal(one.sulcal_depth, surface.sulcal_depth()[flat.ids])


def test_the_graph_of_voxels_has_none(tmp_path):
    flat = voxflat.surface(shapes.sheet((20, 20))).flatten(Grossmann2002(sources=60))
    flat.save(tmp_path / "map.npz")
    for one in (flat, voxflat.load(tmp_path / "map.npz")):
        assert one.curvature is one.sulcal_depth is None
