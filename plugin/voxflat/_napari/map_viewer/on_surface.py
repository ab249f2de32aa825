"""The surface in space in the colours of its map."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from napari.layers import Surface
from numpy.typing import NDArray
from psygnal import Signal

from voxflat._napari.layers.world import from_ras
from voxflat._napari.map_viewer.sheet import Sheet
from voxflat._napari.results.flat_layers import units
from voxflat._napari.results.listed import insert

if TYPE_CHECKING:
    from napari import Viewer
    from napari.layers import Layer


class PaintedSurface:
    """A Surface layer that has the map's colours, to be seen in 3D in the place of what was flattened.

    It is hidden where it is not wanted, and takes up other maps: napari takes a quarter of a second for a layer that
    goes, and a tenth for one that comes.

    Parameters
    ----------
    viewer : Viewer
        The viewer.
    """

    switched = Signal(bool)
    """Someone showed or hid it in the list of layers."""

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
        if self._is_there:
            self.take_up(sheet)
            assert self.layer is not None
            self.layer.vertex_colors = colours / 255
            self._set_visible(True)
            self._cover()
            return
        self.remove()
        data, described = _of(sheet)
        self.layer = Surface(data, vertex_colors=colours / 255, shading="smooth", **described)
        self._sheet = sheet
        self._cover()
        insert(self._viewer, self.layer)
        self.layer.events.visible.connect(self._on_visible)

    def take_up(self, sheet: Sheet) -> None:
        """Become the surface of another map, hidden, if it is there.

        Parameters
        ----------
        sheet : Sheet
            The map.
        """
        if not self._is_there or self._sheet is sheet:
            return
        assert self.layer is not None
        self.hide()
        data, described = _of(sheet)
        self.layer.vertex_colors = None  # there may be another number of points
        self.layer.data = data
        for name, value in described.items():
            if value is not None:
                setattr(self.layer, name, value)
        self._sheet = sheet

    def hide(self) -> None:
        """Show what was flattened as it was before."""
        if self._is_there:
            self._set_visible(False)
        self._uncover()

    def remove(self) -> None:
        """Take the layer out of the viewer."""
        if self._is_there:
            self._viewer.layers.remove(self.layer)
        self._uncover()
        self.layer = self._sheet = None

    def _cover(self) -> None:
        """Hide what lies at the same place, or around it."""
        source = None if self._sheet is None else self._sheet.origin.get("layer")
        if self._covered is None and source in self._viewer.layers:
            self._covered = self._viewer.layers[source]
            self._was_visible, self._covered.visible = self._covered.visible, False

    def _uncover(self) -> None:
        if self._covered is not None and self._covered in self._viewer.layers:
            self._covered.visible = self._was_visible
        self._covered = None

    def _set_visible(self, visible: bool) -> None:
        assert self.layer is not None
        with self.layer.events.visible.blocker(self._on_visible):
            self.layer.visible = visible

    def _on_visible(self) -> None:
        if self._is_there:
            assert self.layer is not None
            self.switched.emit(self.layer.visible)


def _of(sheet: Sheet) -> tuple[Any, dict[str, Any]]:
    """Return the data of a layer of a map's surface, and what it says of itself."""
    of, flat_map = sheet.planar._triangles, sheet.run.flat_map
    points = from_ras(sheet.points, sheet.origin.get("world_axes", "RAS"))
    described = {
        "name": f"{sheet.run.name} in the map's colours",
        "units": None if units(flat_map) is None else ("mm",) * 3,
        "metadata": {"voxflat": flat_map},
    }
    return (points, of.faces[~of.torn]), described
