"""Kill workers again and again while they write a store: the rows must be those of one process, bit by bit.

    make soak

Four workers, ten runs, each into a store of its own. In each run two workers are killed (kill -9) at random moments; in
every third one the caller is killed, too, and called again.
"""

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import distributed
from store import bumpy_sheet
from store_soak import OPTIONS, check

import voxflat

RUNS, KILLS, WORKERS = 10, 2, 4


def main():
    """Kill, resume, compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=RUNS)
    parser.add_argument("--side", type=int, default=150, help="of the sheet, voxels")
    parser.add_argument("--sources", type=int, default=4000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--run", type=Path, help="only one run, into this store")
    parser.add_argument("--dask", help="its scheduler")
    options = parser.parse_args()
    if options.run:
        rows_of(options, store=options.run, dask=options.dask)
        return
    expected = rows_of(options)
    random.seed(options.seed)
    with (
        tempfile.TemporaryDirectory() as directory,
        distributed.LocalCluster(
            n_workers=WORKERS, threads_per_worker=1, dashboard_address=None, silence_logs="CRITICAL"
        ) as cluster,
    ):
        start = time.monotonic()
        run(options, Path(directory) / "whole", cluster)
        whole = time.monotonic() - start
        print(f"undisturbed: {whole:.1f} s", flush=True)
        kills = callers = 0
        for number in range(options.runs):
            store = Path(directory) / f"store{number}"
            moments = sorted(random.uniform(0, whole) for _ in range(KILLS))
            killed = []
            killer = threading.Thread(target=kill_at, args=(moments, cluster, killed))
            killer.start()
            if number % 3 == 2:
                callers += run(options, store, cluster, random.uniform(0.3, 1) * whole)
            run(options, store, cluster)
            killer.join()
            check(store, expected)
            kills += len(killed)
            told = ", ".join(f"{moment:.1f}" for moment in moments)
            print(f"run {number + 1:2}: workers killed after {told} s, caller {number % 3 == 2}", flush=True)
        print(f"{kills} kills of workers and {callers} of callers in {options.runs} runs: the bits of one process")


def rows_of(options, **how):
    """Return the rows of a bumpy sheet."""
    return voxflat.geodesic(bumpy_sheet(options.side), options.sources, **how, **OPTIONS)


def run(options, store, cluster, limit=None):
    """Run to the end; or in a process of its own, which is killed after so many seconds, and return whether it was."""
    if limit is None:
        rows_of(options, store=store, dask=cluster.scheduler_address)
        return False
    same = ["--side", str(options.side), "--sources", str(options.sources)]
    command = [sys.executable, __file__, *same, "--run", store, "--dask", cluster.scheduler_address]
    process = subprocess.Popen(command)
    try:
        status = process.wait(limit)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return True
    if status:
        raise SystemExit(f"a run failed with status {status}")
    return False


def kill_at(moments, cluster, killed):
    """Kill a worker at each moment, s from now, that is alive then."""
    start = time.monotonic()
    for moment in moments:
        time.sleep(max(0, start + moment - time.monotonic()))
        alive = [nanny.pid for nanny in cluster.workers.values() if nanny.pid]
        if alive:
            killed.append(random.choice(alive))
            os.kill(killed[-1], signal.SIGKILL)


if __name__ == "__main__":
    main()
