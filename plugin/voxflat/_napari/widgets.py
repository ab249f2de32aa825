"""The widgets of *Layers → Transform* that flatten, each with a form, buttons, a progress bar and results."""

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from napari import Viewer
from napari.layers import Layer
from napari.utils.notifications import notification_manager, show_warning
from qtpy.QtCore import QEvent, QSize, Qt, QTimer
from qtpy.QtWidgets import (
    QFrame,
    QHBoxLayout,
    QProgressBar,
    QPushButton,
    QScrollArea,
    QStyle,
    QVBoxLayout,
    QWidget,
)

from voxflat._napari.docks import TaskDock, arrange, plain_label
from voxflat._napari.forms.patches_form import PatchesForm
from voxflat._napari.forms.surface_form import SurfaceForm
from voxflat._napari.map_viewer.dock import open_flat_map
from voxflat._napari.results import report
from voxflat._napari.results.flat_layers import FlatLayers, Run
from voxflat._napari.results.map_panel import MapPanel
from voxflat._napari.results.maps import C_MEANING
from voxflat._napari.results.session import session_of
from voxflat._napari.scripts import Recipe
from voxflat._napari.timers import PAUSE, single_shot
from voxflat._napari.viewer_state import ViewerState
from voxflat._napari.wording import error_text
from voxflat._napari.worker import POLL_INTERVAL
from voxflat.arguments import Progress, collecting_warnings
from voxflat.errors import Cancelled, VoxflatError
from voxflat.maps.flat_map import FlatMap

_RESTORE = "Set the form as it was when this map was computed"


class FlattenWidget(TaskDock):
    """Runs the job that a form describes in another thread, and shows the result."""

    def __init__(self, viewer: Viewer, form: SurfaceForm | PatchesForm, results: MapPanel, action: str) -> None:
        super().__init__()
        self._viewer = viewer
        self._started = 0.0
        self._has_finished = True
        self._is_refused = False  # because there is nothing to flatten
        self._shown: Run | None = None
        self._summary = ""  # of the last map, which the status bar of napari also shows
        self._arriving: tuple[Run, str] | None = None
        self._coming = single_shot(self, PAUSE, self._arrive)
        self._timer = QTimer(self)
        self._timer.setInterval(POLL_INTERVAL)
        self._timer.timeout.connect(self._show_progress)
        self.form = form
        self.results = results
        results.write = ViewerState.of(viewer).save
        self.start, self.stop = QPushButton(action), QPushButton("Cancel")
        self.start.clicked.connect(self.flatten)
        self.stop.clicked.connect(self.cancel)
        self.bar, self.status = QProgressBar(), plain_label()
        self.status.setWordWrap(True)
        inside = QWidget()
        column = QVBoxLayout(inside)
        column.setContentsMargins(0, 0, 0, 0)
        arrange(column, self.form, self.results)
        column.addStretch(1)
        self.scrolled = _Scroll()
        self.scrolled.setWidget(inside)
        actions = QHBoxLayout()  # outside the scroll area, where the buttons are always visible
        arrange(actions, (self.start, 2), (self.stop, 1))
        arrange(QVBoxLayout(self), (self.scrolled, 1), actions, self.bar, self.status)
        self._show_work(None)
        self._follow_edits(form)
        self._swapped: tuple[Run, bool, Mapping[str, Any]] | None = None  # restored or undone, and the other settings
        results.settings.clicked.connect(self._swap_settings)
        form.restored.connect(self._on_restored)
        ViewerState.of(viewer).changed.connect(self._show_current)
        ViewerState.of(viewer).content_shown.connect(self._forget_error)
        self._show_current()

    def flatten(self) -> None:
        """Start the flattening; `cancel` stops it."""
        if self._worker is not None:
            return
        try:
            self._recipe = Recipe(self.form.job())
        except VoxflatError as error:
            self.results.show_earlier()
            self._fail(error)
            return
        self._has_finished = False
        self._started = time.perf_counter()
        self._work(partial(_with_warnings, self._recipe.run), self.start.text(), self._on_returned)

    def cancel(self) -> None:
        if self._worker is not None:
            self._worker.quit()
            self.stop.setEnabled(False)
            self.status.setText("Cancelling…")

    def _show_work(self, what: str | None) -> None:
        running = what is not None
        self.start.setEnabled(not running and not self._is_refused)
        self.stop.setEnabled(running)
        self.bar.setVisible(running)
        self._timer.stop()
        if running:
            self._show_progress()
            self._timer.start()

    def _show_progress(self) -> None:
        if self._worker is None or self._worker.abort_requested:
            return
        stage, done, total = self._worker.stage
        self.bar.setRange(0, total if total > 1 else 0)  # the range 0 to 0 shows a busy indicator
        self.bar.setValue(done if total > 1 else 0)
        self.status.setText(f"{stage[:1].upper()}{stage[1:]}…")

    def _on_returned(self, result: FlatLayers) -> None:
        if self._worker is None or self._worker.abort_requested:
            return  # the task was cancelled just as it finished
        seconds = time.perf_counter() - self._started
        self._timer.stop()
        run = Run(result, session_of(result.flat_map).layer, self._recipe)
        self._arriving = run, f"{report.summary(result.flat_map)} ({seconds:.1f} s)"
        if not ViewerState.of(self._viewer).runs:
            open_flat_map(self._viewer)
        self._coming.start()

    def _arrive(self) -> None:
        """Show the run after the window has processed the events of the new dock."""
        assert self._arriving is not None
        (run, summary), self._arriving = self._arriving, None
        if self._worker is not None and not self._worker.abort_requested:
            ViewerState.of(self._viewer).add(run)
            self.status.setText(summary)
            self._viewer.status = self._summary = summary
            if not self.results.warnings.isHidden():
                self.show_warnings()
        self._end()

    def show_warnings(self) -> None:
        """Scroll to the warnings once the results have their size."""
        QTimer.singleShot(PAUSE, partial(self.scrolled.ensureWidgetVisible, self.results.warnings, 0, 0))

    def _show_current(self) -> None:
        """Show the current run if this widget shows runs of its kind; the status does not outlive its run."""
        self._forget_error()
        run = ViewerState.of(self._viewer).current
        if run is not self._shown and (run is None or isinstance(run.flat_map, FlatMap) == self.results.shows_maps):
            self._shown = run
            if self._viewer.status == self._summary:
                self._viewer.status = ""
            if self._worker is None:
                self.status.setText("")
        if run is not None and isinstance(run.flat_map, FlatMap) == self.results.shows_maps:
            self.results.show_run(run)
            self._offer_settings(run)
            if run is ViewerState.of(self._viewer).opened:
                ViewerState.of(self._viewer).opened = None
                if self._settings_of(run) is not None:
                    self._swap_settings()

    def _settings_of(self, run: Run) -> Mapping[str, Any] | None:
        found = session_of(run.flat_map).form
        return found if isinstance(found, Mapping) else None

    def _offer_settings(self, run: Run) -> None:
        """Offer to restore the settings of a run, or to undo this, unless they wait for a layer."""
        is_swapped = self._swapped is not None and self._swapped[0] is run and self._swapped[1]
        self.results.settings.setText("Undo restored settings" if is_swapped else "Restore settings")
        tip = "Set the form as it was before the settings were restored" if is_swapped else _RESTORE
        self.results.settings.setToolTip(tip)
        self.results.settings.setVisible(self._settings_of(run) is not None and not self.form.is_waiting)

    def _on_restored(self, message: str) -> None:
        self._show_message(message)
        if self._swapped is not None and self._swapped[0] is ViewerState.of(self._viewer).current:
            self._offer_settings(self._swapped[0])

    def _swap_settings(self) -> None:
        """Restore the settings of the current run, or those before."""
        run = ViewerState.of(self._viewer).current
        assert run is not None
        is_restored, wanted = False, self._settings_of(run) or {}
        if self._swapped is not None and self._swapped[0] is run:
            _, is_restored, wanted = self._swapped
        self._swapped = run, not is_restored, self.form.record()
        self.form.restore(wanted)
        self._offer_settings(run)

    def _on_errored(self, error: Exception) -> None:
        self._timer.stop()  # otherwise the stage would overwrite the error
        self.results.show_earlier()
        if isinstance(error, Cancelled):
            return
        if isinstance(error, VoxflatError | MemoryError | OSError):
            self._fail(error)
        else:  # show the traceback of a bug
            self.status.setText(error_text(error))
            self._has_failed = True
            notification_manager.receive_error(type(error), error, error.__traceback__)

    def _on_finished(self) -> None:
        self._has_finished = True
        self._end()

    def _end(self) -> None:
        """Allow the next run once the thread has ended and its result is shown."""
        if self._arriving is not None or not self._has_finished:
            return
        if self._worker is not None and self._worker.abort_requested:
            self.status.setText("Cancelled")
        self._worker = None
        self._show_work(None)

    def _show_message(self, message: str) -> None:
        self.status.setText(message)

    def _release(self) -> None:
        super()._release()
        self.form.release()
        ViewerState.of(self._viewer).changed.disconnect(self._show_current, missing_ok=True)
        ViewerState.of(self._viewer).content_shown.disconnect(self._forget_error, missing_ok=True)


def _with_warnings(run: Callable[[Progress], FlatLayers], progress: Progress) -> FlatLayers:
    """Return the layers of a job with its warnings, which are listed with those of the map."""
    with collecting_warnings() as warnings:
        layers = run(progress)
    return replace(layers, warnings=tuple(warnings))


class FlattenSurface(FlattenWidget):
    """Flattens a mesh, the surface of a label, or the surface of the voxels above a threshold, in another thread."""

    form: SurfaceForm

    def __init__(self, napari_viewer: Viewer) -> None:
        super().__init__(napari_viewer, SurfaceForm(napari_viewer), MapPanel(), "Flatten surface")
        ViewerState.of(napari_viewer).flatten_requested.connect(self._on_flatten_requested)
        self.form.action_changed.connect(self.start.setText)
        self.form.plan.refused.connect(self._on_refused)
        self._on_refused(self.form.plan.is_refused)

    def _on_refused(self, is_refused: bool) -> None:
        self._is_refused = is_refused
        self.start.setEnabled(self._worker is None and not is_refused)

    def _on_flatten_requested(self, layer: Layer, foreground: Mapping[str, Any]) -> None:
        if not self.start.isEnabled():
            show_warning("Flatten surface is still running. Wait for its map or cancel it, then press Flatten again")
            return
        self.form.continue_from_shown_map(layer, **foreground)
        self.flatten()

    def _release(self) -> None:
        super()._release()
        ViewerState.of(self._viewer).flatten_requested.disconnect(self._on_flatten_requested, missing_ok=True)


class FlattenPatches(FlattenWidget):
    """Flattens a surface of any topology in patches of certified distortion, in another thread."""

    form: PatchesForm

    def __init__(self, napari_viewer: Viewer) -> None:
        panel = MapPanel(meaning=C_MEANING, what="atlas")
        super().__init__(napari_viewer, PatchesForm(napari_viewer), panel, "Flatten in patches")


class _Scroll(QScrollArea):
    """A scroll area that scrolls only vertically and is as wide as its contents."""

    def __init__(self) -> None:
        super().__init__()
        self.setWidgetResizable(True)
        self.setFrameShape(QFrame.Shape.NoFrame)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)

    def eventFilter(self, watched: Any, event: Any) -> bool:  # noqa: N802 - Qt's name
        if watched is self.widget() and event.type() == QEvent.Type.LayoutRequest:
            self.updateGeometry()
        return bool(super().eventFilter(watched, event))

    def minimumSizeHint(self) -> QSize:  # noqa: N802 - Qt's name
        inside, bar, style = self.widget(), self.verticalScrollBar(), self.style()
        assert inside is not None
        assert bar is not None
        assert style is not None
        beside = bar.sizeHint().width() + style.pixelMetric(QStyle.PixelMetric.PM_ScrollView_ScrollBarSpacing)
        around = self.contentsMargins()
        width = inside.minimumSizeHint().width() + beside + around.left() + around.right()
        return QSize(width, super().minimumSizeHint().height())
