"""Threads that work while napari stays alive, and may outlive its window; progress in napari's activity dock."""

import atexit
from collections.abc import Callable
from functools import cache
from typing import Any, ClassVar

from napari.qt.threading import WorkerBase
from napari.utils import cancelable_progress
from qtpy.QtCore import QObject, QTimer, Signal  # type: ignore[attr-defined]  # qtpy makes it of pyqtSignal
from qtpy.QtWidgets import QApplication, QLabel, QMainWindow

from voxflat._napari.garbage_collection import defer_collections
from voxflat._napari.timers import PAUSE
from voxflat.arguments import Progress

POLL_INTERVAL = 250
"""Between two looks at a worker, ms: whatever changes has the whole window put together anew."""

_TICK = 50  # ms between two looks at whether it was cancelled
_CALM = 12  # %, four frames a second


class BackgroundTask(WorkerBase):  # type: ignore[misc]  # napari's type is Any
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


class LatestTask(QObject):
    """Does one thing at a time in a thread; of what is asked for meanwhile, only the last."""

    done = Signal(object)
    """What was asked for last is done; with what it returned."""

    failed = Signal(object)
    """It ended with this error."""

    def __init__(self, parent: QObject, done: Callable[[Any], None], failed: Any) -> None:
        super().__init__(parent)
        self.done.connect(done)
        self.failed.connect(failed)
        self._worker: BackgroundTask | None = None
        self._next: Callable[[], Any] | None = None

    @property
    def is_busy(self) -> bool:
        """Whether something is under way."""
        return self._worker is not None

    def ask(self, work: Callable[[], Any]) -> None:
        """Do what touches no widget and no layer, after what is under way, of which nobody is told any more."""
        if self._worker is not None:
            self._next = work
            return
        self._worker = worker = BackgroundTask(work)
        worker.returned.connect(self._on_returned)
        worker.errored.connect(self._on_errored)
        worker.finished.connect(self._on_finished)
        worker.start()

    def stop(self) -> None:
        """Tell nobody of what is under way."""
        self._next = None
        if self._worker is not None:
            self._worker.returned.disconnect(self._on_returned)
            self._worker.errored.disconnect(self._on_errored)
            self._worker.finished.disconnect(self._on_finished)
            self._worker.quit()
            self._worker = None

    def _on_returned(self, result: Any) -> None:
        if self._next is None:
            self.done.emit(result)

    def _on_errored(self, error: Exception) -> None:
        if self._next is None:
            self.failed.emit(error)

    def _on_finished(self) -> None:
        self._worker = None
        work, self._next = self._next, None
        if work is not None:
            self.ask(work)


class JobWorker(BackgroundTask):
    """Does work outside the GUI's thread, told in napari's activity dock; errors are emitted; `quit` cancels it."""

    def __init__(self, work: Callable[[Progress], Any], title: str = "voxflat") -> None:
        super().__init__(lambda: work(self._progress))
        self.title = title
        self.stage = ("starting", 0, 1)
        """What is being done, and how much of how much of it is done; to be read by any thread at any time."""

    def start(self) -> None:
        """Show the bar, and start the thread when the window has lived since; called in the GUI's."""
        defer_collections()

        def show() -> None:
            if not self.abort_requested:
                self._activity = _Activity(self)
                self.finished.connect(self._activity.end)
            QTimer.singleShot(PAUSE, super(JobWorker, self).start)

        QTimer.singleShot(PAUSE, show)

    def _progress(self, stage: str, done: int, total: int) -> bool:
        self.stage = (stage, done, total)
        return not self.abort_requested


class _Activity(QObject):
    """A worker's bar in napari's activity dock, from when it is made until `end`.

    napari turns a wheel beside it 33 times a second, for which the window is put together each time: without a graphics
    card that takes the better part of a core from the work. Meanwhile it turns 4 times a second.
    """

    _count: ClassVar[int] = 0

    def __init__(self, worker: JobWorker) -> None:
        super().__init__()
        self._worker = worker
        self._bar = cancelable_progress(total=0, desc=worker.title)
        _Activity._count += 1
        _turn_wheels(_CALM)
        self._looks = 0
        self._timer = QTimer(self)
        self._timer.setInterval(_TICK)
        self._timer.timeout.connect(self._look)
        self._timer.start()

    def _look(self) -> None:
        defer_collections()
        if self._bar.is_canceled:
            self._worker.quit()
        self._looks += 1
        if self._looks % (POLL_INTERVAL // _TICK) == 0:
            self._show()

    def _show(self) -> None:
        stage, done, total = self._worker.stage
        counted = total > 1
        described = f"{self._worker.title}: {stage}"
        if self._bar.desc != f"{described}: ":
            self._bar.set_description(described)
        if self._bar.total != (total if counted else 0):
            self._bar.total = total if counted else 0  # 0 shows that it goes on
        if counted:
            self._bar.update(done - self._bar.n)

    def end(self) -> None:
        """Take the bar away."""
        self._timer.stop()
        self._bar.close()
        _Activity._count -= 1
        if _Activity._count == 0:
            _turn_wheels(100)


def _turn_wheels(percent: int) -> None:
    """Set the speed of what turns in the status bars."""
    for window in QApplication.topLevelWidgets():
        if isinstance(window, QMainWindow):
            bar = window.statusBar()
            for label in [] if bar is None else bar.findChildren(QLabel):
                if (wheel := label.movie()) is not None:
                    wheel.setSpeed(percent)
