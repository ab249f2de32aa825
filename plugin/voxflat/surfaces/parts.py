"""Select parts of a surface: regions, geodesic disks and polygons. A part stores how it was selected."""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from voxflat import _core
from voxflat.arguments import Note, Progress, array_of, checked_number, shown
from voxflat.errors import InputError
from voxflat.io.files import naming
from voxflat.io.grid import in_unit
from voxflat.io.meshes import holds_mesh
from voxflat.io.objects import values_of_object
from voxflat.io.overlays import as_mask, read_region, region_of
from voxflat.io.partners import check_partner
from voxflat.io.patches import Patch, is_patch, read_patch
from voxflat.io.sources import as_mesh
from voxflat.io.volumes import Volume
from voxflat.surfaces.correspondence import check_label
from voxflat.surfaces.foreground import keep_mask
from voxflat.surfaces.manifold import Manifold, Step, SurfaceT
from voxflat.surfaces.voxel_graph import found_seed, seed_voxel

STRAY_SHARE = 0.05  # largest share of a part's area in stray pieces
_TOUCHING = 0.3  # mm between white and pial surface; cortex is 1 to 5 mm thick
_SHARES = (0.01, 0.2)  # limits of the medial wall's share of a hemisphere; 7 % is usual
_CLEAR = 10  # least size relative to the next largest such region


def kept(surface: SurfaceT, region: object) -> SurfaceT:
    """Return the part of a surface inside a region; see `voxflat.Surface.keep`."""
    _check_file(surface, region)
    faces = surface.faces
    by_triangles = None if surface.is_voxels else _triangles(surface, region)
    mask = None
    if by_triangles is None:
        vertices, mask = _vertices(surface, region, "keep")
        by_triangles, step = _all_corners(vertices, faces), Step("keep", mask)
    else:
        step = Step("keep", by_triangles=True)
    return _region(surface, by_triangles, step, region)


def dropped(surface: SurfaceT, region: object) -> SurfaceT:
    """Return the part of a surface outside a region; see `voxflat.Surface.drop`."""
    _check_file(surface, region)
    mask = None
    if is_medial_wall(region):
        vertices = medial_wall_of(surface)
    else:
        vertices, mask = _vertices(surface, region, "drop")
    step = Step("drop", None if mask is None else ~mask)
    return _region(surface, _all_corners(~vertices, surface.faces), step, region)


def disk(
    surface: SurfaceT, seed_point: Sequence[int] | int, radius: float, threads: int | None, progress: Progress | None
) -> SurfaceT:
    """Return a geodesic disk; see `voxflat.Surface.disk`."""
    radius = checked_number(radius, "radius")
    seed, warnings = vertex_at(surface, seed_point, "seed point")
    core, filled = surface.core.disk(seed, radius, threads, progress)
    if filled:
        warnings.append(f"the disk includes {filled} triangles that are beyond the radius, but enclosed by the disk")
    indices, voxel = np.asarray(seed_point).tolist(), surface.ids[seed].tolist()
    return _part(surface, core, Step("disk", seed_point=indices, seed_found=voxel, radius=radius), warnings)


def polygon(surface: SurfaceT, corners: ArrayLike, progress: Progress | None) -> SurfaceT:
    """Return the part enclosed by a closed shortest path; see `voxflat.Surface.polygon`."""
    core, _ = surface.core.polygon(surface.find(corners, "the polygon's corners"), progress)
    return _part(surface, core, Step("polygon", corners=np.asarray(corners).tolist()), [])


def largest_piece(part: SurfaceT, progress: Progress | None = None) -> SurfaceT:
    """Return the largest piece and add a warning; raise an error if the choice is not clear.

    It has the largest area of all pieces with at least 1 % as many triangles as the piece with the most triangles.
    """
    pieces = part.core.topology(progress)["components"]
    areas = pieces["area"].tolist()
    if len(areas) == 1:
        return part
    share = areas[0] / sum(areas)
    if part.steps and 1 - share > STRAY_SHARE:
        sizes = ", ".join(f"{area:.4g}" for area in areas[:5]) + (", ..." if len(areas) > 5 else "")
        raise InputError(
            f"the patch consists of {len(areas)} separate pieces (with areas of {sizes} mm²). Keep one piece, or pass "
            "a seed point and a radius"
        )
    subject = "the patch" if part.steps else "the surface"
    of_triangles = 100 * pieces["faces"][0] / pieces["faces"].sum()
    used = f"{of_triangles:.1f} % of the triangles, {100 * share:.1f} % of the area"
    warning = f"{subject} has {len(areas)} components; only the largest is used ({used})"
    if max(areas) > areas[0]:
        warning += ". A component with a larger area was ignored, because it has less than 1 % as many triangles"
    if 1 - share > STRAY_SHARE:
        warning += ". To use another one, select its label or keep a part"
    elif max(areas) == areas[0]:
        warning = Note(warning)
    return replace(part, core=part.core.largest_piece(progress), warnings=(*part.warnings, warning))


def piece_of(part: SurfaceT, vertices: NDArray[np.uint32]) -> SurfaceT:
    """Return the one piece that contains all given vertices."""
    a, b = part.faces[:, :2].T, part.faces[:, 1:].T
    links = scipy.sparse.coo_array((np.ones(a.size), (a.ravel(), b.ravel())), shape=(len(part), len(part)))
    count, labels = scipy.sparse.csgraph.connected_components(links, directed=False)
    if count == 1:
        return part
    pieces = np.unique(labels[vertices])
    if len(pieces) > 1:
        raise InputError(f"the sources lie on {len(pieces)} separate components. Pass sources on one component")
    return replace(part, core=part.core.part_of_faces(labels[part.faces[:, 0]] == pieces[0]))


def _part(whole: SurfaceT, core: _core.Surface, step: Step, warnings: list[str]) -> SurfaceT:
    steps, texts = (*whole.steps, step), (*whole.warnings, *warnings)
    return replace(whole, core=core, whole=whole._complete, steps=steps, warnings=texts)


def _region(part: SurfaceT, faces: NDArray[np.bool_], step: Step, region: object) -> SurfaceT:
    if not faces.any():
        raise InputError(
            f"the region contains no triangle of the surface ({len(part)} vertices). Choose another region"
        )
    warnings = check_label(part, Path(region)) if _is_file(region) else []
    return _part(part, part.core.part_of_faces(faces), step, warnings)


def _is_file(region: object) -> TypeGuard[str | os.PathLike[str]]:
    return isinstance(region, str | os.PathLike) and not is_medial_wall(region)


def _check_file(surface: Manifold, region: object) -> None:
    if _is_file(region) and not surface.is_voxels:
        check_partner(region, surface.origin)


def _all_corners(chosen: NDArray[np.bool_], faces: NDArray[np.uint32]) -> NDArray[np.bool_]:
    return np.asarray(np.asarray(chosen[faces]).all(axis=1))


def _triangles(whole: Manifold, keep: object) -> NDArray[np.bool_] | None:
    """Return which triangles another mesh with the same vertices has; None if the input is not such a mesh."""
    if isinstance(keep, str | os.PathLike):
        if not os.path.exists(keep):
            return None
        if is_patch(keep):
            keep = read_patch(keep)
        elif not holds_mesh(keep):
            return None
    if isinstance(keep, Patch):
        return whole._in_patch(keep)
    is_values = values_of_object(keep, whole.count, whole.origin.structure) is not None
    mesh = None if is_values else as_mesh(keep)
    if mesh is None:
        return None
    if len(mesh.points) != whole.origin.mesh.vertices:
        raise InputError(
            f"the surface to keep has {len(mesh.points)} vertices, but the surface has {whole.origin.mesh.vertices}. "
            "Pass a surface whose vertices correspond one to one"
        )
    is_there = whole._has_triangles(mesh.faces)
    if is_there is None:
        raise InputError("the surface to keep has triangles that the full surface lacks. Pass a part of the surface")
    return is_there


def _vertices(whole: Manifold, region: object, verb: str) -> tuple[NDArray[np.bool_], NDArray[np.bool_] | None]:
    """Return which vertices are in a region, and for volumes the region as a mask of voxels."""
    name = f"the region to {verb}"
    if isinstance(region, str | os.PathLike) and not os.path.exists(region):
        raise InputError(f"{name}: the file {os.fspath(region)} does not exist. Check the path")
    if whole.is_voxels:
        shape = whole.origin.voxels.shape
        if isinstance(region, np.ndarray | list) and array_of(region, "region's entries").ndim == 2:  # voxel indices
            vertices = whole.find(array_of(region, name), name)
            mask = np.zeros(shape, dtype=np.bool_)
            mask[tuple(whole.ids[vertices].T)] = True
        else:
            place = Volume(np.empty(shape, dtype=np.bool_), whole.origin.voxels.affine, unit=whole.origin.unit)
            mask = keep_mask(region, place, f"mask to {verb}")
        return mask[tuple(whole.ids.T)], mask
    count = whole.origin.mesh.vertices
    if isinstance(region, str | os.PathLike):
        chosen = read_region(region, count, structure=whole.origin.structure)
    else:
        values = values_of_object(region, count, whole.origin.structure)
        chosen = _as_mask(array_of(region, name), count, name) if values is None else region_of(values, count)
    chosen = chosen.copy()
    np.logical_or.at(chosen, whole.merged[:, 1], chosen[whole.merged[:, 0]])
    return np.asarray(chosen[whole.vertices]), None


def _as_mask(region: NDArray[Any], count: int, name: str) -> NDArray[np.bool_]:
    """Convert a mask of the vertices, or vertex numbers, to a mask."""
    if region.shape == (count,) and (region.dtype.kind in "bf" or not region.any() or region.max() <= 1):
        with naming(name, ""):
            return as_mask(region)
    if region.ndim != 1 or region.dtype.kind not in "ui":
        raise InputError(
            f"{name} has data type {region.dtype} and shape {region.shape}. Pass a mask of shape ({count},), a "
            "list of vertex numbers or a file"
        )
    bad = region[(region < 0) | (region >= count)]
    if len(bad):
        raise InputError(f"{name} refers to vertex {bad[0]}, but the mesh has {count} vertices, numbered from 0")
    chosen = np.zeros(count, dtype=np.bool_)
    chosen[region] = True
    return chosen


def vertex_at(part: Manifold, point: Sequence[int] | int, name: str) -> tuple[int, list[str]]:
    """Return the vertex nearest to a point that the user gave, and a warning if it is far away."""
    if not part.is_voxels:
        place = array_of(point, f"indices of the {name}")
        if place.ndim != 0 or place.dtype.kind not in "ui":
            raise InputError(f"the {name} is {shown(point)}. Pass a vertex number of the mesh")
        return int(part.find(place[None], f"the {name}")[0]), []
    voxel = seed_voxel(point, part.origin.voxels.shape, name)
    vertex, distance = part.nearest(voxel)
    warnings = found_seed(voxel, part.ids[vertex].tolist(), distance, part._largest_spacing, name)
    return vertex, [in_unit(warning, part.origin.named_unit) for warning in warnings]


def is_medial_wall(region: object) -> bool:
    """Return whether a region is given by the name of the medial wall."""
    name = os.fspath(region) if isinstance(region, str | os.PathLike) else ""
    return name in ("medial wall", "medial-wall")


def medial_wall_of(whole: Manifold) -> NDArray[np.bool_]:
    """Find the medial wall, bool (N,): the one large region where the cortex has no thickness."""
    advice = "Pass the label of the medial wall as the region to drop, or drop nothing"
    if whole.thickness is None:
        raise InputError("the medial wall cannot be found without the pial surface. Pass pial, or a label")
    touching = whole.thickness[whole.vertices] < _TOUCHING
    corners = np.asarray(np.asarray(touching[whole.faces]).all(axis=1))
    if not corners.any():
        raise InputError(f"the white and pial surfaces do not touch, so the medial wall cannot be found. {advice}")
    places = whole.core.part_of_faces(corners)
    areas = places.topology()["components"]["area"].tolist()
    share = areas[0] / sum(whole.core.topology()["components"]["area"].tolist())
    if not _SHARES[0] <= share <= _SHARES[1] or max(areas[1:], default=0.0) * _CLEAR > areas[0]:
        raise InputError(
            f"the white and pial surfaces touch in {len(areas)} places, the largest of which covers "
            f"{100 * share:.1f} % of the surface, so the medial wall is ambiguous. {advice}"
        )
    wall = np.zeros(whole.count, dtype=np.bool_)
    wall[places.largest_piece().ids] = True
    return np.asarray(wall[whole.vertices])
