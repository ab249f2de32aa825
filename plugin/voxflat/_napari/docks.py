"""Base classes of the docks, which open as tabs because two docks do not fit on a small screen."""

from collections.abc import Callable, Sequence
from typing import Any

from napari.utils.notifications import show_error, show_info
from qtpy.QtCore import QEvent, QObject, Qt
from qtpy.QtWidgets import (
    QApplication,
    QDockWidget,
    QGridLayout,
    QLabel,
    QLayout,
    QMainWindow,
    QPushButton,
    QWidget,
)

from voxflat._napari.timers import single_shot
from voxflat._napari.wording import error_text
from voxflat._napari.worker import JobWorker
from voxflat.arguments import Progress
from voxflat.errors import Cancelled

_LATE = 2000  # ms; the sizes of the windows are discarded after this time
_EDITS = ("chosen", "edited", "currentIndexChanged", "stateChanged", "valueChanged")  # signals of fields in forms


class Tab(QObject):
    """Opens the dock of a widget as a tab beside the open voxflat docks; the user can move it afterwards.

    An entry of the menu that opens a dock hides it when it is open. Behind another tab, it is brought to the front.
    """

    def __init__(self, widget: QWidget) -> None:
        super().__init__(widget)
        self._widget = widget
        windows = [window for window in QApplication.topLevelWidgets() if isinstance(window, QMainWindow)]
        self._sizes = {id(window): window.size() for window in windows}
        self._soon = single_shot(self, 0, self._join)  # after napari has placed the dock
        self._dock: QDockWidget | None = None
        self._is_behind = False
        widget.installEventFilter(self)
        single_shot(self, _LATE, self._sizes.clear).start()  # before a user can have resized them

    def eventFilter(self, watched: Any, event: Any) -> bool:  # noqa: N802 - Qt's name
        """Join the other tabs when the widget is shown for the first time; bring its dock to the front."""
        if watched is self._widget and event.type() == QEvent.Type.Show:
            self._widget.removeEventFilter(self)
            self._soon.start()
        if isinstance(watched, QDockWidget):
            is_hidden = event.type() == QEvent.Type.Hide and watched.isHidden()  # not with its window
            if event.type() == QEvent.Type.ShowToParent or (is_hidden and self._is_behind):
                self._to_front.start()
        return False

    def _raise(self) -> None:
        window = None if self._dock is None else self._dock.parentWidget()
        if self._dock is None or not isinstance(window, QMainWindow):
            return
        if window.dockWidgetArea(self._dock) == Qt.DockWidgetArea.NoDockWidgetArea:
            return  # it was removed
        self._dock.removeEventFilter(self)  # which would answer to this, too
        self._dock.show()
        self._dock.raise_()
        self._dock.installEventFilter(self)

    def _on_visibility(self, is_in_front: bool) -> None:
        self._is_behind = not is_in_front

    def _join(self) -> None:
        dock: QWidget | None = self._widget
        while dock is not None and not isinstance(dock, QDockWidget):
            dock = dock.parentWidget()
        if dock is None or dock.isFloating():
            return
        window = dock.window()
        if not isinstance(window, QMainWindow):
            return
        self._dock = dock
        self._to_front = single_shot(dock, 0, self._raise)  # after Qt has shown or hidden the dock; deleted with it
        dock.visibilityChanged.connect(self._on_visibility)
        dock.installEventFilter(self)
        others = [other for other in window.findChildren(QDockWidget) if other is not dock and other.findChild(Tab)]
        docked = [other for other in others if not (other.isHidden() or other.isFloating())]
        ours = [other for other in docked if window.dockWidgetArea(other) == window.dockWidgetArea(dock)]
        if ours:
            window.tabifyDockWidget(ours[-1], dock)
            dock.raise_()
            before, layout = self._sizes.get(id(window)), window.layout()
            if before is not None and layout is not None and not (window.isMaximized() or window.isFullScreen()):
                layout.activate()  # a small window grew while one dock was below the other
                window.resize(before)


def plain_label(text: str = "") -> QLabel:
    """Return a label whose text, which may contain names of layers and files, is never taken as HTML."""
    label = QLabel(text)
    label.setTextFormat(Qt.TextFormat.PlainText)
    return label


def arrange(layout: Any, *parts: Any) -> None:
    """Add widgets and layouts to a box layout; a tuple (part, factor) sets its stretch factor."""
    for part in parts:
        item, stretch = part if isinstance(part, tuple) else (part, 0)
        (layout.addLayout if isinstance(item, QLayout) else layout.addWidget)(item, stretch)


def grid(buttons: Sequence[QPushButton], columns: int) -> QGridLayout:
    """Return a layout with buttons in rows."""
    layout = QGridLayout()
    for number, button in enumerate(buttons):
        layout.addWidget(button, *divmod(number, columns))
    return layout


class Dock(QWidget):
    """Base class of the widgets; napari creates them, and passes the viewer as the parameter `napari_viewer`."""

    def __init__(self) -> None:
        super().__init__()
        Tab(self)

    def event(self, event: Any) -> bool:
        """Stop following the viewer when napari closes the dock, which removes the widget from the window."""
        if event.type() == QEvent.Type.ParentChange and self.parent() is None:
            self._release()
        return bool(super().event(event))

    def _release(self) -> None:
        """Cancel the running task, and stop following the viewer."""


class TaskDock(Dock):
    """A dock that runs one task at a time in another thread."""

    def __init__(self) -> None:
        super().__init__()
        self._worker: JobWorker | None = None
        self._has_failed = False  # and the dock shows the error

    def _follow_edits(self, form: QWidget) -> None:
        """Clear the message of an error when a field of a form or its layer changes, because it may no longer apply."""
        for field in form.findChildren(QWidget):
            for signal in _EDITS:
                if hasattr(field, signal):
                    getattr(field, signal).connect(self._forget_error)

    def _forget_error(self) -> None:
        if self._has_failed:
            self._has_failed = False
            self._show_message("")

    def _work(self, work: Callable[[Progress], Any], stage: str, returned: Callable[[Any], None]) -> None:
        """Run a task in another thread, unless one is running."""
        if self._worker is not None:
            return
        worker = JobWorker(work, stage)
        worker.returned.connect(returned)
        worker.errored.connect(self._on_errored)
        worker.finished.connect(self._on_finished)
        self.destroyed.connect(worker.quit)  # when the window is closed
        self._worker = worker
        self._has_failed = False
        self._show_work(stage)
        worker.start()

    def _show_work(self, stage: str | None) -> None:
        """Show the name of the running task, or nothing if it is None."""

    def _show_message(self, message: str) -> None:
        """Show a message in the dock."""

    def _on_errored(self, error: Exception) -> None:
        if not isinstance(error, Cancelled):
            self._fail(error)

    def _on_finished(self) -> None:
        self._worker = None
        self._show_work(None)

    def _fail(self, error: Exception) -> None:
        message = error_text(error)
        self._show_message(message)
        self._has_failed = True
        show_error(message)

    def _release(self) -> None:
        if self._worker is not None and not self._worker.abort_requested:
            self._worker.quit()
            show_info(f"{self._worker.title}: cancelled, because its dock was closed. Open the dock and start it again")
