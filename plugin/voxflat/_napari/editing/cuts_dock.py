"""The widget of *Layers → Transform → Draw cuts*."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from app_model.types import KeyCode, KeyMod
from napari import Viewer
from napari.layers import Layer
from napari.utils.notifications import show_info
from qtpy.QtCore import Qt
from qtpy.QtWidgets import (
    QAbstractItemView,
    QFileDialog,
    QHeaderView,
    QPushButton,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
)

from voxflat._napari.docks import TaskDock, arrange, grid, plain_label
from voxflat._napari.editing.cut_layers import CutLayers
from voxflat._napari.editing.cut_tasks import Found, cuts_of_map, evaluate_cuts, find_cuts, make_surface, save_template
from voxflat._napari.editing.cuts_form import CutsForm
from voxflat._napari.editing.drawing import Drawing, Drawn
from voxflat._napari.keys import Keys, key_text
from voxflat._napari.layers.seed import first_vertex
from voxflat._napari.layers.world import data_to_world, from_ras, in_units_of, moved, unit_of, unit_ratio
from voxflat._napari.map_viewer.viewer_parts import canvas_widget, fill, is_click
from voxflat._napari.notifications import showing_warnings
from voxflat._napari.viewer_state import DrawnCuts, ViewerState
from voxflat.errors import InputError, VoxflatError
from voxflat.io.grid import rounded
from voxflat.maps.flat_map import FlatMap
from voxflat.surfaces.cuts import Cut, save_cuts

_UNDO, _REDO = KeyMod.CtrlCmd | KeyCode.KeyZ, KeyMod.CtrlCmd | KeyMod.Shift | KeyCode.KeyZ
_END_CUT = KeyMod.Shift | KeyCode.KeyX
_COLUMNS = ("cut", "length", "gain")


class DrawCuts(TaskDock):
    """Lets the user draw cuts by clicking on the surface in 3D."""

    def __init__(self, napari_viewer: Viewer) -> None:
        super().__init__()
        self._viewer = napari_viewer
        self._layer: Layer | None = None  # the layer that is cut
        self._foreground: dict[str, Any] = {}  # the foreground of a volume
        self.drawing: Drawing | None = None
        self._layers: CutLayers | None = None
        self._evaluated: tuple[Drawn, ...] = ()
        self._known = ""  # where the first cuts come from
        self.form = CutsForm(napari_viewer)
        self.begin = self._button("Begin", "Show the surface in 3D, to draw cuts on it", self._on_begin)
        tip = "Click on the surface. The clicked points are connected by shortest paths, along which the surface is cut"
        self.draw = self._button("Draw", tip)
        self.draw.setCheckable(True)
        self.draw.toggled.connect(self._on_draw)
        tip = f"Begin a new cut with the next click ({key_text(_END_CUT)})"
        self.end_cut = self._button("Next cut", tip, partial(self._do, Drawing.end_cut))
        tip = f"Undo the last step ({key_text(_UNDO)})"
        self.undo = self._button("Undo", tip, partial(self._do, Drawing.undo))
        tip = f"Redo the last step that was undone ({key_text(_REDO)})"
        self.redo = self._button("Redo", tip, partial(self._do, Drawing.redo))
        self.remove = self._button("Remove", "Remove the selected cut", self._on_remove)
        tip = "Start with cuts that are the same for every brain"
        self.standard = self._button("Standard", tip, partial(self._find, "standard"))
        tip = "Start with cuts optimised for this surface"
        self.automatic = self._button("Automatic", tip, partial(self._find, "automatic"))
        self.from_map = self._button("From map", "Start with the cuts of the displayed map", self._from_map)
        tip = "Estimate how much larger the distance error would be without each cut. Takes a few seconds per cut"
        self.evaluate = self._button("Evaluate", tip, self._on_evaluate)
        tip = "Save the cuts in a file, which can also be used in Python and on the command line"
        self.save = self._button("Save…", tip, self._on_save)
        self.load = self._button("Load…", "Load a cuts file or a template", self._on_load)
        self.template = self._button("Save template…", "Save these cuts for use on every brain", self._on_save_template)
        self.use = self._button("Use for Flatten surface", "Select these cuts in the form", self._on_use)
        tip = "Flatten with these cuts, starting from the displayed map, so that the new map keeps its position. "
        tip += "These cuts must include all cuts of the displayed map"
        self.again = self._button("Flatten again", tip, self._on_again)
        self.cuts = QTableWidget(0, len(_COLUMNS))
        self.cuts.setHorizontalHeaderLabels(_COLUMNS)
        self.cuts.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.cuts.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self.cuts.setMinimumHeight(100)
        header, rows = self.cuts.horizontalHeader(), self.cuts.verticalHeader()
        assert header is not None
        assert rows is not None
        header.setSectionResizeMode(0, QHeaderView.ResizeMode.Stretch)
        rows.hide()
        self.status = plain_label("Choose a surface, then press Begin.")
        self.status.setWordWrap(True)
        above = (self.draw, self.end_cut, self.undo, self.redo, self.standard, self.automatic, self.from_map, self.load)
        below = (self.remove, self.evaluate, self.save, self.template, self.use, self.again)
        parts = (self.form, self.begin, grid(above, 4), (self.cuts, 1), grid(below, 2), self.status)
        arrange(QVBoxLayout(self), *parts)
        buttons = {_UNDO: self.undo, _REDO: self.redo, _END_CUT: self.end_cut}
        ViewerState.of(napari_viewer).changed.connect(self._enable)
        self._follow_edits(self.form)
        self._keys = Keys(napari_viewer, self, {key: button.click for key, button in buttons.items()})
        self.form.restored.connect(self._show_message)
        self._update()

    def _button(self, text: str, tip: str, pressed: Callable[[], None] | None = None) -> QPushButton:
        button = QPushButton(text)
        button.setToolTip(tip)
        if pressed is not None:
            button.clicked.connect(lambda: pressed())
        return button

    # ---------------------------------------------------------------------------------------- beginning

    def _on_begin(self) -> None:
        try:
            layer = self.form.layer()
            source, foreground = self.form.source()
        except VoxflatError as error:
            self._fail(error)
            return
        self._end()
        self._layer, self._foreground = layer, foreground
        self._work(partial(make_surface, source, foreground), "extracting the surface", self._on_made)

    def _on_made(self, prepared: tuple[Any, Any]) -> None:
        surface, curvature = prepared
        if self._layer is None or self._layer not in self._viewer.layers:
            self.status.setText("The layer was removed. Choose another layer, then press Begin.")
            return
        drawing = Drawing.on(self._layer, surface)
        drawing.restore(ViewerState.of(self._viewer).record_of(surface))
        self._known = "The cuts that you drew earlier on this surface are back. " if drawing.cuts else ""
        if not (drawing.can_undo or drawing.can_redo) and (flat_map := self._map()) is not None:
            with suppress(InputError):  # the map is of another surface
                drawing.set_cuts(*cuts_of_map(surface, flat_map))
                self._known = "These are the cuts of the displayed map. "
        world = self.form.world.currentData()
        shown_on = self.form.shown_on.layer
        if shown_on is None:
            places = from_ras(drawing.points, world)
            unit = None if str(self._layer.units[-1]) == "pixel" else unit_of(self._layer)
        else:  # such as the inflated surface, which has the same vertices
            places = moved(np.asarray(shown_on.vertices)[surface.vertices], data_to_world(shown_on))
            unit = None if str(shown_on.units[0]) == "pixel" else str(shown_on.units[0])
        self.drawing = drawing
        self._layers = CutLayers(self._viewer, drawing, curvature, places, unit, self._layer.name, world, self)
        self._layers.appeared.connect(self._on_appeared)
        self._enable()

    def _on_appeared(self) -> None:
        if self._layers is None:
            return
        canvas, units = canvas_widget(self), self._viewer.layers.units
        if canvas is not None:
            ratio = 1.0 if units is None else unit_ratio(self._layers.surface.units, units[-3:])
            size = canvas.width(), canvas.height()
            fill(self._viewer, ratio * self._layers.places, size, self.form.world.currentData())
        self.draw.setChecked(True)
        self._update(f"{self._known}Click on the surface where a cut begins, then where it continues.")

    # ------------------------------------------------------------------------------------------ drawing

    def _on_draw(self, active: bool) -> None:
        callbacks = self._viewer.mouse_drag_callbacks
        if active and self._on_click not in callbacks:
            callbacks.append(self._on_click)
        elif not active and self._on_click in callbacks:
            callbacks.remove(self._on_click)

    def _on_click(self, viewer: Viewer, event: Any) -> Iterator[None]:
        """Add a point where the mouse is clicked without being moved."""
        if not (yield from is_click(event)):
            return
        if self._layers is None or not self._layers.is_there or self.drawing is None or viewer.dims.ndisplay != 3:
            return
        layer = self._layers.surface
        place = in_units_of(layer, event.position, viewer.layers.units)
        start, end = layer.get_ray_intersections(place, event.view_direction, event.dims_displayed)
        vertex = None if start is None else first_vertex(layer, start, end)
        if vertex is not None:
            self._do(lambda drawing: drawing.add_stop(vertex))

    def _on_remove(self) -> None:
        row = self.cuts.currentRow()
        if self.drawing is not None and 0 <= row < len(self.drawing.cuts):
            self._do(lambda drawing: drawing.remove(row))

    def _do(self, step: Callable[[Drawing], None]) -> None:
        if self.drawing is None:
            return
        try:
            step(self.drawing)
        except VoxflatError as error:
            self._fail(error)
            return
        self._update()

    # ------------------------------------------------------------------------------------- automatic cuts

    def _on_load(self) -> None:
        path, _ = QFileDialog.getOpenFileName(self, "Load cuts", "", "cuts (*.json)")
        if path:
            self._find(path)

    def _find(self, by: str) -> None:
        if self.drawing is not None:
            self._work(partial(find_cuts, self.drawing.surface, by), "finding cuts", self._on_found)

    def _map(self) -> FlatMap | None:
        return ViewerState.of(self._viewer).map_of(self._layer)

    def _from_map(self) -> None:
        if self.drawing is not None and (flat_map := self._map()) is not None:
            self._on_found(cuts_of_map(self.drawing.surface, flat_map))

    def _on_found(self, cuts: Found) -> None:
        self._do(lambda drawing: drawing.set_cuts(*cuts))

    def _on_evaluate(self) -> None:
        if self.drawing is not None and (paths := self.drawing.paths()):
            work = partial(evaluate_cuts, self.drawing.surface, paths, self.drawing.left_out)
            self._evaluated = self.drawing.cuts
            self._work(work, "evaluating the cuts", self._on_evaluated)

    def _on_evaluated(self, evaluation: tuple[float, list[float]]) -> None:
        """Show the gain of each cut, unless the cuts have changed."""
        if self.drawing is None or self.drawing.cuts != self._evaluated:
            self.status.setText("The cuts have changed during the evaluation. Evaluate them again.")
            return
        error, gains = evaluation
        rows = [row for row, cut in enumerate(self._evaluated) if cut.is_complete]
        for row, gain in zip(rows, gains, strict=True):
            text = f"{100 * gain:+.1f} %".replace("-", "−") if np.isfinite(gain) else "unknown"
            self.cuts.setItem(row, 2, _cell(text))
        message = f"Estimated distance error with all cuts: {100 * error:.1f} %."
        if not np.isfinite(error):
            message = "With all cuts, the surface is too small to estimate the distance error, so gains are unknown."
        elif not np.isfinite(gains).all():
            message += " Without some of the cuts, the surface is too small, so the gains of these cuts are unknown."
        self.status.setText(message)

    # -------------------------------------------------------------------------------------------- using

    def _on_save(self) -> None:
        path, drawing = self._asked_file("Save the cuts", "cuts.json"), self.drawing
        if path is None or drawing is None:
            return
        cuts = tuple(Cut(ids, None, "given", name) for name, ids in drawing.paths().items())
        try:
            with showing_warnings():
                save_cuts(path, cuts, drawing.left_out, drawing.surface.provenance, overwrite=True)
            show_info(f"Saved {path}")
        except (VoxflatError, OSError) as error:
            self._fail(error)

    def _on_save_template(self) -> None:
        path, drawing = self._asked_file("Save a template of the cuts", "template.json"), self.drawing
        if path is None or drawing is None:
            return
        work = partial(save_template, drawing.surface, drawing.paths(), drawing.left_out, path)
        self._work(work, "computing the template", self._on_template)

    def _on_template(self, path: Path) -> None:
        self.status.setText(f"Saved {path}, a template that makes the same cuts on every brain.")

    def _asked_file(self, title: str, name: str) -> Path | None:
        path, _ = QFileDialog.getSaveFileName(self, title, name, "cuts (*.json)")
        return Path(path).with_suffix(".json") if path else None

    def _on_use(self) -> None:
        if self.drawing is not None and self._layer is not None:
            self._viewer.window.add_plugin_dock_widget(
                "voxflat", "Flatten surface", tabify=True
            )  # opens it if necessary
            drawn = DrawnCuts(self.drawing.paths(), self.drawing.left_out, self.drawing.sphere)
            ViewerState.of(self._viewer).set_cuts(self._layer, drawn)
            self.status.setText(f"Flatten surface will use these cuts for '{self._layer.name}'.")

    def _on_again(self) -> None:
        self._on_use()
        ViewerState.of(self._viewer).flatten_requested.emit(self._layer, self._foreground)

    def _show_work(self, stage: str | None) -> None:
        if stage is not None:
            self.status.setText(f"{stage[:1].upper()}{stage[1:]}…")
        self._enable()

    def _show_message(self, message: str) -> None:
        self.status.setText(message)

    def _update(self, status: str | None = None) -> None:
        self._has_failed = False  # the status is no longer an error
        cuts = () if self.drawing is None else self.drawing.cuts
        self.cuts.setRowCount(len(cuts))
        for row, cut in enumerate(cuts):
            assert self.drawing is not None
            for column, text in enumerate((self.drawing.title(cut), self._length(cut), "")):
                self.cuts.setItem(row, column, _cell(text))
        if self._layers is not None and self._layers.is_there:
            self._layers.update()
        if self.drawing is not None:
            ViewerState.of(self._viewer).keep_record(self.drawing.surface, self.drawing.record())
            total = self._length(*cuts)
            self.status.setText(status or f"{len(cuts)} cut{'s' * (len(cuts) != 1)}, {total} in total.")
        self._enable()

    def _length(self, *cuts: Any) -> str:
        """Return the length of cuts in total, with its unit."""
        assert self.drawing is not None
        unit = "mm" if self._layer is None else unit_of(self._layer)
        return f"{rounded(sum(map(self.drawing.length, cuts)))} {unit}"

    def _enable(self) -> None:
        drawing = self.drawing
        idle = self._worker is None and not (self._layers is not None and self._layers.is_coming)
        self.begin.setEnabled(idle)
        idle = idle and drawing is not None
        has_cuts = drawing is not None and bool(drawing.cuts)
        is_mapped = self._map() is not None
        for button in (self.draw, self.standard, self.automatic, self.load):
            button.setEnabled(idle)
        for button in (self.remove, self.evaluate, self.save, self.template, self.use):
            button.setEnabled(idle and has_cuts)
        self.from_map.setEnabled(idle and is_mapped)
        self.again.setEnabled(idle and is_mapped and has_cuts)
        for button, state in ((self.end_cut, "is_open"), (self.undo, "can_undo"), (self.redo, "can_redo")):
            button.setEnabled(idle and getattr(drawing, state))

    # -------------------------------------------------------------------------------------------- ending

    def _end(self) -> None:
        self.draw.setChecked(False)
        if self._layers is not None:
            self._layers.remove()
        self._layers = self.drawing = self._layer = None
        self._update()

    def _release(self) -> None:
        super()._release()
        self._keys.release()
        ViewerState.of(self._viewer).changed.disconnect(self._enable, missing_ok=True)
        self.form.release()
        self._end()


def _cell(text: str) -> QTableWidgetItem:
    cell = QTableWidgetItem(text)
    if text[:1] in "+−0123456789":
        cell.setTextAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
    return cell
