"""Find the voxel sizes that TIFF files declare, which napari's own reader leaves out."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

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


def declared_size(viewer: Viewer, layer: Layer) -> DeclaredSize | None:
    """Return the voxel size in an open TIFF file with the voxels of a layer, if the layer has no size itself."""
    for each in _alike(viewer, layer):
        path = str(each.source.path or "")
        if path.lower().endswith(TIFF_ENDINGS) and Path(path).is_file():
            found = _in_file(Path(path), Path(path).stat().st_mtime_ns)
            if found is not None:
                return found
    return None


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


@lru_cache(maxsize=16)
def _in_file(path: Path, _: int) -> DeclaredSize | None:
    """Return the voxel size in a file, known by its path and time of change, if all are there."""
    try:
        stack = open_tiff(path)
    except (VoxflatError, OSError):
        return None
    if stack.affine is None:
        return None
    size = tuple(float(length) for length in np.diag(stack.affine)[2::-1])
    return DeclaredSize(path, size, stack.unit) if np.isfinite(size).all() else None
