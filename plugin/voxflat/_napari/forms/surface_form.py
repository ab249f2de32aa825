"""What to flatten and how: the fields of *Flatten surface*."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from napari.layers import Labels, Surface
from numpy.typing import NDArray
from qtpy.QtWidgets import QDoubleSpinBox, QSpinBox, QWidget

from voxflat._napari.forms.layer_form import LayerForm, choice, spin
from voxflat._napari.forms.seed_choice import SeedChoice
from voxflat._napari.job import Job
from voxflat._napari.layers.meshes import LayerMesh, vary
from voxflat._napari.layers.sampled import overlay
from voxflat._napari.layers.volumes import LayerVolume
from voxflat.errors import InputError
from voxflat.methods.options import METHODS

if TYPE_CHECKING:
    from napari import Viewer
    from napari.layers import Layer

_RADIUS = 45.0  # mm, as the demo's
_METHODS = {name: f"{name}: {what}" for name, what in METHODS.items() if name != "saucan2006"}  # which has its own form
_PATCHES = {
    "disk": "disk around a seed point",
    "whole": "whole surface",
    "values": "where its values are not 0",
}


class SurfaceForm(LayerForm):
    """Asks what to flatten and how; `job` says it.

    Parameters
    ----------
    viewer : Viewer
        The viewer.
    parent : QWidget, optional
        The widget's parent.
    """

    def __init__(self, viewer: Viewer, parent: QWidget | None = None) -> None:
        super().__init__(viewer, parent)
        self._make_fields(viewer)
        self._add_rows(
            (
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
            )
        )
        self.patch.currentIndexChanged.connect(self._on_patch)
        self._on_surface()
        self._on_patch()
        self._on_sampled()

    def _make_fields(self, viewer: Viewer) -> None:
        self.method = choice(
            _METHODS,
            "By default over triangles, which keep apart what only touches; the others are the papers' methods",
        )
        self.patch = choice(
            _PATCHES, "A closed surface, such as a brain's whole, is cut open; a smaller patch is distorted less"
        )
        self.seed = SeedChoice(viewer, self._inside)
        self.radius = spin(QDoubleSpinBox(), 1, 1000, "Radius of the disk, along the surface", " mm")
        self.radius.setDecimals(1)
        self.radius.setValue(_RADIUS)
        self.sources = spin(QSpinBox(), 0, 100_000, "How many points distances are measured from")
        self.sources.setSpecialValueText("automatic")

    # ---------------------------------------------------------------------------------------- choosing

    def _on_surface(self) -> None:
        super()._on_surface()
        layer = self.surface.layer
        self._show_row(self.method, not isinstance(layer, Surface))
        self._offer_values(isinstance(layer, Surface))
        self.seed.set_surface(layer)

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

    def _inside(self, values: NDArray[Any]) -> NDArray[Any]:
        """Say which values are foreground."""
        labels = isinstance(self.surface.layer, Labels)
        return np.asarray(values == self.label.label if labels else values > self.threshold.value())

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
        layer, world = self._chosen(), self.world.currentData()
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
        return LayerVolume.of(layer, world), {"method": self.method.currentData(), **self._foreground(layer)}

    def _of_mesh(self, layer: Surface, world: str) -> tuple[LayerMesh, dict[str, Any]]:
        """Return a mesh, and what of the job only meshes have."""
        mesh = LayerMesh.of(layer, world)
        by_values = self.patch.currentData() == "values"
        return mesh, {
            "keep": mesh.kept() if by_values else None,
            "values": overlay(layer, mesh) if vary(mesh.values) else None,
        }

    def release(self) -> None:
        """Stop following the viewer."""
        super().release()
        self.seed.release()
