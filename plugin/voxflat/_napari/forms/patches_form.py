"""The form of *Flatten in patches*: the surface to flatten, and the options."""

from typing import Any

from napari import Viewer
from napari.layers import Surface
from qtpy.QtWidgets import QDoubleSpinBox, QSpinBox, QWidget

from voxflat._napari.forms.fields import choice, spin
from voxflat._napari.forms.layer_form import LayerForm
from voxflat._napari.job import PatchesJob
from voxflat._napari.layers.meshes import LayerMesh
from voxflat._napari.layers.volumes import LayerVolume

_LIMITS = {
    "max_angle": "by angle",
    "bound": "by length change",
    "count": "by number",
}


class PatchesForm(LayerForm):
    """Lets the user choose a surface to flatten in patches and the options; `job` returns these choices."""

    def __init__(self, viewer: Viewer, parent: QWidget | None = None) -> None:
        super().__init__(viewer, parent)
        self.limit = choice(_LIMITS, "What limits the size of the patches")
        self.max_angle = spin(
            QDoubleSpinBox(), 0.01, 80, "Largest angle between a triangle and its patch: C ≤ 1 + tan(angle)", "°"
        )
        self.max_angle.setValue(10.0)
        self.bound = spin(QDoubleSpinBox(), 1.0001, 5.7, "C: the largest factor by which lengths may change")
        self.bound.setDecimals(4)
        self.bound.setSingleStep(0.01)
        self.bound.setValue(1.1763)
        self.count = spin(QSpinBox(), 1, 1_000_000, "Largest number of patches. The angle becomes as small as possible")
        self.count.setValue(500)
        self.glue = spin(
            QDoubleSpinBox(),
            1.0,
            10.0,
            "Close seams between patches as long as no length changes by more than this factor",
        )
        self.glue.setSingleStep(0.1)
        self.glue.setSpecialValueText("not glued")
        self._values: dict[str, Any] = {"max_angle": self.max_angle, "bound": self.bound, "count": self.count}
        self._add_rows(
            (
                ("Surface", self.surface),
                ("Label", self.label),
                ("Threshold", self.threshold),
                ("World axes", self.world),
                ("Limit patches", self.limit),
                ("Angle", self.max_angle),
                ("Bound C", self.bound),
                ("Number", self.count),
                ("Glue within C", self.glue),
                ("Show on page", self.sampled),
                ("at depth", self.sample_depth),
                ("Pixel size", self.pixel_size),
            )
        )
        self.limit.currentIndexChanged.connect(self._on_limit)
        self._on_surface()
        self._on_limit()
        self._on_sampled()

    def _on_limit(self) -> None:
        for name, field in self._values.items():
            self._show_row(field, name == self.limit.currentData())

    def job(self) -> PatchesJob:
        """Return the job that the form describes; raises InputError if a choice is missing or unsuitable."""
        layer, world = self._chosen(), self.world.currentData()
        is_mesh = isinstance(layer, Surface)
        name = self.limit.currentData()
        return PatchesJob(
            surface=LayerMesh.of(layer, world) if is_mesh else LayerVolume.of(layer, world),
            limit={name: self._values[name].value()},
            glue=self.glue.value() if self.glue.value() > self.glue.minimum() else None,
            pixel_size=self.pixel_size.value() or None,
            shown=self._shown(layer, world),
            **({} if is_mesh else self._foreground(layer)),
        )
