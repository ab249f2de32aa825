"""The widgets of *Layers → Measure*, which report defects of surfaces and the quality of maps."""

from functools import partial
from html import escape
from typing import Any

import numpy as np
from napari import Viewer
from qtpy.QtGui import QFontDatabase
from qtpy.QtWidgets import QPushButton, QTextEdit, QVBoxLayout, QWidget

from voxflat._napari.docks import TaskDock, arrange
from voxflat._napari.forms.layer_form import LayerForm
from voxflat._napari.layers.foreground import surface_of
from voxflat._napari.layers.meshes import LayerMesh
from voxflat._napari.layers.volumes import LayerVolume
from voxflat._napari.layers.world import from_ras
from voxflat._napari.results.outputs import remember, remove_unchanged
from voxflat._napari.results.report import table
from voxflat._napari.results.session import session_of
from voxflat._napari.viewer_state import ViewerState
from voxflat._napari.wording import in_window, sentence
from voxflat.arguments import Progress
from voxflat.distortion.distortion import Distortion
from voxflat.errors import VoxflatError
from voxflat.evaluation.measure import measure
from voxflat.pipeline.check import check
from voxflat.surfaces.findings import Check

_PLACES = {"size": 5, "symbol": "ring", "face_color": "#ff4d4d", "border_color": "#ff4d4d"}
_PLACES |= {"blending": "translucent_no_depth"}  # so that they are visible through the surface in 3D


class Findings(TaskDock):
    """Base class of the widgets, with a button that starts the work or cancels it, and a table with the results."""

    def __init__(self, action: str, above: QWidget | None = None) -> None:
        super().__init__()
        self._action = action
        self.start = QPushButton(action)
        self.start.clicked.connect(self._on_start)
        self.table = QTextEdit()
        self.table.setReadOnly(True)
        arrange(QVBoxLayout(self), *([] if above is None else [above]), self.start, self.table)

    def look(self) -> None:
        """Start the work, and show errors."""

    def _show_message(self, message: str) -> None:
        """Show text in a fixed-width font, so that columns are aligned."""
        self.table.setCurrentFont(QFontDatabase.systemFont(QFontDatabase.SystemFont.FixedFont))
        self.table.setPlainText(message)

    def _on_start(self) -> None:
        if self._worker is None:
            self.look()
        else:
            self._worker.quit()

    def _show_work(self, stage: str | None) -> None:
        self.start.setText(self._action if stage is None else "Cancel")
        if stage is not None:
            self.table.setPlainText("")


class CheckSurface(Findings):
    """Reports the defects that affect the flattening of a surface, and marks their locations."""

    def __init__(self, napari_viewer: Viewer) -> None:
        self.form = LayerForm(napari_viewer)
        self.form._add_rows(("World axes", self.form.world))
        self.form._on_surface()
        super().__init__("Check", self.form)
        self._follow_edits(self.form)
        self._viewer = napari_viewer
        ViewerState.of(napari_viewer)  # prevents crashes when layers are removed
        self._origin: dict[str, str] = {}
        self._unit = "mm"
        self.form.restored.connect(self._on_restored)

    def _on_restored(self, message: str) -> None:
        if not self._origin:  # the table shows no results yet
            self._show_message(message)

    def look(self) -> None:
        try:
            source, foreground = self.form.source()
        except VoxflatError as error:
            self._fail(error)
            return
        self._origin, self._unit = source.origin, source.place.unit
        self._work(partial(_checked, source, foreground), self._action, self._show)

    def _release(self) -> None:
        super()._release()
        self.form.release()

    def _show(self, found: Check) -> None:
        cells = "".join(
            f"<tr><td style='padding:2px 8px 2px 0'>{escape(name)}</td>"
            f"<td style='padding:2px 0'><b>{escape(value)}</b></td></tr>"
            for name, value in [("input", self._origin["layer"]), *found.rows()[1:]]
        )
        items = "".join(f"<li>{escape(sentence(in_window(line)))}</li>" for line in found.advice)
        self.table.setHtml(f"<table>{cells}</table><ul style='margin-left:-24px'>{items}</ul>")  # wraps in the dock
        name = f"defects of {self._origin['layer']}"
        remove_unchanged(self._viewer, name)
        places = [handle["centre"] for handle in found.handles]  # RAS+
        texts = [f"handle (loop of {handle['length']:.1f} {self._unit})" for handle in found.handles]
        if found.thin is not None and found.thin["place"] is not None:
            places.append(found.thin["place"])
            texts.append(f"thinnest part ({found.thin['worst']:.2f} {self._unit})")
        if not places:
            return
        units = None if self._origin["unit"].startswith("pixel") else (self._unit,) * 3
        points = from_ras(np.array(places), self._origin["world_axes"])
        remember(self._viewer.add_points(points, name=name, units=units, features={"finding": texts}, **_PLACES))


def _checked(source: LayerVolume | LayerMesh, foreground: dict[str, Any], progress: Progress) -> Check:
    """Check the surface of a layer; called in a thread."""
    kind = foreground.pop("rim", None)
    if kind is not None:
        return surface_of(source, progress, rim=kind).check(progress=progress)
    return check(source.read(), **foreground, progress=progress)


class MeasureMap(Findings):
    """Shows all measures of the map of the selected layer or current run; also measures patches from other tools."""

    def __init__(self, napari_viewer: Viewer) -> None:
        super().__init__("Measure")
        self._viewer = napari_viewer
        ViewerState.of(napari_viewer).changed.connect(self.look)
        self.look()

    def look(self) -> None:
        layer = self._viewer.layers.selection.active
        about: dict[str, Any] = {} if layer is None else layer.metadata
        run = ViewerState.of(self._viewer).current
        flat_map = about.get("voxflat", None if run is None else run.flat_map)
        if "patch_file" in about:
            files = about["surface_file"], about["patch_file"]
            self._work(lambda progress: measure(*files, progress=progress), self._action, self._show)
        elif flat_map is not None:
            self._show_message(f"{session_of(flat_map).layer}\n\n{table(flat_map)}")
        else:
            self._show_message("There is no flat map. Flatten a surface, open a flat map, or select a flat patch.")

    def _show(self, distortion: Distortion) -> None:
        self._show_message(distortion.table())

    def _release(self) -> None:
        super()._release()
        ViewerState.of(self._viewer).changed.disconnect(self.look, missing_ok=True)
