"""Surfaces from voxels: closed surfaces, cut surfaces and sheets."""

import numpy as np
import pytest
import shapes
from command_line import succeed
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

import voxflat
from voxflat.io.meshes import read_mesh
from voxflat.methods import Voxflat

pytest.importorskip("nilearn")


class TestFromVoxels:
    @pytest.mark.slow
    @settings(max_examples=60)
    @given(st.integers(0, 2**32), st.floats(0.2, 0.8), st.integers(3, 9))
    def test_a_blob_is_a_closed_manifold_of_its_voxels(self, seed, share, size):
        noise = gaussian_filter(np.random.default_rng(seed).normal(size=(size,) * 3), 0.8)
        volume = (noise > np.quantile(noise, share)).astype(np.uint8)
        surface = shapes.two_sided(volume, repair="none")
        topology = surface.core.topology()
        edges = np.sort(np.concatenate([surface.faces[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))]), axis=1)
        _, counts = np.unique(edges, axis=0, return_counts=True)
        assert (counts == 2).all()
        assert topology["loops"] == []
        assert topology["euler"] == len(surface) - len(counts) + len(surface.faces)
        assert topology["euler"] % 2 == 0
        padded = np.pad(volume, 1)
        open_side = [np.roll(padded, step, axis) == 0 for axis in range(3) for step in (-1, 1)]
        expected = np.argwhere((padded != 0) & np.any(open_side, axis=0)) - 1
        np.testing.assert_array_equal(np.unique(surface.ids, axis=0), expected)

    def test_faces_look_outside_whatever_the_axes(self):
        ball = shapes.ball(8)
        for flip in ([1, 1, 1], [-1, 1, 1], [-1, -1, 1], [2, -1, 0.5]):
            surface = voxflat.surface(ball, affine=np.diag([*flip, 1.0]))
            corners = surface.points[surface.faces]
            volume = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
            assert volume == pytest.approx(ball.sum() * abs(np.prod(flip)), rel=0.1)

    @pytest.mark.medium
    @pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.6, 0.6, 3.0), (2.0, 0.5, 1.0)])
    def test_points_lie_near_the_surface(self, spacing):
        shape = [int(np.ceil(30 / h)) for h in spacing]
        ijk = np.indices(shape).reshape(3, -1).T * spacing
        inside = (11.3 - np.linalg.norm(ijk - 14.2, axis=1)).reshape(shape).astype(np.float32)
        off = {}
        for name, options in {"fit": {"label": 1}, "level": {"threshold": 0.0}}.items():
            volume = (inside > 0).astype(np.uint8) if name == "fit" else inside
            surface = voxflat.surface(volume, spacing=spacing, **options)
            off[name] = np.abs(np.linalg.norm(surface.points - 14.2, axis=1) - 11.3).mean() / max(spacing)
        assert off["fit"] < 0.16
        assert off["level"] < 0.05

    @pytest.mark.parametrize("radius", [6.3, 7.3, 9.3])
    def test_a_ball_is_neither_shrunk_by_the_fits_nor_swollen_by_sharpening(self, radius):
        centre = np.random.default_rng(0).uniform(11, 12, 3)
        ball = np.linalg.norm(np.indices((24, 24, 24)) - centre[:, None, None, None], axis=0) < radius
        surface = voxflat.surface(ball, label=1)
        corners = surface.points[surface.faces] - centre
        volume = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
        assert volume == pytest.approx(ball.sum(), rel=0.008)

    def test_how_points_were_placed_is_recorded(self):
        ball = shapes.ball(6)
        distance = np.linalg.norm(np.indices(ball.shape) - 8.0, axis=0)
        smooth = np.clip(6.5 - distance, 0, 1).astype(np.float32)
        assert voxflat.surface(ball).metadata["placed_by"] == "a fit to the voxels"
        assert voxflat.surface(smooth, threshold=0.5).metadata["placed_by"] == "the level 0.5 of the volume"
        assert voxflat.surface(smooth > 0.5, probability=smooth).metadata["placed_by"] == "the level 0.5 of an image"
        # a mask stored as numbers has no level between its voxels
        assert voxflat.surface(ball.astype(float), threshold=0.5).metadata["placed_by"] == "a fit to the voxels"
        for probability, message in ((smooth[:-1], "has shape"), (smooth * np.nan, "not finite")):
            refused(message, voxflat.surface, ball, probability=probability)

    @pytest.mark.slow
    def test_repair_leaves_a_sphere_and_tells_every_voxel(self, tmp_path):
        i, j, k = np.indices((30, 30, 14)) - np.array([15, 15, 7])[:, None, None, None]
        torus = (np.hypot(np.hypot(i, j) - 9, k) < 4).astype(np.uint8)
        assert voxflat.surface(torus).core.topology()["handles"] == 1
        repaired = voxflat.surface(torus, repair="voxels")
        assert repaired.core.topology()["euler"] == 2
        changed = repaired.changed_voxels()
        assert (torus[changed == 1] == 1).all()
        assert (torus[changed == 2] == 0).all()
        mended = np.where(changed == 1, 0, np.where(changed == 2, 1, torus))
        np.testing.assert_array_equal(voxflat.surface(mended).ids, repaired.ids)
        assert repaired.warnings[0].startswith("repaired 1 handle(s): ")
        cut = voxflat.surface(torus, repair="cuts")
        assert cut.core.topology()["handles"] == 0
        assert len(cut.metadata["handles_cut"]) == 1
        np.testing.assert_array_equal(np.unique(cut.ids, axis=0), np.unique(voxflat.surface(torus).ids, axis=0))
        np.save(tmp_path / "torus.npy", torus)
        written = tmp_path / "changed.nii.gz"
        arguments = ["surface", tmp_path / "torus.npy", "--repair", "voxels", "--repaired", written]
        succeed(*arguments, "-o", tmp_path / "out.surf.gii")
        np.testing.assert_array_equal(voxflat.io.read_volume(written).data, changed)
        np.testing.assert_allclose(read_mesh(tmp_path / "out.surf.gii").points, repaired.points, atol=1e-5)

    def test_banks_that_touch_stay_apart(self):
        # two plates that touch along a row of edges only, joined far away
        volume = np.zeros((40, 20, 12), np.uint8)
        volume[2:38, 2:18, 2:5] = volume[2:38, 2:18, 7:10] = 1
        volume[2:5, 2:18, 2:10] = 1
        volume[30, 2:18, 5] = volume[29, 2:18, 6] = 1  # edges of these touch
        surface = voxflat.surface(volume)
        a, b = surface.find([[30, 10, 5], [29, 10, 6]])
        assert surface.geodesic(surface.ids[[a]])[0][b] > 40
        assert voxflat.surface(volume).geodesic([[30, 10, 5]], geodesic="chain")[0].min() == 0
        assert voxflat.surface(volume).path((30, 10, 5), (29, 10, 6), geodesic="chain").length < 2


class TestSheets:
    @pytest.mark.slow
    @pytest.mark.parametrize("traversed", [False, True])
    def test_the_papers_curled_sheet_is_unrolled(self, traversed):
        """The sheet becomes one surface with a boundary, and its flat map has the size of the sheet."""
        volume = shapes.curled_sheet(rotation=Rotation.random(None, np.random.default_rng(4)), traversed=traversed)
        flat = voxflat.flatten(volume, Voxflat(sources=150))
        assert flat.metadata["sheet"]
        assert flat.metadata["automatic_cuts"] == []
        assert flat.distortion.raw.relative_error < 0.005
        assert flat.distortion.triangles.areal_median < 0.1
        centred = flat.uv - flat.uv.mean(axis=0)
        sides = np.ptp(centred @ np.linalg.svd(centred, full_matrices=False)[2].T, axis=0)
        np.testing.assert_allclose(sides, [88, 44], atol=2.5)
        assert flat.distortion.triangles.flipped <= 3

    def test_a_level_sheet_has_every_voxel_once(self):
        surface = voxflat.surface(shapes.sheet((20, 30)))
        assert surface.metadata["sheet"]
        assert (len(surface), len(surface.faces)) == (600, 2 * 19 * 29)
        assert np.linalg.norm(surface.points - surface.ids, axis=1).max() < 1e-6
        assert shapes.two_sided(shapes.sheet((20, 30))).core.topology()["euler"] == 2

    def test_a_sheet_on_a_slope_may_be_a_strip_of_edges(self):
        i, _, k = np.indices((20, 20, 20))
        surface = voxflat.surface((i + k == 19).astype(np.uint8))  # neighbours touch along edges alone
        topology = surface.core.topology()
        assert (topology["euler"], len(topology["components"])) == (1, 1)
        np.testing.assert_allclose(surface.points[:, [0, 2]].sum(axis=1), 19, atol=1e-6)
