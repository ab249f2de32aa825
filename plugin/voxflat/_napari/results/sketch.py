"""The points, regions and distance that the user draws on a map."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from napari.layers import Layer
from numpy.typing import NDArray

from voxflat._napari.history import History

Place: TypeAlias = tuple[float, float]  # (u, v), mm
Mark: TypeAlias = tuple[int | None, Place]  # with the frame of a movie
Polygon: TypeAlias = tuple[Place, ...]

SKETCH = ("marks", "regions", "distance", "corners", "ends")
"""The fields of a sketch, which the description of a saved map contains."""


POINTS, PATH = "points", "shortest path"
"""The parts of a map that layers show: the marked points, and the path of the measured distance."""


def regions_part(frame: int | None) -> str:
    """Return the part of a map that the layer with its regions shows, at a frame of a movie."""
    return "regions" if frame is None else f"regions of frame {frame}"


@dataclass(frozen=True)
class Sketch:
    """Points, regions and a measured distance, each with the frame of a movie to which it belongs, or None."""

    marks: tuple[Mark, ...] = ()
    regions: tuple[tuple[int | None, Polygon], ...] = ()
    distance: tuple[int | None, Polygon] | None = None  # the last one, from a place to another
    corners: Polygon = ()  # of the region that is being drawn
    ends: Polygon = ()  # of the distance that is being measured

    @classmethod
    def of(cls, record: Mapping[str, Any]) -> "Sketch":
        """Read a sketch from the description of a saved map."""
        marks = tuple((frame, _place(place)) for frame, place in record.get("marks", ()))
        regions = tuple((frame, tuple(map(_place, corners))) for frame, corners in record.get("regions", ()))
        distance = record.get("distance")
        corners, ends = (tuple(map(_place, record.get(name, ()))) for name in ("corners", "ends"))
        return cls(marks, regions, distance and (distance[0], tuple(map(_place, distance[1]))), corners, ends)

    def record(self) -> dict[str, Any]:
        """Return the drawings for the description of a saved map."""
        return {name: found for name in SKETCH if (found := getattr(self, name))}

    def without_unfinished(self) -> "Sketch":
        return replace(self, corners=(), ends=())

    def without(self, part: str) -> "Sketch":
        """Return the sketch without the drawings that one layer shows."""
        if part == POINTS:
            return replace(self, marks=())
        if part == PATH:
            return replace(self, distance=None)
        return replace(self, regions=tuple(one for one in self.regions if regions_part(one[0]) != part))

    def regions_in(self, frame: int | None) -> list[Polygon]:
        return [corners for of, corners in self.regions if of == frame]


def _place(place: Sequence[float]) -> Place:
    u, v = place
    return float(u), float(v)


def _without(marks: tuple[Mark, ...], lost: list[Mark]) -> tuple[Mark, ...]:
    left = [*marks]
    for mark in lost:
        if mark in left:
            left.remove(mark)
    return tuple(left)


class Sketches(History[Sketch]):
    """The drawing on one map, which exists as long as the map, and its state that the layers of the viewer show."""

    def __init__(self, first: Sketch | None = None) -> None:
        super().__init__(first or Sketch())
        self.saved = self.now  # in the file of the map
        self.shown = Sketch()
        self.placed: list[NDArray[np.float64]] = []  # world coordinates of the marks of `shown`
        self.layers: dict[str, Layer] = {}  # of the viewer, by the part of the map that they show

    def remove(self, part: str) -> None:
        """Remove the drawings of a layer that the user has removed from the viewer."""
        del self.layers[part]
        if part == POINTS:
            self.placed = []
        self.shown = self.shown.without(part)
        if self.now != (left := self.now.without(part)):
            self.do(left)

    def remove_points(self, places: Iterable[NDArray[np.float64]]) -> None:
        """Remove the marks at world coordinates, because the user has deleted their points."""
        gone: list[int] = []
        for place in places:
            near = (n for n, placed in enumerate(self.placed) if n not in gone and np.allclose(placed, place))
            gone += [n for n in [next(near, None)] if n is not None]
        lost = [self.shown.marks[n] for n in gone]
        if lost:
            self.placed = [placed for n, placed in enumerate(self.placed) if n not in gone]
            self.shown = replace(self.shown, marks=_without(self.shown.marks, lost))
            self.do(replace(self.now, marks=_without(self.now.marks, lost)))

    @property
    def is_empty(self) -> bool:
        return self.now == Sketch() and not (self.can_undo or self.can_redo)

    @property
    def is_shown(self) -> bool:
        return self.now.without_unfinished() == self.shown.without_unfinished()
