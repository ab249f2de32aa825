"""The window of *Movie*: a layer with the values of all frames on the map, linked to the time slider of the viewer."""

import weakref
from typing import Any

import numpy as np
from napari import Viewer
from napari.layers import Image, Labels, Layer
from napari.utils.notifications import show_info
from numpy.typing import NDArray
from qtpy.QtCore import QObject, Signal  # type: ignore[attr-defined]  # qtpy makes it of pyqtSignal
from qtpy.QtWidgets import QWidget

from voxflat._napari.layers.sampled import Shown, shown
from voxflat._napari.layers.volumes import OutsideError, check_time, finest, shown_step
from voxflat._napari.map_viewer.flat_window import FlatWindow
from voxflat._napari.map_viewer.viewer_parts import list_events, world_units
from voxflat._napari.results.flat_layers import KEPT, MOVIE, LayerData, MovieMaps, flattened_name, limits
from voxflat._napari.results.layer_list import insert
from voxflat.arguments import Progress
from voxflat.errors import Cancelled, InputError
from voxflat.io.channels import Channels
from voxflat.maps.raster import FlatImage, FlatStack


def is_kept(layer: Layer) -> bool:
    """Return whether a layer of the viewer has labels that were drawn in the window."""
    return isinstance(layer, Labels) and KEPT in layer.metadata


def flat_labels(layer: Labels) -> NDArray[Any]:
    """Return a copy of labels over the map, of shape (H, W) or (T, H, W)."""
    data = np.array(finest(layer))
    return data.reshape(len(data), *data.shape[-2:]) if is_kept(layer) else data


def _in_space(layer: Labels, movie: MovieMaps, viewer: Viewer) -> Labels:
    """Return labels over the map as a layer of the viewer, in its first slice, because it aligns the last axes."""
    ends = [np.asarray(layer.data_to_world(end)) for end in np.vstack([np.zeros(layer.ndim), np.eye(layer.ndim)])]
    size, corner = np.diagonal(np.stack(ends[1:]) - ends[0]), ends[0]
    look = {"name": layer.name, "colormap": layer.colormap, "visible": False}
    if layer.ndim == 2:
        return Labels(finest(layer), scale=size, translate=corner, units=layer.units, **look)
    placed = movie.time.placed(np.eye(4))
    scale, translate = placed.diagonal()[:-1].copy(), placed[:-1, -1].copy()
    ratio = world_units(viewer, str(layer.units[-1]))[0]  # pixels stay pixels
    slices = viewer.dims.range[-3] if viewer.dims.ndim > 2 else (0.0, 0.0, 1.0)  # the steps of the slider stay as well
    translate[-3], _, scale[-3] = (ratio * place for place in slices)
    scale[[0, -2, -1]], translate[[0, -2, -1]] = size, corner
    units = (layer.units[0], *movie.time.units[1:], layer.units[-1], *layer.units[-2:])
    data = np.asarray(finest(layer)).reshape(len(finest(layer)), *[1] * (len(scale) - 3), *layer.data.shape[-2:])
    about = {"voxflat": None, KEPT: weakref.ref(movie)}
    return Labels(data, scale=scale, translate=translate, units=units, metadata=about, **look)


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
        if self._movie is not None and self._movie is not movie and self.window.viewer is not None:
            self.window.viewer.layers.clear()
            self._movie.windows.clear()
        self._movie = movie
        movie.windows.add(self.window)
        self.window.show(data)
        flat = self.window.viewer
        assert flat is not None
        if self._linked is not flat:
            self._linked = flat
            flat.dims.events.current_step.connect(self._on_own_step)
            flat.mouse_move_callbacks.append(self._on_move)
            for event in list_events(flat.layers):
                event.connect(self._on_layers)
            self.layers_changed.emit()
            self._take_back(movie)
        self.go_to(movie.time.frame(self._viewer, len(movie.series)))

    def go_to(self, frame: int) -> None:
        """Show a frame."""
        flat = self.window.viewer
        if flat is not None and self._movie is not None and flat.dims.ndim > 2:
            flat.dims.set_current_step(0, frame)

    def close(self) -> None:
        """Close the window; labels that the user has drawn in it become hidden layers of the viewer.

        Points and shapes come back when the window of this movie is opened again.
        """
        if self._movie is not None:
            drawn = self.window.drawn
            self.window.keep([layer for layer in drawn if not isinstance(layer, Labels)], self._movie.drawn)
            kept = [_in_space(layer, self._movie, self._viewer) for layer in drawn if isinstance(layer, Labels)]
            for layer in kept:
                insert(self._viewer, layer)
            if kept:
                names = ", ".join(f"'{layer.name}'" for layer in kept)
                show_info(f"The labels of the window Flat movie are now hidden in the layer list: {names}")
            self._movie.windows.clear()
        self.window.close()
        self._linked = self._movie = None

    def _take_back(self, movie: MovieMaps) -> None:
        """Move labels that were drawn on the maps of a movie from the viewer to the window, and show points again."""
        self.window.take_back(movie.drawn)
        flat = self.window.viewer
        assert flat is not None
        for layer in [layer for layer in self._viewer.layers if is_kept(layer) and layer.metadata[KEPT]() is movie]:
            self._viewer.layers.remove(layer)
            axes = [0, -2, -1]
            place = {name: np.asarray(getattr(layer, name))[axes] for name in ("scale", "translate")}
            units = tuple(layer.units[axis] for axis in axes)
            flat.add_layer(Labels(flat_labels(layer), name=layer.name, colormap=layer.colormap, units=units, **place))

    def _on_own_step(self) -> None:
        flat, movie = self.window.viewer, self._movie
        if flat is None or movie is None or flat.dims.ndim < 3:
            return
        frame = flat.dims.current_step[0]
        if movie.time.frame(self._viewer, len(movie.series)) != frame:
            movie.time.go_to(self._viewer, frame)

    def _on_layers(self) -> None:
        self.layers_changed.emit()

    def _on_move(self, viewer: Viewer, event: Any) -> None:
        self.pointed.emit(float(event.position[-1]), -float(event.position[-2]))


def shown_frames(
    layer: Layer, world: str, movie: MovieMaps, viewer: Viewer, **how: Any
) -> tuple[list[Shown | None], dict[str, Any]]:
    """Read the values of a layer for each frame of a movie, at the displayed channel; None if it has no such frame."""
    if not isinstance(layer, Image | Labels):
        raise InputError("A movie needs an Image or Labels layer. Choose one under Shows, then press Movie")
    if getattr(layer, "rgb", False):
        raise InputError(f"Layer '{layer.name}' contains colours. Choose a layer with one value per voxel")
    check_time(layer, movie.time, len(movie.series))
    found: list[Shown | None] = []
    for frame in range(len(movie.series)):
        try:
            found.append(shown(layer, world, step=shown_step(layer, viewer, (movie.time, frame)), **how))
        except OutsideError:
            found.append(None)
    if all(one is None for one in found):
        raise InputError(f"Layer '{layer.name}' has no values at the times of the map. Check its scale and translation")
    look = {"blending": layer.blending} if isinstance(layer, Image) else {}
    return found, look


def flat_movie(movie: MovieMaps, frames: list[Shown | None], look: dict[str, Any], progress: Progress) -> LayerData:
    """Return a layer (frame, row, column) with the values of all frames, empty where there are none.

    Called in a thread.
    """
    images: list[FlatImage | None] = []
    for number, (flat_map, values) in enumerate(zip(movie.series, frames, strict=True)):
        if progress("sampling the frames", number, len(frames)) is False:
            raise Cancelled("cancelled while sampling the frames")
        images.append(None if values is None else values.image(flat_map, None))
    one = next(one for one in frames if one is not None)
    image = next(image for image in images if image is not None)
    empty = np.full(image.data.shape, np.nan)
    data = np.stack([empty if each is None else each.data for each in images])
    (u, v), size = image.origin, image.pixel_size
    units = (movie.time.units[0], image.unit, image.unit) if image.unit != "unknown" else None
    place = {"scale": (movie.time.step, size, size), "translate": (movie.time.start, -v, u), "units": units}
    name = flattened_name(one, movie.series.flat_map, f"{one.name} ")
    keywords = {**one.display, **look, "name": name, "axis_labels": ("time", "−v", "u"), **place}
    found: NDArray[Any] = np.nan_to_num(data).astype(np.int64) if one.kind == "labels" else data.astype(np.float32)
    channels = Channels(("",), found.__getitem__, movie.time.timing)
    frame = FlatStack(channels, size, image.origin, keywords["name"], image.provenance, unit=image.unit)
    keywords["metadata"] = {"voxflat": movie.series.flat_map, MOVIE: frame}
    if one.kind == "image":
        keywords.setdefault("contrast_limits", limits(data))
    return found, keywords, one.kind
