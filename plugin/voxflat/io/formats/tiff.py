"""Read TIFF stacks with tifffile: plain TIFF, ImageJ and OME-TIFF."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.errors import InputError
from voxflat.io.files import require
from voxflat.io.grid import Affine, millimetres, named_unit
from voxflat.io.reading import check_room

TIFF_ENDINGS = (".tif", ".tiff")

_PAGES = "ZQI"  # tifffile's axes of pages: depth, or unspecified


@dataclass(frozen=True, eq=False)
class TiffStack:
    """The volumes of a TIFF file, which differ in channel or time."""

    path: Path
    axes: tuple[tuple[str, int], ...]  # tifffile's name of each axis, and its length
    depth: str  # the axis of the pages of a volume, or "" for a single page
    names: tuple[str, ...]  # of the volumes
    affine: Affine | None
    unit: str  # of the affine

    def read(self, number: int) -> NDArray[Any]:
        """Return a volume (x, y, z), with y pointing downwards, or colours (x, y, z, 3)."""
        with require("tifffile").TiffFile(self.path) as file:
            data = file.series[0].asarray().reshape([length for _, length in self.axes])
        others = [n for n, (axis, length) in enumerate(self.axes) if not _is_inside(axis, length, self.depth)]
        kept = [axis for axis, length in self.axes if _is_inside(axis, length, self.depth)]
        data = np.moveaxis(data, others, range(len(others)))
        data = data.reshape(-1, *data.shape[len(others) :])[number]
        if not self.depth:
            kept, data = ["one", *kept], data[None]
        order = [kept.index(axis) for axis in ("X", "Y", self.depth or "one", "S") if axis in kept]
        return np.asarray(data.transpose(order))


def open_tiff(path: Path) -> TiffStack:
    """Read the axes of a TIFF file, the names of its channels and the size of its voxels."""
    with require("tifffile").TiffFile(path) as file:
        series = file.series[0]
        axes = tuple(zip(series.axes, map(int, series.shape), strict=True))
        check_room(2 * int(np.prod(series.shape, dtype=object)) * np.dtype(series.dtype).itemsize)
        pages = [axis for axis, length in axes if axis in _PAGES and length > 1]
        if len(pages) > 1:
            shape = " x ".join(str(length) for _, length in axes)
            raise InputError(f"does not name its axes ({shape}). Save it as OME-TIFF, or pass an array (x, y, z)")
        depth = pages[0] if pages else ""
        affine, unit = _ome_place(file.ome_metadata) or _imagej_place(file, bool(pages)) or (None, "mm")
        titles = re.findall(r'<Channel [^>]*\bName="([^"]*)"', file.ome_metadata or "")
    others = [(axis, n) for axis, n in axes if not _is_inside(axis, n, depth)]
    if not depth and (several := [f"{n} along {axis}" for axis, n in others if n > 1]):
        remedy = "If these are slices, save them as slices (in Fiji: Image → Properties), or pass an array (x, y, z)"
        raise InputError(f"has one slice and several images ({', '.join(several)}). {remedy}")
    names = []
    for index in np.ndindex(*(n for _, n in others)):
        each = [(axis, at) for (axis, n), at in zip(others, index, strict=True) if n > 1]
        is_named = len(titles) == dict(axes).get("C")
        names.append(" ".join(titles[at] if axis == "C" and is_named else f"{axis.lower()}{at}" for axis, at in each))
    return TiffStack(path, axes, depth, tuple(names), affine, unit)


def _is_inside(axis: str, length: int, depth: str) -> bool:
    """Return whether an axis belongs to a volume, and does not count volumes."""
    return axis in "XY" or axis == depth or (axis == "S" and length in (3, 4))


def _ome_place(text: str | None) -> tuple[Affine, str] | None:
    """Return the affine and its unit from OME-XML, if it defines the size of voxels."""
    sizes: list[tuple[str, str]] = []
    for axis in "XYZ" if text else "":
        size = re.search(rf'\bPhysicalSize{axis}="([^"]+)"', text or "")
        unit = re.search(rf'\bPhysicalSize{axis}Unit="([^"]+)"', text or "")
        if size is not None:
            sizes.append((size[1], unit[1] if unit else "µm"))
        elif axis == "Z" and sizes:
            sizes.append(sizes[0])
        else:
            return None
    return _place(sizes) if sizes else None


def _imagej_place(file: Any, is_deep: bool) -> tuple[Affine, str] | None:
    """Return the affine and its unit from ImageJ tags, if they define the size of voxels."""
    told = file.imagej_metadata
    if not told or not told.get("unit") or told["unit"] in ("pixel", "pixels"):
        return None
    tags, unit = file.pages[0].tags, str(told["unit"]).encode().decode("unicode_escape")
    across = []
    for name in ("XResolution", "YResolution"):
        if name not in tags or not tags[name].value[0]:
            return None
        number, whole = tags[name].value
        across.append(str(whole / number))
    if is_deep and not told.get("spacing"):
        raise InputError("defines its pixel size, but not the distance between slices. Pass an array and a spacing")
    return _place([(size, unit) for size in (*across, str(told.get("spacing", across[0])))])


def _place(sizes: list[tuple[str, str]]) -> tuple[Affine, str]:
    """Return the affine of voxels with the given sizes, in the unit of the first."""
    unit = named_unit(sizes[0][1]) if sizes[0][1].strip() else "mm"
    lengths = []
    for text, own in sizes:
        factor = millimetres(own) / millimetres(unit)
        try:
            length = abs(float(text)) * factor
        except ValueError:
            length = 0.0
        if not 0 < length < np.inf:
            raise InputError(f"has an invalid voxel size ({text} {own}). Pass an array and a spacing")
        lengths.append(length)
    return np.diag([*lengths, 1.0]), unit
