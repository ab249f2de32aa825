"""Convert points and shapes in the viewer to seed points (voxels or vertices) and to corners of a polygon."""

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np
from napari.layers import Layer, Points, Shapes, Surface
from napari.utils.geometry import find_nearest_triangle_intersection
from numpy.typing import NDArray

from voxflat._napari.layers.volumes import finest
from voxflat._napari.layers.world import LayerPlace, data_to_world, in_units_of, moved
from voxflat.errors import InputError

Voxel: TypeAlias = tuple[int, int, int]
Seed: TypeAlias = Voxel | int  # a voxel of a volume, or the index of a mesh vertex

# the display of a seed point; this blending makes the point visible through the surface in 3D
MARKER = {"name": "seed point", "size": 6, "symbol": "cross", "face_color": "#ffd23f", "border_width": 0}
MARKER |= {"blending": "translucent_no_depth"}


def corners(drawn: Points | Shapes, world: str, unit: str) -> NDArray[np.float64]:
    """Return polygon corners (all points, or the selected or last shape) in RAS+; raises InputError if too few."""
    corners = drawn.data
    if isinstance(drawn, Shapes) and len(corners):
        chosen = sorted(drawn.selected_data)
        corners = corners[chosen[0] if len(chosen) == 1 else -1]
    if len(corners) < 3:
        count = f"{len(corners)} corner{'s' * (len(corners) != 1)}"
        raise InputError(f"The polygon in layer '{drawn.name}' has {count}. Draw at least 3 corners")
    return moved(corners, LayerPlace.of(drawn, world, unit=unit).affine)


def seed_of(points: Points, layer: Layer) -> Seed | None:
    """Return the voxel or vertex of a layer at the selected or last point of a Points layer; None outside the layer."""
    place = _chosen(points, layer)
    return None if place is None else seed_at(layer, place)


def seed_at(layer: Layer, position: NDArray[np.float64]) -> Seed | None:
    """Return the voxel at a position or the vertex nearest to it; the position is in the units of the layer."""
    return nearest_vertex(layer, position) if isinstance(layer, Surface) else voxel_at(layer, position)


def data_place(layer: Layer, seed: Seed) -> NDArray[Any]:
    return np.asarray(layer.vertices[seed] if isinstance(layer, Surface) else seed)


def describe(points: Points, layer: Layer) -> str:
    """Describe the voxel or vertex of a layer that a Points layer selects."""
    place = _chosen(points, layer)
    seed = None if place is None else seed_at(layer, place)
    if seed is None:
        return "no point within the layer"
    if not isinstance(seed, int):
        return f"voxel {seed[0]}, {seed[1]}, {seed[2]}"
    apart = f"{np.linalg.norm(layer.data_to_world(data_place(layer, seed)) - place):.1f}"
    return f"vertex {seed}" + ("" if apart == "0.0" else f", {apart} {layer.units[0]:~} away")


def _chosen(points: Points, layer: Layer) -> NDArray[np.float64] | None:
    """Return the selected or last point, in world coordinates and the units of the layer."""
    if len(points.data) == 0 or points.ndim < 3:
        return None
    selected = sorted(n for n in points.selected_data if n < len(points.data))  # while points are removed
    number = selected[0] if len(selected) == 1 else len(points.data) - 1
    return in_units_of(layer, points.data_to_world(points.data[number]), points.units)


def voxel_at(layer: Layer, position: Sequence[float] | NDArray[np.float64]) -> Voxel | None:
    """Return the voxel of a layer at a position in the units of the layer, or None if it is outside the layer."""
    index = np.round(layer.world_to_data(position)).astype(int)
    return _triple(index) if np.all((index >= 0) & (index < finest(layer).shape[:3])) else None


def first_voxel(
    layer: Layer, start: NDArray[np.float64], end: NDArray[np.float64], inside: Callable[[NDArray[Any]], NDArray[Any]]
) -> Voxel | None:
    """Return the first foreground voxel along a ray, given by its ends in voxel indices."""
    data = finest(layer)
    steps = np.linspace(0, 1, 2 + int(4 * np.linalg.norm(end - start)))[:, None]
    voxels = np.round(start + steps * (end - start)).astype(int)
    voxels = voxels[np.all((voxels >= 0) & (voxels < data.shape[:3]), axis=1)]
    values = np.asarray(getattr(data, "vindex", data)[tuple(voxels.T)])  # dask and zarr need vindex for single voxels
    hits = np.flatnonzero(inside(values))
    return _triple(voxels[hits[0]]) if len(hits) else None


def _triple(index: NDArray[Any]) -> Voxel:
    i, j, k = (int(n) for n in index)
    return i, j, k


def nearest_vertex(layer: Surface, position: Sequence[float] | NDArray[np.float64]) -> int | None:
    """Return the vertex nearest to a position in the units of the layer; vertices without a face are ignored."""
    vertices, faces = layer.vertices, np.asarray(layer.faces)
    used = np.zeros(len(vertices), dtype=np.bool_)
    used[faces[(faces >= 0) & (faces < len(vertices))]] = True  # invalid indices are reported during flattening
    apart = np.linalg.norm(moved(vertices, data_to_world(layer)) - position, axis=1)
    apart[~used | np.isnan(apart)] = np.inf
    return int(apart.argmin()) if np.isfinite(apart).any() else None


def first_vertex(layer: Surface, start: NDArray[np.float64], end: NDArray[np.float64]) -> int | None:
    """Return the vertex nearest to the point where a ray, given by its ends in data coordinates, first meets a mesh."""
    vertices, faces = np.asarray(layer.vertices, dtype=np.float64), np.asarray(layer.faces)
    along = (end - start) / np.linalg.norm(end - start)
    face, place = find_nearest_triangle_intersection(start, along, vertices[faces])
    if face is None:
        return None
    corners, affine = faces[face], data_to_world(layer)
    apart = np.linalg.norm(moved(vertices[corners] - place, affine) - affine[:3, 3], axis=1)
    return int(corners[apart.argmin()])
