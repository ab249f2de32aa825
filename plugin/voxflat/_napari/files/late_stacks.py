"""Give volumes the axes of a stack that is opened, or gets its voxel sizes, after them."""

import weakref
from contextlib import suppress
from typing import Any

import numpy as np
from napari import Viewer, current_viewer
from napari.layers import Image, Labels, Layer
from napari.utils.notifications import show_info, show_warning

from voxflat._napari.layers.volumes import finest
from voxflat._napari.layers.world import WORLD, LayerPlace
from voxflat._napari.results.flat_layers import Run
from voxflat._napari.results.session import session_of
from voxflat._napari.stacks import Stack, stack_of, viewer_order
from voxflat._napari.viewer_state import ViewerState
from voxflat.errors import InputError

_PLACE = ("scale", "translate", "affine", "units")
_told: "weakref.WeakSet[Run]" = weakref.WeakSet()  # maps about whose axes a message was shown


def follow_stacks() -> None:
    """Follow the layers of the viewer, now and later, for the stacks of volumes and maps that were read without one."""
    viewer = current_viewer()
    if viewer is not None:
        viewer.layers.events.inserted.connect(_on_inserted)  # napari ignores a callback that it already has
        for layer in viewer.layers:
            _follow(layer)


def _on_inserted(event: Any) -> None:
    _follow(event.value)
    _on_placed()


def _follow(layer: Layer) -> None:
    if isinstance(layer, Image | Labels) and layer.ndim >= 3:
        for name in _PLACE:
            getattr(layer.events, name).connect(_on_placed)


def _on_placed() -> None:
    """Tell which maps have other axes than their stack, and give its axes to the volumes that voxflat has read."""
    viewer = current_viewer()
    if viewer is None:
        return
    for run in set(ViewerState.of(viewer).runs) - set(_told):
        origin, name = run.flat_map.origin, run.title
        if not origin.is_voxels or session_of(run.flat_map).world_axes != "RAS":
            continue
        stack = stack_of(viewer, origin.voxels.shape, origin.voxels.affine, origin.unit)
        if stack is not None:
            _told.add(run)
            show_warning(
                f"The map '{name}' is older than the stack '{stack.layer.name}' with its voxels, and has other axes "
                f"({stack.world} in the stack). Open the file of the map again, or flatten the layer again"
            )
    for layer in [layer for layer in viewer.layers if _is_volume(viewer, layer)]:
        with suppress(InputError):  # the layer has no place in space
            leading = layer.ndim - 3
            place = LayerPlace.of(layer, "RAS", leading)
            stack = stack_of(viewer, finest(layer).shape[leading : layer.ndim], place.affine, place.unit)
            if stack is not None:
                _turn(layer, place, stack)


def _is_volume(viewer: Viewer, layer: Layer) -> bool:
    """Return whether voxflat has read a layer as a volume with the axes x, y, z, which the user did not choose."""
    is_read = isinstance(layer, Image | Labels) and layer.source.reader_plugin == "voxflat"
    return is_read and layer.metadata.get(WORLD) == "RAS" and ViewerState.of(viewer).world_of(layer) is None


def _turn(layer: Image | Labels, place: LayerPlace, stack: Stack) -> None:
    """Permute the axes of a volume to those of its stack, and place it there."""
    count, leading = layer.ndim, layer.ndim - 3
    affine = stack.affine(place.affine, place.unit)
    order = viewer_order(affine)
    in_time = np.array(layer.affine.affine_matrix)
    in_time[leading:, leading:] = affine[:, [*order, 3]]
    colours = range(count, np.ndim(layer.data))
    for name in _PLACE:  # in between, its voxels are those of no stack
        getattr(layer.events, name).disconnect(_on_placed)
    layer.data = np.transpose(layer.data, [*range(leading), *(leading + axis for axis in order), *colours])
    layer.scale, layer.translate = [*layer.scale[:leading], 1, 1, 1], [*layer.translate[:leading], 0, 0, 0]
    layer.affine, layer.units = in_time, (*layer.units[:leading], *stack.layer.units[-3:])
    layer.metadata[WORLD] = stack.world
    _follow(layer)
    show_info(f"'{layer.name}' has the voxels of '{stack.layer.name}', and now has its axes ({stack.world})")
