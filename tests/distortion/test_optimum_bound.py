"""The lower bound of the benchmarks: no places in the plane may beat it."""

import numpy as np
import optimum_bound
import pytest
from scipy.optimize import minimize


def on_sphere(count, degrees, seed):
    """Great-circle distances between random points of a cap of the unit sphere."""
    rng = np.random.default_rng(seed)
    z = 1 - (1 - np.cos(np.radians(degrees))) * rng.random(count)
    angle = 2 * np.pi * rng.random(count)
    points = np.stack([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z], 1)
    distances = np.arccos(np.clip(points @ points.T, -1, 1))
    np.fill_diagonal(distances, 0)
    return distances


def least_found(distances, starts):
    """The least mean of |d/δ − 1| that search finds, from random places, by ever sharper |x|."""
    count = len(distances)
    first, second = np.triu_indices(count, 1)
    wanted = distances[first, second]
    rng = np.random.default_rng(0)

    def smooth(flat, sharp):
        places = flat.reshape(count, 2)
        way = places[first] - places[second]
        length = np.hypot(*way.T) + 1e-12
        error = length / wanted - 1
        size = np.hypot(error, sharp)
        pull = (error / size / wanted / length)[:, None] * way
        slope = np.zeros((count, 2))
        np.add.at(slope, first, pull)
        np.add.at(slope, second, -pull)
        return size.mean(), slope.ravel() / len(wanted)

    found = []
    for _ in range(starts):
        flat = rng.normal(size=2 * count) * wanted.mean()
        for sharp in (0.1, 1e-2, 1e-3, 1e-5):
            flat = minimize(smooth, flat, args=(sharp,), jac=True, method="L-BFGS-B").x
        found.append(smooth(flat, 0.0)[0])
    return min(found)


@pytest.mark.slow
@pytest.mark.parametrize(("count", "degrees"), [(4, 20), (4, 140), (6, 60), (6, 140)])
def test_no_search_beats_it(count, degrees):
    distances = on_sphere(count, degrees, 1)
    bound = optimum_bound.least_error(distances)
    assert bound > 0
    assert bound <= least_found(distances, 6) + 1e-9


@pytest.mark.slow
def test_it_is_near_what_four_points_cost():
    shares = []
    for seed in range(4):
        distances = on_sphere(4, 40, seed)
        shares.append(optimum_bound.least_error(distances) / least_found(distances, 5))
    assert np.median(shares) > 0.5


@pytest.mark.slow
def test_random_distances_of_four_points_are_not_beaten():
    rng = np.random.default_rng(4)
    for _ in range(4):
        distances = np.ones((4, 4)) + rng.uniform(0, 1, (4, 4))  # any from 1 to 2 are those of some space
        distances = np.triu(distances, 1) + np.triu(distances, 1).T
        assert optimum_bound.least_error(distances) <= least_found(distances, 8) + 1e-9


def test_in_the_plane_it_is_nothing():
    places = np.random.default_rng(1).random((12, 2))
    assert optimum_bound.least_error(np.linalg.norm(places[:, None] - places[None], axis=2)) < 1e-12


def test_areas_are_the_least_of_the_box():
    rng = np.random.default_rng(2)
    sides = rng.uniform(1, 1.9, (200, 3))
    least = optimum_bound._least_area(*sides.T, 0.05)
    for _ in range(50):
        a, b, c = (sides * rng.uniform(0.95, 1.05, sides.shape)).T
        half = (a + b + c) / 2
        area = np.sqrt(np.maximum(half * (half - a) * (half - b) * (half - c), 0))
        assert (area >= least - 1e-12).all()


def test_the_sixth_distance_changes_no_faster_than_is_said():
    rng = np.random.default_rng(3)
    for seed in range(20):
        distances = on_sphere(4, 50, 100 + seed)[None]
        radius = 0.03
        most = optimum_bound._swiftest(distances, np.array([radius]))[0]

        def sixth(five, sign):
            a, b, e, c, f = five
            x, y = ((a * a + p * p - q * q) / (2 * a) for p, q in ((b, c), (e, f)))
            return np.hypot(x - y, np.sqrt(b * b - x * x) + sign * np.sqrt(e * e - y * y))

        (d,) = distances
        own = np.array([d[0, 1], d[0, 2], d[0, 3], d[1, 2], d[1, 3]])
        if not np.isfinite(most):
            continue
        for _ in range(20):
            five, step = own * (1 + rng.uniform(-radius, radius, 5)), rng.uniform(-1e-6, 1e-6, 5)
            for sign in (-1, 1):
                change = (sixth(five + own * step, sign) - sixth(five, sign)) / d[2, 3]
                assert abs(change) <= most * np.abs(step).sum() * (1 + 1e-3)
