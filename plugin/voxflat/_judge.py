"""The judge: what a flat map, ours or another tool's, does to a surface."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat import _core
from voxflat._distortion import Distortion, Figures, Triangles
from voxflat._errors import InputError
from voxflat._prepare import Progress, checked_seed, checked_threads
from voxflat._surface import Surface, as_mesh
from voxflat._surface import surface as _surface
from voxflat.flatmap import FlatMap, load
from voxflat.meshes import Mesh, is_patch, read_patch

__all__ = ["measure"]


def measure(
    surface: object,
    flat: object,
    *,
    sources: int = 300,
    label: int | None = None,
    threshold: float | None = None,
    spacing: Sequence[float] | None = None,
    affine: ArrayLike | None = None,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Distortion:
    """Measure a flat map of a surface, whoever made it.

    Distances are measured on the surface as it was cut for the map: over the map's triangles, and not across its seams.

    Parameters
    ----------
    surface, label, threshold, spacing, affine, seed, threads, progress
        The surface, as in `flatten`.
    flat : path, FlatMap, Mesh, (places, faces), or array_like of shape (V, 2) or (V, 3)
        The map: a FreeSurfer patch (``lh.cortex.patch.flat``), GIFTI or another mesh file of the surface's vertices in
        the same order, a map of voxflat (.npz), or places in the plane, mm. Its triangles, or those of the surface with
        a place for all corners, are judged; a third coordinate must be constant.
    sources : int
        How many random points distances are measured from.

    Returns
    -------
    Distortion

    Raises
    ------
    InputError
        If the map does not belong to the surface, or is not flat.
    """
    threads, seed = checked_threads(threads), checked_seed(seed)
    if sources < 1:
        raise InputError(f"{sources} sources are too few; give at least 1")
    whole = _surface(surface, label=label, threshold=threshold, spacing=spacing, affine=affine, progress=progress)
    part, uv = _matched(whole, flat)
    distances = part.judge(uv, sources, seed, threads, progress)
    triangles = Triangles(**part.measure(uv, progress))
    raw, best_scale = (Figures(**distances.pop(name)) for name in ("raw", "best_scale"))
    return Distortion(raw=raw, best_scale=best_scale, **distances, triangles=triangles)


def _matched(whole: Surface, flat: object) -> tuple[_core.Surface, NDArray[np.float64]]:
    """Return the surface over which the map is defined, and the place of each of its vertices."""
    if isinstance(flat, str | os.PathLike):
        name = os.fspath(flat).lower()
        if name.endswith(".npz"):
            flat = load(flat)
        elif is_patch(flat):
            return _of_patch(whole, flat)
    if isinstance(flat, FlatMap):
        return _of_map(whole, flat)
    mesh = as_mesh(flat)
    if mesh is None:
        places = np.asarray(flat)
        if places.ndim != 2 or places.shape[1] not in (2, 3) or places.dtype.kind not in "iuf":
            raise InputError(
                f"the map is {places.dtype} of shape {places.shape}; give places of shape (V, 2), or a file"
            )
        return _of_places(whole, places.astype(np.float64), None)
    uv = mesh.points if mesh.texture_coordinates is None or _is_flat(mesh.points) else mesh.texture_coordinates
    return _of_places(whole, uv, mesh)


def _of_places(
    whole: Surface, places: NDArray[np.float64], mesh: Mesh | None
) -> tuple[_core.Surface, NDArray[np.float64]]:
    if len(places) != whole.count:
        raise InputError(
            f"the map has {len(places)} points, the surface {whole.count} vertices; they must correspond one by one"
        )
    is_placed = np.asarray(np.isfinite(places).all(axis=1))
    faces = whole.vertices[whole.faces] if mesh is None else mesh.faces
    return _judged(whole, faces[is_placed[faces].all(axis=1)], places)


def _of_patch(whole: Surface, path: Any) -> tuple[_core.Surface, NDArray[np.float64]]:
    patch = read_patch(path)
    faces = whole.vertices[whole.faces[whole.in_patch(patch)]]
    places = np.full((whole.count, 3), np.nan)
    places[patch.vertices] = patch.points
    return _judged(whole, faces, places)


def _of_map(whole: Surface, flat: FlatMap) -> tuple[_core.Surface, NDArray[np.float64]]:
    """Return the map's own triangles, cut as they are, on the surface."""
    vertices = whole.find(flat.ids, "the map's points")
    core, _, unused = _core.Surface.from_triangles(whole.points[vertices], flat.faces.astype(np.int64))
    if unused:
        return core, flat.uv[core.ids]
    return core, flat.uv


def _judged(
    whole: Surface, faces: NDArray[np.int64], places: NDArray[np.float64]
) -> tuple[_core.Surface, NDArray[np.float64]]:
    if len(faces) == 0:
        raise InputError(
            "no triangle of the surface has a place for all its corners in the map: is it of this surface?"
        )
    is_mapped = whole.has_triangles(faces)
    if is_mapped is not None:
        core = whole.core.part_of_faces(is_mapped)
    else:  # the map's triangles are others than the surface's
        points = np.zeros((whole.count, 3))
        points[whole.vertices] = whole.points
        core, _, _ = _core.Surface.from_triangles(points, faces)
    used = places[core.ids]
    if not _is_flat(used):
        depth = float(np.ptp(used[:, 2]))
        raise InputError(f"the map is not flat: its third coordinate varies by {depth:.3g} mm; give a flat surface")
    return core, np.ascontiguousarray(used[:, :2])


def _is_flat(places: NDArray[np.float64]) -> bool:
    if places.shape[1] == 2:
        return True
    extent = np.ptp(places, axis=0)
    return bool(extent[2] <= 1e-4 * extent.max())
