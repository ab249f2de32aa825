"""Checks of errors and warnings."""

import warnings
from contextlib import contextmanager

import pytest

from voxflat.errors import Cancelled, InputError


def refused(message, call, *arguments, **options):
    """Check that a call raises InputError with a one-line message that matches."""
    with pytest.raises(InputError, match=message) as caught:
        call(*arguments, **options)
    assert "\n" not in str(caught.value)


def writes_nothing_half(save, path, count):
    """Check that writing `count` images, cancelled at the second one, leaves no file."""
    seen = []

    def progress(*told):
        seen.append(told)
        return len(seen) < 2

    with pytest.raises(Cancelled, match=f"cancelled while writing {path.name}"):
        save(path, progress=progress)
    assert seen == [(f"writing {path.name}", 1, count), (f"writing {path.name}", 2, count)]
    assert list(path.parent.iterdir()) == []


@contextmanager
def warnings_as_errors():
    with warnings.catch_warnings():  # takes an action itself from Python 3.11
        warnings.simplefilter("error")
        yield
