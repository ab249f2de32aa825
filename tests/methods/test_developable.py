"""Surfaces that can be flattened without distortion, by which maps are judged."""

import numpy as np
import pytest
from developable_shapes import SHAPES, edge_ratios


@pytest.mark.parametrize("shape", SHAPES)
def test_the_flat_shape_has_the_lengths_of_the_one_in_space_and_no_fold(shape):
    points, faces, flat = shape()
    np.testing.assert_allclose(edge_ratios(points, faces, flat), 1, rtol=0, atol=1e-12)
    first, second = np.moveaxis(flat[faces[:, 1:]] - flat[faces[:, :1]], 1, 0)
    doubled_areas = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    assert np.abs(np.sign(doubled_areas).sum()) == len(faces)
