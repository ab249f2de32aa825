"""Convert any input, a file or an object of another package, to a `Mesh` or a `Volume`; the first match is used."""

import os
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from voxflat.arguments import array_of, check_memory, log
from voxflat.errors import InputError
from voxflat.io.chunks import is_stack_path
from voxflat.io.files import REMEDY, naming
from voxflat.io.formats import ENDINGS
from voxflat.io.grid import NOT_KNOWN, completed, given_affine, is_incomplete
from voxflat.io.meshes import Mesh, is_mesh_name, read_mesh
from voxflat.io.objects import SUPPORTED, image_volume, is_image, is_values, mesh_of_object
from voxflat.io.readers import as_array, from_itk, from_nibabel
from voxflat.io.volumes import VOLUME_ENDINGS, Volume, volume_of_file

_BYTES_PER_VOXEL = 12  # bytes per voxel for a surface: mask, its copy, grids of vertices and cavities


def taken(
    source: object,
    *,
    spacing: Sequence[float] | None = None,
    affine: ArrayLike | None = None,
    unit: str | None = None,
    memory_limit: int | None = None,
) -> Mesh | Volume:
    """Return a mesh as a `Mesh`, or anything else as a `Volume` whose surface fits into memory."""
    mesh = as_mesh(source)
    if mesh is None:
        check_ending(source)
        volume, has_unit = _volume_and_unit(source, spacing, affine)
        if unit is not None and unit != volume.unit:
            if has_unit:
                raise InputError(
                    f"unit is {unit!r}, but this volume defines its voxel size in {volume.unit}. Omit unit"
                )
            volume = replace(volume, unit=unit)
        if not volume.is_placed and is_stack_path(volume.path):
            text = "%s does not define the size of its voxels, which is assumed to be 1 %s. Pass spacing and unit"
            log.warning(text, Path(str(volume.path)).name, volume.unit)
        check_memory(_BYTES_PER_VOXEL * volume.data.size, memory_limit, "crop or downsample the volume")
        return volume
    if unit is not None:
        declared = mesh.declared_unit or "unknown"
        if unit != declared != "unknown":
            raise InputError(f"unit is {unit!r}, but this mesh defines its coordinates in {declared}. Omit unit")
        assumed = (mesh.unit_warning or NOT_KNOWN, NOT_KNOWN)  # it is given, so it is not assumed to be mm
        return replace(mesh, warnings=tuple(text for text in mesh.warnings if not text.endswith(assumed)))
    if mesh.path is not None or mesh.unit_warning is None:  # for files, the reader reports it
        return mesh
    return replace(mesh, warnings=(*mesh.warnings, f"the surface {mesh.unit_warning}"))


def as_mesh(source: object) -> Mesh | None:
    """Return a path, (points, faces), a `Mesh` or another package's mesh as a `Mesh`, or None for other input."""
    for is_one, convert in _MESHES:
        if is_one(source):
            return convert(source)
    return mesh_of_object(source)


def check_ending(source: object) -> None:
    """Raise an error for a file whose ending is neither that of a mesh nor that of a volume."""
    path = Path(source) if isinstance(source, str | os.PathLike) else None
    if path is not None and path.is_file() and not path.name.lower().endswith(VOLUME_ENDINGS):
        text = f"{path}: unknown file name ending {path.suffix!r}. Use one of {', '.join((*VOLUME_ENDINGS, *ENDINGS))}"
        raise InputError(f"{text}, a Zarr directory or a FreeSurfer surface")


def as_volume(obj: object, *, spacing: Sequence[float] | None = None, affine: ArrayLike | None = None) -> Volume:
    """Return anything that contains voxels as a `Volume`.

    The voxels are not copied if this can be avoided.

    Parameters
    ----------
    obj : Volume, path, ndarray, nibabel image, itk image, or object with ``__array__``
        The voxels; arrays are indexed as (i, j, k).
    spacing : sequence of 3 floats, optional
        Voxel size along i, j, k in mm; the centre of voxel (0, 0, 0) is the origin. If a TIFF stack defines it along
        some axes only, these must agree, and the size is in the unit of the file.
    affine : array_like, shape (4, 4), optional
        Affine from voxel indices to RAS+ mm; the identity by default. Omit it and `spacing` for an object that has its
        own affine.

    Returns
    -------
    Volume
        The same voxels with their affine.

    Raises
    ------
    InputError
        The object is not a volume, or its position is specified twice.

    See Also
    --------
    read_volume : Read a volume from a file.

    Examples
    --------
    >>> voxflat.io.as_volume(voxflat.samples.ball(), spacing=(0.5, 0.5, 1.0))
    <Volume: 24 x 24 x 24 of uint8, voxels of 0.5 x 0.5 x 1 mm, RAS>
    """
    return _volume_and_unit(obj, spacing, affine)[0]


def _volume_and_unit(obj: object, spacing: Sequence[float] | None, affine: ArrayLike | None) -> tuple[Volume, bool]:
    """Return an object as a volume with the affine that the caller passed, and whether it defines its own unit."""
    matrix = given_affine(spacing, affine)
    with _naming(obj):
        volume = volume_of(obj)
        if is_incomplete(volume.affine):
            affine = completed(volume.affine, volume.unit, spacing)
            return replace(volume, affine=affine, is_placed=True), True
        if matrix is None:
            return volume, volume.is_placed
        if volume.is_placed:
            sizes = " x ".join(f"{size:.6g}" for size in volume.spacing)
            name, text = ("affine", "") if spacing is None else ("spacing", f" ({sizes} {volume.unit})")
            program = "in Fiji (Image → Properties)" if is_stack_path(volume.path) else "with nibabel"
            remedy = f"correct the file, for example {program}" if _is_path(obj) else "pass only the array"
            raise InputError(f"defines the size of its voxels{text}. Omit {name}, or {remedy}")
        return replace(volume, affine=matrix, is_placed=True), False


def volume_of(obj: object) -> Volume:
    """Return anything that contains voxels as a volume, whose affine may be incomplete; see `as_volume`."""
    with _naming(obj):
        return next(convert(obj) for is_one, convert in _VOLUMES if is_one(obj))


def _naming(obj: object) -> AbstractContextManager[None]:
    """Let errors name the file or the type of an object."""
    is_file = isinstance(obj, str | os.PathLike)
    obj = obj.path or obj if isinstance(obj, Volume) else obj
    return naming(obj, REMEDY if is_file else "pass an array, a path or an image")


def _is_path(source: object) -> bool:
    return isinstance(source, str | os.PathLike)


def _of_pair(pair: tuple[Any, Any]) -> Mesh:
    """Return a mesh from points and faces; faces with a corner of −1, as in masked grids, are left out."""
    points, faces = (array_of(part, "points and faces") for part in pair)
    is_left_out = (faces == -1).any(axis=1) if faces.ndim == 2 and faces.dtype.kind == "i" else np.zeros(0, dtype=bool)
    if not is_left_out.any() or is_left_out.all():
        return Mesh(points, faces)
    warning = f"{is_left_out.sum()} of {len(faces)} triangles have a corner of -1 and were left out"
    return Mesh(points, faces[~is_left_out], warnings=(warning,))


def _of_array(source: object) -> Volume:
    if isinstance(source, np.ma.MaskedArray):
        raise InputError("has a mask, which would be lost. Fill the array first, for example with .filled(0)")
    array = as_array(source)
    if array.dtype == object and is_values(source):
        raise InputError("contains values, not a surface. Pass the surface to which the values belong")
    if array.dtype == object:
        raise InputError(f"this object is not supported. Pass {SUPPORTED}")
    return Volume._placed(array, None)


T = TypeVar("T")
_Kinds: TypeAlias = tuple[tuple[Callable[[Any], bool], Callable[[Any], T]], ...]

_MESHES: _Kinds[Mesh] = (
    (lambda given: isinstance(given, Mesh), lambda mesh: mesh),
    (lambda given: _is_path(given) and is_mesh_name(given), read_mesh),
    (lambda given: isinstance(given, tuple) and len(given) == 2, _of_pair),
)

_VOLUMES: _Kinds[Volume] = (
    (lambda given: isinstance(given, Volume), lambda volume: volume),
    (_is_path, volume_of_file),
    (
        lambda given: hasattr(given, "dataobj") and hasattr(given, "affine"),
        lambda image: Volume._placed(*from_nibabel(image)),
    ),
    (
        lambda given: hasattr(given, "GetBufferedRegion") and hasattr(given, "TransformIndexToPhysicalPoint"),
        lambda image: Volume._placed(*from_itk(image)),
    ),
    (is_image, image_volume),
    (lambda _: True, _of_array),
)
