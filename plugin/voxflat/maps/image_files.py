"""Flat images as files: PNG for people, TIFF and NIfTI for programs that measure, NumPy for the rest."""

from __future__ import annotations

import colorsys
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, PngImagePlugin, TiffImagePlugin

from voxflat.errors import InputError
from voxflat.io.volumes import atomic_path, write_volume

if TYPE_CHECKING:
    from voxflat.maps.raster import FlatImage

__all__ = ["ENDINGS", "are_labels", "coloured", "label_colours", "write_image"]

_WINDOW = (1, 99)  # percentiles shown as black and white
_GOLDEN_RATIO = 0.6180339887498949  # its multiples spread over the circle of hues as evenly as can be
_UNLABELLED = (208, 208, 208)
_TIFF_DESCRIPTION, _TIFF_CENTIMETRE = 270, 3


def write_image(image: FlatImage, path: str | os.PathLike[str]) -> None:
    """Write a flat image to a file, all of it or nothing.

    Parameters
    ----------
    image : FlatImage
        Scalars, labels or colours.
    path : path
        ``.png`` to look at: scalars in grey from the 1st to the 99th percentile, labels each in its own colour, colours
        as they are, transparent outside the map. ``.tif``, ``.tiff``, ``.nii`` or ``.nii.gz`` to measure: the values as
        float32, NaN outside the map, with the pixel size in mm. ``.npy``: the array as it is.

    Raises
    ------
    InputError
        If the ending is another, the values do not fit, or the file cannot be written.
    """
    path = Path(path)
    write = next((write for ending, write in _WRITERS.items() if path.name.lower().endswith(ending)), None)
    if write is None:
        raise InputError(f"cannot write an image as {path.name}; give a name that ends in {', '.join(ENDINGS)}")
    write(image, path)


def are_labels(image: FlatImage) -> bool:
    """Tell labels from intensities that happen to be whole numbers.

    Labels form areas: most pixels have the value of those some way off. Intensities, such as a T1 image's, do not.

    Parameters
    ----------
    image : FlatImage
        An image of any kind.

    Returns
    -------
    bool
    """
    if image.is_colour or not _all_whole(image.data):
        return False
    # more than a voxel (which covers two pixels if nothing else was asked for), less than an area
    step = max(3, max(image.data.shape) // 50)
    pairs = [(image.data[step:], image.data[:-step]), (image.data[:, step:], image.data[:, :-step])]
    equal = sum(int(np.count_nonzero(a == b)) for a, b in pairs)  # NaN, which is outside, equals nothing
    inside = sum(int(np.count_nonzero(np.isfinite(a) & np.isfinite(b))) for a, b in pairs)
    return 2 * equal >= inside


def coloured(
    image: FlatImage, colour_map: str | None = None, limits: Sequence[float] | None = None
) -> NDArray[np.uint8]:
    """Return an image's pixels as colours.

    Parameters
    ----------
    image : FlatImage
        Scalars, labels or colours.
    colour_map : str, optional
        A colour map of matplotlib for scalars; by default as in a PNG: grey, and for labels a colour each.
    limits : sequence of 2 floats, optional
        The values at the ends of the colour map; by default the 1st and 99th percentile.

    Returns
    -------
    ndarray of uint8, shape (H, W, 4)
        Opacity 0 outside the map.

    Raises
    ------
    InputError
        If there is no such colour map.
    """
    if image.is_colour:
        return image.data
    if colour_map is None and limits is None and are_labels(image):
        return label_colours(image.data)
    level, inside = _levels(image.data, limits)[0], np.isfinite(image.data)
    pixels = np.zeros((*level.shape, 4), dtype=np.uint8)
    pixels[inside] = _mapped(level[inside], colour_map)
    return pixels


def _mapped(level: NDArray[np.float64], colour_map: str | None) -> NDArray[np.uint8]:
    from matplotlib import colormaps

    try:
        return np.asarray(colormaps[colour_map or "gray"](level, bytes=True))
    except KeyError:
        raise InputError(f"matplotlib has no colour map {colour_map!r}") from None


# ----------------------------------------------------------------------------------------------- writers


def _write_png(image: FlatImage, path: Path) -> None:
    text = PngImagePlugin.PngInfo()
    if image.is_colour:
        pixels, values = image.data, "colours"
    elif are_labels(image):
        pixels, values = label_colours(image.data), "labels, each in a colour of its own"
    else:
        pixels, values = _grey(image.data)
    for key, value in {**_description(image), "Values": values}.items():
        text.add_itxt(key, value)
    per_inch = 25.4 / image.pixel_size  # stored as whole pixels per metre, hence the pixel size as text, too
    with atomic_path(path) as temporary:
        Image.fromarray(pixels).save(temporary, format="PNG", dpi=(per_inch, per_inch), pnginfo=text)


def _write_tiff(image: FlatImage, path: Path) -> None:
    pixels = image.data if image.is_colour else _single(image)
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    tags[_TIFF_DESCRIPTION] = "; ".join(f"{key}: {value}" for key, value in _description(image).items())
    per_cm = 10 / image.pixel_size
    resolution = {"x_resolution": per_cm, "y_resolution": per_cm, "resolution_unit": _TIFF_CENTIMETRE}
    with atomic_path(path) as temporary:
        Image.fromarray(pixels).save(temporary, format="TIFF", tiffinfo=tags, **resolution)


def _write_nifti(image: FlatImage, path: Path) -> None:
    pixels = image.data if image.is_colour else _single(image)
    write_volume(path, pixels[:, :, None], image.affine)


def _write_npy(image: FlatImage, path: Path) -> None:
    with atomic_path(path) as temporary:
        np.save(temporary, image.data, allow_pickle=False)


_WRITERS: dict[str, Callable[[FlatImage, Path], None]] = {
    ".png": _write_png,
    ".tif": _write_tiff,
    ".tiff": _write_tiff,
    ".nii": _write_nifti,
    ".nii.gz": _write_nifti,
    ".npy": _write_npy,
}
ENDINGS = tuple(_WRITERS)
"""Endings of the files that `write_image` writes."""


# ----------------------------------------------------------------------------------------------- helpers


def _description(image: FlatImage) -> dict[str, str]:
    u, v = image.origin
    return {
        "Title": image.name,
        "Pixel size": f"{image.pixel_size:.9g} mm",
        "Centre of the upper left pixel": f"u = {u:.9g} mm, v = {v:.9g} mm",
        "Software": "voxflat",
    }


def _grey(data: NDArray[Any]) -> tuple[NDArray[np.uint8], str]:
    """Return grey levels and opacity (H, W, 2), and what black and white mean."""
    inside = np.isfinite(data)
    level, (low, high) = _levels(data, None)
    pixels = np.zeros((*data.shape, 2), dtype=np.uint8)
    pixels[inside, 0] = np.round(255 * level[inside])
    pixels[inside, 1] = 255
    return pixels, f"black {low:g}, white {high:g} ({_WINDOW[0]}st and {_WINDOW[1]}th percentile)"


def _levels(data: NDArray[Any], limits: Sequence[float] | None) -> tuple[NDArray[np.float64], tuple[float, float]]:
    """Return values from 0 to 1 between limits, by default percentiles, and the limits."""
    inside = np.isfinite(data)
    if limits is not None:
        low, high = (float(limit) for limit in limits)
    else:
        low, high = np.percentile(data[inside], _WINDOW).tolist() if inside.any() else (0.0, 1.0)
    return np.clip((data - low) / ((high - low) or 1.0), 0, 1), (low, high)


def label_colours(data: NDArray[Any]) -> NDArray[np.uint8]:
    """Return a colour for every label (H, W, 4): the same in every image, and unlike its neighbours in number."""
    inside = np.isfinite(data)
    labels, which = np.unique(data[inside], return_inverse=True)
    pixels = np.zeros((*data.shape, 4), dtype=np.uint8)
    pixels[inside, :3] = np.array([_colour(int(label)) for label in labels], dtype=np.uint8).reshape(-1, 3)[which]
    pixels[inside, 3] = 255
    return pixels


def _colour(label: int) -> tuple[int, int, int]:
    if label == 0:
        return _UNLABELLED
    hue, saturation, value = label * _GOLDEN_RATIO % 1, (0.9, 0.55)[label % 2], (1.0, 0.8, 0.6)[label % 3]
    red, green, blue = colorsys.hsv_to_rgb(hue, saturation, value)
    return round(255 * red), round(255 * green), round(255 * blue)


def _all_whole(data: NDArray[Any]) -> bool:
    return bool(np.all((data == np.round(data)) | np.isnan(data)))


def _single(image: FlatImage) -> NDArray[np.float32]:
    """Return the values as float32; labels must not change."""
    single = image.data.astype(np.float32)
    if _all_whole(image.data) and not np.array_equal(single, image.data, equal_nan=True):
        largest = np.nanmax(np.abs(image.data))
        raise InputError(f"labels up to {largest:.0f} are too large for float32, which this format holds: use .npy")
    return single
