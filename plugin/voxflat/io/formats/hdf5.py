"""Read HDF5 files of ilastik with h5py, in the child process."""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.errors import InputError
from voxflat.io.files import AGAIN, require
from voxflat.io.subprocess_reader import read_in_subprocess

HDF5_ENDINGS = (".h5", ".hdf5")

_USUAL = "exported_data"  # ilastik's name of the dataset
_AXES = {3: "zyx", 4: "czyx"}  # by the number of axes, for datasets without axistags
_INFLATED = 1 << 11  # above the largest compression ratio of a chunk, 1032 (gzip)
_OTHER = "Export the volume from ilastik into a file of its own"


@dataclass(frozen=True)
class Hdf5Array:
    """Describe the dataset of an HDF5 file that contains a stack."""

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    chunks: tuple[int, ...]
    axes: str  # one letter of t, c, z, y and x for each axis
    stored: tuple[int, int, int, int]  # chunks in the file, all chunks; bytes of a chunk, and that the file can hold


def open_hdf5(path: Path) -> Hdf5Array:
    """Find the stack in an HDF5 file, and its axes: the dataset of ilastik, or the only one."""
    name, shape, kind, chunks, tags, stored = read_in_subprocess(_described, "h5py", path)
    axes = _AXES.get(len(shape), "") if tags is None else _axes(tags)
    sizes = " x ".join(map(str, shape))
    if not axes:
        raise InputError(f"has a dataset {name} without axistags ({sizes}). Export it from ilastik, or pass an array")
    if len(axes) != len(shape) or len(set(axes)) != len(axes) or not set("xyz") <= set(axes) <= set("tczyx"):
        raise InputError(f"has shape {sizes} and the axes {', '.join(axes)}. Export a volume with the axes z, y and x")
    if not chunks:  # stored as one block
        pages = {*"tc", next(axis for axis in axes if axis in "xyz")}
        chunks = [1 if axis in pages else length for axis, length in zip(axes, shape, strict=True)]
    return Hdf5Array(name, tuple(shape), np.dtype(kind).newbyteorder("="), tuple(chunks), axes, tuple(stored))


def _axes(tags: str) -> str:
    """Return the letters of the axes from ilastik's JSON."""
    try:
        return "".join(str(axis["key"]).lower() for axis in json.loads(tags)["axes"])
    except (ValueError, KeyError, TypeError, RecursionError):
        raise InputError(f"its axistags are damaged. {AGAIN}") from None


def _described(path: Path) -> tuple[str, list[int], str, list[int] | None, str | None, tuple[int, ...]]:
    """Return the name, shape, type, chunks, axistags and stored chunks of the stack in a file, in the child process."""
    h5py = require("h5py")
    stacks: dict[str, Any] = {}

    def add_dataset(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and len(item.shape or ()) > 2 and item.dtype.kind in "biuf":
            stacks[name] = item

    with h5py.File(path, "r") as file:
        file.visititems(add_dataset)
        if not stacks:
            raise InputError(f"contains no dataset of numbers with at least three axes. {_OTHER}")
        if len(stacks) > 1 and _USUAL not in stacks:
            listed = ", ".join(list(stacks)[:5]) + ", ..." * (len(stacks) > 5)
            raise InputError(f"contains several datasets ({listed}), none of which is named {_USUAL}. {_OTHER}")
        name, data = (_USUAL, stacks[_USUAL]) if _USUAL in stacks else stacks.popitem()
        if data.is_virtual or data.external:
            raise InputError(f"stores the values of {name} in other files. {_OTHER}")
        tags = data.attrs.get("axistags")
        tags = tags.decode() if isinstance(tags, bytes) else None if tags is None else str(tags)
        chunks, held = data.chunks and list(map(int, data.chunks)), int(data.id.get_storage_size())
        count = math.prod(-(-n // max(size, 1)) for n, size in zip(data.shape, chunks or data.shape, strict=True))
        there = int(data.id.get_num_chunks()) if chunks else int(held > 0)
        size = math.prod(chunks or data.shape) * data.dtype.itemsize
        stored = (there, count, size, _INFLATED * held)
        return name, list(map(int, data.shape)), data.dtype.str, chunks, tags, stored


def hdf5_block(path: Path, box: list[int | list[int]], name: str) -> NDArray[Any]:
    """Read a box of a dataset, given one index, or a start and an end index, for each axis."""
    with require("h5py").File(path, "r") as file:
        return np.asarray(file[name][tuple(slice(*index) if isinstance(index, list) else index for index in box)])
