"""A box to choose one of the viewer's layers."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from qtpy.QtCore import Signal  # type: ignore[attr-defined]  # qtpy makes it of pyqtSignal
from qtpy.QtWidgets import QComboBox, QSizePolicy, QWidget

if TYPE_CHECKING:
    from napari import Viewer
    from napari.layers import Layer


class LayerChoice(QComboBox):
    """Chooses a layer, and follows the viewer's layers as they come, go and change their names.

    Parameters
    ----------
    viewer : Viewer
        The viewer.
    rank : callable
        How well a layer suits, or None if it does not at all. When nothing is chosen, the best of rank 1 or more is.
    none : str, optional
        An entry for no layer; without it one layer is chosen as soon as there is one.
    parent : QWidget, optional
        The widget's parent.
    """

    chosen = Signal()
    """Another layer is chosen."""

    def __init__(
        self,
        viewer: Viewer,
        rank: Callable[[Layer], int | None],
        none: str | None = None,
        parent: QWidget | None = None,
    ) -> None:
        super().__init__(parent)
        self._viewer = viewer
        self._rank = rank
        self._none = none
        self._layers: list[Layer | None] = []
        self._told: Layer | None = None
        self._by_user = False
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)  # long names do not widen the window
        self._events = (viewer.layers.events.inserted, viewer.layers.events.removed, viewer.layers.events.renamed)
        for event in self._events:
            event.connect(self.refresh)
        self.activated.connect(self._on_activated)
        self.currentIndexChanged.connect(self._tell)
        self.refresh()

    @property
    def layer(self) -> Layer | None:
        """The chosen layer."""
        index = self.currentIndex()
        return self._layers[index] if 0 <= index < len(self._layers) else None

    def choose(self, layer: Layer | None) -> None:
        """Choose a layer.

        `layer`: one of those that are offered.
        """
        self.setCurrentIndex(self._layers.index(layer))

    def refresh(self) -> None:
        """Offer the layers that are there now, and keep the choice if possible."""
        before = self.layer
        offered = [layer for layer in self._viewer.layers if self._rank(layer) is not None]
        if before is not None and before not in offered:
            self._by_user = False  # what was chosen is gone
        keep = before in offered or (before is None and self._by_user)
        wanted = before if keep else self._best(offered)
        self.blockSignals(True)
        self.clear()
        self._layers = offered if self._none is None else [None, *offered]
        self.addItems([self._none or "" if layer is None else layer.name for layer in self._layers])
        self.setCurrentIndex(self._layers.index(wanted) if wanted in self._layers else -1)
        self.blockSignals(False)
        self._tell()

    def reconsider(self) -> None:
        """Offer the layers anew because other ones suit now, and choose the best unless the user has chosen."""
        if not self._by_user:
            self.blockSignals(True)
            self.setCurrentIndex(-1)
            self.blockSignals(False)
        self.refresh()

    def release(self) -> None:
        """Stop following the viewer."""
        for event in self._events:
            event.disconnect(self.refresh)

    def _best(self, offered: list[Layer]) -> Layer | None:
        suitable = [layer for layer in reversed(offered) if self._rank(layer)]
        return max(suitable, key=lambda layer: self._rank(layer) or 0, default=None)

    def _on_activated(self) -> None:
        self._by_user = True

    def _tell(self) -> None:
        if self.layer is not self._told:
            self._told = self.layer
            self.chosen.emit()
