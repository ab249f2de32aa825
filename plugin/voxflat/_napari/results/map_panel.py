"""The panel with the results: the measures of the flat map, warnings, and buttons to save it."""

from collections.abc import Callable
from html import escape
from pathlib import Path

from napari.utils.notifications import show_error, show_info
from qtpy.QtCore import Qt
from qtpy.QtWidgets import QApplication, QFileDialog, QGridLayout, QLabel, QPushButton, QVBoxLayout, QWidget

from voxflat._napari.docks import arrange, plain_label
from voxflat._napari.notifications import showing_warnings
from voxflat._napari.results.flat_layers import Run
from voxflat._napari.results.maps import HEAT_MEANING
from voxflat._napari.results.report import MEANINGS, as_html, figures, table, warnings
from voxflat._napari.results.session import session_of
from voxflat._napari.wording import error_text
from voxflat.atlases.atlas import Atlas
from voxflat.errors import VoxflatError
from voxflat.io.files import SAVED_ENDINGS
from voxflat.maps.flat_map import FlatMap


class MapPanel(QWidget):
    """Shows the measures, the meaning of the colours, and the warnings of a "map" or an "atlas"."""

    def __init__(self, *, meaning: str = HEAT_MEANING, what: str = "map") -> None:
        super().__init__()
        self._what, self.shows_maps = what, what == "map"
        self.flat_map: FlatMap | Atlas | None = None
        self.write: Callable[[FlatMap | Atlas, str], None]  # saves a map with its drawings
        self._figures = QGridLayout()
        self._figures.setColumnStretch(0, 1)
        self._figures.setVerticalSpacing(2)
        self.title, self.warnings = QLabel(), QLabel()
        colours = QLabel(f"The heat map shows {meaning}.")
        for text in (self.title, self.warnings, colours):
            text.setWordWrap(True)
            text.setTextFormat(Qt.TextFormat.RichText)
        self.save = QPushButton(f"Save {what}…")
        self.save.setToolTip(f"Save the {what} with all its data. The file can be opened in napari and in Python")
        self.save.clicked.connect(self._on_save)
        self.settings = QPushButton()
        self.copy = CopyAsPython()
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        arrange(layout, self.title, self.warnings, self._figures, colours, self.save, self.settings, self.copy)
        self.hide()

    def show_run(self, run: Run) -> None:
        self.flat_map = run.flat_map
        self.copy.show_run(run)
        self._name_result("")
        self._show_figures(run.flat_map)
        self._show_warnings(warnings(run.layers))
        self.show()

    def show_earlier(self) -> None:
        """State that the results belong to an earlier run, because the last run failed or was cancelled."""
        if self.flat_map is not None:
            self._name_result("Previous result: ")

    def _name_result(self, before: str) -> None:
        assert self.flat_map is not None
        of = session_of(self.flat_map).layer
        self.title.setText(f"{before}{self._what.capitalize()} of <b>{escape(of)}</b>")

    def _show_figures(self, flat_map: FlatMap | Atlas) -> None:
        while item := self._figures.takeAt(0):
            if widget := item.widget():
                widget.deleteLater()
        for row, (name, value) in enumerate(figures(flat_map)):
            label, number = plain_label(name), plain_label(value)
            number.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
            label.setToolTip(MEANINGS.get(name, ""))
            self._figures.addWidget(label, row, 0)
            self._figures.addWidget(number, row, 1, Qt.AlignmentFlag.AlignRight)
        self.setToolTip(f"<pre>{escape(table(flat_map))}</pre>")

    def _show_warnings(self, found: list[str]) -> None:
        self.warnings.setText(as_html(found))
        self.warnings.setVisible(bool(found))

    def _on_save(self) -> None:
        numpys, own = SAVED_ENDINGS  # napari first tries its own reader of .npz, which fails
        kinds = f"voxflat (*{own});;NumPy (*{numpys})"
        path, _ = QFileDialog.getSaveFileName(self, f"Save the {self._what}", f"{self._what}{own}", kinds)
        if path and self.flat_map is not None:
            try:
                with showing_warnings():
                    self.write(self.flat_map, path if path.endswith(SAVED_ENDINGS) else f"{path}{own}")
            except (VoxflatError, OSError) as error:
                show_error(error_text(error))


class CopyAsPython(QPushButton):
    """Copies a script that repeats a run to the clipboard."""

    def __init__(self) -> None:
        super().__init__("Copy as Python")
        self._run: Run | None = None
        self.setToolTip("Copy a Python script that computes this map, or loads it if it was opened, to the clipboard")
        self.clicked.connect(self.copy)

    def show_run(self, run: Run) -> None:
        self._run = run

    def copy(self) -> None:
        """Copy the script, and ask for a folder if any data are not in a file."""
        recipe = None if self._run is None else self._run.script
        if recipe is None:
            return
        try:
            folder = None
            if recipe.needs_folder():
                title = "Choose a folder for the data that are not in a file"
                chosen = QFileDialog.getExistingDirectory(self, title)
                if not chosen:
                    return
                folder = Path(chosen)
            script = recipe.script(folder)
        except (VoxflatError, OSError) as error:
            show_error(error_text(error))
            return
        clipboard = QApplication.clipboard()
        assert clipboard is not None
        clipboard.setText(script)
        show_info("The script is on the clipboard. Paste it into a file, then run the file with Python")
