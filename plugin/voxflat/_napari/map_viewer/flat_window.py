"""The window of flat volumes and flat movies."""

from contextlib import suppress
from typing import Any

from napari import Viewer
from napari.layers import Layer
from qtpy.QtCore import QEvent, QObject, QTimer
from qtpy.QtWidgets import QWidget

from voxflat._napari.gl_context import keep_canvas_current
from voxflat._napari.map_viewer.viewer_parts import show_scale_bar
from voxflat._napari.results.flat_layers import LayerData
from voxflat._napari.results.outputs import is_drawn, is_unchanged, remember, remove_unchanged
from voxflat._napari.timers import PAUSE

_SIZE = (1000, 650)  # pixels


class FlatWindow:
    """A second window of napari, because the sliders of the first one belong to other axes.

    It is closed together with the dock that owns it.
    """

    def __init__(self, owner: QWidget, title: str) -> None:
        self._title = title
        self.viewer: Viewer | None = None
        owner.destroyed.connect(lambda: self.close())

    def show(self, data: LayerData) -> None:
        """Show a layer, instead of an earlier one of the same name, unless the user has edited that one."""
        if self.viewer is None:
            self.viewer = Viewer(title=self._title, show=False)
            keep_canvas_current(self.viewer)
            show_scale_bar(self.viewer)
            window = self.viewer.window._qt_window
            window.resize(*_SIZE)
            window.installEventFilter(_Hider(window))
            _put_last(window)  # until it is shown
        layers, name = self.viewer.layers, data[1]["name"]
        remove_unchanged(self.viewer, name)
        layer = Layer.create(*data)
        layers.append(layer)
        remember(layer)
        self.viewer.window.show()
        self.viewer.window.activate()
        QTimer.singleShot(PAUSE, self._fit)  # once the size of the canvas is known

    @property
    def drawn(self) -> list[Layer]:
        """The layers that the user has drawn or edited."""
        layers: Any = [] if self.viewer is None else self.viewer.layers
        return [layer for layer in layers if is_drawn(layer) and not is_unchanged(layer)]

    def keep(self, drawn: list[Layer], kept: list[Layer]) -> None:
        """Keep copies of layers that the user has drawn, because the window is about to close."""
        kept += [Layer.create(*layer.as_layer_data_tuple()) for layer in drawn]

    def take_back(self, kept: list[Layer]) -> None:
        """Show the layers that an earlier window kept."""
        assert self.viewer is not None
        while kept:
            self.viewer.add_layer(kept.pop(0))

    def _fit(self) -> None:
        if self.viewer is not None:
            self.viewer.reset_view()

    def close(self) -> None:
        viewer, self.viewer = self.viewer, None
        if viewer is not None:
            with suppress(RuntimeError, AttributeError):  # napari may have closed the window before
                window = viewer.window._qt_window
                window.removeEventFilter(window.findChild(_Hider))
                viewer.close()


class _Hider(QObject):
    """Hides a window when the user closes it, because napari would cancel all tasks and delete the window."""

    def eventFilter(self, watched: Any, event: Any) -> bool:  # noqa: N802 - Qt's name
        if event.type() != QEvent.Type.Close or getattr(watched, "_quit_app", False):
            return False
        event.ignore()
        watched.hide()
        _put_last(watched)
        return True


def _put_last(window: Any) -> None:
    """Make any other window napari's current viewer instead of this hidden one."""
    opened = getattr(type(window), "_instances", [])  # the current one is at the end
    if window in opened:
        opened.insert(0, opened.pop(opened.index(window)))
