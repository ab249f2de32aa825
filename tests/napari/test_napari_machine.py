"""Random sequences of actions in napari's window: no exception, no crash, and consistent choices.

`make test` runs a few sequences, always the same ones; `make bench-napari` runs 200 others (`--sequences`).
"""

import sys

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.errors import Flaky
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule, run_state_machine_as_test
from napari.layers import Image, Labels, Layer, Points, Shapes, Surface
from napari.utils.notifications import ErrorNotification, notification_manager
from napari_window import DOCKS, PATIENCE, bumps, cap, sphere, wait_for_threads
from qtpy.QtCore import QPoint, Qt, QThreadPool
from qtpy.QtWidgets import (
    QAbstractButton,
    QAbstractSpinBox,
    QApplication,
    QComboBox,
    QFileDialog,
    QSlider,
    QTableWidget,
)

import voxflat
from voxflat._napari.forms.layer_choice import LayerChoice
from voxflat._napari.map_viewer.contents import suits
from voxflat._napari.map_viewer.dock import FlatMapDock
from voxflat._napari.viewer_state import ViewerState

RUNS = DOCKS[:2]
FEW, STEPS = (3, 16), 25  # sequences in `make test`, and actions in each; actions in each of the others
NUMBER = st.integers(0, 10**6)
SHARE = st.floats(0, 1)

LAYERS = {
    "labels": lambda: Labels(cap(12), name="sheet"),
    "ball": lambda: Labels(np.pad(np.ones((5, 5, 5), dtype=np.uint8), 2), name="ball"),
    "image": lambda: Image(cap(12).astype(np.float32), name="T1"),
    "image in µm": lambda: Image(cap(12).astype(np.float32), name="microscope", units="um", scale=(9, 9, 9)),
    "colours": lambda: Image(np.zeros((12, 12, 12, 3), dtype=np.uint8), name="colours", rgb=True),
    "film": lambda: Image(np.random.default_rng(0).random((2, 12, 12, 12)), name="film"),
    "picture": lambda: Image(np.eye(9), name="picture"),
    "empty": lambda: Labels(np.zeros((9, 9, 9), dtype=np.uint8), name="empty"),
    "grid": lambda: Surface(bumps(9), name="grid", units="mm"),
    "sphere": lambda: Surface(sphere(150), name="sphere"),
    "points": lambda: Points([[5, 5, 9], [6, 6, 9]], name="points"),
    "no points": lambda: Points(np.empty((0, 3)), ndim=3, name="no points"),
    "flat points": lambda: Points([[5, 5]], name="flat points"),
    "polygon": lambda: Shapes([[[3, 2, 9], [3, 9, 9], [9, 5, 9]]], shape_type="polygon", name="polygon"),
    "no shapes": lambda: Shapes(ndim=3, name="no shapes"),
}


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """Files of a map and of an atlas."""
    folder = tmp_path_factory.mktemp("saved")
    points, faces, _ = bumps(9)
    voxflat.flatten((points, faces)).save(folder / "map.voxflat")
    voxflat.surface((points, faces)).patches(count=2).save(folder / "atlas.voxflat")
    return [folder / "map.voxflat", folder / "atlas.voxflat"]


def one_of(things, number):
    return [things[number % len(things)]] if things else []


class Window(RuleBasedStateMachine):
    """A user of napari's window; `make_viewer`, `qtbot`, `saved` and `failures` are set by the test."""

    def __init__(self):
        super().__init__()
        self.errors = []
        self._hook, sys.excepthook = sys.excepthook, lambda *error: self.errors.append(error)
        notification_manager.records.clear()
        self.docks = {}

    @initialize(shown=st.booleans(), dock=st.sampled_from(DOCKS), kind=st.sampled_from([*LAYERS]))
    def open_window(self, shown, dock, kind):
        self.viewer = self.make_viewer(show=shown)
        self.add(kind)
        self.open(dock)

    @rule(kind=st.sampled_from([*LAYERS]))
    def add(self, kind):
        self.viewer.add_layer(LAYERS[kind]())

    def _layer(self, number):
        """Return a list with one layer, or an empty list."""
        return one_of([*self.viewer.layers], number)

    @rule(number=NUMBER)
    def delete(self, number):
        for layer in self._layer(number):
            self.viewer.layers.remove(layer)

    @rule(sure=st.sampled_from([False, False, True]))
    def delete_all(self, sure):
        if sure:
            self.viewer.layers.clear()

    @rule(number=NUMBER, name=st.sampled_from(["a", "pial", "inflated", "<b>"]))
    def rename(self, number, name):
        for layer in self._layer(number):
            layer.name = name

    @rule(number=NUMBER)
    def select(self, number):
        self.viewer.layers.selection.active = next(iter(self._layer(number)), None)

    @rule(number=NUMBER)
    def hide_or_show(self, number):
        for layer in self._layer(number):
            layer.visible = not layer.visible

    @rule(number=NUMBER, label=st.integers(0, 4))
    def paint(self, number, label):
        layers = [layer for layer in self.viewer.layers if isinstance(layer, Labels) and layer.ndim == 3]
        for layer in one_of(layers, number):
            layer.selected_label = label
            layer.paint((3, 3, 3), label)

    @rule(number=NUMBER)
    def open_a_file(self, number):
        self.viewer.open(str(self.saved[number % len(self.saved)]), plugin="voxflat")

    @rule()
    def toggle_3d(self):
        self.viewer.dims.ndisplay = 5 - self.viewer.dims.ndisplay

    @rule()
    def toggle_theme(self):
        self.viewer.theme = "light" if self.viewer.theme == "dark" else "dark"

    @rule(at=SHARE)
    def step(self, at):
        for axis, (low, high, _) in enumerate(self.viewer.dims.range):
            self.viewer.dims.set_point(axis, low + at * (high - low))

    @rule(name=st.sampled_from(DOCKS))
    def open(self, name):
        self.viewer.window.add_plugin_dock_widget("voxflat", name)
        self._find_docks()

    @rule(number=NUMBER)
    def close(self, number):
        self._find_docks()
        for name in one_of([*self.docks], number):
            self.viewer.window.remove_dock_widget(self.docks.pop(name))

    @rule(number=NUMBER, entry=NUMBER)
    def choose(self, number, entry):
        for box in self._field(QComboBox, number):
            if box.count():
                box.setCurrentIndex(entry % box.count())
                box.activated.emit(box.currentIndex())

    @rule(number=NUMBER)
    def press(self, number):
        for button in self._field(QAbstractButton, number):
            button.click()

    @rule(number=NUMBER, steps=st.integers(-3, 3))
    def turn(self, number, steps):
        for box in self._field(QAbstractSpinBox, number):
            box.stepBy(steps)

    @rule(number=NUMBER, at=SHARE)
    def slide(self, number, at):
        for slider in self._field(QSlider, number):
            slider.setValue(round(slider.minimum() + at * (slider.maximum() - slider.minimum())))

    @rule(number=NUMBER)
    def choose_a_cut(self, number):
        for table in self._field(QTableWidget, number):
            if table.rowCount():
                table.setCurrentCell(number % table.rowCount(), 0)

    @rule(name=st.sampled_from(RUNS))
    def run(self, name):
        self._ready_to_run(name).start.click()

    # Open docks are not preconditions of rules: they depend on when a run ends, so a sequence could not be repeated.

    @rule(stops=st.lists(NUMBER, max_size=3))
    def draw_cuts(self, stops):
        if "Draw cuts" not in self.docks:
            return
        dock = self.docks["Draw cuts"]
        dock.begin.click()
        self.be_patient()
        for stop in stops:
            dock._do(lambda drawing, stop=stop: drawing.add_stop(stop % len(drawing.surface)))

    @rule(name=st.sampled_from(RUNS))
    def run_to_its_end(self, name):
        self._ready_to_run(name).start.click()
        self.be_patient()

    @rule(name=st.sampled_from(RUNS), after=st.integers(0, 300))
    def run_and_cancel(self, name, after):
        dock = self._ready_to_run(name)
        dock.start.click()
        self.qtbot.wait(after)
        dock.stop.click()

    def _ready_to_run(self, name):
        if not self.viewer.layers:
            self.add("grid")
        if name not in self.docks:
            self.open(name)
        return self.docks[name]

    @rule(across=SHARE, down=SHARE, clicks=st.integers(0, 2))
    def point(self, across, down, clicks):
        if "Flat map" not in self.docks:
            return
        place = self.docks["Flat map"].canvas.viewport()
        at = QPoint(int(across * (place.width() - 1)), int(down * (place.height() - 1)))
        self.qtbot.mouseMove(place, at)
        if clicks:
            self.qtbot.mouseClick(place, Qt.MouseButton.LeftButton, pos=at)
        if clicks == 2:
            self.qtbot.mouseDClick(place, Qt.MouseButton.LeftButton, pos=at)

    @rule(across=SHARE, down=SHARE, clicked=st.booleans())
    def point_in_the_viewer(self, across, down, clicked):
        canvas = self.viewer.window._qt_viewer.canvas.native
        at = QPoint(int(across * (canvas.width() - 1)), int(down * (canvas.height() - 1)))
        self.qtbot.mouseMove(canvas, at)
        if clicked:
            self.qtbot.mouseClick(canvas, Qt.MouseButton.LeftButton, pos=at)

    @rule(milliseconds=st.integers(0, 100))
    def wait(self, milliseconds):
        self.qtbot.wait(milliseconds)

    @rule()
    def be_patient(self):
        """Wait until no task is running, then check that the choices match the layers."""
        self._find_docks()
        self.qtbot.waitUntil(lambda: self._is_idle, timeout=PATIENCE)
        self._find_docks()
        for dock in self.docks.values():
            for choice in dock.findChildren(LayerChoice):
                self._check_choice(choice)
        if "Flat map" in self.docks:
            self._check_map(self.docks["Flat map"])
        state = ViewerState.of(self.viewer)
        maps = [run.flat_map for run in state.runs]
        ours = [layer for layer in self.viewer.layers if layer.metadata.get("voxflat") is not None]
        assert all(any(layer.metadata["voxflat"] is one for one in maps) for layer in ours)
        for run, listed in state._runs.items():
            assert all(layer.metadata["voxflat"] is run.flat_map for layer in listed.layers)

    @property
    def _is_idle(self):
        QApplication.processEvents()
        works = any(getattr(dock, "_worker", None) is not None for dock in self.docks.values())
        draws = any(isinstance(dock, FlatMapDock) and not dock.is_drawn for dock in self.docks.values())
        pool = QThreadPool.globalInstance().activeThreadCount()
        return not (works or draws or pool) and ViewerState.of(self.viewer).is_settled

    def _check_choice(self, choice):
        offered = [layer for layer in choice._layers if layer is not None]
        assert offered == [layer for layer in self.viewer.layers if choice._rank(layer) is not None]
        texts = [choice.itemText(row) for row in range(choice.count())]
        assert texts[len(texts) - len(offered) :] == [layer.name for layer in offered]
        assert choice.layer is None or choice.layer in self.viewer.layers

    def _check_map(self, dock):
        state = ViewerState.of(self.viewer)
        assert dock._run is state.current
        assert dock.runs.count() == len(state.runs)
        offered = [one for one in dock.contents._offered if isinstance(one, Layer)]
        run = state.current
        assert offered == [layer for layer in reversed(self.viewer.layers) if run is not None and suits(layer, run)]
        assert (dock.prepared is None) == (run is None), dock.text.text()

    @invariant()
    def nothing_went_wrong(self):
        """No exception reached Qt or napari, and messages of voxflat are single lines."""
        QApplication.processEvents()
        if self.errors:
            _, error, _ = self.errors[0]
            raise error
        for record in notification_manager.records:
            if isinstance(record, ErrorNotification):
                raise record.exception
            assert "\n" not in record.message, record.message

    def teardown(self):
        error = sys.exc_info()[1]
        if isinstance(error, Exception):  # Hypothesis ends a sequence with another BaseException
            self.failures.append(error)
        try:
            if hasattr(self, "viewer") and error is None:
                self.be_patient()
                self.viewer.close()
                wait_for_threads(self.qtbot)
                self.nothing_went_wrong()
            elif hasattr(self, "viewer"):
                self.viewer.close()
        finally:
            sys.excepthook = self._hook

    def _find_docks(self):
        """Update the open docks: the first map opens one automatically."""
        self.docks = {}
        for name, dock in self.viewer.window.dock_widgets.items():
            self.docks |= {own: dock for own in DOCKS if name.startswith(own)}

    def _field(self, kind, number):
        """Return a list with one of the enabled fields of the docks, or an empty list."""
        self._find_docks()
        parts = [part for dock in self.docks.values() for part in dock.findChildren(kind)]
        return one_of([part for part in parts if part.isEnabled() and part.isVisibleTo(part.window())], number)


def test_any_sequence_of_actions(make_napari_viewer, qtbot, saved, request, monkeypatch):
    for ask in ("getSaveFileName", "getOpenFileName"):
        monkeypatch.setattr(QFileDialog, ask, lambda *_: ("", ""))
    monkeypatch.setattr(QFileDialog, "getExistingDirectory", lambda *_: "")
    failures = []
    given = {"make_viewer": staticmethod(make_napari_viewer), "qtbot": qtbot, "saved": saved, "failures": failures}
    machine = type("Window", (Window,), given)
    sequences = request.config.getoption("sequences")
    few = {"max_examples": FEW[0], "stateful_step_count": FEW[1], "derandomize": True, "database": None}
    how = {"max_examples": sequences, "stateful_step_count": STEPS} if sequences else few
    phases = [Phase.explicit, Phase.reuse, Phase.generate]  # shrinking would open many windows
    how |= {"deadline": None, "phases": phases, "suppress_health_check": [*HealthCheck]}
    try:
        run_state_machine_as_test(machine, settings=settings(**how))
    except Flaky as flaky:  # Hypothesis reports only that steps which once succeeded have failed
        if failures:
            raise failures[-1] from flaky
        raise
