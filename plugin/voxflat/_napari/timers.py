"""Timers that keep the window responsive: a pause between steps, and single-shot timers that can be restarted."""

from collections.abc import Callable
from typing import Any

from qtpy.QtCore import QObject, QTimer

PAUSE = 10  # ms between two steps; otherwise, Qt would run the next step before it draws the result of the last one


def single_shot(parent: QObject, pause: int, act: Callable[[], Any]) -> QTimer:
    """Return a timer that calls a function once, `pause` ms after the timer was last started."""
    timer = QTimer(parent)
    timer.setSingleShot(True)
    timer.setInterval(pause)
    timer.timeout.connect(act)
    return timer
