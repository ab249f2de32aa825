"""Flat images as files: PNG for people, TIFF and NIfTI for programs that measure, NumPy for the rest."""

from __future__ import annotations

import gzip
import json
import os
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from voxflat.errors import InputError
from voxflat.io.files import atomic_path, require, save_array
from voxflat.io.provenance import Record, as_text
from voxflat.io.volumes import write_volume
from voxflat.maps.colours import WINDOW, all_whole, label_colours, levels

__all__ = ["IMAGE_ENDINGS", "Image", "Stack", "write_image", "write_stack"]

_TIFF_DESCRIPTION, _TIFF_PAGE_NAME, _TIFF_CENTIMETRE = 270, 285, 3
_TIFF_LIMIT = 1 << 32  # bytes


def write_image(
    path: str | os.PathLike[str],
    data: NDArray[Any],
    affine: NDArray[np.float64],
    name: str,
    *,
    labels: bool,
    record: Record | None = None,
) -> None:
    """Write a flat image to a file, all of it or nothing; see `FlatImage.save`.

    Parameters
    ----------
    path : path
        Its ending says how.
    data, affine, name
        As in `FlatImage`.
    labels : bool
        Whether the values are labels.
    record : dict, optional
        What made it; ``.npy`` has no place for it.

    Raises
    ------
    InputError
        If the ending is another, or the values do not fit.
    OSError
        If the file cannot be written.
    """
    path = Path(path)
    write = next((write for ending, write in _WRITERS.items() if path.name.lower().endswith(ending)), None)
    if write is None:
        raise InputError(f"cannot write an image as {path.name}; give a name that ends in {', '.join(IMAGE_ENDINGS)}")
    write(path, data, affine, name, labels, record or {})


def _write_png(
    path: Path, data: NDArray[Any], affine: NDArray[np.float64], name: str, labels: bool, record: Record
) -> None:
    from PIL import Image, PngImagePlugin

    text = PngImagePlugin.PngInfo()
    if data.ndim == 3:
        pixels, values = data, "colours"
    elif labels:
        pixels, values = label_colours(data), "labels, each in a colour of its own"
    else:
        pixels, values = _grey(data)
    for key, value in {**_description(affine, name, record), "Values": values}.items():
        text.add_itxt(key, value)
    per_inch = 25.4 / affine[2, 2]  # stored as whole pixels per metre, hence the pixel size as text, too
    with atomic_path(path) as temporary:
        Image.fromarray(pixels).save(temporary, format="PNG", dpi=(per_inch, per_inch), pnginfo=text)


def _write_tiff(
    path: Path, data: NDArray[Any], affine: NDArray[np.float64], name: str, labels: bool, record: Record
) -> None:
    from PIL import Image, TiffImagePlugin

    tags = TiffImagePlugin.ImageFileDirectory_v2()
    tags[_TIFF_DESCRIPTION] = "; ".join(f"{key}: {value}" for key, value in _description(affine, name, record).items())
    per_cm = 10 / float(affine[2, 2])
    resolution = {"x_resolution": per_cm, "y_resolution": per_cm, "resolution_unit": _TIFF_CENTIMETRE}
    pixels = _measured(data)
    with atomic_path(path) as temporary:
        Image.fromarray(pixels).save(temporary, format="TIFF", tiffinfo=tags, **resolution)


def _write_nifti(
    path: Path, data: NDArray[Any], affine: NDArray[np.float64], name: str, labels: bool, record: Record
) -> None:
    write_volume(path, _measured(data)[:, :, None], affine, record)


def _write_npy(
    path: Path, data: NDArray[Any], affine: NDArray[np.float64], name: str, labels: bool, record: Record
) -> None:
    with atomic_path(path) as temporary:
        save_array(temporary, data)


_WRITERS: dict[str, Callable[[Path, NDArray[Any], NDArray[np.float64], str, bool, Record], None]] = {
    ".png": _write_png,
    ".tif": _write_tiff,
    ".tiff": _write_tiff,
    ".nii": _write_nifti,
    ".nii.gz": _write_nifti,
    ".npy": _write_npy,
}
IMAGE_ENDINGS = tuple(_WRITERS)
"""Endings of the files that `FlatImage.save` writes."""


# ------------------------------------------------------------------------------------------------ stacks


class Stack(Protocol):
    """Images on the same pixels, one after the other, as `FlatStack`."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of each image."""

    @property
    def layers(self) -> tuple[str, ...]:
        """Of the depths of each channel, where there are several."""

    def __len__(self) -> int:
        """Return the number of images."""

    def __getitem__(self, channel: int) -> Image:
        """Return an image."""


class Image(Protocol):
    """As `FlatImage`."""

    @property
    def data(self) -> NDArray[Any]:
        """Pixels."""

    @property
    def affine(self) -> NDArray[np.float64]:
        """From row and column to mm."""

    @property
    def name(self) -> str:
        """What it shows."""


def write_stack(path: str | os.PathLike[str], stack: Stack, record: Record | None = None) -> None:
    """Write images to one file, one after the other, all of them or nothing; see `FlatStack.save`.

    Parameters
    ----------
    path : path
        Its ending says how.
    stack : Stack
        Images of values; each is asked for once, when it is written.
    record : dict, optional
        What made them; ``.npy`` has no place for it.

    Raises
    ------
    InputError
        If the ending is another, the values do not fit, or it is too large for the format.
    OSError
        If the file cannot be written.
    """
    path, first = Path(path), stack[0]
    write = next((write for ending, write in _STACK_WRITERS.items() if path.name.lower().endswith(ending)), None)
    if write is None:
        endings = ", ".join(_STACK_WRITERS)
        listed = textwrap.shorten(", ".join(map(str, stack.names if any(stack.names) else range(len(stack)))), 300)
        raise InputError(
            f"{path.name} would hold one image, and there are {len(stack)} ({listed}): choose one by its name or "
            f"number (channel), or give a name that ends in {endings}"
        )
    if first.data.ndim != 2:
        raise InputError("colours are no channels: save them as one image")
    with atomic_path(path) as temporary:
        write(temporary, stack, first, record or {})


def _write_tiff_pages(path: Path, stack: Stack, first: Image, record: Record) -> None:
    from PIL import Image as Pillow
    from PIL import TiffImagePlugin

    if len(stack) * (first.data.size * 4 + 4096) > _TIFF_LIMIT:
        raise InputError(f"{len(stack)} images are more than the 4 GiB that a TIFF holds: use .nii or .npy")
    per_cm = 10 / float(first.affine[2, 2])
    resolution = {"x_resolution": per_cm, "y_resolution": per_cm, "resolution_unit": _TIFF_CENTIMETRE}
    with TiffImagePlugin.AppendingTiffWriter(str(path), True) as file:
        for n in range(len(stack)):
            image = stack[n]
            tags = TiffImagePlugin.ImageFileDirectory_v2()
            described = _description(image.affine, image.name, record if n == 0 else {})
            tags[_TIFF_DESCRIPTION] = "; ".join(f"{key}: {value}" for key, value in described.items())
            tags[_TIFF_PAGE_NAME] = stack.names[n] or str(n)
            Pillow.fromarray(_measured(image.data)).save(file, format="TIFF", tiffinfo=tags, **resolution)
            file.newFrame()


def _write_nifti_series(path: Path, stack: Stack, first: Image, record: Record) -> None:
    nibabel = require("nibabel")
    height, width = first.data.shape
    if max(height, width, len(stack)) > np.iinfo(np.int16).max:
        raise InputError(f"{len(stack)} images of {width} x {height} pixels are too many for NIfTI-1: use .npy")
    header = nibabel.Nifti1Header()
    header.set_data_dtype(np.float32)
    depths = max(1, len(stack.layers))
    header.set_data_shape((height, width, depths, len(stack) // depths))
    header.set_zooms((*[float(first.affine[2, 2])] * 3, 1.0))
    header.set_sform(first.affine, "scanner")
    header.set_qform(first.affine, "scanner")
    header.set_xyzt_units("mm")
    header["scl_slope"], header["scl_inter"] = 1, 0
    told: dict[str, Any] = {"names": list(stack.names)} if any(stack.names) else {}
    if record:
        told["provenance"] = record
    if told:
        header.extensions.append(nibabel.nifti1.Nifti1Extension("comment", json.dumps(told).encode()))
    is_packed = path.name.lower().endswith(".gz")
    with path.open("wb") as plain, gzip.GzipFile(fileobj=plain, mode="wb", mtime=0) if is_packed else plain as file:
        header.write_to(file)
        file.write(bytes(int(header["vox_offset"]) - file.tell()))
        for n in range(len(stack)):
            file.write(_measured(stack[n].data).astype("<f4").tobytes(order="F"))


def _write_npy_series(path: Path, stack: Stack, first: Image, record: Record) -> None:
    depths = len(stack.layers)
    shape = (len(stack) // depths, depths) if 0 < depths < len(stack) else (len(stack),)
    described = {"descr": "<f4", "fortran_order": False, "shape": (*shape, *first.data.shape)}
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, described)
        for n in range(len(stack)):
            file.write(_measured(stack[n].data).astype("<f4").tobytes())


_STACK_WRITERS: dict[str, Callable[[Path, Stack, Image, Record], None]] = {
    ".tif": _write_tiff_pages,
    ".tiff": _write_tiff_pages,
    ".nii": _write_nifti_series,
    ".nii.gz": _write_nifti_series,
    ".npy": _write_npy_series,
}


# ----------------------------------------------------------------------------------------------- helpers


def _description(affine: NDArray[np.float64], name: str, record: Record) -> dict[str, str]:
    u, v = affine[:2, 3]
    return {
        "Title": name,
        "Pixel size": f"{affine[2, 2]:.9g} mm",
        "Centre of the upper left pixel": f"u = {u:.9g} mm, v = {v:.9g} mm",
        "Software": "voxflat",
        "Provenance": as_text(record),
    }


def _grey(data: NDArray[Any]) -> tuple[NDArray[np.uint8], str]:
    """Return grey levels and opacity (H, W, 2), and what black and white mean."""
    inside = np.isfinite(data)
    level, (low, high) = levels(data, None)
    pixels = np.zeros((*data.shape, 2), dtype=np.uint8)
    pixels[inside, 0] = np.round(255 * level[inside])
    pixels[inside, 1] = 255
    return pixels, f"black {low:g}, white {high:g} ({WINDOW[0]}st and {WINDOW[1]}th percentile)"


def _measured(data: NDArray[Any]) -> NDArray[Any]:
    """Return colours as they are, and values as float32; labels must not change."""
    if data.ndim == 3:
        return data
    single = data.astype(np.float32)
    if all_whole(data) and not np.array_equal(single, data, equal_nan=True):
        largest = np.nanmax(np.abs(data))
        raise InputError(f"labels up to {largest:.0f} are too large for float32, which this format holds: use .npy")
    return single
