"""What of a viewer lasts: its runs, which every dock of it shows, and which no dock takes along when it is closed."""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING, ClassVar

from psygnal import Signal

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
            cls._of[key] = cls()
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
        self._runs = [*(self._runs if keep else []), run]
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
