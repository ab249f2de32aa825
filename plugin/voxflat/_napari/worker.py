"""The thread that flattens while napari stays alive."""

from __future__ import annotations

from typing import Any, Protocol

from napari.qt.threading import WorkerBase

from voxflat.arguments import Progress


class Work(Protocol):
    """What a worker does; it knows no layer and no widget."""

    def run(self, progress: Progress) -> Any:
        """Do it, and tell how far it is; where `progress` returns False, stop."""


class JobWorker(WorkerBase):  # type: ignore[misc]  # napari's type is Any
    """Runs a job outside the GUI's thread; `quit` cancels it, which napari also does when it closes.

    Whatever goes wrong is emitted by `errored`, and nothing shows it unasked, as napari's other workers do.

    Parameters
    ----------
    job : Work
        What to do, such as a `Job`.
    """

    def __init__(self, job: Work) -> None:
        super().__init__()
        self._job = job
        self.stage = ("starting", 0, 1)
        """What is being done, and how much of how much of it is done; to be read by any thread at any time."""

    def work(self) -> Any:
        """Run the job; called by the thread."""
        return self._job.run(self._progress)

    def _progress(self, stage: str, done: int, total: int) -> bool:
        self.stage = (stage, done, total)
        return not self.abort_requested
