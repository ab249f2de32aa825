"""The form *Advanced*: the options of the methods, with the same names and defaults as in Python."""

from typing import Any

import numpy as np
from qtpy.QtCore import Signal  # type: ignore[attr-defined]  # qtpy makes it of pyqtSignal
from qtpy.QtWidgets import QCheckBox, QComboBox, QDoubleSpinBox, QFormLayout, QSpinBox, QWidget

from voxflat._napari.forms.fields import choice, offer, show_row, spin
from voxflat._napari.viewer_state import DrawnCuts
from voxflat.methods import METHODS
from voxflat.methods.method import OverTriangles

_CHOICES: dict[str, tuple[str, dict[Any, str], str]] = {
    "cuts": (
        "Cuts",
        {
            None: "default",
            "standard": "standard",
            "automatic": "automatic",
        },
        "Standard cuts are the same for every brain; automatic cuts minimise the distortion of this surface. The "
        "default is standard cuts if the sphere of the surface is known, otherwise automatic cuts",
    ),
    "relax": (
        "Relaxation cuts",
        {None: "default", True: "enabled", False: "disabled"},
        "Cuts from the border inwards, added where they reduce the distortion most",
    ),
    "geodesic": (
        "Distances",
        {
            None: "default",
            "graph": "graph of links",
            "marching": "fast marching",
            "exact": "exact",
        },
        "How the distances that the map preserves are computed",
    ),
    "scale": (
        "Scale",
        {None: "fit distances", "areas": "fit areas"},
        "Whether the scale of the map fits the distances or the total area of the surface",
    ),
    "sampling": (
        "Sampling",
        {None: "default", "farthest": "even", "curvature": "denser at folds", "random": "random"},
        "How the sources, from which distances are computed, are distributed",
    ),
    "link_lengths": (
        "Links",
        {None: "chain code", "euclidean": "1, √2, √3 voxels"},
        "Lengths assigned to the links between neighbouring voxels",
    ),
}


_DRAWN = "drawn"


def takes(method: str, option: str) -> bool:
    """Return whether a method accepts an option; triangle methods accept cuts and a mirror."""
    kind = METHODS[method]
    return option in kind.__dataclass_fields__ or (
        issubclass(kind, OverTriangles) and option in ("cuts", "relax", "mirror", "drop")
    )


def usual(option: str, method: str) -> Any:
    """Return the default of an option."""
    return getattr(METHODS[method](), option, None)


class OptionsForm(QWidget):
    """Lets the user set the options of a method; `options` returns those that differ from the defaults."""

    changed = Signal()
    """Emitted when other cuts are chosen."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.rows = QFormLayout(self)
        self.rows.setContentsMargins(0, 0, 0, 0)
        self.rows.setFieldGrowthPolicy(QFormLayout.FieldGrowthPolicy.AllNonFixedFieldsGrow)
        self.fields: dict[str, QWidget] = {}
        for name in ("cuts", "relax"):
            self._add_choice(name)
        self._drawn: DrawnCuts | None = None
        self._cuts = self._chosen("cuts")
        self._cuts.currentIndexChanged.connect(self.changed)
        self.mirror = QCheckBox("flip left and right")
        self.mirror.setToolTip("Makes maps of right hemispheres look like maps of left hemispheres")
        self._add("mirror", "Mirror", self.mirror)
        self.sources = spin(QSpinBox(), 0, 100_000, "Number of points from which distances are computed")
        self.sources.setSpecialValueText("default")
        self._add("sources", "Sources", self.sources)
        for name in ("sampling", "geodesic"):
            self._add_choice(name)
        self.weighting = spin(
            QDoubleSpinBox(), 0, 1, "0 preserves short distances and shapes of triangles; 1 preserves long distances"
        )
        self.weighting.setSingleStep(0.1)
        self.weighting.setValue(usual("weighting", "voxflat"))
        self._add("weighting", "Local to global", self.weighting)
        for name in ("scale", "link_lengths"):
            self._add_choice(name)
        self.neighbourhood = spin(QSpinBox(), 0, 1000, "Preserve distances between points up to this many edges apart")
        self.neighbourhood.setSpecialValueText("default")
        self._add("neighbourhood", "Neighbourhood", self.neighbourhood)
        self.starts = spin(QSpinBox(), 1, 100, "Number of random starts; the best map is kept")
        self.starts.setValue(usual("starts", "schwartz1989"))
        self._add("starts", "Starts", self.starts)
        self.bound = spin(QDoubleSpinBox(), 1.01, 10, "The largest factor by which lengths may change")
        self.bound.setSingleStep(0.1)
        self.bound.setValue(usual("bound", "saucan2006"))
        self._add("bound", "Bound C", self.bound)
        self.seed = spin(QSpinBox(), 0, 2**31 - 1, "Seed of random numbers. The same seed gives the same map")
        self.rows.addRow("Random seed", self.seed)

    @property
    def cuts(self) -> str | None:
        """The chosen cuts; None for the default."""
        cuts: str | None = self._cuts.currentData()
        return cuts

    def offer_drawn(self, drawn: DrawnCuts | None, chosen: bool = False) -> None:
        """Offer the drawn cuts, if there are any, and select them if `chosen`."""
        self._drawn = drawn
        offer(self._cuts, {_DRAWN: ""}, _DRAWN, drawn is not None)
        if drawn is not None:
            index = self._cuts.findData(_DRAWN)
            self._cuts.setItemText(index, f"drawn ({len(drawn.paths)})")
            if chosen:
                self._cuts.setCurrentIndex(index)

    def set_method(self, method: str) -> None:
        """Show the options of a method."""
        for name, field in self.fields.items():
            show_row(self.rows, field, takes(method, name))

    def options(self, method: str) -> dict[str, Any]:
        """Return the options of the method and of `Surface.flatten` that differ from the defaults."""
        values: dict[str, Any] = {
            name: field.currentData() for name, field in self.fields.items() if isinstance(field, QComboBox)
        }
        values |= {
            "mirror": self.mirror.isChecked() or None,
            "sources": self.sources.value() or None,
            "weighting": self.weighting.value(),
            "neighbourhood": self.neighbourhood.value() or None,
            "starts": self.starts.value(),
            "bound": self.bound.value(),
        }
        of_method = {name: value for name, value in values.items() if takes(method, name) and value is not None}
        if of_method.get("cuts") == _DRAWN and self._drawn is not None:
            of_method["cuts"] = self._drawn.paths
            if len(self._drawn.left_out):
                of_method["drop"] = self._drawn.left_out
        changed = {name: value for name, value in of_method.items() if not _is_same(value, usual(name, method))}
        return changed | ({"seed": self.seed.value()} if self.seed.value() else {})

    def _chosen(self, name: str) -> QComboBox:
        field = self.fields[name]
        assert isinstance(field, QComboBox)
        return field

    def _add_choice(self, name: str) -> None:
        text, entries, tip = _CHOICES[name]
        self._add(name, text, choice(entries, tip))

    def _add(self, name: str, text: str, field: QWidget) -> None:
        self.fields[name] = field
        self.rows.addRow(text, field)


def _is_same(value: Any, usual: Any) -> bool:
    return not isinstance(value, list | np.ndarray) and bool(value == usual)
