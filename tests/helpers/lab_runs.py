"""What the tests of `voxflat.lab` share: the command line, a folder's files, and Chromium."""

import shutil
import subprocess
from contextlib import suppress

import pytest
from click.testing import CliRunner

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
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    if program is None:
        pytest.skip("there is no chromium")
    command = [program, "--headless", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    command += ["--enable-logging=stderr", "--virtual-time-budget=8000", *options, "--dump-dom", page.as_uri()]
    for _ in range(3):  # without a graphics card it stops for good now and then on a busy machine
        with suppress(subprocess.TimeoutExpired):
            done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
            return [line for line in done.stderr.splitlines() if "CONSOLE" in line], done.stdout
    raise AssertionError(f"it does not end: {command}")
