"""The seed point, which is a point of a Points layer and can be set by clicking in the viewer."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from napari import Viewer
from napari.layers import Layer, Points, Surface
from napari.utils.notifications import show_warning
from numpy.typing import NDArray
from qtpy.QtCore import Signal  # type: ignore[attr-defined]  # qtpy makes it of pyqtSignal
from qtpy.QtWidgets import QGridLayout, QLabel, QPushButton, QWidget

from voxflat._napari.forms.layer_choice import LayerChoice
from voxflat._napari.layers.seed import MARKER, Seed, data_place, describe, first_vertex, first_voxel, seed_at, seed_of
from voxflat._napari.layers.volumes import finest
from voxflat._napari.layers.world import MADE_FROM, data_to_world, in_units_of
from voxflat._napari.map_viewer.viewer_parts import is_click


class SeedChoice(QWidget):
    """Lets the user choose a Points layer, whose selected or last point is the seed; *Pick* sets it with a click."""

    picking = Signal()  # emitted when the next click on the surface sets the seed

    def __init__(self, viewer: Viewer, inside: Callable[[NDArray[Any]], NDArray[Any]]) -> None:
        super().__init__()
        self._viewer = viewer
        self._inside = inside
        self._surface: Layer | None = None
        self._points: Points | None = None
        self._events: tuple[Any, ...] = ()
        self._layers = LayerChoice(viewer, _rank)
        self._layers.setPlaceholderText("no point (click Pick)")
        self._layers.setToolTip("A Points layer. The seed is the surface point nearest to its selected or last point")
        self.pick = QPushButton("Pick")
        self.pick.setCheckable(True)
        self.pick.setToolTip("Press this button, then click on the surface in the viewer, either in a slice or in 3D")
        self._text = QLabel()
        layout = QGridLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setColumnStretch(0, 1)
        layout.addWidget(self._layers, 0, 0)
        layout.addWidget(self.pick, 0, 1)
        layout.addWidget(self._text, 1, 0, 1, 2)
        self._layers.chosen.connect(self._follow)
        self.pick.toggled.connect(self._on_pick)
        self._follow()

    @property
    def point(self) -> Seed | None:
        """The voxel or vertex of the surface at the seed point, or None if there is no seed point."""
        if self._points is None or self._surface is None or self._surface.ndim != 3:
            return None
        return seed_of(self._points, self._surface)

    def set_surface(self, layer: Layer | None) -> None:
        """Set the layer whose voxels or vertices can be the seed."""
        self._surface = layer
        self.pick.setEnabled(layer is not None and layer.ndim == 3)
        self._on_changed()

    def set_point(self, seed: Seed) -> None:
        """Mark a voxel or vertex of the surface in a Points layer of the viewer."""
        surface = self._surface
        assert surface is not None
        point, affine = data_place(surface, seed), data_to_world(surface)
        if self._points is not None and self._points.name == MARKER["name"] and len(self._points.data) <= 1:
            self._points.affine, self._points.units = affine, surface.units
            self._points.data = [point]
        else:
            before = set(self._viewer.layers.selection)
            self._layers.choose(self._viewer.add_points([point], **MARKER, affine=affine, units=surface.units))
            self._viewer.layers.selection = before
        self._on_changed()

    def keep(self) -> None:
        """Keep the current layer as if the user had chosen it."""
        self._layers.keep()

    def record(self) -> list[int] | int | None:
        return list(self.point) if isinstance(self.point, tuple) else self.point

    def restore(self, seed: list[int] | int | None) -> str:
        """Mark a recorded voxel or vertex of the surface, unless it is marked already."""
        if seed is None or seed == self.record() or self._surface is None:
            return ""
        surface, place = self._surface, np.atleast_1d(seed)
        size = [len(surface.vertices)] if isinstance(surface, Surface) else list(finest(surface).shape)
        if len(place) != len(size) or not np.all((place >= 0) & (place < size)):
            return f"{seed} is outside '{surface.name}'"
        self.set_point(seed if isinstance(seed, int) else (seed[0], seed[1], seed[2]))
        return ""

    def release(self) -> None:
        self.pick.setChecked(False)
        self._layers.release()
        self._unfollow()

    def _follow(self) -> None:
        self._unfollow()
        self._points = self._layers.layer
        if self._points is not None:
            events = self._points.events
            # `highlight`: other points are selected
            self._events = (events.data, events.highlight, events.affine, events.units)
            for event in self._events:
                event.connect(self._on_changed)
        self._on_changed()

    def _unfollow(self) -> None:
        for event in self._events:
            event.disconnect(self._on_changed)
        self._events = ()

    def _on_changed(self) -> None:
        is_usable = self._points is not None and self._surface is not None and self._surface.ndim == 3
        self._text.setText(describe(self._points, self._surface) if is_usable else "")

    def _on_pick(self, active: bool) -> None:
        callbacks = self._viewer.mouse_drag_callbacks
        if active:
            self.picking.emit()
            layer = self._viewer.layers.selection.active
            if layer is not None:
                layer.mode = "pan_zoom"  # so that the click does not paint
            if isinstance(self._surface, Surface):
                self._viewer.dims.ndisplay = 3  # because napari shows almost nothing of a mesh in slices
            callbacks.append(self._on_click)
            self._viewer.status = "Click on the surface to set the seed point"
        elif self._on_click in callbacks:
            callbacks.remove(self._on_click)

    def _on_click(self, viewer: Viewer, event: Any) -> Iterator[None]:
        """Set the seed where the mouse is clicked without being moved."""
        if not (yield from is_click(event)):
            return
        if self._surface is None or not self._surface.visible:
            show_warning("The layer to flatten is hidden. Show the layer, then click on the surface")
            return
        seed = self._clicked(viewer, self._surface, event)
        if seed is None:
            show_warning("There is no surface at this position. Click on the mesh, or on the foreground of the volume")
            return
        self.pick.setChecked(False)
        self.set_point(seed)

    def _clicked(self, viewer: Viewer, surface: Layer, event: Any) -> Seed | None:
        position = in_units_of(surface, event.position, viewer.layers.units)
        if viewer.dims.ndisplay == 2:
            return seed_at(surface, position)
        start, end = surface.get_ray_intersections(position, event.view_direction, event.dims_displayed)
        if start is None:
            return None
        if isinstance(surface, Surface):
            return first_vertex(surface, start, end)
        return first_voxel(surface, start, end, self._inside)


def _rank(layer: Layer) -> int | None:
    return int(layer.ndim >= 3 and MADE_FROM not in layer.metadata) if isinstance(layer, Points) else None
