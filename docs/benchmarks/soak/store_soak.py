"""Kill a computation of rows repeatedly and resume it: the rows must be bit-identical to those of an undisturbed run.

    make soak

Each run has a random number of threads and is killed (kill -9) at a random time: every fourth between its start and its
end, the others up to 20 ms after a random missing row is finished. After every third kill, a part of the table and the
last line of the journal are destroyed as well, as by a power failure.
"""

import argparse
import os
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import voxflat

SIDE, SOURCES = 150, 4000
OPTIONS = {"sampling": "random", "geodesic": "graph"}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--run", type=Path, help="do a single run, into this store")
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    if options.run:
        voxflat.surface(sheet()).geodesic(SOURCES, store=options.run, threads=options.threads, **OPTIONS)
        return
    expected = voxflat.surface(sheet()).geodesic(SOURCES, **OPTIONS)
    random.seed(options.seed)
    kills, restarts = 0, 0
    with tempfile.TemporaryDirectory() as directory:
        store, whole = Path(directory) / "store0", None
        while kills < options.kills:
            start, known = time.monotonic(), finished(store)
            moment, after = random.uniform(0, whole or 1), random.randint(known + 1, max(known + 1, SOURCES))
            if whole is None:
                limit, what = None, "never"
            elif kills % 4 == 3:
                limit, what = (lambda end=start + moment: time.monotonic() > end), f"{moment:4.1f} s"
            else:
                limit, what = row_finished(store, after, moment / whole), f"{after:4} rows"
            if run(store, limit):
                whole = whole or time.monotonic() - start  # the duration of the first run
                check(store, expected)
                restarts += 1
                store = Path(directory) / f"store{restarts}"
                continue
            kills += 1
            if kills % 3 == 0:
                tear(store)
            print(f"kill {kills:2} after {what:>10}: {finished(store)} rows finished")
        run(store, None)
        check(store, expected)
        print(f"{kills} kills, {restarts + 1} stores: all rows are bit-identical to those of an uninterrupted run")


def sheet():
    i, j = np.indices((SIDE, SIDE))
    height = np.round(4 + 3 * np.sin(i / 15) * np.sin(j / 15)).astype(int)
    volume = np.zeros((SIDE, SIDE, 10), dtype=bool)
    volume[i, j, height] = True
    return volume


def row_finished(store, number, later):
    """Return a function that tells whether `number` rows are finished, and a part of 20 ms has passed since."""
    seen = []

    def passed():
        if not seen and finished(store) >= number:
            seen.append(time.monotonic())
        return bool(seen) and time.monotonic() > seen[0] + 0.02 * later

    return passed


def run(store, limit):
    """Run until `limit` says to kill the run; return whether it finished."""
    threads = random.randint(1, 3)
    process = subprocess.Popen([sys.executable, __file__, "--run", store, "--threads", str(threads)])
    while process.poll() is None:
        if limit and limit():
            process.kill()
            process.wait()
            return False
        time.sleep(0.001)
    if process.returncode:
        raise SystemExit(f"a run failed with status {process.returncode}")
    return True


def tear(store):
    """Destroy a part of the table, and half of the last line of the journal."""
    journal, table = store / "journal.jsonl", store / "rows.npy"
    if journal.exists() and len(lines := journal.read_bytes().splitlines(keepends=True)) > 1:
        os.truncate(journal, journal.stat().st_size - len(lines[-1]) // 2)
    if table.exists():
        with table.open("r+b") as file:
            file.seek(random.randrange(128, table.stat().st_size - 4096))
            file.write(bytes(4096))


def finished(store):
    """Return the number of rows in the journal."""
    journal = store / "journal.jsonl"
    return journal.read_text().count("crc32") if journal.exists() else 0


def check(store, expected):
    rows = voxflat.open_rows(store)
    rows.verify()
    if np.asarray(rows).tobytes() != expected.rows.tobytes():
        raise SystemExit(f"{store} differs from an uninterrupted run")


if __name__ == "__main__":
    main()
