"""The measures agree with those of the core, with loops over all pairs, and with known values."""

import numpy as np
import pytest

import voxflat
from voxflat.benchmark.measures import (
    best_scale,
    distance_measures,
    distances_on_map,
    neighbours,
    others_distance_measures,
    triangle_measures,
)
from voxflat.benchmark.truth import distances

BANDS = (5.0, 10.0, 15.0, 30.0)


@pytest.fixture(scope="module")
def hill():
    surface = voxflat.samples.hill()
    uv = np.random.default_rng(1).normal(0, 0.4, (len(surface), 2)) + surface.points[:, :2]
    sources = np.arange(0, len(surface), 11)
    faces = surface.faces.astype(np.int64)
    return surface, uv, sources, faces, distances(surface.points, faces, sources).astype(float)


def test_distance_errors_are_those_of_the_core(hill):
    surface, uv, sources, _, rows = hill
    measures, _ = distance_measures(rows, distances_on_map(uv, sources), BANDS)
    (judged,) = surface.core.judge([uv], sources.astype(np.uint32), "exact", 1 << 30, 0, BANDS)
    for name, value in measures.items():
        assert value == pytest.approx(judged["best_scale"][name], rel=1e-5), name


def test_no_scale_is_better_than_the_best(hill):
    _, uv, sources, _, rows = hill
    flat = distances_on_map(uv, sources)
    apart = rows > 0

    def error(scale):
        return np.mean(np.abs(scale * flat[apart] - rows[apart]) / rows[apart])

    best = best_scale(rows, flat)
    assert all(error(best) <= error(best * factor) for factor in (0.9, 0.99, 0.999, 1.001, 1.01, 1.1))
    assert best_scale(rows, 3 * flat) == pytest.approx(best / 3)


def test_measures_of_others_are_their_formulas_over_all_pairs(hill):
    _, uv, sources, faces, rows = hill
    found = others_distance_measures(rows, distances_on_map(uv, sources), faces, sources)
    every, local, near = [], [], []
    adjacent = [set() for _ in uv]
    for a, b, c in faces.tolist():
        for first, second in ((a, b), (b, c), (c, a)):
            adjacent[first].add(second)
            adjacent[second].add(first)
    for row, source in zip(rows, sources.tolist(), strict=True):
        reached = ring = {source}
        for _ in range(7):
            ring = {other for vertex in ring for other in adjacent[vertex]} - reached
            reached = reached | ring
        for vertex in range(len(uv)):
            if vertex == source:
                continue
            d, true = np.linalg.norm(uv[vertex] - uv[source]), row[vertex]
            every.append(abs(d - true) / true)
            if true <= 30:
                local.append(every[-1])
            if vertex in reached:
                near.append((abs(d - true), true))
    assert found["autoflatten_global"] == pytest.approx(np.mean(every))
    d, true = distances_on_map(uv, sources)[rows > 0], rows[rows > 0]
    of_scales = [np.mean(np.abs(scale * d - true) / true) for scale in np.linspace(0.80, 1.25, 91)]
    assert found["autoflatten_global_best_scale"] == pytest.approx(min(of_scales))
    assert found["autoflatten_local"] == pytest.approx(np.mean(local))
    apart, true = np.array(near).T
    assert found["freesurfer_error"] == pytest.approx(apart.sum() / true.sum())
    assert found["fischl_jd"] == pytest.approx((apart**2).sum() / (4 * len(sources)))
    assert neighbours(faces, sources, len(uv)).sum() == len(near) + len(sources)


def test_a_perfect_map_has_no_errors_at_any_scale():
    flat = np.random.default_rng(2).uniform(0, 40, (300, 2))
    from scipy.spatial import Delaunay

    faces = Delaunay(flat).simplices.astype(np.int64)
    points = np.pad(flat, ((0, 0), (0, 1)))
    surface = voxflat.surface((points, faces))
    uv, sources = 2.5 * surface.points[:, :2], np.arange(20)
    rows = distances(surface.points, surface.faces.astype(np.int64), sources).astype(float)
    measures, errors = distance_measures(rows, distances_on_map(uv, sources), BANDS)
    assert measures.pop("scale") == pytest.approx(0.4)
    assert max(measures.values()) < 1e-6
    assert max(value for name, value in errors.items() if name != "scale") < 1e-6
    triangles = triangle_measures(surface.core, uv, 0.4)
    assert triangles["symmetric_dirichlet_mean"] == pytest.approx(4)
    assert triangles["edge"] < 1e-9
    assert triangles["flipped"] == triangles["covering"] == 0


@pytest.mark.medium
def test_standard_errors_predict_the_spread_over_samples_of_sources(hill):
    _, uv, _, _, _ = hill
    surface = hill[0]
    faces = surface.faces.astype(np.int64)
    rows = distances(surface.points, faces, np.arange(len(uv))).astype(float)
    flat = distances_on_map(uv, np.arange(len(uv)))
    rng = np.random.default_rng(3)
    found, scale = [], best_scale(rows, flat)
    for _ in range(200):
        chosen = rng.choice(len(uv), 30, replace=True)
        measures, errors = distance_measures(rows[chosen], flat[chosen], BANDS, scale)
        found.append([(measures[name], errors[name]) for name in ("relative_error", "relative_error_10mm", "stress_1")])
    values, predicted = np.array(found).transpose(2, 1, 0)
    np.testing.assert_allclose(values.std(axis=1), predicted.mean(axis=1), rtol=0.2)


def test_unconnected_vertices_are_no_pairs():
    points = np.array([[0, 0, 0], [3, 0, 0], [0, 4, 0], [50, 0, 0], [53, 0, 0], [50, 4, 0]], dtype=float)
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    rows = distances(points, faces, np.array([0, 3]))
    np.testing.assert_allclose(rows, [[0, 3, 4, *3 * [np.inf]], [*3 * [np.inf], 0, 3, 4]])
    measures, _ = distance_measures(
        rows.astype(float), distances_on_map(points[:, :2] * [1, 2], np.array([0, 3])), BANDS
    )
    assert measures["relative_error"] == pytest.approx(0.25)
    assert measures["scale"] in (0.5, 1)
