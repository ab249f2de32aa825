"""The form *Advanced*: the options of the methods, with the same names and defaults as in Python."""

from typing import Any

import numpy as np
from qtpy.QtCore import Signal  # type: ignore[attr-defined]  # qtpy makes it of pyqtSignal
from qtpy.QtWidgets import QCheckBox, QComboBox, QDoubleSpinBox, QFormLayout, QSpinBox, QWidget

from voxflat._napari.forms.fields import choice, offer, recorded, restore, show_row, spin
from voxflat._napari.viewer_state import DrawnCuts
from voxflat._napari.wording import CHOICES
from voxflat.methods import METHODS
from voxflat.methods.method import OverTriangles

_DRAWN = "drawn"


def takes(method: str, option: str) -> bool:
    """Return whether a method accepts an option, including the options of `Surface.flatten`."""
    kind = METHODS[method]
    is_common = issubclass(kind, OverTriangles) and option in ("cuts", "relax", "mirror", "drop")
    return is_common or option in kind.__dataclass_fields__


def usual(option: str, method: str) -> Any:
    """Return the default of an option."""
    return getattr(METHODS[method](), option, None)


class OptionsForm(QWidget):
    """Lets the user set the options of a method; `options` returns those that differ from the defaults."""

    changed = Signal()  # emitted when other cuts are chosen

    def __init__(self) -> None:
        super().__init__()
        self.rows = QFormLayout(self)
        self.rows.setContentsMargins(0, 0, 0, 0)
        self.rows.setFieldGrowthPolicy(QFormLayout.FieldGrowthPolicy.AllNonFixedFieldsGrow)
        self.fields: dict[str, QWidget] = {}
        self._cuts = self._add_choice("cuts")
        self._add_choice("relax")
        self._drawn: DrawnCuts | None = None
        self._cuts.currentIndexChanged.connect(self.changed)
        self.mirror = QCheckBox("flip left and right")
        self.mirror.setToolTip("Makes maps of right hemispheres look like maps of left hemispheres")
        self._add("mirror", "Mirror", self.mirror)
        tip = "Number of points from which distances are computed"
        self.sources = spin(QSpinBox(), 0, 100_000, tip, special="default")
        self._add("sources", "Sources", self.sources)
        self._add_choice("sampling")
        self._add_choice("geodesic")
        tip = "0 preserves short distances and the shapes of triangles; 1 preserves long distances"
        self.weighting = spin(QDoubleSpinBox(), 0, 1, tip, step=0.1)
        self.weighting.setValue(usual("weighting", "voxflat"))
        self._add("weighting", "Local to global", self.weighting)
        self._add_choice("scale")
        self._add_choice("link_lengths")
        tip = "Preserve distances between points that are at most this many edges apart"
        self.neighbourhood = spin(QSpinBox(), 0, 1000, tip, special="default")
        self._add("neighbourhood", "Neighbourhood", self.neighbourhood)
        self.starts = spin(QSpinBox(), 1, 100, "Number of random starts. The best map is kept")
        self.starts.setValue(usual("starts", "schwartz1989"))
        self._add("starts", "Starts", self.starts)
        self.bound = spin(QDoubleSpinBox(), 1.01, 10, "The largest factor by which lengths may change", step=0.1)
        self.bound.setValue(usual("bound", "saucan2006"))
        self._add("bound", "Bound C", self.bound)
        self.seed = spin(QSpinBox(), 0, 2**31 - 1, "Seed for random numbers. The same seed gives the same map")
        self.rows.addRow("Random seed", self.seed)

    @property
    def cuts(self) -> str | None:
        """The chosen cuts; None for the default."""
        cuts: str | None = self._cuts.currentData()
        return cuts

    def offer_drawn(self, drawn: DrawnCuts | None, chosen: bool = False) -> None:
        """Offer the drawn cuts, if there are any, and select them if `chosen` is set."""
        self._drawn = drawn
        offer(self._cuts, {_DRAWN: ""}, _DRAWN, drawn is not None)
        if drawn is not None:
            index = self._cuts.findData(_DRAWN)
            self._cuts.setItemText(index, f"drawn ({len(drawn.paths)})")
            if chosen:
                self._cuts.setCurrentIndex(index)

    def record(self) -> dict[str, Any]:
        return {**{name: recorded(field) for name, field in self.fields.items()}, "seed": self.seed.value()}

    def restore(self, record: dict[str, Any]) -> str:
        fields = {**self.fields, "seed": self.seed}
        problems = {name: restore(fields[name], value) for name, value in record.items() if name in fields}
        return ", ".join(f"{name} {problem}" for name, problem in problems.items() if problem)

    def set_method(self, method: str) -> None:
        for name, field in self.fields.items():
            show_row(self.rows, field, takes(method, name))

    def options(self, method: str) -> dict[str, Any]:
        """Return the options of the method and of `Surface.flatten` that differ from the defaults."""
        values: dict[str, Any] = {
            name: field.currentData() for name, field in self.fields.items() if isinstance(field, QComboBox)
        }
        values |= {"mirror": self.mirror.isChecked() or None, "sources": self.sources.value() or None}
        values |= {"weighting": self.weighting.value(), "neighbourhood": self.neighbourhood.value() or None}
        values |= {"starts": self.starts.value(), "bound": self.bound.value()}
        of_method = {name: value for name, value in values.items() if takes(method, name) and value is not None}
        if of_method.get("cuts") == _DRAWN and self._drawn is not None:
            of_method["cuts"] = self._drawn.paths
            if len(self._drawn.left_out):
                of_method["drop"] = self._drawn.left_out
            if self._drawn.sphere is not None:
                of_method["sphere"] = self._drawn.sphere
        changed = {
            name: value
            for name, value in of_method.items()
            if isinstance(value, dict | np.ndarray) or value != usual(name, method)
        }
        return changed | ({"seed": self.seed.value()} if self.seed.value() else {})

    def _add_choice(self, name: str) -> QComboBox:
        text, entries, tip = CHOICES[name]
        box = choice(entries, tip)
        self._add(name, text, box)
        return box

    def _add(self, name: str, text: str, field: QWidget) -> None:
        self.fields[name] = field
        self.rows.addRow(text, field)
