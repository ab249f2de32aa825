"""Surfaces that are hard to flatten have finite maps without folds, or raise a clear error."""

from functools import cache

import hard_shapes
import numpy as np
import pytest

import voxflat


@cache
def usual_map(shape):
    return voxflat.flatten(hard_shapes.surface(shape))


@pytest.mark.slow
@pytest.mark.parametrize("shape", hard_shapes.MESHES + hard_shapes.VOLUMES)
def test_maps_are_finite_without_folds_and_it_is_told_if_they_did_not_converge(shape):
    made = usual_map(shape)
    assert np.isfinite(made.uv).all()
    figures = made.distortion.figures()
    assert np.isfinite([figures["raw"]["relative_error"], figures["raw"]["stress_1"]]).all()
    assert np.isfinite(made.metadata["descent"]["energies"]).all()
    triangles = made.distortion.triangles
    assert (triangles.flipped, triangles.collapsed, triangles.covering, triangles.crossings) == (0, 0, 0, 0)
    signed = hard_shapes.signed_areas(made.uv, made.faces)
    assert (signed > 0).all() or (signed < 0).all()
    told = any("before it converged" in warning for warning in made.metadata["warnings"])
    assert told == (not made.metadata["descent"]["converged"])


@pytest.mark.medium
@pytest.mark.parametrize("shape", [hard_shapes.long_strip, hard_shapes.densities, hard_shapes.slivers])
def test_sheets_that_unroll_do(shape):
    flat = usual_map(shape).distortion
    assert flat.raw.relative_error < 2e-3
    assert flat.triangles.edge < 2e-3


@pytest.mark.slow
@pytest.mark.parametrize("shape", [hard_shapes.pocket, hard_shapes.sphere_with_pinhole])
def test_a_surface_without_a_good_map_is_told_and_cuts_help(shape):
    poor, cut = voxflat.flatten(hard_shapes.surface(shape), relax=False), usual_map(shape)
    assert poor.distortion.best_scale.relative_error > 0.3
    assert any("even at the best scale" in text for text in poor.metadata["warnings"])
    assert cut.distortion.best_scale.relative_error < 0.2
    assert not any("even at the best scale" in text for text in cut.metadata["warnings"])


@pytest.mark.parametrize("method", ["voxflat", "zigelman2002", "schwartz1989"])
@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_triangles(count, method):
    angle = np.linspace(0, 2, count + 2)[:-1]
    points = np.vstack([np.zeros(3), np.column_stack([10 * np.cos(angle), 10 * np.sin(angle), 0 * angle])])
    faces = np.array([[0, corner, corner + 1] for corner in range(1, count + 1)])
    assert voxflat.flatten((points, faces), method).distortion.triangles.edge < 1e-3
