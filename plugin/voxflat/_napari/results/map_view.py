"""What the viewer shows after flattening: the flat map alone, and the way back to the surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary, WeakSet

import numpy as np

from voxflat._napari.results.flat_layers import LayerData

if TYPE_CHECKING:
    from napari import Viewer
    from napari.layers import Layer

_MARGIN = 0.1  # of the canvas, around the map: room for names and colour bars


class MapView:
    """A viewer that shows either the layers of a flat map, side by side, or what it showed before.

    Flat layers have two dimensions. Over a volume napari would repeat them in every slice, and in 3D show them as a
    sheet amid the volume; so the other layers are hidden, and the viewer turned to its last two axes.

    Parameters
    ----------
    viewer : Viewer
        The viewer.
    """

    def __init__(self, viewer: Viewer) -> None:
        self._viewer = viewer
        self._layers: list[Layer] = []
        self._hidden: list[Layer] = []
        self._before: _State | None = None

    @property
    def shows_map(self) -> bool:
        """Whether it shows the map now."""
        return self._before is not None

    @property
    def layers(self) -> list[Layer]:
        """The flat map's layers that are still in the viewer."""
        return [layer for layer in self._layers if layer in self._viewer.layers]

    def add(self, layers: Sequence[LayerData]) -> None:
        """Add the layers of a new flat map, and show them.

        Parameters
        ----------
        layers : sequence of LayerData
            Those of `FlatLayers`.
        """
        if self._before is None:
            self._before = _State.of(self._viewer)
        _grid(self._viewer, False)  # in which every change of a layer costs napari a tenth of a second
        self._layers = _add(self._viewer, layers)
        self._hidden = [layer for layer in self._layers if not layer.visible]
        self.show_map()

    def add_in_space(self, layers: Sequence[LayerData], source: str) -> None:
        """Add layers of three dimensions to what is shown when the map is not, in the place of what they were made of.

        Parameters
        ----------
        layers : sequence of LayerData
            `FlatLayers.in_space`.
        source : str
            Name of the layer that they stand for.
        """
        self.show_surface()
        if source in self._viewer.layers:
            self._viewer.layers[source].visible = False
        _add(self._viewer, layers)
        self._viewer.dims.ndisplay = 3

    def show_map(self) -> None:
        """Show the flat map, as large as the canvas allows, but for layers that were added hidden."""
        viewer = self._viewer
        layers = [layer for layer in self.layers if layer not in self._hidden]
        if self._before is None:
            self._before = _State.of(viewer)
        for layer in viewer.layers:
            layer.visible = layer in layers
        viewer.dims.ndisplay = 2
        viewer.dims.order = tuple(range(viewer.dims.ndim))
        viewer.layers.selection = set(layers[-1:])
        _scale_bar(viewer).visible = True
        _grid(viewer, len(layers) > 1)
        _frame(viewer, layers)

    def show_surface(self) -> None:
        """Show what was shown before the map."""
        before, self._before = self._before, None
        if before is not None:
            before.restore(self._viewer)


@dataclass
class _State:
    """What of a viewer a map view changes."""

    visible: WeakKeyDictionary[Layer, bool]
    selected: WeakSet[Layer]
    ndisplay: int
    point: tuple[float, ...]
    order: tuple[int, ...]
    camera: dict[str, Any]
    grid: bool
    scale_bar: bool

    @classmethod
    def of(cls, viewer: Viewer) -> _State:
        camera = _camera(viewer)
        return cls(
            visible=WeakKeyDictionary({layer: layer.visible for layer in viewer.layers}),
            selected=WeakSet(viewer.layers.selection),
            ndisplay=viewer.dims.ndisplay,
            point=viewer.dims.point,
            order=viewer.dims.order,
            camera={name: getattr(camera, name) for name in ("center", "zoom", "angles")},
            grid=hasattr(viewer, "canvas") and viewer.canvas.grid.enabled,
            scale_bar=_scale_bar(viewer).visible,
        )

    def restore(self, viewer: Viewer) -> None:
        _grid(viewer, False)
        for layer in viewer.layers:
            layer.visible = self.visible.get(layer, False)
        viewer.layers.selection = {layer for layer in self.selected if layer in viewer.layers}
        if len(self.order) == viewer.dims.ndim:  # else layers of other dimensions came or went
            viewer.dims.order = self.order
        viewer.dims.ndisplay = self.ndisplay
        if len(self.point) == viewer.dims.ndim:
            viewer.dims.point = self.point
        for name, value in self.camera.items():
            setattr(_camera(viewer), name, value)
        _scale_bar(viewer).visible = self.scale_bar
        _grid(viewer, self.grid)


def _frame(viewer: Viewer, layers: Sequence[Layer]) -> None:
    """Fit layers of two dimensions into the canvas, which `Viewer.reset_view` can do only in a viewer of two."""
    corners = np.array([layer.extent.world * _in_units_of(viewer, layer) for layer in layers])
    low, high = corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)
    canvas = viewer.canvas.viewbox_size(viewer.layers) if hasattr(viewer, "canvas") else viewer._canvas_size
    camera = _camera(viewer)
    camera.center = (0, *((low + high) / 2))
    camera.zoom = (1 - _MARGIN) * float(np.min(np.asarray(canvas) / (high - low)))


def _in_units_of(viewer: Viewer, layer: Layer) -> float:
    """Return what a layer's unit is in that of the viewer, which is the smallest of its layers'."""
    units = getattr(viewer.layers.extent, "units", None)
    return 1.0 if units is None else float((1 * layer.units[-1]).to(units[-1]).magnitude)


def _grid(viewer: Viewer, enabled: bool) -> None:
    """Put the visible layers side by side, or not.

    Before 0.9 napari's grid has empty places for hidden layers, so the map's layers lie over each other.
    """
    if hasattr(viewer, "canvas"):
        viewer.canvas.grid.enabled = enabled


def _camera(viewer: Viewer) -> Any:
    return getattr(viewer, "scene", viewer).camera  # napari 0.9 moved it


def _scale_bar(viewer: Viewer) -> Any:
    return viewer.canvas.overlays.scale_bar if hasattr(viewer, "canvas") else viewer.scale_bar


def _add(viewer: Viewer, layers: Sequence[LayerData]) -> list[Layer]:
    """Add layers with their names and colour bars."""
    from napari.layers import Layer

    added = []
    for data, keywords, kind in layers:
        layer = Layer.create(data, keywords, kind)
        layer.name_overlay.visible = True
        if hasattr(layer, "colorbar"):
            layer.colorbar.visible = not getattr(layer, "rgb", False) and "vertex_colors" not in keywords
        added.append(viewer.add_layer(layer))
    return added
