"""Helpers of the tests of `voxflat.lab`: the files of a folder, and Chromium."""

import base64
import json
import shutil
import subprocess
import zlib
from contextlib import suppress

import numpy as np
import pytest

VERTICES, FEW = 642, 162


def everything(folder):
    """Return the content and the modification time of each file."""
    files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    return {str(path.relative_to(folder)): (path.read_bytes(), path.stat().st_mtime_ns) for path in files}


def scene_of(text):
    """Decode the scene of a page: its description, its arrays by name, and its triangles."""
    content = json.loads(text)
    data, arrays, at = zlib.decompress(base64.b64decode(content["data"])), {}, 0
    for array in content["arrays"]:
        coded = np.frombuffer(data, "<u2", array["length"], at)
        if "known" in array:  # whole numbers
            values = np.array([*array["known"], np.nan])[np.minimum(coded, len(array["known"]))]
        else:
            values = np.where(coded == 65535, np.nan, array["low"] + array["step"] * coded)
        arrays[array["name"]] = values
        at += 2 * array["length"]
    faces = np.frombuffer(data, "<u4", offset=at).reshape(-1, 3)
    assert len(faces) == content["triangles"]
    return content, arrays, faces


def drawn_with(script, text, folder):
    """Return the elements of a page after it has run a script; its console must stay empty."""
    page = folder / "page.html"
    page.write_text(text.replace("</body>", f"<script>setTimeout(() => {{{script}}}, 4000);</script></body>"))
    said, drawn = console_of(page, "--window-size=1280,900")
    assert said == []
    return drawn


def console_of(page, *options):
    """Return the console messages of a page in headless Chromium, and its elements once it is drawn."""
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    if program is None:
        pytest.skip("Chromium is not installed")
    command = [program, "--headless", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    command += ["--enable-logging=stderr", "--virtual-time-budget=8000", "--dump-dom", *options]
    command.append(page.resolve().as_uri())
    for _ in range(3):  # without a graphics card, it sometimes hangs on a busy machine
        with suppress(subprocess.TimeoutExpired):
            done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
            return [line for line in done.stderr.splitlines() if "CONSOLE" in line], done.stdout
    return pytest.fail("Chromium did not finish within a minute, three times")
