"""Create small surfaces and volumes for examples and for trying out voxflat."""

import numpy as np
from numpy.typing import NDArray

from voxflat.io.volumes import Volume
from voxflat.pipeline.surface import Surface, surface

__all__ = ["ball", "hill", "rim"]


def hill() -> Surface:
    """Return a square surface with a hill in the middle.

    The square has sides of 40 mm and 441 vertices, and the hill is 10 mm high.

    Returns
    -------
    Surface
        A mesh surface with one boundary loop.

    See Also
    --------
    ball : Return a label volume with a closed surface.

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
    """Return a label volume of a ball.

    The volume has 24 voxels of 1 mm along each axis. The ball has a radius of 8 mm and the label 3.

    Returns
    -------
    ndarray of uint8, shape (24, 24, 24)
        The labels: 3 inside the ball and 0 elsewhere.

    See Also
    --------
    hill : Return a surface with a boundary.

    Examples
    --------
    >>> voxflat.surface(voxflat.samples.ball())
    <Surface from voxels: 632 vertices, 1260 triangles>
    """
    places = np.indices((24, 24, 24)) - 11.5
    return np.where(np.linalg.norm(places, axis=0) < 8, 3, 0).astype(np.uint8)


def rim() -> Volume:
    """Return a segmentation of the grey matter of a gyrus, as used for layer fMRI.

    The grey matter is half a cylinder, 8 mm long, between radii of 4.5 and 7 mm, with voxels of 0.4 mm.

    Returns
    -------
    Volume
        The labels: 1 at the outer border, 2 at the inner border, 3 in the grey matter, and 0 elsewhere.

    See Also
    --------
    voxflat.rim : Measure depth in such a segmentation.

    Examples
    --------
    >>> voxflat.samples.rim()
    <Volume: 40 x 20 x 20 of uint8, voxels of 0.4 x 0.4 x 0.4 mm, RAS>
    """
    x, y, _ = np.indices((40, 20, 20)) * 0.4
    radius = np.hypot(x - 7.8, y)
    labels = np.select([radius < 3.7, radius < 4.5, radius < 7, radius < 7.8], [0, 2, 3, 1], 0)
    return Volume(labels.astype(np.uint8), np.diag([0.4, 0.4, 0.4, 1.0]))
