"""Cut a surface as a map of it is cut: the part that the map covers, and the edges at which the map is torn."""

import os
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from voxflat.errors import InputError
from voxflat.io.meshes import holds_mesh
from voxflat.io.patches import is_patch
from voxflat.io.sources import as_mesh
from voxflat.maps.flat_map import MAP_ENDINGS, FlatMap
from voxflat.maps.matching import Matched, loaded, match
from voxflat.surfaces.cuts import Cut
from voxflat.surfaces.cutting import CutManifold, CutSettings, cut_open
from voxflat.surfaces.manifold import Manifold, Step, SurfaceT, are_triangles
from voxflat.unique_rows import numbered

SettingsT = TypeVar("SettingsT", bound=CutSettings)


def is_map(cuts: object) -> bool:
    """Return whether cuts are given by a map or its file, and not by paths or a cuts file."""
    if isinstance(cuts, str | os.PathLike):
        path = Path(cuts)
        if path.name.lower().endswith(MAP_ENDINGS):
            return True
        return path.is_file() and path.suffix.lower() != ".json" and (is_patch(path) or holds_mesh(path))
    is_path = cuts is None or isinstance(cuts, dict | list | tuple | np.ndarray)
    return not is_path and (isinstance(cuts, FlatMap) or as_mesh(cuts) is not None)


def opened_along(part: SurfaceT, settings: CutSettings, *, holes: bool = True) -> CutManifold[SurfaceT]:
    """Cut a surface open like `cut_open`; the cuts may be given by a map."""
    cut = cut_open(*along_map(part, settings), holes=holes)
    return named_as(cut, settings.cuts) if is_map(settings.cuts) else cut


def along_map(part: SurfaceT, settings: SettingsT) -> tuple[SurfaceT, SettingsT]:
    """Return the part that a map in `settings.cuts` covers, and settings with its cuts as paths, if it is a map."""
    if not is_map(settings.cuts):
        return part, settings
    flat = match(part._complete, settings.cuts)
    part = covered(part, flat, "the map in cuts")
    paths = [part.ids[path] for path in seams(part, flat)]
    relax = False if settings.relax is None and settings.adapt is None else settings.relax
    return part, replace(settings, cuts=paths, relax=relax)


def covered(part: SurfaceT, flat: Matched, name: str) -> SurfaceT:
    """Return the triangles of a part that a map covers."""
    corners = flat.vertices[flat.core.faces]
    if part._complete._has_triangles(corners) is None:
        raise InputError(f"{name} has triangles that the surface does not have. Pass a map of this surface")
    is_covered = are_triangles(part.vertices[part.faces], corners)
    if not is_covered.any():
        raise InputError(f"{name} covers no triangle of the part. Pass a map that covers it, or another part")
    if is_covered.all():
        return part
    steps = (*part.steps, Step("keep"))
    return replace(part, core=part.core.part_of_faces(is_covered), whole=part._complete, steps=steps)


def seams(part: Manifold, flat: Matched) -> list[NDArray[np.int64]]:
    """Return the cuts of a map inside a part that it covers, as paths of the part's vertices."""
    places, _ = at_corners(part.vertices, part.faces, flat)
    return _chains(_torn_edges(part.faces, places))


def own_seams(flat: Matched) -> list[NDArray[np.int64]]:
    """Return the cuts of a map, as paths of vertices of the whole surface."""
    return _chains(_torn_edges(flat.vertices[flat.core.faces], flat.core.faces[:, :, None]))


def named_as(cut: CutManifold[SurfaceT], flat: object) -> CutManifold[SurfaceT]:
    """Give cuts the names of the cuts of a map on which they lie, if it is a `FlatMap` or its file."""
    flat_map = loaded(flat)
    lines = [line for line in flat_map.cuts if line.name] if isinstance(flat_map, FlatMap) else []
    named = [replace(cut, name=next((k.name for k in lines if _set(cut) <= _set(k)), None)) for cut in cut.cuts]
    return replace(cut, cuts=tuple(named))


def _set(cut: Cut) -> set[tuple[int, ...]]:
    return {tuple(np.atleast_1d(vertex).tolist()) for vertex in cut.ids}


def at_corners(
    vertices: NDArray[np.int64], faces: NDArray[np.uint32], flat: Matched
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the positions of triangle corners in a map, (F, 3, 2), and a mask of the triangles in the map."""
    asked, existing = vertices[faces], flat.vertices[flat.core.faces]
    keys, wanted_keys = numbered(np.sort(existing, axis=1), np.sort(asked, axis=1))
    triangle = np.zeros(len(keys) + len(wanted_keys), dtype=np.int64)
    triangle[keys] = np.arange(len(keys))
    rows = triangle[wanted_keys]
    is_there = keys[rows] == wanted_keys
    order = np.argsort(existing[rows], axis=1)
    sorted_known = np.take_along_axis(flat.core.faces[rows].astype(np.int64), order, axis=1)
    places = np.empty((*faces.shape, 2))
    np.put_along_axis(places, np.argsort(asked, axis=1)[:, :, None], flat.uv[sorted_known], axis=1)
    return places, is_there


def _torn_edges(faces: NDArray[Any], places: NDArray[Any]) -> NDArray[np.int64]:
    """Return the edges, (k, 2), whose ends have different positions in their two triangles."""
    corners = np.stack([[0, 1], [1, 2], [2, 0]])
    ends = faces[:, corners].reshape(-1, 2).astype(np.int64)
    pairs = places[:, corners].reshape(-1, 2, places.shape[-1])
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
