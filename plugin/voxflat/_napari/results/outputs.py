"""The layers that voxflat writes and may overwrite, unless the user has edited them."""

import re
import weakref
import zlib
from typing import Any

import numpy as np
from napari import Viewer
from napari.layers import Labels, Layer, Points, Shapes

_written: "weakref.WeakKeyDictionary[Layer, tuple[str, int, tuple[Any, ...]]]" = weakref.WeakKeyDictionary()


def remember(layer: Layer, *sources: Any) -> None:
    """Remember the content of a layer, and the objects from which it was made."""
    layer = getattr(layer, "__wrapped__", layer)  # of the proxy that napari passes to widgets, which does not last
    _written[layer] = layer.name, _checksum(layer), tuple(map(weakref.ref, sources))


def is_unchanged(layer: Layer, *sources: Any) -> bool:
    """Return whether a layer was made from the same objects, and the user has neither edited nor renamed it."""
    if layer not in _written:
        return False
    name, checksum, made_from = _written[layer]
    same = made_from == tuple(map(weakref.ref, sources)) and name == layer.name
    return same and checksum == _checksum(layer)


def made_from(viewer: Viewer, *sources: Any) -> Layer | None:
    """Return the last layer that was made from these objects, unless the user has edited it."""
    return next((layer for layer in reversed(viewer.layers) if is_unchanged(layer, *sources)), None)


def is_named(layer: Layer, name: str) -> bool:
    return re.fullmatch(rf"{re.escape(name)}( \[\d+\])?", layer.name) is not None  # as napari numbers equal names


def remove_unchanged(viewer: Viewer, name: str) -> None:
    """Remove the layers with a name that voxflat made and the user has not edited."""
    for layer in [layer for layer in viewer.layers if is_named(layer, name) and is_unchanged(layer)]:
        viewer.layers.remove(layer)


def is_painted(layer: Layer) -> bool:
    """Return whether the content of a remembered layer has changed since."""
    return layer in _written and _written[layer][1] != _checksum(layer)


def is_drawn(layer: Layer) -> bool:
    """Return whether a layer contains labels, points or shapes."""
    if isinstance(layer, Labels):
        return bool(np.any(layer.data[0] if layer.multiscale else layer.data))
    return isinstance(layer, Points | Shapes) and len(layer.data) > 0


def _checksum(layer: Layer) -> int:
    checksum = 0
    for array in layer.data if isinstance(layer.data, list | tuple) else [layer.data]:
        checksum = zlib.crc32(np.ascontiguousarray(array).data.cast("B"), checksum)
    return checksum
