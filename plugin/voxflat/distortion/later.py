"""The distortion of a map that is measured when it is first read, because measuring it can take most of the time."""

from collections.abc import Callable
from threading import Lock

from voxflat.arguments import Progress
from voxflat.distortion.distortion import Distortion


class MeasuredLater:
    """Measures the distortion of a map once, when it is called for the first time."""

    def __init__(self, measure: Callable[[Progress | None], Distortion]) -> None:
        self._measure: Callable[[Progress | None], Distortion] | None = measure
        self._distortion: Distortion | None = None
        self._lock = Lock()

    def __call__(self, progress: Progress | None = None) -> Distortion:
        """Return the distortion; `progress` is called while it is measured."""
        with self._lock:
            if self._distortion is None:
                assert self._measure is not None
                self._distortion = self._measure(progress)
                self._measure = None  # and the surface that it holds
            return self._distortion

    def then(self, change: Callable[[Distortion], Distortion]) -> "MeasuredLater":
        """Return a later distortion with a change that is applied to it when it is measured."""
        return MeasuredLater(lambda progress: change(self(progress)))

    @property
    def is_known(self) -> bool:
        """Whether the distortion has been measured."""
        return self._distortion is not None
