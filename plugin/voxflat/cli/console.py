"""The terminal: how errors, progress and notes are shown."""

from __future__ import annotations

import logging
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import click
from tqdm import tqdm

from voxflat.arguments import Progress, log
from voxflat.errors import Cancelled, VoxflatError

__all__ = ["DEBUG", "Bars", "Failure", "Program", "bars"]

DEBUG = "voxflat.debug"
"""Under this key of a command's context stands whether tracebacks are shown."""


class Failure(click.ClickException):
    """Ends the program with one line on stderr and exit status 1."""

    def show(self, file: Any = None) -> None:
        """Write the line."""
        click.echo(f"voxflat: {self.message}", file=file, err=True)


class Program(click.Group):
    """A group of commands that turns whatever goes wrong into a `Failure`."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command."""
        try:
            return super().invoke(ctx)
        except (click.ClickException, click.exceptions.Exit, click.Abort, BrokenPipeError):
            raise  # click deals with these
        except (KeyboardInterrupt, Cancelled):
            raise Failure("cancelled") from None
        except Exception as error:
            if ctx.meta.get(DEBUG):
                traceback.print_exc()
            raise Failure(f"error: {_one_line(error)}") from error


def _one_line(error: Exception) -> str:
    if isinstance(error, VoxflatError):
        text = str(error)
    elif isinstance(error, MemoryError):
        text = "memory ran out; take a smaller patch or fewer sources"
    elif isinstance(error, OSError) and error.strerror:
        text = f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    else:
        text = f"{type(error).__name__}: {error} (not foreseen: please report it with the output of --debug)"
    return " ".join(text.split())


class Bars:
    """Progress on stderr, one bar a stage; it disappears when its stage is over."""

    def __init__(self, hidden: bool) -> None:
        # one object from the start, so that there is always one to close, wherever Ctrl-C strikes
        self._bar = tqdm(
            desc="reading",
            total=1,
            bar_format="{l_bar}{bar}| {elapsed}<{remaining}",
            leave=False,
            dynamic_ncols=True,
            file=sys.stderr,
            disable=hidden,
        )
        self._stage = ""
        self.progress: Progress | None = None if hidden else self._show
        self.close = self._bar.close

    def _show(self, stage: str, done: int, total: int) -> None:
        if stage != self._stage:
            self._stage = stage
            self._bar.set_description(stage, refresh=False)
            self._bar.reset(total)
        self._bar.update(done - self._bar.n)

    def tell(self, text: str) -> None:
        """Print a line where no bar is."""
        self._bar.clear()
        click.echo(text)


class _Notes(logging.Handler):
    """Print what the package logs, the memory that it needs and warnings, on stderr above the bars."""

    def emit(self, record: logging.LogRecord) -> None:
        kind = "warning: " if record.levelno >= logging.WARNING else ""
        tqdm.write(f"voxflat: {kind}{record.getMessage()}", file=sys.stderr)


@contextmanager
def bars(quiet: bool = False) -> Iterator[Bars]:
    """Show progress and notes while a command works; not where it is to be quiet."""
    shown = Bars(hidden=quiet or not sys.stderr.isatty())
    notes = logging.NullHandler() if quiet else _Notes()
    level = log.level
    log.addHandler(notes)
    log.setLevel(logging.INFO)
    try:
        yield shown
    finally:
        log.removeHandler(notes)
        log.setLevel(level)
        shown.close()
