"""The widget of *Layers → Transform → Flatten surface*."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np
from napari.layers import Image, Labels
from napari.utils.notifications import notification_manager, show_error
from numpy.typing import NDArray
from qtpy.QtCore import QEvent, QTimer
from qtpy.QtWidgets import (
    QComboBox,
    QDoubleSpinBox,
    QFormLayout,
    QHBoxLayout,
    QLabel,
    QProgressBar,
    QPushButton,
    QSizePolicy,
    QSpinBox,
    QVBoxLayout,
    QWidget,
)

from voxflat._errors import Cancelled, InputError, VoxflatError
from voxflat._napari.job import Job
from voxflat._napari.label_choice import LabelChoice
from voxflat._napari.layer_choice import LayerChoice
from voxflat._napari.map_panel import MapPanel
from voxflat._napari.results import FlatLayers, Sampled
from voxflat._napari.seed_choice import SeedChoice
from voxflat._napari.volumes import WORLDS, LayerVolume, same_kind_of_unit
from voxflat._napari.worker import JobWorker

if TYPE_CHECKING:
    from napari import Viewer
    from napari.layers import Layer

_RADIUS = 45.0  # mm, as the demo's
_TICK = 50  # ms between two looks at the worker


class FlattenSurface(QWidget):
    """Flattens the surface of a label or of what lies above a threshold, in another thread.

    Parameters
    ----------
    napari_viewer : Viewer
        The viewer, which napari gives by this parameter's name.
    """

    def __init__(self, napari_viewer: Viewer) -> None:
        super().__init__()
        self._viewer = napari_viewer
        self._worker: JobWorker | None = None
        self._started = 0.0
        self._timer = QTimer(self)
        self._timer.setInterval(_TICK)
        self._timer.timeout.connect(self._show_progress)
        self._make_fields()
        self._make_actions()
        self._lay_out()
        self._on_surface()
        self._on_patch()
        self._on_sampled()
        self._set_running(False)

    # ------------------------------------------------------------------------------------------ making

    def _make_fields(self) -> None:
        self.surface = LayerChoice(self._viewer, _surface_rank)
        self.surface.setPlaceholderText("open a Labels or Image layer")
        self.surface.setToolTip("The volume: a Labels layer, or an Image layer and a threshold")
        self.label = LabelChoice()
        self.label.setToolTip("The label whose surface is flattened; by default the layer's selected one")
        self.threshold = _spin(QDoubleSpinBox(), -1e9, 1e9, "The surface encloses what is greater than this")
        self.world = QComboBox()
        for code, text in WORLDS.items():
            self.world.addItem(text, code)
        self.world.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self.world.setToolTip("Where the axes of the viewer's world grow to. With a wrong choice the map is mirrored!")
        self.patch = QComboBox()
        self.patch.addItem("disk around a seed point", True)
        self.patch.addItem("whole surface, if it is open", False)
        self.patch.setToolTip("A closed surface, such as a brain's, cannot be flattened as a whole")
        self.seed = SeedChoice(self._viewer, self._inside)
        self.radius = _spin(QDoubleSpinBox(), 1, 1000, "Radius of the disk, along the surface", " mm")
        self.radius.setDecimals(1)
        self.radius.setValue(_RADIUS)
        self.sampled = LayerChoice(self._viewer, _sampled_rank, none="nothing")
        self.sampled.setToolTip("A layer whose values at the surface the map shows, such as T1 or an atlas")
        self.sample_depth = _spin(
            QDoubleSpinBox(), -100, 100, "How far outside the surface to look; negative is inside", " mm"
        )
        self.sample_depth.setSingleStep(0.5)
        self.sources = _spin(QSpinBox(), 0, 100_000, "How many points distances are measured from")
        self.sources.setSpecialValueText("automatic (up to 1000)")
        self.pixel_size = _spin(QDoubleSpinBox(), 0, 100, "Side of the map's pixels", " mm")
        self.pixel_size.setSingleStep(0.1)
        self.pixel_size.setSpecialValueText("automatic (half a voxel)")
        self.surface.chosen.connect(self._on_surface)
        self.sampled.chosen.connect(self._on_sampled)
        self.patch.currentIndexChanged.connect(self._on_patch)

    def _make_actions(self) -> None:
        self.start = QPushButton("Flatten surface")
        self.start.clicked.connect(self.flatten)
        self.stop = QPushButton("Cancel")
        self.stop.clicked.connect(self.cancel)
        self.bar = QProgressBar()
        self.status = QLabel()
        self.status.setWordWrap(True)
        self.results = MapPanel(self._viewer)
        self.seed.picking.connect(self.results.show_volume)

    def _lay_out(self) -> None:
        self._form = form = QFormLayout()
        form.setFieldGrowthPolicy(QFormLayout.FieldGrowthPolicy.AllNonFixedFieldsGrow)
        for text, field in (
            ("Surface", self.surface),
            ("Label", self.label),
            ("Threshold", self.threshold),
            ("World axes", self.world),
            ("Patch", self.patch),
            ("Seed point", self.seed),
            ("Radius", self.radius),
            ("Show on map", self.sampled),
            ("at depth", self.sample_depth),
            ("Sources", self.sources),
            ("Pixel size", self.pixel_size),
        ):
            form.addRow(text, field)
        actions = QHBoxLayout()
        actions.addWidget(self.start, 2)
        actions.addWidget(self.stop, 1)
        layout = QVBoxLayout(self)
        layout.addLayout(form)
        layout.addLayout(actions)
        layout.addWidget(self.bar)
        layout.addWidget(self.status)
        layout.addWidget(self.results)
        layout.addStretch(1)

    # ---------------------------------------------------------------------------------------- choosing

    def _on_surface(self) -> None:
        layer = self.surface.layer
        labels = isinstance(layer, Labels)
        self.label.follow(layer if labels else None)
        self._show_row(self.label, labels)
        self._show_row(self.threshold, isinstance(layer, Image))
        if isinstance(layer, Image):
            self._offer_threshold(*layer.contrast_limits)
        self.seed.set_surface(layer)

    def _offer_threshold(self, low: float, high: float) -> None:
        digits = 3 - np.floor(np.log10(high - low)) if high > low else 3
        self.threshold.setDecimals(int(np.clip(digits, 0, 12)))
        self.threshold.setSingleStep((high - low) / 100)
        self.threshold.setValue((low + high) / 2)

    def _on_patch(self) -> None:
        self._show_row(self.seed, self.patch.currentData())
        self._show_row(self.radius, self.patch.currentData())

    def _on_sampled(self) -> None:
        self._show_row(self.sample_depth, self.sampled.layer is not None)

    def _show_row(self, field: QWidget, visible: bool) -> None:
        field.setVisible(visible)
        label = self._form.labelForField(field)
        assert label is not None
        label.setVisible(visible)

    def _inside(self, values: NDArray[Any]) -> NDArray[Any]:
        """Say which values are foreground."""
        labels = isinstance(self.surface.layer, Labels)
        return np.asarray(values == self.label.label if labels else values > self.threshold.value())

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
        layer, sampled = self.surface.layer, self.sampled.layer
        if layer is None:
            raise InputError("nothing to flatten: open a Labels or Image layer")
        surface = LayerVolume.of(layer, self.world.currentData())
        if sampled is not None and sampled.ndim == 3 and not same_kind_of_unit(layer, sampled):
            raise InputError(
                f"layers '{layer.name}' and '{sampled.name}' have units that cannot be compared "
                f"({layer.units[0]}, {sampled.units[0]}): set the units of both"
            )
        on_disk = self.patch.currentData()
        if on_disk and self.seed.voxel is None:
            raise InputError("no seed point: click Pick, then on the surface; or choose the whole surface")
        return Job(
            surface=surface,
            label=self.label.label if isinstance(layer, Labels) else None,
            threshold=self.threshold.value() if isinstance(layer, Image) else None,
            seed_point=self.seed.voxel if on_disk else None,
            radius=self.radius.value() if on_disk else None,
            sources=self.sources.value() or None,
            pixel_size=self.pixel_size.value() or None,
            sampled=None if sampled is None else _sampled(sampled, self.world.currentData(), self.sample_depth.value()),
        )

    # --------------------------------------------------------------------------------------- flattening

    def flatten(self) -> None:
        """Start flattening; `cancel` stops it."""
        if self._worker is not None:
            return
        try:
            worker = JobWorker(self.job())
        except VoxflatError as error:
            self._fail(str(error))
            return
        worker.returned.connect(self._on_returned)
        worker.errored.connect(self._on_errored)
        worker.finished.connect(self._on_finished)
        self.destroyed.connect(worker.quit)  # with the window
        self._worker = worker
        self._started = time.perf_counter()
        self._set_running(True)
        worker.start()

    def cancel(self) -> None:
        """Stop flattening, if it is under way."""
        if self._worker is not None:
            self._worker.quit()
            self.stop.setEnabled(False)
            self.status.setText("cancelling…")

    def _set_running(self, running: bool) -> None:
        self.start.setEnabled(not running)
        self.stop.setEnabled(running)
        self.bar.setVisible(running)
        if running:
            self._show_progress()
            self._timer.start()
        else:
            self._timer.stop()

    def _show_progress(self) -> None:
        if self._worker is None or self._worker.abort_requested:
            return
        stage, done, total = self._worker.stage
        counted = total > 1
        self.bar.setRange(0, total if counted else 0)  # 0 to 0 shows that it goes on
        self.bar.setValue(done if counted else 0)
        self.status.setText(f"{stage}…")

    def _on_returned(self, result: FlatLayers) -> None:
        if self._worker is None or self._worker.abort_requested:
            return  # cancelled when it was just done
        seconds = time.perf_counter() - self._started
        error = 100 * result.flat_map.distortion.raw.relative_error
        summary = f"{len(result.flat_map):,} points in {seconds:.1f} s, {error:.1f} % mean relative error"
        self.status.setText(summary)
        self.results.show_result(result)
        self._viewer.status = summary

    def _on_errored(self, error: Exception) -> None:
        if isinstance(error, Cancelled):
            return
        if isinstance(error, VoxflatError | MemoryError | OSError):
            self._fail(str(error) or type(error).__name__)
        else:  # a bug: with its traceback
            self.status.setText(f"{type(error).__name__}: {error}")
            notification_manager.receive_error(type(error), error, error.__traceback__)

    def _on_finished(self) -> None:
        if self._worker is not None and self._worker.abort_requested:
            self.status.setText("cancelled")
        self._worker = None
        self._set_running(False)

    def _fail(self, message: str) -> None:
        message = " ".join(message.split())
        self.status.setText(message)
        show_error(message)

    # ------------------------------------------------------------------------------------------- ending

    def event(self, event: Any) -> bool:
        """End what is under way when napari closes the widget's dock, which takes the widget out of the window."""
        if event.type() == QEvent.Type.ParentChange and self.parent() is None:
            self._release()
        return bool(super().event(event))

    def _release(self) -> None:
        self.cancel()
        self.label.follow(None)
        for part in (self.surface, self.sampled, self.seed, self.results):
            part.release()


def _spin(box: Any, least: float, most: float, tip: str, suffix: str = "") -> Any:
    box.setRange(least, most)
    box.setToolTip(tip)
    box.setSuffix(suffix)
    box.setKeyboardTracking(False)
    return box


def _surface_rank(layer: Layer) -> int | None:
    if not isinstance(layer, Image | Labels) or getattr(layer, "rgb", False) or "voxflat" in layer.metadata:
        return None
    return (1 + isinstance(layer, Labels)) if layer.ndim == 3 else 0


def _sampled_rank(layer: Layer) -> int | None:
    if not isinstance(layer, Image | Labels) or "voxflat" in layer.metadata:
        return None
    return int(isinstance(layer, Image) and layer.ndim == 3)


def _sampled(layer: Layer, world: str, depth: float) -> Sampled:
    """Return a layer's values, and how to show them."""
    volume = LayerVolume.of(layer, world)
    if isinstance(layer, Labels):
        return Sampled(volume, depth, "labels", {"colormap": layer.colormap})
    if layer.rgb:
        return Sampled(volume, depth)
    display = {"colormap": layer.colormap, "gamma": layer.gamma}
    if layer.contrast_limits != layer.contrast_limits_range:  # someone chose them
        display["contrast_limits"] = layer.contrast_limits
    return Sampled(volume, depth, "image", display)
