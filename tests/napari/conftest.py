"""napari's window, and what happens in it."""

import pytest


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
def endings(monkeypatch):
    """How the jobs of the plugin's widgets ended: None for a result, or the class of the error."""
    from voxflat._napari.job import Job, PatchesJob

    ended = []

    def watch(run):
        def watched(job, progress):
            try:
                layers = run(job, progress)
            except Exception as error:
                ended.append(type(error))
                raise
            ended.append(None)
            return layers

        return watched

    for job in (Job, PatchesJob):
        monkeypatch.setattr(job, "run", watch(job.run))
    return ended


@pytest.fixture
def messages():
    """What napari notified of."""
    from napari.utils.notifications import notification_manager

    notification_manager.records.clear()
    return notification_manager.records
