"""The link to the viewer: the location under the mouse, and the ring at the location marked on the map."""

from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np
from napari import Viewer
from napari.layers import Image, Labels
from numpy.typing import NDArray
from qtpy.QtCore import QObject, Signal  # type: ignore[attr-defined]  # qtpy makes it of pyqtSignal
from qtpy.QtWidgets import QWidget

from voxflat._napari.layers.world import from_ras, in_units_of, to_ras
from voxflat._napari.map_viewer.cursor import RingWidget
from voxflat._napari.map_viewer.prepared_map import PreparedMap
from voxflat._napari.map_viewer.viewer_parts import camera, canvas_widget, in_grid, is_click, projected, world_units
from voxflat._napari.results.flat_layers import is_opaque, is_within, place_of
from voxflat._napari.results.session import Session
from voxflat._napari.timers import single_shot
from voxflat._napari.viewer_state import ViewerState

_CLICK = 4  # pixels; a longer movement is not a click


class ViewerLink(QObject):
    """Follows the mouse in the viewer, and marks locations there; its parent is a widget of the viewer window."""

    pointed = Signal(object)  # emitted with the place (u, v) under the mouse, or None outside the surface
    clicked = Signal(object)  # emitted with the place (u, v) of a click

    def __init__(self, viewer: Viewer, inside: QWidget) -> None:
        super().__init__(inside)
        self._viewer = viewer
        self._inside = inside
        self.prepared: PreparedMap | None = None
        self._marked: NDArray[np.float64] | None = None
        self.ring: RingWidget | None = None  # the mark in the viewer; None until a place is marked
        self._drawn = single_shot(self, 15, self._draw)  # draws once after several events of the camera
        self._events = (camera(viewer).events, viewer.dims.events.point, viewer.dims.events.ndisplay)
        for event in self._events:
            event.connect(self._on_view)
        viewer.mouse_move_callbacks.append(self._on_move)
        viewer.mouse_drag_callbacks.append(self._on_press)

    def release(self) -> None:
        self._drawn.stop()
        for event in self._events:
            event.disconnect(self._on_view)
        with suppress(ValueError):
            self._viewer.mouse_move_callbacks.remove(self._on_move)
            self._viewer.mouse_drag_callbacks.remove(self._on_press)
        self.prepared = None
        if self.ring is not None:
            self.ring.hide()
            self.ring.deleteLater()
            self.ring = None

    @property
    def _is_linked(self) -> bool:
        return (
            self.prepared is not None
            and Session.of(self.prepared.run.flat_map) is not None
            and self._viewer.dims.ndim >= 3
        )

    @property
    def _is_painting(self) -> bool:
        """Whether clicks paint on a flat layer."""
        layer = self._viewer.layers.selection.active
        return isinstance(layer, Labels) and layer.ndim == 2 and str(layer.mode) not in ("pan_zoom", "transform")

    @property
    def _units(self) -> NDArray[np.float64]:
        """The units of the world axes in the unit of the map."""
        assert self.prepared is not None
        return world_units(self._viewer, self.prepared.unit)

    def to_world(self, point: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert a point from RAS+ to the world of the viewer; other axes, such as time, keep their position."""
        assert self.prepared is not None
        world = np.asarray(self._viewer.dims.point, dtype=np.float64)
        world[-3:] = from_ras(point[None], self.prepared.session.world_axes)[0] / self._units
        return world

    def _to_ras(self, world: Any) -> NDArray[np.float64]:
        assert self.prepared is not None
        mm = np.asarray(world, dtype=np.float64)[-3:] * self._units
        return np.asarray(to_ras(mm[None], self.prepared.session.world_axes)[0])

    def _place(self, event: Any) -> tuple[float, float] | None:
        """Return the map location under the mouse, in a slice, on the surface, or on an image of the map."""
        if not self._is_linked:
            return None
        assert self.prepared is not None
        flat, place = self._on_flat_layer(event.position)
        if flat:
            return place
        point: NDArray[np.float64] | None = self._to_ras(event.position)
        if self._viewer.dims.ndisplay == 3:
            point = self.prepared.met(self._to_ras(event.position), self._to_ras(event.view_direction))
        return None if point is None else self.prepared.place(point)

    def _on_flat_layer(self, position: Any) -> tuple[bool, tuple[float, float] | None]:
        """Return whether a flat layer is shown at a world position, and the place if the layer is of this map."""
        if self._viewer.dims.ndisplay == 3:
            return False, None
        assert self.prepared is not None
        state = ViewerState.of(self._viewer)
        is_beside = False  # on the transparent pixels of a flat layer
        for layer in reversed(self._viewer.layers):
            if not (layer.visible and isinstance(layer, Image | Labels)):
                continue
            world = in_units_of(layer, position, self._viewer.layers.units)
            run = state.run_of(layer) if layer.ndim == 2 else None
            is_flat = run is not None or (layer.ndim == 2 and "voxflat" in layer.metadata)
            if is_opaque(layer, world):
                is_ours = is_flat and run is self.prepared.run
                return is_flat, place_of(layer, world) if is_ours else None
            is_beside |= is_flat and is_within(layer, world)
        return is_beside, None

    def _on_move(self, viewer: Viewer, event: Any) -> None:
        if self._is_linked:
            self.pointed.emit(self._place(event))

    def _on_press(self, viewer: Viewer, event: Any) -> Iterator[None]:
        if not (yield from is_click(event, _CLICK)):
            return
        place = self._place(event)
        if place is not None and not self._is_painting:
            self.clicked.emit(place)

    def mark(self, point: NDArray[np.float64] | None) -> None:
        """Place the ring at a point in RAS+, or hide it."""
        self._marked = point
        self._draw()

    def follow(self, point: NDArray[np.float64] | None) -> None:
        """Move the ring to a point in RAS+, unless it is hidden."""
        if self._marked is not None:
            self.mark(point)

    def centre(self, point: NDArray[np.float64]) -> None:
        """Move the slices of the viewer to a point in RAS+, and centre the camera on it."""
        if not self._is_linked:
            return
        viewer, world = self._viewer, self.to_world(point)
        viewer.dims.set_point([*range(viewer.dims.ndim)][-3:], world[-3:].tolist())
        camera(viewer).center = (0.0, *world[list(viewer.dims.displayed)])[-3:]

    def _on_view(self) -> None:
        if self._marked is not None:
            self._drawn.start()

    def _draw(self) -> None:
        if self.ring is None and (inside := canvas_widget(self._inside)) is not None:
            self.ring = RingWidget(inside)
        canvas = None if self.ring is None else self.ring.parentWidget()
        if canvas is None or self.ring is None:
            return
        place, prepared = None, self.prepared
        if self._marked is not None and prepared is not None and self._is_linked and not in_grid(self._viewer):
            world = self.to_world(self._marked)
            if not self._on_flat_layer(world)[0]:
                place = projected(self._viewer, world, (canvas.width(), canvas.height()))
        if place is None or prepared is None or not canvas.rect().contains(round(place[0]), round(place[1])):
            self.ring.hide()
        else:
            hidden = [axis for axis in self._viewer.dims.not_displayed if axis >= self._viewer.dims.ndim - 3]
            apart = np.zeros(self._viewer.dims.ndim)
            apart[-3:] = (world - self._viewer.dims.point)[-3:] * self._units
            self.ring.show_at(*place, near=bool((np.abs(apart[hidden]) <= prepared.thickness).all()))
