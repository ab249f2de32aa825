"""A box for choosing one of the layers in the viewer."""

from collections.abc import Callable
from functools import partial
from typing import Any

from napari import Viewer
from napari.layers import Layer
from qtpy.QtCore import QTimer, Signal  # type: ignore[attr-defined]  # qtpy makes it of pyqtSignal
from qtpy.QtWidgets import QComboBox, QSizePolicy
from superqt.utils import signals_blocked

from voxflat._napari.map_viewer.viewer_parts import list_events

_EDITED = ("data", "paint", "units", "scale", "translate", "rotate", "shear", "affine")  # events of layers


class LayerChoice(QComboBox):
    """Lets the user choose a layer, or `none`, and follows layers that are added, removed and renamed.

    Until the user chooses, the box selects the newest of the layers with the highest `rank`. A layer with rank None is
    not offered, and a layer with rank 0 is not selected automatically. If `follows_selection` is set, a layer that the
    user selects in the layer list takes precedence; napari's own selection of new layers is ignored.
    """

    chosen = Signal()  # emitted when another layer is chosen
    edited = Signal()  # emitted when the data or the place of the chosen layer change
    settled = Signal(str)  # emitted with an empty text when a layer for which the box waits is there, or not needed

    def __init__(
        self,
        viewer: Viewer,
        rank: Callable[[Layer], int | None],
        none: str | None = None,
        follows_selection: bool = False,
    ) -> None:
        super().__init__()
        self._viewer = viewer
        self._rank = rank
        self._none = none
        self._layers: list[Layer | None] = []
        self._last: Layer | None = None
        self._edits: list[Any] = []
        self._by_user = False
        self._awaited: str | None = None  # the name of a layer that is chosen when it is opened
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)  # long names must not widen the window
        self._selected: Layer | None = None
        self._has_new = False
        layers = viewer.layers
        self._events = list_events(layers)
        for event in self._events:
            event.connect(self.refresh)
        self._follows_selection = follows_selection
        if follows_selection:
            layers.events.inserting.connect(self._on_inserting)
            layers.selection.events.active.connect(self._on_selection)
        self.activated.connect(self._on_activated)
        self.currentIndexChanged.connect(self._tell)
        self.refresh()

    @property
    def layer(self) -> Layer | None:
        index = self.currentIndex()
        return self._layers[index] if 0 <= index < len(self._layers) else None

    def choose(self, layer: Layer | None) -> None:
        """Choose an offered layer, as if the user had chosen it."""
        self._by_user = True
        self.setCurrentIndex(self._layers.index(layer))

    def record(self) -> str | None:
        return None if self.layer is None else self.layer.name

    def restore(self, name: str | None) -> str:
        """Choose a layer by its name; if it is not open, choose it when it is opened."""
        self._awaited = name
        self.refresh()
        if name is None and self._none is not None:
            self.choose(None)
        return "" if self._awaited is None else f"layer '{name}' is not open"

    def refresh(self) -> None:
        """Update the offered layers, and select the best one unless the user has chosen."""
        before = self.layer
        offered = [layer for layer in self._viewer.layers if self._rank(layer) is not None]
        if before is not None and before not in offered:
            self._by_user = False  # the chosen layer was removed
        awaited = next((layer for layer in offered if layer.name == self._awaited), None)
        if awaited is not None:
            before, self._by_user, self._awaited = awaited, True, None
        choice = before if self._by_user else self._best(offered)
        with signals_blocked(self):
            self.clear()
            self._layers = offered if self._none is None else [None, *offered]
            self.addItems([self._none or "" if layer is None else layer.name for layer in self._layers])
            self.setCurrentIndex(self._layers.index(choice) if choice in self._layers else -1)
        self._tell()
        if awaited is not None:
            self.settled.emit("")

    def keep(self) -> None:
        """Keep the current layer as if the user had chosen it."""
        self._by_user |= self.layer is not None

    def release(self) -> None:
        self._follow(None)
        for event in self._events:
            event.disconnect(self.refresh)
        if self._follows_selection:
            self._viewer.layers.events.inserting.disconnect(self._on_inserting)
            self._viewer.layers.selection.events.active.disconnect(self._on_selection)

    def _on_inserting(self) -> None:
        self._has_new = True
        QTimer.singleShot(0, partial(setattr, self, "_has_new", False))

    def _on_selection(self) -> None:
        if not self._has_new:
            self._selected = self._viewer.layers.selection.active
            self.refresh()

    def _best(self, offered: list[Layer]) -> Layer | None:
        suitable = {layer: rank for layer in reversed(offered) if (rank := self._rank(layer))}
        return self._selected if self._selected in suitable else max(suitable, key=suitable.__getitem__, default=None)

    def _on_activated(self) -> None:
        self._by_user = True
        if self._awaited is not None:
            self._awaited = None
            self.settled.emit("")

    def _tell(self) -> None:
        if self.layer is not self._last:
            self._last = self.layer
            self._follow(self.layer)
            self.chosen.emit()

    def _follow(self, layer: Layer | None) -> None:
        for event in self._edits:
            event.disconnect(self._on_edited)
        events = {} if layer is None else layer.events.emitters
        self._edits = [events[name] for name in _EDITED if name in events]
        for event in self._edits:
            event.connect(self._on_edited)

    def _on_edited(self) -> None:
        self.edited.emit()
