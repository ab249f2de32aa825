"""Small surfaces and volumes for examples and first tries."""

import numpy as np
from numpy.typing import NDArray

from voxflat.pipeline.surface import Surface, surface

__all__ = ["ball", "hill"]


def hill() -> Surface:
    """Return a square sheet of 40 mm with a hill of 10 mm in its middle: 441 vertices.

    Returns
    -------
    Surface

    Examples
    --------
    >>> voxflat.samples.hill().flatten()
    <FlatMap: 441 points, 42 x 42 mm, relative error 3.6 %>
    """
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-20, 20, 21), np.linspace(-20, 20, 21)))
    corners = np.arange(441).reshape(21, 21)
    a, b, c, d = (part.ravel() for part in (corners[:-1, :-1], corners[:-1, 1:], corners[1:, 1:], corners[1:, :-1]))
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return surface((np.column_stack([x, y, 10 * np.exp(-(x**2 + y**2) / 100)]), faces))


def ball() -> NDArray[np.uint8]:
    """Return a label volume, 24 voxels of 1 mm along each side, whose ball of radius 8 mm has the label 3.

    Returns
    -------
    ndarray of uint8, shape (24, 24, 24)

    Examples
    --------
    >>> voxflat.surface(voxflat.samples.ball())
    <Surface from voxels: 632 vertices, 1260 triangles>
    """
    places = np.indices((24, 24, 24)) - 11.5
    return np.where(np.linalg.norm(places, axis=0) < 8, 3, 0).astype(np.uint8)
