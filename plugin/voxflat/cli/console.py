"""Show errors, progress, notes and warnings in the terminal."""

from __future__ import annotations

import atexit
import ctypes
import importlib
import io
import json
import logging
import os
import platform
import re
import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, ClassVar, TextIO

import click
import cloup

from voxflat.errors import Cancelled, user_message
from voxflat.wording import in_words

if TYPE_CHECKING:
    from voxflat.arguments import Progress

CANCELLED, TERMINATED = 130, 143  # exit statuses of programs ended by SIGINT and SIGTERM
_ARENA_MAX = -8  # M_ARENA_MAX of glibc's malloc.h


class Program(cloup.Group):
    """Command group that reports every error as one line on stderr and, with ``--json``, as a JSON object."""

    def __init__(self, *arguments: Any, **more: Any) -> None:
        super().__init__(*arguments, **more)
        self.modules: dict[str, str] = {}  # the module in `voxflat.cli.commands` that defines each command

    def main(self, args: Sequence[str] | None = None, *further: Any, **more: Any) -> Any:
        """Run the program and exit."""
        arguments = list(sys.argv[1:] if args is None else args)
        try:
            status = self._status(arguments, *further, **more)
        except KeyboardInterrupt:  # raised while the outcome is being printed
            status = CANCELLED
        atexit.unregister(_ignore_interrupts)
        atexit.register(_ignore_interrupts)
        sys.exit(status)

    def _status(self, arguments: list[str], *further: Any, **more: Any) -> int:
        more["standalone_mode"] = False  # click raises its errors instead of printing them
        _replace_closed_files()
        _share_one_heap()
        try:
            with _sigterm_as_interrupt():
                status = super().main(arguments, *further, **more)
        except click.ClickException as error:
            _ignoring_errors(error.show)
            status = _failed(arguments, error.format_message(), error.exit_code)
        except (Cancelled, click.Abort) as error:
            manner = "terminated" if isinstance(error.__cause__, _Terminated) else "cancelled"
            _print(f"voxflat: {manner}")
            status = _failed(arguments, manner, TERMINATED if manner == "terminated" else CANCELLED)
        except Exception as error:
            if "--debug" in arguments:
                _print(traceback.format_exc().rstrip())
            text = in_options(user_message(error), self._named(arguments), self)
            _print(f"voxflat: error: {text}")
            status = _failed(arguments, text, 1)
        return status if isinstance(status, int) else 0

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command; until then, `commands` contains only its name and summary."""
        if cmd_name not in self.commands:
            return None
        module = importlib.import_module(f"voxflat.cli.commands.{self.modules[cmd_name]}")
        command: click.Command = getattr(module, f"{cmd_name.replace('-', '_')}_command")
        for parser in (command, *(command.commands.values() if isinstance(command, Group) else ())):
            parser.context_settings = {**self.context_settings, **parser.context_settings}  # accept -h everywhere
        self.commands[cmd_name] = command
        return command

    def _named(self, arguments: list[str]) -> click.Command | None:
        """Return the command, or the command of a group, that arguments name."""
        name, second = [*arguments, "", ""][:2]
        command = self.commands.get(name)
        return command.commands.get(second, command) if isinstance(command, Group) else command

    def flags(self) -> dict[str, str]:
        """Return the options of all commands, which are imported for this, by their names in Python."""
        commands = [self.get_command(click.Context(self), name) for name in list(self.commands)]
        return {name: flag for command in commands if command for name, flag in _flags(command).items()}

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as stop:
            raise Cancelled("cancelled") from stop


class Command(cloup.Command):
    """Command that refuses an option that is given twice, unless all its values are used."""

    synonyms: ClassVar[dict[str, str]] = {}  # names of options, by words that users may try instead

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the arguments; click itself would use the last value of a repeated option, without a word."""
        try:
            if not ctx.resilient_parsing:
                _, _, order = self.make_parser(ctx).parse_args(args=list(args))
                for number, parameter in enumerate(order):
                    if isinstance(parameter, click.Option) and not parameter.multiple and parameter in order[:number]:
                        raise click.UsageError(f"{parameter.opts[-1]} is given twice. Pass it once.", ctx)
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            raise self._no_such(error.option_name, ctx) from None

    def _no_such(self, name: str, ctx: click.Context) -> click.UsageError:
        """Return the error that an option does not exist, with similar ones; dashes do not make names similar."""
        bare = name.lstrip("-")
        flags = {flag.lstrip("-"): item.opts[0] for item in self.params for flag in item.opts if flag.startswith("--")}
        names = [self.synonyms[bare]] if bare in self.synonyms else get_close_matches(bare, flags)
        near = dict.fromkeys(flags[like] for like in names if like in flags)
        hint = f"Did you mean {' or '.join(near)}?" if near else f'See "{ctx.command_path} --help".'
        return click.UsageError(f"No such option: {name}. {hint}", ctx)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command, and print its notes and warnings."""
        with _notes(bool(ctx.params.get("quiet"))):
            return super().invoke(ctx)


class Group(cloup.Group):
    """Command with commands of its own."""


def _ignore_interrupts() -> None:
    """Ignore Ctrl-C when the work is done, because it would interrupt Python's clean-up with a traceback."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)


class _Terminated(KeyboardInterrupt):
    """Exception for SIGTERM, which is handled like Ctrl-C."""


@contextmanager
def _sigterm_as_interrupt() -> Iterator[None]:
    """Treat SIGTERM like Ctrl-C, so that temporary files are removed."""
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


def _share_one_heap() -> None:
    """Let threads share one heap if address space is limited, because glibc reserves 64 MiB for each thread's heap.

    This changes the process, so only the program does it, and never the library.
    """
    if sys.platform != "linux":
        return
    import resource

    is_limited = resource.getrlimit(resource.RLIMIT_AS)[0] != resource.RLIM_INFINITY
    if is_limited and platform.libc_ver()[0] == "glibc":
        ctypes.CDLL(None).mallopt(_ARENA_MAX, 1)


def _replace_closed_files() -> None:
    """Replace closed standard streams, or output files would get their descriptors; escape unprintable characters."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free descriptor, which is this one
    sys.stdout = sys.stdout or _null_stream()
    sys.stderr = sys.stderr or _null_stream()
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
        sys.stdout.reconfigure(errors="backslashreplace")  # as stderr does: pipes of Windows have no Greek letters


def _null_stream() -> TextIO:
    return open(os.devnull, "w", encoding="utf-8", newline="\n")


def _failed(arguments: list[str], text: str, status: int) -> int:
    """Return the exit status; with ``--json``, also print the error as a JSON object on stdout."""
    if "--json" in arguments:
        with suppress(OSError):
            click.echo(json.dumps({"error": text, "exit_code": status}))
    return status


def _print(text: str) -> None:
    """Print a line on stderr."""
    _ignoring_errors(lambda: click.echo(text, err=True))


def _ignoring_errors(show: Callable[[], None]) -> None:
    """Write to stderr, and ignore failures to do so, so that the result is not lost."""
    try:
        show()
    except (OSError, ValueError):  # the disk is full, or the stream is closed
        sys.stderr = _null_stream()  # or Python would fail when it flushes stderr at exit


class _Stderr:
    """Stderr stream that ignores failures to write."""

    def write(self, text: str) -> None:
        _ignoring_errors(lambda: print(end=text, file=sys.stderr, flush=True))

    def flush(self) -> None:
        _ignoring_errors(sys.stderr.flush)

    def __getattr__(self, name: str) -> Any:
        return getattr(sys.stderr, name)


_STDERR = _Stderr()


class Bars:
    """Progress bars on stderr, one for each stage, which disappear when the stage is finished."""

    def __init__(self, hidden: bool) -> None:
        from tqdm import tqdm

        # one bar is reused for all stages, so that there is always a bar to close when Ctrl-C is pressed
        look: dict[str, Any] = {"bar_format": "{l_bar}{bar}| {elapsed}<{remaining}", "dynamic_ncols": True}
        self._bar = tqdm(desc="reading", total=1, leave=False, file=_STDERR, disable=hidden, **look)
        self._stage = ""
        self.progress: Progress | None = None if hidden else self._show
        self.close = self._bar.close

    def _show(self, stage: str, done: int, total: int) -> None:
        if stage != self._stage:
            self._stage = stage
            self._bar.set_description(stage, refresh=False)
            self._bar.reset(total)
        self._bar.update(done - self._bar.n)

    def tell(self, text: str, *, err: bool = False) -> None:
        """Hide the bar and print a line on stdout or stderr."""
        self.hide()
        click.echo(text, err=err)

    def hide(self) -> None:
        """Hide the bar until its next update."""
        self._bar.clear()


_GIVEN = r" (?:is|are|cannot|do|does|has|have|must|requires?)\b"  # follows the names of arguments
_ALSO = r"(?:,? and |,? or |, | without | is given without )"  # between the names of arguments
_COMMANDS = {  # instead of functions of Python
    r"voxflat\.worst_places": "`voxflat worst`",
    r"voxflat\.compare": "`voxflat measure`",
    r"(?:use|with) voxflat\.rim": "pass --rim",
    r"with voxflat\.hemisphere": "with --hemisphere",
    r", as in voxflat\.io\.read_volume\(path, channel=0\)": " with --channel",
    r"Read it with voxflat\.load\b(?!_)": "Pass maps of several frames, made by `voxflat movie-map`",
    r", or read them with voxflat\.load_series": "",
    r", or pass the values as an array to use them anyway": "",
}


def _flags(command: click.Command) -> dict[str, str]:
    """Return the options of a command by their names in Python and by their own."""
    options = [parameter for parameter in command.params if isinstance(parameter, click.Option)]
    long = [(parameter.name, flag) for parameter in options for flag in parameter.opts[::-1] if flag.startswith("--")]
    return {name: flag for own, flag in long for name in (str(own), flag[2:].replace("-", "_"))}


def in_options(text: str, command: click.Command | None, program: Program | None = None) -> str:
    """Return a message with Python arguments, such as relax=False, replaced by command options, such as --no-relax.

    A name with a value, also of another command of the program, or with an underscore is an argument. Another name may
    be an ordinary word. It is replaced if it stands beside another option, if a sentence begins with it and a verb, or
    if the message asks to pass or omit it.
    """
    if command is None:
        return text
    flags = _flags(command)

    def option(name: str, value: str | None, original: str) -> str:
        if value is None:
            return flags[name] if name in flags and "_" in name else original
        flag = flags.get(name) or (program.flags().get(name) if program else None)
        if flag is None:
            return original
        if value in ("False", "True"):
            return flag.replace("--", "--no-", 1) if value == "False" else flag
        return f"{flag} {_as_words(value)}".rstrip()

    text = in_words(text, _COMMANDS, option)
    if "rim_channel" in flags:  # --channel is that of another volume, which has other messages
        text = text.replace(" with --channel", " with --rim-channel")
    words = "|".join(sorted(name for name, flag in flags.items() if flag == f"--{name}" and "_" not in name))
    word = rf"(?:--[\w-]+|(?:{words})\b(?![/=(-]))"

    def listed(match: re.Match[str]) -> str:
        before, after = match.string[: match.start()], match.string[match.end() :]
        is_list = "--" in match[0] and re.match(r"[,.;:]|$| (?:is|are|requires?|cannot|do|does)\b", after)
        is_given = re.search(r"(?:^|[.:;] )$", before) and re.match(_GIVEN, after)
        is_named = re.search(r"\b(?:[Pp]ass|[Oo]mit) $", before) and re.match(r"[.,]|$", after)
        if not (is_list or is_given or is_named) or re.search(
            r"--[\w-]+ $", before
        ):  # this one: the value of an option
            return match[0]
        return re.sub(rf"(?<![\w-])(?:{words})(?![\w-])", r"--\g<0>", match[0])

    return re.sub(rf"(?<![\w'=./-]){word}(?:{_ALSO}{word})*", listed, text) if words else text


def _as_words(value: str) -> str:
    """Return a value of Python as it is written on the command line."""
    return value.strip("'[]().").replace(", ", ",")


def translated(text: str) -> str:
    """Return a message with the options of the command that is running."""
    context = click.get_current_context(silent=True)
    if context is None:
        return text
    program = context.find_root().command
    return in_options(text, context.command, program if isinstance(program, Program) else None)


class _Notes(logging.Handler):
    """Print notes and warnings on stderr, above the progress bars, each of them once."""

    def __init__(self) -> None:
        super().__init__()
        self._told: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        kind = "warning: " if record.levelno >= logging.WARNING else ""
        package = "" if record.name.split(".")[0] == "voxflat" else f"{record.name.split('.')[0]}: "
        self.tell(f"voxflat: {kind}{package}{translated(record.getMessage())}")

    def warn(self, message: Warning | str, _category: object, file: str, *_: object) -> None:
        """Print a warning of Python, which names the package that issued it instead of its line."""
        package = next((name for name, module in list(sys.modules.items()) if _file_of(module) == file), "")
        prefix = f"{package.split('.')[0]}: " if package.split(".")[0] not in ("", "voxflat", "__main__") else ""
        self.tell(f"voxflat: warning: {prefix}{translated(' '.join(str(message).split()))}")

    def tell(self, text: str) -> None:
        from tqdm import tqdm

        if text not in self._told:
            self._told.add(text)
            tqdm.write(text, file=_STDERR)


def _file_of(module: object) -> str | None:
    return getattr(module, "__file__", None)


@contextmanager
def _notes(quiet: bool) -> Iterator[None]:
    """Print the messages and warnings of the package and other libraries while a command runs, unless `quiet`."""
    notes, foreign = _Notes(), _Notes()
    foreign.addFilter(lambda record: record.name.split(".")[0] != "voxflat")
    log = logging.getLogger("voxflat")
    level = log.level
    handlers = {log: logging.NullHandler() if quiet else notes}
    handlers[logging.getLogger()] = logging.NullHandler() if quiet else foreign
    for logger, handler in handlers.items():
        logger.addHandler(handler)
    log.setLevel(logging.INFO)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _ignore if quiet else notes.warn  # type: ignore[assignment]
            yield
    finally:
        log.setLevel(level)
        for logger, handler in handlers.items():
            logger.removeHandler(handler)


def _ignore(*_: object) -> None:
    pass


@contextmanager
def bars(quiet: bool = False, *, notes: bool = True) -> Iterator[Bars]:
    """Show progress while a command runs; without `notes`, messages of the package are not printed meanwhile."""
    log = logging.getLogger("voxflat")
    bar = Bars(hidden=quiet or not sys.stderr.isatty())
    silenced = [] if notes else [handler for handler in log.handlers if isinstance(handler, _Notes)]
    nothing = logging.NullHandler()
    log.addHandler(nothing)  # or Python would print warnings itself
    for entry in silenced:
        log.removeHandler(entry)
    try:
        yield bar
    finally:
        for entry in silenced:
            log.addHandler(entry)
        log.removeHandler(nothing)
        bar.close()
