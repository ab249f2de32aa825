"""Colours of scalars and labels: the same in files, on pages, in textures and in 3-D."""

import colorsys
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import numbers_of, shown
from voxflat.errors import InputError

WINDOW = (1, 99)  # percentiles at the ends of a colour map

_GOLDEN_RATIO = 0.6180339887498949  # its multiples are evenly spread over the circle of hues
_UNLABELLED = (208, 208, 208)


def are_labels(data: NDArray[Any]) -> bool:
    """Return whether an image shows labels, whole numbers that form areas; pixels outside the map are NaN."""
    if data.ndim == 3 or not all_whole(data):
        return False
    # larger than a voxel (two pixels by default), smaller than an area
    step = max(3, max(data.shape) // 50)
    pairs = [(data[step:], data[:-step]), (data[:, step:], data[:, :-step])]
    equal = sum(int(np.count_nonzero(a == b)) for a, b in pairs)  # NaN (outside the map) equals nothing
    inside = sum(int(np.count_nonzero(np.isfinite(a) & np.isfinite(b))) for a, b in pairs)
    return 2 * equal >= inside


def coloured(
    data: NDArray[Any], colour_map: str | None = None, limits: Sequence[float] | None = None, *, labels: bool
) -> NDArray[np.uint8]:
    """Return an image as RGBA, transparent outside the map; by default, scalars are grey (1st to 99th percentile)."""
    if data.ndim == 3:
        return data
    if colour_map is None and limits is None and labels:
        return label_colours(data)
    from matplotlib import colormaps

    level, inside = levels(data, limits)[0], np.isfinite(data)
    pixels = np.zeros((*level.shape, 4), dtype=np.uint8)
    try:
        pixels[inside] = colormaps[colour_map or "gray"](level[inside], bytes=True)
    except (KeyError, TypeError, ValueError):  # TypeError or ValueError if this is not a valid name
        raise InputError(f"colour_map is {shown(colour_map)}. Pass the name of a Matplotlib colour map") from None
    return pixels


def levels(data: NDArray[Any], limits: Sequence[float] | None) -> tuple[NDArray[np.float64], tuple[float, float]]:
    """Return values scaled from 0 to 1 between limits, and the limits, which are percentiles by default."""
    inside = np.isfinite(data)
    if limits is not None:
        between = numbers_of(limits, "limits")
        if between.shape != (2,):
            raise InputError(f"limits is {shown(limits)}. Pass two numbers")
        low, high = between.tolist()
    else:
        low, high = np.percentile(data[inside], WINDOW).tolist() if inside.any() else (0.0, 1.0)
    return np.clip((data - low) / ((high - low) or 1.0), 0, 1), (low, high)


def passing(data: NDArray[Any], above: float | None = None, below: float | None = None) -> NDArray[np.bool_]:
    """Return which values lie above one threshold and below another; or beyond either if `below` < `above`."""
    with np.errstate(invalid="ignore"):
        higher = data > above if above is not None else np.isfinite(data)
        lower = data < below if below is not None else np.isfinite(data)
    two_sided = above is not None and below is not None and below < above
    return np.asarray((higher | lower) if two_sided else (higher & lower))


def label_colours(data: NDArray[Any]) -> NDArray[np.uint8]:
    """Return a colour for every label (H, W, 4), the same in every image; consecutive labels have distinct colours."""
    inside = np.isfinite(data)
    labels, which = np.unique(data[inside], return_inverse=True)
    pixels = np.zeros((*data.shape, 4), dtype=np.uint8)
    pixels[inside, :3] = np.array([label_colour(int(label)) for label in labels], dtype=np.uint8).reshape(-1, 3)[which]
    pixels[inside, 3] = 255
    return pixels


def label_colour(label: int) -> tuple[int, int, int]:
    """Return the default colour of a label: red, green, blue from 0 to 255."""
    if label == 0:
        return _UNLABELLED
    hue, saturation, value = label * _GOLDEN_RATIO % 1, (0.9, 0.55)[label % 2], (1.0, 0.8, 0.6)[label % 3]
    red, green, blue = colorsys.hsv_to_rgb(hue, saturation, value)
    return round(255 * red), round(255 * green), round(255 * blue)


def all_whole(data: NDArray[Any]) -> bool:
    """Return whether all values are whole numbers or NaN."""
    with np.errstate(invalid="ignore"):  # signalling NaN
        return bool(np.all((data == np.round(data)) | np.isnan(data)))
