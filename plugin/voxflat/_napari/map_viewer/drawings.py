"""Drawings on a map, projected onto the surface: points, regions, and the shortest path between two points."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from typing import Any

import numpy as np
from napari import Viewer
from napari.layers import Labels, Layer, Points, Shapes, Surface
from napari.utils.colormaps import CyclicLabelColormap
from numpy.typing import NDArray

from voxflat._napari.layers.world import MADE_FROM, WORLD, from_ras
from voxflat._napari.map_viewer.prepared_map import PreparedMap
from voxflat._napari.results.flat_layers import LayerData, in_unit_of, layer_name, units
from voxflat._napari.results.layer_list import insert
from voxflat._napari.results.outputs import is_unchanged, remember
from voxflat._napari.results.sketch import PATH, POINTS, Place, Polygon, Sketch, regions_part
from voxflat.errors import InputError
from voxflat.io.grid import rounded
from voxflat.io.volumes import Volume
from voxflat.maps.colours import label_colour
from voxflat.maps.flat_map import FlatMap
from voxflat.pipeline.surface import surface

OF_MAP = "voxflat_regions"
"""Key of the metadata of drawn regions: the `Regions`, which can be saved as a table, or at the vertices of a mesh."""

_COLOUR = "#ffd23f"
_COLOURS = np.array([label_colour(number) for number in range(256)]) / 255  # of regions, as on the map and in files
_CORTEX = (-0.5, 3.0)  # mm outside the surface; the depths of a region if the pial surface is unknown


@dataclass(frozen=True, eq=False)
class Drawn:
    """A drawing as a layer of the viewer, and a message about it."""

    part: str  # of the map, for the name of the layer
    layer: LayerData
    message: str = ""


@dataclass(frozen=True, eq=False)
class Changes:
    """What the layers of the viewer need in order to show another state of a sketch."""

    sketch: Sketch
    kept: int  # marks that stay
    made: list[Drawn] = field(default_factory=list)
    empty: list[str] = field(default_factory=list)  # parts of the map that no longer have regions or a path


def changes(
    prepared: PreparedMap, shown: Sketch, now: Sketch, moments: Mapping[int | None, Sequence[float]]
) -> Changes:
    """Project what differs between two states of a sketch; `moments` are the positions of frames, as in `points`.

    Raises InputError as `regions` does.
    """
    same = (mark == other for mark, other in zip(shown.marks, now.marks, strict=False))
    found = Changes(now, sum(takewhile(bool, same)))
    for frame, place in now.marks[found.kept :]:
        found.made.append(points(prepared.at(frame), [place], moments[frame]))
    for frame in dict(shown.regions + now.regions):
        polygons = now.regions_in(frame)
        if not polygons:
            found.empty.append(regions_part(frame))
        elif polygons != shown.regions_in(frame):
            found.made.append(regions(prepared.at(frame), polygons))
    if now.distance is None and shown.distance is not None:
        found.empty.append(PATH)
    elif now.distance is not None and now.distance != shown.distance:
        frame, (a, b) = now.distance
        found.made.append(way(prepared.at(frame), a, b, moments[frame]))
    return found


def points(prepared: PreparedMap, places: Sequence[Place], moment: Sequence[float] = ()) -> Drawn:
    """Project points (u, v) on the map onto the surface; `moment` is the position along the axes before space."""
    spots = [spot for spot in (prepared.spot(*place) for place in places) if spot is not None]
    features = {"vertex": [str(spot.vertex) for spot in spots], "surface": [prepared.run.name] * len(spots)}
    look = {"face_color": _COLOUR, "size": 2 * prepared.thickness, "features": features}
    keywords = {**_described(prepared, POINTS), **look}
    world = _world(prepared, np.array([spot.point for spot in spots]))
    return Drawn(POINTS, (_at(moment, world), keywords, "points"))


def regions(prepared: PreparedMap, polygons: Sequence[Polygon]) -> Drawn:
    """Convert polygons on a map to voxels or vertices, at the displayed frame of a movie.

    Raises InputError for an empty region or a page of patches.
    """
    flat_map = _map(prepared)
    drawn = flat_map.regions({f"region {n}": np.array(corners) for n, corners in enumerate(polygons, 1)})
    of_frame = "" if prepared.frame is None else f" in frame {prepared.frame}"
    message = f"The map has {len(polygons)} region{'s' * (len(polygons) > 1)}{of_frame}"
    part = regions_part(prepared.frame)
    keywords = _described(prepared, part)
    keywords["metadata"][OF_MAP] = drawn
    if not flat_map.is_voxels:
        surface = (_world(prepared, prepared.points), flat_map.faces[~flat_map.torn], drawn.labels.astype(np.float32))
        look = {"vertex_colors": _COLOURS[drawn.labels % len(_COLOURS)], "contrast_limits": (0, len(polygons))}
        return Drawn(part, (surface, {**keywords, **look}, "surface"), message)
    keywords["colormap"] = CyclicLabelColormap(colors=_COLOURS)
    is_own = flat_map is prepared.own  # the points of other frames are not voxels
    labels = flat_map.paint(drawn.labels.astype(np.int32)) if is_own else np.zeros(flat_map.volume_shape, np.int32)
    if not np.isnan(flat_map.normals).all():  # the surface has an outer side, where the cortex lies
        grid = Volume(labels, flat_map.affine, unit=prepared.unit)
        depths = depths_of_regions(flat_map, movie=prepared.run.layers.movie is not None)
        cortex = drawn.volume(grid, depth=depths)
        message += f", in the volume {reach(flat_map, depths)}"
        labels = np.where(labels == 0, cortex.data, labels)
    affine, movie = affine_in_world(prepared), prepared.run.layers.movie
    if movie is not None and prepared.frame is not None:
        affine = movie.time.placed(affine, prepared.frame)
    return Drawn(part, (labels[(None,) * (len(affine) - 4)], {**keywords, "affine": affine}, "labels"), message)


def _described(prepared: PreparedMap, part: str) -> dict[str, Any]:
    name = layer_name(prepared.run.title, part)
    return {"name": name, "units": units_in_time(prepared), "metadata": drawing_metadata(prepared)}


def drawing_metadata(prepared: PreparedMap) -> dict[str, Any]:
    """Return the metadata of layers that are drawn on a map: the flattened layer, and the world axes chosen for it."""
    return {MADE_FROM: prepared.run.name, WORLD: prepared.session.world_axes}


def affine_in_world(prepared: PreparedMap) -> NDArray[np.float64]:
    """Return the affine of the flattened volume to the world of the viewer."""
    to_ras = _map(prepared).affine
    corners = _world(prepared, np.vstack([np.zeros(3), np.eye(3)]) @ to_ras[:3, :3].T + to_ras[:3, 3])
    affine = np.eye(4)
    affine[:3, 3] = corners[0]
    affine[:3, :3] = (corners[1:] - corners[0]).T
    return affine


def depths_of_regions(flat_map: FlatMap, depth: float = 0.0, *, movie: bool = False) -> tuple[float, float] | None:
    """Return the depths of regions: of the cortex or, if the surface may be of a tissue, a voxel on both sides.

    A displayed depth beyond them is included. If the pial surface is known, regions lie between both surfaces.
    """
    if flat_map.pial_points is not None:
        return None
    step = flat_map.spacing
    low, high = _CORTEX if flat_map.origin.named_unit == "mm" and not movie else (-step, step)
    return (low, high) if low <= depth <= high else (min(low, depth - step), max(high, depth + step))


def reach(flat_map: FlatMap, depths: tuple[float, float] | None) -> str:
    """Return a text with the depths of regions."""
    text = "between both surfaces" if depths is None else f"from {depths[0]:.3g} to {depths[1]:.3g} mm"
    return in_unit_of(flat_map, text)


def way(prepared: PreparedMap, a: Place, b: Place, moment: Sequence[float] = ()) -> Drawn:
    """Find the shortest path along the surface, across cuts, between two map points; raises InputError on failure.

    `moment` is as in `points`.
    """
    flat_map = _map(prepared)
    ends = [prepared.spot(*end) for end in (a, b)]
    if None in ends:
        raise InputError("At least one of the two points is outside the map. Click on two points of the map")
    faces = flat_map.faces[~flat_map.torn].astype(np.int64)
    rows = merged = np.arange(len(flat_map))
    if not flat_map.is_voxels:  # a voxel can occur twice, where two parts of the surface touch
        rows, merged = np.unique(flat_map.ids, return_index=True, return_inverse=True)[1:]
    start, end = (int(merged[spot.row]) for spot in ends if spot is not None)
    path = surface((flat_map.points[rows], merged[faces])).path(start, end, geodesic="exact")
    flat = float(np.hypot(a[0] - b[0], a[1] - b[1]))
    lengths = f"{rounded(path.length, 1)} mm along the surface, {rounded(flat, 1)} mm on the map"
    message = in_unit_of(flat_map, lengths)
    message += "" if prepared.frame is None else f", in frame {prepared.frame}"
    line = _at(moment, _world(prepared, flat_map.space.to_scanner(path.points)))
    look = {"shape_type": "path", "edge_color": _COLOUR, "edge_width": 0.7 * prepared.thickness}
    return Drawn(PATH, ([line], {**_described(prepared, PATH), **look}, "shapes"), message)


def put(viewer: Viewer, data: LayerData, earlier: Layer | None, *sources: Any) -> Layer:
    """Add a layer to the viewer, or change an earlier one that was made from the same sources.

    Points are added to the earlier ones. Other layers are not changed if the user has edited them.
    """
    values, keywords, kind = data
    features = keywords.get("features", {})
    layer = Layer.create(values, keywords, kind)
    is_own = isinstance(earlier, Points) or (earlier is not None and is_unchanged(earlier, *sources))
    if earlier not in viewer.layers or not is_own or (kind != "points" and _corners(earlier) != _corners(layer)):
        insert(viewer, layer)
        remember(layer, *sources)
        return layer
    if isinstance(earlier, Points):
        merged = {name: [*earlier.features.get(name, [""] * len(earlier.data)), *new] for name, new in features.items()}
        earlier.data = np.concatenate([earlier.data, [earlier.world_to_data(place) for place in values]])
        earlier.features = merged
        earlier.visible = True
        return earlier
    if isinstance(earlier, Shapes):
        earlier.data = [(line, keywords["shape_type"]) for line in values]  # a new Shapes layer may crash OpenGL
        earlier.visible = True
    elif isinstance(earlier, Labels | Surface):
        earlier.data = values
        if isinstance(earlier, Surface):
            earlier.vertex_colors = keywords["vertex_colors"]
        earlier.metadata = layer.metadata
    assert earlier is not None
    remember(earlier, *sources)
    return earlier


def take_back(layer: Layer, mark: NDArray[np.float64]) -> None:
    """Remove the last point that lies at these world coordinates from the layer of marked points."""
    if isinstance(layer, Points):
        rows = [number for number, place in enumerate(layer.data) if np.allclose(layer.data_to_world(place), mark)]
        if rows:
            layer.selected_data = {rows[-1]}
            layer.remove_selected()


def remove_empty(viewer: Viewer, layers: dict[str, Layer], part: str, *sources: Any) -> None:
    """Remove the layer of regions of a map, or empty that of its path, unless the user has edited it."""
    layer = layers.get(part)
    if isinstance(layer, Shapes) and is_unchanged(layer, *sources):
        layer.data, layer.visible = [], False  # kept, because a new Shapes layer may crash OpenGL
        remember(layer, *sources)
    elif layers.pop(part, None) in viewer.layers and is_unchanged(layer, *sources):
        viewer.layers.remove(layer)


def units_in_time(prepared: PreparedMap) -> tuple[Any, ...] | None:
    """Return the units of all axes of a layer that belongs to a frame of a movie, or of the space axes."""
    own, movie = units(prepared.run.flat_map, 3), prepared.run.layers.movie
    return own if own is None or movie is None else (*movie.time.units, *own)


def _at(moment: Sequence[float], points: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.column_stack([np.broadcast_to(np.asarray(moment, dtype=np.float64), (len(points), len(moment))), points])


def _corners(layer: Layer) -> list[tuple[float, ...]]:
    """Return the positions that determine where a layer lies in the world."""
    return [tuple(layer.data_to_world(end)) for end in np.vstack([np.zeros(layer.ndim), np.eye(layer.ndim)])]


def _map(prepared: PreparedMap) -> FlatMap:
    """Return the map with the positions of the displayed frame."""
    flat_map = prepared.planar
    if not isinstance(flat_map, FlatMap):
        raise InputError("Regions and distances need a flat map, not a page of patches. Use Flatten surface instead")
    return flat_map


def _world(prepared: PreparedMap, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert points from RAS+ to positions along the world axes."""
    return from_ras(points.reshape(-1, 3), prepared.session.world_axes)
