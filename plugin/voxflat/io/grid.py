"""Define voxel grids, which have a shape and an affine without shear from indices to RAS+ mm."""

import re
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat import _core
from voxflat.arguments import log, numbers_of, shown
from voxflat.errors import InputError

Affine: TypeAlias = NDArray[np.float64]

_MAX_SHEAR = 1e-3  # largest |cosine| between two axes of the voxel grid
_LONGEST = 2**31 - 1  # voxels along an axis: indices have 32 bits

FARTHEST = _core.FARTHEST
"""Largest distance from the origin in mm. It suffices for brains in nm and the Earth in m, and keeps volumes finite."""

SMALLEST = _core.SMALLEST  # mm, smallest voxel size and smallest surface extent


def voxel_size(affine: ArrayLike) -> float:
    """Return the geometric mean of the voxel spacings in mm; for cubes, it is their exact spacing on every machine."""
    spacing = np.linalg.norm(np.asarray(affine, dtype=np.float64)[:3, :3], axis=0)
    largest = spacing.max()
    # the cube root of 1 is exactly 1 on every machine, that of 0.125 is not exactly 0.5
    return float(largest * np.cbrt(np.prod(spacing / largest)))


def check_affine(affine: ArrayLike) -> Affine:
    """Check and return an affine from voxel indices to RAS+ mm, which must be finite and without shear."""
    try:
        matrix = numbers_of(affine, "affine")
    except InputError as error:
        raise InputError(f"affine {shown(affine)} is not an array of numbers. Pass a (4, 4) matrix") from error
    if matrix.shape != (4, 4):
        raise InputError(f"affine has shape {matrix.shape}. Pass a (4, 4) matrix that maps voxel indices to RAS+ (mm)")
    if not np.isfinite(matrix).all():
        raise InputError(f"affine {matrix.tolist()} is not finite. Repair the header, or pass an affine")
    if np.abs(matrix).max() > FARTHEST:
        raise InputError(f"affine {matrix.tolist()} exceeds {FARTHEST:g} mm. Repair the header, or pass an affine")
    if not np.array_equal(matrix[3], [0, 0, 0, 1]):
        raise InputError(f"the last row of the affine is {matrix[3].tolist()}, not 0 0 0 1. Transpose it if necessary")
    sizes = np.linalg.norm(matrix[:3, :3], axis=0)
    if not (sizes > 0).all():
        raise InputError(f"the affine has voxel sizes {sizes.tolist()} mm. Pass an affine with positive voxel sizes")
    if sizes.min() < SMALLEST:
        sizes_text = f"{sizes.tolist()} mm, below {SMALLEST:g} mm"
        raise InputError(f"the affine has voxel sizes {sizes_text}. Repair the header, or pass an affine in mm")
    axes = matrix[:3, :3] / sizes
    shear = np.abs(axes.T @ axes - np.eye(3)).max()
    if not shear <= _MAX_SHEAR:
        sheared = f"sheared: the cosine between two voxel axes is {shear:.3g}, above {_MAX_SHEAR:g}"
        raise InputError(f"the affine is {sheared}. Resample the volume to an orthogonal grid")
    return matrix


_SAME_SIZE = 1e-3  # relative difference of a given voxel size and that of a file, which may be rounded


def given_affine(spacing: Sequence[float] | None, affine: ArrayLike | None) -> Affine | None:
    """Return the affine that the caller passed, either directly or as a spacing."""
    if spacing is None:
        return None if affine is None else check_affine(affine)
    if affine is not None:
        raise InputError("spacing and affine are both given. Omit spacing, which the affine includes")
    wrong = f"spacing is {shown(spacing)}. Pass 3 positive, finite numbers in mm"
    try:
        sizes = np.asarray(spacing, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(wrong) from error
    is_bool = np.asarray(spacing).dtype.kind == "b"
    if is_bool or sizes.shape != (3,) or not (np.isfinite(sizes) & (sizes > 0)).all():
        raise InputError(wrong)
    return check_affine(np.diag([*sizes, 1.0]))


def is_incomplete(affine: Affine) -> bool:
    """Return whether a file defines the size of its voxels along some axes only, which is NaN along the others."""
    return affine.shape == (4, 4) and bool(np.isnan(np.diag(affine)).any())


def completed(affine: Affine, unit: str, spacing: Sequence[float] | None) -> Affine:
    """Return an incomplete affine with the spacing that the caller passed, which must agree with the known sizes."""
    sizes = np.diag(affine)[:3]
    is_stored = np.isfinite(sizes)
    named = "XYZ"
    missing = " and ".join(axis for axis, is_known in zip(named, is_stored, strict=True) if not is_known)
    matrix = given_affine(spacing, None)
    if matrix is None:
        remedy = f"Pass spacing, in {unit} as the other sizes, or save the file with that size"
        raise InputError(f"does not define the size of its voxels along {missing}. {remedy}")
    if not np.allclose(np.diag(matrix)[:3][is_stored], sizes[is_stored], rtol=_SAME_SIZE, atol=0):
        stored = " and ".join(f"{size:g} along {axis}" for axis, size in zip(named, sizes, strict=True) if size == size)
        remedy = f"Pass the sizes of the file and that along {missing}, in {unit}"
        raise InputError(f"has voxel sizes of {stored} in {unit}, but spacing is {shown(spacing)}. {remedy}")
    return matrix


def volume_shape(shape: tuple[int, ...], dtype: np.dtype[Any]) -> tuple[int, ...]:
    """Drop trailing axes of length 1; raise an error if the result is not the shape of a volume."""
    lengths = shape[:3] + tuple(n for n in shape[3:] if n != 1)
    colour = len(lengths) == 4 and lengths[3] in (3, 4) and dtype == np.uint8
    if (len(lengths) != 3 and not colour) or min(lengths) < 1:
        remedy = "one 3-D volume (I, J, K), or uint8 colours (I, J, K, 3) or (I, J, K, 4)"
        raise InputError(f"has shape {shape}. Select {remedy}")
    check_axes(lengths)
    return lengths


def check_axes(shape: tuple[int, ...]) -> None:
    """Raise an error if a 32-bit index cannot cover an axis."""
    if max(shape) > _LONGEST:
        raise InputError(f"shape {shape} has an axis of more than {_LONGEST} voxels. Crop the volume, or copy it again")


LONG_NAMES = {"mm": "millimeter", "µm": "micrometer", "nm": "nanometer", "cm": "centimeter", "m": "meter"}
LONG_NAMES |= {"inch": "inch"}  # of OME-Zarr and napari
_MILLIMETRES = {"mm": 1.0, "cm": 10.0, "m": 1e3, "µm": 1e-3, "nm": 1e-6, "inch": 25.4}
UNITS = tuple(_MILLIMETRES)
_UNDEFINED = ("", "?", "???", "unknown")  # in headers of volumes, which are then in mm
_METRES = {"mm": "milli", "µm": "micro", "nm": "nano", "cm": "centi", "m": ""}
_ENDS = ("meter", "metre", "meters", "metres")
_UNITS = {unit: unit for unit in UNITS} | {f"{name}{end}": unit for unit, name in _METRES.items() for end in _ENDS}
_UNITS |= dict.fromkeys(("um", "μm", "micron", "microns"), "µm") | dict.fromkeys(("in", "inches", '"'), "inch")


NOT_KNOWN = "counts as unknown unless it is passed as unit"
"""The end of a warning on a unit."""


def unit_of(text: object) -> str | None:
    """Return the standard name of a unit of length, or None for other texts and objects."""
    return _UNITS.get(text.strip().lower()) if isinstance(text, str) else None


def named_unit(unit: object) -> str:
    """Return the standard name of a unit of length that a user passed."""
    symbol = unit_of(unit)
    if symbol is None:
        raise InputError(f"unit is {shown(unit)}. Pass one of {', '.join(_MILLIMETRES)}")
    return symbol


def rounded(length: float, places: int = 0) -> str:
    """Return a length with some decimal places, but at least two significant digits, so that no length is "0"."""
    return f"{length:.{places}f}" if abs(length) >= (1 if places else 10) or length == 0 else f"{length:.2g}"


def key_in_unit(name: str, unit: str) -> str:
    """Return the name of a figure, such as ``area_mm2`` or ``error_10mm``, with the unit instead of mm."""
    short = "" if unit == "unknown" else unit.replace("µ", "u")
    return re.sub("(_?)mm(2?)$", lambda match: f"{match[1]}{short}{match[2]}" if short else "", name)


def in_unit(text: str, unit: str) -> str:
    """Replace mm in a text by the unit of a surface or map; remove it if the unit is unknown."""
    if unit == "mm":
        return text
    if unit != "unknown":
        return re.sub(r"(?<![A-Za-z])mm(?![A-Za-z])", unit, text)
    return re.sub(r" \(mm²?\)|,? ?(?<![A-Za-z])mm²?(?![A-Za-z])", "", text)


def warn_of_unit(path: object, unit: str) -> None:
    """Warn if coordinates are not known to be in mm, but are written in a format that other programs read in mm."""
    if unit == "unknown":
        text = "%s: the unit of the coordinates is unknown, but this format is in mm. Pass unit when reading the mesh"
        log.warning(text, path)
    elif unit != "mm":
        log.warning("%s: coordinates are in %s, but other programs assume mm in this format", path, unit)


def millimetres(unit: str) -> float:
    """Return the length of a unit in mm. The default unit is mm, and an unknown unit raises an `InputError`."""
    name = "mm" if unit.strip().lower() in _UNDEFINED else unit_of(unit)
    if name is None:
        raise InputError(f"its unit of length, {unit!r}, is unknown. Save it in mm, or pass an array and an affine")
    return _MILLIMETRES[name]


def scaled(affine: ArrayLike, unit: str, target: str) -> Affine:
    """Return an affine in another unit of length."""
    factor = millimetres(unit) / millimetres(target)
    return np.asarray(np.diag([factor] * 3 + [1.0]) @ np.asarray(affine, dtype=np.float64))


def in_millimetres(affine: Affine, unit: str) -> Affine:
    """Convert an affine from a given unit to mm, and log the conversion."""
    if millimetres(unit) == 1:
        return affine
    log.warning("the header specifies lengths in %s, which were converted to mm", unit)
    return scaled(affine, unit, "mm")
