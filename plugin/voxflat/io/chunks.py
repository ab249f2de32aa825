"""Read volumes larger than memory in chunks (dask, zarr, OME-Zarr, HDF5, TIFF); each required chunk is read once."""

import json
import math
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import amount, log, shown
from voxflat.errors import InputError
from voxflat.io.channels import Channels
from voxflat.io.files import AGAIN, REMEDY, check_regular, naming, require, within
from voxflat.io.formats.hdf5 import HDF5_ENDINGS, hdf5_block, open_hdf5
from voxflat.io.formats.tiff import TIFF_ENDINGS, open_tiff
from voxflat.io.grid import LONG_NAMES, Affine, check_axes, millimetres
from voxflat.io.reading import check_room, record_file
from voxflat.io.subprocess_reader import read_in_subprocess

PLACE_BYTES = 360
"""Bytes of memory per sampled position (a pixel at one depth), in addition to one chunk at a time."""

_WHOLE = 1 << 28
"""Largest size in bytes of a volume in a TIFF file that is read at once."""

_INFLATED = {True: 1 << 21, False: 1 << 16}  # above the largest compression ratio of a chunk: with bzip2, with zstd
_CALLED = "channel"  # what messages call a volume in a stack
_CHANNEL_BYTES = 1000  # bytes of memory per channel before any voxel is read

_HEADERS = ("zarr.json", ".zattrs", ".zarray", ".zgroup")

_UNITS = {**{name: (unit, 1.0) for unit, name in LONG_NAMES.items()}, "angstrom": ("nm", 0.1)}  # lengths in a unit
_ENDS = (("left", "right"), ("posterior", "anterior"), ("inferior", "superior"))  # of the axes of RAS
_ORIENTED = {f"{low}-to-{high}": (axis, 1) for axis, (low, high) in enumerate(_ENDS)}  # RFC-4: axis and direction
_ORIENTED |= {f"{high}-to-{low}": (axis, -1) for axis, (low, high) in enumerate(_ENDS)}


class _Grid:
    """Store the sizes of the chunks along an axis, given as one size for all chunks or as a list of sizes."""

    def __init__(self, length: int, sizes: Any) -> None:
        self._length = length
        self._size = None if isinstance(sizes, tuple | list) else int(sizes)
        self._edges = np.cumsum([0, *sizes]).astype(np.int64) if self._size is None else np.zeros(0, np.int64)
        self.count = len(self._edges) - 1 if self._size is None else -(-length // self._size)

    def number(self, index: NDArray[np.integer[Any]]) -> NDArray[np.integer[Any]]:
        """Return the numbers of the chunks that contain the given indices."""
        if self._size is None:
            return np.searchsorted(self._edges, index, side="right") - 1
        return index // self._size

    def span(self, number: int) -> tuple[int, int]:
        """Return the first index of a chunk and the index after the last one."""
        if self._size is None:
            return int(self._edges[number]), min(int(self._edges[number + 1]), self._length)
        return number * self._size, min((number + 1) * self._size, self._length)


@dataclass(frozen=True, eq=False)
class Chunked:
    """Represent three axes of a chunked array as a volume, indexed as (i, j, k)."""

    array: Any  # has shape, dtype, chunks and slices
    axes: tuple[int, int, int] = (0, 1, 2)  # axes of the array for i, j and k
    fixed: tuple[tuple[int, int], ...] = ()  # other axes, and the index used for each
    ndim = 3
    made_of: Callable[[NDArray[Any]], NDArray[Any]] | None = None  # converts the values that are read
    path: Path | None = None  # named in error messages, because the file is read later

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of voxels along each of i, j and k."""
        return tuple(int(self.array.shape[axis]) for axis in self.axes)

    def whole(self) -> NDArray[Any]:
        """Read all voxels."""
        check_room(2 * math.prod(self.shape) * self.dtype.itemsize)
        return self.block([(0, length) for length in self.shape])

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the values."""
        stored: np.dtype[Any] = np.dtype(self.array.dtype)
        return stored if self.made_of is None else self.made_of(np.zeros(0, stored)).dtype

    @property
    def grids(self) -> list[_Grid]:
        """The chunks along each of i, j and k."""
        return [_Grid(length, self.array.chunks[axis]) for axis, length in zip(self.axes, self.shape, strict=True)]

    def chunk_of(self, voxels: NDArray[np.integer[Any]]) -> NDArray[np.integer[Any]]:
        """Return the number of the chunk that contains each voxel, given by its indices (P, 3)."""
        number = np.zeros(len(voxels), dtype=np.int64)
        for axis, grid in enumerate(self.grids):
            number *= grid.count
            number += grid.number(voxels[:, axis])
        return number

    def block(self, spans: list[tuple[int, int]]) -> NDArray[Any]:
        """Read a box of voxels, given the first index and the index after the last one along each of i, j and k."""
        place: list[Any] = [slice(None)] * len(self.array.shape)
        for axis, span in zip(self.axes, spans, strict=True):
            place[axis] = slice(*span)
        for axis, index in self.fixed:
            place[axis] = index
        with naming(self.path or type(self.array).__name__, REMEDY):
            read = np.asarray(self.array[tuple(place)])  # the remaining axes keep their order
        if self.made_of is not None:
            read = self.made_of(read)
        order = np.argsort(np.argsort(self.axes))
        return np.transpose(read, order)


@dataclass(frozen=True, eq=False)
class _StoredArray:
    """Represent an array in a Zarr directory or an HDF5 file, which C code decompresses in a child process."""

    path: Path
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    chunks: tuple[int, ...]
    package: str
    read: Callable[..., NDArray[Any]]  # reads a box in the child process
    name: tuple[str, ...] = ()  # of the dataset in a file

    def __getitem__(self, key: tuple[int | slice, ...]) -> NDArray[Any]:
        box = [[part.start, part.stop] if isinstance(part, slice) else part for part in key]
        size = self.dtype.itemsize
        for index, length in zip(box, self.chunks, strict=True):  # all of each chunk is decompressed
            first, last = (index[0], index[1] - 1) if isinstance(index, list) else (index, index)
            size *= (last // length - first // length + 1) * length
        limits: dict[str, Any] = {"size": size, "inflated": 2}
        block: NDArray[Any] = read_in_subprocess(self.read, self.package, self.path, box, *self.name, **limits)
        return block


def zarr_block(path: Path, box: list[int | list[int]]) -> NDArray[Any]:
    """Read a box from an array in a Zarr directory, given one index, or a start and an end index, for each axis."""
    array = require("zarr").open_array(str(path), mode="r")
    _check_blosc()
    return np.asarray(array[tuple(slice(*part) if isinstance(part, list) else part for part in box)])


@cache
def _check_blosc() -> None:
    """Refuse truncated chunks in this process, the child: Blosc reads beyond their end, and returns other values."""
    blosc: Any = require("numcodecs.blosc")
    decode = blosc.Blosc.decode

    def checked(self: Any, buf: Any, out: Any = None) -> Any:
        size, need = memoryview(buf).nbytes, int.from_bytes(bytes(memoryview(buf)[12:16]), "little")
        if size < max(need, 16):
            raise InputError(f"contains a chunk that ends after {size} of {max(need, 16)} bytes. {AGAIN}")
        return decode(self, buf, out)

    blosc.Blosc.decode = checked


def is_chunked(obj: object) -> bool:
    """Return whether an object is a chunked array, which is not held completely in memory."""
    named = all(hasattr(obj, name) for name in ("shape", "dtype", "chunks", "__getitem__"))
    return named and not isinstance(obj, np.ndarray) and bool(getattr(obj, "chunks", None))


def is_zarr_path(obj: object) -> bool:
    """Return whether an object is the path to a Zarr directory."""
    if not isinstance(obj, str | os.PathLike):
        return False
    path = Path(obj)
    return path.is_dir() and any((path / name).exists() for name in _HEADERS)


def is_stack_path(obj: object) -> bool:
    """Return whether an object is the path to a microscopy stack: a TIFF or HDF5 file, or a Zarr directory."""
    is_path = isinstance(obj, str | os.PathLike)
    return is_zarr_path(obj) or (is_path and str(obj).lower().endswith((*TIFF_ENDINGS, *HDF5_ENDINGS)))


def voxels_at(data: Any, low: NDArray[np.integer[Any]], offsets: NDArray[np.integer[Any]]) -> NDArray[Any]:
    """Return the voxels (P, K) at `low` (P, 3) plus `offsets` (K, 3), clipped to the volume; read each chunk once."""
    last = np.asarray(data.shape[:3], dtype=low.dtype) - 1
    voxels = np.empty((len(low), len(offsets)), dtype=data.dtype)
    if not isinstance(data, Chunked):
        for n, offset in enumerate(offsets):
            voxels[:, n] = data[tuple(np.minimum(low + offset, last).T)]
        return voxels
    grids = data.grids
    counts = [grid.count for grid in grids]
    chunk = np.empty(voxels.shape, dtype=np.int32 if math.prod(counts) < 2**31 else np.int64)
    for n, offset in enumerate(offsets):
        chunk[:, n] = data.chunk_of(np.minimum(low + offset, last))
    order = np.argsort(chunk.ravel(), kind="stable")
    values, first = voxels.reshape(-1), 0
    numbers, sizes = np.unique(chunk, return_counts=True)
    for number, size in zip(numbers.tolist(), sizes.tolist(), strict=True):
        items = order[first : first + size]
        first += size
        spans = [grid.span(int(n)) for grid, n in zip(grids, np.unravel_index(number, counts), strict=True)]
        block = data.block(spans)
        rows, columns = np.divmod(items, len(offsets))
        index = np.minimum(low[rows] + offsets[columns], last) - [span[0] for span in spans]
        values[items] = block[tuple(index.T)]
    return voxels


def chunked_of(obj: object) -> tuple[Channels, Affine | None, str] | None:
    """Return the channels, affine and unit of a chunked array or stack file, or None for other input."""
    if is_zarr_path(obj):
        return _ome_zarr(Path(str(obj)))
    if is_stack_path(obj):
        path = Path(str(obj))
        return _hdf5(path) if path.name.lower().endswith(HDF5_ENDINGS) else _tiff(path)
    if not is_chunked(obj):
        return None
    array: Any = obj
    _check(array, array.chunks)
    if len(array.shape) == 3:
        each: list[Any] = [Chunked(array)]
        return Channels(("",), each.__getitem__), None, "mm"
    if len(array.shape) == 4:
        check_room(_CHANNEL_BYTES * array.shape[3])
        each = [Chunked(array, fixed=((3, n),)) for n in range(array.shape[3])]
        return Channels(("",) * len(each), each.__getitem__), None, "mm"
    raise InputError(f"has shape {tuple(array.shape)}. Pass an array of shape (I, J, K) or (I, J, K, C)")


def _check(array: Any, chunks: Any) -> None:
    if np.dtype(array.dtype).kind not in "biuf":
        raise InputError(f"has values of type {array.dtype}. Convert them to bool, integer or float")
    if 0 in array.shape or 0 in chunks:
        raise InputError(f"is empty (shape {tuple(array.shape)}, chunks {tuple(chunks)}). Pass an array with voxels")
    check_axes(tuple(array.shape))
    count = math.prod(_Grid(length, size).count for length, size in zip(array.shape, chunks, strict=True))
    if count >= 2**63:
        raise InputError(f"has {count} chunks, more than a 64-bit integer can count. Write it again with larger chunks")
    largest = math.prod(max(size) if isinstance(size, tuple | list) else int(size) for size in chunks)
    check_room(2 * largest * np.dtype(array.dtype).itemsize)


def _tiff(path: Path) -> tuple[Channels, Affine | None, str]:
    """Open a TIFF stack; volumes that are small are read completely, and others in chunks of one page."""
    check_regular(path)
    stack = open_tiff(path)
    record_file(path)
    voxels = math.prod(length for n, (_, length) in enumerate(stack.axes) if n not in dict(stack.at(0)[1]))
    size = voxels * stack.array.dtype.itemsize
    is_large = size > _WHOLE and len(stack.at(0)[0]) == 3 and not stack.is_colour
    if is_large:
        _check(stack.array, stack.array.chunks)

    def read(n: int) -> Any:
        if not is_large:
            check_room(2 * size)
            return stack.read(n)
        (x, y, z), fixed = stack.at(n)
        return Chunked(stack.array, (x, y, z), fixed, path=path)

    return Channels(stack.names, read, called=_CALLED).of_file(path), stack.affine, stack.unit


def _hdf5(path: Path) -> tuple[Channels, None, str]:
    """Open the stack in an HDF5 file, which does not define the size of voxels."""
    check_regular(path)
    stack = open_hdf5(path)
    record_file(path)
    options: dict[str, Any] = {"package": "h5py", "read": hdf5_block, "name": (stack.name,)}
    array = _StoredArray(path, stack.shape, stack.dtype, stack.chunks, **options)
    _check(array, array.chunks)
    _check_stored(path, *stack.stored)
    return _channels(array, stack.axes, path), None, "mm"


def _channels(array: Any, names: Sequence[str], path: Path, labels: Sequence[str] = ()) -> Channels:
    """Return the volumes of an array, which differ along all axes other than x, y and z.

    `labels` are the names of the channels, the axis c.
    """
    x, y, z = (names.index(axis) for axis in "xyz")
    others = [axis for axis in range(len(names)) if axis not in (x, y, z)]
    check_room(_CHANNEL_BYTES * math.prod(array.shape[axis] for axis in others))
    each: list[Any] = []
    titles = []
    for number in np.ndindex(*(array.shape[axis] for axis in others)):
        fixed = tuple(zip(others, map(int, number), strict=True))
        each.append(Chunked(array, (x, y, z), fixed, path=path))
        labelled = names.index("c") if "c" in names and len(labels) == array.shape[names.index("c")] else None
        parts = [
            labels[n] if axis == labelled else f"{names[axis]}{n}"
            for axis, n in fixed
            if array.shape[axis] > 1 or axis == labelled
        ]
        titles.append(" ".join(parts))
    return Channels(tuple(titles), each.__getitem__, called=_CALLED)


def _ome_zarr(path: Path) -> tuple[Channels, Affine, str]:
    """Open the finest image of an OME-Zarr directory, or the image within it that the path selects."""
    zarr = require("zarr")
    wanted = None
    image, about, labels = _multiscales(path)
    if image is None:
        image, about, labels = _multiscales(path.parent)
        wanted = path.name
    if image is None or about is None:
        raise InputError("has no multiscales metadata, which define its position. Pass an array and an affine")
    record_file(about)
    sets = image.get("datasets") or []
    dataset = next((entry for entry in sets if wanted is None or entry.get("path") == wanted), None)
    if dataset is None:
        raise InputError(f"has no image {wanted!r}. Choose one of {', '.join(str(e.get('path')) for e in sets)}")
    file = within(path if wanted is None else path.parent, str(dataset.get("path")), "image")
    for name in _HEADERS:
        if (file / name).exists():
            check_regular(file / name)
    opened = zarr.open_array(str(file), mode="r")
    shape, chunks = tuple(map(int, opened.shape)), tuple(map(int, opened.chunks))
    array = _StoredArray(file, shape, np.dtype(opened.dtype), chunks, "zarr", zarr_block)
    axes = image.get("axes") or [{"name": name} for name in "tczyx"[-len(array.shape) :]]
    axes = [axis if isinstance(axis, dict) else {"name": axis} for axis in axes]
    names = [str(axis.get("name")) for axis in axes]
    if len(names) != len(array.shape) or not {"x", "y", "z"} <= set(names):
        raise InputError(f"has shape {tuple(array.shape)} and the axes {', '.join(names)}. Provide the axes x, y and z")
    _check(array, array.chunks)
    _check_stored(path, *_zarr_chunks(file, opened))
    scale, shift = _scale_and_shift(dataset, image, len(names))
    spatial = tuple(names.index(axis) for axis in "xyz")
    affine = np.zeros((4, 4))
    affine[3, 3] = 1
    units = [str(axes[axis].get("unit", "millimeter")) for axis in spatial]
    for axis, named in zip(spatial, units, strict=True):
        if named not in _UNITS:
            raise InputError(f"has an axis {names[axis]} with the unit {named}. Use one of {', '.join(_UNITS)}")
    unit = _UNITS[units[0]][0]
    for column, axis in enumerate(spatial):
        symbol, length = _UNITS[units[column]]
        length *= millimetres(symbol) / millimetres(unit)
        orientation = axes[axis].get("orientation") or {}
        value = orientation.get("value") if isinstance(orientation, dict) else None
        row, sign = _ORIENTED.get(str(value), (column, 1))
        affine[row, column] = sign * scale[axis] * length
        affine[row, 3] = sign * shift[axis] * length
    if abs(np.linalg.det(affine)) == 0:
        raise InputError("has a singular affine: an axis has no extent, or two axes are parallel. Correct its metadata")
    return _channels(array, names, path, labels), affine, unit


def _scale_and_shift(
    image: dict[str, Any], around: dict[str, Any], axes: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the scale and the translation of an image along each axis."""
    scale, shift = np.ones(axes), np.zeros(axes)
    steps = [*(image.get("coordinateTransformations") or []), *(around.get("coordinateTransformations") or [])]
    if not any(step.get("type") == "scale" for step in steps):
        raise InputError("does not define its scale, the size of its voxels. Pass an array and an affine")
    with np.errstate(invalid="ignore", over="ignore"):  # checked below
        for step in steps:
            kind = step.get("type")
            if kind not in ("scale", "translation", "identity"):
                raise InputError(f"has the transformation {shown(kind)}. Use only scale and translation")
            if kind == "identity":
                continue
            numbers = step.get(kind)
            if (
                not isinstance(numbers, list)
                or len(numbers) != axes
                or any(type(n) not in (int, float) for n in numbers)
            ):
                raise InputError(f"has the {kind} {shown(numbers)}. Use one number for each of its {axes} axes")
            if kind == "scale" and min(numbers) <= 0:
                raise InputError(f"has the scale {numbers}. Use positive numbers, and orientation for reversed axes")
            scale = scale * numbers if kind == "scale" else scale
            shift = shift * numbers if kind == "scale" else shift + numbers
    if not (np.isfinite(scale).all() and np.isfinite(shift).all()):
        raise InputError(f"has scale {scale.tolist()} and translation {shift.tolist()}. Use finite numbers")
    return scale, shift


def _zarr_chunks(path: Path, array: Any) -> tuple[int, int, int, int]:
    """Return the numbers of stored and of all files of a Zarr array, the size of a chunk, and the most a file can hold.

    Sizes are in bytes. The file of a chunk, or of a shard, is called 1/2/3 or 1.2.3, after c/ or c. in version 3.
    """
    each = getattr(array, "shards", None) or array.chunks
    counts, stored, largest = [-(-n // size) for n, size in zip(array.shape, each, strict=True)], 0, 0
    for folder, _, names in os.walk(path):
        for name in names:
            place = re.split(r"[./]", (Path(folder) / name).relative_to(path).as_posix())
            place = place[1:] if place[0] == "c" else place
            if len(place) == len(counts) and all(map(str.isdecimal, place)):
                stored += all(int(n) < count for n, count in zip(place, counts, strict=True))
                largest = max(largest, (Path(folder) / name).stat().st_size)
    ratio = _INFLATED["bz2" in str(array.metadata).lower()]
    return stored, math.prod(counts), math.prod(array.chunks) * np.dtype(array.dtype).itemsize, ratio * largest


def _check_stored(path: Path, stored: int, count: int, size: int, most: int) -> None:
    """Check that a file can contain its chunks; report missing ones, which have the fill value by definition."""
    if not stored:
        raise InputError(f"contains none of its {count} chunks. {AGAIN}")
    if size > most:
        raise InputError(f"has chunks of {amount(size)}, more than its files can contain. {AGAIN}")
    if stored < count:
        text = "%s: %d of %d chunks (%.2g %%) are not stored. Their voxels have the fill value, usually 0, as in "
        text += "chunks that a program left out because they are empty. If the image was copied, copy it again"
        log.warning(text, path, count - stored, count, 100 * (count - stored) / count)


def _multiscales(path: Path) -> tuple[dict[str, Any] | None, Path | None, tuple[str, ...]]:
    """Return the first multiscales entry in the metadata of a Zarr group, the file that contains it, and channels."""
    for name in ("zarr.json", ".zattrs"):
        file = path / name
        if not file.is_file():
            continue
        try:
            content = json.loads(file.read_text(encoding="utf-8"))  # accepts NaN, which some programs write
            attributes = content.get("attributes", {}) if name == "zarr.json" else content
            group = attributes.get("ome", attributes)
            scales = group.get("multiscales")
            channels = (group.get("omero") or attributes.get("omero") or {}).get("channels") or []
            labels = tuple(str(channel.get("label", "")).strip() for channel in channels)
        except (ValueError, AttributeError, RecursionError):
            raise InputError(f"{name} is damaged. Copy or download it again") from None
        if scales:
            return scales[0], file, labels if all(labels) else ()
    return None, None, ()
