"""Points and shapes in the volume, shown on the map at the nearest surface points."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from napari import Viewer
from napari.layers import Layer, Points, Shapes
from numpy.typing import NDArray
from qtpy.QtCore import QObject, Signal  # type: ignore[attr-defined]  # qtpy makes it of pyqtSignal

from voxflat._napari.layers.world import LayerPlace, in_units_of, moved
from voxflat._napari.map_viewer.prepared_map import PreparedMap
from voxflat._napari.results.flat_layers import in_unit_of
from voxflat._napari.timers import single_shot
from voxflat.maps.lines import ellipse

_CLOSED = ("polygon", "rectangle", "ellipse")
_LOOKS = ("data", "set_data", "visible", "face_color", "current_face_color", "border_color", "current_border_color")
_SHAPES = ("edge_color", "current_edge_color", "edge_width")
_PLACE = ("scale", "translate", "rotate", "shear", "affine", "units")
_FINER = 2  # steps along a line for each spacing of the surface points
_JUMP = 4.0  # multiple of the usual step; a line crosses a cut where a step is longer


@dataclass(frozen=True, eq=False)
class Annotation:
    """The points and lines of a layer at the displayed time, in RAS+ mm in scanner space."""

    points: NDArray[np.float64]  # (P, 3)
    colours: NDArray[np.uint8]  # (P, 4), one per point
    lines: list[NDArray[np.float64]]  # (k, 3) each; a closed line ends at its first point
    line_colours: NDArray[np.uint8]  # (L, 4), one per line

    @classmethod
    def of(
        cls, layer: Points | Shapes, world: str, point: Sequence[float] | NDArray[np.float64], unit: str = "mm"
    ) -> "Annotation":
        """Read the points or lines of a layer that are displayed at a point in its units.

        Raises InputError if its last three axes are not lengths.
        """
        leading = layer.ndim - 3
        affine = LayerPlace.of(layer, world, leading, unit).affine
        now = np.asarray(layer.world_to_data(np.asarray(point)[-layer.ndim :]))[:leading]
        if isinstance(layer, Shapes):
            seen = [n for n, corners in enumerate(layer.data) if _is_now(corners[:1], now)[0]]
            lines = [moved(_line(layer.data[n][:, leading:], layer.shape_type[n]), affine) for n in seen]
            colours = np.where(layer.edge_color[:, 3:] > 0, layer.edge_color, layer.face_color)[seen]
            return cls(np.empty((0, 3)), np.empty((0, 4), dtype=np.uint8), lines, _bytes(colours))
        data = np.asarray(layer.data, dtype=np.float64)
        seen = layer.shown & _is_now(data, now)
        colours = np.where(layer.face_color[:, 3:] > 0, layer.face_color, layer.border_color)[seen]
        return cls(moved(data[seen][:, leading:], affine), _bytes(colours), [], np.empty((0, 4), dtype=np.uint8))

    def is_same(self, other: "Annotation") -> bool:
        arrays: list[list[Any]] = [[a.points, a.colours, a.line_colours, *a.lines] for a in (self, other)]
        return len(arrays[0]) == len(arrays[1]) and all(map(np.array_equal, *arrays))


@dataclass(frozen=True, eq=False)
class OnMap:
    """Annotations of the volume on the map, with coordinates (u, v) in mm."""

    dots: NDArray[np.float64]
    colours: NDArray[np.uint8]
    lines: list[NDArray[np.float64]]
    line_colours: NDArray[np.uint8]
    excluded: str  # a message about annotations that are too far from the surface; may be empty


def on_map(prepared: PreparedMap, annotations: Sequence[Annotation]) -> OnMap:
    """Project annotations onto the nearest surface points within the distance `far`; lines are split at cuts."""
    points = np.concatenate([np.empty((0, 3)), *(annotation.points for annotation in annotations)])
    colours = np.concatenate([np.empty((0, 4), dtype=np.uint8), *(annotation.colours for annotation in annotations)])
    dots = prepared.places(points)
    is_known = np.isfinite(dots[:, 0])
    lines, line_colours, shapes, far = [], [], 0, 0
    for marking in annotations:
        for line, colour in zip(marking.lines, marking.line_colours, strict=True):
            places = prepared.places(_along(line, prepared))
            parts = split(places, prepared.spacing)
            lines += parts
            line_colours += [colour] * len(parts)
            shapes += 1
            far += bool(np.isnan(places).any())
    beyond = int((~is_known).sum())
    counts = [f"{beyond} of {len(points)} point{'s' * (len(points) > 1)}"] if beyond else []
    counts += [f"all or parts of {far} of {shapes} shape{'s' * (shapes > 1)}"] if far else []
    limit = in_unit_of(prepared.run.flat_map, f"more than {prepared.far:.3g} mm from the surface")
    excluded = f"Not shown ({limit}): {', '.join(counts)}" if counts else ""
    all_colours = np.array(line_colours, dtype=np.uint8).reshape(-1, 4)
    return OnMap(dots[is_known], colours[is_known], lines, all_colours, excluded)


def split(places: NDArray[np.float64], spacing: float) -> list[NDArray[np.float64]]:
    """Split a line of shape (k, 2) on the map at NaN and at jumps across cuts, and drop single points."""
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    usual = float(np.median(steps[np.isfinite(steps)])) if np.isfinite(steps).any() else 0.0
    breaks = np.flatnonzero(~(steps <= _JUMP * max(usual, spacing))) + 1
    return [part for part in np.split(places, breaks) if len(part) > 1]


def _along(line: NDArray[np.float64], prepared: PreparedMap) -> NDArray[np.float64]:
    """Sample a line more finely than the surface points; a part that is far from the surface becomes a single NaN."""
    low, high = prepared.points.min(axis=0) - prepared.far, prepared.points.max(axis=0) + prepared.far
    step = prepared.spacing / _FINER
    points, nothing = [np.empty((0, 3))], np.full((1, 3), np.nan)
    for a, b in pairwise(line):
        along = b - a
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # the line may be parallel to some axes
            ends = np.sort([(low - a) / along, (high - a) / along], axis=0)
        inside = (low <= a) & (a <= high)  # for axes perpendicular to the line
        start = max(0.0, np.max(np.where(along == 0, np.where(inside, -np.inf, np.inf), ends[0])))
        end = min(1.0, np.min(np.where(along == 0, np.inf, ends[1])))
        if start > 0:
            points.append(nothing)
        if start <= end:
            count = 2 + int((end - start) * np.linalg.norm(along) / step)
            points.append(a + np.linspace(start, end, count)[:, None] * along)
        if end < 1:
            points.append(nothing)
    return np.concatenate(points)


def _line(corners: NDArray[np.float64], kind: str) -> NDArray[np.float64]:
    """Return the outline of a shape; closed outlines end at their first point."""
    line = ellipse(corners) if kind == "ellipse" else np.asarray(corners, dtype=np.float64)
    return np.concatenate([line, line[:1]]) if kind in _CLOSED else line


def _is_now(data: NDArray[Any], now: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return a mask of the points in the displayed step of the leading axes, such as time."""
    return np.asarray((np.abs(data[:, : len(now)] - now) <= 0.5).all(axis=1))


def _bytes(colours: NDArray[Any]) -> NDArray[np.uint8]:
    return np.round(255 * np.asarray(colours, dtype=np.float64)).astype(np.uint8).reshape(-1, 4)


class VolumeAnnotations(QObject):
    """Follows the visible Points and Shapes layers of the viewer."""

    changed = Signal()  # emitted once after one or more changes that may affect annotations

    def __init__(self, viewer: Viewer, parent: QObject) -> None:
        super().__init__(parent)
        self._viewer = viewer
        self._events: list[Any] = []
        self._soon = single_shot(self, 0, self.changed)
        self._of_list = (viewer.layers.events.inserted, viewer.layers.events.removed)
        for event in self._of_list:
            event.connect(self._on_layers)
        self._on_layers()

    @property
    def layers(self) -> list[Layer]:
        """The followed layers, excluding layers that voxflat itself adds, such as cuts."""
        layers = [layer for layer in self._viewer.layers if isinstance(layer, Points | Shapes) and layer.ndim >= 3]
        return [layer for layer in layers if "voxflat" not in layer.metadata]

    @property
    def is_busy(self) -> bool:
        return bool(self._soon.isActive())

    def taken(self, world: str, unit: str) -> list[Annotation]:
        """Read the annotations of all visible layers; raises InputError if the axes of a layer have no length units."""
        point, units = self._viewer.dims.point, self._viewer.layers.units
        seen = [layer for layer in self.layers if layer.visible]
        return [Annotation.of(layer, world, in_units_of(layer, point, units), unit) for layer in seen]

    def release(self) -> None:
        self._soon.stop()
        self._follow([])
        for event in self._of_list:
            event.disconnect(self._on_layers)

    def _on_layers(self) -> None:
        self._follow(self.layers)
        self._soon.start()

    def _follow(self, layers: list[Layer]) -> None:
        for event in self._events:
            event.disconnect(self._on_change)
        names = (*_LOOKS, *_SHAPES, *_PLACE)
        self._events = [getattr(layer.events, name) for layer in layers for name in names if name in layer.events]
        for event in self._events:
            event.connect(self._on_change)

    def _on_change(self) -> None:
        self._soon.start()
