"""How long napari's window stands still when maps come and are pointed at, and how much memory they take.

Needs a display, or ``xvfb-run -s "-screen 0 1600x1000x24" python docs/benchmarks/napari_stalls.py``.
"""

from __future__ import annotations

import argparse
import copy
import importlib
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import napari
import numpy as np
import psutil
from qtpy.QtCore import QEvent, QPoint, QTimer
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QApplication

import voxflat
from voxflat._napari.layers.sampled import Overlay
from voxflat._napari.map_viewer.dock import FlatMapDock, open_flat_map
from voxflat._napari.map_viewer.viewer_parts import canvas_widget
from voxflat._napari.results.flat_layers import FlatLayers
from voxflat._napari.results.maps import map_layers
from voxflat._napari.results.run import Run
from voxflat._napari.workbench import Workbench


class Pulse:
    """Beats as often as the window lives; `longest` is the longest time between two beats, ms.

    `busiest` is the most of the window's own thread: what a busy machine does not lengthen.
    """

    def __init__(self) -> None:
        self._timer = QTimer()
        self._timer.setInterval(1)
        self._timer.timeout.connect(self._beat)
        self._timer.start()
        self._last, self._spent = time.perf_counter(), time.thread_time()
        self.longest = self.busiest = 0.0

    def _beat(self) -> None:
        now, spent = time.perf_counter(), time.thread_time()
        self.longest = max(self.longest, 1000 * (now - self._last))
        self.busiest = max(self.busiest, 1000 * (spent - self._spent))
        self._last, self._spent = now, spent

    def during(self, act: Callable[[], object], until: Callable[[], bool]) -> tuple[float, float]:
        """Do something; return the longest stall until it has come to an end, and the most CPU time of one, ms."""
        live(0.3)
        self.longest = self.busiest = 0.0
        act()
        while not until():
            live(0.02)
        live(0.3)
        return self.longest, self.busiest


def live(seconds: float) -> None:
    """Let the window live."""
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        QApplication.processEvents()
        QApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)  # which only a loop of Qt's own does
        time.sleep(0.001)


def sheet(points: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a bumpy sheet of about so many points, 1 mm apart, with values."""
    size = round(points**0.5)
    i, j = np.mgrid[:size, :size]
    height = 4 * np.sin(i / 6) * np.cos(j / 8)
    corner = (i[:-1, :-1] * size + j[:-1, :-1]).ravel()
    lower = np.stack([corner, corner + size, corner + 1], axis=1)
    upper = np.stack([corner + 1, corner + size, corner + size + 1], axis=1)
    vertices = np.stack([1.0 * i, 1.0 * j, height], axis=-1).reshape(-1, 3)
    return vertices, np.concatenate([lower, upper]), height.ravel()


def moves(widget: object, dock: FlatMapDock) -> tuple[float, float]:
    """Return how long it takes to show the place of a move of the mouse, ms: the mean and the longest."""
    spent = []
    for n in range(60):
        at = QPoint(int(widget.width() * (0.3 + 0.4 * (n % 10) / 10)), int(widget.height() * (0.3 + 0.4 * n / 60)))  # type: ignore[attr-defined]
        start = time.perf_counter()
        QTest.mouseMove(widget, at)
        QApplication.processEvents()
        spent.append(1000 * (time.perf_counter() - start))
        live(0.02)
    return float(np.mean(spent)), max(spent)


def told(what: str, took: tuple[float, float]) -> None:
    """Print a stall."""
    print(f"  {what:28} {took[0]:6.0f} {took[1]:6.0f}", flush=True)


def alone(viewer: napari.Viewer, pulse: Pulse, surface: tuple[np.ndarray, ...]) -> None:
    """Tell what napari takes for the same without voxflat: what of the stalls is its own. The layers stay."""
    volume = np.random.default_rng(0).random((200, 200, 60), dtype=np.float32)
    told("a layer of 9 x 9 comes", pulse.during(lambda: viewer.add_image(np.eye(9)), lambda: True))
    viewer.layers.clear()
    told("a surface comes", pulse.during(lambda: viewer.add_surface(surface, name="sheet", units="mm"), lambda: True))
    told("a volume comes", pulse.during(lambda: viewer.add_image(volume, name="volume", units="mm"), lambda: True))
    told("it turns to 3D", pulse.during(lambda: setattr(viewer.dims, "ndisplay", 3), lambda: True))
    told("a layer is hidden", pulse.during(lambda: setattr(viewer.layers["sheet"], "visible", False), lambda: True))
    colours = np.random.default_rng(0).random((len(surface[0]), 3), dtype=np.float32)
    more = viewer.add_surface(surface[:2], vertex_colors=colours, visible=False, name="more", units="mm")
    live(1)
    told("a coloured surface shows", pulse.during(lambda: setattr(more, "visible", True), lambda: True))
    viewer.layers.remove(more)
    viewer.layers["sheet"].visible = True
    told("it turns to 2D", pulse.during(lambda: setattr(viewer.dims, "ndisplay", 2), lambda: True))


def main() -> None:
    """Flatten twice, let such maps come many times, and print what it took."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=150_000)
    parser.add_argument("--runs", type=int, default=30, help="how many, of which the first two flatten")
    asked = parser.parse_args()
    points, faces, values = sheet(asked.points)
    flat_map = voxflat.flatten((points, faces), method=voxflat.methods.Voxflat(sources=50))
    flat_map.metadata["napari"] = {"layer": "sheet", "world_axes": "RAS", "unit": "millimeter"}

    viewer = napari.Viewer()
    viewer.window.resize(1600, 960)
    live(2)
    pulse, process = Pulse(), psutil.Process()
    print(f"{len(points):,} points; longest stall, ms, and the most CPU time of one")
    came = pulse.during(lambda: viewer.open_sample("voxflat", "demo_cortex"), lambda: len(viewer.layers) == 3)
    told("the sample, as the first", came)
    viewer.layers.clear()
    print("napari without voxflat")
    alone(viewer, pulse, (points, faces, values))
    print("with voxflat")
    workbench = Workbench.of(viewer)
    pool = ThreadPoolExecutor(1)

    def made_by_a_job() -> FlatLayers:
        importlib.import_module("voxflat.figures")  # as a job does
        return map_layers(copy.deepcopy(flat_map), "sheet", Overlay("sheet", values))

    def another() -> Run:
        made = pool.submit(made_by_a_job)
        while not made.done():
            live(0.02)
        return Run(made.result(), "sheet")

    def has_ended() -> bool:
        docks = [widget for widget in QApplication.allWidgets() if isinstance(widget, FlatMapDock)]
        return form.start.isEnabled() and workbench.is_settled and all(dock.is_drawn for dock in docks)

    _, form = viewer.window.add_plugin_dock_widget("voxflat", "Flatten surface")
    form.form.surface.setCurrentText("sheet")
    live(2)
    for n in (1, 2):
        start = time.perf_counter()
        took = pulse.during(form.start.click, has_ended)
        told(f"run {n}, {time.perf_counter() - start:.0f} s from the click", took)
    dock = open_flat_map(viewer)

    def come(run: Run) -> tuple[float, float]:
        return pulse.during(lambda: workbench.add(run), lambda: workbench.is_settled and dock.is_drawn)

    stalls, memory = [], [process.memory_info().rss / 1e6]
    for _ in range(asked.runs - 2):
        stalls.append(come(another()))
        memory.append(process.memory_info().rss / 1e6)
    told(f"its maps, runs 3 to {asked.runs}", tuple(np.max(stalls, axis=0)))
    told("  the median", tuple(np.median(stalls, axis=0)))
    print(f"  memory after run 2: {memory[0]:.0f} MB, after run {asked.runs}: {memory[-1]:.0f} MB")
    print(f"  layers: {len(viewer.layers)}, widgets: {len(QApplication.allWidgets())}")
    for n in range(dock.contents.count()):
        took = pulse.during(lambda n=n: dock.contents.setCurrentIndex(n), lambda: dock.is_drawn)
        told(f"shows {dock.contents.itemText(n)}", took)
    told("another slice", pulse.during(lambda: viewer.dims.set_point(0, 90), lambda: dock.is_drawn))
    for switch in (dock.outlined, dock.on_surface):
        for way in ("on", "off", "on again", "off again"):
            told(f"{switch.text()}, {way}", pulse.during(switch.click, lambda: dock.is_drawn))
    print("a move of the mouse, ms: mean, longest")
    print("  over the map, slices         {:6.1f} {:6.1f}".format(*moves(dock.canvas.viewport(), dock)))
    print("  over the slices              {:6.1f} {:6.1f}".format(*moves(canvas_widget(dock), dock)))
    told("napari turns to 3D", pulse.during(lambda: setattr(viewer.dims, "ndisplay", 3), lambda: True))
    for switch in (dock.outlined, dock.on_surface):
        for way in ("on again", "off again"):
            told(f"{switch.text()}, {way}", pulse.during(switch.click, lambda: dock.is_drawn))
    live(2)
    print("  over the map, 3D             {:6.1f} {:6.1f}".format(*moves(dock.canvas.viewport(), dock)))
    print("  over the surface, 3D         {:6.1f} {:6.1f}".format(*moves(canvas_widget(dock), dock)))
    for name in [layer.name for layer in viewer.layers]:
        told(f"{name} goes", pulse.during(partial(viewer.layers.remove, name), lambda: dock.is_drawn))
    viewer.close()


if __name__ == "__main__":
    main()
