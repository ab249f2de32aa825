"""Start from a known flat map: the part that it covers, its cuts, and the positions of its vertices."""

from collections import defaultdict
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import Progress
from voxflat.errors import InputError
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.matching import Matched, loaded
from voxflat.surfaces.cuts import Cut
from voxflat.surfaces.cutting import CutManifold, cut_out_as, opened_to_disk
from voxflat.surfaces.manifold import Manifold, Step
from voxflat.unique_rows import numbered


def covered(whole: Manifold, start: Matched) -> Manifold:
    """Return the part of a surface that a map covers."""
    is_covered = whole._has_triangles(start.vertices[start.core.faces])
    if is_covered is None:
        raise InputError("start has triangles that the surface does not have. Pass a map of this surface")
    part = whole._with_core(whole.core.part_of_faces(is_covered))
    return part if is_covered.all() else replace(part, whole=whole, steps=(Step("keep"),))


def cut_as(whole: Manifold, start: Matched, threads: int | None, progress: Progress | None) -> CutManifold[Manifold]:
    """Cut out the part that a map covers, along the map's own cuts."""
    part = covered(whole, start)
    places, _ = _at_corners(part.vertices, part.faces, start)
    cut = cut_out_as(whole, part, _chains(_seams(part.faces, places)), "start")
    return opened_to_disk(cut, False, threads, progress)


def named_as(cut: CutManifold[Manifold], start: object) -> CutManifold[Manifold]:
    """Give cuts the names of the cuts of a map on which they lie, if it is a `FlatMap` or its file."""
    flat_map = loaded(start)
    lines = [line for line in flat_map.cuts if line.name] if isinstance(flat_map, FlatMap) else []
    named = [replace(cut, name=next((k.name for k in lines if _set(cut) <= _set(k)), None)) for cut in cut.cuts]
    return replace(cut, cuts=tuple(named))


def _set(cut: Cut) -> set[tuple[int, ...]]:
    return {tuple(np.atleast_1d(vertex).tolist()) for vertex in cut.ids}


def places_of(cut: CutManifold[Manifold], start: Matched) -> NDArray[np.float64]:
    """Return the start's position for every vertex; both sides of a cut that the start lacks share a position."""
    vertices = cut.surface.vertices
    corners, is_there = _at_corners(vertices, cut.faces, start)
    if not is_there.all():
        lacking = vertices[cut.faces[np.flatnonzero(~is_there)[0]]].tolist()
        raise InputError(
            f"start does not contain {int((~is_there).sum())} of the {len(is_there)} triangles to be flattened "
            f"(for example, the triangle of vertices {lacking}). Pass a map that covers all of them, or omit start"
        )
    places = np.full((len(vertices), 2), np.nan)
    places[cut.faces] = corners
    torn = np.argwhere((places[cut.faces] != corners).any(axis=2))
    if len(torn):
        vertex = int(vertices[cut.faces[tuple(torn[0])]])
        raise InputError(
            f"start is cut at vertex {vertex}, but the surface is not. Also pass the cuts of the start, or omit cuts, "
            "sphere, relax and adapt"
        )
    return places


def _at_corners(
    vertices: NDArray[np.int64], faces: NDArray[np.uint32], start: Matched
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the positions of triangle corners in a map, (F, 3, 2), and a mask of the triangles in the map."""
    asked, existing = vertices[faces], start.vertices[start.core.faces]
    keys, wanted_keys = numbered(np.sort(existing, axis=1), np.sort(asked, axis=1))
    triangle = np.zeros(len(keys) + len(wanted_keys), dtype=np.int64)
    triangle[keys] = np.arange(len(keys))
    rows = triangle[wanted_keys]
    is_there = keys[rows] == wanted_keys
    order = np.argsort(existing[rows], axis=1)
    sorted_known = np.take_along_axis(start.core.faces[rows].astype(np.int64), order, axis=1)
    places = np.empty((*faces.shape, 2))
    np.put_along_axis(places, np.argsort(asked, axis=1)[:, :, None], start.uv[sorted_known], axis=1)
    return places, is_there


def _seams(faces: NDArray[np.uint32], places: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the edges, (k, 2), whose ends have different positions in their two triangles."""
    corners = np.stack([[0, 1], [1, 2], [2, 0]])
    ends = faces[:, corners].reshape(-1, 2).astype(np.int64)
    pairs = places[:, corners].reshape(-1, 2, 2)
    order = np.argsort(ends, axis=1)
    ends = np.take_along_axis(ends, order, axis=1)
    pairs = np.take_along_axis(pairs, order[:, :, None], axis=1)
    by_edge = np.lexsort(ends.T)
    ends, pairs = ends[by_edge], pairs[by_edge]
    is_same = (ends[1:] == ends[:-1]).all(axis=1)
    is_torn = (pairs[1:] != pairs[:-1]).any(axis=(1, 2))
    return np.asarray(ends[1:][is_same & is_torn])


def _chains(edges: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Join edges into paths, which end at vertices where the number of edges is not two."""
    beside: defaultdict[int, list[int]] = defaultdict(list)
    for a, b in edges.tolist():
        beside[a].append(b)
        beside[b].append(a)
    left = {(min(edge), max(edge)) for edge in edges.tolist()}
    paths = []
    ends = [vertex for vertex in sorted(beside) if len(beside[vertex]) != 2]
    for first in [*ends, *sorted(beside)]:  # the remaining edges form rings
        for second in beside[first]:
            path = [first]
            step = second
            while (min(path[-1], step), max(path[-1], step)) in left:
                left.remove((min(path[-1], step), max(path[-1], step)))
                path.append(step)
                if len(beside[step]) != 2:
                    break
                step = next((other for other in beside[step] if other != path[-2]), path[-2])
            if len(path) > 1:
                paths.append(np.array(path, dtype=np.int64))
    return paths
