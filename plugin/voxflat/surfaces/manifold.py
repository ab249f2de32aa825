"""Define surfaces, which are made from voxels and meshes and used by all other modules."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat import _core
from voxflat.arguments import (
    Progress,
    array_of,
    checked_instance,
    checked_text,
    checked_threads,
    is_number,
    log,
    numbers_of,
    shown,
)
from voxflat.errors import InputError
from voxflat.io.grid import in_unit, rounded, voxel_size, warn_of_unit
from voxflat.io.meshes import Mesh, in_tkras, write_mesh
from voxflat.io.notebook import page
from voxflat.io.origin import Origin
from voxflat.io.patches import FLAT_PATCH_ENDINGS, PATCH_ENDING, Patch, in_patch, patch_border, write_patch
from voxflat.io.provenance import Record, resolved
from voxflat.io.saved import Saved
from voxflat.io.spaces import Space, VolumeGeometry
from voxflat.io.triangles import check_faces
from voxflat.read_only import ReadOnly
from voxflat.surfaces.cut_sides import listed_points, triangles_of
from voxflat.surfaces.foreground import PackedMask, Repair
from voxflat.unique_rows import distinct, in_rows

if TYPE_CHECKING:
    from typing_extensions import Self


@dataclass(frozen=True, eq=False)
class Step:
    """One step that selected a part of a surface, such as `Surface.keep` or `Surface.disk`."""

    verb: str  # name of the method; "outlines" for a template's excluded region
    mask: NDArray[np.bool_] | None = None  # voxels to keep, for a region of a volume
    by_triangles: bool = False  # whether triangles defined the region
    seed_point: Any = None  # centre of a disk: voxel indices or vertex number
    seed_found: Any = None  # nearest voxel or vertex on the surface
    radius: float | None = None  # radius of a disk, mm
    corners: Any = None  # corners of a polygon


@dataclass(frozen=True, eq=False)
class Manifold(ReadOnly, Saved):
    """The geometry of a surface: an oriented manifold of triangles, with or without a boundary.

    `voxflat.Surface` describes the fields and adds operations that need the modules above. Arrays with V rows refer to
    the vertices of the complete surface.
    """

    _kind = "the surface"
    _formats = """
    File name that ends in .surf.gii, .vtp, .ply or .obj, or a FreeSurfer name such as lh.white. FreeSurfer files are
    in tkRAS; other files are in scanner RAS, as in `io.write_mesh`. A name that ends in .patch.3d writes a FreeSurfer
    patch of the original mesh, for ``mris_flatten``. A patch uses the vertex numbers of the mesh and has one position
    per vertex, so it excludes vertices at the sides of cuts; a warning reports how many. GIFTI files contain
    `provenance`.
    """

    core: _core.Surface
    voxels: NDArray[np.int64] | None
    origin: Origin
    details: dict[str, object] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    white_points: NDArray[np.float64] | None = None
    pial_points: NDArray[np.float64] | None = None
    mesh_faces: NDArray[np.int64] | None = None
    foreground: PackedMask | None = None
    whole: Self | None = None
    steps: tuple[Step, ...] = ()
    repair: Repair | None = None
    uncertain: NDArray[np.uint8] | None = None
    provenance: Record = field(default_factory=dict)

    @property
    def metadata(self) -> dict[str, object]:
        """How the surface was made, for people and files: written from the fields, and read by no operation."""
        record = {"provenance": self.provenance} if self.provenance else {}
        return {**self.origin._described(), **self.details, **record}

    @property
    def _complete(self) -> Self:
        """The surface of which this one is a part, or this one."""
        return self if self.whole is None else self.whole

    def __len__(self) -> int:
        """Return the number of vertices."""
        return len(self.core)

    def __repr__(self) -> str:
        kind = "voxels" if self.is_voxels else "a mesh"
        return f"<{type(self).__name__} from {kind}: {len(self)} vertices, {len(self.faces)} triangles>"

    def _repr_html_(self) -> str:
        """Return a description of the surface and its position, for Jupyter."""
        facts = {"space": self.space.name, "structure": self.origin.structure, "file": self.origin.input}
        low, high = self.points.min(axis=0), self.points.max(axis=0)
        ranges = (f"{a:.4g} to {b:.4g}" for a, b in zip(low, high, strict=True))
        facts[in_unit("extent, mm", self.origin.named_unit)] = ", ".join(ranges)
        return page(self, "\n".join(f"{name:12}{value}" for name, value in facts.items() if value))

    @property
    def is_voxels(self) -> bool:
        """Whether the surface came from a volume."""
        return self.voxels is not None

    @property
    def voxel_size(self) -> float | None:
        """Geometric mean of the three voxel spacings, in mm. It is None for a surface from a mesh."""
        return voxel_size(self.origin.voxels.affine) if self.is_voxels else None

    @property
    def _largest_spacing(self) -> float:
        """The largest of the three voxel spacings, in mm; the surface must come from a volume."""
        return float(np.linalg.norm(self.origin.voxels.affine[:3, :3], axis=0).max())

    @property
    def points(self) -> NDArray[np.float64]:
        """Coordinates of the vertices, in RAS+ mm in `space`, shape (N, 3).

        The two sides of a cut have separate vertices.
        """
        return self.core.points

    @property
    def space(self) -> Space:
        """Coordinate space of the points.

        It is the space of the volume, or the space that the file of the mesh defines.
        """
        return self.origin.space

    @property
    def faces(self) -> NDArray[np.uint32]:
        """Triangles as vertex numbers, shape (F, 3). Corners are listed counterclockwise as seen from outside."""
        return self.core.faces

    @property
    def thickness(self) -> NDArray[np.float64] | None:
        """Distance from the white to the pial surface at each vertex of the complete surface, in mm, shape (V,).

        It is None if the white or the pial surface is not known.
        """
        if self.white_points is None or self.pial_points is None:
            return None
        return np.asarray(np.linalg.norm(self.pial_points - self.white_points, axis=1))

    @property
    def merged(self) -> NDArray[np.int64]:
        """Pairs of vertices of the whole mesh, shape (M, 2).

        They are a vertex, and the vertex at the same position that replaces it.
        """
        return np.empty((0, 2), dtype=np.int64) if self.is_voxels else self.origin.mesh.merged

    @property
    def usual_edge(self) -> float:
        """Median length of the triangle edges, in mm. It is a measure of the resolution of the surface."""
        corners = self.points[self.faces]
        return float(np.median(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)))

    @property
    def count(self) -> int:
        """Number of vertices of the complete surface. It includes vertices without a triangle."""
        return len(self.voxels) if self.voxels is not None else self.origin.mesh.vertices

    @property
    def vertices(self) -> NDArray[np.int64]:
        """Number of each vertex in the complete surface, shape (N,). The two sides of a cut share a number."""
        return self.core.ids.astype(np.int64)

    @property
    def ids(self) -> NDArray[np.int64]:
        """The voxel or vertex of the input that corresponds to each vertex.

        These are voxel indices of shape (N, 3), or vertex numbers of shape (N,) if the input was a mesh.
        """
        return self.vertices if self.voxels is None else self.voxels[self.core.ids]

    def find(self, ids: ArrayLike, name: str = "the ids") -> NDArray[np.uint32]:
        """Find vertices by their voxels or vertex numbers in the input.

        This is the inverse of `ids`.

        Parameters
        ----------
        ids : array_like of int, shape (m, 3) for voxels, (m,) for a mesh
            Voxel indices or vertex numbers.
        name : str
            Name of the ids in error messages.

        Returns
        -------
        ndarray of uint32, shape (m,)
            Vertex numbers; the first one if a voxel or a cut has several vertices.

        Raises
        ------
        InputError
            If one of the ids is not on this surface.

        Examples
        --------
        >>> surface = voxflat.samples.hill()
        >>> surface.find([0, 440])
        array([  0, 440], dtype=uint32)
        """
        asked = array_of(ids, checked_text(name, "name").removeprefix("the "))
        shape = (3,) if self.is_voxels else ()
        if asked.shape[1:] != shape or asked.ndim == 0 or asked.dtype.kind not in "ui":
            kind = (
                "voxel indices (integers) of shape (m, 3)"
                if self.is_voxels
                else "vertex numbers (integers) of shape (m,)"
            )
            raise InputError(f"{name} must be {kind}, but got data type {asked.dtype} and shape {asked.shape}")
        asked = asked.astype(np.int64)
        numbers = self.ids.astype(np.int64)
        if len(self.merged):
            original, copy = self.merged.astype(np.int64).T
            numbers, aliases = np.concatenate([numbers, original[np.isin(copy, numbers)]]), copy[np.isin(copy, numbers)]
        keys = _keys(numbers, numbers)
        order = np.argsort(keys, kind="stable")  # stable, so that the first of several vertices is found
        sought = _keys(asked, numbers)
        place = np.minimum(np.searchsorted(keys, sought, sorter=order), len(order) - 1)
        rows = order[place]
        missing = np.flatnonzero(keys[rows] != sought)
        if len(missing):
            first = asked[missing[0]].tolist()
            raise InputError(f"{self._name(first)} is not on the surface{self._nearest(first)}")
        beyond = rows >= len(self.ids)
        if beyond.any():
            rows[beyond] = self.find(aliases[rows[beyond] - len(self.ids)], name)
        return rows.astype(np.uint32)

    def _name(self, key: Any) -> str:
        return f"voxel {key}" if self.is_voxels else f"vertex {key}"

    def _nearest(self, key: Any) -> str:
        if not self.is_voxels:
            return f"; the vertices of the mesh are numbered from 0 to {self.origin.mesh.vertices - 1}"
        vertex, distance = self.nearest(key)
        away = in_unit(f"{rounded(distance, 1)} mm", self.origin.named_unit)
        return f"; the nearest surface voxel is {self.ids[vertex].tolist()}, {away} away"

    def nearest(self, place: Sequence[int]) -> tuple[int, float]:
        """Find the vertex nearest to a voxel.

        Only surfaces from volumes have voxels.

        Parameters
        ----------
        place : sequence of 3 ints
            Voxel indices.

        Returns
        -------
        vertex : int
            Vertex number.
        distance : float
            Distance from the centre of the voxel to the centre of the vertex's voxel, in mm.

        Examples
        --------
        >>> surface = voxflat.surface(voxflat.samples.ball())
        >>> vertex, distance = surface.nearest((4, 12, 12))
        >>> distance
        0.0
        """
        if not self.is_voxels:
            raise InputError("a surface from a mesh has no voxels. Pass a vertex number instead")
        voxel = numbers_of(place, "voxel")
        if voxel.shape != (3,):
            raise InputError(f"the voxel is {shown(place)}. Pass three voxel indices")
        linear = self.origin.voxels.affine[:3, :3]
        apart = np.linalg.norm((self.ids - voxel) @ linear.T, axis=1)
        vertex = int(apart.argmin())
        return vertex, float(apart[vertex])

    def mean_curvature(
        self, smoothing: float = 2.0, *, threads: int | None = None, progress: Progress | None = None
    ) -> NDArray[np.float64]:
        """Return the mean curvature at each vertex.

        The mean curvature is ½ (κ₁ + κ₂) (Cohen-Steiner and Morvan, 2003), positive on gyri and negative in sulci.

        Parameters
        ----------
        smoothing : float
            Standard deviation in mm of a Gaussian that smooths the curvature along the surface; 0 for no smoothing.
            A value of 2 mm is similar to FreeSurfer's ``curv``, which has the opposite sign.
        threads, progress : optional
            As in `Surface.flatten`.

        Returns
        -------
        ndarray of float64, shape (N,)
            Mean curvature in 1/mm, positive where the surface bulges outwards.

        Raises
        ------
        InputError, Cancelled
            If the smoothing is negative or not finite, or `progress` returned False.
        """
        if not (is_number(smoothing) and 0 <= smoothing < np.inf):
            raise InputError(f"smoothing is {shown(smoothing)}. Pass a length in mm, or 0 for no smoothing")
        return self.core.mean_curvature(float(smoothing), checked_threads(threads), progress)

    def sulcal_depth(
        self, flow: float = 70.0, *, threads: int | None = None, progress: Progress | None = None
    ) -> NDArray[np.float64]:
        """Return how far each vertex moves outwards while the surface unfolds.

        Like FreeSurfer's ``sulc``, it is the accumulated displacement along the outer normal. The surface unfolds by a
        mean curvature flow that cannot tear it (Kazhdan, Solomon and Ben-Chen, 2012).

        Parameters
        ----------
        flow : float
            Duration of the flow in mm²: folds of wavelength λ shrink by exp(−(2π/λ)² flow). 70 mm² suits the human
            cortex; for other surfaces, scale it with the square of their size.
        threads, progress : optional
            As in `Surface.flatten`.

        Returns
        -------
        ndarray of float64, shape (N,)
            Depth in mm: positive in sulci, negative on gyri, 0 on average over the area of each component.

        Raises
        ------
        InputError, Cancelled
            If `flow` is not positive, or `progress` returned False.
        """
        if not (is_number(flow) and 0 < flow < np.inf):
            raise InputError(f"flow is {shown(flow)}. Pass a positive number of mm²")
        return self.core.sulcal_depth(float(flow), checked_threads(threads), progress)

    def _merged_in(self, vertices: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return vertices of the complete surface, each replaced by the vertex that it was merged with."""
        target = np.arange(self.count)
        target[self.merged[:, 0]] = self.merged[:, 1]
        return np.asarray(target[vertices])

    def _also_merged(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Find the vertices of the complete surface that were merged with a vertex of this surface."""
        order = np.argsort(self.vertices, kind="stable")
        sides = [np.searchsorted(self.vertices, self.merged[:, 1], side, order) for side in ("left", "right")]
        counts = sides[1] - sides[0]
        within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        return np.repeat(self.merged[:, 0], counts), order[np.repeat(sides[0], counts) + within]

    def _has_triangles(self, faces: NDArray[np.int64]) -> NDArray[np.bool_] | None:
        """Find triangles that are given by vertices of the complete surface."""
        faces = self._merged_in(faces)
        a, b, c = faces.T
        asked = distinct(np.sort(faces[(a != b) & (b != c) & (c != a)], axis=1)).rows
        is_there = are_triangles(self.vertices[self.faces], asked)
        return is_there if is_there.sum() == len(asked) else None

    def _in_patch(self, patch: Patch) -> NDArray[np.bool_]:
        """Find the triangles of a FreeSurfer patch: like other programs, take those whose corners are all listed."""
        checked_instance(patch, Patch, "patch", "a Patch, as read_patch returns it")
        is_listed = np.isin(self.merged[:, 0], patch.vertex_ids)
        listed = np.concatenate([patch.vertex_ids, self.merged[is_listed, 1]])
        return in_patch(self.vertices[self.faces], np.unique(listed), self.count)

    def _bridges(self, faces: NDArray[Any] | None = None) -> NDArray[np.int64]:
        """Find excluded triangles of the mesh whose corners are all on the surface."""
        if self.mesh_faces is None:
            return np.zeros((0, 3), dtype=np.int64)
        corners = self.vertices[self.faces if faces is None else check_faces(faces, len(self))]
        among = self.mesh_faces[triangles_of(np.unique(corners), self.mesh_faces)]
        return among[~are_triangles(among, corners)]

    def changed_voxels(self) -> NDArray[np.uint8]:
        """Return the voxels that the repair changed.

        Only surfaces from volumes have voxels.

        Returns
        -------
        ndarray of uint8, shape (I, J, K)
            Labels: 1 for removed voxels, 2 for added voxels, 0 for all others.

        Raises
        ------
        InputError
            If the surface came from a mesh.
        """
        if not self.is_voxels:
            raise InputError("the surface came from a mesh, so no voxels were changed. Pass a surface from a volume")
        labels = np.zeros(self.origin.voxels.shape, dtype=np.uint8)
        if (repair := self.repair) is not None:
            labels[tuple(np.concatenate([repair.cut, repair.dropped]).T)] = 1
            labels[tuple(np.concatenate([repair.filled, repair.cavities]).T)] = 2
        return labels

    def _with_core(self, core: _core.Surface) -> Self:
        """Return this surface with another core, such as a part or a cut surface."""
        return replace(self, core=core)

    def _with_provenance(self, record: Record) -> Self:
        """Return the same surface with a provenance record."""
        return replace(self, provenance=resolved(record, self.metadata))

    def _write(self, path: Path) -> None:
        space, structure = self.space, self.origin.structure
        if space.name == "scanner" and self.is_voxels:
            voxels = self.origin.voxels
            space = Space("scanner", VolumeGeometry.of_volume(voxels.affine, voxels.shape, voxels.input or ""))
        if space.warning:
            log.warning("%s may be misaligned with volumes: %s", path, space.warning)
        if path.name.lower().endswith((*FLAT_PATCH_ENDINGS, PATCH_ENDING)):
            self._save_patch(path, space)
        else:
            write_mesh(
                path, Mesh(self.points, self.faces.astype(np.int64), structure=structure, space=space), self.provenance
            )
        if path.suffix.lower() not in (".vtp", ".ply", ".obj"):
            warn_of_unit(path, self.origin.unit)

    def _save_patch(self, path: str | os.PathLike[str], space: Space) -> None:
        if os.fspath(path).lower().endswith(FLAT_PATCH_ENDINGS):
            raise InputError(f"{path}: a 3-D surface is not a flat patch. Pass a name that ends in {PATCH_ENDING}")
        if self.is_voxels:
            raise InputError("a patch file requires a mesh, but this surface comes from voxels. Save it as .surf.gii")
        points, _ = in_tkras(self.points, space)
        write_patch(path, patch_of(points, self.vertices, self.faces, self._bridges(), self.count, self.merged))


SurfaceT = TypeVar("SurfaceT", bound=Manifold)
"""The class of a surface, which functions that make a part of it or cut it keep."""

SurfaceT_co = TypeVar("SurfaceT_co", bound=Manifold, covariant=True)
"""The same for classes that hold surfaces."""


def size_and_space(
    points: NDArray[Any], triangles: int, structure: str | None, space: Space, unit: str
) -> dict[str, Any]:
    """Return size, hemisphere and coordinate space of a mesh, for a check."""
    there = points[np.isfinite(points).all(axis=1)]
    size = tuple(float(side) for side in np.ptp(there, axis=0)) if len(there) else (0.0, 0.0, 0.0)
    about = {"structure": structure, "space": space._described(), "unit": unit}
    return {"vertices": len(points), "triangles": triangles, "size": size, **about}


def are_triangles(faces: NDArray[np.int64], others: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return a mask of the triangles that are among others, regardless of their first corner and direction."""
    return in_rows(np.sort(faces, axis=1), np.sort(others, axis=1))


def patch_of(
    points: NDArray[np.float64],
    ids: NDArray[np.int64],
    faces: NDArray[Any],
    bridges: NDArray[np.int64],
    count: int,
    merged: NDArray[np.int64],
) -> Patch:
    """Return points as a FreeSurfer patch with the given triangles; a warning reports excluded triangles.

    `ids` are the points' vertices in a mesh of `count` vertices, `bridges` are from `Manifold._bridges`, and the first
    vertices of `merged` are listed together with the second ones.
    """
    rows = listed_points(ids, faces, bridges)
    listed_faces = faces[triangles_of(rows, faces)]
    if len(listed_faces) == 0:
        raise InputError(
            "every triangle borders a cut, so a patch file cannot store any of them. Save as .vtp, .ply or .obj"
        )
    vertices = len(np.unique(ids[faces]))
    if len(listed_faces) < len(faces):
        log.warning(
            "%d of %d vertices and %d of %d triangles at cuts are excluded, because a patch file stores one position "
            "per vertex, and programs read every triangle whose corners it lists",
            vertices - len(rows),
            vertices,
            len(faces) - len(listed_faces),
            len(faces),
        )
    listed, border = ids[rows], patch_border(ids[listed_faces], ids[rows], count)
    also = merged[np.isin(merged[:, 1], listed)]
    at = np.concatenate([np.arange(len(rows)), np.searchsorted(listed, also[:, 1])])
    numbers = np.concatenate([listed, also[:, 0]])
    order = np.argsort(numbers)
    return Patch(numbers[order], points[rows][at[order]], border[at[order]])


def _keys(ids: NDArray[np.int64], among: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return a number for each vertex number, or voxel (k, 3); -1 for voxels outside the bounding box of the others."""
    if ids.ndim == 1:
        return ids
    low, high = among.min(axis=0), among.max(axis=0)
    inside = np.all((ids >= low) & (ids <= high), axis=1)
    keys = np.full(len(ids), -1, dtype=np.int64)
    keys[inside] = np.ravel_multi_index(tuple((ids[inside] - low).T), tuple(high - low + 1))
    return keys
