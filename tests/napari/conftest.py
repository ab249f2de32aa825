"""Fixtures of the tests in napari's window."""

import gc
from functools import cache
from pathlib import Path

import pytest
from napari_window import map_dock, run, wait_for_threads, wait_until_drawn


def pytest_collection_modifyitems(items):
    """Mark all tests of this folder as slow: they open windows, and importing napari alone takes seconds."""
    for item in items:
        if item.path.is_relative_to(Path(__file__).parent):
            item.add_marker("slow")


@pytest.fixture(autouse=True)
def exclude_modules_from_garbage_collection():
    """Freeze imported objects: napari collects garbage whenever layers are removed, through half a million of them."""
    import matplotlib.pyplot  # noqa: F401
    import napari  # noqa: F401
    from napari._qt.qt_main_window import Window  # noqa: F401

    gc.freeze()  # before each test, because many modules are imported late


@pytest.fixture(scope="session", autouse=True)
def windows_open_quickly():
    """Skip what each window repeats (plugins, screen, settings, welcome), and animations while jobs run."""
    from napari._qt.containers import _layer_delegate
    from napari._qt.dialogs import qt_activity_dialog
    from napari.settings._base import EventedConfigFileSettings
    from npe2 import PluginManifest
    from qtpy.QtWidgets import QProgressBar
    from vispy.app import canvas

    try:
        from napari._qt.widgets.qt_welcome import QtWelcomeWidget
    except ImportError:  # napari 0.7
        QtWelcomeWidget = None  # noqa: N806
    discover, set_range = PluginManifest.discover, QProgressBar.setRange
    found = cache(lambda paths: list(discover(paths=paths)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(PluginManifest, "discover", lambda paths=(): found(tuple(paths)))
        patch.setattr(canvas, "get_dpi", cache(canvas.get_dpi))
        patch.setattr(EventedConfigFileSettings, "_maybe_save", lambda _: None)
        if refresh := getattr(QtWelcomeWidget, "refresh", None):  # not in napari 0.6
            patch.setattr(QtWelcomeWidget, "refresh", lambda it, _=None: refresh(it) if it.isVisible() else None)
        for module in (qt_activity_dialog, _layer_delegate):
            patch.setattr(module, "LOADING_GIF_PATH", "")
        patch.setattr(QProgressBar, "setRange", lambda bar, low, high: set_range(bar, low, max(high, low + 1)))
        yield


@pytest.fixture
def open_widget(make_napari_viewer):
    """A function that opens napari's window with layers and a widget of voxflat."""

    def opened(*layers, show=False, name="Flatten surface"):
        viewer = make_napari_viewer(show=show)
        for layer in layers:
            viewer.add_layer(layer)
        _, widget = viewer.window.add_plugin_dock_widget("voxflat", name)
        return viewer, widget

    return opened


@pytest.fixture
def flattened(open_widget, qtbot):
    """A function that flattens a layer in a window, and opens the dock *Flat map*."""
    from napari.layers import Labels

    def opened(*layers, **how):
        viewer, widget = open_widget(*layers, show=True, **how)
        viewer.window._qt_window.resize(1000, 700)
        if isinstance(widget.form.surface.layer, Labels):
            qtbot.waitUntil(lambda: widget.form.label.count() == 1 and "voxels" in widget.form.label.currentText())
        run(widget, qtbot)
        wait_until_drawn(viewer, qtbot)
        return viewer, widget, map_dock(viewer, qtbot)

    yield opened
    wait_for_threads(qtbot)


@pytest.fixture
def messages():
    """The notifications of napari."""
    from napari.utils.notifications import notification_manager

    notification_manager.records.clear()
    return notification_manager.records
