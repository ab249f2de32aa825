"""Surfaces: what voxels and meshes both become, and what everything else works on."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat import _core
from voxflat.arguments import (
    Progress,
    array_of,
    checked_kind,
    checked_path,
    checked_text,
    checked_threads,
    is_number,
    log,
    numbers_of,
    shown,
)
from voxflat.errors import InputError
from voxflat.io.grid import in_unit, voxel_size, warn_of_unit
from voxflat.io.meshes import Mesh, in_tkras, write_mesh
from voxflat.io.notebook import page
from voxflat.io.patches import FLAT_PATCH_ENDINGS, PATCH_ENDING, Patch, in_patch, patch_border, write_patch
from voxflat.io.provenance import Record, resolved, saving
from voxflat.io.spaces import Space, VolumeGeometry
from voxflat.io.triangles import check_faces
from voxflat.surfaces.cut_sides import listed_points, triangles_of
from voxflat.surfaces.foreground import PackedMask
from voxflat.unique_rows import distinct, in_rows

if TYPE_CHECKING:
    from typing_extensions import Self


@dataclass(frozen=True, eq=False)
class Step:
    """One choice by which a part came about: what `Surface.keep`, `drop`, `disk` and `polygon` were given."""

    verb: str  # what was called; "outlines" is what a template leaves out
    mask: NDArray[np.bool_] | None = None  # the voxels that may stay, of a region of a volume
    by_triangles: bool = False  # whether the region was given by triangles
    seed_point: Any = None  # the middle of a disk: voxel indices or number of a vertex
    seed_found: Any = None  # what stands for it on the surface
    radius: float | None = None  # of the disk, mm
    corners: Any = None  # of a polygon


@dataclass(frozen=True, eq=False)
class Manifold:
    """A surface of triangles: a manifold, with or without a boundary, whose faces run counterclockwise from outside.

    Parameters
    ----------
    core : _core.Surface
        The compiled core's surface.
    voxels : ndarray of int64, shape (V, 3), or None
        The voxel of each vertex of the whole surface, where it came from a volume.
    metadata : dict
        Where it came from and how it was made.
    remarks : tuple of str
        What the user should know of it.
    white_points, pial_points : ndarray of float64, shape (V, 3), or None
        The white and the pial surface at each vertex of the whole surface, RAS+ mm in `space`, where both were given.
    mesh_faces : ndarray of int64, shape (G, 3), or None
        The triangles of the whole mesh as they were given, or mended, as vertex numbers; None if it was no mesh.
    merged : ndarray of int64, shape (M, 2)
        Vertices of the whole surface that are one with another, since they lie where that does, and which that is.
    foreground : PackedMask or None
        The voxels that it was made of.
    whole : Manifold or None
        What it is a part of.
    steps : tuple of Step
        How the part was chosen.
    """

    core: _core.Surface
    voxels: NDArray[np.int64] | None
    metadata: dict[str, Any] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    white_points: NDArray[np.float64] | None = None
    pial_points: NDArray[np.float64] | None = None
    mesh_faces: NDArray[np.int64] | None = None
    merged: NDArray[np.int64] = field(default_factory=lambda: np.empty((0, 2), dtype=np.int64))
    foreground: PackedMask | None = None
    whole: Manifold | None = None
    steps: tuple[Step, ...] = ()

    def __len__(self) -> int:
        """Return the number of vertices."""
        return len(self.core)

    def __repr__(self) -> str:
        kind = "voxels" if self.is_voxels else "a mesh"
        return f"<{type(self).__name__} from {kind}: {len(self)} vertices, {len(self.faces)} triangles>"

    def _repr_html_(self) -> str:
        """Return what the surface is and where it lies, for Jupyter."""
        facts = {"space": self.space.name, "structure": self.metadata.get("structure"), "file": self.metadata["input"]}
        low, high = self.points.min(axis=0), self.points.max(axis=0)
        ranges = (f"{a:.4g} to {b:.4g}" for a, b in zip(low, high, strict=True))
        facts[in_unit("extent, mm", self.metadata)] = ", ".join(ranges)
        return page(self, "\n".join(f"{name:12}{value}" for name, value in facts.items() if value))

    @property
    def is_voxels(self) -> bool:
        """Whether it came from a volume."""
        return self.voxels is not None

    @property
    def voxel_size(self) -> float | None:
        """Geometric mean of the voxels' three spacings, mm, where it came from a volume."""
        if not self.is_voxels:
            return None
        return voxel_size(self.metadata["affine"])

    @property
    def points(self) -> NDArray[np.float64]:
        """The vertices, RAS+ mm in `space`, shape (N, 3)."""
        return self.core.points

    @property
    def space(self) -> Space:
        """The space of its points: that of the volume, or what the mesh's file says."""
        return Space._of(self.metadata)

    @property
    def faces(self) -> NDArray[np.uint32]:
        """Triangles, shape (F, 3)."""
        return self.core.faces

    @property
    def thickness(self) -> NDArray[np.float64] | None:
        """From white to pial surface at each vertex of the whole surface, mm, shape (V,); None if not known."""
        if self.white_points is None or self.pial_points is None:
            return None
        return np.asarray(np.linalg.norm(self.pial_points - self.white_points, axis=1))

    @property
    def usual_edge(self) -> float:
        """Median length of the triangles' edges, mm."""
        corners = self.points[self.faces]
        return float(np.median(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)))

    @property
    def count(self) -> int:
        """Number of vertices of the whole surface, those that no triangle uses among them."""
        return len(self.voxels) if self.voxels is not None else int(self.metadata["vertices"])

    @property
    def vertices(self) -> NDArray[np.int64]:
        """The vertex of the whole surface that each vertex is, shape (N,); the two sides of a cut share one."""
        return self.core.ids.astype(np.int64)

    @property
    def ids(self) -> NDArray[np.int64]:
        """What each vertex is in the input: voxel indices of shape (N, 3), or vertex numbers of shape (N,)."""
        return self.vertices if self.voxels is None else self.voxels[self.core.ids]

    def find(self, ids: ArrayLike, name: str = "the ids") -> NDArray[np.uint32]:
        """Find vertices by what they are in the input.

        Parameters
        ----------
        ids : array_like of int, shape (m, 3) for voxels, (m,) for a mesh
            Voxel indices or vertex numbers.
        name : str
            What they are, for messages.

        Returns
        -------
        ndarray of uint32, shape (m,)
            Numbers of vertices; where a voxel or a cut has several, the first.

        Raises
        ------
        InputError
            If one of them is not on this surface.

        Examples
        --------
        >>> surface = voxflat.samples.hill()
        >>> surface.find([0, 440])
        array([  0, 440], dtype=uint32)
        """
        wanted = array_of(ids, checked_text(name, "name").removeprefix("the "))
        shape = (3,) if self.is_voxels else ()
        what = "voxel indices of shape (m, 3)" if self.is_voxels else "vertex numbers of shape (m,)"
        if wanted.shape[1:] != shape or wanted.ndim == 0 or wanted.dtype.kind not in "ui":
            raise InputError(f"{name} must be {what}, whole numbers, not {wanted.dtype} of shape {wanted.shape}")
        wanted = wanted.astype(np.int64)
        own = self.ids.astype(np.int64)
        if len(self.merged):
            of, one = self.merged.astype(np.int64).T
            own, aliases = np.concatenate([own, of[np.isin(one, own)]]), one[np.isin(one, own)]
        keys = _keys(own, own)
        order = np.argsort(keys, kind="stable")  # so that of several the first is found
        sought = _keys(wanted, own)
        place = np.minimum(np.searchsorted(keys, sought, sorter=order), len(order) - 1)
        found = order[place]
        missing = np.flatnonzero(keys[found] != sought)
        if len(missing):
            first = wanted[missing[0]].tolist()
            raise InputError(f"{self._name(first)} is not on the surface{self._nearest(first)}")
        beyond = found >= len(self.ids)
        if beyond.any():
            found[beyond] = self.find(aliases[found[beyond] - len(self.ids)], name)
        return found.astype(np.uint32)

    def _name(self, key: Any) -> str:
        return f"voxel {key}" if self.is_voxels else f"vertex {key}"

    def _nearest(self, key: Any) -> str:
        if not self.is_voxels:
            return f", which has vertices of a mesh of {self.metadata['vertices']}, counted from 0"
        vertex, distance = self.nearest(key)
        return f"; the nearest surface voxel is {self.ids[vertex].tolist()}, {distance:.1f} mm away"

    def nearest(self, place: Sequence[int]) -> tuple[int, float]:
        """Find the vertex nearest to a voxel.

        Parameters
        ----------
        place : sequence of 3 ints
            Voxel indices.

        Returns
        -------
        vertex : int
        distance : float
            From the voxel's centre to that of the vertex's voxel, mm.

        Examples
        --------
        >>> surface = voxflat.surface(voxflat.samples.ball())
        >>> vertex, distance = surface.nearest((4, 12, 12))
        >>> distance
        0.0
        """
        if not self.is_voxels:
            raise InputError("a surface from a mesh has no voxels. Pass the number of a vertex instead")
        wanted = numbers_of(place, "voxel")
        if wanted.shape != (3,):
            raise InputError(f"the voxel is {shown(place)}. Pass its three indices")
        linear = np.asarray(self.metadata["affine"])[:3, :3]
        apart = np.linalg.norm((self.ids - wanted) @ linear.T, axis=1)
        vertex = int(apart.argmin())
        return vertex, float(apart[vertex])

    def mean_curvature(
        self, smoothing: float = 2.0, *, threads: int | None = None, progress: Progress | None = None
    ) -> NDArray[np.float64]:
        """Return how much the surface bends at each vertex: outwards on gyri, inwards in sulci.

        Parameters
        ----------
        smoothing : float
            Standard deviation of a Gaussian along the surface by which it is averaged, mm; 0 for none. 2 mm are about
            what FreeSurfer's ``curv`` has, whose sign is the other one.
        threads, progress
            As in `voxflat.flatten`.

        Returns
        -------
        ndarray of float64, shape (N,)
            1/mm: ½ (κ₁ + κ₂), positive where it bulges outwards (Cohen-Steiner, Morvan 2003).

        Raises
        ------
        InputError
            If the smoothing is negative or not finite.
        Cancelled
            If `progress` returned False.

        Examples
        --------
        >>> surface = voxflat.samples.hill()
        >>> surface.mean_curvature().shape
        (441,)
        """
        if not (is_number(smoothing) and 0 <= smoothing < np.inf):
            raise InputError(f"smoothing is {shown(smoothing)}. Pass a length in mm, or 0 for no smoothing")
        return self.core.mean_curvature(float(smoothing), checked_threads(threads), progress)

    def sulcal_depth(
        self, flow: float = 70.0, *, threads: int | None = None, progress: Progress | None = None
    ) -> NDArray[np.float64]:
        """Return how deep in a fold each vertex lies: how far it moves outwards while the surface unfolds.

        As FreeSurfer's ``sulc`` it is the displacement along the outer normal, added up; the surface unfolds by a mean
        curvature flow that cannot tear it (Kazhdan, Solomon, Ben-Chen 2012).

        Parameters
        ----------
        flow : float
            How long it flows, mm²: folds of a wavelength λ shrink by exp(−(2π/λ)² flow). 70 mm² are for the human
            cortex; for others, as the square of their size.
        threads, progress
            As in `voxflat.flatten`.

        Returns
        -------
        ndarray of float64, shape (N,)
            mm: positive in sulci, negative on gyri, 0 on average over the area of each component.

        Raises
        ------
        InputError
            If the flow is not positive.
        Cancelled
            If `progress` returned False.

        Examples
        --------
        >>> surface = voxflat.surface(voxflat.samples.ball())
        >>> surface.sulcal_depth().shape
        (632,)
        """
        if not (is_number(flow) and 0 < flow < np.inf):
            raise InputError(f"flow is {shown(flow)}. Pass a positive number of mm²")
        return self.core.sulcal_depth(float(flow), checked_threads(threads), progress)

    def _merged_in(self, vertices: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return vertices of the whole surface, each replaced by the one that it was merged with."""
        one = np.arange(self.count)
        one[self.merged[:, 0]] = self.merged[:, 1]
        return np.asarray(one[vertices])

    def _also_merged(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Find the vertices of the whole surface that were merged with one of this surface."""
        order = np.argsort(self.vertices, kind="stable")
        sides = [np.searchsorted(self.vertices, self.merged[:, 1], side, order) for side in ("left", "right")]
        counts = sides[1] - sides[0]
        within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        return np.repeat(self.merged[:, 0], counts), order[np.repeat(sides[0], counts) + within]

    def _has_triangles(self, faces: NDArray[np.int64]) -> NDArray[np.bool_] | None:
        """Find triangles that are given by vertices of the whole surface."""
        faces = self._merged_in(faces)
        a, b, c = faces.T
        wanted = distinct(np.sort(faces[(a != b) & (b != c) & (c != a)], axis=1)).rows
        found = are_triangles(self.vertices[self.faces], wanted)
        return found if found.sum() == len(wanted) else None

    def _in_patch(self, patch: Patch) -> NDArray[np.bool_]:
        """Find the triangles of a FreeSurfer patch: as its other readers do, those whose corners are all listed."""
        checked_kind(patch, "patch", "vertex_ids", "a Patch, as read_patch returns it")
        is_listed = np.isin(self.merged[:, 0], patch.vertex_ids)
        listed = np.concatenate([patch.vertex_ids, self.merged[is_listed, 1]])
        return in_patch(self.vertices[self.faces], np.unique(listed), self.count)

    def _bridges(self, faces: NDArray[Any] | None = None) -> NDArray[np.int64]:
        """Find the triangles of the mesh that were left out although all their corners are there."""
        if self.mesh_faces is None:
            return np.zeros((0, 3), dtype=np.int64)
        own = self.vertices[self.faces if faces is None else check_faces(faces, len(self))]
        among = self.mesh_faces[triangles_of(np.unique(own), self.mesh_faces)]
        return among[~are_triangles(among, own)]

    def changed_voxels(self) -> NDArray[np.uint8]:
        """Return which voxels the repair changed, as labels: 1 removed, 2 added.

        Returns
        -------
        ndarray of uint8, shape (I, J, K)
            All 0 where nothing was repaired.

        Raises
        ------
        InputError
            If the surface came from a mesh.

        Examples
        --------
        >>> surface = voxflat.surface(voxflat.samples.ball(), repair="voxels")
        >>> int(surface.changed_voxels().sum())
        0
        """
        if not self.is_voxels:
            raise InputError("the surface came from a mesh and has no voxels to change")
        labels = np.zeros(self.metadata["shape"], dtype=np.uint8)
        report = self.metadata.get("repair", {})
        for value, names in ((1, ("cut", "dropped")), (2, ("filled", "cavities"))):
            for name in names:
                labels[tuple(np.asarray(report.get(name, []), dtype=np.int64).reshape(-1, 3).T)] = value
        return labels

    def _with_core(self, core: _core.Surface) -> Self:
        """Return a part of this surface, or a cut one, that is the same otherwise."""
        return replace(self, core=core)

    @property
    def provenance(self) -> Record:
        """What made it: version, function, parameters, and the files that were read."""
        return dict(self.metadata.get("provenance", {}))

    def _with_provenance(self, record: Record) -> Self:
        """Return the same surface with a record of what made it."""
        return replace(self, metadata={**self.metadata, "provenance": resolved(record, self.metadata)})

    def save(self, path: str | os.PathLike[str], *, sidecar: bool = False, overwrite: bool = False) -> None:
        """Write the surface to a file, all of it or nothing.

        Parameters
        ----------
        path : path
            Ends in .surf.gii, .vtp, .ply or .obj, or is named as FreeSurfer names surfaces, like lh.white. FreeSurfer's
            have tkRAS, the others scanner RAS, as `io.write_mesh` says. One that ends in .patch.3d is a FreeSurfer
            patch of the mesh that this is a part of: what ``mris_flatten`` takes. It has the mesh's own vertex numbers
            and one place for each, so vertices on the lips of cuts are left out, and it is said how many. GIFTI holds
            `provenance`.
        sidecar : bool
            Write `provenance` to ``<path>.json``, too.
        overwrite : bool
            Replace a file of that name that voxflat did not write.

        Raises
        ------
        InputError
            If the path has another ending, or is a file that the surface was made of.
        OSError
            If it cannot be written.

        Examples
        --------
        >>> surface = voxflat.samples.hill()
        >>> surface.save("hill.ply")
        """
        path = checked_path(path)
        space, structure = self.space, self.metadata.get("structure")
        if space.name == "scanner" and self.is_voxels:
            volume = VolumeGeometry.of_volume(
                self.metadata["affine"], self.metadata["shape"], self.metadata["input"] or ""
            )
            space = Space("scanner", volume)
        if space.doubt:
            log.warning("%s may be misaligned with volumes: %s", path, space.doubt)
        if path.suffix.lower() not in (".vtp", ".ply", ".obj"):
            warn_of_unit(path, self.metadata)
        with saving(path, self.provenance, sidecar=sidecar, overwrite=overwrite):
            if path.name.lower().endswith((*FLAT_PATCH_ENDINGS, PATCH_ENDING)):
                self._save_patch(path, space)
            else:
                mesh = Mesh(self.points, self.faces.astype(np.int64), structure=structure, space=space)
                write_mesh(path, mesh, self.provenance)

    def _save_patch(self, path: str | os.PathLike[str], space: Space) -> None:
        if os.fspath(path).lower().endswith(FLAT_PATCH_ENDINGS):
            raise InputError(f"cannot write {path}: a 3-D surface is not a flat patch. End its name in {PATCH_ENDING}")
        if self.is_voxels:
            raise InputError("a patch file requires a mesh, but this surface comes from voxels. Save it as .surf.gii")
        points, _ = in_tkras(self.points, space)
        write_patch(path, patch_of(points, self.vertices, self.faces, self._bridges(), self.count, self.merged))


def size_and_space(
    points: NDArray[Any], triangles: int, structure: str | None, space: Space, unit: str
) -> dict[str, Any]:
    """Return what a check says of a mesh: its size, which hemisphere it is, and the space of its points."""
    size = tuple(float(side) for side in np.ptp(points, axis=0))
    about = {"structure": structure, "space": space._described(), "unit": unit}
    return {"vertices": len(points), "triangles": triangles, "size": size, **about}


def are_triangles(faces: NDArray[np.int64], of: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Say which triangles are among others, wherever they begin and whichever way they run."""
    return in_rows(np.sort(faces, axis=1), np.sort(of, axis=1))


def patch_of(
    points: NDArray[np.float64],
    ids: NDArray[np.int64],
    faces: NDArray[Any],
    bridges: NDArray[np.int64],
    count: int,
    merged: NDArray[np.int64],
) -> Patch:
    """Return points as a FreeSurfer patch whose triangles, by its readers' rule, are these; say what it cannot hold.

    `ids` are the vertices of a mesh of `count` that the points are, bridges as `Manifold._bridges` finds them; of
    `merged` the former are listed where the latter are.
    """
    rows = listed_points(ids, faces, bridges)
    kept = faces[triangles_of(rows, faces)]
    if len(kept) == 0:
        raise InputError("every triangle lies at a cut, so a patch file cannot hold them. Save as .vtp, .ply or .obj")
    vertices = len(np.unique(ids[faces]))
    if len(kept) < len(faces):
        log.warning(
            "a patch file stores one position per vertex, and programs read all triangles whose corners it "
            "lists: at cuts, %d of %d vertices and %d of %d triangles are excluded",
            vertices - len(rows),
            vertices,
            len(faces) - len(kept),
            len(faces),
        )
    listed, border = ids[rows], patch_border(ids[kept], ids[rows], count)
    also = merged[np.isin(merged[:, 1], listed)]
    at = np.concatenate([np.arange(len(rows)), np.searchsorted(listed, also[:, 1])])
    numbers = np.concatenate([listed, also[:, 0]])
    order = np.argsort(numbers)
    return Patch(numbers[order], points[rows][at[order]], border[at[order]])


def _keys(ids: NDArray[np.int64], among: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return a number for each vertex number, or voxel (k, 3), -1 for voxels outside the box of others."""
    if ids.ndim == 1:
        return ids
    low, high = among.min(axis=0), among.max(axis=0)
    inside = np.all((ids >= low) & (ids <= high), axis=1)
    keys = np.full(len(ids), -1, dtype=np.int64)
    keys[inside] = np.ravel_multi_index(tuple((ids[inside] - low).T), tuple(high - low + 1))
    return keys
