"""The values that a map can show: only its folds, a distortion measure, or a layer of the viewer."""

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from napari import Viewer
from napari.layers import Image, Labels, Layer, Surface
from numpy.typing import NDArray
from qtpy.QtCore import Signal  # type: ignore[attr-defined]  # qtpy makes it of pyqtSignal
from qtpy.QtWidgets import QComboBox, QSizePolicy
from superqt.utils import signals_blocked

from voxflat._napari.layers.sampled import Shown
from voxflat._napari.map_viewer.measures import Measure, growth, measures
from voxflat._napari.map_viewer.pictures import ColourScale, Picture
from voxflat._napari.map_viewer.prepared_map import PreparedMap
from voxflat._napari.map_viewer.viewer_parts import list_events
from voxflat._napari.results.flat_layers import Run, limits

Content: TypeAlias = "Measure | Layer | None"  # the displayed values; None for the folds only

FOLDS = "Folds only"


def suits(layer: Layer, run: Run) -> bool:
    """Return whether a layer can be shown on the map of a run; a volume far from the surface gives an empty picture."""
    if "voxflat" in layer.metadata:
        return False
    if isinstance(layer, Image | Labels):
        return bool(layer.ndim >= 3)
    return isinstance(layer, Surface) and len(layer.vertices) == run.flat_map.origin.size


def drawing(shown: Shown) -> Callable[[PreparedMap], Picture]:
    """Return a function that draws the values of a layer on a map, in any thread."""

    def draw(prepared: PreparedMap) -> Picture:
        image = shown.image(prepared.planar, prepared.pixel_size)
        if image.is_colour:
            return Picture(image.data.astype(np.uint8), image.origin, image.pixel_size)
        data, display = image.data.astype(np.float32), shown.display
        if shown.kind == "labels":
            return Picture(_label_colours(data, display["colormap"]), image.origin, image.pixel_size, data)
        level = np.linspace(0, 1, 256) ** display.get("gamma", 1.0)
        colours = _bytes(display["colormap"].map(level)) if "colormap" in display else _bytes(level[:, None])
        low, high = display.get("contrast_limits") or limits(data)
        return Picture.of(image, ColourScale(shown.name, colours, (float(low), float(high))))

    return draw


def _label_colours(data: NDArray[np.floating], colormap: Any) -> NDArray[np.uint8]:
    """Return the colours of labels in napari; missing values and 0 are transparent."""
    known = np.isfinite(data)
    labels, which = np.unique(np.where(known, data, 0).astype(np.int64), return_inverse=True)
    colours = _bytes(np.atleast_2d(colormap.map(labels)))
    colours[labels == 0, 3] = 0
    return np.asarray(colours[which.reshape(data.shape)])


def _bytes(colours: NDArray[Any]) -> NDArray[np.uint8]:
    """Convert colours between 0 and 1 to RGBA bytes."""
    if colours.shape[1] == 1:
        colours = np.repeat(colours, 3, axis=1)
    if colours.shape[1] == 3:
        colours = np.column_stack([colours, np.ones(len(colours))])
    return np.asarray(np.round(255 * np.clip(colours, 0, 1)), dtype=np.uint8)


class ContentChoice(QComboBox):
    """Lets the user choose the values that the map shows; follows the layers of the viewer."""

    chosen = Signal()  # emitted when something else is chosen

    def __init__(self, viewer: Viewer) -> None:
        super().__init__()
        self._viewer = viewer
        self._run: Run | None = None
        self._offered: list[Content] = []
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self.setMinimumContentsLength(12)
        self._events = list_events(viewer.layers)
        for event in self._events:
            event.connect(self._on_layers)
        self.currentIndexChanged.connect(self.chosen)

    @property
    def content(self) -> Content:
        index = self.currentIndex()
        return self._offered[index] if 0 <= index < len(self._offered) else None

    def step(self, steps: int) -> None:
        """Move the selection down by a number of entries, wrapping from the last entry to the first."""
        if self._offered:
            self.setCurrentIndex((self.currentIndex() + steps) % len(self._offered))

    def show_run(self, run: Run | None) -> None:
        """Offer the values that a run's map can show; select the layer chosen in the form, or the first measure."""
        self._run = run
        own = [] if run is None else measures(run.flat_map)
        if run is not None and run.layers.movie is not None:
            own.append(growth(run.layers.movie))
        self._fill(own)
        wanted: Content = own[0] if own else None
        shown = None if run is None else run.layers.shown
        if shown is not None:
            wanted = next((one for one in self._offered if getattr(one, "name", None) == shown.name), wanted)
        with signals_blocked(self):
            self.setCurrentIndex(self._offered.index(wanted) if self._offered else -1)
        self.chosen.emit()

    def release(self) -> None:
        for event in self._events:
            event.disconnect(self._on_layers)

    def _on_layers(self) -> None:
        if self._run is None:
            return
        before, own = self.content, [one for one in self._offered if isinstance(one, Measure)]
        self._fill(own)
        is_there = before in self._offered
        with signals_blocked(self):
            self.setCurrentIndex(self._offered.index(before if is_there else own[0]))
        if not is_there:
            self.chosen.emit()

    def _fill(self, own: list[Measure]) -> None:
        """Offer first the measures, then the layers, and finally the folds only."""
        run = self._run
        layers = [] if run is None else [layer for layer in reversed(self._viewer.layers) if suits(layer, run)]
        with signals_blocked(self):
            self.clear()
            self._offered = [] if run is None else [*own, *layers, None]
            self.addItems([FOLDS if one is None else one.name for one in self._offered])
