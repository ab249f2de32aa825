"""The peer of flat maps that we wrote ourselves: Floater's shape-preserving parameterization, in docs/benchmarks."""

import floater1997
import numpy as np
import pytest
from scipy.spatial import Delaunay


def sheet(count=200, seed=0):
    """Random points in a circle of points: places, counterclockwise triangles, how many lie inside."""
    around = np.linspace(0, 2 * np.pi, 30, endpoint=False)
    rng = np.random.default_rng(seed)
    angles, reach = rng.uniform(0, 2 * np.pi, count), 9 * np.sqrt(rng.uniform(0, 1, count))
    inside = reach[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    places = np.concatenate([inside, 10 * np.column_stack([np.cos(around), np.sin(around)])])
    return places, Delaunay(places).simplices.astype(np.int64), count


def turned_over(places, faces):
    a, b, c = places[faces].transpose(1, 0, 2)
    return int(((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] <= 0).sum())


def by_definition(points, ring, centre):
    """Floater's weights of one ring, step by step as in his section 6: an oracle."""
    spokes = points[ring] - points[centre]
    after = np.roll(spokes, -1, axis=0)
    lengths = np.linalg.norm(spokes, axis=1)
    angles = np.arccos((spokes * after).sum(axis=1) / lengths / np.roll(lengths, -1))
    angles *= 2 * np.pi / angles.sum()
    at = np.cumsum(angles) - angles
    flat = lengths[:, None] * np.column_stack([np.cos(at), np.sin(at)])
    total = np.zeros(len(ring))
    for k in range(len(ring)):
        for side in range(len(ring)):
            corners = [k, side, (side + 1) % len(ring)]
            if len(set(corners)) == 3:
                shares = np.linalg.solve(np.vstack([flat[corners].T, np.ones(3)]), [0, 0, 1])
                if (shares >= 0).all():
                    total[corners] += shares / len(ring)
                    break
    return total


@pytest.mark.parametrize("seed", range(5))
def test_a_plane_whose_border_stays_is_kept(seed):
    places, faces, inside = sheet(seed=seed)
    points = np.column_stack([places, np.zeros(len(places))])
    loop = np.arange(inside, len(places))
    found = floater1997.shape_preserving(points, faces, loop, places[loop])
    np.testing.assert_allclose(found, places, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_weights_are_positive_and_sum_to_one(seed):
    places, faces, inside = sheet(seed=seed)
    points = np.column_stack([places, 3 * np.sin(places).prod(axis=1)])
    weights = floater1997.weights(points, faces, np.arange(inside))
    assert weights.data.min() > 0
    np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=1e-12)
    sides = {(a, b) for face in faces for a in face for b in face if a != b}
    assert set(zip(*map(np.ndarray.tolist, weights.nonzero()), strict=True)) == {s for s in sides if s[0] < inside}


def test_weights_are_those_of_the_definition():
    places, faces, inside = sheet(count=60)
    points = np.column_stack([places, 3 * np.sin(places).prod(axis=1)])
    centres = np.arange(inside)
    weights = floater1997.weights(points, faces, centres)
    rings = floater1997.neighbours_in_turn(faces, centres, len(points))
    for centre, ring in zip(centres, rings, strict=True):
        ring = ring[ring >= 0]
        np.testing.assert_allclose(weights[[centre]].toarray()[0][ring], by_definition(points, ring, centre), atol=1e-9)


def test_a_rough_surface_is_mapped_one_to_one():
    places, faces, inside = sheet(count=800)
    points = np.column_stack([places, np.random.default_rng(1).normal(0, 5, len(places))])
    loop = np.arange(inside, len(places))
    assert turned_over(places, faces) == 0
    found = floater1997.shape_preserving(points, faces, loop, places[loop])
    assert turned_over(found, faces) == 0


@pytest.mark.parametrize("spoilt", ["a point on another", "a ring on a line", "all in one place"])
def test_degenerate_rings_have_weights(spoilt):
    places, faces, inside = sheet()
    points = np.column_stack([places, np.zeros(len(places))])
    ring = floater1997.neighbours_in_turn(faces, np.arange(1), len(points))[0]
    ring = ring[ring >= 0]
    if spoilt == "a point on another":
        points[0] = points[ring[0]]
    elif spoilt == "a ring on a line":
        points[ring, 1:] = points[0, 1:]
    else:
        points[:] = 0
    weights = floater1997.weights(points, faces, np.arange(inside))
    assert weights.data.min() >= 0
    np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=1e-12)


def test_a_centre_on_a_side_of_its_ring_lies_between_its_ends():
    points = np.array([[1.0, 0, 0], [0, 1, 0], [-3, 0, 0], [0, 0, 0]])
    faces = np.array([[3, 0, 1], [3, 1, 2], [3, 2, 0]])
    (weights,) = floater1997.weights(points, faces, np.array([3])).toarray()
    np.testing.assert_allclose(weights, [0.75, 0, 0.25, 0], atol=1e-12)


def test_rings_that_do_not_close_are_refused():
    places, faces, inside = sheet()
    with pytest.raises(ValueError, match="do not close"):
        floater1997.weights(np.column_stack([places, 0 * places[:, 0]]), faces, np.array([inside]))
    with pytest.raises(ValueError, match="do not close"):
        floater1997.neighbours_in_turn(np.array([[0, 1, 2], [0, 2, 1], [0, 3, 4], [0, 4, 3]]), np.array([0]), 5)
