"""The button that copies a run as a Python script."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from napari.utils.notifications import show_error, show_info
from qtpy.QtWidgets import QApplication, QFileDialog, QPushButton, QWidget

from voxflat.errors import VoxflatError

if TYPE_CHECKING:
    from voxflat._napari.results.run import Run


class CopyAsPython(QPushButton):
    """Copies the script that makes a run again to the clipboard."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__("Copy as Python", parent)
        self._run: Run | None = None
        self.setToolTip("A script that makes the same map without a window")
        self.clicked.connect(self.copy)
        self.hide()

    def show_run(self, run: Run) -> None:
        """Offer the script of a run, if it has one: what was opened from a file has none."""
        self._run = run
        self.setVisible(run.script is not None)

    def copy(self) -> None:
        """Copy the script; ask where data shall lie that are in no file."""
        recipe = None if self._run is None else self._run.script
        if recipe is None:
            return
        try:
            folder = None
            if recipe.needs_folder():
                chosen = QFileDialog.getExistingDirectory(self, "Where to save layers that lie in no file")
                if not chosen:
                    return
                folder = Path(chosen)
            script = recipe.script(folder)
        except (VoxflatError, OSError) as error:
            show_error(" ".join(str(error).split()))
            return
        clipboard = QApplication.clipboard()
        assert clipboard is not None
        clipboard.setText(script)
        show_info("copied: paste it into a file, and run it by Python")
