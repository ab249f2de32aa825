"""Create small surfaces and volumes for examples and for trying out voxflat."""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from voxflat.arguments import is_whole, shown
from voxflat.errors import InputError
from voxflat.io.volumes import Volume
from voxflat.pipeline.surface import Surface, surface
from voxflat.read_only import ReadOnly

__all__ = ["Embryo", "ball", "embryo", "hill", "rim"]


def __dir__() -> list[str]:
    return sorted(__all__)


_NUCLEI = 300
_VOXEL = np.array([2.5, 2.5, 5.0])  # µm
_GRID = (100, 50, 20)  # voxels
_CORNER = np.array([-123.75, -48.75, -47.5])  # µm, the centre of the first voxel


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
    <FlatMap: 441 points, 42 x 42 mm, relative error 3.6 % of interior pairs, 3.6 % of all pairs at the best scale>
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


@dataclass(frozen=True, eq=False)
class Embryo(ReadOnly):
    """Store a synthetic movie of an embryo.

    The true positions of the nuclei show how well a method follows the movement.

    Parameters
    ----------
    images : tuple of Volume
        The intensities of each frame: uint8, in µm.
    labels : tuple of Volume
        The segmentation of each frame: 1 inside the embryo and 0 elsewhere.
    points : ndarray of float64, shape (T, 300, 3)
        Position in µm of the place on the surface above each nucleus, in each frame.

    See Also
    --------
    embryo : Make such a movie.

    Examples
    --------
    >>> voxflat.samples.embryo(frames=2)
    <Embryo: 2 frames, 300 nuclei>
    """

    images: tuple[Volume, ...]
    labels: tuple[Volume, ...]
    points: NDArray[np.float64]

    def __repr__(self) -> str:
        return f"<Embryo: {len(self.labels)} frames, {self.points.shape[1]} nuclei>"


def embryo(frames: int = 6) -> Embryo:
    """Return a synthetic movie of an embryo that grows and bends.

    The embryo is an ellipsoid of 180 x 80 x 70 µm. From the first to the last frame, it grows by 25 % in length and by
    10 % in width and height, and bends from 10 to 60 degrees. The voxels measure 2.5 x 2.5 x 5 µm. The nuclei are 4 µm
    below the surface and form seven bright stripes.

    Parameters
    ----------
    frames : int
        Number of frames.

    Returns
    -------
    Embryo
        The frames and the true positions of the nuclei.

    Raises
    ------
    InputError
        The number of frames is not a positive whole number.

    See Also
    --------
    voxflat.flatten_series : Flatten all frames of a movie with one map.

    Examples
    --------
    >>> embryo = voxflat.samples.embryo()
    >>> embryo.images[0]
    <Volume: 100 x 50 x 20 of uint8, voxels of 2.5 x 2.5 x 5 µm, RAS>
    >>> series = voxflat.flatten_series([voxflat.surface(labels) for labels in embryo.labels[:2]])
    """
    if not is_whole(frames) or frames < 1:
        raise InputError(f"the number of frames is {shown(frames)}. Pass a positive whole number")
    affine = np.diag([*_VOXEL, 1.0])
    affine[:3, 3] = _CORNER
    voxels = np.moveaxis(np.indices(_GRID), 0, -1) * _VOXEL + _CORNER
    directions = _nuclei()
    brightness = np.where(np.cos(7 * np.pi * directions[:, 0]) > 0, 1.0, 0.35)
    images: list[Volume] = []
    labels: list[Volume] = []
    points: list[NDArray[np.float64]] = []
    for time in np.linspace(0, 1, frames):
        sides = np.array([90 * (1 + 0.25 * time), 40 * (1 + 0.1 * time), 35 * (1 + 0.1 * time)])
        radius = 2 * sides[0] / np.radians(10 + 50 * time)
        straight = voxels.copy()
        straight[..., 0] = radius * np.arctan2(voxels[..., 0], radius - voxels[..., 1])
        straight[..., 1] = radius - np.hypot(voxels[..., 0], radius - voxels[..., 1])
        depth = 1 - np.linalg.norm(straight / sides, axis=-1)
        outward = directions / sides
        below = directions * sides - 4 * outward / np.linalg.norm(outward, axis=1, keepdims=True)
        blobs = _blobs(_bent(below, radius), brightness)
        tissue = 0.12 * np.exp(-((depth / 0.3) ** 2)) * (depth > 0)
        noise = np.random.default_rng(len(images)).normal(0.02, 0.01, _GRID)
        image = np.clip(blobs + tissue + noise, 0, 1)
        images.append(Volume(np.round(255 * image).astype(np.uint8), affine, unit="µm"))
        labels.append(Volume((depth > 0).astype(np.uint8), affine, unit="µm"))
        points.append(_bent(directions * sides, radius))
    return Embryo(tuple(images), tuple(labels), np.array(points))


def _nuclei() -> NDArray[np.float64]:
    """Return positions on the unit sphere that are evenly distributed on the ellipsoid of the first frame."""
    fine = np.linspace(-1, 1, 2001)
    area = np.cumsum(np.sqrt(1 - (1 - (37.5 / 90) ** 2) * fine**2))
    step = np.arange(_NUCLEI)
    x = np.interp((step + 0.5) / _NUCLEI, area / area[-1], fine)
    turn = step * np.pi * (1 + np.sqrt(5))
    return np.column_stack([x, *(np.sqrt(1 - x**2) * wave(turn) for wave in (np.cos, np.sin))])


def _bent(points: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
    """Bend positions so that the x axis becomes an arc with a radius."""
    x, y, z = points.T
    return np.column_stack([(radius - y) * np.sin(x / radius), radius - (radius - y) * np.cos(x / radius), z])


def _blobs(centres: NDArray[np.float64], brightness: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return blurred spots at positions in µm."""
    places = (centres - _CORNER) / _VOXEL
    first = np.floor(places).astype(np.int64)
    spots = np.zeros(_GRID)
    for corner in np.ndindex(2, 2, 2):
        weights = np.prod(np.where(corner, places - first, 1 + first - places), axis=1)
        np.add.at(spots, tuple((first + corner).T), weights * brightness)
    sigma = 2.6 / _VOXEL
    return np.asarray(scipy.ndimage.gaussian_filter(spots, sigma) * (2 * np.pi) ** 1.5 * np.prod(sigma) * 0.8)
