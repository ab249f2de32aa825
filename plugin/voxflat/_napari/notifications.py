"""Show the warnings that voxflat logs as notifications of napari."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from napari.utils.notifications import show_warning

from voxflat._napari.wording import in_window, sentence
from voxflat.arguments import collecting_warnings


def show_warnings(warnings: Iterable[str]) -> None:
    for warning in dict.fromkeys(warnings):
        show_warning(sentence(in_window(warning)))


@contextmanager
def showing_warnings() -> Iterator[None]:
    """Show the warnings that are logged in this context, which belongs to the GUI thread."""
    with collecting_warnings() as warnings:
        try:
            yield
        finally:
            show_warnings(warnings)
