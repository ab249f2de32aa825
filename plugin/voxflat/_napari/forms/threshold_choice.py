"""A threshold, set by a slider while the viewer shows the voxels above it."""

from functools import partial

import numpy as np
from napari import Viewer
from napari.layers import Image
from napari.utils.colormaps import Colormap
from qtpy.QtCore import Qt
from qtpy.QtWidgets import QDoubleSpinBox, QGridLayout, QPushButton, QSlider, QWidget
from superqt.utils import signals_blocked

from voxflat._napari.forms.fields import restore, spin
from voxflat._napari.layers.volumes import finest

_STEPS = 1000  # number of slider steps
_EDGE = 1e-4  # fraction of the range over which the preview goes from transparent to opaque
_COLOURS = Colormap([[0.0, 0.0, 0.0, 0.0], [1.0, 0.45, 0.1, 1.0]], name="above")


class ThresholdChoice(QWidget):
    """Lets the user choose a threshold; a preview uses contrast limits to show the voxels above the threshold."""

    def __init__(self, viewer: Viewer) -> None:
        super().__init__()
        self._viewer = viewer
        self._layer: Image | None = None
        self._shown: Image | None = None
        self._limits = (0.0, 1.0)
        self.box = spin(QDoubleSpinBox(), -1e9, 1e9, "The surface encloses the voxels above this value")
        self.slider = QSlider(Qt.Orientation.Horizontal)
        self.slider.setRange(0, _STEPS)
        self.slider.setToolTip(self.box.toolTip())
        self.preview = QPushButton("Preview")
        self.preview.setCheckable(True)
        self.preview.setToolTip("Show the voxels above the threshold in the viewer")
        layout = QGridLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self.box, 0, 0)
        layout.addWidget(self.preview, 0, 1)
        layout.addWidget(self.slider, 1, 0, 1, 2)
        layout.setColumnStretch(0, 1)
        self.box.valueChanged.connect(self._on_box)
        self.slider.valueChanged.connect(self._on_slider)
        self.slider.sliderPressed.connect(partial(self.preview.setChecked, True))
        self.preview.toggled.connect(self._on_preview)

    def value(self) -> float:
        return float(self.box.value())

    def setValue(self, value: float) -> None:  # noqa: N802 - as in Qt's number boxes
        self.box.setValue(value)

    def record(self) -> float:
        return self.value()

    def restore(self, value: float) -> str:
        return restore(self.box, value)

    def follow(self, layer: Image | None) -> None:
        """Offer thresholds between the contrast limits of a layer; with None, stop following the layer.

        napari shows bytes from 0 to 255. If no value is above the middle, as in masks, use the range of the values.
        """
        if layer is self._layer:
            return
        self.preview.setChecked(False)
        self._layer = layer
        if layer is None:
            return
        low, high = (float(limit) for limit in layer.contrast_limits)
        values = finest(layer)
        if isinstance(values, np.ndarray) and values.dtype == np.uint8 and values.max() <= (low + high) / 2:
            low, high = float(values.min()), float(values.max())
        digits = 3 - np.floor(np.log10(high - low)) if high > low else 3
        self._limits = (low, high if high > low else low + 1)
        self.box.setDecimals(int(np.clip(digits, 0, 12)))
        self.box.setSingleStep((self._limits[1] - low) / 100)
        self.box.setValue((low + high) / 2)

    def _on_box(self, value: float) -> None:
        low, high = self._limits
        with signals_blocked(self.slider):
            self.slider.setValue(round(_STEPS * min(max((value - low) / (high - low), 0), 1)))
        if self._shown is not None:
            self._shown.contrast_limits = self._above()

    def _on_slider(self, step: int) -> None:
        low, high = self._limits
        self.box.setValue(low + (high - low) * step / _STEPS)

    def _on_preview(self, is_shown: bool) -> None:
        if is_shown and self._layer is not None and self._layer in self._viewer.layers:
            layer = self._layer
            before = set(self._viewer.layers.selection)
            placement = ("multiscale", "affine", "scale", "translate", "rotate", "shear", "units")
            keywords = {name: getattr(layer, name) for name in placement}
            keywords |= {"name": f"{layer.name} above the threshold", "contrast_limits": self._above()}
            keywords |= {"metadata": {"voxflat": None}}  # marks a voxflat layer, which is not offered for flattening
            look = {"colormap": _COLOURS, "opacity": 0.6, "blending": "translucent", "interpolation2d": "nearest"}
            self._shown = Image(layer.data, **keywords, **look)
            self._viewer.layers.insert(self._viewer.layers.index(layer) + 1, self._shown)
            self._viewer.layers.selection = before
        elif not is_shown:
            if self._shown is not None and self._shown in self._viewer.layers:
                self._viewer.layers.remove(self._shown)
            self._shown = None

    def _above(self) -> tuple[float, float]:
        low, high = self._limits
        return self.value(), self.value() + _EDGE * (high - low)
