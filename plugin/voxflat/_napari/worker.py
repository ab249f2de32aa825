"""Background tasks that keep napari responsive and show their progress in napari's activity dock."""

import atexit
from collections.abc import Callable
from functools import cache
from typing import Any, ClassVar

from napari.qt.threading import WorkerBase, WorkerBaseSignals
from napari.utils import cancelable_progress
from qtpy.QtCore import QObject, QTimer, Signal  # type: ignore[attr-defined]  # qtpy makes it of pyqtSignal
from qtpy.QtWidgets import QApplication, QLabel, QMainWindow

from voxflat._napari.garbage_collection import defer_collections
from voxflat._napari.notifications import show_warnings
from voxflat._napari.timers import PAUSE
from voxflat.arguments import Progress, collecting_warnings

POLL_INTERVAL = 250  # interval between two updates of the progress, ms; every change redraws the complete window

_CANCEL_INTERVAL = 50  # ms between checks of whether a task has been cancelled
_SPINNER_SPEED = 12  # per cent; four frames per second


class _Signals(WorkerBaseSignals):  # type: ignore[misc]  # napari's type is Any
    logged = Signal(object)  # emitted with the warnings that were logged


class BackgroundTask(WorkerBase):  # type: ignore[misc]  # napari's type is Any
    """Calls a function in a thread of Qt's thread pool.

    When napari closes, it waits for all threads except one that is just starting; Python waits for that thread before
    it exits. The signals of such a thread are deleted, and an exception from `run` would end the process.
    """

    def __init__(self, function: Callable[[], Any], logged: Callable[[list[str]], None] = show_warnings) -> None:
        """Create a task; `logged` is called with the warnings that it logs, in the GUI thread."""
        super().__init__(SignalsClass=_Signals)
        self._function = function
        self.signals.logged.connect(logged)
        _wait_at_exit()

    def work(self) -> Any:
        with collecting_warnings() as warnings:
            try:
                return self._function()
            finally:
                if warnings and not self.abort_requested:
                    self.signals.logged.emit(warnings)

    def run(self) -> None:
        """Do the work and emit the signals in the thread."""
        try:
            super().run()
        except RuntimeError:
            try:
                self.signals.objectName()
            except RuntimeError:
                return  # the signals have been deleted
            raise


@cache
def _wait_at_exit() -> None:
    """Make Python stop the threads, and wait for them, before it exits."""
    atexit.register(WorkerBase.await_workers)


class LatestTask(QObject):
    """Runs one task at a time in a thread; if several tasks are requested meanwhile, only the last one is run."""

    done = Signal(object)  # emitted with the result of the task that was requested last
    failed = Signal(object)  # emitted with the error of the task that was requested last

    def __init__(self, parent: QObject, done: Callable[[Any], None], failed: Any) -> None:
        super().__init__(parent)
        self.done.connect(done)
        self.failed.connect(failed)
        self._worker: BackgroundTask | None = None
        self._next: Callable[[], Any] | None = None
        self._reported: set[str] = set()  # because the same task is often repeated

    @property
    def is_busy(self) -> bool:
        return self._worker is not None

    def ask(self, work: Callable[[], Any]) -> None:
        """Run a task, which must not use widgets or layers; the result of a task that is still running is discarded."""
        if self._worker is not None:
            self._next = work
            return
        self._worker = worker = BackgroundTask(work, self._on_warned)
        worker.returned.connect(self._on_returned)
        worker.errored.connect(self._on_errored)
        worker.finished.connect(self._on_finished)
        worker.start()

    def stop(self) -> None:
        """Discard the result of the running task."""
        self._next = None
        if self._worker is not None:
            self._worker.returned.disconnect(self._on_returned)
            self._worker.errored.disconnect(self._on_errored)
            self._worker.finished.disconnect(self._on_finished)
            self._worker.quit()
            self._worker = None

    def _on_warned(self, warnings: list[str]) -> None:
        show_warnings(warning for warning in warnings if warning not in self._reported)
        self._reported.update(warnings)

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
    """A task with progress in napari's activity dock, which emits errors and can be cancelled by `quit`."""

    def __init__(self, work: Callable[[Progress], Any], title: str = "voxflat") -> None:
        super().__init__(lambda: work(self._progress))
        self.title = title
        self.stage = ("starting", 0, 1)  # name, completed steps and total steps; any thread may read it

    def start(self) -> None:
        """In the GUI thread, show the progress bar, and start the thread after the window has processed events."""
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
    """The progress bar of a task, shown in napari's activity dock until `end` is called.

    napari animates a spinner beside the bar at 33 frames per second, and each frame redraws the window. Without a
    graphics card, this uses most of a CPU core. The spinner is therefore slowed down to 4 frames per second.
    """

    _count: ClassVar[int] = 0

    def __init__(self, worker: JobWorker) -> None:
        super().__init__()
        self._worker = worker
        self._bar = cancelable_progress(total=0, desc=worker.title)
        _Activity._count += 1
        _set_spinner_speed(_SPINNER_SPEED)
        self._looks = 0
        self._timer = QTimer(self)
        self._timer.setInterval(_CANCEL_INTERVAL)
        self._timer.timeout.connect(self._look)
        self._timer.start()

    def _look(self) -> None:
        defer_collections()
        if self._bar.is_canceled:
            self._worker.quit()
        self._looks += 1
        if self._looks % (POLL_INTERVAL // _CANCEL_INTERVAL) == 0:
            self._show()

    def _show(self) -> None:
        stage, done, total = self._worker.stage
        total = total if total > 1 else 0  # 0 shows a busy indicator
        described = f"{self._worker.title}: {stage}"
        if self._bar.desc != f"{described}: ":
            self._bar.set_description(described)
        if self._bar.total != total:
            self._bar.total = total
        if total:
            self._bar.update(done - self._bar.n)

    def end(self) -> None:
        self._timer.stop()
        self._bar.close()
        _Activity._count -= 1
        if _Activity._count == 0:
            _set_spinner_speed(100)


def _set_spinner_speed(percent: int) -> None:
    for window in QApplication.topLevelWidgets():
        if isinstance(window, QMainWindow):
            bar = window.statusBar()
            for label in [] if bar is None else bar.findChildren(QLabel):
                if (spinner := label.movie()) is not None:
                    spinner.setSpeed(percent)
