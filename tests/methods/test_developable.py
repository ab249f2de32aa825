"""The map of a surface that can be flattened without distortion is exact."""

import developable_shapes
import numpy as np
import pytest
import shapes
from developable_shapes import SHAPES, angle_changes, edge_ratios

import voxflat
from voxflat.methods import Voxflat


def is_exact(flat, longer=1e-4, turned=0.01):
    """Return whether no edge is longer or shorter by more than a fraction, and no angle differs by more degrees."""
    surface = flat.points, flat.faces, flat.uv
    return np.abs(edge_ratios(*surface) - 1).max() < longer and angle_changes(*surface).max() < turned


def folds(flat):
    triangles = flat.distortion.triangles
    return triangles.flipped, triangles.covering, triangles.crossings


@pytest.mark.parametrize("shape", SHAPES)
def test_the_flat_shape_has_the_lengths_of_the_one_in_space_and_no_fold(shape):
    points, faces, flat = shape()
    np.testing.assert_allclose(edge_ratios(points, faces, flat), 1, rtol=0, atol=1e-12)
    first, second = np.moveaxis(flat[faces[:, 1:]] - flat[faces[:, :1]], 1, 0)
    doubled_areas = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    assert np.abs(np.sign(doubled_areas).sum()) == len(faces)


@pytest.mark.medium
@pytest.mark.parametrize("shape", SHAPES)
def test_a_developable_surface_keeps_its_lengths_and_angles_without_a_cut(shape):
    points, faces, _ = shape()
    flat = voxflat.flatten((points, faces))
    assert is_exact(flat)
    assert folds(flat) == (0, 0, 0)
    assert len(flat) == len(points)


@pytest.mark.slow
@pytest.mark.parametrize("shape", [developable_shapes.u_scroll, developable_shapes.spiral, developable_shapes.cone])
def test_several_levels_are_exact_too(shape):
    points, faces, _ = shape(3)
    flat = voxflat.flatten((points, faces))
    assert is_exact(flat)
    assert folds(flat) == (0, 0, 0)


@pytest.mark.medium
@pytest.mark.parametrize(
    "options", [{"weighting": 0}, {"weighting": 1}, {"scale": "areas"}, {"max_area": 1.01}, {"sources": 20}]
)
def test_exact_maps_do_not_depend_on_options(options):
    points, faces, _ = developable_shapes.u_shape()
    assert is_exact(voxflat.flatten((points, faces), Voxflat(**options)))


@pytest.mark.medium
def test_a_distorted_start_becomes_exact():
    points, faces, flat = developable_shapes.comb()
    start = flat + 0.003 * flat[:, ::-1] ** 2 * [0, 1]
    assert is_exact(voxflat.flatten((points, faces), Voxflat(start=start)))


@pytest.mark.medium
def test_a_flat_sheet_of_voxels_with_a_notch_keeps_its_lengths_and_angles():
    volume = shapes.sheet((30, 30))
    volume[11:21, 9:, 1] = 0
    assert is_exact(voxflat.surface(volume, spacing=(1, 1, 1)).flatten())
