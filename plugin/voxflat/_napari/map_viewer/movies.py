"""The window of *Movie*: a layer with the values of all frames on the map, linked to the time slider of the viewer."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from napari import Viewer
from napari.layers import Image, Labels, Layer
from qtpy.QtCore import QObject, Signal  # type: ignore[attr-defined]  # qtpy makes it of pyqtSignal
from qtpy.QtWidgets import QWidget

from voxflat._napari.layers.sampled import Shown, shown
from voxflat._napari.layers.volumes import shown_step
from voxflat._napari.map_viewer.flat_window import FlatWindow
from voxflat._napari.map_viewer.viewer_parts import list_events, show_scale_bar
from voxflat._napari.results.flat_layers import LayerData, MovieMaps, limits
from voxflat.arguments import Progress
from voxflat.errors import Cancelled, InputError
from voxflat.maps.raster import FlatImage


class MovieWindow(QObject):
    """Shows flat movies in a second window of napari; the time sliders of both windows move together."""

    pointed = Signal(float, float)  # emitted with the position (u, v) of the mouse
    layers_changed = Signal()  # emitted when layers of the window are added, removed or renamed

    def __init__(self, viewer: Viewer, owner: QWidget) -> None:
        super().__init__(owner)
        self._viewer = viewer
        self._movie: MovieMaps | None = None
        self._linked: Viewer | None = None
        self.window = FlatWindow(owner, "Flat movie")

    @property
    def layers(self) -> list[Layer]:
        return [] if self.window.viewer is None else list(self.window.viewer.layers)

    def show(self, movie: MovieMaps, data: LayerData) -> None:
        """Show a movie; layers of the maps of other movies are removed."""
        if self._movie is not movie and self.window.viewer is not None:
            self.window.viewer.layers.clear()
        self._movie = movie
        self.window.show(data)
        flat = self.window.viewer
        assert flat is not None
        if self._linked is not flat:
            self._linked = flat
            flat.dims.events.current_step.connect(self._on_own_step)
            flat.mouse_move_callbacks.append(self._on_move)
            for event in list_events(flat.layers):
                event.connect(self._on_layers)
            show_scale_bar(flat)
            self.layers_changed.emit()
        self.go_to(movie.time.frame(self._viewer.dims.point, len(movie.series)))

    def go_to(self, frame: int) -> None:
        """Show a frame."""
        flat = self.window.viewer
        if flat is not None and self._movie is not None and flat.dims.ndim > 2:
            flat.dims.set_current_step(0, frame)

    def close(self) -> None:
        self.window.close()
        self._linked = self._movie = None

    def _on_own_step(self) -> None:
        flat, movie = self.window.viewer, self._movie
        if flat is None or movie is None or flat.dims.ndim < 3:
            return
        axis, frame = self._viewer.dims.ndim + movie.time.axis, flat.dims.current_step[0]
        if axis >= 0 and movie.time.frame(self._viewer.dims.point, len(movie.series)) != frame:
            self._viewer.dims.set_point(axis, movie.time.place(frame))

    def _on_layers(self) -> None:
        self.layers_changed.emit()

    def _on_move(self, viewer: Viewer, event: Any) -> None:
        self.pointed.emit(float(event.position[-1]), -float(event.position[-2]))


def shown_frames(
    layer: Layer, world: str, movie: MovieMaps, point: Sequence[float], **how: Any
) -> tuple[list[Shown], dict[str, Any]]:
    """Read the values of a layer for each frame of a movie, at the other coordinates of a point of the viewer."""
    if not isinstance(layer, Image | Labels):
        raise InputError("A movie needs an Image or Labels layer. Choose one under Shows, then press Movie")
    if getattr(layer, "rgb", False):
        raise InputError(f"Layer '{layer.name}' contains colours. Choose a layer with one value per voxel")
    found, at = [], np.array(point, dtype=np.float64)
    for frame in range(len(movie.series)):
        at[movie.time.axis] = movie.time.place(frame)
        found.append(shown(layer, world, step=shown_step(layer, at.tolist()), **how))
    look = {"blending": layer.blending} if isinstance(layer, Image) else {}
    return found, look


def flat_movie(movie: MovieMaps, frames: list[Shown], look: dict[str, Any], progress: Progress) -> LayerData:
    """Return a layer (frame, row, column) with the values of all frames; called in a thread."""
    images: list[FlatImage] = []
    for number, (flat_map, values) in enumerate(zip(movie.series, frames, strict=True)):
        if progress("sampling the frames", number, len(frames)) is False:
            raise Cancelled("cancelled while sampling the frames")
        images.append(values.image(flat_map, None))
    data, image, one = np.stack([image.data for image in images]), images[0], frames[0]
    (u, v), size = image.origin, image.pixel_size
    units = ("pixel", image.unit, image.unit) if image.unit != "unknown" else None
    place = {"scale": (movie.time.step, size, size), "translate": (movie.time.start, -v, u), "units": units}
    keywords = {**one.display, **look, "name": f"{one.name} flattened", "axis_labels": ("time", "−v", "u"), **place}
    if one.kind == "labels":
        return np.nan_to_num(data).astype(np.int64), keywords, "labels"
    keywords.setdefault("contrast_limits", limits(data))
    return data.astype(np.float32), keywords, "image"
