"""A map of the other hemisphere is reported also if no file tells the hemispheres apart; right maps never are."""

import logging

import numpy as np
import pytest
from hard_shapes import sheet
from nilearn.datasets import load_fsaverage
from refusals import refused

import voxflat
from voxflat.evaluation import sides
from voxflat.io import Mesh, write_mesh
from voxflat.maps.matching import match

POINTS, FACES = sheet(lambda u, v: (u, v, 3 * np.sin(u / 7) * np.cos(v / 9)), (36.0, 36.0), (13, 13))
FLAT = np.pad(POINTS[:, :2], ((0, 0), (0, 1)))
OTHER = (POINTS * [-1, 1, 1], FACES[:, ::-1])  # of the other hemisphere, as in fs_LR


def reports(loaded):
    return [text for text in loaded.warnings if "other hemisphere" in text]


def test_triangles_turned_round_belong_to_the_other_hemisphere(caplog):
    (text,) = reports(voxflat.load((FLAT, FACES), OTHER))
    why = "because its triangles are those of the surface, turned round. Pass the surface of its hemisphere. If"
    assert text.startswith(f"the map probably belongs to the other hemisphere, {why} the surface is not a hemisphere")
    assert not reports(voxflat.load((FLAT, FACES), (POINTS, FACES)))
    assert not reports(voxflat.load((FLAT * [-1, 1, 1], FACES[:, ::-1]), OTHER))
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        voxflat.measure(OTHER, (FLAT, FACES))
    assert text in caplog.text


def test_a_mirrored_map_of_the_same_hemisphere_is_only_mirrored():
    (text,) = reports(voxflat.load((FLAT * [-1, 1, 1], FACES), (POINTS, FACES)))
    assert text.startswith("the map shows the surface from inside")


def test_recorded_sides_decide(tmp_path):
    write_mesh(tmp_path / "lh.flat.surf.gii", Mesh(FLAT, FACES, structure="CortexLeft"))
    left = Mesh(*OTHER, structure="CortexLeft")
    (text,) = reports(voxflat.load(tmp_path / "lh.flat.surf.gii", left))
    assert text.startswith("the map shows the surface from inside")
    right = Mesh(*OTHER, structure="CortexRight")
    flat = Mesh(FLAT, FACES, structure="CortexLeft")
    refused("the map: belongs to the left hemisphere, but the surface belongs to the right", voxflat.load, flat, right)


@pytest.fixture(scope="module")
def fsaverage5():
    meshes = load_fsaverage("fsaverage5")

    def mesh(kind, side):
        part = meshes[kind].parts[side]
        return np.asarray(part.coordinates, dtype=np.float64), np.asarray(part.faces, dtype=np.int64)

    return mesh


@pytest.mark.slow
@pytest.mark.parametrize("side", ["left", "right"])
def test_fsaverage5(fsaverage5, side):
    """Both sides have the same triangles, and no side is recorded."""
    flat = fsaverage5("flat", side)
    for kind in ("white_matter", "pial", "inflated", "sphere"):
        assert not reports(voxflat.load(flat, fsaverage5(kind, side))), kind
    other = {"left": "right", "right": "left"}[side]
    for kind in ("white_matter", "pial"):
        (text,) = reports(voxflat.load(flat, fsaverage5(kind, other)))
        assert "% of the area) is lateral on this surface, not medial. Pass the surface of its hemisphere" in text


@pytest.mark.slow
def test_a_lateral_part_may_be_omitted(fsaverage5, tmp_path):
    """Such as the insula: lengths on the map are still those of the surface."""
    points, faces = fsaverage5("pial", "left")
    write_mesh(tmp_path / "lh.flat.surf.gii", Mesh(*fsaverage5("flat", "left")))
    made = voxflat.flatten((points, faces), cuts=tmp_path / "lh.flat.surf.gii", relax=False)
    corners = made.ids[made.faces]
    is_near = np.linalg.norm(points - points[points[:, 0].argmin()], axis=1) < 39
    kept = corners[~is_near[corners].all(axis=1)]
    places = np.zeros((len(points), 3))
    places[made.ids, :2] = made.uv
    whole = voxflat.surface((points, faces))
    assert sides._omitted_on_the_outside(whole, match(whole, (places, kept))) > 0
    assert not reports(voxflat.load((places, kept), whole))
