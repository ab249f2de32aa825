"""Measure a large store of distance rows: memory, time and throughput, each kind of geodesic in a process of its own.

    make bench-store

A bumpy sheet of a million surface voxels, a thousand sources: 4 GB of rows. Peak memory is the resident set's, of the
whole process and while rows are computed. Beside it: how fast the same disk takes as many bytes in one go.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import psutil

import voxflat
from voxflat import _core


def main():
    """Measure both kinds, each in a process of its own."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--side", type=int, default=1000, help="of the sheet, voxels")
    parser.add_argument("--sources", type=int, default=1000)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--directory", type=Path, default=None, help="where the stores go")
    parser.add_argument("--geodesic", help="only this kind, in this process")
    options = parser.parse_args()
    if options.geodesic:
        return measure(options)
    for kind in ("chain", "graph"):
        subprocess.run([sys.executable, __file__, *sys.argv[1:], "--geodesic", kind], check=True)
    return None


def measure(options):
    """Measure one kind of geodesic."""
    with tempfile.TemporaryDirectory(dir=options.directory) as directory:
        sheet = bumpy_sheet(options.side)
        memory = Memory()
        start = time.perf_counter(), time.process_time()
        stages = {}

        def progress(stage, done, total):
            stages.setdefault(stage, (time.perf_counter(), time.process_time(), memory.peak))
            if stage == "measuring distances" and not memory.rows:
                memory.rows = 1

        rows = voxflat.surface(sheet).geodesic(
            options.sources,
            sampling="random",
            geodesic=options.geodesic,
            store=Path(directory) / "store",
            threads=options.threads,
            progress=progress,
        )
        end = time.perf_counter(), time.process_time()
        began = stages["measuring distances"]
        wall, cpu = (end[k] - began[k] for k in (0, 1))
        size = rows.nbytes / 1e6
        print(f"{options.geodesic}: {rows.shape[0]} x {rows.shape[1]} distances, {options.threads} thread(s)")
        print(f"  peak memory       {memory.peak / 2**20:8.0f} MiB; before rows {began[2] / 2**20:.0f}", end="")
        print(f", while they are computed {memory.rows / 2**20:.0f}")
        said = _core.store_memory_need(rows.shape[1], rows.shape[0], options.threads)
        print(f"  said beforehand   {said / 2**20:8.0f} MiB for rows in the making")
        print(f"  before rows       {began[0] - start[0]:8.1f} s, {began[1] - start[1]:.1f} s CPU")
        print(f"  rows              {wall:8.1f} s, {cpu:.1f} s CPU, {size / wall:.0f} MB/s")
        print(f"                    {1e9 * cpu / rows.shape[0] / rows.shape[1]:8.1f} ns CPU a distance")
        print(f"  resumed, complete {timed(lambda: again(options, sheet, rows.store)):8.1f} s", end="")
        print(f"; verify() {timed(rows.verify):.1f} s")
        print(f"  the disk alone    {rows.nbytes / 1e6 / timed(lambda: plain(Path(directory), rows)):8.0f} MB/s")
        memory.stop()


def again(options, sheet, store):
    """Open the complete store by the same call."""
    kind, threads = options.geodesic, options.threads
    voxflat.surface(sheet).geodesic(options.sources, sampling="random", geodesic=kind, store=store, threads=threads)


def plain(directory, rows):
    """Write as many bytes in one go."""
    with (directory / "plain").open("wb") as file:
        for start in range(0, len(rows), 16):
            file.write(rows.rows[start : start + 16].tobytes())
        file.flush()
        os.fsync(file.fileno())


class Memory(threading.Thread):
    """Watches the resident set of this process."""

    def __init__(self):
        super().__init__(daemon=True)
        self.peak, self.rows, self._stopped = 0, 0, threading.Event()
        self.start()

    def run(self):
        """Look every 5 ms."""
        process = psutil.Process()
        while not self._stopped.wait(0.005):
            used = process.memory_info().rss
            self.peak = max(self.peak, used)
            self.rows = max(self.rows, used) if self.rows else 0

    def stop(self):
        """Stop looking."""
        self._stopped.set()


def bumpy_sheet(side):
    """Return a sheet one voxel thick with bumps."""
    i, j = np.indices((side, side))
    height = np.round(12 + 8 * np.sin(i / 40) * np.sin(j / 40)).astype(int)
    volume = np.zeros((side, side, height.max() + 3), dtype=bool)
    volume[i, j, height] = True
    return volume


def timed(work):
    """Return how long some work takes, s."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


if __name__ == "__main__":
    main()
