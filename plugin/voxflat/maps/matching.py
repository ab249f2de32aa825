"""Match flat maps from any tool with a surface: find the position of each vertex."""

import os
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from voxflat import _core
from voxflat.arguments import array_of, log, shown
from voxflat.errors import InputError
from voxflat.io.files import REMEDY, SAVED_ENDINGS, contents, naming
from voxflat.io.formats.obj import read_obj_texture
from voxflat.io.formats.ply import read_ply_texture
from voxflat.io.grid import millimetres
from voxflat.io.meshes import Mesh, named_structure
from voxflat.io.partners import check_participant, check_partner, check_side, check_unit
from voxflat.io.patches import is_patch, read_patch
from voxflat.io.sources import as_mesh
from voxflat.maps.flat_map import FlatMap, load_saved
from voxflat.surfaces.manifold import Manifold, are_triangles
from voxflat.unique_rows import distinct

_OTHER = "Pass the surface on which the map was made"
NOT_A_MAP = "is not a flat map. Pass a flat surface, a FreeSurfer patch, texture coordinates or a map of voxflat"
_COMMON = 0.5  # least share of a map's triangles that are triangles of its surface
_SAME_POINT = 1e-4  # relative to the median edge length, because mesh coordinates may be float32
_SAME_PLACE = 2e-6  # tolerance for positions in single precision, relative to the size of the surface


@dataclass(frozen=True, eq=False)
class Matched:
    """A map, and the surface as cut by the map."""

    core: _core.Surface  # the triangles over which the map is defined; its ids are vertices of the whole surface
    uv: NDArray[np.float64]  # (N, 2)
    period: float | None = None  # of a map that repeats in v
    places: NDArray[np.float64] | None = None  # (V, 2), of the vertices of the whole surface, if each has one; or NaN
    structure: str | None = None  # the hemisphere of the map's file, if known
    is_clockwise: bool | None = None  # whether most of the map's own triangles turn clockwise; None if it has none

    @property
    def vertices(self) -> NDArray[np.int64]:
        """Vertex of the whole surface for each position, shape (N,); both sides of a cut have the same vertex."""
        return self.core.ids.astype(np.int64)

    def joined(self) -> tuple["Matched", NDArray[np.int64]]:
        """Return the map of the surface on which distances are measured, and the vertex there of each vertex.

        The two sides of the seam of a periodic map are joined; other maps stay as they are.
        """
        if self.period is None:
            return self, np.arange(len(self.uv))
        once = distinct(self.vertices[:, None])
        core, _ = _core.Surface.from_triangles(self.core.points[once.first], once.which[self.core.faces])
        number = np.empty(len(core), dtype=np.int64)
        number[core.ids] = np.arange(len(core))
        rows = once.first[core.ids]
        core, uv = core.with_ids(self.core.ids[rows]), np.ascontiguousarray(self.uv[rows])
        return Matched(core, uv, self.period), number[once.which]

    def correspondence(self, other: "Matched") -> NDArray[np.int64] | None:
        """Return the other map's vertex for each vertex, if both maps have the same triangles and cuts."""
        corners, ids = _sorted_corners(self)
        others, other_ids = _sorted_corners(other)
        if not np.array_equal(ids, other_ids):
            return None
        order = np.full(len(self.uv), -1, dtype=np.int64)
        order[corners] = others
        is_same = (order[corners] == others).all() and len(np.unique(order)) == len(order) == len(other.uv)
        return order if is_same else None


def _sorted_corners(flat: Matched) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the corners of all triangles and their vertices, in an order that depends only on the vertices."""
    faces = flat.core.faces.astype(np.int64)
    faces = np.take_along_axis(faces, np.argsort(flat.vertices[faces], axis=1), axis=1)
    ids = flat.vertices[faces]
    order = np.lexsort(ids.T[::-1])
    return faces[order], ids[order]


def loaded(flat: object) -> object:
    """Load the input if it is the path to a complete map; return all other input unchanged."""
    is_ours = isinstance(flat, str | os.PathLike) and os.fspath(flat).lower().endswith(SAVED_ENDINGS)
    return load_saved(flat) if is_ours else flat  # type: ignore[arg-type]


def match(whole: Manifold, flat: object) -> Matched:
    """Match a map, as accepted by `voxflat.measure`, with its surface."""
    with naming(flat, REMEDY) if isinstance(flat, str | os.PathLike) else nullcontext():
        return _match(whole, loaded(flat))


def _match(whole: Manifold, flat: object) -> Matched:
    if isinstance(flat, str | os.PathLike):
        check_partner(flat, whole.origin, _OTHER)
    if isinstance(flat, str | os.PathLike) and is_patch(flat):
        patch = read_patch(flat)
        places = np.full((whole.count, 3), np.nan)
        places[patch.vertex_ids] = patch.points
        matched = _matched(whole, whole.vertices[whole.faces[whole._in_patch(patch)]], places)
        return replace(matched, structure=named_structure(Path(flat)))
    if isinstance(flat, FlatMap):
        cut = _cut_as_it_is(whole, vertices_of(whole, flat), flat.faces.astype(np.int64), flat.uv)
        _check_share(whole, cut.vertices[cut.core.faces])
        return replace(cut, period=flat.period)
    if isinstance(flat, tuple) and len(flat) == 3:
        return _of_rows(whole, *flat)
    mesh = mesh_of_map(flat)
    if mesh is None and isinstance(flat, str | os.PathLike):
        raise InputError(NOT_A_MAP)
    if mesh is None:
        places = array_of(flat, "places")
        if places.ndim != 2 or places.shape[1] not in (2, 3) or places.dtype.kind not in "iuf":
            raise InputError(f"the map is {_kind(places)}. Pass positions as an array of shape (V, 2), or a file")
        return _of_places(whole, places.astype(np.float64), None)
    check_side("the map", mesh.structure, whole.origin.structure, _OTHER)
    check_unit("the map", mesh, whole.origin.unit)
    return replace(_of_mesh(whole, mesh), structure=mesh.structure)


def _of_mesh(whole: Manifold, mesh: Mesh) -> Matched:
    if "surface_points" in mesh.point_data and is_flat(mesh.points):
        return _of_ours(whole, mesh)
    if mesh.texture_coordinates is None or is_flat(mesh.points):
        return _of_places(whole, mesh.points, mesh)
    corners = _texture_of_corners(mesh)
    if corners is None and len(mesh.points) == whole.count:
        return _of_places(whole, mesh.texture_coordinates, mesh)
    return _of_texture(whole, mesh, *(corners or (mesh.faces, mesh.texture_coordinates[mesh.faces])))


def _of_ours(whole: Manifold, mesh: Mesh) -> Matched:
    """Use a map of `FlatMap.to_pyvista` or ``mesh.voxflat()``, which holds the place of each point on the surface."""
    data = mesh.point_data
    is_torn = np.asarray(mesh.face_data.get("torn", np.zeros(len(mesh.faces))), dtype=np.bool_)
    if "vertex_ids" in data and not whole.is_voxels:
        vertices = np.asarray(data["vertex_ids"])
    else:
        apart, nearest = scipy.spatial.cKDTree(whole.points).query(np.asarray(data["surface_points"], dtype=np.float64))
        if not (apart <= _SAME_POINT * whole.usual_edge).all():
            raise InputError(f"some points of the map are up to {apart.max():.3g} away from the surface. {_OTHER}")
        vertices = whole.vertices[nearest]
    cut = _of_rows(whole, mesh.points, mesh.faces[~is_torn], vertices)
    _check_share(whole, cut.vertices[cut.core.faces])
    return cut


def _kind(array: NDArray[Any]) -> str:
    return f"an array of shape {array.shape} and data type {array.dtype}"


def _of_places(whole: Manifold, places: NDArray[np.float64], mesh: Mesh | None) -> Matched:
    if len(places) != whole.count:
        counts = f"the map has {len(places)} points, but the surface has {whole.count} vertices"
        raise InputError(f"{counts}. {'Pass one point per vertex' if mesh is None else _OTHER}")
    is_placed = np.asarray(np.isfinite(places).all(axis=1))
    if mesh is not None:
        check_flat(places[mesh.faces[is_placed[mesh.faces].all(axis=1)].ravel()])
    faces = whole.vertices[whole.faces] if mesh is None else whole._merged_in(mesh.faces)
    matched = _matched(whole, faces[is_placed[faces].all(axis=1)], places)
    if mesh is None:
        return matched
    is_used = np.isin(np.arange(whole.count), mesh.faces)  # others are often at the origin
    is_clockwise = bool(turns(places, mesh.faces[is_placed[mesh.faces].all(axis=1)]).sum() < 0)
    return replace(matched, places=np.where(is_used[:, None], places[:, :2], np.nan), is_clockwise=is_clockwise)


def _texture_of_corners(mesh: Mesh) -> tuple[NDArray[np.int64], NDArray[np.float64]] | None:
    """Return the faces of a file and their corners' texture coordinates (F, 3, 2); None if points have one each."""
    ending = "" if mesh.path is None else mesh.path.suffix.lower()
    if mesh.path is None or ending not in (".obj", ".ply"):
        return None
    with naming(mesh.path, REMEDY):
        data = contents(mesh.path)
        return read_obj_texture(data)[:2] if ending == ".obj" else read_ply_texture(data)


def _of_texture(whole: Manifold, mesh: Mesh, faces: NDArray[np.int64], coordinates: NDArray[np.float64]) -> Matched:
    """Use texture coordinates at the corners of triangles as a map, which is cut where those of a vertex differ."""
    is_placed = np.isfinite(coordinates).all(axis=(1, 2))
    faces, coordinates = faces[is_placed], coordinates[is_placed]
    faces = whole._merged_in(faces) if len(mesh.points) == whole.count else _same_places(whole, mesh.points, faces)
    _check_triangles(whole, faces)
    corners = np.column_stack([faces.ravel(), coordinates.reshape(-1, 2) + 0.0])  # adding 0.0 turns −0 into 0
    rows, _, numbers, _ = distinct(corners)
    vertices = rows[:, 0].astype(np.int64)
    core, _ = _core.Surface.from_triangles(_places_of(whole)[vertices], numbers.reshape(-1, 3), mend=True)
    uv = np.ascontiguousarray(rows[core.ids, 1:])
    return Matched(core.with_ids(vertices[core.ids].astype(np.uint32)), uv)


def _same_places(whole: Manifold, points: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return triangles as vertices of the surface that have the positions of points, which seams have duplicated."""
    used, corners = np.unique(faces, return_inverse=True)
    tree, extent = scipy.spatial.cKDTree(whole.points), np.ptp(whole.points, axis=0).max()
    positions = points[used]
    upright = positions[:, [0, 2, 1]] * [1, -1, 1]  # glTF has the y axis up, and metres
    unit = whole.origin.unit
    metre = 1.0 if unit == "unknown" else millimetres("m") / millimetres(unit)
    near = _SAME_PLACE * (extent + np.abs(whole.points).max())
    for places in (positions, whole.space.from_scanner(positions), upright, metre * positions, metre * upright):
        away, nearest = tree.query(places)
        if away.max(initial=0.0) <= near:
            break
    else:
        away, _ = tree.query(positions)
        text = f"the map has {len(points)} points, but the surface has {whole.count} vertices, and none of them is at"
        raise InputError(
            f"{text} {_shown(positions[away.argmax()])}. Pass one point per vertex, or points at the same positions"
        )
    counts = tree.query_ball_point(whole.points[nearest], near, return_length=True)
    if (counts > 1).any():
        problem = f"several vertices of the surface are at {_shown(positions[counts.argmax()])}"
        raise InputError(f"{problem}, so points cannot be matched by position. Pass one point per vertex")
    return np.asarray(whole.vertices[nearest][corners.reshape(-1, 3)])


def _shown(point: NDArray[np.float64]) -> str:
    return "(" + ", ".join(f"{value:.6g}" for value in point) + ")"


def _of_rows(whole: Manifold, places: Any, faces: Any, vertices: Any) -> Matched:
    """Use positions of given vertices, some of which a cut may have duplicated."""
    places, faces, vertices = (array_of(part, "positions, faces and vertices") for part in (places, faces, vertices))
    if places.ndim != 2 or places.shape[1] not in (2, 3) or places.dtype.kind not in "iuf":
        raise InputError(f"the map is {_kind(places)}. Pass positions as an array of shape (N, 2)")
    if not is_flat(places) or not np.isfinite(places).all():
        raise InputError("the coordinates of the map are not flat or not finite. Pass a flat surface")
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu" or not len(faces):
        raise InputError(f"the triangles of the map are {_kind(faces)}. Pass an integer array of shape (F, 3)")
    if not 0 <= int(faces.min()) <= int(faces.max()) < len(places):
        problem = f"the triangles of the map refer to points {faces.min()} to {faces.max()}"
        raise InputError(f"{problem}. Pass numbers from 0 to {len(places) - 1}")
    if vertices.shape != (len(places),) or vertices.dtype.kind not in "iu":
        raise InputError(f"the vertices of the map are {_kind(vertices)}. Pass one vertex number per point")
    numbers = np.full(whole.count, -1, dtype=np.int64)
    numbers[whole.vertices[::-1]] = np.arange(len(whole))[::-1]  # the first of several matches
    numbers[whole.merged[:, 0]] = numbers[whole.merged[:, 1]]
    is_there = (vertices >= 0) & (vertices < whole.count)
    rows = np.where(is_there, numbers[np.where(is_there, vertices, 0)], -1)
    if (rows < 0).any():
        missing = vertices[rows < 0][0]
        raise InputError(f"vertex {missing} of the map is not a vertex of the surface. Pass a map of this surface")
    return _cut_as_it_is(whole, rows, faces.astype(np.int64), np.asarray(places[:, :2], dtype=np.float64))


def _cut_as_it_is(
    whole: Manifold, vertices: NDArray[np.int64], faces: NDArray[np.int64], uv: NDArray[np.float64]
) -> Matched:
    """Return the map's own triangles, with its cuts, on the surface."""
    core, _ = _core.Surface.from_triangles(whole.points[vertices], faces)
    return Matched(core.with_ids(whole.core.ids[vertices][core.ids]), uv[core.ids])


def vertices_of(whole: Manifold, flat: FlatMap) -> NDArray[np.int64]:
    """Find the vertices of a map's points; if a voxel has two, one for each side of the surface, use the nearer one."""
    check_side("the map", flat.origin.structure, whole.origin.structure, _OTHER)
    made_on, other = flat.origin.size, whole.origin.size
    if flat.is_voxels == whole.is_voxels and made_on != other:
        elements = "voxels" if flat.is_voxels else "vertices"
        sizes = f"{shown(made_on)} {elements}, but the given surface has {shown(other)}"
        raise InputError(f"the map was made on a surface with {sizes}. {_OTHER}")
    check_participant(flat.origin.input, whole.origin.input)
    rows = whole.find(flat.ids, "the map's points").astype(np.int64)
    _, _, kind, counts = distinct(whole.ids)
    order, ends = np.argsort(kind, kind="stable"), np.cumsum(counts)
    for point in np.flatnonzero(counts[kind[rows]] > 1):
        end = ends[kind[rows[point]]]
        candidates = order[end - counts[kind[rows[point]]] : end]
        apart = np.linalg.norm(whole.points[candidates] - flat.points[point], axis=1)
        rows[point] = candidates[apart.argmin()]
    return rows


def _matched(whole: Manifold, faces: NDArray[np.int64], places: NDArray[np.float64]) -> Matched:
    _check_triangles(whole, faces)
    is_mapped = whole._has_triangles(faces)
    if is_mapped is not None:
        core = whole.core.part_of_faces(is_mapped)
    else:  # the map's triangles differ from the surface's
        core, _ = _core.Surface.from_triangles(_places_of(whole), faces, mend=True)
    used = places[core.ids]
    check_flat(used)
    return Matched(core, np.ascontiguousarray(used[:, :2]), places=places[:, :2])


def _check_share(whole: Manifold, faces: NDArray[np.int64]) -> None:
    """Raise an error for a map that has few triangles of the surface; repairs and closed holes change only some."""
    is_common = are_triangles(faces, whole.vertices[whole.faces])
    if is_common.mean() < _COMMON:
        share = f"only {is_common.sum()} of the map's {len(is_common)} triangles are triangles of the surface"
        raise InputError(f"{share}. {_OTHER}")


def _check_triangles(whole: Manifold, faces: NDArray[np.int64]) -> None:
    """Raise an error for vertices that are not on the surface; warn about triangles that are not on it."""
    if len(faces) == 0:
        raise InputError("the map does not contain a complete triangle of the surface. Pass a map of this surface")
    is_there = np.zeros(whole.count, dtype=np.bool_)
    is_there[whole.vertices] = True
    strange = faces[~is_there[faces]]
    if len(strange):
        problem = f"the map has a triangle with vertex {strange[0]}, which is in no triangle of the surface"
        raise InputError(f"{problem}. Pass a map of this surface")
    if whole._has_triangles(faces) is None:
        _check_share(whole, faces)
        log.warning(
            "the map has triangles that the surface does not have. Distortion is measured on the triangles of the map"
        )


def _places_of(whole: Manifold) -> NDArray[np.float64]:
    """Return the positions of all vertices of the whole surface; 0 for vertices without triangles."""
    points = np.zeros((whole.count, 3))
    points[whole.vertices] = whole.points
    return points


def turns(uv: NDArray[np.float64], faces: NDArray[Any]) -> NDArray[np.float64]:
    """Return 1 for each counterclockwise triangle, -1 for each clockwise one, and 0 for those without area."""
    a, b, c = np.moveaxis(uv[:, :2][faces], 1, 0)
    return np.asarray(np.sign(np.linalg.det(np.stack([b - a, c - a], axis=1))))


def mesh_of_map(flat: object) -> Mesh | None:
    """Return a map as a mesh, or None if it has no triangles."""
    if isinstance(flat, tuple) and len(flat) == 2 and np.ndim(flat[0]) == 2 and np.shape(flat[0])[1] == 2:
        flat = (np.pad(array_of(flat[0], "places"), ((0, 0), (0, 1))), flat[1])  # add z = 0
    return as_mesh(flat)


def check_flat(places: NDArray[np.float64]) -> None:
    """Raise an error for points that are not in a plane z = constant."""
    if not is_flat(places):
        depth = float(np.ptp(places[:, 2]))
        raise InputError(f"the map is not flat: its third coordinate varies by {depth:.3g} mm. Pass a flat surface")


def is_flat(places: NDArray[np.float64]) -> bool:
    """Return whether points are in a plane z = constant."""
    if places.shape[1] == 2:
        return True
    extent = np.ptp(places, axis=0) if len(places) else np.zeros(3)
    return bool(extent[2] <= 1e-4 * extent.max())
