"""The terminal: how errors, progress and notes are shown."""

import atexit
import json
import logging
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, TextIO

import click
import cloup
from tqdm import tqdm

from voxflat.arguments import Progress, log
from voxflat.errors import Cancelled, told

CANCELLED, TERMINATED = 130, 143  # as of programs that SIGINT and SIGTERM ended


class Program(cloup.Group):
    """A group of commands that turns whatever goes wrong into one line on stderr, or one JSON object, and a status.

    1 for an input that cannot be used and work that failed, 2 for wrong usage, 130 where the user stopped it.
    """

    def main(self, args: Sequence[str] | None = None, *further: Any, **more: Any) -> Any:
        """Run the program."""
        arguments = list(sys.argv[1:] if args is None else args)
        try:
            status = self._status(arguments, *further, **more)
        except KeyboardInterrupt:  # while the end was told
            status = CANCELLED
        atexit.unregister(_let_it_end)
        atexit.register(_let_it_end)
        sys.exit(status)

    def _status(self, arguments: list[str], *further: Any, **more: Any) -> int:
        more["standalone_mode"] = False  # errors are shown here
        _hold_standard_files()
        try:
            with _terminable():
                status = super().main(arguments, *further, **more)
        except click.ClickException as error:
            _showing(error.show)
            status = _failed(arguments, error.format_message(), error.exit_code)
        except (Cancelled, click.Abort) as error:
            how = "terminated" if isinstance(error.__cause__, _Terminated) else "cancelled"
            _say(f"voxflat: {how}")
            status = _failed(arguments, how, TERMINATED if how == "terminated" else CANCELLED)
        except Exception as error:
            if "--debug" in arguments:
                _say(traceback.format_exc().rstrip())
            text = told(error)
            _say(f"voxflat: error: {text}")
            status = _failed(arguments, text, 1, getattr(error, "remedy", ""))
        return status if isinstance(status, int) else 0

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as stop:
            raise Cancelled("cancelled") from stop


def _let_it_end() -> None:
    """Take no Ctrl-C any more: all is done, and what Python tidies up would be broken off with a traceback."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)


class _Terminated(KeyboardInterrupt):
    """SIGTERM came: all that Ctrl-C tidies up is tidied up, too."""


@contextmanager
def _terminable() -> Iterator[None]:
    """Take SIGTERM as Ctrl-C, so that no temporary file is left."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(*_: object) -> None:
        raise _Terminated

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before or signal.SIG_DFL)


def _hold_standard_files() -> None:
    """Put something in place of standard files that are closed, whose numbers a result's file would get otherwise."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest number that is free: this one
    sys.stdout = sys.stdout or _nowhere()
    sys.stderr = sys.stderr or _nowhere()


def _nowhere() -> TextIO:
    return open(os.devnull, "w")


def _failed(arguments: list[str], text: str, status: int, remedy: str = "") -> int:
    """Return the exit status; with ``--json`` what went wrong is the object on stdout, too."""
    if "--json" in arguments:
        with suppress(OSError):
            click.echo(json.dumps({"error": text, "remedy": remedy or None, "exit_code": status}))
    return status


def _say(text: str) -> None:
    """Print a line on stderr."""
    _showing(lambda: click.echo(text, err=True))


def _showing(show: Callable[[], None]) -> None:
    """Show something on stderr, if that takes it: what is told there is never worth a result."""
    try:
        show()
    except (OSError, ValueError):  # it is full, or closed
        sys.stderr = _nowhere()  # or Python's own end would fail, too


class _Stderr:
    """Stderr, but what it does not take is left out."""

    def write(self, text: str) -> None:
        _showing(lambda: print(end=text, file=sys.stderr))

    def flush(self) -> None:
        _showing(sys.stderr.flush)

    def __getattr__(self, name: str) -> Any:
        return getattr(sys.stderr, name)


_STDERR = _Stderr()


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
            file=_STDERR,
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
        self.hide()
        click.echo(text)

    def hide(self) -> None:
        """Take the bar away until it moves on."""
        self._bar.clear()


class _Notes(logging.Handler):
    """Print what the package logs, the memory that it needs and warnings, on stderr above the bars."""

    def emit(self, record: logging.LogRecord) -> None:
        kind = "warning: " if record.levelno >= logging.WARNING else ""
        tqdm.write(f"voxflat: {kind}{record.getMessage()}", file=_STDERR)


@contextmanager
def bars(quiet: bool = False, *, hushed: bool = False) -> Iterator[Bars]:
    """Show progress and notes while a command works; not where it is to be quiet, and no notes that stand elsewhere."""
    shown = Bars(hidden=quiet or not sys.stderr.isatty())
    notes = logging.NullHandler() if quiet or hushed else _Notes()
    level = log.level
    log.addHandler(notes)
    log.setLevel(logging.INFO)
    try:
        yield shown
    finally:
        log.removeHandler(notes)
        log.setLevel(level)
        shown.close()
