"""The surface in space in the colours of its map."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from napari.layers import Surface
from numpy.typing import NDArray

from voxflat._napari.layers.world import from_ras
from voxflat._napari.map_viewer.sheet import Sheet
from voxflat._napari.results.flat_layers import units
from voxflat._napari.results.listed import insert

if TYPE_CHECKING:
    from napari import Viewer
    from napari.layers import Layer


class PaintedSurface:
    """A Surface layer that has the map's colours, to be seen in 3D in the place of what was flattened.

    Parameters
    ----------
    viewer : Viewer
        The viewer.
    """

    def __init__(self, viewer: Viewer) -> None:
        self._viewer = viewer
        self._sheet: Sheet | None = None
        self._covered: Layer | None = None
        self._was_visible = True
        self.layer: Surface | None = None

    @property
    def _is_there(self) -> bool:
        return self.layer is not None and self.layer in self._viewer.layers

    def show(self, sheet: Sheet, colours: NDArray[np.uint8]) -> None:
        """Paint the surface of a map.

        Parameters
        ----------
        sheet : Sheet
            The map.
        colours : ndarray of uint8, shape (N, 4)
            One a point of it.
        """
        if self._is_there and self._sheet is sheet:
            assert self.layer is not None
            self.layer.vertex_colors = colours / 255
            return
        self.remove()
        of, flat_map = sheet.planar._triangles, sheet.run.flat_map
        flat_units = units(flat_map)
        self.layer = Surface(
            (from_ras(sheet.points, sheet.origin.get("world_axes", "RAS")), of.faces[~of.torn]),
            name=f"{sheet.run.name} in the map's colours",
            vertex_colors=colours / 255,
            shading="smooth",
            units=None if flat_units is None else ("mm",) * 3,
            metadata={"voxflat": flat_map},
        )
        self._sheet = sheet
        source = sheet.origin.get("layer")
        if source in self._viewer.layers:
            self._covered = self._viewer.layers[source]  # it lies at the same place, or around it
            self._was_visible, self._covered.visible = self._covered.visible, False
        insert(self._viewer, self.layer)

    def remove(self) -> None:
        """Take the layer out of the viewer."""
        if self._is_there:
            self._viewer.layers.remove(self.layer)
        if self._covered is not None and self._covered in self._viewer.layers:
            self._covered.visible = self._was_visible
        self.layer = self._sheet = self._covered = None
