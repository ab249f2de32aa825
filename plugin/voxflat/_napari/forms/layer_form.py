"""What both forms ask: which surface, where it lies, and what its map shows."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from napari import Viewer
from napari.layers import Image, Labels, Layer, Surface
from qtpy.QtWidgets import QDoubleSpinBox, QFormLayout, QWidget
from superqt import QCollapsible

from voxflat._napari.forms.fields import choice, show_row, spin
from voxflat._napari.forms.label_choice import LabelChoice
from voxflat._napari.forms.layer_choice import LayerChoice
from voxflat._napari.forms.threshold_choice import ThresholdChoice
from voxflat._napari.layers.meshes import LayerMesh, is_elsewhere, surface_name, vary
from voxflat._napari.layers.sampled import Shown, shown, usual_depth
from voxflat._napari.layers.volumes import LayerVolume
from voxflat._napari.layers.world import WORLDS, same_kind_of_unit
from voxflat.errors import InputError


class LayerForm(QWidget):
    """Asks for a surface and for what its map shows; other forms add how it is flattened."""

    def __init__(self, viewer: Viewer, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.surface = LayerChoice(viewer, partial(_surface_rank, viewer), follows_selection=True)
        self.surface.setPlaceholderText("open a Labels, Image or Surface layer")
        self.surface.setToolTip(
            "What is flattened: a Labels layer, an Image layer with a threshold, or a Surface layer"
        )
        self.label = LabelChoice()
        self.label.setToolTip("The label whose surface is flattened; by default the selected label of the layer")
        self.threshold = ThresholdChoice(viewer)
        self.world = choice(WORLDS, "The anatomical directions of the viewer's axes. A wrong choice mirrors the map")
        self.sampled = LayerChoice(viewer, self._sampled_rank, none="nothing")
        self.sampled.setToolTip("A layer, such as T1 or an atlas, whose values at the surface the map shows")
        self.sample_depth = spin(
            QDoubleSpinBox(),
            -100,
            100,
            "Distance from the surface at which the layer is sampled; negative values lie inside",
            " mm",
        )
        self.sample_depth.setSingleStep(0.5)
        self.pixel_size = spin(
            QDoubleSpinBox(),
            0,
            100,
            "Size of the map's pixels; by default half a voxel, or half an edge of the mesh",
            " mm",
        )
        self.pixel_size.setSingleStep(0.1)
        self.pixel_size.setSpecialValueText("automatic")
        self._depth_by_user = False
        self.sample_depth.editingFinished.connect(self._on_depth)
        self._rows = QFormLayout(self)
        self._rows.setContentsMargins(0, 0, 0, 0)
        self._rows.setFieldGrowthPolicy(QFormLayout.FieldGrowthPolicy.AllNonFixedFieldsGrow)
        self.advanced = QCollapsible("Advanced", expandedIcon="▾", collapsedIcon="▸")

    def _add_rows(self, rows: Sequence[tuple[str, QWidget]], advanced: QWidget | None = None) -> None:
        """Lay the fields out, and follow them."""
        for text, field in rows:
            self._rows.addRow(text, field)
        if advanced is not None:
            self.advanced.addWidget(advanced)
            self._rows.addRow(self.advanced)
        self.surface.chosen.connect(self._on_surface)
        self.sampled.chosen.connect(self._on_sampled)

    # ---------------------------------------------------------------------------------------- choosing

    def _on_surface(self) -> None:
        layer = self.surface.layer
        self.label.follow(layer if isinstance(layer, Labels) else None)
        self._show_row(self.label, isinstance(layer, Labels))
        self._show_row(self.threshold, isinstance(layer, Image))
        self.threshold.follow(layer if isinstance(layer, Image) and not layer.rgb else None)
        self.sampled.refresh()
        if not self._depth_by_user:
            self.sample_depth.setValue(usual_depth(layer))

    def _on_depth(self) -> None:
        self._depth_by_user = True

    def _on_sampled(self) -> None:
        self._show_row(self.sample_depth, isinstance(self.sampled.layer, Image | Labels))

    def _show_row(self, field: QWidget, visible: bool) -> None:
        show_row(self._rows, field, visible)

    def _sampled_rank(self, layer: Layer) -> int | None:
        """Say how well a layer suits to be shown on the map: best are the values of the mesh that is flattened."""
        if "voxflat" in layer.metadata:
            return None
        if isinstance(layer, Image | Labels):
            suits = isinstance(layer, Image) and layer.ndim == 3
            return int(suits) + (
                suits and layer != self.surface.layer
            )  # at its own border an image is the same everywhere
        mesh = self.surface.layer
        if not (isinstance(layer, Surface) and isinstance(mesh, Surface) and len(layer.vertices) == len(mesh.vertices)):
            return None
        return (3 if layer == mesh else 1) if vary(np.asarray(layer.vertex_values)) else 0

    # ------------------------------------------------------------------------------------------ asking

    def _chosen(self) -> Layer:
        """Return the surface's layer."""
        if self.surface.layer is None:
            raise InputError("nothing to flatten: open a Labels, Image or Surface layer")
        self.surface.keep()
        return self.surface.layer

    def source(self) -> tuple[LayerVolume | LayerMesh, dict[str, Any]]:
        """Return what is chosen, and what of a volume is foreground; raises InputError if the layer does not suit."""
        layer, world = self._chosen(), self.world.currentData()
        if isinstance(layer, Surface):
            return LayerMesh.of(layer, world), {}
        return LayerVolume.of(layer, world), self._foreground(layer)

    def _foreground(self, layer: Layer) -> dict[str, Any]:
        """Return what of a volume is foreground."""
        labels = isinstance(layer, Labels)
        return {"label": self.label.label if labels else None, "threshold": None if labels else self.threshold.value()}

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
        self.threshold.follow(None)
        for part in (self.surface, self.sampled):
            part.release()


def _surface_rank(viewer: Viewer, layer: Layer) -> int | None:
    """Rank layers to be flattened: labels, then surfaces, then images; not one that belongs to another in the list."""
    if "voxflat" in layer.metadata or not isinstance(layer, Image | Labels | Surface) or getattr(layer, "rgb", False):
        return None
    if layer.ndim != 3:
        return 0
    if any(_is_of(layer, other) for other in viewer.layers):
        return 0
    if isinstance(layer, Surface):
        return 2 if _is_partner(layer) else 3
    return 4 if isinstance(layer, Labels) else 1


def _is_partner(layer: Surface) -> bool:
    """Tell whether a surface is hardly ever flattened itself: a pial, inflated or spherical one."""
    name = surface_name(layer)
    return "pial" in name or is_elsewhere(name)


def _is_of(layer: Layer | None, other: Layer) -> bool:
    """Tell whether a layer is a pial, inflated or spherical surface, and another layer the surface it belongs to."""
    if not isinstance(layer, Surface) or not isinstance(other, Surface) or not _is_partner(layer):
        return False
    is_same_mesh = len(other.vertices) == len(layer.vertices)
    return is_same_mesh and "voxflat" not in other.metadata and not _is_partner(other)
