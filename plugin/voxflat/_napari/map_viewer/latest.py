"""Work outside the GUI's thread of which only the latest matters."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from qtpy.QtCore import QObject, Signal  # type: ignore[attr-defined]  # qtpy makes it of pyqtSignal

from voxflat._napari.errand import Errand


class Latest(QObject):
    """Does one thing at a time in a thread; of what is asked for meanwhile, only the last."""

    done = Signal(object)
    """What was asked for last is done; with what it returned."""

    failed = Signal(object)
    """It ended with this error."""

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._worker: Errand | None = None
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
        self._worker = worker = Errand(work)
        worker.returned.connect(self._on_returned)
        worker.errored.connect(self._on_errored)
        worker.finished.connect(self._on_finished)
        worker.start()

    def stop(self) -> None:
        """Tell nobody of what is under way."""
        self._next = None
        if self._worker is not None:
            for signal, slot in (
                (self._worker.returned, self._on_returned),
                (self._worker.errored, self._on_errored),
                (self._worker.finished, self._on_finished),
            ):
                signal.disconnect(slot)
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
