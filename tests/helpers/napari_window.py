"""Sample data and actions for tests of the napari plugin."""

from dataclasses import replace

import composed
import numpy as np
from mesh_files import grid
from napari.layers import Labels
from numpy.testing import assert_array_equal
from qtpy.QtCore import QCoreApplication, QPoint, Qt, QThreadPool
from scipy.spatial import ConvexHull

from voxflat._napari.map_viewer.prepared_map import PreparedMap
from voxflat._napari.results.flat_layers import Run
from voxflat._napari.results.maps import map_layers
from voxflat._napari.viewer_state import ViewerState

AFFINE = np.array([[0, -2.0, 0, 30], [1.5, 0, 0, -7], [0, 0, 3.0, 11], [0, 0, 0, 1]])
DOCKS = (
    "Flatten surface",
    "Flatten in patches",
    "Flat map",
    "Draw cuts",
    "Check surface",
    "Measure map",
    "Cortical depth",
)
FLIP = np.array([[-2.0, 0, 0, 30], [0, 1.5, 0, -7], [0, 0, 3.0, 11], [0, 0, 0, 1]])  # napari shows no permuted axes


def cap(size=24):
    """A curved open surface, one voxel thick."""
    labels = np.zeros((size, size, size), dtype=np.uint8)
    i, j = np.mgrid[2 : size - 2, 2 : size - 2]
    height = size - 4 - ((i - size / 2) ** 2 + 0.5 * (j - size / 3) ** 2) / size
    labels[i, j, np.round(height).astype(int)] = 3
    return labels


def bumps(size=25):
    """A bumpy open mesh on a 2 mm grid, with values that are 0 near its rim."""
    i, j = np.mgrid[:size, :size]
    height = 3 * np.sin(i / 3) * np.cos(j / 4) + 0.02 * i * j
    mesh = grid(size, height.ravel(), step=2.0)
    values = np.where((i > 3) & (i < size - 2) & (j > 2) & (j < size - 5), 1 + np.cos(i / 5) + 0.1 * j, 0).ravel()
    return mesh.points, mesh.faces, values


def sphere(count=400, radius=20.0):
    number = np.arange(count) + 0.5
    height, angle = 1 - 2 * number / count, np.pi * (1 + np.sqrt(5)) * number
    ring = np.sqrt(1 - height**2)
    points = radius * np.stack([ring * np.cos(angle), ring * np.sin(angle), height], axis=1)
    return points, ConvexHull(points).simplices


def choose(box, key):
    box.setCurrentIndex(box.findData(key))


def choose_whole(widget):
    choose(widget.form.patch, "whole")


PATIENCE = 120_000  # timeout of the tests, ms, long enough for a busy machine


def run(widget, qtbot, dock=None):
    """Flatten, and wait until all layers are there, and the dock *Flat map*, if given, is up to date."""
    widget.start.click()
    qtbot.waitUntil(widget.start.isEnabled, timeout=PATIENCE)
    qtbot.waitUntil(lambda: ViewerState.of(widget._viewer).is_settled, timeout=PATIENCE)
    if dock is not None:
        wait_for_picture(dock, qtbot)


def run_whole(widget, qtbot):
    """Flatten a complete surface; wait first until the labels of `cap` are listed."""
    if isinstance(widget.form.surface.layer, Labels):
        qtbot.waitUntil(lambda: widget.form.label.label == 3, timeout=PATIENCE)
    choose_whole(widget)
    run(widget, qtbot)


def click_middle(canvas, qtbot):
    middle = QPoint(canvas.width() // 2, canvas.height() // 2)
    qtbot.mousePress(canvas, Qt.MouseButton.LeftButton, pos=middle)
    qtbot.mouseRelease(canvas, Qt.MouseButton.LeftButton, pos=middle)


def map_dock(viewer, qtbot):
    """Return the dock *Flat map*, once it is up to date."""
    _, dock = viewer.window.add_plugin_dock_widget("voxflat", "Flat map")
    wait_for_picture(dock, qtbot)
    return dock


def wait_for_picture(dock, qtbot):
    """Wait until the dock *Flat map* is up to date."""
    qtbot.waitUntil(lambda: dock.is_drawn, timeout=PATIENCE)


def open_file(viewer, qtbot, path):
    """Open a file with voxflat, wait for all layers, and return the new ones."""
    before = set(viewer.layers)
    viewer.open(str(path), plugin="voxflat")
    qtbot.waitUntil(lambda: ViewerState.of(viewer).is_settled, timeout=PATIENCE)
    return [layer for layer in viewer.layers if layer not in before]


def wait_until_drawn(viewer, qtbot):
    """Wait until the window is on the screen and its canvas has been redrawn."""
    with qtbot.waitExposed(viewer.window._qt_window, timeout=PATIENCE):
        pass
    drawn = []
    canvas = viewer.window._qt_viewer.canvas._scene_canvas
    canvas.events.draw.connect(drawn.append)
    canvas.update()
    qtbot.waitUntil(lambda: bool(drawn), timeout=PATIENCE)


def wait_for_threads(qtbot):
    """Wait until no thread is running and the last signals have arrived."""
    qtbot.waitUntil(lambda: QThreadPool.globalInstance().activeThreadCount() == 0, timeout=PATIENCE)
    QCoreApplication.processEvents()


def same_map(layer, expected):
    """Check that a layer has exactly this map."""
    flat_map = layer.metadata["voxflat"]
    for name in ("uv", "points", "ids", "faces", "sources", "eigenvalues"):
        assert_array_equal(getattr(flat_map, name), getattr(expected, name))
    assert_array_equal(flat_map.distortion.per_point, expected.distortion.per_point)
    own = {name: flat_map.metadata[name] for name in ("napari", "provenance")}  # calls differ, by Volume or by array
    assert flat_map.metadata == {**expected.metadata, **own}


def prepared_map_of(points, faces, **how):
    flat_map = composed.flatten((points, faces), sources=20, **how)
    origin = {"layer": "it", "world_axes": "RAS", "unit": "millimeter"}
    flat_map = replace(flat_map, details={**flat_map.details, "napari": origin})
    return PreparedMap.of(Run(map_layers(flat_map, "it"), "it"))
