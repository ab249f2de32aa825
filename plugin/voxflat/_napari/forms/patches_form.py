"""The form of *Flatten in patches*: the surface to flatten, and the options."""

from typing import Any

from napari import Viewer
from qtpy.QtWidgets import QDoubleSpinBox, QSpinBox

from voxflat._napari.forms.fields import choice, show_row, spin
from voxflat._napari.forms.layer_form import LayerForm
from voxflat._napari.job import PatchesJob

_LIMITS = {"max_angle": "by angle", "bound": "by length change", "count": "by number"}


class PatchesForm(LayerForm):
    """Lets the user choose a surface to flatten in patches and the options; `job` returns these choices."""

    _settings = (*LayerForm._settings, "pixel_size", "limit", "max_angle", "bound", "count", "glue")

    def __init__(self, viewer: Viewer) -> None:
        super().__init__(viewer)
        self.limit = choice(_LIMITS, "How the size of the patches is limited")
        tip = "Largest angle between a triangle and its patch: C ≤ 1 + tan(angle)"
        self.max_angle = spin(QDoubleSpinBox(), 0.01, 80, tip, "°")
        self.max_angle.setValue(10.0)
        tip = "C: the largest factor by which lengths may change"
        self.bound = spin(QDoubleSpinBox(), 1.0001, 5.7, tip, step=0.01)
        self.bound.setDecimals(4)
        self.bound.setValue(1.1763)
        tip = "Largest number of patches. The angle is minimised for this number"
        self.count = spin(QSpinBox(), 1, 1_000_000, tip)
        self.count.setValue(500)
        tip = "Close seams between patches as long as no length changes by more than this factor"
        self.glue = spin(QDoubleSpinBox(), 1.0, 10.0, tip, step=0.1, special="not glued")
        self._values: dict[str, Any] = {"max_angle": self.max_angle, "bound": self.bound, "count": self.count}
        limits = (("Limit patches", self.limit), ("Angle", self.max_angle), ("Bound C", self.bound))
        making = (*limits, ("Number", self.count), ("Glue within C", self.glue))
        display = (("Show on page", self.sampled), ("at depth", self.sample_depth), ("Pixel size", self.pixel_size))
        self._add_rows(("World axes", self.world), *making, *display)
        self.limit.currentIndexChanged.connect(self._on_limit)
        self._on_surface()
        self._on_limit()
        self._on_sampled()

    def _on_limit(self) -> None:
        for name, field in self._values.items():
            show_row(self._rows, field, name == self.limit.currentData())

    def job(self) -> PatchesJob:
        """Return the job that the form describes; raises InputError if a choice is missing or unsuitable."""
        surface, foreground = self.source()
        name, pixel_size = self.limit.currentData(), self.pixel_size.value() or None
        glue = self.glue.value() if self.glue.value() > self.glue.minimum() else None
        shown = self._shown(self._chosen(), self.world.currentData())
        limit = {name: self._values[name].value()}
        self._waiting = None  # the user has chosen other settings
        settings: dict[str, Any] = {"glue": glue, "pixel_size": pixel_size, "form": self.record()}
        return PatchesJob(surface, limit, shown=shown, **settings, **foreground)
