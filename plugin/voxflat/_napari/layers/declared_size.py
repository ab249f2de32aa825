"""Find the voxel sizes that TIFF files declare, which napari's own reader leaves out."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
from napari import Viewer
from napari.layers import Image, Labels, Layer

from voxflat._napari.layers.volumes import finest
from voxflat.errors import VoxflatError
from voxflat.io.formats.tiff import TIFF_ENDINGS, open_tiff


@dataclass(frozen=True)
class DeclaredSize:
    """The size of the voxels in a file, along z, y and x."""

    path: Path
    size: tuple[float, ...]
    unit: str


File: TypeAlias = tuple[Path, int]  # with its time of change

_sizes: dict[File, DeclaredSize | None] = {}  # in the files that were read


def declared_size(viewer: Viewer, layer: Layer) -> DeclaredSize | None:
    """Return the voxel size in an open TIFF file with the voxels of a layer, if the layer has no size itself.

    The size is known after `read_sizes` of the `unread_files`.
    """
    found = (_sizes.get(file) for file in _files(viewer, layer))
    return next((size for size in found if size is not None), None)


def unread_files(viewer: Viewer, layer: Layer) -> tuple[File, ...]:
    """Return the files that may have the voxel size of a layer, and were not read since they changed."""
    return tuple(file for file in _files(viewer, layer) if file not in _sizes)


def read_sizes(files: Sequence[File]) -> None:
    """Read the voxel sizes in files, which takes about a second for 5,000 pages; called in a thread."""
    for file in files:
        _sizes[file] = _in_file(file[0])


def _files(viewer: Viewer, layer: Layer) -> list[File]:
    """Return the open TIFF files with the voxels of a layer, if the layer has no size itself."""
    paths = [Path(str(each.source.path)) for each in _alike(viewer, layer) if each.source.path]
    tiffs = [path for path in paths if path.name.lower().endswith(TIFF_ENDINGS) and path.is_file()]
    return [(path, path.stat().st_mtime_ns) for path in tiffs]


def use_declared_size(viewer: Viewer, layer: Layer, declared: DeclaredSize) -> None:
    """Give the size to a layer, and to all others with its voxels that have no size; the slice stays, and fits."""
    step = viewer.dims.current_step
    for each in _alike(viewer, layer):
        leading = each.ndim - 3
        each.scale = (*each.scale[:leading], *declared.size)
        each.units = (*each.units[:leading], *[declared.unit] * 3)
    viewer.dims.current_step = tuple(int(number == 0) for number in step)  # otherwise napari shows an empty slice
    viewer.dims.current_step = step
    viewer.reset_view()


def _alike(viewer: Viewer, layer: Layer) -> list[Layer]:
    """Return the layers without a voxel size that have the voxels of a layer, which must have none either."""
    layers = [layer, *(each for each in viewer.layers if each is not layer)] if _has_no_size(layer) else []
    return [each for each in layers if _has_no_size(each) and _shape(each) == _shape(layer)]


def _has_no_size(layer: Layer) -> bool:
    if (
        not isinstance(layer, Image | Labels)
        or layer.ndim < 3
        or any(str(unit) != "pixel" for unit in layer.units[-3:])
    ):
        return False
    return np.array_equal(layer.scale[-3:], [1, 1, 1]) and np.array_equal(
        layer.affine.affine_matrix[-4:, -4:], np.eye(4)
    )


def _shape(layer: Layer) -> tuple[int, ...]:
    return tuple(finest(layer).shape[layer.ndim - 3 : layer.ndim])


def _in_file(path: Path) -> DeclaredSize | None:
    """Return the voxel size in a file, if it declares all three lengths."""
    try:
        stack = open_tiff(path)
    except (VoxflatError, OSError):
        return None
    if stack.affine is None:
        return None
    size = tuple(float(length) for length in np.diag(stack.affine)[2::-1])
    return DeclaredSize(path, size, stack.unit) if np.isfinite(size).all() else None
