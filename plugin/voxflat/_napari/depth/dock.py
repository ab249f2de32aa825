"""The widget of *Layers → Measure → Cortical depth*."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from napari import Viewer
from napari.layers import Layer
from napari.utils.colormaps import DirectLabelColormap
from napari.utils.notifications import show_info
from numpy.typing import NDArray
from qtpy.QtWidgets import QFileDialog, QPushButton, QSizePolicy, QVBoxLayout, QWidget

from voxflat._napari.depth import tasks
from voxflat._napari.depth.form import DepthForm
from voxflat._napari.docks import TaskDock, arrange, grid, plain_label
from voxflat._napari.layers.world import MADE_FROM, WORLD, data_to_world
from voxflat._napari.map_viewer.flat_window import FlatWindow
from voxflat._napari.results.flat_layers import LayerData
from voxflat._napari.results.outputs import remember, remove_unchanged
from voxflat._napari.viewer_state import ViewerState
from voxflat.errors import InputError, VoxflatError
from voxflat.laminar.profile import PROFILE_ENDINGS, Profile
from voxflat.maps.flat_map import FlatMap

_PLOT_HEIGHT = 240  # pixels


class CorticalDepth(TaskDock):
    """Divides a rim into layers, shows a volume at all depths of the displayed map, and plots profiles."""

    def __init__(self, napari_viewer: Viewer) -> None:
        super().__init__()
        self._viewer = napari_viewer
        self._state = ViewerState.of(napari_viewer)
        self.flat_window = FlatWindow(self, "Flat volume")
        self.profile: Profile | None = None
        self.plot: QWidget | None = None
        self.form = DepthForm(napari_viewer)
        tip = "Add a Labels layer with the layer of each voxel, from 1 at the white matter"
        self.layers = self._button("Divide into layers", tip, partial(self._on_divide, "layers"))
        tip = "Add a Labels layer with columns of similar size, from the inner to the outer border"
        self.columns = self._button("Divide into columns", tip, partial(self._on_divide, "columns"))
        tip = "Show the volume on the displayed map in a new window. Its slider is the depth: each step is one layer"
        self.flatten = self._button("Flat volume", tip, self._on_flatten)
        tip = "Plot the mean and standard deviation of the volume in each layer"
        self.measure = self._button("Plot profile", tip, self._on_measure)
        self.stop = self._button("Cancel", "Stop the running computation", self._on_stop)
        self.save = self._button("Save table…", "Save the values of the profile as a .tsv or .csv file", self._on_save)
        self.save.hide()
        self.status = plain_label("Choose a rim, such as a Labels layer with the labels 1, 2 and 3.")
        self.status.setWordWrap(True)
        self._actions = (self.layers, self.columns, self.flatten, self.measure)
        self._column = QVBoxLayout(self)
        arrange(self._column, self.form, grid(self._actions, 2), self.stop, self.status, self.save)
        self._column.addStretch(1)
        self._show_work(None)
        self._follow_edits(self.form)
        self.form.restored.connect(self._show_message)
        self._state.changed.connect(self._forget_error)

    def _button(self, text: str, tip: str, pressed: Callable[[], None]) -> QPushButton:
        button = QPushButton(text)
        button.setToolTip(tip)
        button.clicked.connect(lambda: self._start(pressed))
        return button

    def _start(self, pressed: Callable[[], None]) -> None:
        try:
            pressed()
        except (VoxflatError, OSError) as error:
            self._fail(error)

    # -------------------------------------------------------------------------------------------- tasks

    def _on_divide(self, parts: str) -> None:
        rim, layer = self.form.rim(), self.form.surface.layer
        if parts == "layers":
            task = partial(tasks.divide_into_layers, rim, self.form.layers())
        else:
            task = partial(tasks.divide_into_columns, rim, self.form.area.value())
        self._work(task, f"Dividing into {parts}", partial(self._on_divided, layer, parts))

    def _on_divided(self, layer: Layer, parts: str, data: NDArray[np.integer]) -> None:
        name = f"{layer.name} in {parts}"
        remove_unchanged(self._viewer, name)
        about = {MADE_FROM: layer.name, WORLD: self.form.world.currentData()}
        place = {"affine": data_to_world(layer), "units": layer.units, "metadata": about}
        colours = {"colormap": _in_order(int(data.max()))} if parts == "layers" else {}
        remember(self._viewer.add_labels(data, name=name, **place, **colours))
        self._show_message(f"Divided '{layer.name}' into {data.max():,} {parts}.")

    def _on_flatten(self) -> None:
        flat_map = None if self._state.current is None else self._state.current.flat_map
        if not isinstance(flat_map, FlatMap) or flat_map.pial_points is None:
            raise InputError(
                "There is no map with an inner and an outer border. Flatten a rim, or a white surface with its pial "
                "surface, then press Flat volume"
            )
        volume, layers = self.form.volume(), self.form.layers()
        self._work(partial(tasks.flat_volume, flat_map, volume, layers), "Flat volume", self._on_flattened)

    def _on_flattened(self, layer: LayerData) -> None:
        self.flat_window.show(layer)
        self.flat_window.take_back(self._state.flat_drawings)
        name = layer[1]["name"]
        steps = f"{len(layer[0])} layers, from the white matter outwards"
        self._show_message(f"The window shows '{name}'. Its slider is the depth: {steps}.")

    def _on_measure(self) -> None:
        volume, region = self.form.volume(), self.form.region()
        task = partial(tasks.profile, self.form.rim(), volume, region, self.form.layers())
        self._work(task, "Plotting the profile", self._on_measured)

    def _on_measured(self, result: tuple[Profile, Any]) -> None:
        from matplotlib.backends.backend_qtagg import FigureCanvasQTAgg

        self.profile, figure = result
        plot: QWidget = FigureCanvasQTAgg(figure)  # type: ignore[no-untyped-call]
        plot.setMinimumHeight(_PLOT_HEIGHT)
        plot.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Expanding)
        if self.plot is not None:
            self._column.removeWidget(self.plot)
            self.plot.deleteLater()
        self.plot = plot
        self._column.insertWidget(self._column.indexOf(self.save), plot, 100)
        self.save.show()
        legend = "The line is the mean, and the band is the standard deviation between voxels"
        self._show_message(f"{legend}, in {self.profile.mean.shape[-1]} layers.")

    def _on_stop(self) -> None:
        if self._worker is not None:
            self._worker.quit()
            self._show_message("Cancelling…")

    def _show_work(self, stage: str | None) -> None:
        for button in self._actions:
            button.setEnabled(stage is None)
        self.stop.setEnabled(stage is not None)
        if stage is not None:
            self._show_message(f"{stage}…")

    def _show_message(self, message: str) -> None:
        self.status.setText(message)

    def _on_finished(self) -> None:
        if self._worker is not None and self._worker.abort_requested:
            self._show_message("Cancelled")
        super()._on_finished()

    def _on_save(self) -> None:
        kinds = "Tab-separated (*.tsv);;Comma-separated (*.csv)"
        path, _ = QFileDialog.getSaveFileName(self, "Save the profile", "profile.tsv", kinds)
        if path and self.profile is not None:
            file = Path(path if path.lower().endswith(PROFILE_ENDINGS) else f"{path}.tsv")
            self.profile.save(file, overwrite=True)  # the dialog has asked
            show_info(f"Saved {file}")

    def _release(self) -> None:
        super()._release()
        self._state.changed.disconnect(self._forget_error, missing_ok=True)
        self.form.release()
        if drawn := self.flat_window.drawn:
            self.flat_window.keep(drawn, self._state.flat_drawings)
            names = ", ".join(f"'{layer.name}'" for layer in drawn)
            show_info(f"Press Flat volume in Cortical depth to see the layers of its window again: {names}")
        self.flat_window.close()


def _in_order(count: int) -> DirectLabelColormap:
    """Return colours for layers, in the order of their depth."""
    from matplotlib import colormaps

    colours: dict[int | None, NDArray[np.floating]] = {None: np.zeros(4), 0: np.zeros(4)}
    colours |= dict(enumerate(colormaps["viridis"](np.linspace(0, 1, count)), 1))
    return DirectLabelColormap(color_dict=colours)
