"""Only one process at a time writes the results of a participant; the others wait."""

import subprocess
import sys

import pytest

from voxflat.io.locks import locked

pytestmark = pytest.mark.slow  # starts processes

ADD = """
import sys, time
from pathlib import Path
from voxflat.io.locks import locked
path = Path(sys.argv[1])
for _ in range(20):
    with locked(path.with_name(".lock"), lambda: None):
        count = int(path.read_text())
        time.sleep(0)  # lets another process run
        path.write_text(str(count + 1))
"""
HOLD = """
import sys
from pathlib import Path
from voxflat.io.locks import locked
with locked(Path(sys.argv[1]), lambda: None):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_processes_take_turns_and_leave_no_lock(tmp_path):
    path = tmp_path / "count"
    path.write_text("0")
    processes = [subprocess.Popen([sys.executable, "-c", ADD, path]) for _ in range(3)]
    assert [one.wait() for one in processes] == [0, 0, 0]
    assert path.read_text() == "60"
    assert [one.name for one in tmp_path.iterdir()] == ["count"]


def test_the_lock_of_a_killed_process_is_free_and_waiting_is_told_once(tmp_path):
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", HOLD, tmp_path / ".lock"], **pipes) as process:
        assert process.stdout.readline() == "held\n"
        calls = []

        def tell():
            calls.append(process.poll())
            process.kill()

        with locked(tmp_path / ".lock", tell):
            assert calls == [None]  # it held the lock until it was killed
    assert not list(tmp_path.iterdir())


def test_where_nothing_can_be_written_the_block_reports_it(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(NotADirectoryError), locked(tmp_path / "file" / ".lock", lambda: None):
        (tmp_path / "file" / "result").touch()
