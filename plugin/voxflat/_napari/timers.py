"""Time for the window to live: how long between two steps, and timers that are started again and again."""

from collections.abc import Callable
from typing import Any

from qtpy.QtCore import QObject, QTimer

PAUSE = 10
"""Between two steps, ms: what is posted at once would be done in one go with what the last step has to have drawn."""


def single_shot(parent: QObject, pause: int, act: Callable[[], Any]) -> QTimer:
    """Return a timer that, once started, acts after a pause, ms: several starts until then are one."""
    timer = QTimer(parent)
    timer.setSingleShot(True)
    timer.setInterval(pause)
    timer.timeout.connect(act)
    return timer
