"""Pictures, and surfaces for them."""

import os
import sys

import numpy as np
import pytest
import pyvista as pv

needs_window = pytest.mark.skipif(
    sys.platform == "linux" and "DISPLAY" not in os.environ and pv.vtk_version_info < (9, 4),
    reason="this VTK draws only with a display",
)


def chessboard(squares=8, texels=8, shape=None):
    """Draw a chessboard whose upper left square is white."""
    rows, columns = shape or (squares, squares)
    grey = np.indices((rows, columns)).sum(axis=0) % 2 == 0
    return np.repeat(np.repeat(np.where(grey, 255, 0).astype(np.uint8), texels, axis=0), texels, axis=1)


def grid(rows, columns, step=1.0):
    y, x = np.mgrid[:rows, :columns] * step
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    lower = np.column_stack([corner, corner + 1, corner + columns])
    upper = np.column_stack([corner + 1, corner + columns + 1, corner + columns])
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]), np.concatenate([lower, upper])


def cylinder(rows=25, columns=41, radius=10.0):
    """Bend a rectangle of 24 x 40 mm into two thirds of a cylinder, which hardly changes its triangles."""
    points, faces = grid(rows, columns)
    angle = points[:, 0] / radius
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), points[:, 1]]), faces


def areas(points, faces):
    a, b, c = points[faces].transpose(1, 0, 2)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def side_counts(faces):
    sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    return np.unique(sides, axis=0, return_counts=True)
