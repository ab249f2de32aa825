"""Progress and cancelling of background tasks, and the deferral of garbage collection while they run."""

import gc
import threading
import time
import weakref

import pytest
from napari.resources import LOADING_GIF_PATH
from napari.utils import progress
from napari_window import PATIENCE, wait_for_threads
from qtpy.QtGui import QCursor
from qtpy.QtWidgets import QLabel

from voxflat._napari.garbage_collection import _Deferral, defer_collections
from voxflat._napari.worker import BackgroundTask, JobWorker, LatestTask
from voxflat.arguments import collecting_warnings, log
from voxflat.errors import Cancelled


class Circle:
    """Garbage that only the collector frees."""

    def __init__(self):
        self.own = self


@pytest.fixture
def usual(qapp, monkeypatch):
    """Restores the thresholds of the collector; the mouse rests."""
    if gc.get_threshold()[2] == 0:
        pytest.skip("this Python collects in small steps")
    monkeypatch.setattr(QCursor, "pos", lambda: (0, 0))
    monkeypatch.setattr(gc, "get_count", lambda: (0, 3, 999))  # no new objects, and enough garbage

    def end():
        if _Deferral.one is not None:
            _Deferral.one._end()

    end()  # of an earlier test
    yield gc.get_threshold()
    end()


def old_garbage():
    """Return a weak reference to garbage of the oldest generation."""
    circle = Circle()
    gc.collect(1)
    gc.collect(1)
    return weakref.ref(circle)


def test_a_full_collection_waits_until_the_window_is_idle(usual):
    defer_collections()
    assert gc.get_threshold()[:2] == usual[:2]
    assert gc.get_threshold()[2] > usual[2]
    garbage = old_garbage()
    _Deferral.one.look()  # notes the position of the mouse
    assert garbage() is not None
    _Deferral.one.look()  # the mouse has not moved since
    assert garbage() is None
    assert _Deferral.one is None
    assert gc.get_threshold() == usual


def test_the_collection_waits_for_jobs_and_the_mouse_for_a_limited_time(usual, monkeypatch):
    places = iter(range(1, 1000))
    defer_collections()
    garbage = old_garbage()
    for _ in range(30):
        defer_collections()  # as a job does, many times between two checks
        _Deferral.one.look()
    assert garbage() is not None
    monkeypatch.setattr(QCursor, "pos", lambda: (next(places), 0))
    for _ in range(8):
        _Deferral.one.look()
    defer_collections()  # layers are added, which restarts the deferral
    for _ in range(9):
        _Deferral.one.look()
    assert garbage() is not None
    _Deferral.one.look()
    assert garbage() is not None  # the user, who is moving the mouse, is not disturbed
    assert _Deferral.one is None
    assert gc.get_threshold() == usual


def test_settings_of_others_are_kept(usual):
    gc.disable()
    try:
        defer_collections()
        assert _Deferral.one is None
    finally:
        gc.enable()
    defer_collections()
    others = (usual[0] + 1, *usual[1:])
    gc.set_threshold(*others)
    try:
        _Deferral.one._end()
        assert gc.get_threshold() == others
    finally:
        gc.set_threshold(*usual)


def test_explicit_collections_run_immediately(usual):
    defer_collections()
    garbage = old_garbage()
    gc.collect()
    assert garbage() is None


def endless(progress):
    """Work until it is cancelled."""
    while progress("counting", 3, 7):
        time.sleep(0.001)
    raise Cancelled("cancelled")


@pytest.fixture
def wheel(make_napari_viewer, monkeypatch):
    """The spinner in the status bar of a window."""
    monkeypatch.setattr("napari._qt.dialogs.qt_activity_dialog.LOADING_GIF_PATH", LOADING_GIF_PATH)
    window = make_napari_viewer().window._qt_window
    (wheel,) = (label.movie() for label in window.statusBar().findChildren(QLabel) if label.movie() is not None)
    return wheel


def test_the_activity_dock_shows_and_cancels(wheel, qtbot, monkeypatch):
    worker, errors = JobWorker(endless, "Flatten"), []
    worker.errored.connect(errors.append)
    calls = []
    monkeypatch.setattr("voxflat._napari.worker.defer_collections", lambda: calls.append(worker.stage))
    worker.start()
    qtbot.waitUntil(lambda: bool(progress._all_instances), timeout=PATIENCE)
    (bar,) = progress._all_instances
    qtbot.waitUntil(lambda: (bar.n, bar.total) == (3, 7), timeout=PATIENCE)
    assert bar.desc.startswith("Flatten: counting")
    assert len(calls) > 1
    assert wheel.speed() < 20  # %; each frame redraws the complete window
    bar.cancel()  # as its button does
    qtbot.waitUntil(lambda: bool(errors), timeout=PATIENCE)
    assert isinstance(errors[0], Cancelled)
    wait_for_threads(qtbot)
    assert not progress._all_instances
    assert wheel.speed() == 100


def test_the_spinner_is_slow_while_any_job_runs(wheel, qtbot):
    workers = [JobWorker(endless, name) for name in ("one", "other")]
    for worker in workers:
        worker.start()
    qtbot.waitUntil(lambda: all(worker.is_running for worker in workers), timeout=PATIENCE)
    for worker, speed in zip(workers, (12, 100), strict=True):
        with qtbot.waitSignal(worker.finished, timeout=PATIENCE):
            worker.quit()
        qtbot.waitUntil(lambda speed=speed: wheel.speed() == speed, timeout=PATIENCE)
    wait_for_threads(qtbot)


def test_cancelling_immediately_shows_no_bar(make_napari_viewer, qtbot):
    make_napari_viewer()
    worker, errors = JobWorker(endless), []
    worker.errored.connect(errors.append)
    worker.start()
    worker.quit()
    qtbot.waitUntil(lambda: bool(errors), timeout=PATIENCE)
    assert isinstance(errors[0], Cancelled)
    assert not progress._all_instances
    wait_for_threads(qtbot)


@pytest.mark.parametrize("kind", [BackgroundTask, JobWorker])
def test_warnings_of_tasks_are_shown_once(qapp, qtbot, messages, kind):
    def work(*_):
        log.warning("layers cross. Pass depth=1")
        log.warning("layers cross. Pass depth=1")
        log.info("not shown")

    kind(work).start()
    qtbot.waitUntil(lambda: bool(messages))
    wait_for_threads(qtbot)
    assert [(one.severity.value, one.message) for one in messages] == [("warning", "Layers cross. Set Depth to 1.")]
    messages.clear()
    is_cancelled = threading.Event()
    cancelled = kind(lambda *_: is_cancelled.wait(PATIENCE / 1000) and work())
    with qtbot.waitSignal(cancelled.finished):
        cancelled.start()
        cancelled.quit()
        is_cancelled.set()
    wait_for_threads(qtbot)
    assert not messages


def test_a_repeated_task_shows_a_warning_once(qapp, qtbot, messages):
    shown = []
    task = LatestTask(None, shown.append, shown.append)
    for number in (1, 1, 2):
        task.ask(lambda number=number: log.warning("depth %d", number))
        qtbot.waitUntil(lambda: not task.is_busy)
    assert [one.message for one in messages] == ["Depth 1.", "Depth 2."]
    wait_for_threads(qtbot)


def test_warnings_of_other_threads_are_not_mixed():
    def inside():
        with collecting_warnings() as own:
            log.warning("inner")
            assert own == ["inner"]

    with collecting_warnings() as warnings:
        thread = threading.Thread(target=inside)
        thread.start()
        thread.join()
        log.warning("outer")
        inside()
    assert warnings == ["outer"]
