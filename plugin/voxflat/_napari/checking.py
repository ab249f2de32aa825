"""The widgets of *Layers → Measure*: what keeps a surface from being flattened, and how good maps are."""

from collections.abc import Callable, Sequence
from functools import partial
from html import escape
from typing import Any

import numpy as np
from napari import Viewer
from qtpy.QtGui import QFontDatabase
from qtpy.QtWidgets import QPushButton, QTextEdit, QVBoxLayout, QWidget

from voxflat._napari.forms.layer_form import LayerForm
from voxflat._napari.layers.meshes import LayerMesh
from voxflat._napari.layers.volumes import LayerVolume
from voxflat._napari.layers.world import from_ras
from voxflat._napari.results.report import table
from voxflat._napari.tabs import WorkingDock
from voxflat._napari.workbench import Workbench
from voxflat.arguments import Progress
from voxflat.distortion.distortion import Distortion
from voxflat.errors import VoxflatError
from voxflat.evaluation.measure import measure
from voxflat.pipeline.check import check
from voxflat.surfaces.findings import Check

_PLACES = {
    "size": 5,
    "symbol": "ring",
    "face_color": "#ff4d4d",
    "border_color": "#ff4d4d",
    "blending": "translucent_no_depth",  # in 3D they are seen through the surface
}


class Findings(WorkingDock):
    """A button to find out, which cancels while that is done, and a table of what was found, below what is asked."""

    def __init__(self, action: str, above: QWidget | None = None) -> None:
        super().__init__()
        self._action = action
        self.start = QPushButton(action)
        self.start.clicked.connect(self._on_start)
        self.table = QTextEdit()
        self.table.setReadOnly(True)
        layout = QVBoxLayout(self)
        for part in (above, self.start, self.table):
            if part is not None:
                layout.addWidget(part)

    def look(self) -> None:
        """Start to find out; errors are told."""
        raise NotImplementedError

    def _tell_rows(self, rows: Sequence[tuple[str, str]], advice: Sequence[str]) -> None:
        """Show names and what was found, row by row, in lines as wide as the dock, then what to know and what to do."""
        cells = "".join(
            f"<tr><td style='padding:2px 8px 2px 0'>{escape(name)}</td>"
            f"<td style='padding:2px 0'><b>{escape(value)}</b></td></tr>"
            for name, value in rows
        )
        told = "".join(f"<li>{escape(line)}</li>" for line in advice)
        self.table.setHtml(f"<table>{cells}</table><ul style='margin-left:-24px'>{told}</ul>")

    def _say(self, message: str) -> None:
        """Show a text, or a table of it, column below column."""
        self.table.setCurrentFont(QFontDatabase.systemFont(QFontDatabase.SystemFont.FixedFont))
        self.table.setPlainText(message)

    def _on_start(self) -> None:
        if self._worker is None:
            self.look()
        else:
            self._worker.quit()

    def _find(self, work: Callable[[Progress], Any], found: Callable[[Any], None]) -> None:
        self._work(work, self._action, found)

    def _show_work(self, what: str | None) -> None:
        self.start.setText(self._action if what is None else "Cancel")
        if what is not None:
            self.table.setPlainText("")


class CheckForm(LayerForm):
    """Asks which surface is checked."""

    def __init__(self, viewer: Viewer, parent: QWidget | None = None) -> None:
        super().__init__(viewer, parent)
        self._add_rows(
            (
                ("Surface", self.surface),
                ("Label", self.label),
                ("Threshold", self.threshold),
                ("World axes", self.world),
            )
        )
        self._on_surface()

    def _on_sampled(self) -> None:
        """Nothing is shown on a map here."""


class CheckSurface(Findings):
    """Says what keeps a surface from being flattened, and marks where."""

    def __init__(self, napari_viewer: Viewer) -> None:
        self.form = CheckForm(napari_viewer)
        super().__init__("Check", self.form)
        self._viewer = napari_viewer
        Workbench.of(napari_viewer)  # for what it sees to while layers go
        self._origin: dict[str, str] = {}

    def look(self) -> None:
        """Start to check; errors are told."""
        try:
            source, foreground = self.form.source()
        except VoxflatError as error:
            self._fail(error)
            return
        self._origin = source.origin
        self._find(partial(_checked, source, foreground), self._show)

    def _release(self) -> None:
        super()._release()
        self.form.release()

    def _show(self, found: Check) -> None:
        rows = dict(found.rows())
        self._tell_rows([("input", self._origin["layer"]), *list(rows.items())[1:]], found.advice)
        name = f"places to look at in {self._origin['layer']}"
        if name in self._viewer.layers:
            self._viewer.layers.remove(name)
        places, texts = _places(found)
        if not places:
            return
        units = None if self._origin["unit"].startswith("pixel") else ("mm",) * 3
        points = from_ras(np.array(places), self._origin["world_axes"])
        self._viewer.add_points(points, name=name, units=units, features={"finding": texts}, **_PLACES)


def _checked(source: LayerVolume | LayerMesh, foreground: dict[str, Any], progress: Progress) -> Check:
    return check(source.read(), **foreground, progress=progress)


def _places(found: Check) -> tuple[list[Any], list[str]]:
    """Return where handles and the thinnest place are, RAS+ mm, and what each is."""
    places = [handle["centre"] for handle in found.handles]
    texts = [f"handle, {handle['length']:.1f} mm around" for handle in found.handles]
    if found.thin is not None and found.thin["place"] is not None:
        places.append(found.thin["place"])
        texts.append(f"thinnest place, {found.thin['worst']:.2f} mm")
    return places, texts


class MeasureMap(Findings):
    """Tells all figures of the selected layer's map, or of the current run; another tool's flat patch is measured."""

    def __init__(self, napari_viewer: Viewer) -> None:
        super().__init__("Measure")
        self._viewer = napari_viewer
        self.look()

    def look(self) -> None:
        """Tell the figures, or start to measure."""
        layer = self._viewer.layers.selection.active
        about: dict[str, Any] = {} if layer is None else layer.metadata
        run = Workbench.of(self._viewer).current
        flat_map = about.get("voxflat", None if run is None else run.flat_map)
        if "patch_file" in about:
            self._find(partial(_measured, about["surface_file"], about["patch_file"]), self._show)
        elif flat_map is not None:
            self._say(f"{flat_map.metadata['napari']['layer']}\n\n{table(flat_map)}")
        else:
            self._say("No flat map: flatten, open one, or select a flat patch.")

    def _show(self, found: Distortion) -> None:
        self._say(found.table())


def _measured(surface: str, patch: str, progress: Progress) -> Distortion:
    return measure(surface, patch, progress=progress)
