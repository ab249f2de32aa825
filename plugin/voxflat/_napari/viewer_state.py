"""The state of a viewer that persists when docks are closed: its runs and drawn cuts."""

import itertools
import weakref
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np
from napari import Viewer
from napari.layers import Layer
from napari.layers import Surface as SurfaceLayer
from napari.layers.base import ActionType
from napari.utils.notifications import show_info
from numpy.typing import NDArray
from psygnal import Signal
from qtpy.QtCore import QTimer

from voxflat._napari.gl_context import keep_canvas_current
from voxflat._napari.results.flat_layers import KEPT, MAPS, FlatLayers, MovieMaps, Pixels, Run
from voxflat._napari.results.layer_list import ListedLayers
from voxflat._napari.results.outputs import is_drawn
from voxflat._napari.results.session import Session, session_of
from voxflat._napari.results.sketch import Sketch, Sketches
from voxflat._napari.scripts import OpenedFile
from voxflat._napari.worker import JobWorker
from voxflat.atlases.atlas import Atlas
from voxflat.io.files import SAVED_ENDINGS
from voxflat.maps.flat_map import FlatMap
from voxflat.pipeline.surface import Surface

_Made = TypeVar("_Made", bound=FlatMap | Atlas)


@dataclass(frozen=True, eq=False)
class DrawnCuts:
    """Drawn cuts, as vertex ids of the input."""

    paths: dict[str, NDArray[np.int64]]  # by name
    left_out: NDArray[np.int64]  # excluded vertices, as `drop`; may be empty
    sphere: str | None = None  # aligns the map with maps that have standard cuts: a file, or `OWN_REGISTRATION`

    @classmethod
    def of(cls, record: Mapping[str, Any]) -> "DrawnCuts":
        """Read cuts from the description of a saved map."""
        paths = {name: np.array(path, dtype=np.int64) for name, path in record["paths"].items()}
        return cls(paths, np.array(record["left_out"], dtype=np.int64), record["sphere"])

    def record(self) -> dict[str, Any]:
        paths = {name: path.tolist() for name, path in self.paths.items()}
        return {"paths": paths, "left_out": self.left_out.tolist(), "sphere": self.sphere}


class ViewerState:
    """The runs of one viewer, which do not depend on open docks; the signal `changed` notifies the docks."""

    changed = Signal()  # emitted when runs are added or removed, or the current run changes
    adding = Signal()  # emitted before a run is added
    visibility_changed = Signal()  # emitted when layers of maps were shown, hidden or removed
    content_shown = Signal()  # emitted when the map shows values that the user chose
    drawing_removed = Signal(object, str)  # emitted with a run, after the user removed a layer with drawings on its map
    world_chosen = Signal()  # emitted when the world axes of a layer were chosen
    cuts_drawn = Signal(object)  # emitted when cuts were drawn for a layer
    flatten_requested = Signal(object, object)  # emitted with a layer to flatten along drawn cuts, and its foreground

    _of: ClassVar["dict[int, ViewerState]"] = {}

    def __init__(self, viewer: Viewer) -> None:
        self._viewer = weakref.ref(viewer)
        self._runs: dict[Run, ListedLayers] = {}
        self._current: Run | None = None
        self._opened: weakref.WeakSet[Run] = weakref.WeakSet()  # runs whose layers napari adds one at a time
        self._cuts: weakref.WeakKeyDictionary[Layer, DrawnCuts] = weakref.WeakKeyDictionary()
        self._worlds: weakref.WeakKeyDictionary[Layer, str] = weakref.WeakKeyDictionary()
        self._over: weakref.WeakKeyDictionary[Layer, Run] = weakref.WeakKeyDictionary()  # layers that the user added
        self._cut_records: dict[str, dict[str, Any]] = {}
        self.flat_drawings: list[Layer] = []  # of the window Flat volume, until it is opened again
        self.settings: dict[str, Mapping[str, Any]] = {}  # of the forms in docks that were closed
        self.opened: Run | None = None  # the run of the last opened map, until its settings are restored
        self.keeps_earlier = False  # whether earlier runs are kept when a new one is added
        self.loading: dict[JobWorker, str] = {}  # tasks that load maps, and the files of the maps

    @classmethod
    def of(cls, viewer: Viewer) -> "ViewerState":
        """Return the state of a viewer, which exists as long as the viewer does."""
        viewer = getattr(viewer, "__wrapped__", viewer)  # napari passes a different proxy to each widget
        key = id(viewer)  # because viewers are not hashable
        if key not in cls._of:
            state = cls._of[key] = cls(viewer)
            viewer.layers.events.inserted.connect(state._adopt)
            viewer.layers.events.removed.connect(state._on_removed)
            keep_canvas_current(viewer)
            weakref.finalize(viewer, cls._of.pop, key, None)
        return cls._of[key]

    @property
    def runs(self) -> tuple[Run, ...]:
        return tuple(self._runs)  # in the order in which they were added

    @property
    def current(self) -> Run | None:
        return self._current

    @property
    def is_settled(self) -> bool:
        """Whether the layer list has all layers of the runs, and none of removed runs, and no map is being loaded."""
        return not self.loading and all(listed.is_settled for listed in self._runs.values())

    def add(self, run: Run, *, keeps_earlier: bool = False) -> None:
        """Make a run the current one, and add its layers.

        Other runs are removed unless `keeps_earlier` is set, here or for all runs, or the user has drawn or painted on
        their maps.
        """
        viewer = self._viewer()
        assert viewer is not None
        self.adding.emit()
        free: list[Layer] = []
        if not (keeps_earlier or self.keeps_earlier):
            dropped = [one for one in self._runs if not self._is_drawn_on(one)]
            free = [layer for earlier in dropped for layer in self._runs.pop(earlier).hand_over()]
            self._over.update({layer: run for layer, earlier in self._over.items() if earlier in dropped})
        run.title = self._free_title(run.title)
        self._runs[run] = ListedLayers(viewer, self._on_visible, free)
        self._current = run
        self.changed.emit()
        self._runs[run].show(run.layers, run.title)

    def _free_title(self, wanted: str) -> str:
        """Return a title that no other run has, such as `sheet (2)`."""
        taken = {run.title for run in self._runs}
        numbered = (f"{wanted} ({number})" for number in itertools.count(2))
        return next(title for title in itertools.chain([wanted], numbered) if title not in taken)

    def _is_drawn_on(self, run: Run) -> bool:
        """Return whether the user has drawn on a map, or painted on its labels or in layers over it."""
        return not run.sketches.is_empty or bool(self._drawn_over(run))

    def _drawn_over(self, run: Run) -> list[Layer]:
        """Return the layers that the user has drawn over a map or painted, which its file does not contain."""
        viewer, movie = self._viewer(), run.layers.movie
        over = [layer for layer in ([] if viewer is None else viewer.layers) if self._over.get(layer) is run]
        return [*self._runs[run].painted, *filter(is_drawn, over), *([] if movie is None else movie.drawings)]

    def choose(self, run: Run) -> None:
        if run in self._runs and run is not self._current:
            self._current = run
            self.changed.emit()

    def unsaved(self, run: Run) -> str:
        """Return a text with the drawings that would be lost with a map, or an empty one."""
        movie = run.layers.movie
        layers = [*self._runs[run].painted, *([] if movie is None else movie.drawings)]
        drawn = ["what you drew on the map"] if run.sketches.now != run.sketches.saved else []
        return ", ".join([*drawn, *(f"'{layer.name}'" for layer in layers)])

    def remove(self, run: Run) -> None:
        """Remove a map, its layers and its drawings; layers that the user has added stay."""
        listed, viewer = self._runs.pop(run), self._viewer()
        listed.remove()
        for layer in run.sketches.layers.values():
            if viewer is not None and layer in viewer.layers:
                viewer.layers.remove(layer)
        if run is self._current:
            self._current = self.runs[-1] if self._runs else None
        self.changed.emit()

    def _adopt(self, event: Any) -> None:
        """Add the map of a layer that was opened from a file as a run; a layer of the user lies on the current map."""
        flat_map = event.value.metadata.get("voxflat")
        under = self._current if event.value.ndim == 2 else None
        if KEPT in event.value.metadata:
            under = next((run for run in self._runs if run.layers.movie is event.value.metadata[KEPT]()), None)
        if flat_map is None and under is not None:
            self._over[event.value] = under
        if flat_map is None or event.value.source.path is None:
            return
        viewer = self._viewer()
        assert viewer is not None
        run = next((run for run in self._runs if run.flat_map is flat_map), None)
        if run is None:
            session = session_of(flat_map)
            sketches = Sketches(Sketch.of(session.drawn))
            movie: MovieMaps | None = event.value.metadata.get(MAPS)
            script = OpenedFile(event.value.source.path, flat_map, is_movie=movie is not None)
            title = self._free_title(Path(event.value.source.path).stem)
            run = Run(FlatLayers(flat_map, [], movie=movie), session.layer, script, sketches, title)
            self._opened.add(run)
            self.opened = run
            self._runs[run] = ListedLayers(viewer, self._on_visible)
            self._current = run
        if run in self._opened:
            layer = event.value.as_layer_data_tuple()
            (run.layers.layers if event.value.ndim == 2 else run.layers.in_space).append(layer)
            self._runs[run].take(event.value, run.title)
            QTimer.singleShot(0, partial(setattr, event.value, "visible", False))  # RGB layers are added visible
            self.changed.emit()

    def follow_points(self, run: Run, layer: Layer) -> None:
        """Remove marks from a map when the user deletes their points; this can be undone."""
        layer.events.data.connect(partial(self._on_points, run, layer))

    def _on_points(self, run: Run, layer: Any, event: Any) -> None:
        if event.action != ActionType.REMOVING or layer not in run.sketches.layers.values():
            return
        before = run.sketches.now
        run.sketches.remove_points(layer.data_to_world(layer.data[number]) for number in event.data_indices)
        if run.sketches.now is not before:
            self.drawing_removed.emit(run, layer.name)

    def _on_visible(self) -> None:
        self.visibility_changed.emit()

    def _on_removed(self, event: Any) -> None:
        """Remove from a map what a layer showed that the user removed; this can be undone."""
        self.visibility_changed.emit()
        for run in self._runs:
            part = next((part for part, layer in run.sketches.layers.items() if layer is event.value), None)
            if part is not None:
                run.sketches.remove(part)
                self.drawing_removed.emit(run, event.value.name)

    def map_of(self, layer: Layer | None) -> FlatMap | None:
        """Return the displayed map if it fits a layer: both are voxels, or both have the same number of vertices."""
        flat_map = None if self._current is None else self._current.flat_map
        if layer is None or not isinstance(flat_map, FlatMap) or flat_map.is_voxels == isinstance(layer, SurfaceLayer):
            return None
        fits = flat_map.is_voxels or flat_map.origin.mesh.vertices == len(layer.vertices)
        return flat_map if fits else None

    def run_of(self, layer: Layer) -> Run | None:
        """Return the run of whose map a flat layer is an image, or on whose pixels the user painted it."""
        flat_map = layer.metadata.get("voxflat")
        if flat_map is None:
            return self.run_under(layer)
        return next((run for run in self._runs if run.flat_map is flat_map), None)

    def run_under(self, layer: Layer) -> Run | None:
        """Return the run whose map has the pixels of a flat layer: that over which it was added, or the current one.

        Maps whose own images have these pixels come before maps that could have such an image.
        """
        order = (self._over.get(layer), self._current, *self._runs)
        runs = [run for run in order if run in self._runs and isinstance(run.flat_map, FlatMap)]
        pixels = Pixels.of(layer)
        if pixels is None:
            return None
        tests = (Run.has_pixels, Run.can_have_pixels)
        return next((run for fits in tests for run in runs if run is not None and fits(run, pixels)), None)

    def keep_record(self, surface: Surface, record: dict[str, Any]) -> None:
        """Keep the cuts in the table of *Draw cuts*, so that neither layers nor docks that are closed lose them."""
        self._cut_records[surface.origin.input_sha256] = record

    def record_of(self, surface: Surface | FlatMap | Atlas) -> dict[str, Any]:
        """Return the cuts that were drawn on a surface in this session, or before one of the open maps was saved."""
        key = surface.origin.input_sha256
        of_maps = {
            run.flat_map.origin.input_sha256: session_of(run.flat_map).drawn.get("drawn_cuts", {}) for run in self._runs
        }
        return self._cut_records.get(key) or of_maps.get(key, {})

    def save(self, made: FlatMap | Atlas, path: str) -> None:
        """Save a map with its drawings; tell which layers over it the file does not contain."""
        run = next((run for run in self._runs if run.flat_map is made), None)
        movie, kept = None if run is None else run.layers.movie, self.with_session(made)
        is_complete = path.lower().endswith(SAVED_ENDINGS)  # other formats hold one map, that of the reference frame
        if movie is not None and is_complete and isinstance(kept, FlatMap):
            replace(movie.series, flat_map=kept).save(path)
        else:
            kept.save(path)
        if run is not None and is_complete:
            run.sketches.saved = run.sketches.now
        names = ", ".join(f"'{layer.name}'" for layer in ([] if run is None else self._drawn_over(run)))
        remedy = f". The file does not contain {names}. Save these layers with File → Save Selected Layers…"
        show_info(f"Saved {path}{remedy if names else ''}")

    def with_session(self, made: _Made) -> _Made:
        """Return a map or an atlas whose description contains its drawings and the cuts of its surface."""
        sketch = next((run.sketches.now for run in self._runs if run.flat_map is made), Sketch())
        record = self.record_of(made)
        drawn = {**sketch.record(), **({"drawn_cuts": record} if record.get("cuts") else {})}
        session = Session.of(made)
        return made if session is None else replace(session, drawn=drawn).put(made)

    def choose_world(self, layer: Layer, world: str) -> None:
        """Keep the world axes that the user chose for a layer, which all forms show."""
        self._worlds[layer] = world
        self.world_chosen.emit()

    def world_of(self, layer: Layer) -> str | None:
        return self._worlds.get(layer)

    def set_cuts(self, layer: Layer, cuts: DrawnCuts) -> None:
        self._cuts[layer] = cuts
        self.cuts_drawn.emit(layer)

    def cuts_of(self, layer: Layer | None) -> DrawnCuts | None:
        return None if layer is None else self._cuts.get(layer)
