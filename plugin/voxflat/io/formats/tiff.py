"""Read TIFF stacks with tifffile: plain TIFF, ImageJ and OME-TIFF."""

import contextlib
import math
import re
import weakref
from dataclasses import dataclass
from functools import cached_property
from html import unescape
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import log
from voxflat.errors import InputError
from voxflat.io.files import AGAIN, require, retelling
from voxflat.io.formats.tiff_pages import check_companions, check_pages, check_series
from voxflat.io.grid import Affine, millimetres, unit_of

TIFF_ENDINGS = (".tif", ".tiff")

_NOT_LENGTHS = ("pixel", "pixels", "reference frame")  # units of sizes in OME and ImageJ that are not known
_PAGES = "ZQI"  # tifffile's axes of pages: depth, or unspecified


@dataclass(frozen=True, eq=False)
class TiffArray:
    """The pages of a TIFF file as one array, of which only the pages that are asked for are read."""

    path: Path
    shape: tuple[int, ...]
    dtype: np.dtype[Any]  # in native byte order
    chunks: tuple[int, ...]  # one page
    offset: int | None  # of the pixels in the file, if all pages follow each other without compression
    order: Literal["<", ">"]  # of the bytes

    def __getitem__(self, key: tuple[int | slice, ...]) -> NDArray[Any]:
        """Return a box, given one index, or a slice with both ends, for each axis."""
        count = next((n for n, size in enumerate(self.chunks) if size > 1), len(self.shape))
        leading, inner = key[:count], key[count:]
        spans = [range(one.start, one.stop) if isinstance(one, slice) else (one,) for one in leading]
        pages = [self._page(index)[inner] for index in product(*spans)]
        lengths = [len(each) for each, one in zip(spans, leading, strict=True) if isinstance(one, slice)]
        return np.stack(pages).reshape(*lengths, *pages[0].shape)

    def _page(self, index: tuple[int, ...]) -> NDArray[Any]:
        """Read one page."""
        number = int(np.ravel_multi_index(index, self.shape[: len(index)])) if index else 0
        shape = self.shape[len(index) :]
        if self.offset is None:
            if not index:
                return np.asarray(self._series.asarray()).reshape(shape)
            page = self._series.pages[number]
            with contextlib.ExitStack() as closing:  # tifffile closes all files of a series but the first
                if page.parent.filehandle.closed:
                    page.parent.filehandle.open()
                    closing.callback(page.parent.filehandle.close)
                return np.asarray(page.asarray()).reshape(shape)
        size = math.prod(shape)
        with self.path.open("rb") as file:
            file.seek(self.offset + number * size * self.dtype.itemsize)
            data = np.frombuffer(file.read(size * self.dtype.itemsize), self.dtype.newbyteorder(self.order))
        if len(data) < size:
            raise InputError(f"ends after {len(data)} of {size} pixels of page {number}. {AGAIN}")
        return data.reshape(shape).astype(self.dtype, copy=False)

    @cached_property
    def _series(self) -> Any:
        """The open file, which is closed with this object."""
        with retelling(self.path, "tifffile"):
            file = require("tifffile").TiffFile(self.path)
            weakref.finalize(self, file.close)
            return file.series[0]


@dataclass(frozen=True, eq=False)
class TiffStack:
    """The volumes of a TIFF file, which differ in channel or time."""

    array: TiffArray
    axes: tuple[tuple[str, int], ...]  # tifffile's name of each axis, and its length
    depth: str  # the axis of the pages of a volume, or "" for a single page
    names: tuple[str, ...]  # of the volumes
    affine: Affine | None  # voxel sizes that the file does not define are NaN
    unit: str  # of the affine

    @property
    def is_colour(self) -> bool:
        """Whether voxels have several samples."""
        return any(axis == "S" and _is_inside(axis, length, self.depth) for axis, length in self.axes)

    def at(self, number: int) -> tuple[tuple[int, ...], tuple[tuple[int, int], ...]]:
        """Return the axes x, y and z of a volume in the array, and its index along each of the other axes."""
        names = [axis for axis, _ in self.axes]
        others = [n for n, (axis, length) in enumerate(self.axes) if not _is_inside(axis, length, self.depth)]
        index = np.unravel_index(number, [self.axes[n][1] for n in others]) if others else ()
        inside = tuple(names.index(axis) for axis in ("X", "Y", self.depth) if axis)
        return inside, tuple(zip(others, map(int, index), strict=True))

    def read(self, number: int) -> NDArray[Any]:
        """Return a volume (x, y, z), with y pointing downwards, or colours (x, y, z, 3)."""
        fixed = dict(self.at(number)[1])
        key = tuple(fixed.get(n, slice(0, length)) for n, (_, length) in enumerate(self.axes))
        axes, data = [axis for n, (axis, _) in enumerate(self.axes) if n not in fixed], self.array[key]
        if not self.depth:
            axes, data = ["one", *axes], data[None]
        order = [axes.index(axis) for axis in ("X", "Y", self.depth or "one", "S") if axis in axes]
        return np.asarray(data.transpose(order))


def open_tiff(path: Path) -> TiffStack:
    """Read the axes of a TIFF file, the names of its channels and the size of its voxels."""
    check_pages(path)
    messages: list[str] = []  # passed on only if the file is read
    with retelling(path, "tifffile", messages.append), require("tifffile").TiffFile(path) as file:
        values = check_companions(path, file.ome_metadata)
        series = file.series[0]
        check_series(file, values)
        if len(file.series) > 1:
            messages.append(_other_images(file.series))
        axes = tuple(zip(series.axes, map(int, series.shape), strict=True))
        array = _array(path, file)
        pages = [axis for axis, length in axes if axis in _PAGES and length > 1]
        if len(pages) > 1:
            shape = " x ".join(str(length) for _, length in axes)
            raise InputError(f"does not name its axes ({shape}). Save it as OME-TIFF, or pass an array (x, y, z)")
        depth = pages[0] if pages else ""
        affine, unit = _ome_place(file.ome_metadata, bool(pages)) or _imagej_place(file, bool(pages)) or (None, "mm")
        titles = [unescape(name) for name in re.findall(r'<Channel [^>]*\bName="([^"]*)"', file.ome_metadata or "")]
    for message in messages:
        log.warning("%s: %s", path, message)
    others = [(axis, n) for axis, n in axes if not _is_inside(axis, n, depth)]
    if not depth and (several := [f"{n} along {axis}" for axis, n in others if n > 1]):
        remedy = "If these are slices, save them as slices (in Fiji: Image → Properties), or pass an array (x, y, z)"
        raise InputError(f"has one slice and several images ({', '.join(several)}). {remedy}")
    names = []
    for index in np.ndindex(*(n for _, n in others)):
        each = [(axis, place) for (axis, n), place in zip(others, index, strict=True) if n > 1]
        is_named = len(titles) == dict(axes).get("C")
        names.append(" ".join(titles[n] if axis == "C" and is_named else f"{axis.lower()}{n}" for axis, n in each))
    return TiffStack(array, axes, depth, tuple(names), affine, unit)


def _other_images(series: Any) -> str:
    """Return a message about the pictures after the first image; raise an error if these are slices or stacks."""
    sizes = [" x ".join(str(length) for length in page.shape[::-1]) for page in series]
    names = [f"{page.name!r:.60} ({size})" if page.name else size for page, size in zip(series, sizes, strict=True)]
    content = f"contains {len(series)} images ({', '.join(names[:5])}{', ...' * (len(names) > 5)})"
    if len(series[0]) == 1 or any(len(page) > 1 for page in series[1:]):
        raise InputError(f"{content}. Save one image, or all slices as one stack, to a file of its own")
    return f"{content}. Only the first one, a stack, is read"


def _array(path: Path, file: Any) -> TiffArray:
    """Return the first series of a file as an array in chunks of one page, or in one chunk if its pages differ."""
    series = file.series[0]
    shape, page = tuple(map(int, series.shape)), math.prod(series.keyframe.shape)
    count = next((n for n in range(len(shape)) if math.prod(shape[n:]) == page), 0)
    offset = None if series.is_multifile else series.dataoffset
    is_paged = offset is not None or len(series.pages) == math.prod(shape[:count])
    chunks = (1,) * count + shape[count:] if is_paged else shape
    dtype = np.dtype(series.dtype).newbyteorder("=")
    return TiffArray(path, shape, dtype, chunks, offset, file.byteorder)


def _is_inside(axis: str, length: int, depth: str) -> bool:
    """Return whether an axis belongs to a volume, and does not count volumes."""
    return axis in "XY" or axis == depth or (axis == "S" and length in (3, 4))


def _ome_place(text: str | None, is_deep: bool) -> tuple[Affine, str] | None:
    """Return the affine and its unit from OME-XML, if it defines the size of voxels."""
    sizes = {}
    for axis in "XYZ" if text else "":
        size = re.search(rf'\bPhysicalSize{axis}="([^"]*)"', text or "")
        unit = re.search(rf'\bPhysicalSize{axis}Unit="([^"]+)"', text or "")
        named = unescape(unit[1]) if unit else "µm"
        if size is not None and named not in _NOT_LENGTHS:
            sizes[axis] = (size[1], named)
    if not sizes:
        return None
    if not is_deep:
        sizes.setdefault("Z", sizes.get("X", ("", "µm")))
    if negative := [size for size, _ in sizes.values() if size.strip().startswith("-")]:
        raise InputError(f"has an invalid voxel size ({negative[0]}). Pass an array and a spacing")
    return _place([sizes.get(axis) for axis in "XYZ"])


def _imagej_place(file: Any, is_deep: bool) -> tuple[Affine, str] | None:
    """Return the affine and its unit from ImageJ tags, if they define the size of voxels."""
    header = file.imagej_metadata
    if not header or not header.get("unit") or header["unit"] in _NOT_LENGTHS:
        return None
    tags, unit = file.pages[0].tags, str(header["unit"]).encode().decode("unicode_escape")
    across = []
    for name in ("XResolution", "YResolution"):
        if name not in tags or not tags[name].value[0]:
            return None
        number, whole = tags[name].value
        across.append(str(whole / number))
    along = header.get("spacing") or (None if is_deep else across[0])
    return _place([None if size is None else (str(size), unit) for size in (*across, along)])


def _place(sizes: list[tuple[str, str] | None]) -> tuple[Affine, str]:
    """Return the affine of voxels with the given sizes, in the unit of the first; unknown sizes become NaN."""
    unit = next(symbol for _, symbol in filter(None, sizes))
    millimetres(unit)  # raises an error that names the file's unit
    unit = unit_of(unit) or "mm"
    lengths = []
    for size in sizes:
        if size is None:
            lengths.append(math.nan)
            continue
        text, name = size
        factor = millimetres(name) / millimetres(unit)
        try:
            length = abs(float(text)) * factor
        except ValueError:
            length = 0.0
        if not 0 < length < np.inf:
            raise InputError(f"has an invalid voxel size ({text} {name}). Pass an array and a spacing")
        lengths.append(length)
    return np.diag([*lengths, 1.0]), unit
