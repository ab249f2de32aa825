"""Find the regions where a map changes areas most, and cuts that reduce their distortion."""

from dataclasses import replace
from typing import Any

import numpy as np
import scipy  # its modules are imported on first use
from numpy.typing import NDArray

from voxflat import _core
from voxflat.arguments import (
    Progress,
    checked_instance,
    checked_switch,
    checked_threads,
    is_whole,
    optional_number,
    shown,
)
from voxflat.errors import InputError
from voxflat.io.provenance import recording
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.lines import rim
from voxflat.maps.parcels import Parcels, check_table, parcels_of
from voxflat.maps.worst_places import RelievingCut, WorstPlace, WorstPlaces, area_changes
from voxflat.surfaces.cuts import close_holes, sketch_error
from voxflat.surfaces.manifold import Manifold
from voxflat.unique_rows import distinct

_Floats = NDArray[np.float64]
_Ints = NDArray[np.int64]

_ON = 3.0  # depth of the cut for a region at the border, in multiples of the region's depth


@recording()
def worst_places(
    flat_map: FlatMap,
    count: int = 5,
    *,
    beyond: float = 1.5,
    cuts: bool = True,
    parcels: object | None = None,
    table: object | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> WorstPlaces:
    """Find the regions where a map changes areas most, and a cut that would reduce the distortion of each.

    A region is a set of connected triangles that are all stretched, or all shrunk, by more than the factor `beyond`,
    relative to the scale that preserves the total area. Regions are ranked by their area, weighted by its change.

    Parameters
    ----------
    flat_map : FlatMap
        A flat map.
    count : int
        Maximum number of regions.
    beyond : float
        Areas in a region change by more than this factor.
    cuts : bool
        Find a cut for each region: the shortest path along edges from the border through the region to its far end. At
        the border, the cut continues inwards to three times the depth of the region.
    parcels : path, ndarray, image object, Volume, Regions or Parcels, optional
        Labels, as in `figures.flat_map`. Each region gets the name of the parcel that contains the largest part of it.
    table : path, optional
        Names of the parcels, if their file does not contain names.
    threads : int, optional
        As in `flatten`.
    progress : callable, optional
        As in `flatten`.

    Returns
    -------
    WorstPlaces
        The regions, worst first.

    Raises
    ------
    InputError
        If the map has no triangles of the surface (method "grossmann2002"), or an argument is not valid.
    Cancelled
        If `progress` returned False.

    See Also
    --------
    voxflat.methods.Voxflat : Limit changes in area with ``max_area``.

    Examples
    --------
    >>> voxflat.worst_places(voxflat.samples.hill().flatten(), beyond=1.01)
    <WorstPlaces: 2 of 2 regions where areas change by more than a factor of 1.01 (88.89 % of the surface)>
    """
    checked_instance(flat_map, FlatMap, "flat map", "a FlatMap")
    if not is_whole(count) or count < 0:
        raise InputError(f"count is {shown(count)}. Pass the maximum number of regions as a whole number")
    factor = optional_number(beyond, "beyond")
    if factor is None or not 1 < factor < np.inf:
        raise InputError(f"beyond is {shown(beyond)}. Pass a factor greater than 1, such as 1.5")
    check_table(parcels, table)
    threads, with_cuts = checked_threads(threads), checked_switch(cuts, "cuts")
    if flat_map.distortion.triangles is None:
        raise InputError("the map has no triangles on which to measure areas. Pass a map made with another method")
    areas, logs = area_changes(flat_map)
    is_known = np.isfinite(logs)
    whole = float(areas[is_known].sum())
    groups = []
    for sign in (1, -1):  # stretched, shrunk
        is_beyond = is_known & (sign * np.nan_to_num(logs) > np.log2(factor))
        groups += _touching(flat_map.faces, is_beyond, len(flat_map))
    held = [float((areas[group] * np.abs(logs[group])).sum()) for group in groups]
    order = sorted(range(len(groups)), key=lambda n: -held[n])[: int(count)]
    named = parcels if parcels is None or isinstance(parcels, Parcels) else parcels_of(flat_map, parcels, table=table)
    places = [_place(flat_map, number, groups[n], areas, logs, whole, named) for number, n in enumerate(order, 1)]
    error = np.nan
    if with_cuts and places:
        ways = _Ways(flat_map, threads, progress)
        error = ways.error
        places = [replace(place, cut=ways.relieving(place)) for place in places]
    share = float(sum(areas[group].sum() for group in groups)) / whole if whole > 0 else np.nan
    return WorstPlaces(flat_map, factor, tuple(places), len(groups), share, error)


def _touching(faces: NDArray[Any], chosen: NDArray[np.bool_], count: int) -> list[_Ints]:
    """Split selected triangles into groups that do not share a vertex."""
    numbers = np.flatnonzero(chosen)
    if not len(numbers):
        return []
    corners = faces[numbers].astype(np.int64)
    ends = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]]])
    links = scipy.sparse.coo_matrix((np.ones(len(ends)), ends.T), shape=(count, count))
    _, group = scipy.sparse.csgraph.connected_components(links, directed=False)
    _, which = np.unique(group[corners[:, 0]], return_inverse=True)
    order = np.argsort(which, kind="stable")
    return np.split(numbers[order], np.cumsum(np.bincount(which))[:-1])


def _place(
    flat_map: FlatMap, number: int, group: _Ints, areas: _Floats, logs: _Floats, whole: float, parcels: Parcels | None
) -> WorstPlace:
    area, log = areas[group], logs[group]
    kind = "stretched" if log[0] > 0 else "shrunk"  # one of them for the whole group
    weights = area * np.abs(log)
    corners = flat_map.faces[group]
    middle = np.average(flat_map.points[corners].mean(axis=1), axis=0, weights=weights)
    vertices = np.unique(corners)
    centre = vertices[np.argmin(np.linalg.norm(flat_map.points[vertices] - middle, axis=1))]
    order = np.argsort(log)
    median = log[order][np.searchsorted(np.cumsum(area[order]), area.sum() / 2)]
    parcel = None
    if parcels is not None:
        labels = parcels.labels[corners].ravel()
        present, which = np.unique(labels, return_inverse=True)
        most = int(present[np.argmax(np.bincount(which.reshape(-1), np.repeat(area, 3)))])
        parcel = parcels.names.get(most)
    total, excess = float(area.sum()), float(weights.sum())
    ratios = float(2.0 ** log[np.argmax(np.abs(log))]), float(2.0**median)
    spot = flat_map.points[centre], flat_map.uv[centre], flat_map.ids[centre]
    unit = flat_map.origin.named_unit
    return WorstPlace(number, kind, total, total / whole, excess, *ratios, *spot, group, parcel, unit=unit)


class _Ways:
    """Paths from the border of a map inwards along edges, and the effect of cuts along them."""

    def __init__(self, flat_map: FlatMap, threads: int | None, progress: Progress | None) -> None:
        self.flat_map, self.threads, self.progress = flat_map, threads, progress
        core, _ = _core.Surface.from_triangles(flat_map.points, flat_map.faces.astype(np.int64))
        voxels = flat_map.ids if flat_map.is_voxels else None
        origin = flat_map.origin if flat_map.is_voxels else replace(flat_map.origin.mesh, vertices=len(flat_map))
        part = Manifold(core, voxels, origin)
        self.part, faces, _ = close_holes(part, progress)
        self.rows = self.part.vertices  # row of the map for each vertex
        count = len(self.rows)
        is_border = np.zeros(count, dtype=np.bool_)
        for line in rim(self.part.faces, count):
            is_border[line] = True
        self.border = is_border
        self.of_row = np.full(len(flat_map), -1)
        self.of_row[self.rows] = np.arange(count)
        sides = np.concatenate([faces[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
        ends = distinct(np.sort(sides, axis=1)).rows
        self.ends = ends[~is_border[ends].all(axis=1)]  # paths between border vertices open nothing
        self.lengths = np.linalg.norm(np.subtract(*(self.part.points[self.ends[:, end]] for end in (0, 1))), axis=1)
        self.from_border, self.to_border = self._dijkstra(np.flatnonzero(is_border), self.ends, self.lengths)
        self.error = self._sketch(None)

    def _sketch(self, path: _Ints | None) -> float:
        """Return the error of a coarse preview map with one additional cut."""
        core = self.part.core if path is None else self.part.core.cut([path.astype(np.uint32)])
        topology = core.topology()
        if len(topology["components"]) > 1 or topology["handles"] or not topology["loops"]:
            return np.nan
        return sketch_error(self.part._with_core(core), self.threads, self.progress)

    def _dijkstra(self, sources: _Ints, ends: NDArray[Any], lengths: _Floats) -> tuple[_Floats, _Ints]:
        """Return the distance of vertices to the nearest source, and the previous vertex on the shortest path."""
        count = len(self.rows)
        graph = scipy.sparse.csr_matrix((lengths, ends.T), shape=(count, count))
        far, before, _ = scipy.sparse.csgraph.dijkstra(
            graph, directed=False, indices=sources, min_only=True, return_predecessors=True
        )
        return far, before

    def relieving(self, place: WorstPlace) -> RelievingCut | None:
        """Return the cut that reduces the distortion of a region."""
        vertices = self.of_row[np.unique(self.flat_map.faces[place.triangles])]
        path = self._through(vertices, place)
        if path is None:
            return None
        points, rows = self.part.points[path], self.rows[path]
        length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
        gain = np.nan if np.isnan(self.error) else self.error - self._sketch(path)
        return RelievingCut(self.flat_map.ids[rows], points, self.flat_map.uv[rows], length, float(gain))

    def _through(self, vertices: _Ints, place: WorstPlace) -> _Ints | None:
        """Return the path through a region's vertices, inner end first; None if no path leads to the border.

        The path starts where the shortest path from the deepest vertex meets the border, and leads through the region
        to its far end. The distortion of a region at the border is due to curvature farther inwards, so the path
        continues to three times the depth or width of the region.
        """
        vertices = vertices[np.isfinite(self.from_border[vertices])]
        if not len(vertices):
            return None
        deepest = vertices[np.argmax(self.from_border[vertices])]
        root = _followed(self.to_border, deepest)[-1]
        is_open = ~(self.border[self.ends] & (self.ends != root)).any(axis=1)
        far, before = self._dijkstra(np.array([root]), self.ends[is_open], self.lengths[is_open])
        if self.border[vertices].any():
            depth = max(float(self.from_border[deepest]), float(np.sqrt(place.area)))
            tip = np.argmax(np.where(far <= _ON * depth, self.from_border, -1.0))
        else:
            tip = vertices[np.argmax(np.where(np.isfinite(far[vertices]), far[vertices], -1.0))]
        path = _followed(before, tip)
        return path if len(path) > 1 and path[-1] == root else None


def _followed(before: _Ints, start: np.int64) -> _Ints:
    """Return the path from a vertex back to the source."""
    path = [int(start)]
    while before[path[-1]] >= 0:
        path.append(int(before[path[-1]]))
    return np.array(path)
