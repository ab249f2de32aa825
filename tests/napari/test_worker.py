"""What works in another thread is shown in napari's activity dock, and is cancelled there, too."""

import threading

import pytest
from napari.resources import LOADING_GIF_PATH
from napari.utils import progress
from napari_window import PATIENCE, wait_for_threads
from qtpy.QtWidgets import QLabel

from voxflat._napari.worker import JobWorker
from voxflat.errors import Cancelled

pytestmark = pytest.mark.slow  # a window


class Endless:
    """Works until it is cancelled."""

    def __init__(self):
        self.go_on = threading.Event()

    def run(self, tell):
        while tell("counting", 3, 7):
            self.go_on.wait(0.001)
        raise Cancelled("cancelled")


def test_the_activity_dock_shows_and_cancels(make_napari_viewer, qtbot, monkeypatch):
    monkeypatch.setattr("napari._qt.dialogs.qt_activity_dialog.LOADING_GIF_PATH", LOADING_GIF_PATH)
    window = make_napari_viewer().window._qt_window
    (wheel,) = (label.movie() for label in window.statusBar().findChildren(QLabel) if label.movie() is not None)
    worker, errors = JobWorker(Endless(), "Flatten"), []
    worker.errored.connect(errors.append)
    calls = []
    monkeypatch.setattr("voxflat._napari.worker.put_off_collections", lambda: calls.append(worker.stage))
    worker.start()
    qtbot.waitUntil(lambda: bool(progress._all_instances), timeout=PATIENCE)
    (bar,) = progress._all_instances
    qtbot.waitUntil(lambda: (bar.n, bar.total) == (3, 7), timeout=PATIENCE)
    assert bar.desc.startswith("Flatten: counting")
    assert len(calls) > 1  # as long as it works
    assert wheel.speed() < 20  # %: each of its pictures has the whole window put together
    bar.cancel()  # as the button there
    qtbot.waitUntil(lambda: bool(errors), timeout=PATIENCE)
    assert isinstance(errors[0], Cancelled)
    wait_for_threads(qtbot)
    assert not progress._all_instances
    assert wheel.speed() == 100


def test_the_wheel_turns_slowly_while_any_job_runs(make_napari_viewer, qtbot, monkeypatch):
    monkeypatch.setattr("napari._qt.dialogs.qt_activity_dialog.LOADING_GIF_PATH", LOADING_GIF_PATH)
    window = make_napari_viewer().window._qt_window
    (wheel,) = (label.movie() for label in window.statusBar().findChildren(QLabel) if label.movie() is not None)
    workers = [JobWorker(Endless(), name) for name in ("one", "other")]
    for worker in workers:
        worker.start()
    qtbot.waitUntil(lambda: all(worker.is_running for worker in workers), timeout=PATIENCE)
    for worker, speed in zip(workers, (12, 100), strict=True):
        with qtbot.waitSignal(worker.finished, timeout=PATIENCE):
            worker.quit()
        qtbot.waitUntil(lambda speed=speed: wheel.speed() == speed, timeout=PATIENCE)
    wait_for_threads(qtbot)


def test_who_cancels_at_once_sees_no_bar(make_napari_viewer, qtbot):
    make_napari_viewer()
    worker, errors = JobWorker(Endless()), []
    worker.errored.connect(errors.append)
    worker.start()
    worker.quit()
    qtbot.waitUntil(lambda: bool(errors), timeout=PATIENCE)
    assert isinstance(errors[0], Cancelled)
    assert not progress._all_instances
    wait_for_threads(qtbot)
