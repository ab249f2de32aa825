"""The layers of runs in the viewer's list: hidden, and put there one at a time."""

import weakref
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import nullcontext
from functools import partial
from typing import Any

from napari import Viewer
from napari.layers import Layer
from napari.utils.events import Event
from qtpy.QtCore import QTimer

from voxflat._napari.garbage_collection import defer_collections
from voxflat._napari.results.flat_layers import FlatLayers, LayerData, hidden
from voxflat._napari.timers import PAUSE

_PLACE = ("name", "metadata", "units", "scale", "translate")
_LOOK = ("colormap", "contrast_limits", "gamma", "vertex_colors", "features")


class ListedLayers:
    """The layers of a run in a viewer.

    napari takes a tenth of a second for each layer that comes or goes, and a hundredth for other data in one that is
    there. So a run that replaces another one takes over its layers, as far as they are of the same kind; and what comes
    or goes does so with time for the window in between.
    """

    def __init__(self, viewer: Viewer, layers: Iterable[Layer] = ()) -> None:
        self._viewer = weakref.ref(viewer)
        self._layers: list[Layer] = [*layers]
        self._steps: deque[Callable[[Viewer], None]] = deque()

    @property
    def layers(self) -> list[Layer]:
        """Those that are in the viewer."""
        viewer = self._viewer()
        return [] if viewer is None else [layer for layer in self._layers if layer in viewer.layers]

    @property
    def is_settled(self) -> bool:
        """Whether all have come and gone."""
        return not self._steps

    def show(self, result: FlatLayers) -> None:
        """List the layers of a run."""
        defer_collections()
        earlier = self.layers
        for data in [*result.in_space, *result.layers]:
            taken = next((layer for layer in earlier if _is_like(layer, data)), None)
            if taken is not None:
                earlier.remove(taken)
            self._steps.append(partial(self._put, data=data, taken=taken))
        self._steps.extend(partial(self._take_out, layer=layer) for layer in earlier)
        QTimer.singleShot(0, self._go_on)

    def take(self, layer: Layer) -> None:
        """Count a layer of the run that is in the list already, as of a file that was opened, among these."""
        self._layers.append(layer)

    def remove(self) -> None:
        """Take them out of the list."""
        self._stop()
        self._steps.extend(partial(self._take_out, layer=layer) for layer in self.layers)
        QTimer.singleShot(0, self._go_on)

    def hand_over(self) -> list[Layer]:
        """Give all layers to another run's, and leave them alone."""
        self._stop()
        return self.layers

    def _stop(self) -> None:
        """Take no further step."""
        self._steps.clear()
        viewer = self._viewer()
        if viewer is not None:
            for layer in self._layers:
                if layer not in viewer.layers:
                    drop_controls(viewer, layer)

    def _go_on(self) -> None:
        """Take a step, and come back for the next one when the window has lived."""
        viewer = self._viewer()
        if viewer is None or not self._steps:
            self._steps.clear()
            return
        try:
            self._steps.popleft()(viewer)
        finally:  # a layer that fails keeps no other one
            QTimer.singleShot(PAUSE, self._go_on)

    def _put(self, viewer: Viewer, data: LayerData, taken: Layer | None) -> None:
        if taken is not None and taken in viewer.layers:
            _fill(taken, data)
            return
        layer = Layer.create(*hidden(data))
        self._layers.append(layer)
        ahead = (make_controls, make_room, _insert_hidden)
        self._steps.extendleft(partial(step, layer=layer) for step in reversed(ahead))

    def _take_out(self, viewer: Viewer, layer: Layer) -> None:
        self._layers.remove(layer)
        if layer in viewer.layers:
            viewer.layers.remove(layer)


def _controls(viewer: Viewer) -> Any:
    """Return what holds the controls of a viewer's layers, where this napari has it."""
    viewer = getattr(viewer, "__wrapped__", viewer)  # which napari gives widgets, and whose parts are private
    found = getattr(getattr(getattr(viewer, "window", None), "_qt_viewer", None), "controls", None)
    return found if all(hasattr(found, name) for name in ("_add", "_remove", "widgets")) else None


def make_controls(viewer: Viewer, layer: Layer) -> None:
    """Make the controls of a layer that `insert` puts into the list in a later turn of the loop: half of its time."""
    controls = _controls(viewer)
    if controls is not None:
        controls._add(Event("inserted", value=layer))


def make_room(viewer: Viewer, layer: Layer) -> None:
    """Let the sliders reach as far as they will with a layer that is about to come: what is shown is sliced anew."""
    extent = viewer.layers.get_extent([*viewer.layers, layer])
    if len(extent.step) == viewer.dims.ndim:
        viewer.dims.range = tuple(zip(*extent.world, extent.step, strict=True))


def drop_controls(viewer: Viewer, layer: Layer) -> None:
    """Forget the controls of a layer that does not come, if they were made."""
    controls = _controls(viewer)
    if controls is not None and layer in controls.widgets:
        controls._remove(Event("removed", value=layer))


def _without_controls(viewer: Viewer, layer: Layer) -> Any:
    """Keep napari from making the controls of a layer a second time."""
    controls = _controls(viewer)
    if controls is None or layer not in controls.widgets:
        return nullcontext()
    return viewer.layers.events.inserted.blocker(controls._add)


def _insert_hidden(viewer: Viewer, layer: Layer) -> None:
    insert(viewer, layer)
    layer.visible = False


def insert(viewer: Viewer, layer: Layer, index: int | None = None) -> None:
    """Put a layer into the list, and leave the selection alone: napari makes controls for it, which takes long."""
    viewer = getattr(viewer, "__wrapped__", viewer)  # as above
    layers, before = viewer.layers, set(viewer.layers.selection)
    layers._activate_on_insert = False
    try:
        with _without_controls(viewer, layer):
            viewer.layers.insert(len(layers) if index is None else index, layer)
    finally:
        layers._activate_on_insert = True
    if set(layers.selection) != before:  # where the switch is none
        layers.selection = before


def _is_like(layer: Layer, data: LayerData) -> bool:
    """Whether a layer can take over data: it is of the same type and kind of colours, and nothing was added to it."""
    _, keywords, kind = data
    is_rgb = bool(getattr(layer, "rgb", False))
    return type(layer).__name__.lower() == kind and is_rgb == bool(keywords.get("rgb", False))


def _fill(layer: Layer, data: LayerData) -> None:
    """Give a layer other data."""
    values, keywords, _ = data
    if getattr(layer, "vertex_colors", None) is not None:
        layer.vertex_colors = None  # there may be another number of points, which napari slices at once
    layer.data = values
    for name in _PLACE + _LOOK:
        if name in keywords and keywords[name] is not None:
            setattr(layer, name, keywords[name])
