"""The thread that works while napari stays alive, and its progress in napari's activity dock."""

from __future__ import annotations

from typing import Any, Protocol

from napari.qt.threading import WorkerBase
from napari.utils import cancelable_progress
from qtpy.QtCore import QObject, QTimer

from voxflat.arguments import Progress

_TICK = 50  # ms between two looks at the worker


class Work(Protocol):
    """What a worker does, such as a `Job`; it knows no layer and no widget."""

    def run(self, progress: Progress) -> Any:
        """Do it, and tell how far it is; where `progress` returns False, stop."""


class JobWorker(WorkerBase):  # type: ignore[misc]  # napari's type is Any
    """Runs a job outside the GUI's thread; `quit` cancels it, which napari also does when it closes.

    Its progress is shown in napari's activity dock. Whatever goes wrong is emitted by `errored`, and nothing shows it
    unasked, as napari's other workers do.

    Parameters
    ----------
    job : Job, PatchesJob or other Work
        What to do.
    title : str
        What is done, for the activity dock.
    """

    def __init__(self, job: Work, title: str = "voxflat") -> None:
        super().__init__()
        self.job: Any = job
        self.title = title
        self.stage = ("starting", 0, 1)
        """What is being done, and how much of how much of it is done; to be read by any thread at any time."""

    def start(self) -> None:
        """Start the thread; called in the GUI's."""
        self._activity = _Activity(self)
        self.finished.connect(self._activity.end)
        super().start()

    def work(self) -> Any:
        """Run the job; called by the thread."""
        return self.job.run(self._progress)

    def _progress(self, stage: str, done: int, total: int) -> bool:
        self.stage = (stage, done, total)
        return not self.abort_requested


class _Activity(QObject):
    """A worker's bar in napari's activity dock, from when it is made until `end`."""

    def __init__(self, worker: JobWorker) -> None:
        super().__init__()
        self._worker = worker
        self._bar = cancelable_progress(total=0, desc=worker.title)
        self._timer = QTimer(self)
        self._timer.setInterval(_TICK)
        self._timer.timeout.connect(self._show)
        self._timer.start()

    def _show(self) -> None:
        if self._bar.is_canceled:
            self._worker.quit()
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
