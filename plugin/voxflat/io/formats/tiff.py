"""Read TIFF stacks with tifffile: plain TIFF, ImageJ and OME-TIFF."""

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.errors import InputError
from voxflat.io.files import require
from voxflat.io.grid import Affine, millimetres
from voxflat.io.reading import check_room

_PAGES = "ZQI"  # tifffile's axes of pages: depth, or unspecified


def read_tiff(path: Path) -> tuple[NDArray[Any], Affine | None]:
    """Return a stack (x, y, z), with y pointing downwards, or colours (x, y, z, 3), and its affine to mm if known."""
    with require("tifffile").TiffFile(path) as file:
        series = file.series[0]
        shape = dict(zip(series.axes, series.shape, strict=True))
        check_room(2 * int(np.prod(series.shape, dtype=object)) * np.dtype(series.dtype).itemsize)
        pages = [axis for axis in series.axes if axis in _PAGES and shape[axis] > 1]
        others = [axis for axis in series.axes if axis not in "XYS" + _PAGES and shape[axis] > 1] + pages[1:]
        if others:
            found = ", ".join(f"{shape[axis]} along {axis}" for axis in others)
            raise InputError(f"contains more than one volume ({found}). Save one channel and one time point")
        data = series.asarray()
        sizes = _ome_sizes(file.ome_metadata) or _imagej_sizes(file, "Z" in shape or bool(pages))
    depth = pages[0] if pages else ""
    kept = [axis for axis in series.axes if axis in "XY" or axis == depth or (axis == "S" and shape["S"] in (3, 4))]
    data = data.reshape([shape[axis] for axis in kept])
    if not depth:
        kept, data = ["one", *kept], data[None]
    order = [kept.index(axis) for axis in ("X", "Y", depth or "one", "S") if axis in kept]
    return data.transpose(order), None if sizes is None else np.diag([*sizes, 1.0])


def _ome_sizes(text: str | None) -> list[float] | None:
    """Return voxel sizes along x, y, z in mm from OME-XML."""
    if not text:
        return None
    sizes: list[float] = []
    for axis in "XYZ":
        size = re.search(rf'\bPhysicalSize{axis}="([^"]+)"', text)
        unit = re.search(rf'\bPhysicalSize{axis}Unit="([^"]+)"', text)
        if size is not None:
            sizes.append(_size(size[1], unit[1] if unit else "µm"))
        elif axis == "Z":
            sizes.append(sizes[0])
        else:
            return None
    return sizes


def _imagej_sizes(file: Any, is_deep: bool) -> list[float] | None:
    """Return voxel sizes along x, y, z in mm from ImageJ tags."""
    told = file.imagej_metadata
    if not told or not told.get("unit") or told["unit"] in ("pixel", "pixels"):
        return None
    tags, unit = file.pages[0].tags, str(told["unit"]).encode().decode("unicode_escape")
    across = []
    for name in ("XResolution", "YResolution"):
        if name not in tags or not tags[name].value[0]:
            return None
        number, whole = tags[name].value
        across.append(_size(str(whole / number), unit))
    if is_deep and not told.get("spacing"):
        raise InputError("defines its pixel size, but not the distance between slices. Pass an array and a spacing")
    return [*across, _size(str(told.get("spacing", whole / number)), unit)]


def _size(text: str, unit: str) -> float:
    try:
        size = abs(float(text)) * millimetres(unit)
    except ValueError:
        size = 0.0
    if not 0 < size < np.inf:
        raise InputError(f"has an invalid voxel size ({text} {unit}). Pass an array and a spacing")
    return size
