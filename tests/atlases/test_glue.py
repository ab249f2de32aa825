"""Gluing certified patches: the open problem of Appleboim, Saucan and Zeevi (2006)."""

import json

import composed
import numpy as np
import pytest
from hard_shapes import sheet, signed_areas
from refusals import refused
from textures import areas, side_counts
from triangle_meshes import singular_values

import voxflat
from voxflat import Cancelled, FlatAtlas, figures
from voxflat.atlases.glued import GluedAtlas
from voxflat.methods import Saucan2006

pytestmark = pytest.mark.slow  # what its fixtures make takes seconds


def bumps():
    return sheet(lambda x, y: (x, y, 1.5 * np.sin(0.7 * x) * np.cos(0.6 * y)), (24, 20), (25, 21))


@pytest.fixture(scope="module")
def atlas():
    return voxflat.surface(bumps()).patches(10)


@pytest.fixture(scope="module")
def glued(atlas):
    return atlas.glue(1.1)


def check(atlas, glued):
    """Check what is promised by what is returned alone."""
    assert (signed_areas(glued.uv, glued.uv_faces) > 0).all()
    most, least = singular_values(glued.points[glued.faces], glued.uv[glued.uv_faces]).T
    assert np.maximum(most, 1 / least).max() <= glued.bound * (1 + 1e-9)
    np.testing.assert_allclose(glued.stretch, np.stack([most, least], axis=1), rtol=1e-6)
    assert np.array_equal(glued.vertex_ids[glued.uv_faces], glued.faces)
    assert np.array_equal(glued.patch_ids, atlas.piece_ids)
    for number, piece in enumerate(glued):
        assert (glued.piece_ids[piece.face_ids] == number).all()
        assert np.array_equal(piece.vertex_ids[piece.faces], glued.faces[piece.face_ids])
        assert len(voxflat.surface((glued.points, glued.faces[piece.face_ids])).faces) == len(piece.face_ids)
    length = np.linalg.norm(np.diff(glued.points[glued.cuts], axis=1)[:, 0], axis=1).sum()
    assert length == pytest.approx(glued.seams.cuts, rel=1e-9, abs=1e-9)
    assert glued.seams.length == pytest.approx(glued.seams.closed + glued.seams.cuts)


class TestGlue:
    def test_what_is_promised_holds(self, atlas, glued):
        check(atlas, glued)
        assert isinstance(glued, GluedAtlas)
        assert len(glued) < len(atlas) / 10
        assert glued.seams.closed_share > 0.9
        assert glued.certified_before == atlas.certificate.c
        assert glued.measured_before == pytest.approx(atlas.figures()["measured"]["c"])

    def test_a_wider_bound_closes_more(self, atlas, glued):
        wide = atlas.glue(1.5)
        check(atlas, wide)
        assert wide.seams.closed_share >= glued.seams.closed_share

    def test_wrong_bounds_are_named(self, atlas):
        refused(r"a bound of 1 on C. Pass a bound from 1\.000001 to 10", atlas.glue, 1)
        refused("a bound of NaN", atlas.glue, float("nan"))
        refused(r"change lengths by a factor of up to 1\.01.* greater bound", atlas.glue, 1.0001)
        refused("bound is 'tight'. Pass the largest factor", atlas.glue, "tight")
        refused("bound is True", atlas.glue, True)

    def test_it_can_be_cancelled(self, atlas):
        refused("threads", atlas.glue, threads=0)
        with pytest.raises(Cancelled):
            atlas.glue(progress=lambda stage, done, total: False)


class TestGluedAtlas:
    def test_it_is_a_sequence(self, glued):
        assert len(glued[:1]) == 1
        assert np.array_equal(glued[-1].uv, glued[len(glued) - 1].uv)
        assert "seams closed" in repr(glued)
        assert "triangles" in repr(glued[0])
        with pytest.raises(IndexError):
            glued[len(glued)]

    def test_figures_and_table_agree(self, atlas, glued):
        told = glued.figures()
        assert told["patches"] == len(atlas)
        assert told["seams"]["closed_share"] == glued.seams.closed_share
        assert told["measured"]["c"] == pytest.approx(glued.measured[:, 1].max())
        table = glued.table()
        assert f"{100 * glued.seams.closed_share:.2f} %" in table
        assert f"{told['measured']['c']:.4f}" in table
        assert json.dumps(told, allow_nan=False)

    def test_saved_and_loaded_it_is_the_same(self, atlas, glued, tmp_path):
        glued.save(tmp_path / "glued.npz")
        loaded = voxflat.load_atlas(tmp_path / "glued.npz")
        assert isinstance(loaded, GluedAtlas)
        assert loaded.seams == glued.seams
        assert loaded.table() == glued.table()
        check(atlas, loaded)
        atlas.save(tmp_path / "atlas.npz")
        again = voxflat.load_atlas(tmp_path / "atlas.npz")
        assert isinstance(again, FlatAtlas)
        assert np.array_equal(again.glue(1.1).uv, glued.uv)

    def test_other_files_are_refused(self, atlas, glued, tmp_path):
        refused(r"ends in \.npz", glued.save, tmp_path / "glued.obj")
        atlas.save(tmp_path / "atlas.npz")
        refused("", GluedAtlas.load, tmp_path / "atlas.npz")
        (tmp_path / "broken.npz").write_bytes(b"PK")
        refused("is not an atlas", voxflat.load_atlas, tmp_path / "broken.npz")
        with pytest.raises(FileNotFoundError):
            voxflat.load_atlas(tmp_path / "nowhere.npz")

    def test_the_outline_is_where_pieces_end(self, glued):
        boundary = np.linalg.norm(np.diff(glued.points[glued.vertex_ids[glued.outline]], axis=1)[:, 0], axis=1).sum()
        ends, uses = side_counts(glued.faces)
        rim = np.linalg.norm(np.diff(glued.points[ends[uses == 1]], axis=1)[:, 0], axis=1).sum()
        assert boundary == pytest.approx(rim + 2 * glued.seams.cuts)
        assert np.isfinite(glued.uv[glued.outline]).all()

    def test_pieces_have_a_page_without_overlap(self, glued, tmp_path):
        drawn = np.abs(signed_areas(glued.layout(), glued.uv_faces))
        np.testing.assert_allclose(drawn, glued.areal * areas(glued.points, glued.faces), rtol=1e-6)
        figures.save(figures.atlas_page(glued), tmp_path / "page.png")
        assert (tmp_path / "page.png").stat().st_size > 10_000


class TestOneMap:
    def test_it_is_the_glued_piece(self):
        mesh = bumps()
        flat = voxflat.flatten(mesh, method=Saucan2006(bound=1.3))
        glued = voxflat.surface(mesh).patches(10).glue(1.3)
        assert len(glued) == 1
        np.testing.assert_array_equal(flat.uv[flat.faces], glued.uv[glued.uv_faces])
        np.testing.assert_array_equal(flat.points[flat.faces], glued.points[glued.faces])
        assert flat.distortion.triangles.flipped == flat.distortion.triangles.covering == 0
        assert flat.metadata["method"] == "saucan2006"
        assert flat.metadata["bound"] == 1.3
        assert flat.metadata["seams"]["closed_share"] == glued.seams.closed_share
        assert np.isfinite(flat.normals).all()
        assert len(flat.sources) == 0
        most, least = singular_values(flat.points[flat.faces], flat.uv[flat.faces]).T
        assert np.maximum(most, 1 / least).max() <= 1.3 * (1 + 1e-9)
        assert not {"sources", "sampling", "planarity"} & set(flat.metadata)
        assert flat.metadata["memory_need_bytes"] > 4000 * len(flat)  # gluing alone
        assert flat.metadata["before"]["c"] <= flat.metadata["before"]["certified_c"]

    def test_a_closed_surface_is_cut_as_far_as_it_must(self, tmp_path):
        ball = np.linalg.norm(np.indices((16, 16, 16)).T - 7.4, axis=-1) < 6.5
        flat = voxflat.flatten(ball, method=Saucan2006(bound=1.6))
        assert any("remain cut" in warning for warning in flat.metadata["warnings"])
        assert len(flat) > len(np.unique(flat.ids, axis=0))  # both sides of cuts
        assert flat.metadata["seams"]["cuts"] + sum(cut["length"] for cut in flat.metadata["automatic_cuts"]) > 10
        flat.save(tmp_path / "ball.npz")
        np.testing.assert_array_equal(voxflat.load(tmp_path / "ball.npz").uv, flat.uv)

    def test_what_unrolls_is_unrolled(self):
        mesh = sheet(lambda x, y: (8 * np.cos(x / 8), 8 * np.sin(x / 8), y), (30, 16), (31, 17))
        flat = voxflat.flatten(mesh, method="saucan2006")
        assert flat.distortion.triangles.edge < 1e-6
        assert flat.metadata["warnings"] == []

    def test_bad_options_are_refused(self):
        for options, message in (
            ({"bound": 1.0}, "bound is 1.0. Pass the largest factor by which lengths may change, from above 1 to 10"),
            ({"bound": np.nan}, "bound is nan"),
            ({"bound": "1.5"}, "bound is '1.5'"),
            ({"rows": True}, "the method 'saucan2006' does not measure distances"),
        ):
            refused(message, composed.flatten, bumps(), method="saucan2006", **options)

    def test_too_little_memory_is_refused_before_work_begins(self):
        stages = []
        limits = {"memory_limit": 400_000, "progress": lambda stage, *_: stages.append(stage)}  # its surface takes less
        told = r"of memory is needed, but the limit is .*. Flatten a smaller patch"
        refused(told, composed.flatten, bumps(), method="saucan2006", **limits)
        assert "growing patches" not in stages

    def test_several_pieces_are_refused(self):
        mesh = sheet(lambda x, y: (x, y, 6 * np.sin(1.9 * x) * np.cos(2.1 * y)), (20, 20), (21, 21))
        assert len(voxflat.surface(mesh).patches(10).glue(1.02)) > 1
        told = r"cannot be glued into one piece within C ≤ 1.02: \d+ pieces remain"
        refused(told, voxflat.flatten, mesh, method=Saucan2006(bound=1.02))
