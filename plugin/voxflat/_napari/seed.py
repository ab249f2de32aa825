"""Seed points: from places in the viewer to voxels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from voxflat._napari.volumes import finest, unit_ratio

if TYPE_CHECKING:
    from napari.layers import Layer, Points

Voxel: TypeAlias = tuple[int, int, int]

MARKER = {
    "name": "seed point",
    "size": 6,
    "symbol": "cross",
    "face_color": "#ffd23f",
    "border_width": 0,
    "blending": "translucent_no_depth",  # in 3D it is seen through the surface
}
"""How a seed point looks in the viewer: keywords of a Points layer."""


def seed_voxel(points: Points, layer: Layer) -> Voxel | None:
    """Look up which voxel of a layer a Points layer names: at its selected point, else at the last one.

    Parameters
    ----------
    points : Points
        The points.
    layer : Layer
        Of three dimensions.

    Returns
    -------
    tuple of 3 ints, or None
        None if there is no point, or it lies outside the layer.
    """
    if len(points.data) == 0 or points.ndim < 3:
        return None
    selected = sorted(points.selected_data)
    number = selected[0] if len(selected) == 1 else len(points.data) - 1
    return voxel_at(layer, in_units_of(layer, points.data_to_world(points.data[number]), points.units))


def in_units_of(layer: Layer, position: Sequence[float], units: Sequence[Any] | None) -> NDArray[np.float64]:
    """Convert a place in the viewer to a layer's units.

    Parameters
    ----------
    layer : Layer
        Of three dimensions.
    position : sequence of floats
        In the world; of more than three numbers the last three are taken.
    units : sequence of pint.Unit, or None
        The position's units; None where they cannot be compared, so that nothing is converted.

    Returns
    -------
    ndarray, shape (3,)
    """
    place = np.asarray(position, dtype=np.float64)[-3:]
    return place if units is None else place * unit_ratio(tuple(units)[-3:], layer.units)


def voxel_at(layer: Layer, position: Sequence[float] | NDArray[np.float64]) -> Voxel | None:
    """Look up which voxel of a layer lies at a place.

    Parameters
    ----------
    layer : Layer
        Of three dimensions.
    position : sequence of 3 floats
        In the world, in the layer's units.

    Returns
    -------
    tuple of 3 ints, or None
        None outside the layer.
    """
    index = np.round(layer.world_to_data(position)).astype(int)
    return _triple(index) if np.all((index >= 0) & (index < finest(layer).shape[:3])) else None


def first_voxel(
    layer: Layer, start: NDArray[np.float64], end: NDArray[np.float64], inside: Callable[[NDArray[Any]], NDArray[Any]]
) -> Voxel | None:
    """Look up which voxel of the foreground a ray meets first.

    Parameters
    ----------
    layer : Layer
        Of three dimensions.
    start, end : ndarray, shape (3,)
        The ray's ends in voxel indices.
    inside : callable
        Whether values are foreground.

    Returns
    -------
    tuple of 3 ints, or None
    """
    data = finest(layer)
    steps = np.linspace(0, 1, 2 + int(4 * np.linalg.norm(end - start)))[:, None]
    voxels = np.round(start + steps * (end - start)).astype(int)
    voxels = voxels[np.all((voxels >= 0) & (voxels < data.shape[:3]), axis=1)]
    values = np.asarray(getattr(data, "vindex", data)[tuple(voxels.T)])  # dask and zarr index point by point so
    hits = np.flatnonzero(inside(values))
    return _triple(voxels[hits[0]]) if len(hits) else None


def _triple(index: NDArray[Any]) -> Voxel:
    i, j, k = (int(n) for n in index)
    return i, j, k
