"""What both forms ask: which surface, where it lies, and what its map shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from napari.layers import Image, Labels, Surface
from qtpy.QtWidgets import QComboBox, QDoubleSpinBox, QFormLayout, QSizePolicy, QWidget

from voxflat._napari.forms.label_choice import LabelChoice
from voxflat._napari.forms.layer_choice import LayerChoice
from voxflat._napari.layers.meshes import vary
from voxflat._napari.layers.sampled import Shown, shown
from voxflat._napari.layers.world import WORLDS, same_kind_of_unit
from voxflat.errors import InputError

if TYPE_CHECKING:
    from napari import Viewer
    from napari.layers import Layer


class LayerForm(QWidget):
    """Asks for a surface and for what its map shows; other forms add how it is flattened.

    Parameters
    ----------
    viewer : Viewer
        The viewer.
    parent : QWidget, optional
        The widget's parent.
    """

    def __init__(self, viewer: Viewer, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.surface = LayerChoice(viewer, _surface_rank)
        self.surface.setPlaceholderText("open a Labels, Image or Surface layer")
        self.surface.setToolTip("A Labels layer, an Image layer and a threshold, or a Surface layer of triangles")
        self.label = LabelChoice()
        self.label.setToolTip("The label whose surface is flattened; by default the layer's selected one")
        self.threshold = spin(QDoubleSpinBox(), -1e9, 1e9, "The surface encloses what is greater than this")
        self.world = choice(WORLDS, "Where the viewer's axes grow to. With a wrong choice the map is mirrored!")
        self.sampled = LayerChoice(viewer, self._sampled_rank, none="nothing")
        self.sampled.setToolTip("What the map shows: the values at the surface of a layer, such as T1 or an atlas")
        self.sample_depth = spin(
            QDoubleSpinBox(), -100, 100, "How far outside the surface to look; negative is inside", " mm"
        )
        self.sample_depth.setSingleStep(0.5)
        self.pixel_size = spin(QDoubleSpinBox(), 0, 100, "Side of the map's pixels", " mm")
        self.pixel_size.setSingleStep(0.1)
        self.pixel_size.setSpecialValueText("automatic (half a voxel or edge)")
        self._rows = QFormLayout(self)
        self._rows.setContentsMargins(0, 0, 0, 0)
        self._rows.setFieldGrowthPolicy(QFormLayout.FieldGrowthPolicy.AllNonFixedFieldsGrow)

    def _add_rows(self, rows: Sequence[tuple[str, QWidget]]) -> None:
        """Lay the fields out, and follow them."""
        for text, field in rows:
            self._rows.addRow(text, field)
        self.surface.chosen.connect(self._on_surface)
        self.sampled.chosen.connect(self._on_sampled)

    # ---------------------------------------------------------------------------------------- choosing

    def _on_surface(self) -> None:
        layer = self.surface.layer
        self.label.follow(layer if isinstance(layer, Labels) else None)
        self._show_row(self.label, isinstance(layer, Labels))
        self._show_row(self.threshold, isinstance(layer, Image))
        if isinstance(layer, Image):
            self._offer_threshold(*layer.contrast_limits)
        self.sampled.reconsider()

    def _offer_threshold(self, low: float, high: float) -> None:
        digits = 3 - np.floor(np.log10(high - low)) if high > low else 3
        self.threshold.setDecimals(int(np.clip(digits, 0, 12)))
        self.threshold.setSingleStep((high - low) / 100)
        self.threshold.setValue((low + high) / 2)

    def _on_sampled(self) -> None:
        self._show_row(self.sample_depth, isinstance(self.sampled.layer, Image | Labels))

    def _show_row(self, field: QWidget, visible: bool) -> None:
        field.setVisible(visible)
        label = self._rows.labelForField(field)
        assert label is not None
        label.setVisible(visible)

    def _sampled_rank(self, layer: Layer) -> int | None:
        """Say how well a layer suits to be shown on the map: best are the values of the mesh that is flattened."""
        if "voxflat" in layer.metadata:
            return None
        if isinstance(layer, Image | Labels):
            return int(isinstance(layer, Image) and layer.ndim == 3)
        mesh = self.surface.layer
        if not (isinstance(layer, Surface) and isinstance(mesh, Surface) and len(layer.vertices) == len(mesh.vertices)):
            return None
        return 2 if layer == mesh and vary(np.asarray(layer.vertex_values)) else 0

    # ------------------------------------------------------------------------------------------ asking

    def _chosen(self) -> Layer:
        """Return the surface's layer."""
        if self.surface.layer is None:
            raise InputError("nothing to flatten: open a Labels, Image or Surface layer")
        return self.surface.layer

    def _foreground(self, layer: Layer) -> dict[str, Any]:
        """Return what of a volume is foreground."""
        labels = isinstance(layer, Labels)
        return {
            "label": self.label.label if labels else None,
            "threshold": None if labels else self.threshold.value(),
        }

    def _shown(self, layer: Layer, world: str) -> Shown | None:
        """Return what the map of a layer shall show."""
        sampled = self.sampled.layer
        if sampled is None:
            return None
        if not isinstance(sampled, Surface) and sampled.ndim == 3 and not same_kind_of_unit(layer, sampled):
            raise InputError(
                f"layers '{layer.name}' and '{sampled.name}' have units that cannot be compared "
                f"({layer.units[0]}, {sampled.units[0]}): set the units of both"
            )
        return shown(sampled, world, self.sample_depth.value())

    def release(self) -> None:
        """Stop following the viewer."""
        self.label.follow(None)
        for part in (self.surface, self.sampled):
            part.release()


def spin(box: Any, least: float, most: float, tip: str, suffix: str = "") -> Any:
    """Set a box for numbers up."""
    box.setRange(least, most)
    box.setToolTip(tip)
    box.setSuffix(suffix)
    box.setKeyboardTracking(False)
    return box


def choice(texts: Mapping[str, str], tip: str) -> QComboBox:
    """Make a box to choose from texts, by their keys."""
    box = QComboBox()
    for key, text in texts.items():
        box.addItem(text, key)
    box.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)  # long texts do not widen the window
    box.setToolTip(tip)
    return box


def _surface_rank(layer: Layer) -> int | None:
    """Say how well a layer suits to be flattened."""
    if "voxflat" in layer.metadata or not isinstance(layer, Image | Labels | Surface) or getattr(layer, "rgb", False):
        return None
    return (2 - isinstance(layer, Image)) if layer.ndim == 3 else 0
