"""What of a viewer lasts: its runs, which every dock of it shows, and which no dock takes along when it is closed."""

import weakref
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
from napari import Viewer
from napari.layers import Layer, Surface
from numpy.typing import NDArray
from psygnal import Signal
from qtpy.QtCore import QTimer

from voxflat._napari.gl_context import keep_canvas_current
from voxflat._napari.results.flat_layers import FlatLayers, Run
from voxflat._napari.results.layer_list import ListedLayers
from voxflat.maps.flat_map import FlatMap


@dataclass(frozen=True, eq=False)
class DrawnCuts:
    """Cuts that someone drew, by what the vertices are in the input."""

    paths: list[NDArray[np.int64]]
    left_out: NDArray[np.int64]  # as `drop`; empty for nothing


class ViewerState:
    """The runs of one viewer, whatever docks are open; `changed` tells these to read again."""

    changed = Signal()
    """Runs came or went, or another one is the current one."""

    cuts_drawn = Signal()
    """Someone drew cuts for a layer."""

    flatten_requested = Signal(object, object)
    """Someone wants a layer, and what of it is foreground, flattened again along the cuts that were drawn."""

    _of: ClassVar["dict[int, ViewerState]"] = {}

    def __init__(self, viewer: Viewer) -> None:
        self._viewer = weakref.ref(viewer)
        self._runs: dict[Run, ListedLayers] = {}
        self._current: Run | None = None
        self._opened: weakref.WeakSet[Run] = weakref.WeakSet()  # runs whose layers come one by one
        self._cuts: weakref.WeakKeyDictionary[Layer, DrawnCuts] = weakref.WeakKeyDictionary()
        self.keeps_earlier = False
        """Whether earlier runs stay when a new one comes, unless it says otherwise."""

    @classmethod
    def of(cls, viewer: Viewer) -> "ViewerState":
        """Return the state of a viewer, for as long as the viewer lives."""
        viewer = getattr(viewer, "__wrapped__", viewer)  # napari gives each widget another wrapper around it
        key = id(viewer)  # viewers have no hash
        if key not in cls._of:
            state = cls._of[key] = cls(viewer)
            viewer.layers.events.inserted.connect(state._adopt)
            keep_canvas_current(viewer)
            weakref.finalize(viewer, cls._of.pop, key, None)
        return cls._of[key]

    @property
    def runs(self) -> tuple[Run, ...]:
        """The runs, in the order in which they came."""
        return tuple(self._runs)

    @property
    def current(self) -> Run | None:
        """The run that the docks show."""
        return self._current

    @property
    def is_settled(self) -> bool:
        """Whether the viewer lists the layers of the runs, and no others of earlier ones."""
        return all(listed.is_settled for listed in self._runs.values())

    def add(self, run: Run, *, keep: bool | None = None) -> None:
        """Make a run the current one, and list its layers; by default `keeps_earlier` says whether the others stay."""
        viewer = self._viewer()
        assert viewer is not None
        gone: list[ListedLayers] = []
        if not (self.keeps_earlier if keep is None else keep):
            gone = [*self._runs.values()]
            self._runs.clear()
        self._runs[run] = ListedLayers(viewer, [layer for listed in gone for layer in listed.hand_over()])
        self._current = run
        self.changed.emit()
        self._runs[run].show(run.layers)

    def choose(self, run: Run) -> None:
        """Show a run."""
        if run in self._runs and run is not self._current:
            self._current = run
            self.changed.emit()

    def remove(self, run: Run) -> None:
        """Forget a run, unless it is forgotten already, and take its layers out of the list."""
        if run not in self._runs:
            return
        self._runs.pop(run).remove()
        if run is self._current:
            self._current = self.runs[-1] if self._runs else None
        self.changed.emit()

    def _adopt(self, event: Any) -> None:
        """Take up a map that comes with its layers, as from a file that is opened, as a run of its own."""
        flat_map = event.value.metadata.get("voxflat")
        if flat_map is None or event.value.source.path is None:
            return
        viewer = self._viewer()
        assert viewer is not None
        run = next((run for run in self._runs if run.flat_map is flat_map), None)
        if run is None:
            run = Run(FlatLayers(flat_map, []), flat_map.metadata["napari"]["layer"])
            self._opened.add(run)
            self._runs[run] = ListedLayers(viewer)
            self._current = run
        if run in self._opened:
            layer = event.value.as_layer_data_tuple()
            (run.layers.layers if event.value.ndim == 2 else run.layers.in_space).append(layer)
            self._runs[run].take(event.value)
            QTimer.singleShot(0, partial(setattr, event.value, "visible", False))  # what came in colours is not yet
            self.changed.emit()

    def map_of(self, layer: Layer | None) -> FlatMap | None:
        """Return the map that the docks show, if it may be of a layer's surface: of as many vertices, or of voxels."""
        flat_map = None if self._current is None else self._current.flat_map
        if layer is None or not isinstance(flat_map, FlatMap):
            return None
        if not isinstance(layer, Surface):
            return flat_map if flat_map.is_voxels else None
        fits = not flat_map.is_voxels and flat_map.metadata.get("vertices") == len(layer.vertices)
        return flat_map if fits else None

    def set_cuts(self, layer: Layer, cuts: DrawnCuts) -> None:
        """Keep cuts that were drawn on a layer's surface."""
        self._cuts[layer] = cuts
        self.cuts_drawn.emit()

    def cuts_of(self, layer: Layer | None) -> DrawnCuts | None:
        """Return the cuts that were drawn on a layer's surface."""
        return None if layer is None else self._cuts.get(layer)
