"""Quasi-isometric patches after Appleboim, Saucan and Zeevi (2006)."""

import itertools
import sys

import composed
import numpy as np
import pytest
import shapes
import triangle_meshes
from hard_shapes import signed_areas
from refusals import refused
from triangle_meshes import singular_values

import voxflat
from voxflat import Cancelled, FlatAtlas, figures

pv = pytest.importorskip("pyvista")


@pytest.fixture(scope="module")
def torus():
    return voxflat.surface(triangle_meshes.torus(60))


@pytest.fixture(scope="module")
def atlas(torus):
    return torus.patches(10)


def check(atlas):
    """Check what is promised of all patches by what is returned alone."""
    certificate = atlas.certificate
    assert np.array_equal(np.sort(np.concatenate([patch.face_ids for patch in atlas])), np.arange(len(atlas.faces)))
    for number, patch in enumerate(atlas):
        assert (atlas.piece_ids[patch.face_ids] == number).all()
        assert np.array_equal(patch.vertex_ids[patch.faces], atlas.faces[patch.face_ids])
        plane = patch.plane
        frame = np.vstack([plane.axes, plane.normal])
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(frame) > 0
        projected = (atlas.points[patch.vertex_ids] - plane.origin) @ plane.axes.T
        np.testing.assert_allclose(patch.uv, projected, atol=1e-9)
        assert (signed_areas(patch.uv, patch.faces) > 0).all()
        most, least = singular_values(atlas.points[atlas.faces[patch.face_ids]], patch.uv[patch.faces]).T
        assert np.maximum(most, 1 / least).max() == pytest.approx(patch.isometric, rel=1e-6)
        assert (most / least).max() == pytest.approx(patch.quasi_conformal, rel=1e-6)
        assert np.maximum(most, 1 / least).max() <= certificate.c * (1 + 1e-9)
        assert (most / least).max() <= certificate.k * (1 + 1e-9)
        assert patch.tilt <= certificate.angle + 1e-6


class TestPatches:
    @pytest.mark.medium
    @pytest.mark.parametrize(("angle", "c"), [(10, 1.1763), (5, 1.0875)])
    def test_certificates_are_the_papers(self, torus, angle, c):
        atlas = torus.patches(max_angle=angle)
        assert atlas.certificate.c == pytest.approx(c, abs=5e-5)
        assert atlas.certificate.k == pytest.approx(c**1.5, abs=1e-4)
        check(atlas)

    def test_a_bound_allows_the_angle_of_its_cosine(self, torus, atlas):
        bounded = torus.patches(bound=1.1763)
        assert (bounded.certificate.c, bounded.certificate.k) == (1.1763, 1.1763)
        assert bounded.certificate.angle == pytest.approx(np.degrees(np.arccos(1 / 1.1763)))
        assert max(patch.isometric for patch in bounded) > 1.1
        assert len(bounded) < len(atlas) / 3
        check(bounded)

    @pytest.mark.medium
    def test_a_number_of_patches_is_not_exceeded(self, torus):
        few = torus.patches(count=30)
        assert len(few) <= 30
        assert len(torus.patches(0.9 * few.certificate.angle)) > 30
        check(few)
        refused("2 patches are too few", torus.patches, count=2)

    @pytest.mark.medium
    @pytest.mark.parametrize("seeds", ["curvature", "flattest", "random"])
    def test_where_patches_begin(self, torus, atlas, seeds):
        other = torus.patches(seeds=seeds)
        check(other)
        assert len(other) == len(atlas) if seeds == "curvature" else len(other) > 1.33 * len(atlas)

    def test_voxels_take_the_same_way(self):
        ball = voxflat.surface(shapes.ball(12), spacing=(0.5, 0.5, 0.5)).patches(15)
        assert ball.ids.shape == ball.points.shape
        assert ball.metadata["limit"] == {"angle": 15.0}
        check(ball)
        sheet = voxflat.surface(shapes.sheet()).patches()
        assert len(sheet) == 1
        assert sheet[0].isometric == pytest.approx(1, abs=1e-9)
        check(sheet)

    def test_wrong_arguments_are_named(self, torus):
        for options, message in (
            ({"max_angle": 0}, "the angle is 0°"),
            ({"max_angle": float("nan")}, "the angle is NaN°"),
            ({"max_angle": "steep"}, "max_angle is 'steep'. Pass a number"),
            ({"bound": 1}, "the bound C is 1"),
            ({"count": 0}, "count is 0"),
            ({"count": 2.5}, "count is 2.5. Pass a whole number"),
            ({"max_angle": 10, "bound": 1.2}, "max_angle and bound cannot be combined"),
            ({"seeds": "best"}, "seeds is 'best'"),
            ({"seed": -1}, "the seed is -1"),
            ({"threads": 0}, "threads"),
            ({"label": 3}, "label does not apply"),
        ):
            refused(message, composed.patches, torus, **options)

    def test_triangles_so_thin_that_rounding_counts_are_told(self, caplog):
        points = np.array([[0, 0, 0], [1e6, 0.3, 0.7], [3e5, 0.09, 0.21 + 1e-9], [2e5, -1e5, 4e4]]) + 1e3
        atlas = voxflat.surface((points, np.array([[0, 1, 2], [1, 0, 3]]))).patches(0.01)
        assert len(atlas) == 2
        assert atlas.figures()["broken"] == atlas.broken.sum()
        assert ("rounding" in caplog.text) == bool(atlas.broken.any())

    def test_it_can_be_cancelled(self, torus):
        with pytest.raises(Cancelled):
            torus.patches(10, progress=lambda stage, done, total: False)

    @pytest.mark.slow
    def test_it_is_asked_for_progress_even_where_nothing_moves(self):
        # or nobody could cancel a stage of which the end is not counted
        reports = []
        voxflat.surface(triangle_meshes.torus(300)).patches(5, progress=lambda *report: reports.append(report))
        assert any(before == after for before, after in itertools.pairwise(reports))


class TestFlatAtlas:
    def test_it_is_a_sequence(self, atlas):
        assert len(atlas.patches) == len(atlas)
        areas = [patch.area for patch in atlas]
        assert areas == sorted(areas, reverse=True)
        assert "1.1763" in repr(atlas)
        assert "triangles" in repr(atlas[0])

    def test_the_table_has_certificates_beside_measured_figures(self, atlas):
        table = atlas.table()
        assert "1.1763" in table
        measured = atlas.figures()["measured"]
        assert f"{measured['c']:.4f}" in table
        assert measured["c"] < atlas.certificate.c
        assert atlas.figures()["broken"] == 0

    @pytest.mark.parametrize("name", ["atlas.npz", "atlas.voxflat"])
    def test_saved_and_loaded_it_is_the_same(self, atlas, tmp_path, name):
        atlas.save(tmp_path / name)
        loaded = FlatAtlas.load(tmp_path / name)
        assert loaded.certificate == atlas.certificate
        assert loaded.metadata == atlas.metadata
        assert loaded.table() == atlas.table()
        for name in ("points", "faces", "ids", "piece_ids", "stretch", "uv", "planes", "measured"):
            assert np.array_equal(getattr(loaded, name), getattr(atlas, name))
        check(loaded)

    @pytest.mark.slow
    def test_pictures(self, atlas, tmp_path, monkeypatch):
        figures.save(figures.atlas_page(atlas), tmp_path / "page.png")
        assert (tmp_path / "page.png").stat().st_size > 10_000
        by_pyvista = figures.atlas_3d(atlas, size=300)
        monkeypatch.setitem(sys.modules, "pyvista", None)
        for picture in (by_pyvista, figures.atlas_3d(atlas, size=300)):
            assert picture.shape == (300, 300, 3)
            assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 50
        refused("towards", figures.atlas_3d, atlas, towards=(0, 0, 0))
