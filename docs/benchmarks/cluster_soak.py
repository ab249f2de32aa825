"""Kill workers again and again while they write a store: the rows must be those of one process, bit by bit.

    make soak

Four workers, ten runs, each into a store of its own. In each run two workers are killed (kill -9), up to 20 ms after a
random share of the rows was finished; in every third one the caller is killed, too, and called again.
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
from voxflat.distances.journal import read_journal

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
        kills = callers = 0
        for number in range(options.runs):
            store, over = Path(directory) / f"store{number}", threading.Event()
            shares = sorted(random.random() for _ in range(KILLS))
            killed = []
            killer = threading.Thread(target=kill_at, args=(shares, store, over, cluster, killed))
            killer.start()
            if number % 3 == 2:
                last = random.random()
                callers += run(options, store, cluster, lambda of=store, share=last: finished(of) > share)
            run(options, store, cluster)
            over.set()
            killer.join()
            check(store, expected)
            kills += len(killed)
            told = ", ".join(f"{100 * share:.0f} %" for share in killed)
            print(f"run {number + 1:2}: workers killed after {told} of the rows, caller {number % 3 == 2}", flush=True)
        print(f"{kills} kills of workers and {callers} of callers in {options.runs} runs: the bits of one process")


def rows_of(options, **how):
    """Return the rows of a bumpy sheet."""
    return voxflat.geodesic(bumpy_sheet(options.side), options.sources, **how, **OPTIONS)


def run(options, store, cluster, limit=None):
    """Run to the end; or in a process of its own, which is killed when it is time, and return whether it was."""
    if limit is None:
        rows_of(options, store=store, dask=cluster.scheduler_address)
        return False
    same = ["--side", str(options.side), "--sources", str(options.sources)]
    command = [sys.executable, __file__, *same, "--run", store, "--dask", cluster.scheduler_address]
    process = subprocess.Popen(command)
    while process.poll() is None:
        if limit():
            process.kill()
            process.wait()
            return True
        time.sleep(0.005)
    if process.returncode:
        raise SystemExit(f"a run failed with status {process.returncode}")
    return False


def finished(store):
    """Return the share of rows that journals know, of the store and of its parts; -1 where there is no store."""
    try:
        whole = read_journal(store)
        parts = [read_journal(path.parent) for path in (store / "parts").glob("*/journal.jsonl")]
    except (voxflat.InputError, OSError):
        return -1
    return min(1, sum(len(one.checksums) for one in (whole, *parts)) / whole.rows)


def kill_at(shares, store, over, cluster, killed):
    """Kill a worker that is alive, up to 20 ms after each share of the rows is finished."""
    for share in shares:
        while finished(store) < share and not over.wait(0.002):
            pass
        time.sleep(random.uniform(0, 0.02))
        # Dask gives up a worker that dies while it starts
        nannies = [nanny for nanny in cluster.workers.values() if nanny.process is not None]
        alive = [nanny.pid for nanny in nannies if nanny.process.status == distributed.Status.running]
        if alive and not over.is_set():
            os.kill(random.choice(alive), signal.SIGKILL)
            killed.append(share)


if __name__ == "__main__":
    main()
