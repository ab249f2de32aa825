"""The thread that works while napari stays alive, and its progress in napari's activity dock."""

from __future__ import annotations

from typing import Any, ClassVar, Protocol

from napari.utils import cancelable_progress
from qtpy.QtCore import QObject, QTimer
from qtpy.QtWidgets import QApplication, QLabel, QMainWindow

from voxflat._napari.errand import Errand
from voxflat._napari.garbage import put_off_collections
from voxflat._napari.results.listed import BREATH
from voxflat.arguments import Progress

GLANCE = 250
"""Between two looks at a worker, ms: whatever changes has the whole window put together anew."""

_TICK = 50  # ms between two looks at whether it was cancelled
_CALM = 12  # %, four frames a second


class Work(Protocol):
    """What a worker does, such as a `Job`; it knows no layer and no widget."""

    def run(self, progress: Progress) -> Any:
        """Do it, and tell how far it is; where `progress` returns False, stop."""


class JobWorker(Errand):
    """Runs a job outside the GUI's thread; `quit` cancels it, which napari also does when it closes.

    Its progress is shown in napari's activity dock. Whatever goes wrong is emitted by `errored`, and nothing shows it
    unasked, as napari's other workers do.
    """

    def __init__(self, job: Work, title: str = "voxflat") -> None:
        super().__init__(lambda: job.run(self._progress))
        self.job: Any = job
        self.title = title
        self.stage = ("starting", 0, 1)
        """What is being done, and how much of how much of it is done; to be read by any thread at any time."""

    def start(self) -> None:
        """Show the bar, and start the thread when the window has lived since; called in the GUI's."""
        put_off_collections()

        def show() -> None:
            if not self.abort_requested:
                self._activity = _Activity(self)
                self.finished.connect(self._activity.end)
            QTimer.singleShot(BREATH, begin)

        def begin() -> None:
            Errand.start(self)

        QTimer.singleShot(BREATH, show)

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
        put_off_collections()
        if self._bar.is_canceled:
            self._worker.quit()
        self._looks += 1
        if self._looks % (GLANCE // _TICK) == 0:
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
