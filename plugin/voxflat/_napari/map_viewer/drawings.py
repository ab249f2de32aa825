"""Drawings on a map, projected onto the surface: points, regions, and the shortest path between two points."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from napari import Viewer
from napari.layers import Labels, Layer, Points, Shapes, Surface
from numpy.typing import NDArray

from voxflat._napari.layers.world import MADE_FROM, from_ras
from voxflat._napari.map_viewer.prepared_map import PreparedMap
from voxflat._napari.results.flat_layers import LayerData, units
from voxflat._napari.results.layer_list import insert
from voxflat.errors import InputError
from voxflat.io.volumes import Volume
from voxflat.maps.flat_map import FlatMap
from voxflat.pipeline.surface import surface

Place: TypeAlias = tuple[float, float]  # (u, v), mm

REGIONS = "map regions"
"""Name of the layer with the regions that the user draws."""

_COLOUR = "#ffd23f"
_CORTEX = (-0.5, 3.0)  # mm outside the surface; the depths of a region if the pial surface is unknown


@dataclass(frozen=True, eq=False)
class Drawn:
    """A drawing as a layer of the viewer, and a message about it."""

    layer: LayerData
    message: str = ""


def points(prepared: PreparedMap, places: Sequence[Place]) -> Drawn:
    """Project points (u, v) on the map onto the surface."""
    spots = [spot for spot in (prepared.spot(*place) for place in places) if spot is not None]
    features = {"vertex": [str(spot.vertex) for spot in spots], "surface": [prepared.run.name] * len(spots)}
    look = {"face_color": _COLOUR, "size": 2 * prepared.thickness, "features": features}
    keywords = {"name": "map points", **look, "units": units(prepared.run.flat_map, 3)}
    return Drawn((_world(prepared, np.array([spot.point for spot in spots])), keywords, "points"))


def regions(prepared: PreparedMap, polygons: Sequence[Sequence[Place]]) -> Drawn:
    """Convert polygons on a map to voxels or vertices; raises InputError for an empty region or a page of patches."""
    flat_map = _map(prepared)
    drawn = flat_map.regions({f"region {n}": np.array(corners) for n, corners in enumerate(polygons, 1)})
    message = f"Drew {len(polygons)} region{'s' * (len(polygons) > 1)}"
    keywords: dict[str, Any] = {
        "name": REGIONS,
        "units": units(flat_map, 3),
        "metadata": {MADE_FROM: prepared.run.name},
    }
    if not flat_map.is_voxels:
        surface = (_world(prepared, prepared.points), flat_map.faces[~flat_map.torn], drawn.labels.astype(np.float32))
        look = {"colormap": "turbo", "contrast_limits": (0.0, float(len(polygons)))}
        return Drawn((surface, {**keywords, **look}, "surface"), message)
    labels = flat_map.paint(drawn.labels.astype(np.int32))
    if not np.isnan(flat_map.normals).all():  # the surface has an outer side, where the cortex lies
        grid = Volume(labels, flat_map.affine, unit=prepared.unit)
        cortex = drawn.volume(grid, depth=depth_range(prepared) if flat_map.pial_points is None else None)
        labels = np.where(labels == 0, cortex.data, labels)
    return Drawn((labels, {**keywords, "affine": affine_in_world(prepared)}, "labels"), message)


def affine_in_world(prepared: PreparedMap) -> NDArray[np.float64]:
    """Return the affine of the flattened volume to the world of the viewer."""
    to_ras = _map(prepared).affine
    corners = _world(prepared, np.vstack([np.zeros(3), np.eye(3)]) @ to_ras[:3, :3].T + to_ras[:3, 3])
    affine = np.eye(4)
    affine[:3, 3] = corners[0]
    affine[:3, :3] = (corners[1:] - corners[0]).T
    return affine


def depth_range(prepared: PreparedMap, depth: float = 0.0) -> tuple[float, float]:
    """Return the depths of regions: of the cortex or, in a tissue, a voxel on both sides, up to a depth."""
    is_cortex = prepared.unit == "mm" and prepared.run.layers.movie is None
    low, high = _CORTEX if is_cortex else (-prepared.spacing, prepared.spacing)
    return min(low, low + depth), max(high, high + depth)


def way(prepared: PreparedMap, a: Place, b: Place) -> Drawn:
    """Find the shortest path along the surface, across cuts, between two map points; raises InputError on failure."""
    flat_map = _map(prepared)
    ends = [prepared.spot(*end) for end in (a, b)]
    if None in ends:
        raise InputError("At least one of the two points is outside the map. Click on two points of the map")
    faces = flat_map.faces[~flat_map.torn].astype(np.int64)
    rows = merged = np.arange(len(flat_map))
    if not flat_map.is_voxels:  # a voxel can occur twice, where two parts of the surface touch
        rows, merged = np.unique(flat_map.ids, return_index=True, return_inverse=True)[1:]
    start, end = (int(merged[spot.row]) for spot in ends if spot is not None)
    found = surface((flat_map.points[rows], merged[faces])).path(start, end, geodesic="exact")
    flat = float(np.hypot(a[0] - b[0], a[1] - b[1]))
    unit = prepared.unit
    message = f"{found.length:.1f} {unit} along the surface, {flat:.1f} {unit} on the map"
    line = _world(prepared, flat_map.space.to_scanner(found.points))
    look = {"shape_type": "path", "edge_color": _COLOUR, "edge_width": 0.7 * prepared.thickness}
    return Drawn(([line], {"name": "shortest path", **look, "units": units(flat_map, 3)}, "shapes"), message)


def put(viewer: Viewer, data: LayerData) -> Layer:
    """Add a layer to the viewer, or replace the layer of the same name; points are added to the existing points."""
    values, keywords, kind = data
    features = keywords.get("features", {})
    earlier = next((one for one in viewer.layers if one.name == keywords["name"]), None)
    if isinstance(earlier, Points) and kind == "points" and earlier.ndim == 3:
        merged = {name: [*earlier.features.get(name, [""] * len(earlier.data)), *new] for name, new in features.items()}
        earlier.data = np.concatenate([earlier.data, [earlier.world_to_data(place) for place in values]])
        earlier.features = merged
        earlier.visible = True
    elif isinstance(earlier, Labels | Surface) and type(earlier).__name__.lower() == kind:
        earlier.data = values
    elif isinstance(earlier, Shapes) and kind == "shapes" and earlier.ndim == 3:
        earlier.data = [(line, keywords["shape_type"]) for line in values]  # a new Shapes layer may crash OpenGL
        earlier.visible = True
    else:
        earlier = Layer.create(values, keywords, kind)
        insert(viewer, earlier)
    return earlier


def _map(prepared: PreparedMap) -> FlatMap:
    flat_map = prepared.run.flat_map
    if not isinstance(flat_map, FlatMap):
        raise InputError("Regions and distances need a flat map, not a page of patches. Use Flatten surface instead")
    return flat_map


def _world(prepared: PreparedMap, of: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert points from RAS+ to positions along the world axes."""
    return from_ras(of.reshape(-1, 3), prepared.origin.get("world_axes", "RAS"))
