"""Volumes in and out: voxels in the order (i, j, k) and an affine to RAS+ mm.

`as_volume` takes whatever holds voxels (an array, a path, an image object), `read_volume` a file,
`write_volume` writes one. All of them end in a `Volume`, which is checked once, where it is made.

NIfTI voxels come from ITK, or from nibabel where ITK refuses them or would change them; the affine is
read here, so it is the same (nibabel's: sform, else qform, else pixdim) whichever package is installed.
Neither package notices every damaged file, so the checks of completeness are made here, too.
"""

from __future__ import annotations

import gzip
import importlib
import os
import re
import textwrap
import uuid
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat._errors import InputError

__all__ = ["Volume", "as_volume", "atomic_path", "check_affine", "read_volume", "write_volume"]

_Affine: TypeAlias = NDArray[np.float64]
_Read: TypeAlias = tuple[NDArray[Any], NDArray[Any] | None]  # voxels, and the affine if there is one

_MAX_SHEAR = 1e-3  # largest |cosine| between two axes of the voxel grid
_LPS_TO_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])


@dataclass(frozen=True, eq=False)
class Volume:
    """Voxels and where they lie. Making one checks it; a bad array or affine is an `InputError`.

    Parameters
    ----------
    data : ndarray, shape (I, J, K), or (I, J, K, 3) or (I, J, K, 4) for uint8 colours
        Values in the index order i, j, k, as nibabel gives them; native byte order.
    affine : ndarray, shape (4, 4), float64
        Takes the voxel index (i, j, k, 1) to RAS+ mm; a voxel's centre has integer indices.
    path : Path or None
        The file it came from.
    is_placed : bool
        Whether its place was given; otherwise the affine is the identity for want of a better one.
    """

    data: NDArray[Any]
    affine: _Affine
    path: Path | None = None
    is_placed: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "data", _check_data(self.data))
        object.__setattr__(self, "affine", check_affine(self.affine))

    @property
    def spacing(self) -> _Affine:
        """Distance between the centres of neighbouring voxels along i, j, k, shape (3,), in mm."""
        return np.asarray(np.linalg.norm(self.affine[:3, :3], axis=0))

    @property
    def orientation(self) -> str:
        """The way each index grows, one of R/L, A/P, S/I each, such as ``'RAS'``."""
        cosines = self.affine[:3, :3] / self.spacing
        codes = [""] * 3
        # the best aligned index chooses first, so that no two share a direction
        for index in np.argsort(-np.abs(cosines).max(axis=0), kind="stable"):
            world = int(np.abs(cosines[:, index]).argmax())
            codes[index] = ("LR", "PA", "IS")[world][int(cosines[world, index] > 0)]
            cosines[world] = 0
        return "".join(codes)


def read_volume(path: str | os.PathLike[str]) -> Volume:
    """Read a volume from a file.

    Parameters
    ----------
    path : path
        ``.nii``, ``.nii.gz``, ``.nrrd``, ``.nhdr``, ``.mha``, ``.mhd``, ``.mgh``, ``.mgz``, ``.npy``, or
        ``.npz`` with one array, or with ``data`` and perhaps ``affine``. Arrays without an affine get
        the identity: 1 mm voxels.

    Returns
    -------
    Volume
        Voxels (I, J, K) and their affine to RAS+ mm.

    Raises
    ------
    InputError
        The file is damaged, of another format, no single volume, sheared, or not in mm.
    FileNotFoundError, PermissionError
        The file cannot be opened.
    """
    return as_volume(Path(path))


def as_volume(obj: object, *, spacing: Sequence[float] | None = None, affine: ArrayLike | None = None) -> Volume:
    """Take anything that holds voxels as a `Volume`, without a copy where possible.

    Parameters
    ----------
    obj : Volume, path, ndarray, nibabel image, itk image, or object with ``__array__``
        The voxels, in the order (i, j, k) if it is an array.
    spacing : sequence of 3 floats, optional
        Voxel size along i, j, k in mm; the centre of voxel (0, 0, 0) is the origin.
    affine : array_like, shape (4, 4), optional
        Voxel index to RAS+ mm. Neither this nor `spacing` may be given for something with an affine of
        its own. Without any, the identity.

    Returns
    -------
    Volume
        The same voxels with their affine.

    Raises
    ------
    InputError
        The object is no volume, or its place is given twice.
    """
    given = _given_affine(spacing, affine)
    is_file = isinstance(obj, str | os.PathLike)
    remedy = "is the file complete, and what its ending says?" if is_file else "give an array, a path or an image"
    with _naming(obj if is_file else type(obj).__name__, remedy):
        data, own, path = _parts(obj)
        if given is not None and own is not None:
            raise InputError("has its own affine: leave out spacing= and affine=, or pass the bare array")
        placed = own if given is None else given
        return Volume(data, np.eye(4) if placed is None else placed, path, is_placed=placed is not None)


def write_volume(path: str | os.PathLike[str], data: ArrayLike, affine: ArrayLike) -> None:
    """Write a volume to a file, all of it or nothing.

    Parameters
    ----------
    path : path
        ``.nii``, ``.nii.gz``, ``.nrrd``, ``.mha``, ``.mgh``, ``.mgz``, ``.npz``, or ``.npy``, which has
        no place for an affine other than the identity.
    data : array_like, shape (I, J, K), or (I, J, K, 3|4) uint8 for colours
        Values; the type is kept, except that bool becomes uint8 in image formats.
    affine : array_like, shape (4, 4)
        Voxel index to RAS+ mm.

    Raises
    ------
    InputError
        The format cannot hold the volume, or the file cannot be written.
    """
    path = Path(path)
    with atomic_path(path) as temporary, _naming(path, "can this format hold it?"):
        write = _by_ending(path, _WRITERS, "written; .mhd and .nhdr are two files: use .mha or .nrrd")
        write(temporary, Volume(np.asarray(data), check_affine(affine)))


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Write a file beside its place, and move it there once it is complete.

    Parameters
    ----------
    path : path
        The file to make or replace.

    Yields
    ------
    Path
        A new empty file in the same directory whose name has the same ending. It takes the place of
        `path` when the block ends, and is deleted when the block raises.

    Raises
    ------
    InputError
        Nothing can be written at `path`.
    """
    path = Path(path)
    temporary = path.with_name(f".{uuid.uuid4().hex[:8]}.{path.name}")
    try:
        if path.is_dir():
            raise IsADirectoryError(None, "it is a directory")
        temporary.open("xb").close()  # by open(), not mkstemp(), for the user's usual permissions
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror}; choose another place") from error
    try:
        yield temporary
        try:
            temporary.replace(path)
        except OSError as error:
            raise InputError(f"cannot replace {path}: {error.strerror}; is it in use?") from error
    finally:
        temporary.unlink(missing_ok=True)


def check_affine(affine: ArrayLike) -> _Affine:
    """Check that an affine maps a grid of boxes to mm: finite, and not sheared.

    Parameters
    ----------
    affine : array_like, shape (4, 4)
        Voxel index to RAS+ mm.

    Returns
    -------
    ndarray, shape (4, 4), float64
        The affine.

    Raises
    ------
    InputError
        It has another shape, values that are not finite, a voxel size of 0, or axes that are not
        orthogonal (the cosine between two of them exceeds 1e-3).
    """
    try:
        matrix = np.asarray(affine, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"affine {affine!r} is no array of numbers: give a (4, 4) matrix") from error
    if matrix.shape != (4, 4):
        raise InputError(f"affine has shape {matrix.shape}: give a (4, 4) matrix, voxel index to RAS+ mm")
    if not np.isfinite(matrix).all():
        raise InputError(f"affine {matrix.tolist()} is not finite: repair the header or give an affine")
    if not np.array_equal(matrix[3], [0, 0, 0, 1]):
        raise InputError(f"affine's last row is {matrix[3].tolist()}: it must be 0 0 0 1; is it transposed?")
    sizes = np.linalg.norm(matrix[:3, :3], axis=0)
    if not (sizes > 0).all():
        raise InputError(f"affine's voxel size is {sizes.tolist()} mm: each column must have a length above 0")
    axes = matrix[:3, :3] / sizes
    shear = np.abs(axes.T @ axes - np.eye(3)).max()
    if not shear <= _MAX_SHEAR:
        raise InputError(
            f"affine is sheared: the cosine between two voxel axes is {shear:.3g}, above {_MAX_SHEAR:g}: "
            "resample to an orthogonal grid"
        )
    return matrix


def _given_affine(spacing: Sequence[float] | None, affine: ArrayLike | None) -> _Affine | None:
    """Return the affine that the caller gave, as such or as a spacing."""
    if spacing is None:
        return None if affine is None else check_affine(affine)
    if affine is not None:
        raise InputError("both spacing= and affine= are given: give one, the affine holds the spacing")
    try:
        sizes = np.asarray(spacing, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"spacing {spacing!r} must be 3 numbers in mm") from error
    if sizes.shape != (3,) or not (np.isfinite(sizes) & (sizes > 0)).all():
        raise InputError(f"spacing {sizes.tolist()} must be 3 positive, finite numbers in mm")
    return np.diag([*sizes, 1.0])


def _check_data(data: NDArray[Any]) -> NDArray[Any]:
    """Check type and shape, drop trailing axes of length 1, and take the native byte order."""
    if data.dtype.kind not in "biuf":
        raise InputError(f"values of type {data.dtype} are no bool, integer or float: convert them")
    shape = _volume_shape(data.shape, data.dtype)
    data = data if data.shape == shape else data.reshape(shape)
    return data.astype(data.dtype.newbyteorder("="), copy=False)


def _volume_shape(shape: tuple[int, ...], dtype: np.dtype[Any]) -> tuple[int, ...]:
    """Drop trailing axes of length 1; an error for what is no volume then."""
    kept = shape[:3] + tuple(n for n in shape[3:] if n != 1)
    colour = len(kept) == 4 and kept[3] in (3, 4) and dtype == np.uint8
    if (len(kept) != 3 and not colour) or min(kept) < 1:
        raise InputError(f"shape {shape} is no volume: pick one of shape (I, J, K), or uint8 colours (I, J, K, 3 or 4)")
    return kept


def _parts(obj: object) -> tuple[NDArray[Any], NDArray[Any] | None, Path | None]:
    """Return the voxels of anything, its own affine or None, and its file or None."""
    if isinstance(obj, Volume):
        return obj.data, obj.affine, obj.path
    if isinstance(obj, str | os.PathLike):
        return *_read(Path(obj)), Path(obj)
    if hasattr(obj, "dataobj") and hasattr(obj, "affine"):
        return *_from_nibabel(obj), None
    if hasattr(obj, "GetBufferedRegion") and hasattr(obj, "TransformIndexToPhysicalPoint"):
        return *_from_itk(obj), None
    if isinstance(obj, np.ma.MaskedArray):
        raise InputError("has a mask, which would be lost: fill it first, say with .filled(0)")
    return _array(obj), None, None


def _array(obj: object) -> NDArray[Any]:
    """Return an ndarray; of ITK's own view, one that keeps its image alive.

    `numpy.asarray` drops the view's hold on the image, and ends in freed memory; `memoryview` keeps it.
    """
    return np.asarray(memoryview(obj) if hasattr(obj, "itk_base") else obj)  # type: ignore[arg-type]


# ------------------------------------------------------------------------------------------- reading


def _read(path: Path) -> _Read:
    """Read the voxels of a file and its affine, if it has one."""
    if path.is_dir():
        raise InputError("is a directory: name a volume file (a DICOM series: convert it to NIfTI first)")
    path.open("rb").close()  # the system's own error for a missing file says more than a reader's
    read: Callable[[Path], _Read] = _by_ending(path, _READERS, "read")
    return read(path)


def _read_npy(path: Path) -> _Read:
    with path.open("rb") as file:
        return np.lib.format.read_array(file, allow_pickle=False), None


def _read_npz(path: Path) -> _Read:
    if not zipfile.is_zipfile(path):
        raise InputError("is no complete .npz archive: write it again with numpy.savez")
    with np.load(path, allow_pickle=False) as archive:
        names = archive.files
        if "data" in names:
            return archive["data"], archive["affine"] if "affine" in names else None
        if len(names) != 1:
            raise InputError(f"holds the arrays {names}: name the volume 'data' (and its affine 'affine')")
        return archive[names[0]], None


def _read_mgh(path: Path) -> _Read:
    if path.suffix.lower() == ".mgz":
        _uncompressed(path)
    return _from_nibabel(_require("nibabel").load(path, mmap=False))


def _read_nifti(path: Path) -> _Read:
    head, size = _uncompressed(path)
    if head[4:8] == b"n+2\0":  # ITK knows no NIfTI-2
        return _from_nibabel(_require("nibabel").load(path, mmap=False))
    header = _nifti_header(head)
    shape = tuple(header["dim"][1 : header["dim"][0] + 1].tolist())
    _volume_shape(shape, np.dtype(np.uint8))  # before a time series is read for nothing
    # ITK returns a file cut short as if it were whole, the rest filled with what is in memory
    needed = int(header["vox_offset"]) + int(np.prod(shape, dtype=np.int64)) * int(header["bitpix"]) // 8
    if size < needed:
        raise InputError(f"ends after {size} of {needed} bytes: copy or download it again")
    affine = check_affine(_nifti_affine(header, shape))  # before ITK complains of a bad one at length
    return _nifti_voxels(path, header, shape), affine


def _nifti_voxels(path: Path, header: np.void, shape: tuple[int, ...]) -> NDArray[Any]:
    """Read by ITK; by nibabel what ITK refuses or would change."""
    try:
        # ITK scales in float32 (integers above 2^24 change), and adds scl_inter even if scl_slope is 0
        if header["scl_slope"] not in (0, 1) or header["scl_inter"] != 0:
            raise InputError("its values are scaled, which ITK does in float32 only")
        if path.suffix.lower() == ".gz" and path.with_suffix("").exists():
            raise InputError(f"ITK would read {path.with_suffix('').name} in its place")
        if not _all_finite(path, header, shape):
            raise InputError("it holds NaN or infinity, which ITK turns into 0")
        voxels, _ = _from_itk(_load_itk(path))
        if voxels.shape[:3] != shape[:3]:
            raise InputError(f"ITK gives the shape {voxels.shape} instead of {shape}")
        return voxels
    except Exception as refusal:
        reason = _one_line(refusal)
    try:
        nibabel = _require("nibabel")
    except InputError as missing:
        raise InputError(f"{reason}; {missing}") from None
    return _from_nibabel(nibabel.load(path, mmap=False))[0]


def _all_finite(path: Path, header: np.void, shape: tuple[int, ...]) -> bool:
    """Tell whether all values of a NIfTI-1 file are finite."""
    form = {16: "f4", 64: "f8"}.get(int(header["datatype"]))
    if form is None:
        return True
    dtype = np.dtype(form).newbyteorder(header["dim"].dtype.byteorder)
    remaining = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
    with _opened(path) as file:
        file.read(int(header["vox_offset"]))
        while remaining > 0 and (block := file.read(min(remaining, 1 << 24))):
            remaining -= len(block)
            if not np.isfinite(np.frombuffer(block, dtype)).all():
                return False
    return True


# The fields of NIfTI-1 that place the voxels (nifti1.h). ITK's metadata has them, too, but as text with
# six digits: an offset of -123.45678 mm would come back as -123.457.
_NIFTI1_FIELDS = {
    "sizeof_hdr": ("i4", 0),
    "dim": ("8i2", 40),
    "datatype": ("i2", 70),
    "bitpix": ("i2", 72),
    "pixdim": ("8f4", 76),
    "vox_offset": ("f4", 108),
    "scl_slope": ("f4", 112),
    "scl_inter": ("f4", 116),
    "xyzt_units": ("u1", 123),
    "qform_code": ("i2", 252),
    "sform_code": ("i2", 254),
    "quatern": ("3f4", 256),
    "qoffset": ("3f4", 268),
    "srow": ("(3,4)f4", 280),
    "magic": ("S4", 344),
}
_NIFTI1 = np.dtype(
    {
        "names": list(_NIFTI1_FIELDS),
        "formats": [form for form, _ in _NIFTI1_FIELDS.values()],
        "offsets": [offset for _, offset in _NIFTI1_FIELDS.values()],
        "itemsize": 348,
    }
)
_NIFTI_UNITS = {1: "meter", 3: "micron"}  # 2 is mm; 0, unknown, is taken as mm


def _nifti_header(head: bytes) -> np.void:
    """Return the fields of a NIfTI-1 header of either byte order."""
    for order in ("<", ">"):
        if len(head) < _NIFTI1.itemsize:
            break
        header: np.void = np.frombuffer(head, _NIFTI1.newbyteorder(order), count=1)[0]
        if header["sizeof_hdr"] == 348 and header["magic"] == b"n+1" and 1 <= header["dim"][0] <= 7:
            _check_unit(_NIFTI_UNITS.get(int(header["xyzt_units"]) & 7, "mm"))
            return header
    raise InputError("is no NIfTI file, or its header is damaged: does its ending name its format?")


def _nifti_affine(header: np.void, shape: tuple[int, ...]) -> _Affine:
    """Return the affine to RAS+ mm that nibabel would choose: sform, else qform, else pixdim."""
    affine = np.eye(4)
    if header["sform_code"] != 0:
        affine[:3] = header["srow"]
        return affine
    sizes = header["pixdim"][1:4].astype(np.float64)
    if not (np.isfinite(sizes) & (sizes > 0)).all():
        raise InputError(f"pixdim {sizes.tolist()} must be positive, finite mm: repair the header")
    if header["qform_code"] != 0:
        sizes[2] *= -1 if header["pixdim"][0] == -1 else 1
        affine[:3, :3] = _rotation(header["quatern"].astype(np.float64)) * sizes
        affine[:3, 3] = header["qoffset"]
        return affine
    sizes[0] *= -1  # nibabel's choice for a file without a place: radiological order, the centre as origin
    affine[:3, :3] = np.diag(sizes)
    affine[:3, 3] = -sizes * (np.array(shape[:3]) - 1) / 2
    return affine


def _rotation(imaginary: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation of a unit quaternion with a real part >= 0, given its three other parts."""
    b, c, d = imaginary
    square = 1 - imaginary @ imaginary
    if not square > -3 * np.finfo(np.float32).eps:
        raise InputError(f"qform quaternion {imaginary.tolist()} is longer than 1: repair the header")
    # within the rounding of the header's float32 a half turn is meant
    a = np.sqrt(square) if square >= 3 * np.finfo(np.float32).eps else 0.0
    return np.array(
        [
            [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
            [2 * (b * c + a * d), a * a + c * c - b * b - d * d, 2 * (c * d - a * b)],
            [2 * (b * d - a * c), 2 * (c * d + a * b), a * a + d * d - b * b - c * c],
        ]
    ) / (a * a + imaginary @ imaginary)


def _read_nrrd(path: Path) -> _Read:
    with path.open("rb") as file:
        head = re.split(rb"\r?\n\r?\n", file.read(1 << 20), maxsplit=1)[0]
    for line in re.findall(rb"(?m)^(?:space )?units:(.*)$", head):
        for unit in re.findall(r'"([^"]*)"', line.decode("latin1")):
            _check_unit(unit)
    if spacings := re.search(rb"(?mi)^spacings:(.*nan.*)$", head):  # for which ITK takes 1 mm
        raise InputError(f"its spacings are{spacings[1].decode('latin1')}: give array and spacing")
    return _from_itk(_load_itk(path))


def _read_metaimage(path: Path) -> _Read:
    content = path.read_bytes()
    end = re.search(rb"(?m)^ElementDataFile *= *(.*?) *\r?\n", content)
    if end is None:
        raise InputError("is no MetaImage: does its ending name its format?")
    head = content[: end.start()]
    if unit := re.search(rb"(?m)^DistanceUnits *= *(\S*)", head):
        _check_unit(unit[1].decode("latin1"))
    if re.search(rb"(?mi)^CompressedData *= *(True|1)", head):
        separate = path.parent / end[1].decode("utf-8", "replace")
        if end[1] == b"LOCAL":
            _check_deflated(content[end.end() :])
        elif separate.is_file():
            _check_deflated(separate.read_bytes())
    return _from_itk(_load_itk(path))


def _check_deflated(packed: bytes) -> None:
    """Decompress to compare the checksum: ITK returns what it could decompress as if it were whole."""
    stream = zlib.decompressobj(wbits=47)  # zlib or gzip
    stream.decompress(packed)
    if not stream.eof:
        raise InputError("ends too early: copy or download it again")


def _check_unit(unit: str) -> None:
    """Refuse lengths that the header says are not mm."""
    if unit not in ("", "mm", "?", "???", "unknown"):
        raise InputError(f"its lengths are in {unit}, by its header: save it in mm, or give array and affine")


def _opened(path: Path) -> Any:
    """Open a file that may be gzipped, for reading bytes."""
    opener: Callable[..., Any] = gzip.open if path.suffix.lower() in (".gz", ".mgz") else open
    return opener(path, "rb")


def _uncompressed(path: Path) -> tuple[bytes, int]:
    """Return the first 348 bytes and the full length of a file that may be gzipped.

    It is read to its end, so that the checksum is compared: nibabel stops before it.
    """
    with _opened(path) as file:
        head: bytes = file.read(_NIFTI1.itemsize)
        size = len(head)
        while block := file.read(1 << 20):
            size += len(block)
    return head, size


# --------------------------------------------------------------------------------- images of packages


def _from_nibabel(image: Any) -> _Read:
    """Return voxels and affine of a nibabel image."""
    _volume_shape(image.shape, np.dtype(np.uint8))
    if hasattr(image.header, "get_xyzt_units"):
        _check_unit(image.header.get_xyzt_units()[0])
    voxels = np.asarray(image.dataobj)
    if voxels.dtype.names is not None:  # RGB24, RGBA32
        voxels = np.stack([voxels[name] for name in voxels.dtype.names], axis=-1)
    return voxels, check_affine(image.affine)


def _from_itk(image: Any) -> _Read:
    """Return voxels and affine of an ITK image, whose axes are (k, j, i) and whose world is LPS."""
    itk = _require("itk")
    view = _array(itk.array_view_from_image(image))
    dimension = image.GetImageDimension()
    voxels = view.transpose(*reversed(range(dimension)), *range(dimension, view.ndim))
    if dimension != 3:
        return voxels, None  # no volume, unless NIfTI with an affine of its own
    affine = np.eye(4)
    affine[:3, :3] = itk.array_from_matrix(image.GetDirection()) * np.array(image.GetSpacing())
    start = np.array(image.GetBufferedRegion().GetIndex())  # not 0 in a region cut from an image
    affine[:3, 3] = np.array(image.GetOrigin()) + affine[:3, :3] @ start
    return voxels, _LPS_TO_RAS @ affine


def _load_itk(path: Path) -> Any:
    """Read an image by ITK, without its warnings on NIfTI placements, which are not taken from it."""
    itk = _require("itk")
    before = itk.Object.GetGlobalWarningDisplay()
    itk.Object.SetGlobalWarningDisplay(False)
    try:
        return itk.imread(str(path))
    except TypeError as error:  # 30 lines on templates, of which the first names the type
        known = ", ".join(_ITK_TYPES)
        raise InputError(f"{str(error).splitlines()[0]} Convert its values to one of {known}") from error
    finally:
        itk.Object.SetGlobalWarningDisplay(before)


# ------------------------------------------------------------------------------------------- writing

_ITK_TYPES = ("uint8", "uint16", "int16", "uint32", "int32", "float32", "float64")


def _write_npy(path: Path, volume: Volume) -> None:
    if not np.array_equal(volume.affine, np.eye(4)):
        raise InputError("a .npy file keeps no affine: use .npz or an image format")
    np.save(path, volume.data, allow_pickle=False)


def _write_npz(path: Path, volume: Volume) -> None:
    np.savez_compressed(path, data=volume.data, affine=volume.affine)


def _write_mgh(path: Path, volume: Volume) -> None:
    nibabel = _require("nibabel")
    data = _storable(volume.data)
    if data.ndim != 3:
        raise InputError("an MGH file holds no colours: use .nii.gz or .nrrd")
    nibabel.save(nibabel.MGHImage(data, volume.affine), path)


def _write_nifti(path: Path, volume: Volume) -> None:
    try:
        nibabel = _require("nibabel")
    except InputError:
        return _write_itk(path, volume)
    data = _storable(volume.data)
    if data.ndim == 4:
        colour = np.dtype([(name, "u1") for name in "RGBA"[: data.shape[3]]])
        data = np.ascontiguousarray(data).view(colour)[..., 0]
    if max(data.shape) > np.iinfo(np.int16).max:  # nibabel would write what only FreeSurfer reads
        raise InputError(f"shape {data.shape} is too long for NIfTI-1: use .nrrd or .npz")
    image = nibabel.Nifti1Image(data, volume.affine, dtype=data.dtype)
    image.set_sform(volume.affine, "scanner")
    image.set_qform(volume.affine, "scanner")
    image.header.set_xyzt_units("mm")
    nibabel.save(image, path)
    return None


def _write_metaimage(path: Path, volume: Volume) -> None:
    if volume.data.ndim != 3:
        raise InputError("a MetaImage does not say that its channels are colours: use .nii.gz or .nrrd")
    _write_itk(path, volume)


def _write_itk(path: Path, volume: Volume) -> None:
    itk = _require("itk")
    data = _storable(volume.data)
    if data.dtype.name not in _ITK_TYPES:
        raise InputError(f"ITK writes no {data.dtype}: convert to one of {', '.join(_ITK_TYPES)}")
    kji = np.ascontiguousarray(data.transpose(2, 1, 0, *range(3, data.ndim)))
    pixel = {3: itk.RGBPixel, 4: itk.RGBAPixel}.get(data.shape[3] if data.ndim == 4 else 0)
    image = itk.image_view_from_array(kji, ttype=pixel and itk.Image[pixel[itk.UC], 3])
    lps = _LPS_TO_RAS @ volume.affine
    image.SetSpacing(volume.spacing.tolist())
    image.SetOrigin(lps[:3, 3].tolist())
    image.SetDirection(itk.matrix_from_array(np.ascontiguousarray(lps[:3, :3] / volume.spacing)))
    itk.imwrite(image, str(path), compression=True)


def _storable(data: NDArray[Any]) -> NDArray[Any]:
    """Take the types that no image format knows as the next one that keeps their values."""
    wider = {"bool": np.uint8, "float16": np.float32}.get(data.dtype.name)
    return data if wider is None else data.astype(wider)


# -------------------------------------------------------------------------------------------- helpers

_READERS: dict[str, Callable[[Path], _Read]] = {
    ".nii": _read_nifti,
    ".nii.gz": _read_nifti,
    ".nrrd": _read_nrrd,
    ".nhdr": _read_nrrd,
    ".mha": _read_metaimage,
    ".mhd": _read_metaimage,
    ".mgh": _read_mgh,
    ".mgz": _read_mgh,
    ".npy": _read_npy,
    ".npz": _read_npz,
}
_WRITERS: dict[str, Callable[[Path, Volume], None]] = {
    ".nii": _write_nifti,
    ".nii.gz": _write_nifti,
    ".nrrd": _write_itk,
    ".mha": _write_metaimage,
    ".mgh": _write_mgh,
    ".mgz": _write_mgh,
    ".npy": _write_npy,
    ".npz": _write_npz,
}


def _by_ending(path: Path, table: dict[str, Callable[..., Any]], verb: str) -> Callable[..., Any]:
    """Return the entry of a table whose key ends the file's name."""
    for ending, entry in table.items():
        if path.name.lower().endswith(ending):
            return entry
    raise InputError(f"ending {path.suffix!r} is unknown; {', '.join(table)} can be {verb}")


def _require(module: str) -> Any:
    """Import an optional package, which has the name of its extra."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise InputError(f"needs {module}: pip install 'voxflat[{module}]'") from error


@contextmanager
def _naming(name: object, remedy: str) -> Iterator[None]:
    """Turn whatever goes wrong with a file or object into one line that begins with its name."""
    try:
        yield
    except (FileNotFoundError, PermissionError, MemoryError):
        raise
    except InputError as error:
        raise InputError(f"{name}: {error}") from error
    except Exception as error:
        raise InputError(f"{name}: {_one_line(error)}: {remedy}") from error


def _one_line(error: Exception) -> str:
    """Shorten a message, above all ITK's: lines of C++ places and addresses."""
    if isinstance(error, InputError):
        return str(error)
    text = re.sub(r"\S+\.[ch]xx:\d+:|(ITK|itk::) ?ERROR:|\w+\(0x[0-9a-fA-F]+\):", " ", str(error))
    return textwrap.shorten(text, 200, placeholder=" ...") or type(error).__name__
