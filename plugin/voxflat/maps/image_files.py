"""Flat images as files: PNG for people, TIFF and NIfTI for programs that measure, NumPy for the rest."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.errors import InputError
from voxflat.io.files import atomic_path, save_array
from voxflat.io.provenance import Record, as_text
from voxflat.io.volumes import write_volume
from voxflat.maps.colours import WINDOW, all_whole, label_colours, levels

__all__ = ["IMAGE_ENDINGS", "write_image"]

_TIFF_DESCRIPTION, _TIFF_CENTIMETRE = 270, 3


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
