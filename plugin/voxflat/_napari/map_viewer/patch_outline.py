"""The outline of the flattened part: its surface in slices, and its border and cuts in 3D."""

from functools import partial
from typing import TypeAlias

import numpy as np
import scipy
from napari import Viewer
from napari.layers import Vectors
from numpy.typing import NDArray
from qtpy.QtCore import QObject, Signal  # type: ignore[attr-defined]  # qtpy makes it of pyqtSignal

from voxflat._napari.layers.world import from_ras, to_ras
from voxflat._napari.map_viewer.prepared_map import PreparedMap
from voxflat._napari.map_viewer.toggled_layer import ToggledLayer
from voxflat._napari.map_viewer.viewer_parts import world_units
from voxflat._napari.results.flat_layers import layer_name, units
from voxflat._napari.worker import LatestTask
from voxflat.unique_rows import distinct

_PART, _CUT = np.array([1.0, 0.82, 0.25, 1.0]), np.array([1.0, 0.35, 0.21, 1.0])  # red, green, blue, opacity
_WIDTH = 0.006  # width of lines in 3D, as a fraction of the surface size; half as wide in slices
_MARK = 1.5  # half the length of a cut mark in a slice, as a multiple of that width

Segments: TypeAlias = NDArray[np.float64]  # line segments, shape (S, 2, 3), by their ends, RAS+ mm in scanner space


def width(prepared: PreparedMap) -> float:
    """Return a line width, in mm, that is visible when the whole surface is in view."""
    return _WIDTH * float(np.linalg.norm(np.ptp(prepared.points, axis=0)))


def edges(prepared: PreparedMap) -> tuple[Segments, Segments]:
    """Return the border of the flattened part, and its cuts or, for a page, its seams."""
    lines = (np.column_stack([line[:-1], line[1:]]) for line in prepared.rim)
    pairs = np.concatenate([np.empty((0, 2), np.int64), *lines])
    rows, which = np.unique(pairs, return_inverse=True)
    same = distinct(prepared.points[rows]).which  # the two sides of a cut have the same coordinates
    ends = distinct(np.sort(same[which].reshape(-1, 2), axis=1))
    found = prepared.points[pairs[ends.first]]
    return found[ends.counts == 1], found[ends.counts > 1]


def lifted(prepared: PreparedMap, segments: Segments) -> Segments:
    """Move segments slightly outside the surface, so that the surface does not hide them."""
    rows = scipy.spatial.cKDTree(prepared.points).query(segments.reshape(-1, 3))[1]
    outwards = np.nan_to_num(prepared.planar._triangles.on_surface.normals[rows])  # NaN if neither side is outside
    return np.asarray(segments + width(prepared) / 2 * outwards.reshape(segments.shape))


def in_slice(prepared: PreparedMap, cuts: Segments, axis: int, level: float) -> tuple[Segments, Segments]:
    """Return the intersection of the surface with a plane perpendicular to an RAS axis, and marks at its cuts."""
    flat, points = prepared.planar._triangles, prepared.points
    above = points[:, axis] - level > 0
    corners = above[flat.faces]
    met = flat.faces[(corners.any(axis=1) & ~corners.all(axis=1)) & ~flat.torn].astype(np.int64)
    lone = above[met].sum(axis=1) == 1
    alone = np.argmax(above[met] == lone[:, None], axis=1)  # the only corner on its side of the plane
    first, second, third = (points[met[np.arange(len(met)), (alone + step) % 3]] for step in range(3))
    surface = np.stack([_between(first, end, axis, level) for end in (second, third)], axis=1)
    crossing = (cuts[:, 0, axis] > level) != (cuts[:, 1, axis] > level)
    places = _between(cuts[crossing, 0], cuts[crossing, 1], axis, level)
    if not len(places) or not len(surface):
        return surface, np.empty((0, 2, 3))
    nearest = scipy.spatial.cKDTree(surface.mean(axis=1)).query(places)[1]
    along = surface[nearest, 1] - surface[nearest, 0]
    across = np.cross(along, np.eye(3)[axis])
    across *= _MARK * width(prepared) / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    return surface, np.stack([places - across, places + across], axis=1)


def _between(a: NDArray[np.float64], b: NDArray[np.float64], axis: int, level: float) -> NDArray[np.float64]:
    """Return the points at which edges cross a plane."""
    above, below = a[:, axis] - level, b[:, axis] - level
    share = above / (above - below)
    cut = a + share[:, None] * (b - a)
    cut[:, axis] = level
    return np.asarray(cut)


_View: TypeAlias = tuple[int, float] | None  # the displayed slice: the RAS axis across it and its position, mm; or 3D


def _drawn(
    prepared: PreparedMap, outline: tuple[Segments, Segments] | None, view: _View
) -> tuple[PreparedMap, tuple[Segments, Segments], Segments, int]:
    """Compute the displayed segments; called in a thread."""
    found = edges(prepared) if outline is None else outline
    part, marks = (lifted(prepared, lines) for lines in found) if view is None else in_slice(prepared, found[1], *view)
    segments = from_ras(np.concatenate([part, marks]), prepared.session.world_axes)
    return prepared, found, segments.reshape(-1, 2, 3), len(part)


class PatchOutline(ToggledLayer[Vectors]):
    """A Vectors layer that shows the flattened surface and its cuts in slices, and its border and cuts in 3D."""

    failed = Signal(object)  # emitted with the error if the outline could not be computed

    def __init__(self, viewer: Viewer, parent: QObject) -> None:
        super().__init__(viewer, parent)
        self._prepared: PreparedMap | None = None
        self._known: tuple[Segments, Segments] | None = None
        self._view: _View | str = "none yet"
        self._is_wanted = False
        self._finder = LatestTask(self, self._on_found, self.failed)
        self._events = (viewer.dims.events.point, viewer.dims.events.ndisplay, viewer.dims.events.order)
        for event in self._events:
            event.connect(self._on_view)

    @property
    def is_busy(self) -> bool:
        return self._finder.is_busy or self.is_coming

    def show(self, prepared: PreparedMap) -> None:
        """Show the outline of the part of the surface that a map shows."""
        self.take_up(prepared)
        self._is_wanted, self._view = True, "none yet"
        self._on_view()

    def take_up(self, prepared: PreparedMap) -> None:
        """Change to the outline of another map, whether visible or not."""
        if prepared is self._prepared:
            return
        self._prepared, self._known = prepared, None
        if self.there is not None and not self._is_wanted:
            self._describe(self.there)
            self.there.data = np.empty((0, 2, 3))

    def hide(self) -> None:
        self._is_wanted = False
        super().hide()

    def remove(self) -> None:
        self._prepared = self._known = None
        self._is_wanted = False
        super().remove()

    def release(self) -> None:
        """Stop following the viewer, and remove the layer from it."""
        self._finder.stop()
        for event in self._events:
            event.disconnect(self._on_view)
        super().release()

    def _on_view(self) -> None:
        """Compute the outline if the displayed slice has changed."""
        if self._prepared is None or not self._is_wanted:
            return
        dims = self._viewer.dims
        view: _View = None
        if dims.ndisplay == 2 and dims.ndim >= 3:
            across = [axis - dims.ndim + 3 for axis in dims.not_displayed if axis >= dims.ndim - 3]
            if len(across) != 1:  # for example, a slice along time
                return
            world = self._prepared.session.world_axes
            point = np.asarray(dims.point, dtype=np.float64)[-3:] * world_units(self._viewer, self._prepared.unit)
            axis = int(np.abs(to_ras(np.eye(3)[across], world)[0]).argmax())
            view = axis, float(to_ras(point[None], world)[0, axis])
        if view != self._view:
            self._view = view
            self._finder.ask(partial(_drawn, self._prepared, self._known, view))

    def _on_found(self, result: tuple[PreparedMap, tuple[Segments, Segments], Segments, int]) -> None:
        prepared, outline, segments, parts = result
        if prepared is not self._prepared:
            return
        self._known = outline
        if not self._is_wanted:
            return
        colours = np.where(np.arange(len(segments))[:, None] < parts, _PART, _CUT)
        layer = self.there
        step = self._step() if layer is None else layer.scale[0]
        seen = width(prepared) / (1 if self._view is None else 2) / step
        vectors = np.stack([segments[:, 0], segments[:, 1] - segments[:, 0]], axis=1) / step  # starts and directions
        if layer is not None:
            self._describe(layer)
            if layer.edge_width != seen:
                layer.edge_width = seen
            layer.data = vectors
            self._set_visible(True)  # napari would draw the old lines of a hidden layer in these colours
            layer.edge_color = colours
            return
        look = {"edge_width": seen, "edge_color": colours if len(colours) else _PART, "vector_style": "line"}
        layer = Vectors(vectors, ndim=3, scale=(step,) * 3, units=units(prepared.run.flat_map, 3), **look)
        self._describe(layer)
        self._insert(layer)

    def _describe(self, layer: Vectors) -> None:
        assert self._prepared is not None
        layer.metadata = {"voxflat": self._prepared.run.flat_map}
        layer.name = layer_name(self._prepared.run.title, "outline")

    def _step(self) -> float:
        """Return the largest slice spacing; a layer with a finer grid would refine the steps of the sliders."""
        if self._viewer.dims.ndim < 3 or self._prepared is None:
            return 1.0
        steps = [step for _, _, step in self._viewer.dims.range][-3:] * world_units(self._viewer, self._prepared.unit)
        return float(np.max(steps)) or 1.0
