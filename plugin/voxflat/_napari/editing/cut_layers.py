"""The layers of the viewer that show the cuts, and the surface on which they are drawn."""

import weakref
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from napari import Viewer
from napari.layers import Layer, Points, Vectors
from napari.layers import Surface as SurfaceLayer
from numpy.typing import NDArray
from qtpy.QtCore import QObject, QTimer, Signal  # type: ignore[attr-defined]  # qtpy makes it of pyqtSignal

from voxflat._napari.editing.drawing import Drawing
from voxflat._napari.map_viewer.viewer_parts import is_right, look_from_side
from voxflat._napari.results.layer_list import drop_controls, insert, make_controls
from voxflat._napari.timers import PAUSE

_GREYS = (0.72, 0.45)  # grey levels of gyri and sulci
_CUT = "#ff5a36"
_LEFT_OUT = (0.55, 0.4, 0.35)  # factors of red, green and blue where the surface is excluded
_WIDTH = 0.006  # line width, as a fraction of the surface size


class CutLayers(QObject):
    """Shows a drawing in a viewer; its layers are added one at a time, so that the window stays responsive."""

    appeared = Signal()  # emitted when all layers are in the viewer, and the camera shows them

    def __init__(
        self,
        viewer: Viewer,
        drawing: Drawing,
        curvature: NDArray[np.float64],
        places: NDArray[np.float64],
        unit: str | None,
        name: str,
        world: str,
        parent: QObject,
    ) -> None:
        super().__init__(parent)
        self._viewer = weakref.proxy(viewer)
        self._drawing = drawing
        self.places = places  # coordinates of the displayed vertices, mm along the axes of the world
        size = float(np.linalg.norm(np.ptp(places, axis=0)))
        common: dict[str, Any] = {"units": None if unit is None else (unit,) * 3, "metadata": {"voxflat": None}}
        gyri, sulci = _GREYS
        greys = np.where(curvature < 0, sulci, gyri)
        self._colours = np.column_stack([greys, greys, greys, np.ones(len(greys))])
        self._left_out = drawing.left_out
        look = {"vertex_colors": self._colours, "shading": "smooth"}
        self.surface = SurfaceLayer((places, drawing.surface.faces), name=f"{name} (cuts)", **look, **common)
        common |= {"ndim": 3, "blending": "translucent_no_depth"}
        look = {"edge_color": _CUT, "edge_width": _WIDTH * size, "vector_style": "line"}
        self.lines = Vectors(np.empty((0, 2, 3)), name="cuts", **look, **common)
        look = {"face_color": _CUT, "size": 2 * _WIDTH * size, "border_color": "white"}
        self.stops = Points(np.empty((0, 3)), name="cut points", **look, **common)
        self._world = world
        self._hidden: list[Layer] = []
        self._steps: deque[Callable[[], None]] = deque([self._hide_others])
        for layer in self.layers:  # not selected, because the controls of points enlarge a small window
            self._steps += [partial(make_controls, viewer, layer), partial(insert, viewer, layer)]
        self._steps += [partial(setattr, viewer.dims, "ndisplay", 3), self._look]
        self._timer = QTimer(self)
        self._timer.setInterval(PAUSE)
        self._timer.timeout.connect(self._take_step)
        self._timer.start()

    def _take_step(self) -> None:
        self._steps.popleft()()
        if not self._steps:
            self._timer.stop()
            self.appeared.emit()

    def _hide_others(self) -> None:
        self._hidden = [layer for layer in self._viewer.layers if layer.visible]
        for layer in self._hidden:
            layer.visible = False

    def _look(self) -> None:
        if self.is_there:
            self._viewer.layers.selection = {self.surface}
        right = is_right(self._drawing.points, self._drawing.surface.origin.structure)
        look_from_side(self._viewer, right=right, world=self._world)
        self.update()

    @property
    def is_coming(self) -> bool:
        """Whether layers have yet to be added."""
        return bool(self._steps)

    @property
    def layers(self) -> tuple[Layer, ...]:
        return (self.surface, self.lines, self.stops)

    @property
    def is_there(self) -> bool:
        """Whether the surface is still in the viewer."""
        return self.surface in self._viewer.layers

    def update(self) -> None:
        ways = [self.places[self._drawing.vertices(cut)] for cut in self._drawing.cuts]
        pieces = [np.stack([way[:-1], np.diff(way, axis=0)], axis=1) for way in ways]
        self.lines.data = np.concatenate([np.empty((0, 2, 3)), *pieces])
        if not np.array_equal(self._drawing.left_out, self._left_out):
            self._left_out = self._drawing.left_out
            colours = self._colours.copy()
            colours[self._drawing.surface.find(self._left_out), :3] *= _LEFT_OUT
            self.surface.vertex_colors = colours
        last = self._drawing.cuts[-1].stops if self._drawing.is_open else ()
        self.stops.data = self.places[np.array(last, dtype=np.int64)]

    def remove(self) -> None:
        """Remove the layers, and show the layers that were visible before."""
        self._timer.stop()
        self._steps.clear()
        for layer in self.layers:
            if layer in self._viewer.layers:
                self._viewer.layers.remove(layer)
            else:
                drop_controls(self._viewer, layer)
        for layer in self._hidden:
            if layer in self._viewer.layers:
                layer.visible = True
        self._hidden = []
        self.deleteLater()
