"""What is refused, and how it is told."""

import pytest

from voxflat.errors import InputError


def refused(message, call, *arguments, **options):
    """A call raises InputError, which is told in one line that matches."""
    with pytest.raises(InputError, match=message) as caught:
        call(*arguments, **options)
    assert "\n" not in str(caught.value)
