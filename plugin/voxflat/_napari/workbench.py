"""What of a viewer lasts: its runs, which every dock of it shows, and which no dock takes along when it is closed."""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING, Any, ClassVar

from psygnal import Signal

from voxflat._napari.results.flat_layers import FlatLayers
from voxflat._napari.results.run import Run

if TYPE_CHECKING:
    from napari import Viewer


class Workbench:
    """The runs of one viewer; `of` returns a viewer's.

    Docks come and go; they read the runs here, and `changed` tells them to read again.
    """

    changed = Signal()
    """Runs came or went, or another one is the current one."""

    _of: ClassVar[dict[int, Workbench]] = {}

    def __init__(self) -> None:
        self._runs: list[Run] = []
        self._current: Run | None = None
        self._opened: weakref.WeakSet[Run] = weakref.WeakSet()  # runs whose layers come one by one

    @classmethod
    def of(cls, viewer: Viewer) -> Workbench:
        """Return the workbench of a viewer, for as long as the viewer lives.

        Parameters
        ----------
        viewer : Viewer
            The viewer.

        Returns
        -------
        Workbench
        """
        key = id(viewer)  # viewers have no hash
        if key not in cls._of:
            bench = cls._of[key] = cls()
            viewer.layers.events.inserted.connect(bench._adopt)
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

    def add(self, run: Run, *, keep: bool = False) -> None:
        """Make a new run the current one.

        Parameters
        ----------
        run : Run
            The new run.
        keep : bool
            Whether the earlier ones stay; without it the new one takes their place.
        """
        others = [other for other in self._runs if other.flat_map is not run.flat_map]
        self._runs = [*(others if keep else []), run]
        self._current = run
        self.changed.emit()

    def choose(self, run: Run) -> None:
        """Show a run.

        Parameters
        ----------
        run : Run
            One of `runs`.
        """
        if run in self._runs and run is not self._current:
            self._current = run
            self.changed.emit()

    def remove(self, run: Run) -> None:
        """Forget a run.

        Parameters
        ----------
        run : Run
            One of `runs`; others are forgotten already.
        """
        if run not in self._runs:
            return
        self._runs.remove(run)
        if run is self._current:
            self._current = self._runs[-1] if self._runs else None
        self.changed.emit()

    def _adopt(self, event: Any) -> None:
        """Take up a map that comes with its layers, as from a file that is opened, as a run of its own."""
        flat_map = event.value.metadata.get("voxflat")
        if flat_map is None:
            return
        run = next((run for run in self._runs if run.flat_map is flat_map), None)
        if run is None:
            run = Run(FlatLayers(flat_map, []), flat_map.metadata["napari"]["layer"])
            self._opened.add(run)
            self.add(run, keep=True)
        if run in self._opened:
            layer = event.value.as_layer_data_tuple()
            (run.layers.layers if event.value.ndim == 2 else run.layers.in_space).append(layer)
            self.changed.emit()
