"""Read volumes as layers in scanner coordinates."""

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat._napari.files.late_stacks import follow_stacks
from voxflat._napari.layers.world import WORLD
from voxflat._napari.results.flat_layers import LayerData, Pixels, limits, unit_of_map, units
from voxflat._napari.stacks import stack_of, viewer_order
from voxflat.io.channels import series_of
from voxflat.io.files import REMEDY, naming
from voxflat.io.grid import millimetres
from voxflat.io.sources import as_volume
from voxflat.maps.image_files import is_flat
from voxflat.maps.raster import FlatImage

_LABELS = {"aseg", "aparc", "dseg", "label", "labels", "mask", "parc", "ribbon", "seg", "segmentation"}
_FEW = 64  # distinct values; a volume with more of them is an image, unless its name indicates labels
_SPACE = ("mm",) * 3


def volume_layers(path: Path) -> list[LayerData]:
    """Read a volume or a series of volumes as labels or an image, in scanner RAS and mm.

    The first axis of a series is time, and its frames are read when they are displayed. The axes of the file are
    permuted to the order x, y, z, because napari does not show slices in other orders. A volume with the voxels of an
    open stack gets the axes and the unit of the stack. Raises InputError if the file is damaged or is not a volume.
    """
    with naming(path, REMEDY):
        found = series_of(path)
    if found is not None:
        from dask.array import from_delayed, stack
        from dask.delayed import delayed

        frames, to_ras = found
        shape = frames.read(0).shape
        if is_flat(path, (*shape, len(frames)), to_ras):
            return [_flat_layer(path, np.stack([frames.read(n) for n in range(len(frames))]), to_ras)]
        order, affine, place = _place(path, shape, to_ras)
        first = np.transpose(frames.read(0), order)
        read = delayed(lambda n: np.transpose(frames.read(n), order).astype(first.dtype, copy=False))
        data = stack([from_delayed(read(n), first.shape, first.dtype) for n in range(len(frames))])  # type: ignore[no-untyped-call]
        in_time = np.eye(5)
        in_time[1:, 1:] = affine
        about = {"affine": in_time, **place, "units": ("pixel", *place["units"])}
        return [(data, {"name": _name(path), **about}, "image")]
    volume = as_volume(path).in_unit("mm")
    if is_flat(path, volume.data.shape, volume.affine):
        return [_flat_layer(path, volume.data, volume.affine)]
    order, affine, place = _place(path, volume.data.shape, volume.affine)
    voxels = np.transpose(volume.data, [*order, *range(3, volume.data.ndim)])
    about = {"name": _name(path), "affine": affine, **place}
    is_named = not _LABELS.isdisjoint(re.split(r"[^a-z]+", path.name.lower()))
    if voxels.ndim > 3 or voxels.dtype.kind not in "iub" or not (is_named or len(np.unique(voxels)) <= _FEW):
        return [(voxels, {**about, "rgb": voxels.ndim > 3}, "image")]
    return [(voxels.astype(np.int32) if voxels.dtype.kind == "b" else voxels, about, "labels")]


def _flat_layer(path: Path, voxels: NDArray[Any], affine: NDArray[np.float64]) -> LayerData:
    """Return the layer of flat images, where the images of their map lie if it is open; depths get a slider."""
    from napari import current_viewer

    from voxflat._napari.viewer_state import ViewerState

    viewer = current_viewer()
    runs = () if viewer is None else ViewerState.of(viewer).runs
    data = np.moveaxis(voxels, -1, -3)  # the depths come before rows and columns
    if data.shape[-3] == 1:
        data = data[..., 0, :, :]
    size, (u, v, height) = float(affine[0, 1]), affine[:3, 3].tolist()
    in_mm = Pixels(data.shape[-2:], size, (-v, u))
    found = (run for run in runs if run.has_pixels(in_mm.scaled(1 / millimetres(unit_of_map(run.flat_map)))))
    run = next(found, None)
    unit = "mm" if run is None else unit_of_map(run.flat_map)
    own = in_mm.scaled(1 / millimetres(unit))
    step, start = (length / millimetres(unit) for length in (float(affine[2, 2]), height))
    before = [(1.0, 0.0, "pixel")] * (voxels.ndim > 3) + [(step, start, unit)] * (voxels.shape[-1] > 1)
    steps, starts, named = zip(*before, strict=True) if before else ((), (), ())
    in_plane = (unit,) * 2 if run is None else units(run.flat_map, 2)
    place: dict[str, Any] = {"scale": (*steps, *(own.size,) * 2), "translate": (*starts, *own.corner)}
    place["units"] = None if in_plane is None else (*named, *in_plane)
    if before:
        place["metadata"] = {"voxflat": None}  # so that it is neither flattened nor sampled as a volume
    if FlatImage(data, size, (u, v), "").is_labels:
        return np.nan_to_num(data).astype(np.int64), {"name": _name(path), **place}, "labels"
    return data, {"name": _name(path), **place, "contrast_limits": limits(data)}, "image"


def _place(
    path: Path, shape: tuple[int, ...], to_ras: NDArray[np.float64]
) -> tuple[list[int], NDArray[np.float64], dict[str, Any]]:
    """Return the order of the axes in a layer, its affine, and its units and world axes: those of its open stack."""
    from napari import current_viewer
    from napari.utils.notifications import show_info

    stack = stack_of(current_viewer(), shape, to_ras)
    affine = to_ras if stack is None else stack.affine(to_ras, "mm")
    order = viewer_order(affine)
    if stack is None:
        follow_stacks()
        return order, affine[:, [*order, 3]], {"units": _SPACE, "metadata": {WORLD: "RAS"}}
    show_info(f"{path.name} has the voxels of '{stack.layer.name}', and was opened with its axes ({stack.world})")
    place = {"units": tuple(stack.layer.units[-3:]), "metadata": {WORLD: stack.world}}
    return order, affine[:, [*order, 3]], place


def _name(path: Path) -> str:
    return re.sub(r"\.(nii\.gz|[a-z]+)$", "", path.name, flags=re.IGNORECASE)
