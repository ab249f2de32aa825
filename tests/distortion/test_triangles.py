"""Distortion of triangles and points, compared with singular values and with the core's figures."""

import numpy as np
import pytest
from hard_shapes import sheet
from numpy.testing import assert_allclose
from refusals import warnings_as_errors

import voxflat
from voxflat.distortion.triangles import isometric, measure_arrays, quasi_conformal, stretches


def test_stretches_are_the_singular_values_of_each_triangles_map():
    rng = np.random.default_rng(2)
    points, uv, faces = rng.normal(size=(300, 3)), rng.normal(size=(300, 2)), np.arange(300).reshape(-1, 3)
    for face, found in zip(faces, stretches(points, faces, uv), strict=True):
        sides = (points[face[1:]] - points[face[0]]).T  # (3, 2), in the plane of an orthonormal frame:
        frame, in_plane = np.linalg.qr(sides)
        assert_allclose(frame @ in_plane, sides, atol=1e-12)
        jacobian = (uv[face[1:]] - uv[face[0]]).T @ np.linalg.inv(in_plane)
        assert_allclose(found, np.linalg.svd(jacobian, compute_uv=False), rtol=1e-7)


def test_a_triangle_without_area_has_no_stretch_and_one_flattened_to_a_line_has_none_across():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0.0]])
    uv = np.array([[0, 0], [1, 0], [3, 0], [2, 0.0]])
    nothing, line = stretches(points, np.array([[0, 1, 3], [0, 1, 2]]), uv)
    assert np.isnan(nothing).all()
    assert_allclose(line, [np.sqrt(10), 0], atol=1e-12)
    assert np.isinf(isometric(line[None]))[0]
    assert np.isinf(quasi_conformal(line[None]))[0]


def test_figures_of_a_map_are_the_medians_of_its_arrays():
    points, faces = sheet(lambda u, v: (u - 10, v - 10, 0.06 * ((u - 10) ** 2 - (v - 10) ** 2)), (20, 20), (15, 15))
    flat_map = voxflat.flatten((points, faces), method=voxflat.methods.Voxflat(sources=20), relax=False)
    triangles = flat_map.distortion.triangles
    of_points, of_triangles = measure_arrays(flat_map.distortion, flat_map.points, flat_map.faces, flat_map.uv)
    a, b = (flat_map.points[flat_map.faces[:, k]] - flat_map.points[flat_map.faces[:, 0]] for k in (1, 2))
    areas = np.linalg.norm(np.cross(a, b), axis=1)
    for name in ("isometric", "quasi_conformal"):
        values = of_triangles[name]
        order = np.argsort(values)
        half = np.searchsorted(np.cumsum(areas[order]), areas.sum() / 2)
        low, high = values[order][[half - 1, half + 1]]
        assert low <= getattr(triangles, name) <= high
    assert np.average(of_points["angle"]) == pytest.approx(triangles.angle, rel=0.2)  # by points, not by areas
    assert_allclose(np.sort(np.abs(of_points["areal"]))[len(points) // 2], triangles.areal_median, rtol=0.02)
    names = {"distance_error", "areal", "angle", "isometric", "quasi_conformal", "flipped"}
    assert set(of_points) | set(of_triangles) == names
    assert of_triangles["flipped"].sum() == triangles.flipped == 0


def test_the_thinnest_triangles_are_stretched_infinitely_without_a_warning():
    thin = np.array([[1e200, 1e-200], [1.0, 5e-324]])
    with warnings_as_errors():
        assert_allclose(quasi_conformal(thin), np.inf)
        assert_allclose(isometric(thin), [1e200, np.inf])
