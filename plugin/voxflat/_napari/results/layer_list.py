"""The hidden layers of runs in the layer list, which are added one at a time."""

import weakref
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import nullcontext
from functools import partial
from typing import Any

from napari import Viewer
from napari.layers import Labels, Layer
from napari.utils.events import Event
from qtpy.QtCore import QTimer

from voxflat._napari.garbage_collection import defer_collections
from voxflat._napari.results.flat_layers import PART, FlatLayers, LayerData, hidden, layer_name
from voxflat._napari.results.outputs import is_painted, remember
from voxflat._napari.timers import PAUSE

_PLACE = ("name", "metadata", "units", "scale", "translate")
_LOOK = ("colormap", "contrast_limits", "gamma", "vertex_colors", "features")


class ListedLayers:
    """The layers of a run in a viewer.

    napari needs 0.1 s to add or remove a layer, but only 0.01 s to change its data. A run that replaces another run
    therefore reuses its layers. Layers are added and removed in steps, between which the window processes events.
    """

    def __init__(self, viewer: Viewer, visibility_changed: Callable[[], None], layers: Iterable[Layer] = ()) -> None:
        self._viewer = weakref.ref(viewer)
        self._visibility_changed = visibility_changed
        self._layers: list[Layer] = [*layers]
        self._steps: deque[Callable[[Viewer], None]] = deque()

    @property
    def layers(self) -> list[Layer]:
        viewer = self._viewer()
        return [] if viewer is None else [layer for layer in self._layers if layer in viewer.layers]

    @property
    def is_settled(self) -> bool:
        """Whether all layers have been added and removed."""
        return not self._steps

    @property
    def painted(self) -> list[Layer]:
        """The layers of the map that the user has painted on."""
        return [layer for layer in self.layers if is_painted(layer)]

    def show(self, result: FlatLayers, owner: str) -> None:
        """Add the layers of the map with this title."""
        defer_collections()
        earlier = self.layers
        for data in [*result.in_space, *result.layers]:
            taken = next((layer for layer in earlier if _is_like(layer, data)), None)
            if taken is not None:
                earlier.remove(taken)
            about = {**data[1], "name": layer_name(owner, data[1]["metadata"][PART])}
            self._steps.append(partial(self._put, data=(data[0], about, data[2]), taken=taken))
        self._steps.extend(partial(self._take_out, layer=layer) for layer in earlier)
        QTimer.singleShot(0, self._go_on)

    def take(self, layer: Layer, owner: str) -> None:
        """Include a layer of the map with this title that is already in the list, because it is from a file."""
        layer.name = layer_name(owner, layer.metadata[PART])
        self._include(layer)

    def _include(self, layer: Layer) -> None:
        self._layers.append(layer)
        layer.events.visible.connect(self._visibility_changed)
        _remember(layer)

    def remove(self) -> None:
        self._stop()
        self._steps.extend(partial(self._take_out, layer=layer) for layer in self.layers)
        QTimer.singleShot(0, self._go_on)

    def hand_over(self) -> list[Layer]:
        """Return all layers for reuse by another run, and stop managing these layers."""
        self._stop()
        return self.layers

    def _stop(self) -> None:
        """Discard the remaining steps."""
        self._steps.clear()
        if (viewer := self._viewer()) is not None:
            for layer in self._layers:
                if layer not in viewer.layers:
                    drop_controls(viewer, layer)

    def _go_on(self) -> None:
        """Take a step, and schedule the next one after the window has processed events."""
        viewer = self._viewer()
        if viewer is None or not self._steps:
            self._steps.clear()
            return
        try:
            self._steps.popleft()(viewer)
        finally:  # so that an error in one layer does not stop the others
            QTimer.singleShot(PAUSE, self._go_on)

    def _put(self, viewer: Viewer, data: LayerData, taken: Layer | None) -> None:
        if taken is not None and taken in viewer.layers:
            _fill(taken, data)
            _remember(taken)
            return
        layer = Layer.create(*hidden(data))
        self._include(layer)
        ahead = (make_controls, make_room, _insert_hidden)
        self._steps.extendleft(partial(step, layer=layer) for step in reversed(ahead))

    def _take_out(self, viewer: Viewer, layer: Layer) -> None:
        self._layers.remove(layer)
        if layer in viewer.layers:
            viewer.layers.remove(layer)


def _controls(viewer: Viewer) -> Any:
    """Return the widget with the layer controls, if this version of napari has it."""
    viewer = getattr(viewer, "__wrapped__", viewer)  # the proxy that napari passes to widgets hides private parts
    found = getattr(getattr(getattr(viewer, "window", None), "_qt_viewer", None), "controls", None)
    return found if all(hasattr(found, name) for name in ("_add", "_remove", "widgets")) else None


def make_controls(viewer: Viewer, layer: Layer) -> None:
    """Create the controls of a layer in advance, so that `insert`, in a later step, blocks the window half as long."""
    controls = _controls(viewer)
    if controls is not None:
        controls._add(Event("inserted", value=layer))


def make_room(viewer: Viewer, layer: Layer) -> None:
    """Extend the sliders for a layer that is about to be added, which makes napari slice all layers again."""
    extent = viewer.layers.get_extent([*viewer.layers, layer])
    if len(extent.step) == viewer.dims.ndim:
        viewer.dims.range = tuple(zip(*extent.world, extent.step, strict=True))


def drop_controls(viewer: Viewer, layer: Layer) -> None:
    """Discard the controls of a layer that will not be added."""
    controls = _controls(viewer)
    if controls is not None and layer in controls.widgets:
        controls._remove(Event("removed", value=layer))


def _insert_hidden(viewer: Viewer, layer: Layer) -> None:
    insert(viewer, layer)
    layer.visible = False


def insert(viewer: Viewer, layer: Layer, index: int | None = None) -> None:
    """Insert a layer without selecting it, because napari would then create its controls, which is slow."""
    viewer = getattr(viewer, "__wrapped__", viewer)  # see above
    layers, before = viewer.layers, set(viewer.layers.selection)
    layers._activate_on_insert = False
    controls = _controls(viewer)
    has_controls = controls is not None and layer in controls.widgets  # napari must not create them again
    try:
        with layers.events.inserted.blocker(controls._add) if has_controls else nullcontext():
            viewer.layers.insert(len(layers) if index is None else index, layer)
    finally:
        layers._activate_on_insert = True
    if set(layers.selection) != before:  # in versions without `_activate_on_insert`
        layers.selection = before


def _remember(layer: Layer) -> None:
    """Remember labels, on which the user may paint."""
    if isinstance(layer, Labels) and layer.ndim == 2:
        remember(layer)


def _is_like(layer: Layer, data: LayerData) -> bool:
    """Return whether a layer can be reused for other data: both have the same type, and both or neither are RGB."""
    _, keywords, kind = data
    is_rgb = bool(getattr(layer, "rgb", False))
    return type(layer).__name__.lower() == kind and is_rgb == bool(keywords.get("rgb", False))


def _fill(layer: Layer, data: LayerData) -> None:
    values, keywords, _ = data
    if getattr(layer, "vertex_colors", None) is not None:
        layer.vertex_colors = None  # the number of points may change, and napari slices immediately
    layer.data = values
    for name in _PLACE + _LOOK:
        if name in keywords and keywords[name] is not None:
            setattr(layer, name, keywords[name])
