"""The thread that flattens while napari stays alive."""

from __future__ import annotations

from napari.qt.threading import WorkerBase

from voxflat._napari.job import Job, PatchesJob
from voxflat._napari.results.flat_layers import FlatLayers


class JobWorker(WorkerBase):  # type: ignore[misc]  # napari's type is Any
    """Runs a job outside the GUI's thread; `quit` cancels it, which napari also does when it closes.

    Whatever goes wrong is emitted by `errored`, and nothing shows it unasked, as napari's other workers do.

    Parameters
    ----------
    job : Job or PatchesJob
        What to do.
    """

    def __init__(self, job: Job | PatchesJob) -> None:
        super().__init__()
        self._job = job
        self.stage = ("starting", 0, 1)
        """What is being done, and how much of how much of it is done; to be read by any thread at any time."""

    def work(self) -> FlatLayers:
        """Run the job; called by the thread."""
        return self._job.run(self._progress)

    def _progress(self, stage: str, done: int, total: int) -> bool:
        self.stage = (stage, done, total)
        return not self.abort_requested
