"""Surfaces: what voxels and meshes both become, and what everything else works on."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from numbers import Integral, Real
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat import _core
from voxflat.arguments import BYTES_PER_VOXEL, Progress, check_memory, check_scalar
from voxflat.errors import InputError
from voxflat.io.meshes import Mesh, Patch, is_mesh_name, read_mesh, suspicious_units, write_mesh
from voxflat.io.volumes import Volume, as_volume
from voxflat.surfaces.foreground import foreground

__all__ = ["Surface", "as_mesh", "surface"]

_SHARE_BETWEEN = 0.5  # of the border's voxels, for an image to be finer than its mask


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
        wanted = _row_keys(faces)
        found = np.isin(_row_keys(self.vertices[self.faces]), wanted)
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
        if len(patch.vertices) and patch.vertices.max() >= self.count:
            raise InputError(
                f"the patch names vertex {patch.vertices.max()}, but the surface has {self.count} vertices: is it of "
                "this one?"
            )
        place = np.zeros(self.count, dtype=np.int8)  # 1 inside, 2 on the border
        place[patch.vertices] = np.where(patch.border, 2, 1)
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

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the surface to a file, all of it or nothing.

        Parameters
        ----------
        path : path
            Ends in .surf.gii, .vtp, .ply or .obj, or is named as FreeSurfer names surfaces, like lh.white.

        Raises
        ------
        InputError
            If the path has another ending or cannot be written.
        """
        write_mesh(path, Mesh(self.points, self.faces.astype(np.int64), structure=self.metadata.get("structure")))


def _row_keys(faces: NDArray[np.int64]) -> NDArray[Any]:
    """Return one item a triangle that does not depend on where it begins or which way it runs."""
    rows = np.ascontiguousarray(np.sort(faces, axis=1))
    return rows.view([("", np.int64)] * 3).ravel()


def _key(item: Any) -> Any:
    return tuple(item) if isinstance(item, list) else item


def surface(
    source: object,
    *,
    label: int | None = None,
    threshold: float | None = None,
    spacing: Sequence[float] | None = None,
    affine: ArrayLike | None = None,
    probability: object | None = None,
    sheet: bool | None = None,
    pial: object | None = None,
    repair: bool | str = False,
    memory_limit: int | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Surface:
    """Make a surface of a label volume or of a mesh.

    The surface of a volume has a vertex for each surface voxel and side: surfels, the faces between foreground and
    background voxels, are glued along their edges, so that thin blades keep two sides and touching banks stay apart,
    and drawn together voxel by voxel. No iso-surface is made: every vertex is a voxel, placed finer than the grid.

    Parameters
    ----------
    source : ndarray, path, image object, Volume, (points, faces), Mesh, pyvista.PolyData or Surface
        A label or intensity volume (I, J, K), or a mesh of triangles in RAS+ mm.
    label, threshold, spacing, affine
        What of a volume is foreground, and where it lies: as in `flatten`.
    probability : ndarray, path, image object or Volume, optional
        An image of the volume's shape whose value is `threshold`, or 0.5, on the surface: points are placed there. By
        default they are placed by the volume itself where `threshold` is given and its values change smoothly, and else
        by a fit to the voxels.
    sheet : bool, optional
        Whether the foreground is a sheet one voxel thick, of which one surface is made instead of two sides. By default
        this is recognised.
    pial : path, Mesh, (points, faces) or pyvista.PolyData, optional
        Where `source` is a white surface, the pial surface with the same vertices: distances are measured midway.
    repair : {False, True, "voxels", "cuts"}
        Make the surface of a volume a sphere: by the fewest voxels taken away or added that leave no handle
        ("voxels" or True), or by cutting handles open ("cuts", also for meshes).
    memory_limit : int, optional
        Bytes that may be used; by default what is free.
    threads : int, optional
        By default one a core.
    progress : callable, optional
        As in `flatten`.

    Returns
    -------
    Surface

    Raises
    ------
    InputError
        If the input is no surface; the message names the place and the remedy.
    Cancelled
        If `progress` returned False.
    """
    if repair not in (False, True, "voxels", "cuts"):
        raise InputError(f"repair is {repair!r}; give False, True, 'voxels' or 'cuts'")
    if isinstance(source, Surface):
        made = source
        _refuse_options("a Surface", label=label, threshold=threshold, spacing=spacing, affine=affine, pial=pial)
        _refuse_options("a Surface", probability=probability, sheet=sheet, repair=repair or None)
    elif (mesh := as_mesh(source)) is not None:
        _refuse_options("a mesh", label=label, threshold=threshold, spacing=spacing, affine=affine)
        _refuse_options("a mesh", probability=probability, sheet=sheet)
        if repair in (True, "voxels"):
            raise InputError(f"repair is {repair!r}, but a mesh has no voxels; give 'cuts'")
        made = _of_mesh(mesh, pial)
    else:
        _refuse_options("a volume", pial=pial)
        volume = as_volume(source, spacing=spacing, affine=affine)
        made = _of_volume(volume, label, threshold, probability, sheet, repair, memory_limit, threads, progress)
    return _cut_handles(made, progress) if repair == "cuts" else made


def _refuse_options(what: str, **options: object) -> None:
    for name, value in options.items():
        if value is not None:
            raise InputError(f"{name} is given, but the input is {what}, for which it means nothing; leave it out")


# ------------------------------------------------------------------------------------------ from meshes


def as_mesh(source: object) -> Mesh | None:
    """Take what is a mesh as a `Mesh`; None for everything else.

    Parameters
    ----------
    source : object
        A path, (points, faces), a Mesh or a pyvista.PolyData.

    Returns
    -------
    Mesh or None

    Raises
    ------
    InputError
        If it is a mesh, but a damaged one.
    """
    if isinstance(source, Mesh):
        return source
    if isinstance(source, str | os.PathLike):
        return read_mesh(source) if is_mesh_name(Path(source)) else None
    if isinstance(source, tuple) and len(source) == 2:
        points, faces = (np.asarray(part) for part in source)
        return Mesh(points, faces)
    if type(source).__name__ == "PolyData" and hasattr(source, "regular_faces"):
        return _of_polydata(source)
    return None


def _of_polydata(mesh: Any) -> Mesh:
    if mesh.n_lines:  # which triangulate() leaves where all faces are triangles already
        raise InputError(
            f"the PolyData has {mesh.n_lines} lines; triangulate it and remove them: mesh = mesh.triangulate(); "
            "mesh.SetLines(None)"
        )
    if not mesh.is_all_triangles:
        raise InputError("the PolyData has faces that are no triangles, or none; triangulate it: mesh.triangulate()")
    return Mesh(np.asarray(mesh.points), np.asarray(mesh.regular_faces))


def _of_mesh(mesh: Mesh, pial: object | None) -> Surface:
    core, turned, unused = _core.Surface.from_triangles(mesh.points, mesh.faces)
    remarks = list(mesh.remarks)
    if turned:
        remarks.append(f"{turned} of {len(mesh.faces)} triangles were turned over, so that all face outside")
    if unused:
        remarks.append(f"{unused} of {len(mesh.points)} vertices belong to no triangle and are left out")
    suspicion = suspicious_units(mesh.points)
    if suspicion and suspicion not in remarks:
        remarks.append(f"the surface {suspicion}")
    measured_on = "the given surface"
    thickness = None
    if pial is not None:
        other = as_mesh(pial)
        if other is None:
            raise InputError(f"pial is {type(pial).__name__}; give a mesh: a path, (points, faces), or a PolyData")
        if len(other.points) != len(mesh.points):
            raise InputError(
                f"the pial surface has {len(other.points)} vertices, the given one {len(mesh.points)}; they must be of "
                "one subject and correspond vertex by vertex"
            )
        thickness = np.linalg.norm(other.points - mesh.points, axis=1)
        core = core.moved((mesh.points[core.ids] + other.points[core.ids]) / 2)
        measured_on = "midthickness: halfway to the pial surface"
    digest = hashlib.sha256(np.ascontiguousarray(core.points).tobytes() + mesh.faces.tobytes())
    metadata = {
        "kind": "mesh",
        "input": None if mesh.path is None else str(mesh.path),
        "input_sha256": digest.hexdigest(),
        "vertices": len(mesh.points),
        "structure": mesh.structure,
        "measured_on": measured_on,
    }
    return Surface(core, None, metadata, tuple(remarks), thickness)


# ------------------------------------------------------------------------------------------ from volumes


def _of_volume(
    volume: Volume,
    label: int | None,
    threshold: float | None,
    probability: object | None,
    sheet: bool | None,
    repair: bool | str,
    memory_limit: int | None,
    threads: int | None,
    progress: Progress | None,
) -> Surface:
    if threshold is not None and not isinstance(threshold, Real):
        raise InputError(f"the threshold is {threshold!r}; give a number")
    if label is not None and not isinstance(label, Integral):
        raise InputError(f"the label is {label!r}; give a whole number, or a threshold for intensities")
    check_scalar(volume)
    check_memory(BYTES_PER_VOXEL * volume.data.size, memory_limit, "crop or downsample the volume")
    mask = foreground(volume.data, label=label, threshold=threshold)
    digest = hashlib.sha256(np.packbits(mask).tobytes() + str(mask.shape).encode()).hexdigest()
    level, placed_by = _level(volume, mask, threshold, probability)
    metadata: dict[str, Any] = {
        "kind": "voxels",
        "input": None if volume.path is None else str(volume.path),
        "input_sha256": digest,
        "shape": [int(n) for n in volume.data.shape],
        "affine": volume.affine.tolist(),
        "label": None if label is None else int(label),
        "threshold": None if threshold is None else float(threshold),
        "foreground": int(np.count_nonzero(mask)),
    }
    remarks: list[str] = []
    if repair in (True, "voxels"):
        mask, metadata["repair"], remarks = _repaired(mask, volume, level, progress)
    core, voxels, made = _core.Surface.from_mask(mask, volume.affine.tolist(), level, sheet, threads, progress)
    metadata |= {**made, "placed_by": placed_by if made["kind"] == "solid" else "a fit to the middle of the sheet"}
    metadata["sheet"] = metadata.pop("kind") == "sheet"
    metadata["kind"] = "voxels"
    if metadata["conflicts"]:
        remarks.append(
            f"the sheet's sides do not agree at {metadata['conflicts']} pairs of voxels: it touches itself there, or "
            "has one side only, like a Möbius strip"
        )
    if not metadata["sheet"] and (touched := _touched_sides(mask)):
        remarks.append(f"the foreground touches the volume's border ({touched}); the surface is closed there")
    return Surface(core, voxels.astype(np.int64), metadata, tuple(remarks))


def _touched_sides(mask: NDArray[np.bool_]) -> str:
    """Name the sides of the volume that the foreground touches."""
    sides = [
        f"{'first' if end == 0 else 'last'} layer of axis {axis}"
        for axis in range(3)
        for end in (0, -1)
        if mask.take(end, axis).any()
    ]
    return ", ".join(sides)


def _level(
    volume: Volume, mask: NDArray[np.bool_], threshold: float | None, probability: object | None
) -> tuple[tuple[NDArray[np.float32], float] | None, str]:
    """Return the image and the value that it has on the surface, and how to call that."""
    if probability is not None:
        image = as_volume(probability)
        if image.data.shape != mask.shape:
            raise InputError(
                f"the probability image has shape {image.data.shape}, the volume {mask.shape}; resample it"
            )
        if image.is_placed and volume.is_placed and not np.allclose(image.affine, volume.affine, atol=1e-3):
            raise InputError("the probability image lies elsewhere than the volume (their affines differ); resample it")
        values = image.data.astype(np.float32)
        if not np.isfinite(values).all():
            raise InputError("the probability image has values that are not finite; replace them by 0")
        level = 0.5 if threshold is None else float(threshold)
        return (values, level), f"the level {level:g} of {image.path.name if image.path else 'an image'}"
    if threshold is None or volume.data.dtype.kind != "f":
        return None, "a fit to the voxels"
    # a mask stored as numbers has its level halfway between any two voxels, which says nothing
    values = volume.data.astype(np.float32)
    border = np.zeros_like(mask)
    for axis in range(3):
        low, high = np.moveaxis(mask, axis, 0)[:-1], np.moveaxis(mask, axis, 0)[1:]
        np.moveaxis(border, axis, 0)[:-1] |= low != high
        np.moveaxis(border, axis, 0)[1:] |= low != high
    at_border = values[border]
    least, most = values.min(), values.max()
    between = np.mean((at_border > least) & (at_border < most)) if len(at_border) else 0.0
    if between < _SHARE_BETWEEN:
        return None, "a fit to the voxels"
    return (values, float(threshold)), f"the level {float(threshold):g} of the volume"


def _repaired(
    mask: NDArray[np.bool_],
    volume: Volume,
    level: tuple[NDArray[np.float32], float] | None,
    progress: Progress | None,
) -> tuple[NDArray[np.bool_], dict[str, Any], list[str]]:
    """Make the foreground's surface a sphere; with what was done."""
    likely = None
    if level is not None and level[0].min() >= 0 and level[0].max() <= 1:
        likely = level[0]
    repaired, report = _core.repair(mask, volume.spacing.tolist(), likely, progress)
    told = {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in report.items()}
    removed, added, others = len(report["cut"]), len(report["filled"]), len(report["dropped"]) + len(report["cavities"])
    remarks: list[str] = []
    if removed or added:
        share = 100 * (removed + added) / np.count_nonzero(mask)
        remarks.append(
            f"{report['handles']} handle(s) were repaired: {removed} voxels removed, {added} added ({share:.2f} %)"
        )
    if others:
        remarks.append(
            f"{len(report['dropped'])} voxels of smaller components were removed, {len(report['cavities'])} voxels of "
            "enclosed cavities added"
        )
    return repaired, told, remarks


def _cut_handles(whole: Surface, progress: Progress | None) -> Surface:
    core, handles = whole.core.cut_handles(progress)
    if not handles:
        return whole
    lengths = [handle["length"] for handle in handles]
    remark = f"{len(handles)} handle(s) were cut open along loops of {min(lengths):.1f} to {max(lengths):.1f} mm"
    metadata = {**whole.metadata, "handles_cut": handles}
    return Surface(core, whole.voxels, metadata, (*whole.remarks, remark))
