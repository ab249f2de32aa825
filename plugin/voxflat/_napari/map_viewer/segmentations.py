"""Segmentations drawn on the map, which become labels in the volume or a table of cells."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from napari import Viewer
from napari.layers import Labels
from numpy.typing import NDArray
from qtpy.QtCore import Signal  # type: ignore[attr-defined]  # qtpy makes it of pyqtSignal
from qtpy.QtWidgets import QComboBox, QHBoxLayout, QLabel, QPushButton, QSizePolicy, QWidget
from superqt.utils import signals_blocked

from voxflat._napari.docks import arrange
from voxflat._napari.map_viewer.drawings import (
    affine_in_world,
    depths_of_regions,
    drawing_metadata,
    reach,
    units_in_time,
)
from voxflat._napari.map_viewer.movies import MovieWindow, flat_labels, is_kept
from voxflat._napari.map_viewer.prepared_map import PreparedMap
from voxflat._napari.map_viewer.viewer_parts import list_events
from voxflat._napari.results.flat_layers import KEPT, LayerData, Pixels, Run
from voxflat._napari.viewer_state import ViewerState
from voxflat.arguments import Progress
from voxflat.errors import Cancelled, InputError
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.raster import Raster
from voxflat.maps.regions import Regions
from voxflat.wording import many


class Segmentations(QWidget):
    """A row that offers Labels layers over the map, from the viewer (2-D) and from the window of movies."""

    to_volume = Signal()
    to_file = Signal()

    def __init__(self, viewer: Viewer, movies: MovieWindow) -> None:
        super().__init__()
        self._viewer, self._movies = viewer, movies
        self._layers: list[Labels] = []
        self.box = QComboBox()
        self.box.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self.box.setToolTip("A Labels layer over the flattened image, such as cells that you painted or segmented")
        self.send, self.save = QPushButton("To volume"), QPushButton("Save…")
        self.send.setToolTip("Add a Labels layer with the same labels in the volume, at the depths of regions")
        self.save.setToolTip(
            "Save the area, perimeter and elongation of each label as on the surface, or, for the map of a mesh, the "
            "label of each vertex, with names and colours"
        )
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        arrange(row, QLabel("Segmentation"), (self.box, 1), self.send, self.save)
        self.send.clicked.connect(self.to_volume)
        self.save.clicked.connect(self.to_file)
        self._events = list_events(viewer.layers)
        for event in self._events:
            event.connect(self.refresh)
        movies.layers_changed.connect(self.refresh)
        self._run: Run | None = None
        self.refresh()

    @property
    def layer(self) -> Labels | None:
        index = self.box.currentIndex()
        return self._layers[index] if 0 <= index < len(self._layers) else None

    def offer(self, run: Run | None) -> None:
        """Offer the layers that lie on the map of a run."""
        self._run = run
        self.refresh()

    def refresh(self) -> None:
        """Update the offered layers; the newest one is selected if the selected one was removed."""
        before = self.layer
        found = [layer for layer in self._viewer.layers if isinstance(layer, Labels) and layer.ndim == 2]
        found = [layer for layer in found if "voxflat" not in layer.metadata]
        state = ViewerState.of(self._viewer)
        found = [layer for layer in found if self._run is not None and state.run_under(layer) is self._run]
        movie = None if self._run is None else self._run.layers.movie
        if movie is not None:
            found += [layer for layer in self._viewer.layers if is_kept(layer) and layer.metadata[KEPT]() is movie]
        self._layers = [*found, *(layer for layer in self._movies.layers if isinstance(layer, Labels))]
        with signals_blocked(self.box):
            self.box.clear()
            self.box.addItems([layer.name for layer in self._layers])
            chosen = self._layers.index(before) if before in self._layers else len(self._layers) - 1
            self.box.setCurrentIndex(chosen)
        self.setVisible(self._run is not None and bool(self._layers))

    def release(self) -> None:
        for event in self._events:
            event.disconnect(self.refresh)


@dataclass(frozen=True, eq=False)
class Segmentation:
    """The labels of a layer, read in the GUI thread."""

    name: str
    data: NDArray[Any]  # (H, W), or (T, H, W) for the frames of a movie
    pixels: Pixels
    names: dict[int, str]
    colours: dict[int, tuple[int, int, int]]

    @classmethod
    def of(cls, layer: Labels) -> "Segmentation":
        """Read a layer; raises InputError unless its pixels are square."""
        pixels = Pixels.of(layer)
        if pixels is None:
            raise InputError(f"The pixels of '{layer.name}' are not those of the map. {REMEDY}")
        data = flat_labels(layer)
        keys = np.unique(data[data != 0])
        colours = np.round(255 * np.array([layer.get_color(key) for key in keys])).astype(int)
        features, names = layer.features, {}
        if {"index", "name"} <= set(features):
            names = {int(key): str(name) for key, name in zip(features["index"], features["name"], strict=True) if name}
        found = {int(key): (int(r), int(g), int(b)) for key, (r, g, b, _) in zip(keys, colours, strict=True)}
        return cls(layer.name, data, pixels, names, found)

    def at(self, frame: int | None) -> NDArray[Any]:
        """Return the labels of a frame; labels without frames are the same in all frames."""
        return self.data if self.data.ndim == 2 or frame is None else self.data[frame]

    def check(self, flat_map: FlatMap) -> Raster:
        """Return the pixels of a map; raises InputError unless the labels lie on them."""
        raster = flat_map.raster(self.pixels.size)
        if not Pixels.of_raster(raster).is_same(self.pixels):
            raise InputError(f"The pixels of '{self.name}' are not those of the map. {REMEDY}")
        return raster

    def regions(self, flat_map: FlatMap, frame: int | None) -> Regions:
        """Return the regions on the map of a frame; raises InputError unless the labels lie on its pixels."""
        self.check(flat_map)
        found = flat_map.regions(self.at(frame), pixel_size=self.pixels.size)
        names = tuple(self.names.get(key, name) for key, name in zip(found.keys, found.names, strict=True))
        return replace(found, names=names, colours=np.array([self.colours[key] for key in found.keys], dtype=np.uint8))


_MOST = 3  # labels that are named
REMEDY = "Set the scale, translation and shape of the layer to those of a flattened image of this map"


def to_volume(prepared: PreparedMap, drawn: Segmentation, depth: float, progress: Progress) -> tuple[LayerData, str]:
    """Return a Labels layer with the labels in the volume, for all frames of a movie; called in a thread.

    Also return the end of a message, with their depths and the labels without voxels.
    """
    flat_map, movie = prepared.run.flat_map, prepared.run.layers.movie
    if not isinstance(flat_map, FlatMap):
        raise InputError("Segmentations need a flat map, not a page of patches. Use Flatten surface instead")
    if not flat_map.is_voxels:
        raise InputError("The map of a mesh has no voxels. Save the table, or flatten a Labels or Image layer")
    if not drawn.data.any():
        raise InputError(f"Layer '{drawn.name}' has no labels. Paint on it, or segment the flattened image")
    if movie is not None and drawn.data.ndim == 3 and len(drawn.data) != len(movie.series):
        count = len(movie.series)
        raise InputError(f"Layer '{drawn.name}' has {len(drawn.data)} frames, but the movie has {count}. {REMEDY}")
    wanted = depths_of_regions(flat_map, depth, movie=movie is not None)
    frames = [None] if movie is None else list(range(len(movie.series)))
    inside = drawn.check(flat_map).inside
    volumes, lost = [], []
    for number, frame in enumerate(frames):
        if progress("transferring labels", number, len(frames)) is False:
            raise Cancelled("cancelled while transferring labels")
        of = flat_map if movie is None or frame is None else movie.series[frame]
        labels = drawn.at(frame)
        if (inside & (labels != 0)).any():
            regions = drawn.regions(of, frame)
            volumes.append(regions._voxels(regions._grid(), wanted).data)
        else:
            volumes.append(np.zeros(flat_map.volume_shape, dtype=np.int32))
        where = "" if frame is None else f" in frame {frame}"
        lost += [f"{key}{where}" for key in np.setdiff1d(labels, [0, *np.unique(volumes[-1])]).tolist()]
    data, affine = np.stack(volumes), affine_in_world(prepared)
    if not data.any():
        raise InputError(f"No label of '{drawn.name}' contains the centre of a voxel. Draw larger labels on the map")
    data = data[0]
    if movie is not None:
        affine = movie.time.placed(affine)
        data = np.stack(volumes).reshape(len(volumes), *[1] * (len(affine) - 5), *data.shape)
    about = {"name": f"{drawn.name} in the volume", "opacity": 0.6, "metadata": drawing_metadata(prepared)}
    told = f" {reach(flat_map, wanted)}"
    told += f". Left out, because they contain no voxel centre of the map: label {_listed(lost)}" if lost else ""
    return (data, {**about, "affine": affine, "units": units_in_time(prepared)}, "labels"), told


def _listed(lost: list[str]) -> str:
    """List the first entries, and count the others."""
    return ", ".join(lost[:_MOST]) + (f" and {len(lost) - _MOST} more" if len(lost) > _MOST else "")


def save_labels(prepared: PreparedMap, drawn: Segmentation, frame: int | None, path: Path, progress: Progress) -> str:
    """Save the properties of the labels in one frame, or their vertices; return a message. Called in a thread."""
    flat_map = prepared.planar
    if not isinstance(flat_map, FlatMap):
        raise InputError("Segmentations need a flat map, not a page of patches. Use Flatten surface instead")
    progress("measuring labels", 0, 1)
    regions = drawn.regions(flat_map, frame)
    regions.save(path, overwrite=True)  # the dialog has asked
    return f"Saved {many(len(regions), 'label')}" + ("" if frame is None else f" of frame {frame}") + f" in {path.name}"
