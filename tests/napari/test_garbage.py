"""When Python collects garbage while jobs run and layers come."""

import gc
import weakref

import pytest
from qtpy.QtGui import QCursor

from voxflat._napari.garbage import _PutOff, put_off_collections

pytestmark = pytest.mark.slow  # a window


class Circle:
    """Garbage that only a collection finds."""

    def __init__(self):
        self.own = self


@pytest.fixture
def usual(qapp, monkeypatch):
    """The thresholds of before; the mouse rests."""
    if gc.get_threshold()[2] == 0:
        pytest.skip("this Python collects in small steps")
    monkeypatch.setattr(QCursor, "pos", lambda: (0, 0))
    monkeypatch.setattr(gc, "get_count", lambda: (0, 3, 999))  # nothing is made, and there is enough
    if _PutOff.one is not None:  # of a test before
        _PutOff.one._end()
    yield gc.get_threshold()
    if _PutOff.one is not None:
        _PutOff.one._end()


def old_garbage():
    """Return what tells whether garbage that survived two collections of what is young is there."""
    circle = Circle()
    gc.collect(1)
    gc.collect(1)
    return weakref.ref(circle)


def test_a_full_collection_waits_for_rest(usual):
    put_off_collections()
    assert gc.get_threshold()[:2] == usual[:2]
    assert gc.get_threshold()[2] > usual[2]
    garbage = old_garbage()
    _PutOff.one.look()  # where the mouse is
    assert garbage() is not None
    _PutOff.one.look()  # and it has not moved since
    assert garbage() is None
    assert _PutOff.one is None
    assert gc.get_threshold() == usual


def test_it_waits_for_jobs_and_the_mouse_but_not_for_ever(usual, monkeypatch):
    places = iter(range(1, 1000))
    put_off_collections()
    garbage = old_garbage()
    for _ in range(30):
        put_off_collections()  # as a job does, many times between two looks
        _PutOff.one.look()
    assert garbage() is not None
    monkeypatch.setattr(QCursor, "pos", lambda: (next(places), 0))
    for _ in range(8):
        _PutOff.one.look()
    put_off_collections()  # layers come: it begins anew
    for _ in range(9):
        _PutOff.one.look()
    assert garbage() is not None
    _PutOff.one.look()
    assert garbage() is not None  # who moves the mouse is not disturbed
    assert _PutOff.one is None
    assert gc.get_threshold() == usual  # Python does as it did


def test_what_others_said_stays(usual):
    gc.disable()
    try:
        put_off_collections()
        assert _PutOff.one is None
    finally:
        gc.enable()
    put_off_collections()
    others = (usual[0] + 1, *usual[1:])
    gc.set_threshold(*others)
    try:
        _PutOff.one._end()
        assert gc.get_threshold() == others
    finally:
        gc.set_threshold(*usual)


def test_who_asks_gets_it_at_once(usual):
    put_off_collections()
    garbage = old_garbage()
    gc.collect()
    assert garbage() is None
