"""What it costs to let workers of Dask write a store: one process beside one worker, or as many as are asked for.

    make bench-cluster

A bumpy sheet of 200,000 surface voxels, 1,000 sources, one thread each; medians of some rounds, in turn. The surface
is there already, and so are workers, that have imported voxflat, as those of a cluster that is in use have; what it
takes to start them is told beside it. What was written before is on the disk when a run begins: else the second of two
writes both stores. Rows must be the same bits.
"""

import argparse
import hashlib
import importlib
import os
import shutil
import tempfile
import time
from pathlib import Path

import distributed
import numpy as np
import psutil
from store import bumpy_sheet

import voxflat


def main():
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--side", type=int, default=447, help="of the sheet, voxels")
    parser.add_argument("--sources", type=int, default=1000)
    parser.add_argument("--workers", type=int, nargs="*", default=[1])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--directory", type=Path, default=None, help="where the stores go")
    options = parser.parse_args()
    spent_by = {count: [] for count in (None, *options.workers)}
    for _ in range(options.rounds):
        with tempfile.TemporaryDirectory(dir=options.directory) as directory:
            rows = []
            for count, found in spent_by.items():
                os.sync()
                store = Path(directory) / f"{count}"
                found.append(measure(options, store, count))
                rows.append(hashlib.sha256((store / "rows.npy").read_bytes()).digest())
                shutil.rmtree(store)
            if len(set(rows)) > 1:
                raise SystemExit("the rows are other bits")
    usual = np.median(spent_by[None], axis=0)
    print(f"one process: {usual[0]:.1f} s, {usual[1]:.1f} s of CPU time")
    for count in options.workers:
        wall, cpu, *began = np.median(spent_by[count], axis=0)
        more = 100 * (wall / usual[0] - 1), 100 * (cpu / usual[1] - 1)
        print(f"{count} workers: {wall:.1f} s ({more[0]:+.0f} %), {cpu:.1f} s of CPU time ({more[1]:+.0f} %)")
        print(f"  they were there after {began[0]:.1f} s, {began[1]:.1f} s of CPU time")


def measure(options, store, workers):
    """Return the seconds that a store takes, of the clock and of computing, and those until workers were there."""
    surface = voxflat.surface(bumpy_sheet(options.side))
    how = {"sampling": "random", "store": store, "threads": 1}
    start = time.perf_counter(), time.process_time()
    if workers is None:
        surface.geodesic(options.sources, **how)
        return time.perf_counter() - start[0], time.process_time() - start[1], 0.0, 0.0
    with distributed.LocalCluster(
        n_workers=workers, threads_per_worker=1, dashboard_address=None, silence_logs="CRITICAL"
    ) as cluster:
        with distributed.Client(cluster) as client:
            client.run(importlib.import_module, "voxflat.distances.parts")
        ready = time.perf_counter(), spent(cluster)
        surface.geodesic(options.sources, dask=cluster.scheduler_address, **how)
        end = time.perf_counter(), spent(cluster)
        return end[0] - ready[0], end[1] - ready[1], ready[0] - start[0], ready[1] - start[1]


def spent(cluster):
    """Return the CPU time of this process and of the workers, s."""
    workers = (psutil.Process(nanny.pid).cpu_times() for nanny in cluster.workers.values())
    return time.process_time() + sum(of.user + of.system for of in workers)


if __name__ == "__main__":
    main()
