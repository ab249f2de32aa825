"""What the tests of `voxflat.lab` share: the command line, a folder's files, and Chromium."""

import pytest
from click.testing import CliRunner
from study import chromium

from voxflat import cli

VERTICES, FEW = 642, 162


def run(*arguments):
    return CliRunner().invoke(cli.main, [str(argument) for argument in arguments], prog_name="voxflat")


def everything(folder):
    """Return what each file holds, and when it was written."""
    files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    return {str(path.relative_to(folder)): (path.read_bytes(), path.stat().st_mtime_ns) for path in files}


def console_of(page, *options):
    """Open a page in headless Chromium; return what it says in its console, and its elements once it is drawn."""
    done = chromium(page, "--virtual-time-budget=8000", *options, "--dump-dom")
    if done is None:
        pytest.skip("there is no chromium")
    return [line for line in done.stderr.splitlines() if "CONSOLE" in line], done.stdout
