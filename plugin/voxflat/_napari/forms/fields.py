"""Functions that create and show form fields."""

from collections.abc import Mapping
from typing import Any

from qtpy.QtWidgets import QCheckBox, QComboBox, QFormLayout, QSizePolicy, QWidget

_BESIDE = 32  # pixels that a list needs in addition to its texts


def spin(box: Any, least: float, most: float, tip: str, suffix: str = "", *, step: float = 1, special: str = "") -> Any:
    """Set up a number box; it shows the text `special` instead of the lowest value."""
    box.setRange(least, most)
    box.setToolTip(tip)
    box.setSuffix(suffix)
    box.setSingleStep(step)
    box.setSpecialValueText(special)
    box.setKeyboardTracking(False)
    return box


def choice(texts: Mapping[Any, str], tip: str) -> QComboBox:
    """Return a box with one entry for each key, showing its text."""
    box = QComboBox()
    for key, text in texts.items():
        box.addItem(text, key)
    box.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)  # long texts must not widen the window
    show_all(box)
    box.setToolTip(tip)
    return box


def show_all(box: QComboBox) -> None:
    """Make the list of a box as wide as its texts."""
    listed, metrics = box.view(), box.fontMetrics()
    assert listed is not None
    texts = (box.itemText(index) for index in range(box.count()))
    listed.setMinimumWidth(max(map(metrics.horizontalAdvance, texts), default=0) + _BESIDE)


def offer(box: QComboBox, texts: Mapping[str, str], key: str, offered: bool) -> None:
    """Add an entry at the end of a box, or remove it; if it was selected, select the first entry instead."""
    index = box.findData(key)
    if offered and index < 0:
        box.addItem(texts[key], key)
    elif not offered and index >= 0:
        if box.currentIndex() == index:
            box.setCurrentIndex(0)
        box.removeItem(index)


def recorded(field: Any) -> Any:
    """Return the value of a field for the description of a saved map."""
    if hasattr(field, "record"):
        return field.record()
    if isinstance(field, QComboBox):
        return field.currentData()
    return field.isChecked() if isinstance(field, QCheckBox) else field.value()


def restore(field: Any, value: Any) -> str:
    """Set a field to a recorded value; return a message if this is impossible, and otherwise an empty text."""
    if hasattr(field, "restore"):
        return str(field.restore(value))
    if isinstance(field, QComboBox):
        if field.findData(value) < 0:
            return f"{value!r} is not offered"
        field.setCurrentIndex(field.findData(value))
    elif isinstance(field, QCheckBox):
        field.setChecked(bool(value))
    elif field.minimum() <= value <= field.maximum():
        field.setValue(value)
    else:
        return f"{value} is not between {field.minimum():g} and {field.maximum():g}"
    return ""


def show_row(rows: QFormLayout, field: QWidget, visible: bool) -> None:
    field.setVisible(visible)
    label = rows.labelForField(field)
    assert label is not None
    label.setVisible(visible)
