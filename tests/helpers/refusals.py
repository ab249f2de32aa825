"""Checks of errors and warnings."""

import warnings
from contextlib import contextmanager

import pytest

from voxflat.errors import InputError


def refused(message, call, *arguments, **options):
    """Check that a call raises InputError with a one-line message that matches."""
    with pytest.raises(InputError, match=message) as caught:
        call(*arguments, **options)
    assert "\n" not in str(caught.value)


@contextmanager
def warnings_as_errors():
    with warnings.catch_warnings():  # takes an action itself from Python 3.11
        warnings.simplefilter("error")
        yield
