"""The surfaces that are defined by formulas have the best maps that the documentation claims."""

import numpy as np
import pytest

import voxflat
from voxflat.benchmark.shapes import SHAPES


def edges(faces):
    return np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)


def lengths(points, ends):
    return np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1)


@pytest.mark.medium
@pytest.mark.parametrize("name", SHAPES)
def test_each_shape_is_a_disk(name):
    points, faces = SHAPES[name]()
    surface = voxflat.surface((points, faces), repair="none")
    topology = surface.core.topology()
    assert (topology["euler"], len(topology["loops"]), len(topology["components"])) == (1, 1, 1)
    assert len(surface) == len(points)
    np.testing.assert_array_equal(SHAPES[name]()[0], points)


@pytest.mark.parametrize(("name", "area"), [("rolled_square", 3600), ("u_shape", 2700)])
def test_cylinders_keep_all_edges_of_a_flat_sheet(name, area):
    points, faces = SHAPES[name]()
    assert voxflat.surface((points, faces)).core.area == pytest.approx(area, rel=1e-4)
    assert angle_defect(points, faces) < 1e-9


def test_the_cone_is_a_sector_of_160_degrees():
    points, faces = SHAPES["cone"]()
    apex = np.flatnonzero(np.linalg.norm(points, axis=1) < 1e-9)
    assert len(apex) == 1
    assert np.linalg.norm(points, axis=1).max() == pytest.approx(50)
    assert angles(points, faces)[faces == apex[0]].sum() == pytest.approx(np.radians(160), rel=1e-3)
    assert angle_defect(points, faces) < 1e-9


def angles(points, faces):
    corners = points[faces]
    to_next, to_last = (np.roll(corners, step, axis=1) - corners for step in (-1, 1))
    norms = np.linalg.norm(to_next, axis=2) * np.linalg.norm(to_last, axis=2)
    return np.arccos(np.clip((to_next * to_last).sum(axis=2) / norms, -1, 1))


def angle_defect(points, faces):
    """Return the largest difference from 2π of the angles around an inner vertex."""
    total = np.bincount(faces.ravel(), angles(points, faces).ravel(), len(points))
    ends, counts = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0, return_counts=True)
    inner = np.setdiff1d(np.arange(len(points)), ends[counts == 1])
    return np.abs(total[inner] - 2 * np.pi).max()


def test_the_catenoid_and_the_helicoid_are_isometric():
    (catenoid, faces), (helicoid, others) = SHAPES["catenoid"](), SHAPES["helicoid"]()
    np.testing.assert_array_equal(faces, others)
    ends = edges(faces)
    np.testing.assert_allclose(lengths(catenoid, ends), lengths(helicoid, ends), rtol=1e-3)


def test_the_azimuthal_map_of_the_cap_has_the_smallest_possible_stretch():
    points, faces = SHAPES["sphere_cap"]()
    polar = np.arccos(points[:, 2] / 50)
    assert polar.max() == pytest.approx(np.pi / 3)
    turn = np.arctan2(points[:, 1], points[:, 0])
    flat = 50 * polar[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    ends = edges(faces)
    ratio = lengths(flat, ends) / lengths(points, ends)
    assert ratio.max() / ratio.min() == pytest.approx(np.pi / 3 / np.sin(np.pi / 3), rel=0.01)
