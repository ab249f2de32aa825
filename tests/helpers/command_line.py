"""The command line, in this process."""

import inspect

from click.testing import CliRunner

from voxflat import cli

APART = {"mix_stderr": False} if "mix_stderr" in inspect.signature(CliRunner).parameters else {}  # click before 8.2


def run(*words):
    """Return what a command made of its words: `exit_code`, `output`, `stdout`, `stderr`."""
    return CliRunner(**APART).invoke(cli.main, [str(word) for word in words], prog_name="voxflat")


def succeed(*words):
    """Run a command that must succeed."""
    result = run(*words)
    assert result.exit_code == 0, result.output
    return result


def fail(status, told, *words):
    """Run a command that must end with this status and say this, other than as its result."""
    result = run(*words)
    assert result.exit_code == status, result.output
    assert told in result.stderr
    return result
