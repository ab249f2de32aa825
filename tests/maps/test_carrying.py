"""A flat map that is carried to another mesh is repaired: `voxflat.maps.carrying`."""

import numpy as np
import pytest
from mesh_files import grid

import voxflat
from voxflat.maps.carrying import _repaired

COLUMNS = 60


def folds(uv, faces):
    surface = voxflat.surface((np.pad(uv, ((0, 0), (0, 1))), faces))
    of = surface.core.measure(uv)
    return of["flipped"], of["crossings"]


@pytest.fixture
def ring():
    """Return a ring whose ends overlap slightly."""
    faces = grid(5, columns=COLUMNS).faces
    radius, angle = np.indices((5, COLUMNS)).reshape(2, -1)
    radius, angle = 4 + radius, 2.005 * np.pi * angle / (COLUMNS - 1)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)]), faces


def test_ends_that_overlap_are_drawn_apart(ring):
    uv, faces = ring
    assert folds(uv, faces) > (0, 0)
    found = _repaired(uv.copy(), faces)
    assert folds(found, faces) == (0, 0)
    moved = np.flatnonzero((found != uv).any(axis=1)) % COLUMNS
    assert set(np.minimum(moved, COLUMNS - 1 - moved)) <= {0, 1}


def test_a_flipped_triangle_is_unfolded(ring):
    uv, faces = ring
    uv = _repaired(uv, faces)
    folded = uv.copy()
    folded[2 * COLUMNS + 30] += [0.0, -3.0]
    assert folds(folded, faces)[0] > 0
    found = _repaired(folded.copy(), faces)
    assert folds(found, faces) == (0, 0)
    assert np.linalg.norm(found - uv, axis=1).max() < 1
