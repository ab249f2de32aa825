"""Temporary files of killed processes disappear when voxflat writes again; those that may be in use stay."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import voxflat
from voxflat.io.files import atomic_directory, atomic_path

pytestmark = pytest.mark.slow  # starts programs

WRITE = """
import sys
from voxflat.io.files import atomic_directory, atomic_path

with {function}({path!r}) as temporary:
    with ({part}).open("wb") as file:
        file.write(bytes(1000))
        file.flush()
        print(temporary.name, flush=True)
        sys.stdin.readline()
"""


def writing(path, *, function="atomic_path", part="temporary"):
    """Start a process that is in the middle of writing `path`; return it and its temporary file."""
    code = WRITE.format(function=function, path=os.fspath(path), part=part)
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    process = subprocess.Popen([sys.executable, "-c", code], text=True, **pipes)
    return process, path.with_name(process.stdout.readline().strip())


def kill(process):
    process.kill()  # SIGKILL
    process.communicate()


def killed(path, **how):
    """Kill a process while it writes `path`; return what is left of it."""
    process, temporary = writing(path, **how)
    kill(process)
    assert temporary.exists()
    return temporary


def test_files_of_a_killed_process_go_when_the_output_is_written_again(tmp_path):
    path = tmp_path / ("a" * 245 + ".txt")
    left = killed(path)
    with atomic_path(path) as temporary:
        temporary.write_text("whole")
        assert not left.exists()
    assert list(tmp_path.iterdir()) == [path]
    assert path.read_text() == "whole"


def test_folders_of_a_killed_process_go_when_the_output_is_written_again(tmp_path):
    path = tmp_path / "a.zarr"
    killed(path, function="atomic_directory", part="(temporary / '0').mkdir() or temporary / '0' / 'c'")
    with atomic_directory(path):
        pass
    assert list(tmp_path.iterdir()) == [path]


def test_images_and_distance_stores_take_the_place_of_what_killed_processes_left(tmp_path):
    pytest.importorskip("zarr")
    hill = voxflat.samples.hill()
    killed(tmp_path / "image.zarr", function="atomic_directory", part="temporary / '0'")
    hill.flatten().images(np.ones((len(hill), 2))).save(tmp_path / "image.zarr")
    assert [path.name for path in tmp_path.iterdir()] == ["image.zarr"]
    killed(tmp_path / "store", function="atomic_directory", part="temporary / '0'")
    hill.geodesic(sources=5, store=tmp_path / "store")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["image.zarr", "store"]


def test_files_of_a_running_process_stay_until_it_has_written_them(tmp_path):
    path = tmp_path / "a.txt"
    process, temporary = writing(path)
    with atomic_path(path) as own, atomic_path(path):
        own.write_text("whole")
        assert temporary.exists()
        assert own.exists()
    process.communicate("\n")
    assert process.returncode == 0
    assert path.read_bytes() == bytes(1000)


def test_files_of_another_system_or_another_program_stay(tmp_path):
    left = killed(tmp_path / "a.txt")
    system = re.match(r"\.voxflat-([0-9a-f]{8})-", left.name)[1]
    other = f"{int(system, 16) ^ 1:08x}"
    names = [left.name.replace(system, other), left.name.replace("voxflat", "another"), ".a.txt", ".voxflat-notes"]
    for name in names:
        (tmp_path / name).touch()
    with atomic_path(tmp_path / "a.txt"):
        assert not left.exists()
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*names, "a.txt"])


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="only Linux tells when a process started")
def test_the_number_of_a_killed_process_may_be_given_to_another_one(tmp_path):
    left = killed(tmp_path / "a.txt")
    _, system, _, start, random = left.name.split(".")[1].split("-")
    reused = tmp_path / f".voxflat-{system}-{os.getpid()}-{int(start) - 1}-{random}.a.txt"
    left.rename(reused)
    with atomic_path(tmp_path / "a.txt"):
        assert not reused.exists()
