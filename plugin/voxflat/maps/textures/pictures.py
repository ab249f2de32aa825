"""Pictures: files, arrays and images as colours, their position on a map, and interpolation between texels.

A texture coordinate (s, t) is a position in a picture: (0, 0) is the lower left corner, and (1, 1) is the upper right.
The pixels of a picture (texels) are squares on the map, so that only flattening distorts them.
"""

import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import array_of, is_number, shown
from voxflat.errors import InputError
from voxflat.io.files import REMEDY, check_regular, naming, retelling
from voxflat.io.reading import check_room, record_file
from voxflat.io.subprocess_reader import read_in_subprocess
from voxflat.maps.sampling import interpolated

PICTURES = ("PNG", "JPEG", "TIFF", "BMP")
"""Formats that Pillow may open. By default it also opens PostScript, for which it runs a program."""

_PIXEL_BYTES = 24  # memory for decoding a pixel: as decoded by Pillow, rotated upright, as colours, and as an array
_SLACK = 1e-9  # share of a picture's side by which rounding may move a point across the border


def place(uv: NDArray[np.float64], shape: tuple[int, ...], texel_size: float | None = None) -> NDArray[np.float64]:
    """Return texture coordinates for a picture centred on a map; by default, the picture just covers the map."""
    size = np.array([shape[1], shape[0]], dtype=np.float64)
    low, high = uv.min(axis=0), uv.max(axis=0)
    if texel_size is None:
        texel_size = float(np.max((high - low) / size)) or 1.0
    if not (is_number(texel_size) and 0 < texel_size < np.inf):
        raise InputError(f"texel_size is {shown(texel_size)} mm. Pass a positive number")
    return np.asarray(0.5 + (uv - (low + high) / 2) / (texel_size * size))


def check_cover(coordinates: NDArray[np.float64], shape: tuple[int, ...], texel_size: float) -> None:
    """Raise an error if a picture does not cover the whole map."""
    needed = 2 * float(np.abs(coordinates - 0.5).max())
    if needed > 1 + _SLACK:
        height, width = shape[0] * texel_size, shape[1] * texel_size
        raise InputError(
            f"with texels of {texel_size:g} mm, the picture is {width:g} x {height:g} mm and does not cover the map. "
            f"Pass repeat=True, or a texel size of at least {needed * texel_size * (1 + 1e-6):.6g} mm"
        )


def values_at(picture: NDArray[Any], coordinates: NDArray[np.float64], repeat: bool = False) -> NDArray[np.float64]:
    """Interpolate a picture between texel centres; beyond its borders, repeat the picture or its border values."""
    height, width = picture.shape[:2]
    index = [(1 - coordinates[..., 1]) * height - 0.5, coordinates[..., 0] * width - 0.5]
    values = picture.view(np.uint8) if picture.dtype.kind == "b" else picture
    mode = "grid-wrap" if repeat else "nearest"
    if values.ndim == 2:
        return interpolated(values, index, mode=mode)
    return np.stack([interpolated(channel, index, mode=mode) for channel in np.moveaxis(values, 2, 0)], axis=-1)


def check_values(picture: object) -> NDArray[Any]:
    """Return an array of numbers of shape (H, W) or (H, W, C) as a picture."""
    array = array_of(picture, "values of the picture")
    if array.ndim not in (2, 3) or 0 in array.shape or array.dtype.kind not in "buif":
        problem = f"the picture has shape {array.shape} and data type {array.dtype}"
        raise InputError(f"{problem}. Pass a numeric array of shape (H, W) or (H, W, C)")
    return array


def as_picture(picture: object) -> tuple[NDArray[np.uint8], Path | None]:
    """Return a file, Pillow image or array (uint8, bool or floats up to 1) as colours (H, W, 3 or 4), and its path."""
    if isinstance(picture, str | os.PathLike):
        path = Path(picture)
        with naming(path, REMEDY), header(path) as image:
            return decoded(path, image, colours=True), path
    if hasattr(picture, "getbands") and hasattr(picture, "convert"):
        return _of_pillow(picture), None
    return _of_array(check_values(picture)), None


@contextmanager
def header(path: Path) -> Iterator[Any]:
    """Open a picture to read its header; no pixels are decoded."""
    from PIL import Image

    check_regular(path)
    with warnings.catch_warnings(), retelling(path, "PIL.TiffImagePlugin"):
        warnings.simplefilter("ignore")  # Pillow warns about damaged tags that are not needed
        with Image.open(path, formats=PICTURES) as image:
            record_file(path)
            yield image


def decoded(path: Path, image: Any, colours: bool = False) -> NDArray[Any]:
    """Decode a picture, as colours or raw values, in another process, because Pillow's C code trusts the file."""
    need = _PIXEL_BYTES * image.width * image.height
    check_room(need)
    return np.asarray(read_in_subprocess(picture_values, "PIL", path, colours, size=need))


def picture_values(path: Path, colours: bool) -> NDArray[Any]:
    """Decode a picture in the process that `decoded` starts."""
    from PIL import Image

    with warnings.catch_warnings(), Image.open(path, formats=PICTURES) as image:
        warnings.simplefilter("ignore")
        return _of_pillow(image) if colours else np.asarray(image)


def _of_pillow(image: Any) -> NDArray[np.uint8]:
    from PIL import ImageOps

    image = ImageOps.exif_transpose(image)  # photographs may be rotated
    if image.mode.startswith("I;16"):
        return _of_array(((np.asarray(image).astype(np.uint32) + 128) // 257).astype(np.uint8))  # 65,535 is 257 x 255
    if image.mode in ("I", "F"):
        problem = f"the picture has more than 8 bits per value (Pillow mode {image.mode})"
        raise InputError(f"{problem}. Save it as 8-bit grey or RGB")
    has_alpha = "A" in image.getbands() or "transparency" in image.info
    return np.asarray(image.convert("RGBA" if has_alpha else "RGB"))


def _of_array(array: NDArray[Any]) -> NDArray[np.uint8]:
    if array.ndim == 3 and array.shape[2] not in (3, 4):
        raise InputError(f"the picture has shape {array.shape}. Pass an array of shape (H, W), (H, W, 3) or (H, W, 4)")
    if array.dtype.kind == "b":
        array = np.uint8(255) * array
    elif array.dtype.kind == "f":
        least, most = float(array.min()), float(array.max())  # NaN if there is one
        if not (least >= 0 and most <= 1):
            raise InputError(
                f"the picture's values range from {least:g} to {most:g}. Scale floats to the range 0 to 1 (no NaN), or "
                "pass uint8 values"
            )
        array = np.round(255 * array).astype(np.uint8)
    elif array.dtype != np.uint8:
        raise InputError(f"the picture has data type {array.dtype}. Pass uint8 (0 to 255), or floats from 0 to 1")
    return np.ascontiguousarray(np.repeat(array[..., None], 3, axis=2) if array.ndim == 2 else array)
