"""A layer that is shown and hidden by a check box of the dock, or by the eye in the layer list."""

from typing import Any, Generic, TypeVar

from napari import Viewer
from napari.layers import Layer
from qtpy.QtCore import QObject, Signal  # type: ignore[attr-defined]  # qtpy makes it of pyqtSignal

from voxflat._napari.results.layer_list import drop_controls, insert, make_controls
from voxflat._napari.timers import PAUSE, single_shot

LayerType = TypeVar("LayerType", bound=Layer)  # the type of the layer


class ToggledLayer(QObject, Generic[LayerType]):
    """A layer that is hidden instead of removed, because napari needs 0.25 s to remove a layer and 0.1 s to add one."""

    toggled = Signal(bool)  # emitted with the visibility when the user changes it, or removes the layer from the list

    def __init__(self, viewer: Viewer, parent: QObject) -> None:
        super().__init__(parent)
        self._viewer = viewer
        self.layer: LayerType | None = None
        self._coming = single_shot(self, PAUSE, self._arrive)
        viewer.layers.events.removed.connect(self._on_removed)

    @property
    def there(self) -> LayerType | None:
        """The layer, if it is in the list or about to be added to it."""
        is_there = self.layer is not None and (self.is_coming or self.layer in self._viewer.layers)
        return self.layer if is_there else None

    @property
    def is_coming(self) -> bool:
        return bool(self._coming.isActive())

    def hide(self) -> None:
        if self.there is not None:
            self._set_visible(False)

    def remove(self) -> None:
        """Remove the layer from the viewer, or cancel its addition."""
        is_coming, layer, self.layer = self.is_coming, self.there, None
        if layer is not None and is_coming:
            self._coming.stop()
            drop_controls(self._viewer, layer)
        elif layer is not None:
            self._viewer.layers.remove(layer)

    def release(self) -> None:
        """Remove the layer, and stop following the viewer."""
        self.remove()
        self._viewer.layers.events.removed.disconnect(self._on_removed)

    def _on_removed(self, event: Any) -> None:
        if event.value is self.layer:
            self.layer = None
            self.toggled.emit(False)

    def _insert(self, layer: LayerType) -> None:
        """Create the controls of the layer, and add it to the list after the window has processed events."""
        self.layer = layer
        make_controls(self._viewer, layer)
        self._coming.start()

    def _arrive(self) -> None:
        assert self.layer is not None
        insert(self._viewer, self.layer)
        self.layer.events.visible.connect(self._on_visible)

    def _set_visible(self, visible: bool) -> None:
        assert self.layer is not None
        with self.layer.events.visible.blocker(self._on_visible):
            self.layer.visible = visible

    def _on_visible(self) -> None:
        if self.there is not None:
            self.toggled.emit(self.there.visible)
