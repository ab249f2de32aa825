"""Show the warnings that voxflat logs as notifications of napari."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from napari.utils.notifications import show_warning

from voxflat._napari.wording import in_window, sentence
from voxflat.arguments import noting


def show_notes(notes: Iterable[str]) -> None:
    for note in dict.fromkeys(notes):
        show_warning(sentence(in_window(note)))


@contextmanager
def showing_notes() -> Iterator[None]:
    """Show the warnings that are logged in this context, which belongs to the GUI thread."""
    with noting() as notes:
        try:
            yield
        finally:
            show_notes(notes)
