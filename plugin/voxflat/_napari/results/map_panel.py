"""What came out: the flat map's figures, what the user should know, the way back to the surface, and saving."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

from napari.utils.notifications import show_error, show_info
from qtpy.QtCore import Qt, QTimer
from qtpy.QtWidgets import QFileDialog, QGridLayout, QHBoxLayout, QLabel, QPushButton, QVBoxLayout, QWidget

from voxflat._napari.results.flat_layers import FlatLayers
from voxflat._napari.results.map_view import MapView
from voxflat._napari.results.maps import HEAT_MEANING
from voxflat._napari.results.report import figures, table, warnings
from voxflat.atlases.atlas import Atlas
from voxflat.errors import VoxflatError
from voxflat.io.files import SAVED_ENDINGS
from voxflat.maps.flat_map import FlatMap

if TYPE_CHECKING:
    from napari import Viewer


class MapPanel(QWidget):
    """Shows the latest flat map in the viewer, its figures, and what the user should know of it.

    Parameters
    ----------
    viewer : Viewer
        The viewer.
    meaning : str
        What the colours of the distortion mean.
    what : {"map", "atlas"}
        What is shown.
    parent : QWidget, optional
        The widget's parent.
    """

    def __init__(
        self, viewer: Viewer, *, meaning: str = HEAT_MEANING, what: str = "map", parent: QWidget | None = None
    ) -> None:
        super().__init__(parent)
        self._what = what
        self._viewer = viewer
        self.view = MapView(viewer)
        self.flat_map: FlatMap | Atlas | None = None
        self.title = QLabel()
        self.title.setWordWrap(True)
        self.title.setTextFormat(Qt.TextFormat.RichText)
        self._figures = QGridLayout()
        self._figures.setColumnStretch(0, 1)
        self._figures.setVerticalSpacing(2)
        self.warnings = QLabel()
        self.warnings.setWordWrap(True)
        self.warnings.setTextFormat(Qt.TextFormat.RichText)
        colours = QLabel(f"Colours of the distortion: {meaning}.")
        colours.setWordWrap(True)
        self.toggle = QPushButton()
        self.toggle.clicked.connect(self._on_toggle)
        self.save = QPushButton(f"Save {what}…")
        loads = {"map": "voxflat.load()", "atlas": "voxflat.load_atlas()"}[what]
        self.save.setToolTip(f"Everything, for {loads} and to be opened in napari")
        self.save.clicked.connect(self._on_save)
        buttons = QHBoxLayout()
        buttons.addWidget(self.toggle)
        buttons.addWidget(self.save)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self.title)
        layout.addLayout(self._figures)
        layout.addWidget(self.warnings)
        layout.addWidget(colours)
        layout.addLayout(buttons)
        self.hide()
        # amid napari's own work on a layer that goes, to turn the viewer to 3D leaves it drawing what is no more
        self._after_removal = QTimer(self)
        self._after_removal.setSingleShot(True)
        self._after_removal.setInterval(0)
        self._after_removal.timeout.connect(self._without_layers)
        viewer.layers.events.removed.connect(self._on_removed)

    def show_result(self, result: FlatLayers) -> None:
        """Add a flat map's layers, and show them.

        Parameters
        ----------
        result : FlatLayers
            The map.
        """
        self.flat_map = result.flat_map
        self._name_result("")
        self._show_figures(result.flat_map)
        if result.in_space:
            self.show_surface()
            self.view.add_in_space(result.in_space, result.flat_map.metadata["napari"]["layer"])
        self.view.add(result.layers)
        self._name_toggle()
        self.show()

    def show_surface(self) -> None:
        """Show what was shown before the map, if the map is shown."""
        if self.view.shows_map:
            self._on_toggle()

    def show_earlier(self) -> None:
        """Say that what is shown is not of the run that just failed or was cancelled."""
        if self.flat_map is not None:
            self._name_result("Still the earlier one: ")

    def release(self) -> None:
        """Stop following the viewer."""
        self._after_removal.stop()
        self._viewer.layers.events.removed.disconnect(self._on_removed)

    def _name_result(self, before: str) -> None:
        assert self.flat_map is not None
        of = self.flat_map.metadata["napari"]["layer"]
        self.title.setText(f"{before}{self._what.capitalize()} of <b>{escape(of)}</b>")

    def _show_figures(self, flat_map: FlatMap | Atlas) -> None:
        while item := self._figures.takeAt(0):
            if widget := item.widget():
                widget.deleteLater()
        for row, (name, value) in enumerate(figures(flat_map)):
            number = QLabel(value)
            number.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
            self._figures.addWidget(QLabel(name), row, 0)
            self._figures.addWidget(number, row, 1, Qt.AlignmentFlag.AlignRight)
        told = warnings(flat_map)
        self.warnings.setText("".join(f"<p>⚠ {escape(warning)}</p>" for warning in told))
        self.warnings.setVisible(bool(told))
        self.setToolTip(f"<pre>{table(flat_map)}</pre>")

    def _on_toggle(self) -> None:
        (self.view.show_surface if self.view.shows_map else self.view.show_map)()
        self._name_toggle()

    def _name_toggle(self) -> None:
        is_volume = isinstance(self.flat_map, FlatMap) and self.flat_map.is_voxels
        shown = {"map": "map", "atlas": "page"}[self._what]
        self.toggle.setText(f"Show {'volume' if is_volume else 'surface'}" if self.view.shows_map else f"Show {shown}")
        self.toggle.setEnabled(self.view.shows_map or bool(self.view.layers))

    def _on_removed(self) -> None:
        if not self.view.layers:
            self._after_removal.start()

    def _without_layers(self) -> None:
        if not self.view.layers:
            self.show_surface()
            self._name_toggle()

    def _on_save(self) -> None:
        numpys, own = SAVED_ENDINGS  # napari offers .npz to its own reader first, which fails
        kinds = f"voxflat (*{own});;NumPy (*{numpys})"
        path, _ = QFileDialog.getSaveFileName(self, f"Save the {self._what}", f"{self._what}{own}", kinds)
        if path and self.flat_map is not None:
            try:
                path = path if path.endswith(SAVED_ENDINGS) else f"{path}{own}"
                self.flat_map.save(path)
                show_info(f"saved {path}")
            except (VoxflatError, OSError) as error:
                show_error(str(error))
