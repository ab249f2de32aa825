"""A function that runs in another thread, which may outlive napari's window."""

from __future__ import annotations

import atexit
from collections.abc import Callable
from functools import cache
from typing import Any

from napari.qt.threading import WorkerBase


class Errand(WorkerBase):  # type: ignore[misc]  # napari's type is Any
    """Calls a function in a thread of Qt's pool.

    napari waits for threads when it closes, but not for one that starts in that moment. Python then waits for it before
    it ends. Such a thread finds its signals deleted; an exception that leaves `run` would end the process.
    """

    def __init__(self, function: Callable[[], Any]) -> None:
        super().__init__()
        self._function = function
        _wait_at_exit()

    def work(self) -> Any:
        """Call the function; called by the thread."""
        return self._function()

    def run(self) -> None:
        """Do the work and emit its signals; called by the thread."""
        try:
            super().run()
        except RuntimeError:
            if not self._is_deleted():
                raise

    def _is_deleted(self) -> bool:
        try:
            self.signals.objectName()
        except RuntimeError:
            return True
        return False


@cache
def _wait_at_exit() -> None:
    """Have Python ask the threads to end, and wait for them, before it ends itself."""
    atexit.register(WorkerBase.await_workers)
