"""What to flatten and how: the fields of *Flatten surface*."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from napari.layers import Image, Labels, Surface
from numpy.typing import NDArray
from qtpy.QtWidgets import QComboBox, QDoubleSpinBox, QFormLayout, QSizePolicy, QSpinBox, QWidget

from voxflat._errors import InputError
from voxflat._napari.job import Job
from voxflat._napari.label_choice import LabelChoice
from voxflat._napari.layer_choice import LayerChoice
from voxflat._napari.meshes import LayerMesh, vary
from voxflat._napari.sampled import Shown, overlay, shown
from voxflat._napari.seed_choice import SeedChoice
from voxflat._napari.volumes import LayerVolume
from voxflat._napari.world import WORLDS, same_kind_of_unit

if TYPE_CHECKING:
    from napari import Viewer
    from napari.layers import Layer

_RADIUS = 45.0  # mm, as the demo's
_METHODS = {
    "voxflat": "voxflat: over triangles",
    "grossmann2002": "Grossmann et al. 2002: over voxels",
    "zigelman2002": "Zigelman et al. 2002: fast marching",
    "schwartz1989": "Schwartz et al. 1989: random starts",
}
_PATCHES = {
    "disk": "disk around a seed point",
    "whole": "whole surface",
    "values": "where its values are not 0",
}


class SurfaceForm(QWidget):
    """Asks what to flatten and how; `job` says it.

    Parameters
    ----------
    viewer : Viewer
        The viewer.
    parent : QWidget, optional
        The widget's parent.
    """

    def __init__(self, viewer: Viewer, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._make_surface_fields(viewer)
        self._make_map_fields(viewer)
        self._lay_out()
        self.surface.chosen.connect(self._on_surface)
        self.sampled.chosen.connect(self._on_sampled)
        self.patch.currentIndexChanged.connect(self._on_patch)
        self._on_surface()
        self._on_patch()
        self._on_sampled()

    def _make_surface_fields(self, viewer: Viewer) -> None:
        self.surface = LayerChoice(viewer, _surface_rank)
        self.surface.setPlaceholderText("open a Labels, Image or Surface layer")
        self.surface.setToolTip("A Labels layer, an Image layer and a threshold, or a Surface layer of triangles")
        self.label = LabelChoice()
        self.label.setToolTip("The label whose surface is flattened; by default the layer's selected one")
        self.threshold = _spin(QDoubleSpinBox(), -1e9, 1e9, "The surface encloses what is greater than this")
        self.world = _choice(WORLDS, "Where the viewer's axes grow to. With a wrong choice the map is mirrored!")
        self.method = _choice(
            _METHODS,
            "By default over triangles, which keep apart what only touches; the others are the papers' methods",
        )
        self.patch = _choice(
            _PATCHES, "A closed surface, such as a brain's whole, is cut open; a smaller patch is distorted less"
        )
        self.seed = SeedChoice(viewer, self._inside)
        self.radius = _spin(QDoubleSpinBox(), 1, 1000, "Radius of the disk, along the surface", " mm")
        self.radius.setDecimals(1)
        self.radius.setValue(_RADIUS)

    def _make_map_fields(self, viewer: Viewer) -> None:
        self.sampled = LayerChoice(viewer, self._sampled_rank, none="nothing")
        self.sampled.setToolTip("What the map shows: the values at the surface of a layer, such as T1 or an atlas")
        self.sample_depth = _spin(
            QDoubleSpinBox(), -100, 100, "How far outside the surface to look; negative is inside", " mm"
        )
        self.sample_depth.setSingleStep(0.5)
        self.sources = _spin(QSpinBox(), 0, 100_000, "How many points distances are measured from")
        self.sources.setSpecialValueText("automatic")
        self.pixel_size = _spin(QDoubleSpinBox(), 0, 100, "Side of the map's pixels", " mm")
        self.pixel_size.setSingleStep(0.1)
        self.pixel_size.setSpecialValueText("automatic (half a voxel or edge)")

    def _lay_out(self) -> None:
        self._rows = QFormLayout(self)
        self._rows.setContentsMargins(0, 0, 0, 0)
        self._rows.setFieldGrowthPolicy(QFormLayout.FieldGrowthPolicy.AllNonFixedFieldsGrow)
        for text, field in (
            ("Surface", self.surface),
            ("Label", self.label),
            ("Threshold", self.threshold),
            ("World axes", self.world),
            ("Method", self.method),
            ("Patch", self.patch),
            ("Seed point", self.seed),
            ("Radius", self.radius),
            ("Show on map", self.sampled),
            ("at depth", self.sample_depth),
            ("Sources", self.sources),
            ("Pixel size", self.pixel_size),
        ):
            self._rows.addRow(text, field)

    # ---------------------------------------------------------------------------------------- choosing

    def _on_surface(self) -> None:
        layer = self.surface.layer
        self.label.follow(layer if isinstance(layer, Labels) else None)
        self._show_row(self.label, isinstance(layer, Labels))
        self._show_row(self.threshold, isinstance(layer, Image))
        self._show_row(self.method, not isinstance(layer, Surface))
        self._offer_values(isinstance(layer, Surface))
        if isinstance(layer, Image):
            self._offer_threshold(*layer.contrast_limits)
        self.seed.set_surface(layer)
        self.sampled.reconsider()

    def _offer_threshold(self, low: float, high: float) -> None:
        digits = 3 - np.floor(np.log10(high - low)) if high > low else 3
        self.threshold.setDecimals(int(np.clip(digits, 0, 12)))
        self.threshold.setSingleStep((high - low) / 100)
        self.threshold.setValue((low + high) / 2)

    def _offer_values(self, offered: bool) -> None:
        """Offer the patch where a mesh has values, or not."""
        index = self.patch.findData("values")
        if offered and index < 0:
            self.patch.addItem(_PATCHES["values"], "values")
        elif not offered and index >= 0:
            if self.patch.currentIndex() == index:
                self.patch.setCurrentIndex(0)
            self.patch.removeItem(index)

    def _on_patch(self) -> None:
        for field in (self.seed, self.radius):
            self._show_row(field, self._on_disk)

    @property
    def _on_disk(self) -> bool:
        return bool(self.patch.currentData() == "disk")

    def _on_sampled(self) -> None:
        self._show_row(self.sample_depth, isinstance(self.sampled.layer, Image | Labels))

    def _show_row(self, field: QWidget, visible: bool) -> None:
        field.setVisible(visible)
        label = self._rows.labelForField(field)
        assert label is not None
        label.setVisible(visible)

    def _inside(self, values: NDArray[Any]) -> NDArray[Any]:
        """Say which values are foreground."""
        labels = isinstance(self.surface.layer, Labels)
        return np.asarray(values == self.label.label if labels else values > self.threshold.value())

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

    def job(self) -> Job:
        """Return what the fields ask for.

        Returns
        -------
        Job

        Raises
        ------
        InputError
            If something is still to be chosen, or a layer does not suit.
        """
        layer, world = self.surface.layer, self.world.currentData()
        if layer is None:
            raise InputError("nothing to flatten: open a Labels, Image or Surface layer")
        surface, how = self._of_mesh(layer, world) if isinstance(layer, Surface) else self._of_volume(layer, world)
        seed = self.seed.point if self._on_disk else None
        if self._on_disk and seed is None:
            raise InputError("no seed point: click Pick, then on the surface; or choose another patch")
        return Job(
            surface=surface,
            seed_point=seed,
            radius=self.radius.value() if self._on_disk else None,
            sources=self.sources.value() or None,
            pixel_size=self.pixel_size.value() or None,
            shown=self._shown(layer, world),
            **how,
        )

    def _of_volume(self, layer: Layer, world: str) -> tuple[LayerVolume, dict[str, Any]]:
        """Return a volume, and what of the job only volumes have."""
        labels = isinstance(layer, Labels)
        return LayerVolume.of(layer, world), {
            "method": self.method.currentData(),
            "label": self.label.label if labels else None,
            "threshold": None if labels else self.threshold.value(),
        }

    def _of_mesh(self, layer: Surface, world: str) -> tuple[LayerMesh, dict[str, Any]]:
        """Return a mesh, and what of the job only meshes have."""
        mesh = LayerMesh.of(layer, world)
        by_values = self.patch.currentData() == "values"
        return mesh, {
            "keep": mesh.kept() if by_values else None,
            "values": overlay(layer, mesh) if vary(mesh.values) else None,
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
        for part in (self.surface, self.sampled, self.seed):
            part.release()


def _spin(box: Any, least: float, most: float, tip: str, suffix: str = "") -> Any:
    box.setRange(least, most)
    box.setToolTip(tip)
    box.setSuffix(suffix)
    box.setKeyboardTracking(False)
    return box


def _choice(texts: Mapping[str, str], tip: str) -> QComboBox:
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
