"""Surfaces: what voxels and meshes both become, and what everything else works on."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat import _core
from voxflat.errors import InputError
from voxflat.io.freesurfer import Patch
from voxflat.io.meshes import Mesh, write_mesh
from voxflat.io.provenance import Record, resolved, saving

__all__ = ["Surface"]


@dataclass(frozen=True, eq=False)
class Surface:
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
    thickness : ndarray of float64, shape (V,), or None
        From white to pial surface at each vertex of the whole surface, mm, where both were given.
    """

    core: _core.Surface
    voxels: NDArray[np.int64] | None
    metadata: dict[str, Any] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    thickness: NDArray[np.float64] | None = None

    def __len__(self) -> int:
        """Return the number of vertices."""
        return len(self.core)

    def __repr__(self) -> str:
        kind = "voxels" if self.is_voxels else "a mesh"
        return f"<Surface from {kind}: {len(self)} vertices, {len(self.faces)} triangles>"

    @property
    def is_voxels(self) -> bool:
        """Whether it came from a volume."""
        return self.voxels is not None

    @property
    def voxel_size(self) -> float | None:
        """Geometric mean of the voxels' three spacings, mm, where it came from a volume."""
        if not self.is_voxels:
            return None
        return float(np.cbrt(abs(np.linalg.det(np.asarray(self.metadata["affine"])[:3, :3]))))

    @property
    def points(self) -> NDArray[np.float64]:
        """The vertices, RAS+ mm, shape (N, 3)."""
        return self.core.points

    @property
    def faces(self) -> NDArray[np.uint32]:
        """Triangles, shape (F, 3)."""
        return self.core.faces

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
        """
        wanted = np.asarray(ids)
        shape, what = (
            ((3,), "voxel indices of shape (m, 3)") if self.is_voxels else ((), "vertex numbers of shape (m,)")
        )
        if wanted.shape[1:] != shape or wanted.ndim == 0 or wanted.dtype.kind not in "ui":
            raise InputError(f"{name} must be {what}, whole numbers, not {wanted.dtype} of shape {wanted.shape}")
        wanted = wanted.astype(np.int64)
        known: dict[Any, int] = {}
        for number, key in enumerate(map(_key, self.ids.tolist())):
            known.setdefault(key, number)
        found = [known.get(_key(key)) for key in wanted.tolist()]
        if None in found:
            missing = wanted[found.index(None)].tolist()
            raise InputError(f"{self._name(missing)} is not on the surface{self._nearest(missing)}")
        return np.array(found, dtype=np.uint32)

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
        """
        linear = np.asarray(self.metadata["affine"])[:3, :3]
        apart = np.linalg.norm((self.ids - np.asarray(place)) @ linear.T, axis=1)
        vertex = int(apart.argmin())
        return vertex, float(apart[vertex])

    def has_triangles(self, faces: NDArray[np.int64]) -> NDArray[np.bool_] | None:
        """Find triangles that are given by vertices of the whole surface.

        Parameters
        ----------
        faces : ndarray of int, shape (G, 3)
            Triangles, whichever way they run.

        Returns
        -------
        ndarray of bool, shape (F,), or None
            Which of this surface's triangles they are; None if some of them are none of this surface.
        """
        wanted = triangle_keys(faces)
        found = np.isin(triangle_keys(self.vertices[self.faces]), wanted)
        return found if found.sum() == len(np.unique(wanted)) else None

    def in_patch(self, patch: Patch) -> NDArray[np.bool_]:
        """Find the triangles of a FreeSurfer patch.

        A patch file lists vertices; its triangles are those of the surface with all corners in the patch, but for those
        with all corners on its border, which only bridge the two lips of a cut.

        Parameters
        ----------
        patch : Patch
            Of this surface.

        Returns
        -------
        ndarray of bool, shape (F,)

        Raises
        ------
        InputError
            If it names vertices that the surface does not have.
        """
        if len(patch.vertex_ids) and patch.vertex_ids.max() >= self.count:
            raise InputError(
                f"the patch names vertex {patch.vertex_ids.max()}, but the surface has {self.count} vertices: is it of "
                "this one?"
            )
        place = np.zeros(self.count, dtype=np.int8)  # 1 inside, 2 on the border
        place[patch.vertex_ids] = np.where(patch.border, 2, 1)
        corners = place[self.vertices[self.faces]]
        return np.asarray((corners > 0).all(axis=1) & (corners == 1).any(axis=1))

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
        """
        if not self.is_voxels:
            raise InputError("the surface came from a mesh, which has no voxels to change")
        labels = np.zeros(self.metadata["shape"], dtype=np.uint8)
        report = self.metadata.get("repair", {})
        for value, names in ((1, ("cut", "dropped")), (2, ("filled", "cavities"))):
            for name in names:
                labels[tuple(np.asarray(report.get(name, []), dtype=np.int64).reshape(-1, 3).T)] = value
        return labels

    def with_core(self, core: _core.Surface) -> Surface:
        """Return a part of this surface, or a cut one, that is the same otherwise.

        Parameters
        ----------
        core : _core.Surface
            Made of this one's.

        Returns
        -------
        Surface
        """
        return replace(self, core=core)

    @property
    def provenance(self) -> Record:
        """What made it: version, function, parameters, and the files that were read."""
        return dict(self.metadata.get("provenance", {}))

    def with_provenance(self, record: Record) -> Surface:
        """Return the same surface with a record of what made it.

        Parameters
        ----------
        record : dict
            As `provenance`.

        Returns
        -------
        Surface
        """
        return replace(self, metadata={**self.metadata, "provenance": resolved(record, self.metadata)})

    def save(self, path: str | os.PathLike[str], *, sidecar: bool = False, overwrite: bool = False) -> None:
        """Write the surface to a file, all of it or nothing.

        Parameters
        ----------
        path : path
            Ends in .surf.gii, .vtp, .ply or .obj, or is named as FreeSurfer names surfaces, like lh.white. GIFTI holds
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
        """
        mesh = Mesh(self.points, self.faces.astype(np.int64), structure=self.metadata.get("structure"))
        with saving(path, self.provenance, sidecar=sidecar, overwrite=overwrite):
            write_mesh(path, mesh, self.provenance)


def triangle_keys(faces: NDArray[np.int64]) -> NDArray[Any]:
    """Return one item a triangle that does not depend on where it begins or which way it runs."""
    rows = np.ascontiguousarray(np.sort(faces, axis=1))
    return rows.view([("", np.int64)] * 3).ravel()


def _key(item: Any) -> Any:
    return tuple(item) if isinstance(item, list) else item
