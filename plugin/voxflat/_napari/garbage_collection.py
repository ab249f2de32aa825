"""Defer Python's full garbage collection while a job runs and layers are added.

With napari's modules in memory, a full collection takes 0.1 to 0.3 s. It blocks the window, whichever thread triggers
it, and is therefore deferred until the window is idle or a time limit is reached.
"""

import gc
from typing import ClassVar

from qtpy.QtCore import QObject, Qt, QTimer
from qtpy.QtGui import QCursor, QGuiApplication
from qtpy.QtWidgets import QApplication

_LOOK = 1000  # ms between checks of whether the window is idle
_LOOKS = 10  # number of checks after which Python collects garbage as usual
_PATIENCE = 100  # factor by which the collection threshold is increased


def defer_collections() -> None:
    """Defer full collections until the window is idle, for at most ten seconds after the last call.

    Explicit collections, for example by napari when a layer is removed, are not affected. The function does nothing
    in Python versions that collect incrementally, or if garbage collection is disabled.
    """
    application = QApplication.instance()
    if _Deferral.one is not None:
        _Deferral.one.looks = 0
    elif application is not None and gc.isenabled() and gc.get_threshold()[2] > 0:
        _Deferral.one = _Deferral(application)


class _Deferral(QObject):
    """Waits until the mouse is at rest and no objects are created, and then collects garbage."""

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
        _, young, old = gc.get_count()
        now = (QCursor.pos(), young, old)
        is_at_rest = now == self._before and QGuiApplication.mouseButtons() == Qt.MouseButton.NoButton
        is_at_rest = is_at_rest and self.looks > 0  # no deferral was requested since the last check
        self._before = now
        self.looks += 1
        if is_at_rest and old > self._usual[2] and gc.isenabled():
            gc.collect()
        if is_at_rest or self.looks >= _LOOKS:
            self._end()

    def _end(self) -> None:
        """Restore Python's collection thresholds."""
        if gc.get_threshold() == self._ours:  # if no other code has changed the thresholds
            gc.set_threshold(*self._usual)
        type(self).one = None
        self.deleteLater()
