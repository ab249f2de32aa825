"""Make a map in a separate process, so that its time and memory are those of one map.

    python -m voxflat.benchmark.making TOOL JOB.npz MADE.npz

makes a map in this process. `make` starts such a process.
"""

import importlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from voxflat.benchmark.tools import TOOLS, Flat, NoMapError
from voxflat.errors import InputError

GIB = 2**30


@dataclass(frozen=True, eq=False)
class Made:
    """A flat map and its costs, without reading the input and importing packages."""

    flat: Flat
    wall: float  # s
    cpu: float  # s, of all threads and of programs that the tool started
    peak: float  # memory of the process at its peak, packages included, GiB
    taken: float  # the same without packages and input, GiB

    @property
    def costs(self) -> dict[str, float]:
        """The costs, rounded for files."""
        return {"wall": round(self.wall, 2), "cpu": round(self.cpu, 2), "peak": round(self.peak, 3)}


def make(tool: str, job: Mapping[str, Any], limit: float) -> Made:
    """Make a map by one of `TOOLS` in a separate process, within `limit` seconds.

    `job` contains ``points`` and ``faces``, or ``labels`` and ``affine``; and ``options`` of the tool.
    """
    with tempfile.TemporaryDirectory() as directory:
        path, made = (Path(directory, name) for name in ("job.npz", "made.npz"))
        given: dict[str, Any] = {**job, "options": json.dumps(job.get("options", {}))}
        np.savez(path, **given)
        _run([sys.executable, "-m", "voxflat.benchmark.making", tool, str(path), str(made)], limit)
        with np.load(made) as found:
            arrays = {name: found[name] for name in ("uv", "faces", "vertices", "points")}
            flat = Flat(**arrays, details=json.loads(str(found["details"])))
            return Made(flat, *(float(found[name]) for name in ("wall", "cpu", "peak", "taken")))


def _run(command: list[str], limit: float) -> None:
    """Run a process and the programs that it starts, and end them all after some time."""
    group: dict[str, Any] = {"start_new_session": True} if os.name == "posix" else {}
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, **group) as process:
        try:
            _, said = process.communicate(timeout=limit)
        except BaseException as error:
            if os.name == "posix":
                os.killpg(process.pid, signal.SIGKILL)
            else:
                process.kill()
            if isinstance(error, subprocess.TimeoutExpired):
                raise NoMapError(f"made no map within {limit:.0f} s") from None
            raise
    if process.returncode:
        lines = said.strip().splitlines()
        raise NoMapError(lines[-1][:300] if lines else f"ended with status {process.returncode}")


def main() -> None:
    """Make the map that the arguments describe."""
    name, path, made = sys.argv[1:]
    tool = TOOLS[name]
    with np.load(path) as file:
        job = {key: file[key] for key in file.files}
    options = json.loads(str(job.pop("options")))
    if tool.module:
        importlib.import_module(tool.module)
    wall, cpu, before = time.perf_counter(), _cpu(), _memory("VmRSS")
    try:
        flat = tool.make(job, options)
    except InputError as error:
        sys.exit(str(error))
    costs: dict[str, Any] = {"wall": time.perf_counter() - wall, "cpu": _cpu() - cpu}
    if not np.isfinite(flat.uv).all():
        sys.exit("the map has positions that are not finite")
    costs |= {"peak": _peak() / GIB, "taken": (_peak() - before) / GIB}
    arrays: dict[str, Any] = {"uv": flat.uv, "faces": flat.faces, "vertices": flat.vertices, "points": flat.points}
    np.savez(made, details=json.dumps(flat.details), **arrays, **costs)


def _cpu() -> float:
    """Return the CPU time of this process and its finished children, s."""
    import resource  # not on Windows

    return sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def _peak() -> float:
    """Return the peak memory of this process or of a child, bytes; `ru_maxrss` would begin with that of the parent."""
    import resource

    return max(_memory("VmHWM"), 1024 * resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)


def _memory(name: str) -> float:
    """Return an entry of `/proc/self/status`, bytes, or the peak memory on systems other than Linux."""
    import resource

    status = Path("/proc/self/status")
    if not status.exists():
        return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    (line,) = (line for line in status.read_text(encoding="utf-8").splitlines() if line.startswith(name))
    return 1024 * int(line.split()[1])


if __name__ == "__main__":
    main()
