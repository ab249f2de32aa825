"""The dock *Flat map*, which shows the map of the current run, linked to its volume or surface."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from app_model.types import KeyCode, KeyMod
from napari import Viewer
from napari.layers import Image, Labels, Surface
from numpy.typing import NDArray
from qtpy.QtCore import Qt
from qtpy.QtWidgets import (
    QCheckBox,
    QComboBox,
    QFileDialog,
    QHBoxLayout,
    QLabel,
    QMessageBox,
    QPushButton,
    QSizePolicy,
    QVBoxLayout,
    QWidget,
)
from superqt import QLabeledDoubleSlider
from superqt.utils import signals_blocked

from voxflat._napari.docks import TaskDock, arrange, plain_label
from voxflat._napari.keys import Keys, key_text
from voxflat._napari.layers.sampled import shown
from voxflat._napari.layers.volumes import check_time, shown_step
from voxflat._napari.map_viewer import drawings
from voxflat._napari.map_viewer.annotations import Annotation, OnMap, VolumeAnnotations, on_map
from voxflat._napari.map_viewer.canvas import MapCanvas
from voxflat._napari.map_viewer.contents import Content, ContentChoice, drawing
from voxflat._napari.map_viewer.legend import Legend
from voxflat._napari.map_viewer.measures import DISTANCES, Measure
from voxflat._napari.map_viewer.movies import MovieWindow, flat_movie, shown_frames
from voxflat._napari.map_viewer.on_surface import PaintedSurface
from voxflat._napari.map_viewer.patch_outline import PatchOutline
from voxflat._napari.map_viewer.pictures import Picture
from voxflat._napari.map_viewer.prepared_map import PreparedMap, Spot
from voxflat._napari.map_viewer.segmentations import Segmentation, Segmentations, save_labels, to_volume
from voxflat._napari.map_viewer.viewer_link import ViewerLink
from voxflat._napari.map_viewer.viewer_parts import UprightMaps, theme_colours
from voxflat._napari.results.flat_layers import LayerData, Run, in_unit_of
from voxflat._napari.results.outputs import made_from
from voxflat._napari.results.report import as_html, warnings
from voxflat._napari.results.session import session_of
from voxflat._napari.results.sketch import POINTS, Sketch, Sketches
from voxflat._napari.timers import single_shot
from voxflat._napari.viewer_state import ViewerState
from voxflat._napari.wording import error_text
from voxflat._napari.worker import LatestTask
from voxflat.errors import VoxflatError
from voxflat.io.files import file_name
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.regions import VERTEX_ENDINGS

_DEEPEST, _HIGHEST = -3.0, 5.0  # mm outside the surface
_REACH = 10  # depths in other units, on both sides of the surface, as a multiple of the spacing of its points
_LENGTH, _CORTEX = range(2)  # entries of the box with the unit of the depth
_SHARE = 0.43  # initial width of the dock, as a fraction of the window; the viewer keeps the same width
_SLIDER = 72  # minimum width of a slider with its number, in pixels
_OPACITY = 0.85  # initial opacity of the colours, so that the folds remain visible

_Drawn: TypeAlias = tuple[PreparedMap, Picture | None, NDArray[np.uint8] | None, str]

# the actions of a click on the map
GO, MARK, REGION, MEASURE = _CLICKS = ("goes there", "marks a point", "draws a region", "measures a distance")

_UNDO, _REDO = KeyMod.CtrlCmd | KeyCode.KeyZ, KeyMod.CtrlCmd | KeyMod.Shift | KeyCode.KeyZ
_NEXT, _PREVIOUS, _IN_3D, _OUTLINE, _WHOLE = (
    KeyMod.Shift | key for key in (KeyCode.KeyN, KeyCode.KeyB, KeyCode.KeyC, KeyCode.KeyO, KeyCode.KeyW)
)
_OF_CLICKS = [KeyMod.Shift | key for key in (KeyCode.KeyG, KeyCode.KeyM, KeyCode.KeyR, KeyCode.KeyD)]

NOTHING = "Flatten a surface to see its map here."
_HINTS = {  # shown while nothing is pointed at
    GO: "Point at the map or the volume to see the same location in both. Click to go there.",
    MARK: "Click on the map to mark a point.",
    REGION: "Click on the corners of a region, and double-click to close it.",
    MEASURE: "Click on the two ends of the distance.",
}

_OF_CORNERS = "Corner {} of the region. Double-click to close it, or press Undo to remove the last corner."


def open_flat_map(viewer: Viewer) -> "FlatMapDock":
    """Open the dock *Flat map* as a tab beside the other docks, unless it is already open."""
    dock, widget = viewer.window.add_plugin_dock_widget("voxflat", "Flat map", tabify=True)
    window = dock.window()
    if hasattr(window, "resizeDocks"):
        window.resizeDocks([dock], [round(_SHARE * window.width())], Qt.Orientation.Horizontal)
    dock.raise_()
    return widget  # type: ignore[no-any-return]  # napari's type is Any


class FlatMapDock(TaskDock):
    """Shows the map of the current run on its own canvas, without changing the view in the viewer."""

    def __init__(self, napari_viewer: Viewer) -> None:
        super().__init__()
        self._viewer = napari_viewer
        self._state = ViewerState.of(napari_viewer)
        self._run: Run | None = None
        self._frame: int | None = None  # the displayed frame of a movie
        self._display_events: list[Any] = []
        self._location: tuple[Spot | None, tuple[float, float] | None] = None, None
        self._is_chosen = False  # whether the user chose the values that are being drawn
        self.prepared: PreparedMap | None = None  # the map of the run, for display and lookups; None until it is drawn
        self.picture: Picture | None = None  # the picture over the folds
        self._annotations: list[Annotation] = []
        self._projector = LatestTask(self, self._on_projected, self._on_projection_failed)
        self._annotator = LatestTask(self, self._on_annotated, self._on_annotation_failed)
        self._painter = LatestTask(self, self._on_drawn, self._on_failed)
        self._redraw = single_shot(self, 0, self._draw)  # draws once after several changes
        self.movies = MovieWindow(napari_viewer, self)
        self._make_fields()
        self.link = ViewerLink(napari_viewer, self)
        self.painted = PaintedSurface(napari_viewer, self)
        self.outline = PatchOutline(napari_viewer, self)
        self.upright = UprightMaps(napari_viewer)
        self.annotations = VolumeAnnotations(napari_viewer, self)
        self._lay_out()
        self._connect()
        self._on_theme()
        self._on_runs()

    # ------------------------------------------------------------------------------------------ making

    def _make_fields(self) -> None:
        self.runs = QComboBox()
        self.runs.setToolTip("The map to show")
        self.runs.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self.remove = QPushButton("Remove")
        self.remove.setToolTip("Remove the displayed map, its layers and its drawings from the viewer")
        self.keep = QCheckBox("Keep maps")
        self.keep.setToolTip("Keep earlier maps in the list. Otherwise, a new map replaces the previous one")
        self.keep.setChecked(self._state.keeps_earlier)
        self.contents = ContentChoice(self._viewer)
        steps = f"{key_text(_NEXT)}: next, {key_text(_PREVIOUS)}: previous"
        self.contents.setToolTip(f"The values on the map: a distortion measure or a layer of the viewer ({steps})")
        self.depths = QLabeledDoubleSlider(Qt.Orientation.Horizontal)
        self.depths.setToolTip("Distance from the surface at which the layer is sampled")
        self.depth_unit = QComboBox()
        self.depth_unit.addItems(["mm outside", "of cortex"])
        self.opacity = QLabeledDoubleSlider(Qt.Orientation.Horizontal)
        self.opacity.setRange(0, 1)
        self.opacity.setValue(_OPACITY)
        self.opacity.setToolTip("Opacity of the colours over the folds")
        self.on_surface = QCheckBox("In 3D")
        self.on_surface.setToolTip(f"Show the surface in the viewer, in the colours of the map ({key_text(_IN_3D)})")
        self.outlined = QCheckBox("Outline")
        tip = "Show the outline of the flattened surface in slices, its border in 3D, and the cuts in both"
        self.outlined.setToolTip(f"{tip} ({key_text(_OUTLINE)})")
        self.click = QComboBox()
        self.click.addItems([*_CLICKS])
        actions = (f"{what} ({key_text(key)})" for key, what in zip(_OF_CLICKS, _CLICKS, strict=True))
        self.click.setToolTip(f"The action of a click on the map: {', '.join(actions)}")
        self.warned = QPushButton()
        self.undo, self.redo = QPushButton("Undo"), QPushButton("Redo")
        self.undo.setToolTip(f"Undo the last point, corner, region or distance ({key_text(_UNDO)})")
        self.redo.setToolTip(f"Redo the last step that was undone ({key_text(_REDO)})")
        self.whole = QPushButton("Whole map")
        tip = f"Fit the map to the dock ({key_text(_WHOLE)}, or double-click)"
        self.whole.setToolTip(f"{tip}. Scroll to zoom in and out, and drag to move the map")
        self.movie = QPushButton("Movie")
        self.movie.setToolTip(
            "Show the displayed layer in all frames, at this depth, as one layer in a new window, whose time slider "
            "moves together with that of the viewer"
        )
        self.stop = QPushButton("Cancel")
        self.stop.hide()
        self.segmentations = Segmentations(self._viewer, self.movies)
        self.canvas = MapCanvas()
        self.legend = Legend()
        self.text = plain_label(NOTHING)
        self.text.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self.text.setWordWrap(True)
        self.text.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.excluded = plain_label()
        self.excluded.setWordWrap(True)
        self.excluded.hide()
        self.frame_hint = plain_label()
        self.frame_hint.setWordWrap(True)
        self.frame_hint.hide()
        self._limit_depth()

    def _lay_out(self) -> None:
        self._run_row, self._depth_row = QWidget(), QWidget()
        runs, depth = QHBoxLayout(self._run_row), QHBoxLayout(self._depth_row)
        for row in (runs, depth):
            row.setContentsMargins(0, 0, 0, 0)
        arrange(runs, (self.runs, 1), self.remove)
        arrange(depth, QLabel("Depth"), (self.depths, 1), self.depth_unit)
        first, second, third = (QHBoxLayout() for _ in range(3))  # three rows fit into a window of 1000 pixels
        arrange(first, QLabel("Shows"), (self.contents, 1), self.whole, self.keep)
        arrange(second, QLabel("Click"), (self.click, 1), self.on_surface, self.outlined)
        arrange(third, QLabel("Opacity"), (self.opacity, 1), (self._depth_row, 2), self.movie)
        for slider in (self.opacity, self.depths):
            slider.setMinimumWidth(_SLIDER)
        message = QHBoxLayout()
        arrange(message, (self.text, 1), self.warned, self.undo, self.redo, self.stop)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(6, 6, 6, 6)
        layout.setSpacing(4)
        arrange(
            layout,
            self._run_row,
            first,
            second,
            third,
            (self.canvas, 1),
            self.legend,
            self.segmentations,
            message,
            self.frame_hint,
            self.excluded,
        )

    def _connect(self) -> None:
        self._state.changed.connect(self._on_runs)
        self._state.visibility_changed.connect(self.upright.update)
        self._state.drawing_removed.connect(self._on_drawing_removed)
        self._state.adding.connect(self.movies.close)  # so that drawings in its window keep their map
        self._viewer.events.theme.connect(self._on_theme)
        self._viewer.dims.events.current_step.connect(self._on_step)
        self.runs.activated.connect(self._on_run_chosen)
        self.remove.clicked.connect(self._on_remove)
        self.keep.toggled.connect(partial(setattr, self._state, "keeps_earlier"))
        self.contents.chosen.connect(self._on_content)
        self.depths.valueChanged.connect(self._redraw.start)
        self.depth_unit.currentIndexChanged.connect(self._on_depth_unit)
        self.opacity.valueChanged.connect(self._on_opacity)
        self.canvas.picture.setOpacity(_OPACITY)
        self.on_surface.toggled.connect(self._on_surface)
        self.outlined.toggled.connect(self._on_outlined)
        self.whole.clicked.connect(self.canvas.fit)
        self.warned.clicked.connect(self._on_warned)
        self.movie.clicked.connect(self._on_movie)
        self.stop.clicked.connect(self._on_stop)
        self.segmentations.to_volume.connect(self._on_send)
        self.segmentations.to_file.connect(self._on_save_labels)
        self.movies.pointed.connect(self._on_map_pointed)
        self.canvas.pointed.connect(self._on_map_pointed)
        self.canvas.clicked.connect(self._on_map_clicked)
        self.canvas.double_clicked.connect(self._on_double_click)
        self.click.currentIndexChanged.connect(self._on_click)
        self.undo.clicked.connect(partial(self._sketch, Sketches.undo))
        self.redo.clicked.connect(partial(self._sketch, Sketches.redo))
        self.canvas.left.connect(self._on_map_left)
        self.canvas.zoomed.connect(self._on_zoomed)
        self.link.pointed.connect(self._on_viewer_pointed)
        self.link.clicked.connect(self._on_viewer_clicked)
        self.annotations.changed.connect(self._annotate)
        self.outline.failed.connect(self._on_failed)
        self.outline.toggled.connect(self.outlined.setChecked)
        self.painted.toggled.connect(self.on_surface.setChecked)
        keys: dict[int, Any] = {_NEXT: partial(self.contents.step, 1), _PREVIOUS: partial(self.contents.step, -1)}
        keys |= {_IN_3D: self.on_surface.click, _OUTLINE: self.outlined.click, _WHOLE: self.whole.click}
        keys |= {key: partial(self.click.setCurrentText, what) for key, what in zip(_OF_CLICKS, _CLICKS, strict=True)}
        of_dock: dict[int, Any] = {_UNDO: self.undo.click, _REDO: self.redo.click}  # cuts are undone in the viewer
        self._keys = Keys(self._viewer, self, keys, of_dock)

    # -------------------------------------------------------------------------------------------- runs

    def _on_runs(self) -> None:
        runs, current = self._state.runs, self._state.current
        with signals_blocked(self.runs):
            self.runs.clear()
            self.runs.addItems([f"{number}: {run.title}" for number, run in enumerate(runs, 1)])
            self.runs.setCurrentIndex(runs.index(current) if current in runs else -1)
        self._run_row.setVisible(len(runs) > 1)
        if current is not self._run or current is None:
            self._show_run(current)

    def _on_run_chosen(self, index: int) -> None:
        self._state.choose(self._state.runs[index])

    def _on_remove(self) -> None:
        """Remove the displayed map; ask first if drawings that are not saved would be lost."""
        run = self._run
        if run is None:
            return
        lost = self._state.unsaved(run)
        told = f"Removing the map '{run.title}' also removes drawings that are not saved: {lost}.\n\nRemove the map?"
        if not lost or QMessageBox.question(self, "Remove a map", told) == QMessageBox.StandardButton.Yes:
            self._state.remove(run)

    def _show_run(self, run: Run | None) -> None:
        self._run, self.prepared, self.link.prepared = run, None, None
        self._frame = self._shown_frame()
        self._show_hint()
        self.movie.setVisible(self._frame is not None)
        self.segmentations.offer(run)
        self.movies.close()
        self._location = None, None
        self._annotations = []
        self._show_excluded("")
        self._show_warned()
        self._show_sketch()
        now = Sketch() if run is None else run.sketches.now
        if now.corners or now.ends:  # the next click continues the unfinished region or distance
            self.click.setCurrentText(REGION if now.corners else MEASURE)
        self.link.mark(None)
        self.canvas.place_ring(None)
        self.text.setText(NOTHING if run is None else "Drawing the map…")
        known = run is not None and getattr(run.flat_map, "pial_points", None) is not None
        with signals_blocked(self.depth_unit):
            self.depth_unit.setCurrentIndex(_LENGTH)
            self.depth_unit.setItemText(_LENGTH, self._in_unit("mm outside").strip())
        self.depth_unit.setVisible(known)  # to choose fractions of the cortical thickness
        self._limit_depth()
        self.depths.setValue(getattr(None if run is None else run.layers.shown, "depth", 0.0))  # chosen in the form
        self.contents.show_run(run)
        if run is None:
            self.canvas.hide_map()
            self.legend.show_marks([], None)
            self.legend.show_colours(None)
            self.painted.remove()
            self.outline.remove()

    def _show_warned(self) -> None:
        """Show the number of warnings, because the map opens in front of the form that lists them."""
        found = [] if self._run is None else warnings(self._run.layers)
        self.warned.setText(f"⚠ {len(found)} warning{'s' * (len(found) != 1)}")
        self.warned.setToolTip(as_html(found))
        self.warned.setVisible(bool(found))

    def _on_warned(self) -> None:
        assert self._run is not None
        name = "Flatten surface" if isinstance(self._run.flat_map, FlatMap) else "Flatten in patches"
        dock, widget = self._viewer.window.add_plugin_dock_widget("voxflat", name, tabify=True)
        dock.raise_()
        widget.show_warnings()

    # ----------------------------------------------------------------------------------------- drawing

    @property
    def is_drawn(self) -> bool:
        """Whether the canvas and the viewer are up to date."""
        tasks = (self._painter, self._projector, self._annotator)
        threads = (*tasks, self.annotations, self.outline)
        return not (self._redraw.isActive() or self.painted.is_coming or any(one.is_busy for one in threads))

    def _on_content(self) -> None:
        self._is_chosen = True
        for event in self._display_events:
            event.disconnect(self._on_display_changed)
        content = self.contents.content
        self._depth_row.setVisible(isinstance(content, Image | Labels))
        names = ("colormap", "contrast_limits", "gamma", "data") if content is not None else ()
        events = getattr(content, "events", None)
        self._display_events = [getattr(events, name) for name in names if hasattr(events, name)]
        for event in self._display_events:
            event.connect(self._on_display_changed)
        self._redraw.start()

    def _on_display_changed(self) -> None:
        self._redraw.start()

    def _on_step(self) -> None:
        content = self.contents.content
        frame = self._shown_frame()
        self._show_hint()
        if frame != self._frame:
            self._frame = frame
            self.link.prepared = None  # until the map of this frame is ready
            self.movies.go_to(frame or 0)
            self._redraw.start()
        elif isinstance(content, Image | Labels) and content.ndim > 3:
            self._redraw.start()

    def _show_hint(self) -> None:
        """Tell if the map belongs to another frame than the displayed one."""
        single = None if self._run is None else self._run.layers.frame
        hint = "" if single is None else single.hint(self._viewer)
        self.frame_hint.setText(hint)
        self.frame_hint.setVisible(bool(hint))

    def _shown_frame(self) -> int | None:
        """Return the frame of a movie that the viewer displays."""
        movie = None if self._run is None else self._run.layers.movie
        return None if movie is None else movie.time.frame(self._viewer, len(movie.series))

    def _on_depth_unit(self) -> None:
        self._limit_depth()
        self._redraw.start()

    def _on_opacity(self, opacity: float) -> None:
        self.canvas.picture.setOpacity(opacity)
        if self.on_surface.isChecked():
            self._redraw.start()

    def _in_unit(self, text: str) -> str:
        """Return a text about lengths in mm in the unit of the map, or without a unit if it has none."""
        return text if self._run is None else in_unit_of(self._run.flat_map, text)

    def _limit_depth(self) -> None:
        is_length = self.depth_unit.currentIndex() == _LENGTH
        lowest, highest = (_DEEPEST, _HIGHEST) if is_length else (0.0, 1.0)
        flat_map = None if self._run is None else self._run.flat_map
        if is_length and isinstance(flat_map, FlatMap) and flat_map.origin.named_unit != "mm":
            highest = float(np.ceil(_REACH * flat_map.spacing))
            lowest = -highest
        with signals_blocked(self.depths):
            self.depths.setRange(lowest, highest)
            self.depths.setDecimals(1 if is_length else 2)
            self.depths.setSingleStep(0.1 if is_length else 0.05)  # type: ignore[arg-type]  # superqt's are floats
            self.depths.setValue(0.0 if is_length else 0.5)

    def _draw(self) -> None:
        """Draw the chosen values in a thread."""
        run = self._run
        if run is None:
            return
        try:
            draw = self._drawing(self.contents.content)
        except VoxflatError as error:
            draw = partial(_refuse, error)
        opacity = self.opacity.value() if self.on_surface.isChecked() else None
        self._painter.ask(partial(_drawn, run, self.prepared, self._frame, draw, opacity))

    def _drawing(self, content: Content) -> Any:
        if content is None:
            return None
        if isinstance(content, Measure):
            return content.draw
        assert self._run is not None
        world = session_of(self._run.flat_map).world_axes
        how: dict[str, Any] = {}
        if isinstance(content, Image | Labels):
            movie, single = self._run.layers.movie, self._run.layers.frame
            if movie is not None:
                check_time(content, movie.time, len(movie.series))
            elif single is not None:
                check_time(content, single.time, single.count)
            how = {**self._depth(), "step": shown_step(content, self._viewer)}
        return drawing(shown(content, world, **how))

    def _depth(self) -> dict[str, float]:
        is_length = self.depth_unit.currentIndex() == _LENGTH
        return {"depth" if is_length else "fraction": self.depths.value()}

    def _on_surface(self, painted: bool) -> None:
        if painted:
            self._redraw.start()
        else:
            self.painted.hide()

    def _on_outlined(self, outlined: bool) -> None:
        if not outlined:
            self.outline.hide()
        elif self.prepared is not None:
            self.outline.show(self.prepared)

    def _on_drawn(self, result: _Drawn) -> None:
        prepared, picture, colours, problem = result
        if prepared.run is not self._run:
            return
        if self._frame is not None and prepared is not prepared.frames.get(self._frame):
            self._redraw.start()  # the frame has changed meanwhile
            return
        if self.prepared is None:
            self.canvas.show_map(prepared.folds, prepared.outline)
            self.legend.show_marks(prepared.directions, prepared.side)
            text = "\n" if self.warned.isHidden() else "\n\n"  # beside the button, lines are shorter
            lines = self.text.fontMetrics().size(0, text)  # fixed, so that the map keeps its size
            self.text.setFixedHeight(lines.height() + 2)
            self.text.setText(_HINTS[self.click.currentText()])
            self._on_zoomed()
        self.link.prepared = prepared
        if prepared is not self.prepared:
            self.prepared = prepared
            self._annotations = []
            self._annotate()
            self._update_sketch()
            self.painted.take_up(prepared)
            self.outline.take_up(prepared)
            self._on_outlined(self.outlined.isChecked())
        self.picture = picture
        self.canvas.show_picture(picture)
        self.legend.show_colours(None if picture is None else picture.scale)
        if self._is_chosen or self._location[1] is not None:
            self._show_again(*self._location)  # instead of an earlier message
        if colours is not None and self.on_surface.isChecked():
            self.painted.show(prepared, colours)
        if problem:
            self.text.setText(problem)
        elif self._is_chosen:
            self._state.content_shown.emit()
        self._is_chosen = bool(problem)  # the next picture replaces this message

    def _show_again(self, spot: Spot | None, place: tuple[float, float] | None) -> None:
        """Show a location again, which moves with the surface from frame to frame."""
        assert self.prepared is not None
        if spot is not None and place is not None:
            spot = self.prepared.spot(*place)
            self.link.follow(None if spot is None else spot.point)
        self._show_location(spot, place)

    def _on_failed(self, error: Exception) -> None:
        if self.prepared is None:  # the painted surface and the outline belong to the previous map
            self.painted.remove()
            self.outline.remove()
        self.canvas.show_picture(None)
        self.legend.show_colours(None)
        self.text.setText(error_text(error))

    # ------------------------------------------------------------------------------------------- movies

    def _on_movie(self) -> None:
        """Sample all frames in a thread, or stop it."""
        run, content = self._run, self.contents.content
        if run is None or run.layers.movie is None:
            return
        world = session_of(run.flat_map).world_axes
        try:
            frames, look = shown_frames(content, world, run.layers.movie, self._viewer, **self._depth())
        except VoxflatError as error:
            self._show_message(error_text(error))
            return
        task = partial(flat_movie, run.layers.movie, frames, look)
        missing = [str(number) for number, frame in enumerate(frames) if frame is None]
        self._work(task, "Sampling the movie", partial(self._on_sampled, run, missing))

    def _on_sampled(self, run: Run, missing: list[str], data: LayerData) -> None:
        if run is self._run and run.layers.movie is not None:
            self.movies.show(run.layers.movie, data)
            empty = f", but the layer has no frame {', '.join(missing)}, which is empty" if missing else ""
            self._show_message(f"The window shows '{data[1]['name']}' in all frames{empty}.")

    def _on_send(self) -> None:
        layer, prepared = self.segmentations.layer, self.prepared
        if layer is None or prepared is None:
            return
        try:
            drawn = Segmentation.of(layer)
        except VoxflatError as error:
            self._show_message(error_text(error))
            return
        task = partial(to_volume, prepared, drawn, self._depth().get("depth", 0.0))
        self._work(task, "Transferring labels", partial(self._on_sent, prepared.run, layer))

    def _on_sent(self, run: Run, layer: Labels, result: tuple[LayerData, str]) -> None:
        if run is self._run:
            added = drawings.put(self._viewer, result[0], made_from(self._viewer, run, layer), run, layer)
            self._show_message(f"Added '{added.name}'{result[1]}")

    def _on_save_labels(self) -> None:
        layer, prepared = self.segmentations.layer, self.prepared
        if layer is None or prepared is None:
            return
        is_mesh = isinstance(prepared.planar, FlatMap) and not prepared.planar.is_voxels
        kinds = "Tab-separated table (*.tsv);;Comma-separated table (*.csv)"
        if is_mesh:
            kinds = f"GIFTI labels (*.label.gii);;FreeSurfer annotation (*.annot);;FreeSurfer label (*.label);;{kinds}"
        endings = (".tsv", ".csv", *(VERTEX_ENDINGS if is_mesh else ()))
        usual = ".label.gii" if is_mesh else ".tsv"
        path, kind = QFileDialog.getSaveFileName(self, "Save the labels", f"{file_name(layer.name)}{usual}", kinds)
        if not path:
            return
        try:
            drawn = Segmentation.of(layer)
        except VoxflatError as error:
            self._show_message(error_text(error))
            return
        ending = kind.partition("*")[2].rstrip(")") or usual
        file = Path(path if path.lower().endswith(endings) else f"{path}{ending}")
        self._work(partial(save_labels, prepared, drawn, self._frame, file), "Measuring the labels", self._show_message)

    def _on_stop(self) -> None:
        if self._worker is not None:
            self._worker.quit()
            self._show_message("Cancelling…")

    def _show_work(self, what: str | None) -> None:
        for button in (self.movie, self.segmentations.send, self.segmentations.save):
            button.setEnabled(what is None)
        self.stop.setVisible(what is not None)
        if what is not None:
            self._show_message(f"{what}…")

    def _show_message(self, message: str) -> None:
        self.text.setText(message)

    def _on_finished(self) -> None:
        if self._worker is not None and self._worker.abort_requested:
            self._show_message("Cancelled")
        super()._on_finished()

    # ------------------------------------------------------------------------------ drawn in the volume

    def _annotate(self) -> None:
        """Project points and shapes in the volume onto the map in a thread, if they have changed."""
        if self.prepared is None:
            return
        try:
            found = self.annotations.taken(self.prepared.session.world_axes, self.prepared.unit)
        except VoxflatError as error:
            self._on_annotation_failed(error)
            return
        before, self._annotations = self._annotations, found
        if len(found) != len(before) or not all(one.is_same(other) for one, other in zip(found, before, strict=True)):
            self._annotator.ask(partial(_annotated, self.prepared, found))

    def _on_annotated(self, result: tuple[PreparedMap, OnMap]) -> None:
        prepared, found = result
        if prepared is self.prepared:
            self.canvas.show_annotations(found)
            self._show_excluded(found.excluded)

    def _on_annotation_failed(self, error: Exception) -> None:
        self._annotations = []
        self.canvas.show_annotations(None)
        self._show_excluded(error_text(error))

    def _show_excluded(self, what: str) -> None:
        self.excluded.setText(what[:1].upper() + what[1:])
        self.excluded.setVisible(bool(what))

    # -------------------------------------------------------------------------------------------- link

    def _on_map_pointed(self, u: float, v: float) -> None:
        spot = None if self.prepared is None else self.prepared.spot(u, v)
        self.canvas.place_ring(None)  # because the mouse pointer already marks the location
        self.link.mark(None if spot is None else spot.point)
        self._show_location(spot, (u, v))

    def _on_map_left(self) -> None:
        self.link.mark(None)
        self._show_location(None, None)

    def _on_map_clicked(self, u: float, v: float) -> None:
        spot = None if self.prepared is None else self.prepared.spot(u, v)
        if self.prepared is None or spot is None:
            if self.prepared is not None and self.click.currentText() != GO:
                self._show_message("This place is outside the map. Click on the map")
            return
        wanted = self.click.currentText()
        if wanted == GO:
            self.link.centre(spot.point)
            return
        frame, now = self.prepared.frame, self.prepared.run.sketches.now
        if wanted == MARK:
            self._draw_on(replace(now, marks=(*now.marks, (frame, (u, v)))))
        elif wanted == REGION:
            self._draw_on(replace(now, corners=(*now.corners, (u, v))))
            self._show_message(_OF_CORNERS.format(len(now.corners) + 1))
        else:
            ends = (*now.ends, (u, v))
            is_measured = len(ends) == 2
            self._draw_on(replace(now, distance=(frame, ends), ends=()) if is_measured else replace(now, ends=ends))

    def _on_double_click(self) -> None:
        """Close the region that is being drawn, or discard it if it has too few corners; or show the whole map."""
        if self.click.currentText() != REGION:
            self.canvas.fit()
        elif self.prepared is not None and len((now := self.prepared.run.sketches.now).corners) > 2:
            regions = (*now.regions, (self.prepared.frame, now.corners))
            self._draw_on(replace(now, regions=regions, corners=()))
        elif self.prepared is not None:
            self._forget_unfinished()
            self._show_message("A region needs at least 3 corners. Click on all its corners again, then double-click")

    def _draw_on(self, sketch: Sketch) -> None:
        self._sketch(lambda sketches: sketches.do(sketch))

    def _sketch(self, step: Callable[[Sketches], None]) -> None:
        """Draw on the map, or undo or redo a step."""
        if self._run is None:
            return
        step(self._run.sketches)
        self._update_sketch()

    def _update_sketch(self) -> None:
        """Show the sketch on the map and, projected in a thread, in the viewer."""
        self._show_sketch()
        if self.prepared is None or (sketches := self.prepared.run.sketches).is_shown:
            return
        shown, now = sketches.shown, sketches.now
        moments = self._moments(frame for frame, _ in [*now.marks, *filter(None, [now.distance])])
        self._projector.ask(partial(_changed, self.prepared, shown, now, moments))

    def _moments(self, frames: Iterable[int | None]) -> dict[int | None, tuple[float, ...]]:
        """Return the positions of frames along the axes before space, which are empty for a single map."""
        movie = None if self._run is None else self._run.layers.movie
        return {of: () if movie is None or of is None else movie.time.leading(self._viewer, of) for of in frames}

    def _on_projected(self, result: tuple[Run, drawings.Changes]) -> None:
        run, found = result
        if run not in self._state.runs:  # it was removed meanwhile
            return
        sketches = run.sketches
        if (marked := sketches.layers.pop(POINTS, None)) is not None:
            for mark in sketches.placed[found.kept :]:
                drawings.take_back(marked, mark)
            sketches.layers[POINTS] = marked  # only now, so that these points are not deleted by the user
        del sketches.placed[found.kept :]
        for part in found.empty:
            drawings.remove_empty(self._viewer, sketches.layers, part, run)
            self.text.setText("")  # which told about it
        for drawn in found.made:
            sketches.layers[drawn.part] = drawings.put(self._viewer, drawn.layer, sketches.layers.get(drawn.part), run)
            if drawn.part == POINTS:
                if sketches.layers[POINTS] is not marked:
                    marked = sketches.layers[POINTS]
                    self._state.follow_points(run, marked)
                sketches.placed += [*drawn.layer[0]]
            if drawn.message:
                self.text.setText(drawn.message)
        sketches.shown = found.sketch
        self._update_sketch()  # which may have changed meanwhile

    def _on_drawing_removed(self, run: Run, name: str) -> None:
        if run is self._run:
            self._show_sketch()
            self.text.setText(f"What you deleted from '{name}' was removed from the map. Undo brings it back.")

    def _on_projection_failed(self, error: Exception) -> None:
        if self._run is not None:
            sketches = self._run.sketches
            while sketches.can_undo and not sketches.is_shown:
                sketches.cancel()
        self._forget_unfinished()
        self.text.setText(error_text(error))

    def _on_click(self) -> None:
        """Discard the corners of a region, or the end of a distance, that the chosen action does not continue."""
        click, now = self.click.currentText(), Sketch() if self._run is None else self._run.sketches.now
        if (now.corners and click != REGION) or (now.ends and click != MEASURE):
            self._forget_unfinished()
        self._show_location(None, None)

    def _forget_unfinished(self) -> None:
        sketches = None if self._run is None else self._run.sketches
        if sketches is not None and (sketches.now.corners or sketches.now.ends):
            sketches.do(sketches.now.without_unfinished())
        self._show_sketch()

    def _show_sketch(self) -> None:
        """Show the regions of the displayed frame, the corners of the next one, and marks that are not yet points."""
        sketches, frame = Sketches() if self._run is None else self._run.sketches, self._frame
        now = sketches.now
        marks = [place for of, place in now.marks[len(sketches.placed) :] if of == frame]
        self.canvas.show_drawn(now.regions_in(frame), now.corners, [*marks, *now.corners, *now.ends])
        self.undo.setEnabled(sketches.can_undo)
        self.redo.setEnabled(sketches.can_redo)

    def _on_viewer_pointed(self, place: tuple[float, float] | None) -> None:
        self.canvas.place_ring(place)
        self.link.mark(None)
        spot = None if place is None or self.prepared is None else self.prepared.spot(*place)
        self._show_location(spot, place)

    def _on_viewer_clicked(self, place: tuple[float, float]) -> None:
        self.canvas.place_ring(place)
        self.canvas.centre(place)

    def _show_location(self, spot: Spot | None, place: tuple[float, float] | None) -> None:
        self._location = (spot, place)
        if spot is None or place is None:
            self.text.setText(self.text.text() if self.prepared is None else _HINTS[self.click.currentText()])
            return
        x, y, z = spot.point
        number = f"vertex {spot.vertex}" if isinstance(spot.vertex, int) else f"voxel {str(spot.vertex)[1:-1]}"
        parts = [self._in_unit(f"{x:.1f}, {y:.1f}, {z:.1f} mm"), number]
        value = None if self.picture is None else self.picture.value(*place)
        content = self.contents.content
        unit = content.unit if isinstance(content, Measure) else ""
        if value is not None and content is not None and not (unit and content.name == DISTANCES):
            shown = f"{100 * (2**value - 1):+.1f} %" if unit == "log2" else f"{value:.4g}{unit and ' '}{unit}"
            if isinstance(content, Surface) and "labels" in content.metadata:
                shown = content.metadata["labels"].get(round(value)) or shown
            parts.append(f"{content.name} {shown}")
        text = " · ".join(filter(None, [*parts, spot.distortion]))
        self.text.setText(text.replace("-", "−").replace(" %", "\u00a0%"))

    def _on_zoomed(self) -> None:
        self.legend.show_length(self.canvas.scale_factor, self._in_unit("mm"))

    def _on_theme(self) -> None:
        background, ink = theme_colours(self._viewer)
        self.canvas.setBackgroundBrush(background)
        self.legend.set_ink(ink)

    # ------------------------------------------------------------------------------------------ ending

    def _release(self) -> None:
        super()._release()
        for running in (self._redraw, self._painter, self._projector, self._annotator):
            running.stop()
        self.movies.close()
        for linked in (self.segmentations, self._keys, self.annotations, self.link, self.outline, self.contents):
            linked.release()
        self.painted.release()
        for event in self._display_events:
            event.disconnect(self._on_display_changed)
        self._display_events = []
        self._state.changed.disconnect(self._on_runs, missing_ok=True)
        self._state.visibility_changed.disconnect(self.upright.update, missing_ok=True)
        self._state.drawing_removed.disconnect(self._on_drawing_removed, missing_ok=True)
        self._state.adding.disconnect(self.movies.close, missing_ok=True)
        self._viewer.events.theme.disconnect(self._on_theme)
        self._viewer.dims.events.current_step.disconnect(self._on_step)


def _drawn(run: Run, prepared: PreparedMap | None, frame: int | None, draw: Any, opacity: float | None) -> _Drawn:
    """Draw the picture, and find the colours of the surface if it is shown; called in a thread.

    If the values cannot be drawn, return the reason; the map of the frame is shown without them.
    """
    ready = (PreparedMap.of(run) if prepared is None else prepared).at(frame)
    picture, problem = None, ""
    try:
        picture = None if draw is None else draw(ready)
    except VoxflatError as error:
        problem = error_text(error)
    return ready, picture, None if opacity is None else ready.colours(picture, opacity), problem


def _changed(prepared: PreparedMap, *changed: Any) -> tuple[Run, drawings.Changes]:
    return prepared.run, drawings.changes(prepared, *changed)


def _refuse(error: VoxflatError, _: PreparedMap) -> Picture:
    raise error


def _annotated(prepared: PreparedMap, annotations: list[Annotation]) -> tuple[PreparedMap, OnMap]:
    return prepared, on_map(prepared, annotations)
