"""Read and write volumes, which consist of voxels indexed as (i, j, k) and an affine to RAS+ mm.

`read_volume` reads a file, `write_volume` writes one, and `voxflat.io.sources` also accepts objects. All of them create
a `Volume`, which checks its data once.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat.arguments import array_of, checked_path, shown
from voxflat.errors import InputError
from voxflat.io.chunks import Chunked, chunked_of, is_chunked, is_stack_path
from voxflat.io.files import REMEDY, atomic_path, by_ending, naming, require, save_array
from voxflat.io.formats.hdf5 import HDF5_ENDINGS
from voxflat.io.formats.tiff import TIFF_ENDINGS
from voxflat.io.grid import Affine, check_affine, is_incomplete, named_unit, scaled, volume_shape
from voxflat.io.provenance import Record, Recorded, as_text, record_of
from voxflat.io.readers import ITK_TYPES, LPS_TO_RAS, READERS, read
from voxflat.io.reading import reading

_Write: TypeAlias = Callable[[Path, "Volume", Record | None, str], None]  # the last one is the unit: mm or unknown

VOLUME_ENDINGS = (*READERS, *TIFF_ENDINGS, *HDF5_ENDINGS)
"""Endings of the names of volume files."""

_TIFF_LIMIT = 2**32 - 2**20  # bytes of values

_CHECK = "check that this format can hold it"


@dataclass(frozen=True, eq=False)
class Volume(Recorded):
    """Store voxels and their position in space.

    Creating a volume checks its arrays; an invalid array or affine raises an `InputError`.

    Parameters
    ----------
    data : ndarray, shape (I, J, K), or (I, J, K, 3) or (I, J, K, 4) for uint8 colours, or (I, J, K, 3) for vectors
        Values in native byte order, indexed as (i, j, k), as in nibabel.
    affine : ndarray, shape (4, 4), float64
        Affine from voxel indices (i, j, k, 1) to RAS+ positions in `unit`; integer indices refer to voxel centres.
    path : Path or None
        The file that the volume was read from.
    is_placed : bool
        Whether an affine was given; if not, the affine is the identity, or has NaN for a voxel size that the file does
        not define.
    provenance : dict or None
        Record of how voxflat created the volume; None if it did not.
    unit : {"mm", "µm", "nm", "cm", "m", "inch"}
        Unit of length of the affine.
    is_vectors : bool
        Whether the values are vectors, whose components point right, anterior and superior.

    See Also
    --------
    read_volume : Read a volume from a file.
    as_volume : Return anything that contains voxels as a volume.

    Examples
    --------
    >>> volume = voxflat.io.Volume(voxflat.samples.ball(), np.diag([0.5, 0.5, 0.5, 1]))
    >>> volume
    <Volume: 24 x 24 x 24 of uint8, voxels of 0.5 x 0.5 x 0.5 mm, RAS>
    """

    data: NDArray[np.number]
    affine: Affine
    path: Path | None = None
    is_placed: bool = True
    provenance: Record | None = None
    unit: str = "mm"
    is_vectors: bool = False

    def __repr__(self) -> str:
        name = "" if self.path is None else f" {self.path.name}"
        shape, spacing = (" x ".join(f"{n:.4g}" for n in sizes) for sizes in (self.data.shape, self.spacing))
        return f"<Volume{name}: {shape} of {self.data.dtype}, voxels of {spacing} {self.unit}, {self.orientation}>"

    def __post_init__(self) -> None:
        object.__setattr__(self, "data", _check_data(self.data, self.is_vectors))
        if self.is_placed or not is_incomplete(self.affine):
            object.__setattr__(self, "affine", check_affine(self.affine))
        object.__setattr__(self, "unit", named_unit(self.unit))

    @classmethod
    def _placed(
        cls, data: NDArray[Any], affine: NDArray[Any] | None, unit: str = "mm", path: Path | None = None
    ) -> "Volume":
        """Return voxels with their affine, or with the identity if there is none."""
        is_placed = affine is not None and not is_incomplete(affine)
        return cls(data, np.eye(4) if affine is None else affine, path, is_placed=is_placed, unit=unit)

    def in_unit(self, unit: str) -> "Volume":
        """Return the same voxels with their affine in another unit of length.

        Voxels without an affine are not changed.

        Parameters
        ----------
        unit : {"mm", "µm", "nm", "cm", "m", "inch"}
            The unit of length.

        Returns
        -------
        Volume
            The volume, whose voxels are not copied.

        Raises
        ------
        InputError
            The unit is unknown.

        Examples
        --------
        >>> voxflat.io.Volume(voxflat.samples.ball(), np.diag([0.5, 0.5, 0.5, 1])).in_unit("µm")
        <Volume: 24 x 24 x 24 of uint8, voxels of 500 x 500 x 500 µm, RAS>
        """
        unit = named_unit(unit)
        if unit == self.unit or not self.is_placed:
            return self
        return replace(self, affine=scaled(self.affine, self.unit, unit), unit=unit)

    @property
    def spacing(self) -> Affine:
        """Distance between the centres of neighbouring voxels along i, j, k, in the unit of the volume.

        The array has shape (3,).
        """
        return np.asarray(np.linalg.norm(self.affine[:3, :3], axis=0))

    @property
    def orientation(self) -> str:
        """Directions of the axes, such as ``'RAS'``.

        Each axis has one letter from R/L, A/P or S/I: the direction in which its index increases.
        """
        cosines = self.affine[:3, :3] / self.spacing
        codes = [""] * 3
        # best-aligned index first, so that directions are unique
        for index in np.argsort(-np.abs(cosines).max(axis=0), kind="stable"):
            world = int(np.abs(cosines[:, index]).argmax())
            codes[index] = ("LR", "PA", "IS")[world][int(cosines[world, index] > 0)]
            cosines[world] = 0
        return "".join(codes)


def read_volume(path: str | os.PathLike[str], channel: int | str | None = None) -> Volume:
    """Read a volume from a file.

    The affine of arrays without one is the identity, which corresponds to voxels of 1 mm. TIFF and OME-Zarr files keep
    their unit of length, for example µm; lengths in other files are converted to mm.

    Parameters
    ----------
    path : path
        ``.nii``, ``.nii.gz``, ``.nrrd``, ``.nhdr``, ``.mha``, ``.mhd``, ``.mgh``, ``.mgz``, ``.npy``, ``.npz`` with one
        array, or with ``data`` and optionally ``affine``, ``.tif``, ``.tiff``, ``.h5`` or ``.hdf5`` of ilastik, or an
        OME-Zarr directory.
    channel : int or str, optional
        Number (from 0) or name of the channel to read from a TIFF, HDF5 or OME-Zarr file with several channels or time
        points, such as 1, "nuclei" or "t0 c1". By default, the only one.

    Returns
    -------
    Volume
        Voxels (I, J, K) and their affine to RAS+ positions.

    Raises
    ------
    InputError
        The file is damaged, is in another format, has several channels of which none is chosen, or has a sheared affine
        or an unknown unit.

    See Also
    --------
    write_volume : Write a volume to a file.

    Examples
    --------
    >>> voxflat.io.write_volume("labels.npz", voxflat.samples.ball(), np.eye(4))
    >>> voxflat.io.read_volume("labels.npz")
    <Volume labels.npz: 24 x 24 x 24 of uint8, voxels of 1 x 1 x 1 mm, RAS>
    """
    path = checked_path(path)
    with naming(path, REMEDY), reading() as files:
        volume = volume_of_file(path, channel)
    if channel is None:
        return volume
    return volume._with_provenance(record_of("read_volume", {"path": str(path), "channel": channel}, files))


def volume_of_file(path: str | os.PathLike[str], channel: int | str | None = None) -> Volume:
    """Read a volume; errors do not name the file."""
    chunked = chunked_of(path) if is_stack_path(path) else None
    if chunked is not None:
        channels, affine, unit = chunked
        if channel is None and len(channels) > 1:
            several = f"has {len(channels)} channels or time points ({channels.listed()})"
            raise InputError(f"{several}. Choose one, as in voxflat.io.read_volume(path, channel=0)")
        data: Any = channels.read(channels.find(channel))
        return Volume._placed(data.whole() if isinstance(data, Chunked) else data, affine, unit, Path(path))
    if channel not in (None, 0, "0"):
        raise InputError(f"channel is {shown(channel)}, but only TIFF, HDF5 and OME-Zarr files have channels. Omit it")
    return Volume._placed(*read(Path(path)), path=Path(path))


def write_volume(
    path: str | os.PathLike[str],
    data: ArrayLike,
    affine: ArrayLike,
    record: Record | None = None,
    *,
    has_unit: bool = True,
    is_vectors: bool = False,
) -> None:
    """Write a volume to a file.

    The file is written completely or not at all.

    Parameters
    ----------
    path : path
        ``.nii``, ``.nii.gz``, ``.nrrd``, ``.mha``, ``.mgh``, ``.mgz``, ``.npz``, or ``.npy``, which cannot hold an
        affine other than the identity, or ``.tif`` or ``.tiff``, which hold the size of the voxels, but neither their
        origin nor their directions.
    data : array_like, shape (I, J, K), or (I, J, K, 3|4) uint8 for colours, or (I, J, K, 3) for vectors
        Values; the type is kept, except that bool becomes uint8 in image formats.
    affine : array_like, shape (4, 4)
        Affine from voxel indices to RAS+ mm.
    record : dict, optional
        Provenance record, stored in a NIfTI header as an extension with code 6 (comment). Other formats cannot hold it.
    has_unit : bool
        Whether the affine maps to mm; if it does not, a NIfTI header marks the unit as unknown, and a TIFF file has no
        unit.
    is_vectors : bool
        Whether the values are vectors.

    Raises
    ------
    InputError
        The format cannot hold the volume.

    See Also
    --------
    read_volume : Read a volume from a file.

    Examples
    --------
    >>> voxflat.io.write_volume("ball.nii.gz", voxflat.samples.ball(), np.eye(4))
    """
    path = checked_path(path)
    write = check_volume_name(path)
    with atomic_path(path) as temporary, naming(path, _CHECK):
        volume = Volume(array_of(data, "values"), check_affine(affine), is_vectors=is_vectors)
        write(temporary, volume, record, "mm" if has_unit else "unknown")


def check_volume_name(path: Path) -> _Write:
    """Return the writer for a file name; raise an error if no volume format matches."""
    with naming(path, _CHECK):
        return by_ending(path, _WRITERS, ". The formats .mhd and .nhdr consist of two files and cannot be written")


def _check_data(data: NDArray[Any], is_vectors: bool) -> NDArray[Any]:
    """Check type and shape, drop trailing axes of length 1, and convert to native byte order; keep chunked arrays."""
    if isinstance(data, Chunked) or is_chunked(data):
        return data
    data = array_of(data, "values")
    if data.dtype.kind not in "biuf":
        raise InputError(f"values have data type {data.dtype}. Convert them to bool, integer or float")
    shape = data.shape if is_vectors else volume_shape(data.shape, data.dtype)
    if is_vectors and (len(shape) != 4 or shape[3] != 3):
        raise InputError(f"has shape {shape}. Pass vectors of shape (I, J, K, 3)")
    data = data if data.shape == shape else data.reshape(shape)
    return data.astype(data.dtype.newbyteorder("="), copy=False)


def _write_npy(path: Path, volume: Volume, *_: object) -> None:
    if not np.array_equal(volume.affine, np.eye(4)):
        raise InputError("a .npy file cannot hold an affine. Use .npz or an image format")
    save_array(path, volume.data)


def _write_mgh(path: Path, volume: Volume, *_: object) -> None:
    nibabel = require("nibabel")
    data = _storable(volume.data)
    if data.ndim != 3 and not volume.is_vectors:
        raise InputError("an MGH file cannot hold colours. Use .nii.gz or .nrrd")
    nibabel.save(nibabel.MGHImage(data, volume.affine), path)


def _write_nifti(path: Path, volume: Volume, record: Record | None, unit: str) -> None:
    nibabel = require("nibabel")
    data = _storable(volume.data)
    if data.ndim == 4 and not volume.is_vectors:
        colour = np.dtype([(name, "u1") for name in "RGBA"[: data.shape[3]]])
        data = np.ascontiguousarray(data).view(colour)[..., 0]
    if max(data.shape) > np.iinfo(np.int16).max:  # nibabel would write a file that only FreeSurfer can read
        raise InputError(f"shape {data.shape} is too large for NIfTI-1. Use .nrrd or .npz")
    image = nibabel.Nifti1Image(data, volume.affine, dtype=data.dtype)
    image.set_sform(volume.affine, "scanner")
    image.set_qform(volume.affine, "scanner")
    image.header.set_xyzt_units(unit)
    if record is not None:
        image.header.extensions.append(nibabel.nifti1.Nifti1Extension("comment", as_text(record).encode()))
    nibabel.save(image, path)


def _write_itk(path: Path, volume: Volume, *_: object) -> None:
    itk = require("itk")
    data = _storable(volume.data)
    is_colour = data.ndim == 4 and not volume.is_vectors
    if is_colour and path.suffix.lower() == ".mha":
        raise InputError("a MetaImage cannot mark its channels as colours. Use .nii.gz or .nrrd")
    if data.dtype.name not in ITK_TYPES:
        raise InputError(f"ITK cannot write the type {data.dtype}. Convert the values to one of {', '.join(ITK_TYPES)}")
    kji = np.ascontiguousarray(data.transpose(2, 1, 0, *range(3, data.ndim)))
    pixel = {3: itk.RGBPixel, 4: itk.RGBAPixel}.get(data.shape[3] if is_colour else 0)
    image = itk.image_view_from_array(kji, volume.is_vectors, ttype=pixel and itk.Image[pixel[itk.UC], 3])
    lps = LPS_TO_RAS @ volume.affine
    image.SetSpacing(volume.spacing.tolist())
    image.SetOrigin(lps[:3, 3].tolist())
    image.SetDirection(itk.matrix_from_array(np.ascontiguousarray(lps[:3, :3] / volume.spacing)))
    itk.imwrite(image, str(path), compression=True)


def _write_tiff(path: Path, volume: Volume, _: Record | None, unit: str) -> None:
    """Write a stack with the axes z, y, x, as `read_volume`, Fiji and napari read it."""
    order = np.abs(volume.affine[:3, :3]).argmax(axis=1).tolist()
    place, spacing = volume.affine[:, [*order, 3]], volume.spacing[order]
    if not np.allclose(place, np.diag([*spacing, 1.0]), rtol=0, atol=1e-6 * spacing.min()):
        raise InputError("a TIFF file cannot hold the origin and the directions of the voxels. Use .nii.gz")
    data = _storable(volume.data)
    if data.ndim != 3 or data.nbytes > _TIFF_LIMIT:
        raise InputError("a TIFF file can hold neither colours, nor vectors, nor more than 4 GiB. Use .nii.gz")
    if data.dtype.kind in "iu":
        low, high = int(data.min()), int(data.max())
        if not 0 <= low <= high <= np.iinfo(np.uint16).max:
            raise InputError(f"a TIFF stack holds integers from 0 to 65535, not from {low} to {high}. Use .nii.gz")
        data = data if data.dtype == np.uint8 else data.astype(np.uint16)
    elif data.dtype != np.float32:
        raise InputError(f"a TIFF stack cannot hold the type {data.dtype}. Convert the values to float32")
    x, y, z = spacing.tolist()
    has_size = unit == "mm" or (x, y, z) != (1, 1, 1)  # other sizes without a unit are in mm
    size: dict[str, Any] = {"unit": "mm", "spacing": z} if has_size else {}
    about: dict[str, Any] = {"metadata": {"axes": "ZYX", **size}, **({"resolution": (1 / x, 1 / y)} if size else {})}
    require("tifffile").imwrite(path, np.ascontiguousarray(data.transpose(order).T), imagej=True, **about)


def _storable(data: NDArray[Any]) -> NDArray[Any]:
    """Convert types that image formats do not support to the next type that preserves their values."""
    wider = {"bool": np.uint8, "float16": np.float32}.get(data.dtype.name)
    return data if wider is None else data.astype(wider)


_WRITERS: dict[str, _Write] = {
    **dict.fromkeys((".nii", ".nii.gz"), _write_nifti),
    **dict.fromkeys((".nrrd", ".mha"), _write_itk),
    **dict.fromkeys((".mgh", ".mgz"), _write_mgh),
    **dict.fromkeys(TIFF_ENDINGS, _write_tiff),
    ".npy": _write_npy,
    ".npz": lambda path, volume, *_: np.savez_compressed(path, data=volume.data, affine=volume.affine),
}
