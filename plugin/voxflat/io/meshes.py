"""Read and write triangle surfaces with points in RAS+ mm, using nibabel, VTK or voxflat's own parsers."""

import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import array_of, checked_instance, checked_path, numbers_of
from voxflat.errors import InputError
from voxflat.io import formats
from voxflat.io.files import REMEDY, atomic_path, by_ending, contents, naming
from voxflat.io.formats import freesurfer, gifti, gltf, obj, ply, polygons, vtk
from voxflat.io.grid import FARTHEST, warn_of_unit
from voxflat.io.provenance import Record
from voxflat.io.spaces import UNKNOWN, Space, VolumeGeometry
from voxflat.io.triangles import as_float32, check_faces
from voxflat.io.volumes import VOLUME_ENDINGS

LEFT, RIGHT = "CortexLeft", "CortexRight"
_NAMES = {
    r"^lh\.|[._]lh[._]|(^|_)hemi-L[_.]|\.L\.|_left[_.]": LEFT,  # FreeSurfer, BIDS, HCP, nilearn
    r"^rh\.|[._]rh[._]|(^|_)hemi-R[_.]|\.R\.|_right[_.]": RIGHT,
}


@dataclass(frozen=True, eq=False)
class Mesh:
    """Store a triangle surface.

    Creating a mesh checks its arrays; an invalid array raises an `InputError`.

    Parameters
    ----------
    points : ndarray of float64, shape (N, 3)
        Coordinates in RAS+ mm, in `space`. NaN marks a point without a position; infinite values are errors.
    faces : ndarray of int64, shape (F, 3)
        Triangles, as row numbers of `points`. Points without a face are allowed, because flat maps may have them.
    path : Path or None
        The file that the mesh was read from.
    structure : str or None
        Brain structure in the notation of AnatomicalStructurePrimary in GIFTI: ``"CortexLeft"``, ``"CortexRight"``, ...
    point_data : dict of str to ndarray, shape (N,) or (N, K)
        Values at the points, keyed by name.
    texture_coordinates : ndarray of float64, shape (N, 2), or None
        Position of each point in a picture; NaN for points without a position.
    face_data : dict of str to ndarray, shape (F,)
        Values of the triangles, keyed by name.
    warnings : tuple of str
        Warnings on properties that the reader noticed or changed.
    space : Space
        Coordinate space of the points: scanner RAS, FreeSurfer tkRAS, or unknown.
    declared_unit : str or None
        Unit of the coordinates that the source declares, or "unknown", as in file formats that do not define a unit.
        None stands for mm, as in GIFTI and FreeSurfer files.

    See Also
    --------
    read_mesh : Read a mesh from a file.
    write_mesh : Write a mesh to a file.

    Examples
    --------
    >>> mesh = voxflat.io.Mesh(np.eye(3), [[0, 1, 2]])
    >>> mesh
    <Mesh: 3 points, 1 triangles>
    """

    points: NDArray[np.float64]
    faces: NDArray[np.int64]
    path: Path | None = None
    structure: str | None = None
    point_data: Mapping[str, NDArray[np.generic]] = field(default_factory=dict)
    texture_coordinates: NDArray[np.float64] | None = None
    face_data: Mapping[str, NDArray[np.generic]] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    space: Space = UNKNOWN
    declared_unit: str | None = None

    @property
    def unit(self) -> str:
        """Unit of the coordinates. It is the declared unit, ``"mm"`` or ``"unknown"``."""
        return "unknown" if self.unit_warning is not None else self.declared_unit or "mm"

    @property
    def _has_unknown_axes(self) -> bool:
        """Whether the source does not define RAS+, unlike GIFTI and FreeSurfer files and arrays."""
        return self.declared_unit is not None

    @property
    def unit_warning(self) -> str | None:
        """Warning that the mesh is probably not in mm, or None.

        A mesh is suspicious if the longest side of its bounding box is less than 1, unless it declares another unit.
        """
        there = self.points[np.isfinite(self.points).all(axis=1)]
        across = float(np.ptp(there, axis=0).max()) if len(there) else 1.0
        if across >= 1 or self.declared_unit not in (None, "mm", "unknown"):
            return None
        text = f"is {across:.2g} units across; coordinates are assumed to be in mm. If they are in metres, multiply"
        return f"{text} them by 1000"

    def __repr__(self) -> str:
        name = "" if self.path is None else f" {self.path.name}"
        return f"<Mesh{name}: {len(self.points)} points, {len(self.faces)} triangles>"

    def __post_init__(self) -> None:
        points = array_of(self.points, "points")
        if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind not in "iuf":
            raise InputError(f"points have type {points.dtype} and shape {points.shape}. Pass an (N, 3) numeric array")
        if len(points) == 0:
            raise InputError("has no points. Pass a surface mesh")
        points = np.ascontiguousarray(points, dtype=np.float64)
        far = np.flatnonzero((np.abs(points) > FARTHEST).any(axis=1))
        if len(far):
            raise InputError(f"point {far[0]}, {points[far[0]].tolist()}, lies beyond ±{FARTHEST:g} mm. Check the unit")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "faces", check_faces(self.faces, len(points)))
        if self.texture_coordinates is not None:
            texture = np.ascontiguousarray(numbers_of(self.texture_coordinates, "texture coordinates"))
            object.__setattr__(self, "texture_coordinates", texture)
            if texture.shape != (len(points), 2):
                raise InputError(f"texture coordinates have shape {texture.shape} instead of ({len(points)}, 2)")
        for kind, data, count in (("point", self.point_data, len(points)), ("face", self.face_data, len(self.faces))):
            checked_instance(data, Mapping, f"{kind} data", "arrays by name")
            for name, array in data.items():
                length = len(array) if np.ndim(array) else 0
                if length != count:
                    raise InputError(f"{kind} data {name!r} has {length} values, but the surface has {count} {kind}s")


def read_mesh(path: str | os.PathLike[str]) -> Mesh:
    """Read a triangle surface from a file.

    The ending of the name determines the format; if the ending is not known, the content does.

    Parameters
    ----------
    path : path
        GIFTI (``.surf.gii``, ``.gii``, ``.gii.gz``), FreeSurfer (``lh.white``, ``lh.pial``, ``lh.inflated``, ...; or
        ``.asc`` in ASCII), VTK (``.vtk``, ``.vtp``), ``.ply``, ``.stl``, ``.obj``, ``.off`` or ``.glb``.

    Returns
    -------
    Mesh
        The mesh, with its points in the order of the file. STL files store corners; equal corners become one point.

    Raises
    ------
    InputError
        The file is damaged, its format differs from the one that its ending specifies, or it is not a triangle surface.

    See Also
    --------
    write_mesh : Write a mesh to a file.
    read_patch : Read a FreeSurfer patch.

    Examples
    --------
    >>> mesh = voxflat.io.Mesh(np.eye(3), [[0, 1, 2]])
    >>> voxflat.io.write_mesh("triangle.ply", mesh)
    >>> voxflat.io.read_mesh("triangle.ply")
    <Mesh triangle.ply: 3 points, 1 triangles>
    """
    path = checked_path(path)
    with naming(path, REMEDY):
        return parsed(path, contents(path))


def is_mesh_name(path: str | os.PathLike[str]) -> bool:
    """Return whether a file is a mesh according to its ending or, if the ending is not known, its first bytes."""
    path = checked_path(path)
    name = path.name.lower()
    if name.endswith(tuple(formats.ENDINGS)):
        return True
    if name.endswith(VOLUME_ENDINGS) or not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(3) in (b"\xff\xff\xfe", b"\xff\xff\xfd", b"\xff\xff\xff")


def holds_mesh(path: str | os.PathLike[str]) -> bool:
    """Return whether a file contains triangles rather than values at points or a patch."""
    path = checked_path(path)
    with naming(path, REMEDY):
        data = contents(path)
        kind = formats.by_content(data) or formats.by_name(path)
        return gifti._has_triangles(gifti.load(data)) if kind == formats.GIFTI else kind in READERS


def _format(path: Path, data: bytes) -> str:
    """Return the format of a surface file; its ending and content must agree."""
    named, content = formats.by_name(path), formats.by_content(data)
    if named and content and named != content:
        raise InputError(f"its ending indicates {named}, but its content is {content}. Rename the file")
    kind = content or named
    if kind not in READERS:
        usual = f"Pass a {', '.join(formats.ENDINGS)} file or a FreeSurfer surface"
        hint = formats.HINTS.get(kind or "", usual)
        raise InputError(f"is not a surface: its content is {kind or 'unknown'}. {hint}")
    return kind


def parsed(path: Path, data: bytes) -> Mesh:
    """Return the surface in a file, with the structure from its name and a warning if its unit is doubtful."""
    with np.errstate(all="ignore"):
        read, has_unit = READERS[_format(path, data)]
        mesh = Mesh(path=path, **read(path, data), declared_unit=None if has_unit else "unknown")
    warnings = mesh.warnings + ((mesh.unit_warning,) if mesh.unit_warning else ())
    return replace(mesh, structure=mesh.structure or named_structure(path), warnings=warnings)


def named_structure(path: str | os.PathLike[str]) -> str | None:
    """Return the hemisphere that a name contains, such as ``lh.thickness`` or ``sub-01_hemi-L_curv.shape.gii``."""
    sides = [structure for pattern, structure in _NAMES.items() if re.search(pattern, Path(path).name)]
    return sides[0] if len(sides) == 1 else None


_IN_MM = True  # whether a format defines the unit and the axes of points, as RAS+ mm
READERS: dict[str, tuple[Callable[[Path, bytes], dict[str, Any]], bool]] = {  # readers return arguments of `Mesh`
    formats.GIFTI: (lambda _, data: gifti.surface(gifti.load(data)), _IN_MM),
    formats.FREESURFER: (freesurfer.read_geometry, _IN_MM),
    formats.VTK: (vtk.read_vtk, not _IN_MM),
    formats.VTP: (vtk.read_vtp, not _IN_MM),
    formats.PLY: (ply.read_ply, not _IN_MM),
    formats.STL: (polygons.read_stl, not _IN_MM),
    formats.OBJ: (obj.read_obj, not _IN_MM),
    formats.OFF: (polygons.read_off, not _IN_MM),
    formats.ASC: (polygons.read_asc, _IN_MM),
    formats.GLB: (gltf.read_glb, not _IN_MM),
}


def write_mesh(path: str | os.PathLike[str], mesh: Mesh, record: Record | None = None) -> None:
    """Write a surface to a file.

    The file is written completely or not at all. FreeSurfer files are written in tkRAS with the volume geometry, and
    all other formats in scanner RAS. Points are transformed if the transformation is known. Points in an unknown space
    are written unchanged.

    Parameters
    ----------
    path : path
        ``.surf.gii``, ``.vtp``, ``.ply``, ``.obj``, or a FreeSurfer name (without an ending, or like ``lh.white``).
    mesh : Mesh
        The mesh. Its points are rounded to float32 in GIFTI and FreeSurfer files, and to 9 digits in OBJ files. Only
        ``.surf.gii`` stores the structure, only ``.vtp`` the point and face data, and only ``.vtp``, ``.ply`` and
        ``.obj`` the texture coordinates. A mesh is marked as flat in a GIFTI file if all its z coordinates are 0.
    record : dict, optional
        Provenance record for the metadata of a GIFTI file; other formats cannot hold it.

    Raises
    ------
    InputError
        The format cannot hold the mesh.

    See Also
    --------
    read_mesh : Read a mesh from a file.

    Examples
    --------
    >>> mesh = voxflat.io.Mesh(np.eye(3), [[0, 1, 2]])
    >>> voxflat.io.write_mesh("triangle.surf.gii", mesh)
    """
    path = checked_path(path)
    write = check_mesh_name(path)
    with atomic_path(path) as temporary, naming(path, _CHECK):
        write(temporary, mesh, record)
    if write in (_write_gifti, _write_freesurfer) and mesh._has_unknown_axes:
        warn_of_unit(path, mesh.unit)


_Write: TypeAlias = Callable[[Path, Mesh, Record | None], None]
_CHECK = "check that this format can hold it"


def check_mesh_name(path: Path) -> _Write:
    """Return the writer for a file name; raise an error if no surface format matches."""
    name = path.name.lower()
    others = (*formats.ENDINGS, *_WRITERS, ".label", ".annot", ".mgh", ".mgz", ".npy", ".npz")
    with naming(path, _CHECK):
        if ".patch." in name:
            raise InputError("has the name of a patch, which is a part of a surface. Choose the name of a surface")
        if (not path.suffix or name.startswith(("lh.", "rh."))) and not name.endswith(others):
            return _write_freesurfer
        return by_ending(path, _WRITERS, ", or a FreeSurfer name such as lh.white")


def in_tkras(points: NDArray[np.float64], space: Space) -> tuple[NDArray[np.float64], VolumeGeometry | None]:
    """Transform points to tkRAS, and return them with the volume, by default a conformed volume."""
    if space.name != "scanner":
        return points, space.volume
    volume = space.volume or VolumeGeometry.conformed()
    return Space("tkRAS", volume).from_scanner(points), volume


def _write_freesurfer(path: Path, mesh: Mesh, _: Record | None) -> None:
    points, volume = in_tkras(mesh.points, mesh.space)
    freesurfer.write_geometry(path, points, mesh.faces, volume)


def _write_gifti(path: Path, mesh: Mesh, record: Record | None) -> None:
    points, space = mesh.space.to_scanner(mesh.points), mesh.space
    as_float32(points)
    path.write_bytes(gifti.surface_bytes(points, mesh.faces, mesh.structure, is_scanner=space.is_known, record=record))


def _plain(mesh: Mesh) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64] | None]:
    return mesh.space.to_scanner(mesh.points), mesh.faces, mesh.texture_coordinates


_WRITERS: dict[str, _Write] = {
    ".surf.gii": _write_gifti,
    ".vtp": lambda path, mesh, _: vtk.write_vtp(path, *_plain(mesh), mesh.point_data, mesh.face_data),
    ".ply": lambda path, mesh, _: ply.write_ply(path, *_plain(mesh)),
    ".obj": lambda path, mesh, _: obj.write_obj(path, *_plain(mesh)),
}
