"""Docks of ours: they open as tabs of one place, for two above each other have no room on a small screen."""

from collections.abc import Callable
from typing import Any

from napari.utils.notifications import show_error
from qtpy.QtCore import QEvent, QObject
from qtpy.QtWidgets import QApplication, QDockWidget, QMainWindow, QWidget

from voxflat._napari.timers import single_shot
from voxflat._napari.worker import JobWorker
from voxflat.arguments import Progress
from voxflat.errors import Cancelled

_LATE = 2000  # ms: a dock that is opened later has been made for something else


class Tab(QObject):
    """Opens a widget's dock as a tab beside those of ours that are open; afterwards it stays where one puts it."""

    def __init__(self, widget: QWidget) -> None:
        super().__init__(widget)
        self._widget = widget
        windows = [one for one in QApplication.topLevelWidgets() if isinstance(one, QMainWindow)]
        self._sizes = {id(window): window.size() for window in windows}
        self._soon = single_shot(self, 0, self._join)  # when napari has put the dock somewhere
        widget.installEventFilter(self)
        single_shot(self, _LATE, self._sizes.clear).start()  # until then nobody has resized them

    def eventFilter(self, watched: Any, event: Any) -> bool:  # noqa: N802  # Qt's
        """Wait until the widget is shown for the first time."""
        if event.type() == QEvent.Type.Show:
            self._widget.removeEventFilter(self)
            self._soon.start()
        return False

    def _join(self) -> None:
        dock: QWidget | None = self._widget
        while dock is not None and not isinstance(dock, QDockWidget):
            dock = dock.parentWidget()
        if dock is None or dock.isFloating():
            return
        window = dock.window()
        if not isinstance(window, QMainWindow):
            return
        area = window.dockWidgetArea(dock)
        ours = [
            other
            for other in window.findChildren(QDockWidget)
            if other is not dock
            and other.findChild(Tab) is not None
            and not (other.isHidden() or other.isFloating())
            and window.dockWidgetArea(other) == area
        ]
        if ours:
            window.tabifyDockWidget(ours[-1], dock)
            dock.raise_()
            before, layout = self._sizes.get(id(window)), window.layout()
            if before is not None and layout is not None and not (window.isMaximized() or window.isFullScreen()):
                layout.activate()  # for a moment they lay above each other, which made a small window higher
                window.resize(before)


class Dock(QWidget):
    """What a dock holds; napari makes it, and gives the viewer by the name of a parameter, `napari_viewer`."""

    def __init__(self) -> None:
        super().__init__()
        Tab(self)

    def event(self, event: Any) -> bool:
        """Let go of the viewer when napari closes the dock, which takes the widget out of the window."""
        if event.type() == QEvent.Type.ParentChange and self.parent() is None:
            self._release()
        return bool(super().event(event))

    def _release(self) -> None:
        """End what is under way, and stop following the viewer."""


class TaskDock(Dock):
    """A dock that has things done in another thread, one at a time."""

    def __init__(self) -> None:
        super().__init__()
        self._worker: JobWorker | None = None

    def _work(self, work: Callable[[Progress], Any], what: str, returned: Callable[[Any], None]) -> None:
        """Do it in another thread, unless that is busy."""
        if self._worker is not None:
            return
        worker = JobWorker(work, what)
        worker.returned.connect(returned)
        worker.errored.connect(self._on_errored)
        worker.finished.connect(self._on_finished)
        self.destroyed.connect(worker.quit)  # with the window
        self._worker = worker
        self._show_work(what)
        worker.start()

    def _show_work(self, what: str | None) -> None:
        """Show what is under way, if something is."""
        raise NotImplementedError

    def _show_message(self, message: str) -> None:
        """Show what went wrong."""
        raise NotImplementedError

    def _on_errored(self, error: Exception) -> None:
        if not isinstance(error, Cancelled):
            self._fail(error)

    def _on_finished(self) -> None:
        self._worker = None
        self._show_work(None)

    def _fail(self, error: Exception) -> None:
        message = " ".join((str(error) or type(error).__name__).split())
        self._show_message(message)
        show_error(message)

    def _release(self) -> None:
        if self._worker is not None:
            self._worker.quit()
