"""Defer Python's full garbage collections while a job runs and layers are added.

A full collection takes 0.1 to 0.3 s with napari's modules in memory, and blocks the window, whichever thread triggers
it. It is deferred until the window is idle, or for a limited time.
"""

import gc
from typing import ClassVar

from qtpy.QtCore import QObject, Qt, QTimer
from qtpy.QtGui import QCursor, QGuiApplication
from qtpy.QtWidgets import QApplication

_LOOK = 1000  # ms between two checks whether the window is idle
_LOOKS = 10  # checks; then Python collects as usual again
_PATIENCE = 100  # factor on the threshold at which Python collects nevertheless


def defer_collections() -> None:
    """Defer full collections until the window is idle, for at most ten seconds after the last call.

    Explicit collections, such as those of napari when a layer is removed, are not affected. Nothing is done in Python
    versions that collect incrementally, or if garbage collection is disabled.
    """
    application = QApplication.instance()
    if _Deferral.one is not None:
        _Deferral.one.looks = 0
    elif application is not None and gc.isenabled() and gc.get_threshold()[2] > 0:
        _Deferral.one = _Deferral(application)


class _Deferral(QObject):
    """Waits until the mouse rests and no objects are created, then collects garbage."""

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
        """Check whether the window is idle."""
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
        """Restore the thresholds of Python."""
        if gc.get_threshold() == self._ours:  # no other code has changed them
            gc.set_threshold(*self._usual)
        type(self).one = None
        self.deleteLater()
