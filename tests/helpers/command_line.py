"""Run the command line in this process."""

import inspect

import click
from click.testing import CliRunner

from voxflat import cli

APART = {"mix_stderr": False} if "mix_stderr" in inspect.signature(CliRunner).parameters else {}  # click before 8.2


def every_command():
    """Return all commands by the words that call them, such as ("bench", "list") for one of a group."""
    found = {}
    for name in sorted(cli.main.commands):
        command = cli.main.get_command(click.Context(cli.main), name)
        of_group = getattr(command, "commands", None)
        found |= {(name, one): of_group[one] for one in of_group} if of_group else {(name,): command}
    return found


def run(*words):
    return CliRunner(**APART).invoke(cli.main, [str(word) for word in words], prog_name="voxflat")


def succeed(*words):
    result = run(*words)
    assert result.exit_code == 0, result.output
    return result


def fail(status, told, *words):
    """Run a command that must end with this status and write this text to stderr."""
    result = run(*words)
    assert result.exit_code == status, result.output
    assert told in result.stderr
    return result
