"""What is refused, and how it is told."""

import warnings
from contextlib import contextmanager

import pytest

from voxflat.errors import InputError


def refused(message, call, *arguments, **options):
    """A call raises InputError, which is told in one line that matches."""
    with pytest.raises(InputError, match=message) as caught:
        call(*arguments, **options)
    assert "\n" not in str(caught.value)


@contextmanager
def warnings_as_errors():
    """Each warning is an error in this block."""
    with warnings.catch_warnings():  # takes an action itself from Python 3.11
        warnings.simplefilter("error")
        yield
