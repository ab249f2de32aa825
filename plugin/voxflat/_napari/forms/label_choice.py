"""A box for choosing one of the labels in a Labels layer, or a rim."""

import re
from typing import Any

import numpy as np
from napari.layers import Labels
from qtpy.QtCore import Signal  # type: ignore[attr-defined]  # qtpy makes it of pyqtSignal
from qtpy.QtWidgets import QComboBox, QSizePolicy

from voxflat._napari.forms.fields import show_all
from voxflat._napari.layers.foreground import RIMS, rims_in
from voxflat._napari.layers.volumes import finest
from voxflat._napari.timers import single_shot
from voxflat._napari.worker import BackgroundTask
from voxflat.surfaces.foreground import labels_in

_SCANNED = 2**29  # voxels; larger layers, which may be remote, are not read only to list their labels
_RIM = re.compile(r"(?i)(?<![a-z])(rim|ribbon)(?![a-z])")  # in the name of a layer
_PAUSE = 400  # ms without painting before the labels are listed again


class LabelChoice(QComboBox):
    """Lets the user choose a label from a list compiled in a thread; the default is the selected label of the layer.

    If the labels can be those of a rim, the rim is offered, too. It is the default if the name of the layer says so.
    """

    settled = Signal(str)  # emitted when it is known whether the layer has a restored label, with a message if not

    def __init__(self) -> None:
        super().__init__()
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self._layer: Labels | None = None
        self._labels: dict[int, int] | None = None  # number of voxels of each label, once known
        self._restored: int | str | None = None  # chosen before the labels are known
        self._timer = single_shot(self, _PAUSE, self.scan)

    @property
    def label(self) -> int | None:
        label = self.currentData()
        return int(label) if isinstance(label, int) else None

    @property
    def rim(self) -> str | None:
        """The kind of rim, a key of `RIMS`; None if a label is chosen."""
        kind = self.currentData()
        return kind if isinstance(kind, str) else None

    def choose(self, label: int | str) -> None:
        self.setCurrentIndex(self.findData(label))

    def record(self) -> int | str | None:
        return self.currentData()  # type: ignore[no-any-return]  # Qt's type is Any

    def restore(self, label: int | str | None) -> str:
        """Choose a label or a kind of rim; if the labels are not yet known, `settled` follows."""
        if label is None:
            return ""
        if self._layer is None:
            return "the layer is not a Labels layer"
        if self._labels is None:
            self._restored = label
            self._offer(None)
        elif self.findData(label) < 0:
            return self._missing(label)
        else:
            self.choose(label)
        return ""

    def _missing(self, label: int | str) -> str:
        assert self._layer is not None
        return f"'{self._layer.name}' does not contain {f'label {label}' if isinstance(label, int) else 'a rim'}"

    def follow(self, layer: Labels | None) -> None:
        """Offer the labels of a layer, and follow its changes."""
        if self._layer is not None:
            self._layer.events.selected_label.disconnect(self._on_selected)
            for event in (self._layer.events.data, self._layer.events.labels_update):
                event.disconnect(self._rescan)
        self._layer = layer
        self._labels = self._restored = None
        self.clear()
        if layer is None:
            self._timer.stop()
            return
        layer.events.selected_label.connect(self._on_selected)
        for event in (layer.events.data, layer.events.labels_update):
            event.connect(self._rescan)
        self._offer(None)
        self.scan()

    def scan(self) -> None:
        """List the labels, in another thread."""
        if self._layer is None or np.prod((data := finest(self._layer)).shape) > _SCANNED:
            return
        worker = BackgroundTask(lambda: (data, labels_in(np.asarray(data))))
        worker.returned.connect(self._on_scanned)
        worker.start()

    def _rescan(self) -> None:
        self._timer.start()

    def _on_scanned(self, scan: tuple[Any, dict[int, int] | None]) -> None:
        data, labels = scan
        if self._layer is not None and data is finest(self._layer):  # the layer may have changed in the meantime
            self._offer(labels)

    def _on_selected(self) -> None:
        if self._layer is None or self.rim is not None:
            return
        if self._labels is None:
            self._restored = None
            self._offer(None)
        elif self._layer.selected_label in self._labels:
            self.choose(self._layer.selected_label)

    def _offer(self, labels: dict[int, int] | None) -> None:
        """Offer these labels and rims, or only the selected label if they are unknown."""
        assert self._layer is not None
        selected = self._layer.selected_label
        before = self._restored if self._labels is None else self.currentData()
        self._labels = labels
        self.clear()
        if labels is None:
            only = selected if before is None else before
            self.addItem(RIMS[only].text if isinstance(only, str) else str(only), only)
            return
        rims = rims_in(labels)
        for kind in rims:
            self.addItem(RIMS[kind].text, kind)
        for label, count in labels.items():
            self.addItem(f"{label}   ({count:,} voxels)", label)
        show_all(self)
        usual = rims[0] if rims and _RIM.search(self._layer.name) else selected
        choices = [label for label in (before, usual, selected, *labels) if label in rims or label in labels]
        if choices:
            self.choose(choices[0])
        if self._restored is not None:
            restored, self._restored = self._restored, None
            self.settled.emit("" if restored in choices else self._missing(restored))
