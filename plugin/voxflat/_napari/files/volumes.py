"""Read volumes as layers in scanner coordinates."""

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat._napari.results.flat_layers import LayerData
from voxflat.io.channels import series_of
from voxflat.io.files import REMEDY, naming
from voxflat.io.sources import as_volume

_LABELS = {"aseg", "aparc", "dseg", "label", "labels", "mask", "parc", "ribbon", "seg", "segmentation"}
_FEW = 64  # distinct values; a volume with more of them is an image, unless its name indicates labels
_SPACE = ("mm",) * 3


def volume_layers(path: Path) -> list[LayerData]:
    """Read a volume or a series of volumes as labels or an image, in scanner RAS and mm.

    The first axis of a series is time, and its frames are read when they are displayed. The axes of the file are
    permuted to the order x, y, z, because napari does not show slices in other orders. Raises InputError if the file
    is damaged or is not a volume.
    """
    with naming(path, REMEDY):
        found = series_of(path)
    if found is not None:
        from dask.array import from_delayed, stack
        from dask.delayed import delayed

        frames, affine = found
        order = _order(affine)
        first = np.transpose(frames.read(0), order)
        read = delayed(lambda n: np.transpose(frames.read(n), order).astype(first.dtype, copy=False))
        data = stack([from_delayed(read(n), first.shape, first.dtype) for n in range(len(frames))])  # type: ignore[no-untyped-call]
        in_time = np.eye(5)
        in_time[1:, 1:] = affine[:, [*order, 3]]
        about: dict[str, Any] = {"affine": in_time, "units": ("pixel", *_SPACE)}
        return [(data, {"name": _name(path), **about}, "image")]
    volume = as_volume(path).in_unit("mm")
    order = _order(volume.affine)
    voxels = np.transpose(volume.data, [*order, *range(3, volume.data.ndim)])
    about = {"name": _name(path), "affine": volume.affine[:, [*order, 3]], "units": _SPACE}
    is_named = not _LABELS.isdisjoint(re.split(r"[^a-z]+", path.name.lower()))
    if voxels.ndim > 3 or voxels.dtype.kind not in "iub" or not (is_named or len(np.unique(voxels)) <= _FEW):
        return [(voxels, {**about, "rgb": voxels.ndim > 3}, "image")]
    return [(voxels.astype(np.int32) if voxels.dtype.kind == "b" else voxels, about, "labels")]


def _order(affine: NDArray[np.float64]) -> list[int]:
    """Return the voxel axes that are closest to x, y and z."""
    along = np.abs(affine[:3, :3]) / np.linalg.norm(affine[:3, :3], axis=0)
    order = [-1, -1, -1]
    for row, column in sorted(np.ndindex(3, 3), key=lambda at: -along[at]):
        if order[row] < 0 and column not in order:
            order[row] = column
    return order


def _name(path: Path) -> str:
    return re.sub(r"\.(nii\.gz|[a-z]+)$", "", path.name, flags=re.IGNORECASE)
