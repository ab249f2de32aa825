"""Where docks of ours open: as tabs of one place, for two above each other have no room on a small screen."""

from __future__ import annotations

from typing import Any

from qtpy.QtCore import QEvent, QObject, QTimer
from qtpy.QtWidgets import QApplication, QDockWidget, QMainWindow, QWidget

_LATE = 2000  # ms: a dock that is opened later has been made for something else


class Tab(QObject):
    """Opens a widget's dock as a tab beside those of ours that are open; afterwards it stays where one puts it."""

    def __init__(self, widget: QWidget) -> None:
        super().__init__(widget)
        self._widget = widget
        windows = [one for one in QApplication.topLevelWidgets() if isinstance(one, QMainWindow)]
        self._sizes = {id(window): window.size() for window in windows}
        self._soon = QTimer(self)  # when napari has put the dock somewhere
        self._soon.setSingleShot(True)
        self._soon.setInterval(0)
        self._soon.timeout.connect(self._join)
        widget.installEventFilter(self)
        late = QTimer(self)
        late.setSingleShot(True)
        late.timeout.connect(self._sizes.clear)  # until then nobody has resized them
        late.start(_LATE)

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
