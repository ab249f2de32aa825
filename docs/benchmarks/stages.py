"""Where time and memory of a map go, stage by stage.

    python docs/benchmarks/stages.py --voxels 0.7        # a whole hemisphere, voxels of so many mm
    python docs/benchmarks/stages.py --sheet 300_000     # a rolled, waving sheet of about so many vertices

Stages are those that `progress` is told; what comes before the next one is told, on Python's side, is counted to the
one before. Memory is that of the process, packages and input among it; its peak of each stage is known on Linux alone.
Compare CPU times where others use the machine, too.
"""

import argparse
import resource
import sys
import time
from pathlib import Path

import anatomy
import maps_growth
import numpy as np
from distances_tables import table

import voxflat

STATUS = Path("/proc/self/status")
RESET = Path("/proc/self/clear_refs")


def main():
    """Make a map, and print what each stage took."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--voxels", type=float, help="fsaverage5 left, whole, as voxels of so many mm")
    what.add_argument("--sheet", type=int, help="a rolled, waving sheet of about so many vertices")
    parser.add_argument("--threads", type=int, help="by default one a core")
    options = parser.parse_args()
    if not RESET.exists():
        sys.exit("the peak of a stage is known on Linux alone")
    if options.sheet is None:
        hemisphere = anatomy.fsaverage5("left")
        labels, affine, _ = anatomy.voxelise(hemisphere["white"], hemisphere["faces"], options.voxels)
        given, how, further = labels, {"affine": affine, "repair": "voxels"}, {}
    else:
        _, points, faces = maps_growth.waving_sheet(options.sheet)
        given, how, further = (points, faces), {}, {"relax": False}
    stages = Stages()
    how |= {"threads": options.threads, "progress": stages}
    surface = voxflat.surface(given, **how)
    made = surface.flatten(**further, threads=options.threads, progress=stages)
    stages.end()
    size = len(made.uv)
    said = made.metadata["memory_need_bytes"] / 2**30
    wall, cpu, peak = (sum(stages.walls), sum(stages.cpus), max(stages.peaks))
    note = (
        f"{size:,} vertices: {wall:.1f} s, {cpu:.1f} s of CPU time; {peak:.2f} GiB, {peak - stages.before:.2f} without "
        f"packages and input, where {said:.2f} were said before"
    )
    rows = zip(stages.names, stages.walls, stages.cpus, stages.peaks, strict=True)
    columns = ("stage", "wall s", "CPU s", "GiB at its peak")
    table("Stages", columns, [[name, f"{a:.2f}", f"{b:.2f}", f"{c:.2f}"] for name, a, b, c in rows], note)


class Stages:
    """What each stage takes, as a `progress` callable; neighbours of one name are one."""

    def __init__(self):
        self.names, self.walls, self.cpus, self.peaks = [], [], [], []
        self.stage, self.before = "start", memory("VmRSS")
        self.wall, self.cpu = time.perf_counter(), cpu_time()
        RESET.write_text("5")

    def __call__(self, stage, done, total):
        """Take note of a stage."""
        if stage != self.stage:
            self.end()
            self.stage = stage

    def end(self):
        """End the stage at hand."""
        wall, cpu = time.perf_counter(), cpu_time()
        self.names.append(self.stage)
        self.walls.append(wall - self.wall)
        self.cpus.append(cpu - self.cpu)
        self.peaks.append(memory("VmHWM"))
        self.wall, self.cpu = wall, cpu
        RESET.write_text("5")


def cpu_time():
    """Return the CPU time of this process, s."""
    return float(np.sum(resource.getrusage(resource.RUSAGE_SELF)[:2]))


def memory(name):
    """Return a figure of this process' memory as Linux calls it, GiB."""
    (line,) = (line for line in STATUS.read_text().splitlines() if line.startswith(name))
    return int(line.split()[1]) / 2**20


if __name__ == "__main__":
    main()
