"""Read and write FreeSurfer patches (``lh.cortex.patch.3d``, ``lh.cortex.patch.flat``, ``lh.cortex.flat.patch.3d``).

A patch lists some points of a surface and their positions in the patch. Its faces are not stored: they are the faces of
the surface whose corners are all listed. FreeSurfer's MRISreadPatch (utils/mrisurf_io.cpp), pycortex and autoflatten
use this rule; the border flag is only for display. The format is big-endian: an int32 of −1, the number of points as
int32, and for each point v an int32, which is v + 1 inside and −(v + 1) at the border, and three float32.
"""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat.arguments import array_of, checked_path, numbers_of
from voxflat.errors import InputError
from voxflat.io.files import atomic_path, check_size, contents, naming
from voxflat.io.reading import check_room
from voxflat.io.triangles import as_float32, check_faces
from voxflat.unique_rows import distinct

_ENTRY = np.dtype([("vertex", ">i4"), ("point", ">f4", 3)])
_REMEDY = "Check that the file is complete and in this format"

FLAT_PATCH_ENDINGS = (".patch.flat", ".flat.patch.3d")  # endings of flat patches
PATCH_ENDING = ".patch.3d"  # ending of 3-D patches and of some flat ones


@dataclass(frozen=True, eq=False)
class Patch:
    """Store some points of a surface and their positions in a patch.

    Creating a patch checks its arrays; an invalid array raises an `InputError`.

    Parameters
    ----------
    vertex_ids : ndarray of int64, shape (k,)
        Point numbers on the surface, each listed once.
    points : ndarray of float64, shape (k, 3)
        Positions of the points in mm; in a flat patch, z is 0.
    border : ndarray of bool, shape (k,)
        Whether each point lies at the border of the patch; `patch_border` finds these points.
    path : Path or None
        The file that the patch was read from.

    See Also
    --------
    read_patch : Read a patch from a file.
    write_patch : Write a patch to a file.

    Examples
    --------
    >>> patch = voxflat.io.Patch(np.array([0, 1, 2]), np.eye(3), np.array([True, True, True]))
    >>> patch
    <Patch: 3 points, 3 of them at the border>
    """

    vertex_ids: NDArray[np.int64]
    points: NDArray[np.float64]
    border: NDArray[np.bool_]
    path: Path | None = None

    def __repr__(self) -> str:
        return f"<Patch: {len(self.vertex_ids)} points, {np.count_nonzero(self.border)} of them at the border>"

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertex_ids", _check_vertices(self.vertex_ids))
        object.__setattr__(self, "points", np.ascontiguousarray(numbers_of(self.points, "points")))
        border = numbers_of(self.border, "entries of the border")
        object.__setattr__(self, "border", np.ascontiguousarray(border, dtype=np.bool_))
        k = len(self.vertex_ids)
        if self.points.shape != (k, 3) or self.border.shape != (k,):
            shapes = f"points have shape {self.points.shape} and border has shape {self.border.shape}"
            raise InputError(f"{shapes}. Pass arrays of shape ({k}, 3) and ({k},) for {k} vertices")
        bad = np.flatnonzero(~np.isfinite(self.points).all(axis=1))
        if len(bad):
            raise InputError(f"the position of patch entry {bad[0]}, {self.points[bad[0]].tolist()}, is not finite")


def read_patch(path: str | os.PathLike[str]) -> Patch:
    """Read a FreeSurfer patch file.

    Only binary patch files are supported.

    Parameters
    ----------
    path : path
        Patch file, such as ``lh.cortex.patch.3d`` or ``lh.cortex.patch.flat``.

    Returns
    -------
    Patch
        The points in the order of the file.

    Raises
    ------
    InputError
        The file is not a patch, is incomplete, or lists a point twice.

    See Also
    --------
    write_patch : Write a patch to a file.
    patch_faces : Return the faces of a patch.

    Examples
    --------
    >>> patch = voxflat.io.Patch(np.array([0, 1, 2]), np.eye(3), np.array([True, True, True]))
    >>> voxflat.io.write_patch("lh.other.patch.3d", patch)
    >>> voxflat.io.read_patch("lh.other.patch.3d")
    <Patch: 3 points, 3 of them at the border>
    """
    path = checked_path(path)
    with naming(path, _REMEDY):
        return parse_patch(path, contents(path))


def parse_patch(path: Path, data: bytes) -> Patch:
    """Return the patch in a file."""
    header = np.frombuffer(data[:8], ">i4") if len(data) >= 8 else np.zeros(2, int)
    if header[0] != -1:
        raise InputError(f"is not a binary patch file: it begins with {data[:4].hex(' ')}, not ff ff ff ff. {_REMEDY}")
    check_size(data, 8 + _ENTRY.itemsize * int(header[1]), f"{header[1]} points", is_exact=True)
    entries = np.frombuffer(data, _ENTRY, offset=8)
    signed = entries["vertex"].astype(np.int64)
    if not signed.all():
        raise InputError(f"entry {np.flatnonzero(signed == 0)[0]} refers to vertex 0, but patch files count from 1")
    with np.errstate(invalid="ignore"):  # signalling NaN is rejected like NaN
        return Patch(np.abs(signed) - 1, entries["point"].astype(np.float64), signed < 0, path)


def is_patch(path: str | os.PathLike[str]) -> bool:
    """Return whether a file is a FreeSurfer patch."""
    path = checked_path(path)
    if path.exists() and not path.is_file():  # reading from a pipe would block
        return False
    with path.open("rb") as file:
        return file.read(4) == b"\xff\xff\xff\xff"


def write_patch(path: str | os.PathLike[str], patch: Patch) -> None:
    """Write a FreeSurfer patch file.

    The file is written completely or not at all.

    Parameters
    ----------
    path : path
        Patch file, such as ``lh.cortex.patch.flat``.
    patch : Patch
        The patch; its points are rounded to float32.

    Raises
    ------
    InputError
        The file format cannot hold the patch.

    See Also
    --------
    read_patch : Read a patch from a file.

    Examples
    --------
    >>> patch = voxflat.io.Patch(np.array([0, 1, 2]), np.eye(3), np.array([True, True, True]))
    >>> voxflat.io.write_patch("lh.some.patch.3d", patch)
    """
    path = checked_path(path)
    with atomic_path(path) as temporary, naming(path, "check that a patch file can hold it"):
        entries = np.empty(len(patch.vertex_ids), _ENTRY)
        one_based = patch.vertex_ids + 1
        if one_based.max() > np.iinfo(np.int32).max:
            raise InputError(f"vertex {patch.vertex_ids.max()} exceeds 2147483646, the maximum of the format")
        entries["vertex"] = np.where(patch.border, -one_based, one_based)
        entries["point"] = as_float32(patch.points)
        temporary.write_bytes(np.array([-1, len(entries)], ">i4").tobytes() + entries.tobytes())


def in_patch(faces: ArrayLike, vertices: ArrayLike, n: int) -> NDArray[np.bool_]:
    """Return a mask (F,) of the faces of a surface whose three corners are all listed in a patch."""
    triangles, rows = _rows(faces, vertices, n)
    return np.asarray((rows[triangles] >= 0).all(axis=1))


def patch_faces(faces: ArrayLike, vertices: ArrayLike, n: int) -> NDArray[np.int64]:
    """Return the faces of a patch.

    These are the faces of the surface whose three corners are all listed in the patch.

    Parameters
    ----------
    faces : array_like of int, shape (F, 3)
        Triangles of the surface.
    vertices : array_like of int, shape (k,)
        Points of the patch, as point numbers of the surface.
    n : int
        Number of points of the surface.

    Returns
    -------
    ndarray of int64, shape (G, 3)
        Faces, whose corners are patch row numbers (0 to k − 1); together with ``patch.points``, they form a mesh.

    Raises
    ------
    InputError
        A vertex or a face refers to a point that the surface does not have.

    See Also
    --------
    patch_border : Find the border of a patch.

    Examples
    --------
    >>> faces = [[0, 1, 2], [1, 2, 3]]
    >>> voxflat.io.patch_faces(faces, [0, 1, 2], 4)
    array([[0, 1, 2]])
    """
    triangles, rows = _rows(faces, vertices, n)
    corners = rows[triangles]
    return corners[(corners >= 0).all(axis=1)]


def patch_border(faces: ArrayLike, vertices: ArrayLike, n: int) -> NDArray[np.bool_]:
    """Find the border of a patch.

    A point lies at the border if one of its edges has a single face, if one of its faces is not in the patch, or if it
    has no face at all.

    Parameters
    ----------
    faces : array_like of int, shape (F, 3)
        Triangles of the surface.
    vertices : array_like of int, shape (k,)
        Points of the patch, as point numbers of the surface.
    n : int
        Number of points of the surface.

    Returns
    -------
    ndarray of bool, shape (k,)
        True for the points at the border.

    Raises
    ------
    InputError
        A vertex or a face refers to a point that the surface does not have.

    See Also
    --------
    patch_faces : Return the faces of a patch.

    Examples
    --------
    >>> faces = [[0, 1, 2], [1, 2, 3]]
    >>> voxflat.io.patch_border(faces, [0, 1, 2], 4)
    array([ True,  True,  True])
    """
    triangles, rows = _rows(faces, vertices, n)
    corners = rows[triangles]
    is_inside = (corners >= 0).all(axis=1)
    border = np.ones(len(array_of(vertices, "vertices")), dtype=bool)
    inner = corners[is_inside]
    border[inner] = False  # points without a face remain True
    cut = corners[~is_inside]
    border[cut[cut >= 0]] = True
    edges = np.sort(np.concatenate([inner[:, [0, 1]], inner[:, [1, 2]], inner[:, [2, 0]]]), axis=1)
    sides = distinct(edges)
    border[sides.rows[sides.counts == 1]] = True
    return border


def _rows(faces: ArrayLike, vertices: ArrayLike, n: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the checked faces, and the patch row of each point of the surface (−1 outside the patch)."""
    triangles, chosen = check_faces(faces, n), _check_vertices(vertices)
    check_room(8 * n)
    if chosen.max() >= n:
        entry = np.flatnonzero(chosen >= n)[0]
        raise InputError(f"entry {entry} of the patch refers to vertex {chosen[entry]}, but the surface has {n} points")
    rows = np.full(n, -1, dtype=np.int64)
    rows[chosen] = np.arange(len(chosen))
    return triangles, rows


def _check_vertices(vertices: ArrayLike) -> NDArray[np.int64]:
    """Check that vertices are non-negative integers, each listed once."""
    array = array_of(vertices, "vertices")
    if array.ndim != 1 or len(array) == 0 or array.dtype.kind not in "iu":
        raise InputError(f"vertices have data type {array.dtype} and shape {array.shape}. Pass an integer (k,) array")
    array = np.ascontiguousarray(array, dtype=np.int64)
    if array.min() < 0:
        entry = np.flatnonzero(array < 0)[0]
        raise InputError(f"entry {entry} of the patch refers to vertex {array[entry]}. Number vertices from 0")
    order = np.argsort(array, kind="stable")
    twice = order[1:][np.diff(array[order]) == 0]
    if len(twice):
        raise InputError(f"entry {twice.min()} of the patch repeats vertex {array[twice.min()]}. List each vertex once")
    return array
