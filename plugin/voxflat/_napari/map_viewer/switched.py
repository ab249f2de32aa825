"""A layer that a switch of the dock shows and hides, as the eye in the list does."""

from __future__ import annotations

from typing import TYPE_CHECKING, Generic, TypeVar

from napari.layers import Layer
from qtpy.QtCore import QObject, Signal  # type: ignore[attr-defined]  # qtpy makes it of pyqtSignal

from voxflat._napari.results.listed import insert

if TYPE_CHECKING:
    from napari import Viewer

OfLayer = TypeVar("OfLayer", bound=Layer)
"""Which kind of layer."""


class SwitchedLayer(QObject, Generic[OfLayer]):
    """A layer that is hidden where it is not wanted, and takes up other maps.

    napari takes a quarter of a second for a layer that goes, and a tenth for one that comes.

    Parameters
    ----------
    viewer : Viewer
        The viewer.
    parent : QObject
        The parent.
    """

    switched = Signal(bool)
    """Someone showed or hid it in the list of layers."""

    def __init__(self, viewer: Viewer, parent: QObject) -> None:
        super().__init__(parent)
        self._viewer = viewer
        self.layer: OfLayer | None = None

    @property
    def there(self) -> OfLayer | None:
        """The layer, if it is in the list."""
        return self.layer if self.layer is not None and self.layer in self._viewer.layers else None

    def hide(self) -> None:
        """Hide the layer."""
        if self.there is not None:
            self._set_visible(False)

    def remove(self) -> None:
        """Take the layer out of the viewer."""
        if self.there is not None:
            self._viewer.layers.remove(self.layer)
        self.layer = None

    def _insert(self, layer: OfLayer) -> None:
        self.layer = layer
        insert(self._viewer, layer)
        layer.events.visible.connect(self._on_visible)

    def _set_visible(self, visible: bool) -> None:
        assert self.layer is not None
        with self.layer.events.visible.blocker(self._on_visible):
            self.layer.visible = visible

    def _on_visible(self) -> None:
        if self.there is not None:
            self.switched.emit(self.there.visible)
