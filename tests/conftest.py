import os
import signal

import pytest

os.environ.setdefault("MPLBACKEND", "Agg")

# a shell's background jobs, and what they start, ignore Ctrl-C: tests that press it would wait for ever
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def open_widget(make_napari_viewer):
    """A function that opens napari's window with layers and a widget of ours."""

    def opened(*layers, show=False, name="Flatten surface"):
        viewer = make_napari_viewer(show=show)
        for layer in layers:
            viewer.add_layer(layer)
        _, widget = viewer.window.add_plugin_dock_widget("voxflat", name)
        return viewer, widget

    return opened


@pytest.fixture
def messages():
    """What napari notified of."""
    from napari.utils.notifications import notification_manager

    notification_manager.records.clear()
    return notification_manager.records
