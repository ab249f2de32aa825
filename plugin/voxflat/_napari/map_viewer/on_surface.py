"""The surface in 3D, in the colours of its map."""

from typing import Any

import numpy as np
from napari import Viewer
from napari.layers import Image, Layer, Surface
from numpy.typing import NDArray
from qtpy.QtCore import QObject

from voxflat._napari.layers.world import from_ras
from voxflat._napari.map_viewer.prepared_map import PreparedMap
from voxflat._napari.map_viewer.toggled_layer import ToggledLayer
from voxflat._napari.map_viewer.viewer_parts import is_right, stand_upright
from voxflat._napari.results.flat_layers import layer_name, units


class PaintedSurface(ToggledLayer[Surface]):
    """A Surface layer in the colours of the map, shown in 3D instead of the flattened layer."""

    def __init__(self, viewer: Viewer, parent: QObject) -> None:
        super().__init__(viewer, parent)
        self._prepared: PreparedMap | None = None
        self._covered: list[Layer] = []
        viewer.dims.events.ndisplay.connect(self._on_ndisplay)

    def show(self, prepared: PreparedMap, colours: NDArray[np.uint8]) -> None:
        """Show the surface of a map, with one colour per point."""
        if self.there is not None:
            self.take_up(prepared)
            self.there.vertex_colors = colours / 255
            if not self.there.visible:
                self._set_visible(True)
                self._cover()
            return
        self.remove()
        data, described = _of(prepared)
        self._prepared = prepared
        self._cover()
        self._insert(Surface(data, vertex_colors=colours / 255, shading="smooth", **described))

    def take_up(self, prepared: PreparedMap) -> None:
        """Change an existing layer to the surface of another map, and hide it."""
        layer = self.there
        if layer is None or self._prepared is prepared:
            return
        self.hide()
        data, described = _of(prepared)
        layer.vertex_colors = None  # the number of points may change
        layer.data = data
        for name, value in described.items():
            if value is not None:
                setattr(layer, name, value)
        self._prepared = prepared

    def hide(self) -> None:
        """Hide the layer, and restore the visibility of the flattened layer."""
        super().hide()
        self._uncover()

    def remove(self) -> None:
        super().remove()
        self._uncover()
        self._prepared = None

    def release(self) -> None:
        """Remove the layer, and stop following the viewer."""
        super().release()
        self._viewer.dims.events.ndisplay.disconnect(self._on_ndisplay)

    def _on_ndisplay(self) -> None:
        if self.there is not None and self.there.visible:
            self._cover()

    def _cover(self) -> None:
        """Hide the flattened layer and, in 3D, images, which would cover the surface; stand the 3D view upright."""
        assert self._prepared is not None
        self._uncover()
        source, in_3d = self._prepared.session.layer, self._viewer.dims.ndisplay == 3
        for layer in self._viewer.layers:
            is_over = layer.name == source or (in_3d and isinstance(layer, Image) and layer.ndim >= 3)
            if is_over and layer.visible:
                self._covered.append(layer)
                layer.visible = False
        if in_3d:
            right = is_right(self._prepared.points, self._prepared.run.flat_map.origin.structure)
            stand_upright(self._viewer, right=right, world=self._prepared.session.world_axes)

    def _uncover(self) -> None:
        for layer in self._covered:
            if layer in self._viewer.layers:
                layer.visible = True
        self._covered = []


def _of(prepared: PreparedMap) -> tuple[Any, dict[str, Any]]:
    """Return the data of the surface layer of a map, and its properties."""
    flat, flat_map = prepared.planar._triangles, prepared.run.flat_map
    points = from_ras(prepared.points, prepared.session.world_axes)
    name = layer_name(prepared.run.title, "in map colours")
    described = {"name": name, "units": units(flat_map, 3), "metadata": {"voxflat": flat_map}}
    return (points, flat.faces[~flat.torn]), described
