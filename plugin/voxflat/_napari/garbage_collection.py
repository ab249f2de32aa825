"""Python's full collections of garbage wait while a job runs and layers come.

One takes 0.1 to 0.3 s with napari's modules in memory, and comes in whatever thread happens to make the next object:
for so long the window stands still. They come when nothing goes on any more, or soon after.
"""

import gc
from typing import ClassVar

from qtpy.QtCore import QObject, Qt, QTimer
from qtpy.QtGui import QCursor, QGuiApplication
from qtpy.QtWidgets import QApplication

_LOOK = 1000  # ms between two looks at whether all is at rest
_LOOKS = 10  # then it is left to Python again
_PATIENCE = 100  # times as much garbage as usual, and Python collects meanwhile, too


def defer_collections() -> None:
    """Have full collections wait until nothing goes on, for ten seconds at most unless this is called again.

    Whoever asks for a collection gets it at once, as napari does when a layer goes. A Python that collects in small
    steps, and one that was told not to collect, are left alone.
    """
    application = QApplication.instance()
    if _Deferral.one is not None:
        _Deferral.one.looks = 0
    elif application is not None and gc.isenabled() and gc.get_threshold()[2] > 0:
        _Deferral.one = _Deferral(application)


class _Deferral(QObject):
    """Waits until the mouse rests and Python makes nothing, and collects what Python would have collected."""

    one: ClassVar["_Deferral | None"] = None

    def __init__(self, parent: QObject) -> None:
        super().__init__(parent)
        self.looks = 0
        self._usual = gc.get_threshold()
        self._ours = (*self._usual[:2], self._usual[2] * _PATIENCE)
        self._before: object = None
        gc.set_threshold(*self._ours)
        timer = QTimer(self)
        timer.timeout.connect(self.look)
        timer.start(_LOOK)

    def look(self) -> None:
        """See whether all is at rest."""
        _, young, old = gc.get_count()
        now = (QCursor.pos(), young, old)
        is_at_rest = now == self._before and QGuiApplication.mouseButtons() == Qt.MouseButton.NoButton
        is_at_rest = is_at_rest and self.looks > 0  # nothing has come since the last look
        self._before = now
        self.looks += 1
        if is_at_rest and old > self._usual[2] and gc.isenabled():
            gc.collect()
        if is_at_rest or self.looks >= _LOOKS:
            self._end()

    def _end(self) -> None:
        """Leave it to Python again."""
        if gc.get_threshold() == self._ours:  # nobody else has set it
            gc.set_threshold(*self._usual)
        type(self).one = None
        self.deleteLater()
