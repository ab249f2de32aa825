"""FreeSurfer's files: patches, surfaces, values at points, and labels.

A patch (``lh.cortex.patch.3d``, ``lh.cortex.patch.flat``) lists some points of a surface with places of their own; its
faces are those of the surface. The format is that of FreeSurfer's MRISwritePatch and MRISreadPatch
(utils/mrisurf_io.cpp), big-endian: int32 −1, int32 number of points, then for each an int32, v + 1 for point v inside
and −(v + 1) for one at the border, and three float32.

nibabel reads the other formats, but trusts their headers; here the counts are compared to the length of the file first.
"""

from __future__ import annotations

import io
import math
import os
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat.errors import InputError
from voxflat.io.files import atomic_path, contents, naming, require
from voxflat.io.spaces import Space, VolumeGeometry
from voxflat.io.triangles import as_float32, check_faces

_ENTRY = np.dtype([("vertex", ">i4"), ("point", ">f4", 3)])
_SCANNER_TAG = b"\0\0\0\x02\0\0\0\x01"  # useRealRAS: scanner RAS, which nibabel does not know
_AGAIN = "copy it again"
_REMEDY = "is it complete, and of this format?"


@dataclass(frozen=True, eq=False)
class Patch:
    """Some points of a surface, in places of their own. Making one checks it; a bad array is an `InputError`.

    Parameters
    ----------
    vertex_ids : ndarray of int64, shape (k,)
        Which points of the surface, each once.
    points : ndarray of float64, shape (k, 3)
        Their places, mm; in a flat patch z is 0.
    border : ndarray of bool, shape (k,)
        Which of them lie at the border of the patch; `patch_border` finds them.
    path : Path or None
        The file it came from.
    """

    vertex_ids: NDArray[np.int64]
    points: NDArray[np.float64]
    border: NDArray[np.bool_]
    path: Path | None = None

    def __repr__(self) -> str:
        return f"<Patch: {len(self.vertex_ids)} points, {np.count_nonzero(self.border)} of them at the border>"

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertex_ids", _check_vertices(self.vertex_ids))
        object.__setattr__(self, "points", np.ascontiguousarray(self.points, dtype=np.float64))
        object.__setattr__(self, "border", np.ascontiguousarray(self.border, dtype=np.bool_))
        k = len(self.vertex_ids)
        if self.points.shape != (k, 3) or self.border.shape != (k,):
            raise InputError(
                f"a patch of {k} vertices has points of shape {self.points.shape} and a border of shape "
                f"{self.border.shape}: give ({k}, 3) and ({k},)"
            )
        bad = np.flatnonzero(~np.isfinite(self.points).all(axis=1))
        if len(bad):
            raise InputError(f"entry {bad[0]} of the patch lies at {self.points[bad[0]].tolist()}: it must be finite")


def read_patch(path: str | os.PathLike[str]) -> Patch:
    """Read a FreeSurfer patch file.

    Parameters
    ----------
    path : path
        Such as ``lh.cortex.patch.3d`` or ``lh.cortex.patch.flat``.

    Returns
    -------
    Patch
        In the order of the file.

    Raises
    ------
    InputError
        The file is no patch, cut short, or names a point twice.
    FileNotFoundError, PermissionError
        The file cannot be opened.
    """
    path = Path(path)
    with naming(path, _REMEDY):
        return parse_patch(path, contents(path))


def parse_patch(path: Path, data: bytes) -> Patch:
    """Return the patch that a file holds."""
    header = np.frombuffer(data[:8], ">i4") if len(data) >= 8 else np.zeros(2, int)
    if header[0] != -1:
        raise InputError(f"begins with {data[:4].hex(' ')} instead of ff ff ff ff: it is no binary patch file")
    _check_size(data, 8 + _ENTRY.itemsize * int(header[1]), f"{header[1]} points", is_exact=True)
    entries = np.frombuffer(data, _ENTRY, offset=8)
    signed = entries["vertex"].astype(np.int64)
    if not signed.all():
        raise InputError(f"entry {np.flatnonzero(signed == 0)[0]} names vertex 0; patch files count from 1")
    with np.errstate(invalid="ignore"):  # signalling NaN, refused as others
        return Patch(np.abs(signed) - 1, entries["point"].astype(np.float64), signed < 0, path)


def is_patch(path: str | os.PathLike[str]) -> bool:
    """Say whether a file is a FreeSurfer patch.

    Parameters
    ----------
    path : path
        A file.

    Returns
    -------
    bool
    """
    with Path(path).open("rb") as file:
        return file.read(4) == b"\xff\xff\xff\xff"


def write_patch(path: str | os.PathLike[str], patch: Patch) -> None:
    """Write a FreeSurfer patch file, all of it or nothing.

    Parameters
    ----------
    path : path
        Such as ``lh.cortex.patch.flat``.
    patch : Patch
        Its points are rounded to float32.

    Raises
    ------
    InputError
        The file cannot hold the patch.
    OSError
        It cannot be written.
    """
    path = Path(path)
    with atomic_path(path) as temporary, naming(path, "can a patch file hold it?"):
        entries = np.empty(len(patch.vertex_ids), _ENTRY)
        one_based = patch.vertex_ids + 1
        if one_based.max() > np.iinfo(np.int32).max:
            raise InputError(f"vertex {patch.vertex_ids.max()} is above what the format can name, 2147483646")
        entries["vertex"] = np.where(patch.border, -one_based, one_based)
        entries["point"] = as_float32(patch.points)
        temporary.write_bytes(np.array([-1, len(entries)], ">i4").tobytes() + entries.tobytes())


def patch_faces(faces: ArrayLike, vertices: ArrayLike, n: int) -> NDArray[np.int64]:
    """Return the faces of a patch: those of the surface whose three corners all lie in it.

    Parameters
    ----------
    faces : array_like of int, shape (F, 3)
        The surface's triangles.
    vertices : array_like of int, shape (k,)
        The patch's points, as numbers of the surface's.
    n : int
        Number of the surface's points.

    Returns
    -------
    ndarray of int64, shape (G, 3)
        As rows of the patch, 0 to k − 1: together with ``patch.points`` a mesh.

    Raises
    ------
    InputError
        A vertex or a face names a point that the surface does not have.
    """
    triangles, rows = _in_patch(faces, vertices, n)
    corners = rows[triangles]
    return np.asarray(corners[(corners >= 0).all(axis=1)])


def patch_border(faces: ArrayLike, vertices: ArrayLike, n: int) -> NDArray[np.bool_]:
    """Find the border of a patch: points on an edge with a single face, or with a face or no face at all left out.

    Parameters
    ----------
    faces, vertices, n
        As in `patch_faces`.

    Returns
    -------
    ndarray of bool, shape (k,)

    Raises
    ------
    InputError
        As in `patch_faces`.
    """
    triangles, rows = _in_patch(faces, vertices, n)
    corners = rows[triangles]
    is_inside = (corners >= 0).all(axis=1)
    border = np.ones(len(np.asarray(vertices)), dtype=bool)
    kept = corners[is_inside]
    border[kept] = False  # a point without a face stays
    cut = corners[~is_inside]
    border[cut[cut >= 0]] = True
    edges = np.sort(np.concatenate([kept[:, [0, 1]], kept[:, [1, 2]], kept[:, [2, 0]]]), axis=1)
    pairs, counts = np.unique(edges, axis=0, return_counts=True)
    border[pairs[counts == 1]] = True
    return border


def _in_patch(faces: ArrayLike, vertices: ArrayLike, n: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the checked faces, and the row in the patch of each of the surface's points, −1 outside."""
    triangles, chosen = check_faces(faces, n), _check_vertices(vertices)
    if chosen.max() >= n:
        entry = np.flatnonzero(chosen >= n)[0]
        raise InputError(f"entry {entry} of the patch is vertex {chosen[entry]}; the surface has {n} points")
    rows = np.full(n, -1, dtype=np.int64)
    rows[chosen] = np.arange(len(chosen))
    return triangles, rows


def _check_vertices(vertices: ArrayLike) -> NDArray[np.int64]:
    """Check that vertices are whole numbers from 0, each once."""
    array = np.asarray(vertices)
    if array.ndim != 1 or len(array) == 0 or array.dtype.kind not in "iu":
        raise InputError(f"a patch has one whole number or more, not {array.dtype} of shape {array.shape}")
    array = np.ascontiguousarray(array, dtype=np.int64)
    if array.min() < 0:
        entry = np.flatnonzero(array < 0)[0]
        raise InputError(f"entry {entry} of the patch is vertex {array[entry]}: they count from 0")
    order = np.argsort(array, kind="stable")
    twice = order[1:][np.diff(array[order]) == 0]
    if len(twice):
        raise InputError(f"entry {twice.min()} of the patch is vertex {array[twice.min()]}, which it has already")
    return array


# ------------------------------------------------------------------------- surfaces, values, labels


def _check_size(data: bytes, need: int, what: str, *, is_exact: bool = False) -> None:
    """Compare the length of a file to what its header asks for."""
    if need < 0:
        raise InputError(f"has {what} by its header, which is damaged: {_AGAIN}")
    if len(data) < need:
        raise InputError(f"has {what} by its header, but ends after {len(data)} of {need} bytes: {_AGAIN}")
    if is_exact and len(data) > need:
        raise InputError(f"has {what} by its header, but {len(data) - need} bytes more than that: is it damaged?")


def read_geometry(path: Path, data: bytes) -> tuple[NDArray[Any], NDArray[Any], Space, tuple[str, ...]]:
    """Return points, faces, space and remarks of a surface file; quadrangles are split as FreeSurfer does."""
    nibabel, is_quad = require("nibabel"), data[2] != 0xFE
    if is_quad:
        points, quads = (int.from_bytes(data[at : at + 3], "big") for at in (3, 6))
        need = 9 + (6 if data[2] == 0xFF else 12) * points + 12 * quads
        _check_size(data, need, f"{points} points and {quads} quadrangles")
        remarks: tuple[str, ...] = (f"{quads} quadrangles were split into triangles",)
    else:
        start = data.index(b"\n", data.index(b"\n") + 1) + 1  # after a line on who made it, and an empty one
        points, triangles = (int(count) for count in np.frombuffer(data[start : start + 8].ljust(8, b"\xff"), ">i4"))
        need = start + 8 + 12 * points + 12 * triangles
        _check_size(data, need if min(points, triangles) >= 0 else -1, f"{points} points and {triangles} faces")
        remarks = ()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that there is no volume, or what else stands in its place
        coordinates, faces, footer = nibabel.freesurfer.read_geometry(path, read_metadata=True)
    is_scanner = not is_quad and data[need : need + 8] == _SCANNER_TAG
    return coordinates, faces, Space("scanner") if is_scanner else _space(footer), remarks


def _space(footer: dict[str, Any]) -> Space:
    """Return the space of a surface by its footer: tkRAS."""
    if not str(footer.get("valid", "")).startswith("1"):
        doubt = "it has FreeSurfer's coordinates (tkRAS), and its file does not say where their volume lies (c_ras)"
        return Space("tkRAS", None, doubt)
    cosines = np.column_stack([footer[axis] for axis in ("xras", "yras", "zras")])
    try:
        volume = VolumeGeometry(cosines, footer["cras"], footer["volume"], footer["voxelsize"], footer["filename"])
    except InputError as error:
        return Space("tkRAS", None, f"it has FreeSurfer's coordinates (tkRAS), but {error}")
    return Space("tkRAS", volume)


def write_geometry(
    path: Path, points: NDArray[np.float64], faces: NDArray[np.int64], volume: VolumeGeometry | None
) -> None:
    """Write a surface file: points in tkRAS, and the volume that says where that is."""
    footer = None
    if volume is not None:
        footer = {
            "head": np.array([2, 0, 20]),
            "valid": "1  # volume info valid",
            "filename": "".join(letter if letter.isprintable() else "_" for letter in volume.filename) or "unknown",
            "volume": volume.shape,
            "voxelsize": volume.voxel_size,
            **{axis: volume.cosines[:, n] for n, axis in enumerate(("xras", "yras", "zras"))},
            "cras": volume.c_ras,
        }
    require("nibabel").freesurfer.write_geometry(path, as_float32(points), faces, "created by voxflat", footer)


def is_morph(data: bytes) -> bool:
    """Tell whether a file that begins with ff ff ff is one of values, not a surface of quadrangles."""
    points, _, each = (int(count) for count in np.frombuffer(data[3:15].ljust(12, b"\xff"), ">i4"))
    return each > 0 and len(data) == 15 + 4 * points * each


def read_morph(path: Path, data: bytes) -> NDArray[Any]:
    """Return the values of a file such as lh.curv, lh.sulc or lh.thickness."""
    if data[:3] == b"\xff\xff\xff":
        points, _, each = (int(count) for count in np.frombuffer(data[3:15].ljust(12, b"\xff"), ">i4"))
        if each != 1:
            raise InputError(f"has {each} values a point: give a file with one")
        _check_size(data, 15 + 4 * points if points >= 0 else -1, f"{points} values", is_exact=True)
    elif len(data) < 6 or len(data) != 6 + 2 * int.from_bytes(data[:3], "big"):  # this format has nothing to know it by
        raise InputError("is none of the files of values that are known, or is cut short: " + _REMEDY)
    return np.asarray(require("nibabel").freesurfer.read_morph_data(path))


def read_mgh(data: bytes) -> NDArray[Any]:
    """Return the values of an MGH file, shape (N,), or (N, F) of F frames."""
    version, *shape, kind = (int(number) for number in np.frombuffer(data[:24].ljust(24, b"\0"), ">i4"))
    if version != 1 or min(shape) < 1:
        raise InputError(f"is no MGH file, or damaged: {_REMEDY}")
    _check_size(data, 284 + math.prod(shape) * {0: 1, 4: 2}.get(kind, 4), f"the shape {shape}")
    if sorted(shape[:3])[:2] != [1, 1]:
        raise InputError(f"has the shape {shape}: values at N points have (N, 1, 1)")
    values = np.asarray(require("nibabel").MGHImage.from_bytes(data).dataobj).reshape(max(shape[:3]), -1)
    return values[:, 0] if values.shape[1] == 1 else values


def read_annot(path: Path, data: bytes) -> tuple[NDArray[np.int64], list[str]]:
    """Return the label of each point, −1 for none, and the labels' names."""
    points = int.from_bytes(data[:4], "big", signed=True)
    _check_size(data, 4 + 8 * points if points >= 0 else -1, f"{points} points")
    pairs = np.frombuffer(data, ">i4", count=2 * points, offset=4).reshape(-1, 2)
    if not np.array_equal(pairs[:, 0], np.arange(points)):
        raise InputError("does not name the points in their order: write it again by FreeSurfer")
    _, table, names = require("nibabel").freesurfer.read_annot(path, orig_ids=True)
    if len(names) != len(table):
        raise InputError(f"has {len(names)} names for {len(table)} colours: write it again by FreeSurfer")
    labels = np.full(points, -1, dtype=np.int64)
    for index, colour in enumerate(table[:, 4]):  # nibabel's own search gives a colour not in the table its neighbour
        labels[pairs[:, 1] == colour] = index
    return labels, [name.decode("utf-8", "replace") for name in names]


def read_label(data: bytes, n: int) -> NDArray[np.bool_]:
    """Return which of n points a label file names."""
    vertices = _label_columns(data, 1)[:, 0]
    bad = np.flatnonzero((vertices < 0) | (vertices >= n) | (vertices % 1 != 0))
    if len(bad):
        raise InputError(f"line {bad[0] + 3} names point {vertices[bad[0]]:g}; the surface has the points 0 to {n - 1}")
    mask = np.zeros(n, dtype=bool)
    mask[vertices.astype(np.int64)] = True
    return mask


def read_label_points(path: str | os.PathLike[str]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Read the points that a label file names, and where they lay on the surface that it was drawn on.

    Parameters
    ----------
    path : path
        A ``.label`` file that `read_region` has read: its points are those of a surface.

    Returns
    -------
    vertices : ndarray of int64, shape (k,)
        Numbers of points.
    points : ndarray of float64, shape (k, 3)
        tkRAS, mm; some programs write 0.
    """
    path = Path(path)
    with naming(path, _REMEDY):
        data = contents(path)
        vertices = _label_columns(data, 1)[:, 0].astype(np.int64)
        try:
            return vertices, _label_columns(data, 4)[:, 1:]
        except ValueError:  # it has numbers only
            return vertices, np.zeros((len(vertices), 3))


def _label_columns(data: bytes, count: int) -> NDArray[np.float64]:
    """Return the first columns of a label file's points: number, x, y, z."""
    lines = data.decode("utf-8", "replace").splitlines()
    if len(lines) < 2 or not lines[1].strip().isdigit():
        raise InputError("is no label file: its second line must be the number of points")
    named, rows = int(lines[1]), [line for line in lines[2:] if line.strip()]
    if named != len(rows):
        raise InputError(f"names {len(rows)} points, by its header {named}: {_AGAIN}")
    return np.loadtxt(io.StringIO("\n".join(rows)), usecols=range(count), ndmin=2) if rows else np.zeros((0, count))
