"""Kill workers again and again while they write a store, or flatten a study: all must be as one process makes it.

    make soak

Four workers, ten runs, each into a store of its own. In each run two workers are killed (kill -9), up to 20 ms after a
random share of the rows was finished; in every third one the caller is killed, too, and called again. Rows must be the
same bits. Likewise ten studies of eight small hemispheres, after a random share of the files: nobody may be lost, and
no result that was there be made again.
"""

import argparse
import json
import logging
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import distributed
import studies
from store import bumpy_sheet
from store_soak import OPTIONS, check

import voxflat
from voxflat.distances.journal import read_journal
from voxflat.lab.inputs import Parameters
from voxflat.lab.study import study

RUNS, KILLS, WORKERS = 10, 2, 4
PARTICIPANTS = 8
TWICE = -1


def main():
    """Kill, resume, compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=RUNS)
    parser.add_argument("--side", type=int, default=150, help="of the sheet, voxels")
    parser.add_argument("--sources", type=int, default=4000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--run", type=Path, help="only one run, into this store")
    parser.add_argument("--dask", help="its scheduler")
    options = parser.parse_args()
    if options.run:
        rows_of(options, store=options.run, dask=options.dask)
        return
    random.seed(options.seed)
    with (
        tempfile.TemporaryDirectory() as directory,
        distributed.LocalCluster(
            n_workers=WORKERS, threads_per_worker=1, dashboard_address=None, silence_logs="CRITICAL"
        ) as cluster,
    ):
        for kind in options.kinds:
            KINDS[kind](options, Path(directory), cluster)


def rows(options, folder, cluster):
    """Kill while rows are written."""
    expected = rows_of(options)
    kills = callers = 0
    for number in range(options.runs):
        store = folder / f"store{number}"
        with killing(cluster, lambda of=store: finished(of)) as killed:
            if number % 3 == 2:
                last = random.random()
                callers += run(options, store, cluster, lambda of=store, share=last: finished(of) > share)
            run(options, store, cluster)
        check(store, expected)
        kills += len(killed)
        told = ", ".join(f"{100 * share:.0f} %" for share in killed)
        print(f"run {number + 1:2}: workers killed after {told} of the rows, caller {number % 3 == 2}", flush=True)
    print(f"{kills} kills of workers and {callers} of callers in {options.runs} runs: the bits of one process")


def participants(options, folder, cluster):
    """Kill while participants are flattened."""
    logging.getLogger("voxflat").addHandler(logging.NullHandler())  # what is noted of each stands in its record
    of = studies.hemisphere("lh", studies.SIZES[-1])
    for n in range(PARTICIPANTS):
        studies.write_derivatives(folder / "study" / f"sub-{n}" / "anat", f"sub-{n}", "lh", studies.warped(of, n))
    how = (["lh"], Parameters())
    study(folder / "study", folder / "alone", *how, threads=1)
    expected = made_of(folder / "alone")
    kills = died = 0
    for number in range(options.runs):
        out = folder / f"maps{number}"
        complete = {}  # when each record was written, which is the last of its hemisphere
        with killing(cluster, lambda of=out, note=complete: files_of(of, note) / len(expected)) as killed:
            outcomes = study(folder / "study", out, *how, dask=cluster.scheduler_address)
        failed = [one.name for one in outcomes if one.state == "failed"]
        second = study(folder / "study", out, *how, threads=1)
        if [one.name for one in second if one.state == "made"] != failed:
            raise SystemExit(f"{failed} failed, and the next call made others")
        files_of(out, complete)
        if len(outcomes) != PARTICIPANTS or made_of(out) != expected or TWICE in complete.values():
            raise SystemExit(f"{out} is not as one process makes it")
        kills, died = kills + len(killed), died + len(failed)
        told = ", ".join(f"{100 * share:.0f} %" for share in killed)
        print(f"run {number + 1:2}: workers killed after {told} of the files; {len(failed)} failed", flush=True)
    print(
        f"{kills} kills of workers in {options.runs} studies: nobody lost or made twice; {died} had to be called again"
    )


def files_of(out, complete):
    """Return how many files there are of hemispheres, and note records that were written again."""
    for record in out.glob("sub-*/anat/sub-*_flat.json"):
        written = record.stat().st_mtime_ns
        if complete.setdefault(record.name, written) != written:
            complete[record.name] = TWICE
    return len(list(out.glob("sub-*/anat/sub-*")))


def made_of(out):
    """Return what files hold, without seconds."""
    held = {path.name: path.read_bytes() for path in out.glob("sub-*/anat/sub-*")}
    for name in held:
        if name.endswith("_flat.json"):
            held[name] = {key: value for key, value in json.loads(held[name]).items() if key != "seconds"}
    return held


@contextmanager
def killing(cluster, share):
    """Kill workers at random moments of what is done in the block; yields the shares at which it was."""
    killed, over = [], threading.Event()
    shares = sorted(random.random() for _ in range(KILLS))
    killer = threading.Thread(target=kill_at, args=(shares, share, over, cluster, killed))
    killer.start()
    try:
        yield killed
    finally:
        over.set()
        killer.join()


def rows_of(options, **how):
    """Return the rows of a bumpy sheet."""
    return voxflat.surface(bumpy_sheet(options.side)).geodesic(options.sources, **how, **OPTIONS)


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


def kill_at(shares, share, over, cluster, killed):
    """Kill a worker that is alive, up to 20 ms after each share is finished."""
    for wanted in shares:
        while share() < wanted and not over.wait(0.002):
            pass
        time.sleep(random.uniform(0, 0.02))
        # Dask gives up a worker that dies while it starts
        nannies = [nanny for nanny in cluster.workers.values() if nanny.process is not None]
        alive = [nanny.pid for nanny in nannies if nanny.process.status == distributed.Status.running]
        if alive and not over.is_set():
            os.kill(random.choice(alive), signal.SIGKILL)
            killed.append(wanted)


KINDS = {"rows": rows, "participants": participants}

if __name__ == "__main__":
    main()
