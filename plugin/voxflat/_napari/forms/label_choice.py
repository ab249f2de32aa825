"""A box for choosing one of the labels in a Labels layer."""

from typing import Any

import numpy as np
from napari.layers import Labels
from qtpy.QtWidgets import QComboBox

from voxflat._napari.layers.volumes import finest
from voxflat._napari.timers import single_shot
from voxflat._napari.worker import BackgroundTask
from voxflat.surfaces.foreground import labels_in

_SCANNED = 2**29  # voxels; larger layers, which may be remote, are not read only to list their labels
_PAUSE = 400  # ms without painting before the labels are listed again


class LabelChoice(QComboBox):
    """Lets the user choose a label from a list compiled in a thread; the default is the selected label of the layer."""

    def __init__(self) -> None:
        super().__init__()
        self._layer: Labels | None = None
        self._labels: dict[int, int] | None = None  # number of voxels of each label, once known
        self._timer = single_shot(self, _PAUSE, self.scan)

    @property
    def label(self) -> int | None:
        label = self.currentData()
        return None if label is None else int(label)

    def choose(self, label: int) -> None:
        self.setCurrentIndex(self.findData(label))

    def follow(self, layer: Labels | None) -> None:
        """Offer the labels of a layer, and follow its changes."""
        if self._layer is not None:
            self._layer.events.selected_label.disconnect(self._on_selected)
            for event in (self._layer.events.data, self._layer.events.labels_update):
                event.disconnect(self._rescan)
        self._layer = layer
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

    def _on_scanned(self, found: tuple[Any, dict[int, int] | None]) -> None:
        data, labels = found
        if self._layer is not None and data is finest(self._layer):  # the layer may have changed in the meantime
            self._offer(labels)

    def _on_selected(self) -> None:
        if self._layer is None:
            return
        if self._labels is None:
            self._offer(None)
        elif self._layer.selected_label in self._labels:
            self.choose(self._layer.selected_label)

    def _offer(self, labels: dict[int, int] | None) -> None:
        """Offer these labels, or only the selected label if they are unknown."""
        assert self._layer is not None
        selected = self._layer.selected_label
        before = self.label
        self._labels = labels
        self.clear()
        if labels is None:
            self.addItem(str(selected), selected)
            return
        for label, count in labels.items():
            self.addItem(f"{label}   ({count:,} voxels)", label)
        if (wanted := before if before in labels else selected) in labels:
            self.choose(wanted)
