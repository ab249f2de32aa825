"""Sample data and actions for tests of the napari plugin."""

import numpy as np
from napari.layers import Labels
from qtpy.QtCore import QCoreApplication, QPoint, Qt, QThreadPool
from scipy.spatial import ConvexHull

from voxflat._napari.viewer_state import ViewerState

AFFINE = np.array([[0, -2.0, 0, 30], [1.5, 0, 0, -7], [0, 0, 3.0, 11], [0, 0, 0, 1]])
DOCKS = ("Flatten surface", "Flatten in patches", "Flat map", "Draw cuts", "Check surface", "Measure map")
FLIP = np.array(
    [[-2.0, 0, 0, 30], [0, 1.5, 0, -7], [0, 0, 3.0, 11], [0, 0, 0, 1]]
)  # napari does not show permuted axes


def cap(size=24):
    """A curved open surface, one voxel thick."""
    labels = np.zeros((size, size, size), dtype=np.uint8)
    i, j = np.mgrid[2 : size - 2, 2 : size - 2]
    height = size - 4 - ((i - size / 2) ** 2 + 0.5 * (j - size / 3) ** 2) / size
    labels[i, j, np.round(height).astype(int)] = 3
    return labels


def bumps(size=25):
    """A bumpy open mesh: 2 mm grid, seen from above, with a value that is 0 on its rim and behind it."""
    i, j = np.mgrid[:size, :size]
    height = 3 * np.sin(i / 3) * np.cos(j / 4) + 0.02 * i * j
    points = np.stack([2.0 * i, 2.0 * j, height], axis=-1).reshape(-1, 3)
    corner = (i[:-1, :-1] * size + j[:-1, :-1]).ravel()
    lower = np.stack([corner, corner + size, corner + 1], axis=1)
    upper = np.stack([corner + 1, corner + size, corner + size + 1], axis=1)
    values = np.where((i > 3) & (i < size - 2) & (j > 2) & (j < size - 5), 1 + np.cos(i / 5) + 0.1 * j, 0).ravel()
    return points, np.concatenate([lower, upper]), values


def sphere(count=400, radius=20.0):
    """A closed mesh around the origin."""
    number = np.arange(count) + 0.5
    height, angle = 1 - 2 * number / count, np.pi * (1 + np.sqrt(5)) * number
    ring = np.sqrt(1 - height**2)
    points = radius * np.stack([ring * np.cos(angle), ring * np.sin(angle), height], axis=1)
    return points, ConvexHull(points).simplices


def choose(box, key):
    """Choose an entry by its key."""
    box.setCurrentIndex(box.findData(key))


def choose_whole(widget):
    choose(widget.form.patch, "whole")


PATIENCE = 120_000
"""Timeout of the tests, ms, long enough for a busy machine."""


def run(widget, qtbot, dock=None):
    """Flatten, and wait until all layers are there, and the dock *Flat map*, if given, is up to date."""
    widget.start.click()
    qtbot.waitUntil(widget.start.isEnabled, timeout=PATIENCE)
    qtbot.waitUntil(lambda: ViewerState.of(widget._viewer).is_settled, timeout=PATIENCE)
    if dock is not None:
        wait_for_picture(dock, qtbot)


def run_whole(widget, qtbot):
    """Flatten a complete surface; for the labels of `cap`, once they are listed."""
    if isinstance(widget.form.surface.layer, Labels):
        qtbot.waitUntil(lambda: widget.form.label.label == 3, timeout=PATIENCE)
    choose_whole(widget)
    run(widget, qtbot)


def click_middle(canvas, qtbot):
    """Click on the middle of a canvas."""
    middle = QPoint(canvas.width() // 2, canvas.height() // 2)
    qtbot.mousePress(canvas, Qt.MouseButton.LeftButton, pos=middle)
    qtbot.mouseRelease(canvas, Qt.MouseButton.LeftButton, pos=middle)


def map_dock(viewer, qtbot):
    """The dock *Flat map*, once it is up to date."""
    _, dock = viewer.window.add_plugin_dock_widget("voxflat", "Flat map")
    wait_for_picture(dock, qtbot)
    return dock


def wait_for_picture(dock, qtbot):
    """Wait until the dock *Flat map* is up to date."""
    qtbot.waitUntil(lambda: dock.is_drawn, timeout=PATIENCE)


def open_file(viewer, qtbot, path):
    """Open a file with voxflat, wait until all layers are there, and return the new ones."""
    before = set(viewer.layers)
    viewer.open(str(path), plugin="voxflat")
    qtbot.waitUntil(lambda: ViewerState.of(viewer).is_settled, timeout=PATIENCE)
    return [layer for layer in viewer.layers if layer not in before]


def wait_until_drawn(viewer, qtbot):
    """Wait until the window is on the screen, and its canvas has been redrawn."""
    with qtbot.waitExposed(viewer.window._qt_window, timeout=PATIENCE):
        pass
    drawn = []
    canvas = viewer.window._qt_viewer.canvas._scene_canvas
    canvas.events.draw.connect(drawn.append)
    canvas.update()
    qtbot.waitUntil(lambda: bool(drawn), timeout=PATIENCE)


def wait_for_threads(qtbot):
    """Wait until no thread is running, and the signals of the last one have arrived."""
    qtbot.waitUntil(lambda: QThreadPool.globalInstance().activeThreadCount() == 0, timeout=PATIENCE)
    QCoreApplication.processEvents()
