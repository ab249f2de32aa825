"""What both docks of *Layers → Measure* have in common: a table of text, found in another thread."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from typing import Any

from napari.utils.notifications import show_error
from qtpy.QtCore import QEvent, Signal  # type: ignore[attr-defined]  # qtpy makes it of pyqtSignal
from qtpy.QtGui import QFontDatabase
from qtpy.QtWidgets import QPushButton, QTextEdit, QVBoxLayout, QWidget

from voxflat._napari.tabs import Tab
from voxflat._napari.worker import JobWorker, Work
from voxflat.errors import Cancelled


class Findings(QWidget):
    """A button to find out, which cancels while that is done, and a table of what was found, below what is asked."""

    asked = Signal()
    """Someone wants to find out."""

    def __init__(self, action: str, above: QWidget | None = None) -> None:
        super().__init__()
        Tab(self)
        self._action = action
        self._worker: JobWorker | None = None
        self.start = QPushButton(action)
        self.start.clicked.connect(self._on_start)
        self.table = QTextEdit()
        self.table.setReadOnly(True)
        layout = QVBoxLayout(self)
        for part in (above, self.start, self.table):
            if part is not None:
                layout.addWidget(part)

    def release(self) -> None:
        """Stop following the viewer."""

    def tell_text(self, text: str) -> None:
        """Show a table of text, column below column."""
        self.table.setCurrentFont(QFontDatabase.systemFont(QFontDatabase.SystemFont.FixedFont))
        self.table.setPlainText(text)

    def tell_rows(self, rows: Sequence[tuple[str, str]], advice: Sequence[str]) -> None:
        """Show names and what was found, row by row, in lines as wide as the dock, then what to know and what to do."""
        cells = "".join(
            f"<tr><td style='padding:2px 8px 2px 0'>{escape(name)}</td>"
            f"<td style='padding:2px 0'><b>{escape(value)}</b></td></tr>"
            for name, value in rows
        )
        told = "".join(f"<li>{escape(line)}</li>" for line in advice)
        self.table.setHtml(f"<table>{cells}</table><ul style='margin-left:-24px'>{told}</ul>")

    def _on_start(self) -> None:
        if self._worker is None:
            self.asked.emit()
        else:
            self._worker.quit()

    def _work(self, work: Work, returned: Callable[[Any], None]) -> None:
        """Do it in another thread."""
        worker = JobWorker(work, self._action)
        worker.returned.connect(returned)
        worker.errored.connect(self._on_errored)
        worker.finished.connect(self._on_finished)
        self.destroyed.connect(worker.quit)
        self._worker = worker
        self.start.setText("Cancel")
        self.table.setPlainText("")
        worker.start()

    def _on_errored(self, error: Exception) -> None:
        if not isinstance(error, Cancelled):
            self._fail(error)

    def _on_finished(self) -> None:
        self._worker = None
        self.start.setText(self._action)

    def _fail(self, error: Exception) -> None:
        message = " ".join((str(error) or type(error).__name__).split())
        self.tell_text(message)
        show_error(message)

    def event(self, event: Any) -> bool:
        """End what is under way when napari closes the widget's dock, which takes the widget out of the window."""
        if event.type() == QEvent.Type.ParentChange and self.parent() is None:
            if self._worker is not None:
                self._worker.quit()
            self.release()
        return bool(super().event(event))
