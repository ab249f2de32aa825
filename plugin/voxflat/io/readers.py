"""Read files, and images of other packages, as voxel arrays with affines.

nibabel reads NIfTI and MGH; ITK reads NRRD and MetaImage. Neither package detects every damaged file, so this module
checks headers, completeness, and how much memory the voxels need before they are read.
"""

import gzip
import os
import re
import zipfile
import zlib
from collections.abc import Callable, Collection
from pathlib import Path
from typing import IO, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from voxflat.errors import InputError
from voxflat.io.files import AGAIN, by_ending, check_regular, companion, nibabel_image, require
from voxflat.io.formats.hdf5 import HDF5_ENDINGS
from voxflat.io.formats.tiff import TIFF_ENDINGS
from voxflat.io.grid import Affine, check_affine, in_millimetres, millimetres, volume_shape
from voxflat.io.reading import check_room, record_file
from voxflat.io.subprocess_reader import read_in_subprocess

Read: TypeAlias = tuple[NDArray[Any], NDArray[Any] | None]  # voxels, and the affine to mm or None

LPS_TO_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])

_BLOCK = 1 << 20
_MOST_BEYOND = 1 << 26  # largest number of additional bytes after the voxels
ITK_TYPES = ("uint8", "uint16", "int16", "uint32", "int32", "float32", "float64")


def as_array(obj: object) -> NDArray[Any]:
    """Return an ndarray that keeps the image of an ITK view alive; `numpy.asarray` would refer to freed memory."""
    return np.asarray(memoryview(obj) if hasattr(obj, "itk_base") else obj)  # type: ignore[arg-type]


def read(path: Path) -> Read:
    """Read the voxels of a file, and its affine if it has one."""
    if path.is_dir():
        raise InputError("is a directory. Pass a volume file. Convert a DICOM series to NIfTI first")
    check_regular(path)  # the system's own error for a missing file is more helpful
    path.open("rb").close()
    others = f", {', '.join((*TIFF_ENDINGS, *HDF5_ENDINGS))}, or a Zarr directory"
    read: Callable[[Path], Read] = by_ending(path, READERS, others)
    volume = read(path)
    record_file(path)
    return volume


def read_array(path: Path) -> NDArray[Any]:
    """Read the array of a .npy file."""
    with path.open("rb") as file:
        if _header(file)[1].hasobject:
            problem = "contains Python objects, which could run programs when they are loaded"
            raise InputError(f"{problem}. Save an array, or the masks of cellpose as TIFF")
        file.seek(0)
        check_room(_need_of(file, path.stat().st_size))
        file.seek(0)
        return np.lib.format.read_array(file, allow_pickle=False)


def read_arrays(path: str | os.PathLike[str], names: Collection[str] | None = None) -> dict[str, NDArray[Any]]:
    """Read all or some arrays of a .npz archive in native byte order; raise KeyError for missing ones."""
    with np.load(path, allow_pickle=False) as archive:
        taken, need = archive.files if names is None else list(names), 0
        for member in {f"{name}.npy" for name in taken} & set(archive.zip.namelist()):  # other members are not arrays
            with archive.zip.open(member) as file:
                need += _need_of(file, archive.zip.getinfo(member).file_size)
        check_room(need)
        arrays = {name: np.asanyarray(archive[name]) for name in taken}
    return {name: array.astype(array.dtype.newbyteorder("="), copy=False) for name, array in arrays.items()}


def dimensions(path: Path) -> int:
    """Return the number of dimensions of the array in a .npy file, from its header."""
    with path.open("rb") as file:
        return len(_header(file)[0])


def _header(file: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
    version = np.lib.format.read_magic(file)
    headers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    if version not in headers:  # only for field names beyond Latin-1, which numeric arrays do not have
        raise InputError(f"has an unsupported NumPy format version, {version}. Write it again with numpy.save")
    shape, _, dtype = headers[version](file)
    return shape, dtype


def _need_of(file: IO[bytes], size: int) -> int:
    """Return the size of an array in bytes according to its header, and compare it with the length of the file."""
    shape, dtype = _header(file)
    need = int(np.prod(shape, dtype=object)) * dtype.itemsize
    if file.tell() + need > size and not dtype.hasobject:
        raise InputError(f"ends after {size} of {file.tell() + need} bytes. {AGAIN}")
    return need


def _read_npz(path: Path) -> Read:
    if not zipfile.is_zipfile(path):
        raise InputError("is not a complete .npz archive. Write it again with numpy.savez")
    with np.load(path, allow_pickle=False) as archive:
        names = archive.files
    if "data" in names:
        names = [name for name in ("data", "affine") if name in names]
    elif len(names) != 1:
        raise InputError(f"contains the arrays {names}. Name the volume 'data' and its affine 'affine'")
    voxels, *affine = read_arrays(path, names).values()
    return voxels, affine[0] if affine else None


def _read_by_nibabel(path: Path, voxels: Path | None = None) -> Read:
    """Read a file whose voxels may be stored in another file."""
    image = nibabel_image(path, mmap=False)
    _check_proxy(image)
    stored = image.dataobj
    check_length(voxels or path, stored.offset + int(np.prod(image.shape, dtype=object)) * stored.dtype.itemsize)
    return from_nibabel(image)


def _read_pair(path: Path) -> Read:
    """Read an Analyze or NIfTI image that consists of two files."""
    voxels = path.with_name(f"{path.name[: -len(path.suffix)]}{'.IMG' if path.suffix.isupper() else '.img'}")
    if not voxels.is_file():
        raise InputError(f"has no companion file {voxels.name}. Copy both files, .hdr and .img")
    volume = _read_by_nibabel(path, voxels)
    record_file(voxels)
    return volume


def _read_nifti(path: Path) -> Read:
    with _opened(path) as file:
        head: bytes = file.read(_NIFTI1_BYTES)
    if head[4:8] == b"n+2\0":
        return _read_by_nibabel(path)
    header = _nifti_header(head)
    shape = tuple(header["dim"][1 : header["dim"][0] + 1].tolist())
    volume_shape(shape, np.dtype(np.uint8))  # raises an error before a time series is read
    voxels = int(np.prod(shape, dtype=object))
    needed = int(header["vox_offset"]) + voxels * int(header["bitpix"]) // 8
    check_room(needed + (8 * voxels if header["scl_slope"] not in (0, 1) or header["scl_inter"] != 0 else 0))
    check_length(path, needed)
    affine = check_affine(_nifti_affine(header, shape))
    affine = check_affine(in_millimetres(affine, _NIFTI_UNITS.get(int(header["xyzt_units"]) & 7, "mm")))
    return from_nibabel(nibabel_image(path, mmap=False))[0], affine


_NIFTI1_BYTES = 348  # size of the header
_NIFTI_UNITS = {1: "meter", 3: "micron"}  # 2 is mm; 0 (unknown) is assumed to be mm


def has_place(path: Path) -> bool:
    """Return whether the header of a readable file defines the position of the voxels as well as their size."""
    name = path.name.lower()
    if name.endswith((".hdr", ".img")):
        header = path.with_suffix(".HDR" if path.suffix.isupper() else ".hdr").read_bytes()
        return header[344:348] == b"ni1\0" and any(header[252:256])
    if not name.endswith((".nii", ".nii.gz", ".mgh", ".mgz")):
        return True
    with _opened(path) as file:
        head: bytes = file.read(544)
    if name.endswith((".mgh", ".mgz")):
        return head[28:30] == b"\0\x01"  # goodRASFlag
    return any(head[344:352] if head[4:8] == b"n+2\0" else head[252:256])  # qform_code and sform_code


_NIFTI_BITS = {1: 1, 2: 8, 4: 16, 8: 32, 16: 32, 32: 64, 64: 64, 128: 24, 256: 8, 512: 16, 768: 32, 1024: 64}
_NIFTI_BITS |= {1280: 64, 1536: 128, 1792: 128, 2048: 256, 2304: 32}


def _nifti_header(head: bytes) -> np.void:
    """Return the fields of a NIfTI-1 header of either byte order."""
    for order in ("<", ">") if len(head) == _NIFTI1_BYTES else ():
        header: np.void = np.frombuffer(head, require("nibabel").nifti1.header_dtype.newbyteorder(order))[0]
        if header["sizeof_hdr"] == 348 and header["magic"] == b"n+1" and 1 <= header["dim"][0] <= 7:
            kind, bits = int(header["datatype"]), int(header["bitpix"])
            if _NIFTI_BITS.get(kind) != bits:
                raise InputError(f"its header is damaged: voxel type {kind} with {bits} bits does not exist. {AGAIN}")
            return header
    raise InputError("is not a NIfTI file, or its header is damaged. Check that its ending matches its format")


def _nifti_affine(header: np.void, shape: tuple[int, ...]) -> Affine:
    """Return the affine to RAS+ mm that nibabel would choose: from sform, otherwise qform, otherwise pixdim."""
    affine = np.eye(4)
    if header["sform_code"] != 0:
        affine[:3] = [header[f"srow_{axis}"] for axis in "xyz"]
        return affine
    sizes = header["pixdim"][1:4].astype(np.float64)
    if not (np.isfinite(sizes) & (sizes > 0)).all():
        raise InputError(f"has pixdim {sizes.tolist()}. Repair the header: use positive, finite sizes in mm")
    if header["qform_code"] != 0:
        sizes[2] *= -1 if header["pixdim"][0] == -1 else 1
        affine[:3, :3] = _rotation(np.array([header[f"quatern_{axis}"] for axis in "bcd"], np.float64)) * sizes
        affine[:3, 3] = [header[f"qoffset_{axis}"] for axis in "xyz"]
        return affine
    sizes[0] *= -1  # nibabel's default without a position: radiological order, origin at the centre
    affine[:3, :3] = np.diag(sizes)
    affine[:3, 3] = -sizes * (np.array(shape[:3]) - 1) / 2
    return affine


def _rotation(imaginary: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation of a unit quaternion with a non-negative real part, given its other three components."""
    b, c, d = imaginary
    square = 1 - imaginary @ imaginary
    if not square > -3 * np.finfo(np.float32).eps:
        raise InputError(f"has the qform quaternion {imaginary.tolist()}, whose norm exceeds 1. Repair the header")
    # a half turn, within the rounding of float32
    a = np.sqrt(square) if square >= 3 * np.finfo(np.float32).eps else 0.0
    return np.array(
        [
            [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
            [2 * (b * c + a * d), a * a + c * c - b * b - d * d, 2 * (c * d - a * b)],
            [2 * (b * d - a * c), 2 * (c * d + a * b), a * a + d * d - b * b - c * c],
        ]
    ) / (a * a + imaginary @ imaginary)


def _read_nrrd(path: Path) -> Read:
    with path.open("rb") as file:
        start = file.read(1 << 20).replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    head = start.partition(b"\n\n")[0]
    separate = [_beside(path, line) for line in re.findall(rb"(?mi)^data ?file:(.*)$", start)]
    lines = re.findall(rb"(?m)^(?:space )?units:(.*)$", head)
    units = {unit for line in lines for unit in re.findall(r'"([^"]*)"', line.decode("latin1"))}
    if len({millimetres(unit) for unit in units}) > 1:
        raise InputError(f"has axes with different units ({', '.join(sorted(units))}). Pass an array and a spacing")
    if spacings := re.search(rb"(?mi)^spacings:(.*nan.*)$", head):  # ITK would assume 1 mm
        raise InputError(f"has the spacings{spacings[1].decode('latin1')}. Pass an array and a spacing instead")
    return _by_itk(path, *separate, unit=units.pop() if units else "mm")


def _read_metaimage(path: Path) -> Read:
    with path.open("rb") as file:
        fields, start = _metaimage_header(file.read(_BLOCK))
    unit = fields.get(b"DistanceUnits", b"").decode("latin1")
    millimetres(unit)  # report an unknown unit before reading voxels
    named = fields[b"ElementDataFile"]
    separate = [] if named == b"LOCAL" else [_beside(path, named)]
    is_packed = fields.get(b"CompressedData", b"").lower() in (b"true", b"1")
    return _by_itk(path, *separate, unit=unit, packed_from=(0 if separate else start) if is_packed else None)


def _metaimage_header(start: bytes) -> tuple[dict[bytes, bytes], int]:
    """Return the fields of a MetaImage header as ITK finds them, and the offset of the voxels."""
    fields: dict[bytes, bytes] = {}
    position = 0
    while (end := start.find(b"\n", position)) >= 0:
        key, separator, value = start[position:end].partition(b"=")
        key, value, position = key.strip(), value.strip(), end + 1
        if not separator or key in fields or b":" in key:  # ITK ends a key there, too
            break
        fields[key] = value
        if key == b"ElementDataFile":
            return fields, position
    raise InputError("is not a MetaImage file, or its header is damaged. Check that its ending matches its format")


def _beside(path: Path, named: bytes) -> Path:
    """Return the voxel file that a header names, which must be in the header's directory or a subdirectory."""
    name = named.strip().decode("utf-8", "surrogateescape")
    if not name or "%" in name or name.split()[0] == "LIST":  # lists of files and printf formats are not supported
        raise InputError(f"stores its voxels in {name!r:.80} instead of one file. Write it as .mha, .nrrd or .nii.gz")
    return companion(path, name, "voxels")


def _check_deflated(path: Path, start: int, size: int) -> None:
    """Decompress the data to verify their checksum, because ITK returns incomplete data as if they were complete."""
    stream = zlib.decompressobj(wbits=47)  # zlib or gzip
    done = 0
    with path.open("rb") as file:
        file.seek(start)
        packed = file.read(_BLOCK)
        while packed and not stream.eof:
            done += len(stream.decompress(packed, _BLOCK))
            _check_beyond(done, size)
            packed = stream.unconsumed_tail or file.read(_BLOCK)
    if not stream.eof:
        raise InputError(f"its compressed data are incomplete. {AGAIN}")


def _opened(path: Path) -> Any:
    """Open a possibly gzipped file for reading bytes."""
    opener: Callable[..., Any] = gzip.open if path.suffix.lower() in (".gz", ".mgz") else open
    return opener(path, "rb")


def check_length(path: Path, needed: int) -> None:
    """Read a possibly gzipped file to its end to verify its checksum and its length."""
    size = 0
    with _opened(path) as file:
        while block := file.read(_BLOCK):
            size += len(block)
            _check_beyond(size, needed)
    if size < needed:
        raise InputError(f"ends after {size} of {needed} bytes. {AGAIN}")


def _check_beyond(size: int, needed: int) -> None:
    """Stop decompressing a file that is much longer than its header specifies."""
    if size > needed + _MOST_BEYOND:
        raise InputError(f"is longer than the {needed} bytes that its header specifies. {AGAIN}")


def from_nibabel(image: Any) -> Read:
    """Return the voxels and the affine of a nibabel image."""
    volume_shape(image.shape, np.dtype(np.uint8))
    unit = image.header.get_xyzt_units()[0] if hasattr(image.header, "get_xyzt_units") else "mm"
    millimetres(unit)  # report an unknown unit before reading voxels
    _check_proxy(image)
    voxels = np.asarray(image.dataobj)
    if voxels.dtype.names is not None:  # RGB24, RGBA32
        voxels = np.stack([voxels[name] for name in voxels.dtype.names], axis=-1)
    return voxels, check_affine(in_millimetres(check_affine(image.affine), unit))


def _check_proxy(image: Any) -> None:
    """Check that voxels that are still in their file fit into memory."""
    stored = image.dataobj
    if require("nibabel").is_proxy(stored):
        voxels = int(np.prod(image.shape, dtype=object))
        is_scaled = (getattr(stored, "slope", 1), getattr(stored, "inter", 0)) != (1, 0)  # to float64
        is_colour = stored.dtype.names is not None  # copy channel by channel
        check_room(voxels * (stored.dtype.itemsize * (2 if is_colour else 1) + (8 if is_scaled else 0)))


def from_itk(image: Any) -> Read:
    """Return the voxels and the affine of an ITK image, whose axes are (k, j, i) and whose world space is LPS."""
    itk = require("itk")
    view = as_array(itk.array_view_from_image(image))
    dimension = image.GetImageDimension()
    voxels = view.transpose(*reversed(range(dimension)), *range(dimension, view.ndim))
    if dimension != 3:
        return voxels, None  # not a volume, unless it is a NIfTI image with its own affine
    affine = np.eye(4)
    affine[:3, :3] = itk.array_from_matrix(image.GetDirection()) * np.array(image.GetSpacing())
    start = np.array(image.GetBufferedRegion().GetIndex())  # not 0 if the image is a region of another image
    affine[:3, 3] = np.array(image.GetOrigin()) + affine[:3, :3] @ start
    return voxels, LPS_TO_RAS @ affine


def _by_itk(path: Path, *separate: Path, unit: str, packed_from: int | None = None) -> Read:
    """Read an image whose voxels may be in another file, and may be compressed from a given offset onwards."""
    for file in separate:
        record_file(file)
    size = sum(file.stat().st_size for file in (path, *separate))
    packed = str((*separate, path)[0].absolute())
    voxels, affine = read_in_subprocess(_read_itk, "itk", path, packed, packed_from, size=size)
    return voxels, None if affine is None else in_millimetres(affine, unit)


def _read_itk(path: Path, packed: str = "", packed_from: int | None = None) -> Read:
    """Read an image with ITK in the child process."""
    size = _size_by_itk(path)
    check_room(size)
    if packed_from is not None:
        _check_deflated(Path(packed), packed_from, size)
    try:
        return from_itk(require("itk").imread(str(path)))
    except TypeError as error:  # 30 lines on templates; the first names the type
        remedy = f"Convert its values to one of {', '.join(ITK_TYPES)}"
        raise InputError(f"{str(error).splitlines()[0]} {remedy}") from error


def _size_by_itk(path: Path) -> int:
    """Return the size of the voxels in bytes according to the header of their file."""
    itk = require("itk")
    header = itk.ImageIOFactory.CreateImageIO(str(path), itk.CommonEnums.IOFileMode_ReadMode)
    if header is None:
        return 0  # ITK reports the reason when it reads
    header.SetFileName(str(path))
    header.ReadImageInformation()
    return int(header.GetImageSizeInBytes())


READERS: dict[str, Callable[[Path], Read]] = {
    **dict.fromkeys((".nii", ".nii.gz"), _read_nifti),
    **dict.fromkeys((".nrrd", ".nhdr"), _read_nrrd),
    **dict.fromkeys((".mha", ".mhd"), _read_metaimage),
    **dict.fromkeys((".mgh", ".mgz"), _read_by_nibabel),
    ".npy": lambda path: (read_array(path), None),
    ".npz": _read_npz,
    **dict.fromkeys((".hdr", ".img"), _read_pair),
}
