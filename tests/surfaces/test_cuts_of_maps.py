"""The cuts of another map are taken from the map itself."""

import itertools

import numpy as np
import pytest
from command_line import fail, succeed
from hard_shapes import quads
from refusals import refused

import voxflat
from voxflat.methods import Voxflat

ROWS, COLUMNS = 16, 24
NUMBER = np.arange(ROWS * COLUMNS).reshape(ROWS, COLUMNS)


def barrel():
    """Return a tube that is wider in the middle."""
    v, u = np.meshgrid(np.linspace(-15, 15, ROWS), 2 * np.pi * np.arange(COLUMNS) / COLUMNS, indexing="ij")
    radius = 8 - v**2 / 60
    points = np.stack([radius * np.cos(u), radius * np.sin(u), v], axis=-1).reshape(-1, 3)
    following = np.roll(NUMBER, -1, axis=1)
    return points, quads(NUMBER[:-1], following[:-1], following[1:], NUMBER[1:])


BARREL = barrel()
WHOLE = voxflat.surface(BARREL)
CUTS = {"seam": NUMBER[:, 3].tolist(), "dart": NUMBER[:6, 14].tolist()}


@pytest.fixture(scope="module")
def known():
    return WHOLE.flatten(Voxflat(sources=30), cuts=CUTS, relax=False)


def edges(cuts):
    return {frozenset(pair) for cut in cuts for pair in itertools.pairwise(np.asarray(cut.ids).tolist())}


def given():
    return {frozenset(pair) for path in CUTS.values() for pair in itertools.pairwise(path)}


@pytest.mark.medium
def test_a_map_its_file_and_another_tools_mesh_stand_for_its_cuts(known, tmp_path):
    known.save(tmp_path / "map.npz")
    for flat in (known, tmp_path / "map.npz", known.to_pyvista()):
        cut = WHOLE.cut(flat)
        assert edges(cut.cuts) == given()
        assert len(cut.surface) == len(known)
        assert {line.reason for line in cut.cuts} == {"given"}
        assert cut.cuts_by == "given"
    assert {line.name for line in WHOLE.cut(known).cuts} == {*CUTS}
    again = WHOLE.flatten(Voxflat(sources=30), cuts=tmp_path / "map.npz")
    assert again.distortion.best_scale.relative_error == pytest.approx(
        known.distortion.best_scale.relative_error, rel=1e-3
    )


def test_a_map_of_a_part_excludes_the_rest(known, tmp_path):
    known.save(tmp_path / "map.surf.gii")  # one position per vertex: triangles at one side of the cuts are lost
    cut, part = WHOLE.cut(tmp_path / "map.surf.gii"), WHOLE.keep(tmp_path / "map.surf.gii")
    np.testing.assert_array_equal(cut.surface.vertices[cut.surface.faces], part.vertices[part.faces])
    assert (cut.cuts, cut.cuts_by) == ((), "given")
    upper = WHOLE.keep(NUMBER[8:].ravel()).cut(known)  # the dart is in the other half
    assert edges(upper.cuts) == {frozenset(pair) for pair in itertools.pairwise(CUTS["seam"][8:])}
    refused("the map in cuts covers no triangle", WHOLE.keep(NUMBER[:3, 3:6].ravel()).cut, upper.flatten())


def test_the_command_line_and_check_take_maps(known, tmp_path):
    known.save(tmp_path / "map.npz")
    WHOLE.save(tmp_path / "barrel.ply")
    succeed("cut", tmp_path / "barrel.ply", "--cuts", tmp_path / "map.npz", "-o", tmp_path / "cuts.json")
    assert edges(WHOLE.cut(tmp_path / "cuts.json", relax=False).cuts) == given()
    twice = ("--cuts", tmp_path / "map.npz", "--cuts", tmp_path / "map.npz")
    fail(2, "map cannot be combined", "cut", tmp_path / "barrel.ply", *twice, "-o", tmp_path / "other.json")
    found = WHOLE.check(known)
    assert found.can_flatten


def test_a_map_of_another_surface_is_refused(known):
    points, faces = BARREL
    smaller = voxflat.surface((points[: ROWS * COLUMNS - COLUMNS], faces[(faces < (ROWS - 1) * COLUMNS).all(axis=1)]))
    refused("the map was made on a surface with 384 vertices, but the given surface has 360", smaller.cut, known)
