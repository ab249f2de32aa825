"""Open damaged files and call functions with wrong values: each case must end in a result or an error of voxflat.

    make soak
    python docs/benchmarks/soak/fuzz.py --files 2000 --short 1000 --calls 2000     # two minutes
    python docs/benchmarks/soak/fuzz.py --case files 123                           # repeat one case, with its traceback

A small file of each format is damaged at random and opened; files are shortened and opened; public functions and
methods are called with right and wrong values. The seed and the number determine a case. Worker processes with limited
memory run the cases. A finding is a crash, a hang, excessive memory, an exception not defined by voxflat, a message of
several lines, or printed text; a file opened outside the folder; and a shortened file from which something else is read
than from the complete file, without a warning. Each place is reported once, with the command that repeats the case.
"""

import argparse
import json
import logging
import os
import random
import resource
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from itertools import count
from pathlib import Path

from tqdm import tqdm

DEADLINE = 20.0  # seconds per case, and four times that when it is repeated
READING = 1 << 28  # memory limit of reading, bytes
MOST = 1 << 30  # bytes that a case may add to the memory of its worker
ADDRESSES = 3 << 30  # bytes of address space that a worker may add after its start
BAIT = ("/etc/hosts", "/dev/zero", "secret.tif", "secret.raw")  # ends of names outside the folder of a damaged file


# ------------------------------------------------------------------------------------------------- worker


def _two_lines():
    from voxflat.errors import InputError

    raise InputError("one line\nand another")


class Accepted(Exception):  # noqa: N818
    """A shortened file was read without an error or a warning."""


def _accepted(name):
    raise Accepted(f"{name}: something is missing without a warning")


FAULTS = {
    "refused": lambda: Path("nowhere", "at all").read_text(),
    "raw": lambda: [][0],
    "outside": lambda: Path("/etc/hosts").read_bytes(),
    "accepted": lambda: _accepted("t.nii"),
    "not one line": _two_lines,
    "printed": lambda: print("a warning"),
    "memory": lambda: b"x" * (1 << 26),
    "crash": lambda: os.kill(os.getpid(), signal.SIGSEGV),
    "hang": lambda: time.sleep(5 * DEADLINE),
}
"""Cases of a third kind by their expected outcomes, which test the search itself."""


class Cases:
    """Draws and runs cases in a folder."""

    def __init__(self, folder, kind, seed):
        self.folder, self.kind, self.seed = folder, kind, seed
        self.whole, self.warnings, self.opened = {}, [], []
        warned = logging.Handler(logging.WARNING)
        warned.emit = lambda record: self.warnings.append(str(record.msg))
        logging.getLogger("voxflat").addHandler(warned)
        warnings.showwarning = lambda message, *_: self.warnings.append(str(message))
        warnings.simplefilter("always")
        sys.addaudithook(lambda event, of: event == "open" and str(of[0]).endswith(BAIT) and self.opened.append(of[0]))
        if kind in ("files", "short"):
            from fuzz_files import corpus

            self.entries = corpus(folder / "corpus")
            for name in ("secret.tif", "secret.raw"):
                shutil.copy(next(of.folder / of.main for of in self.entries if of.main == "plain.tif"), folder / name)
        elif kind == "calls":
            from fuzz_calls import calls

            (folder / "read").mkdir()
            self.calls, self.values = calls(folder / "read")
            self.labels = sorted(self.calls)

    def drawn(self, number):
        """Return the description of a case, and the case."""
        chance = random.Random(f"{self.kind} {self.seed} {number}")
        if self.kind == "files":
            from fuzz_files import OPENERS, damaged

            entry = self.entries[number % len(self.entries)]
            path, opener = damaged(entry, self.entries, self.folder / "case", chance)
            return f"{opener} {path.name}", entry.kind, lambda: OPENERS[opener](path)
        if self.kind == "short":
            from fuzz_files import OPENERS
            from fuzz_short import shortened

            entry = self.entries[number % len(self.entries)]
            path, how = shortened(entry, self.folder / "case", chance)
            return f"{path.name}: {how}", entry.kind, lambda: self.shorter(entry, path, OPENERS[entry.opener], how)
        if self.kind == "faults":
            name = list(FAULTS)[number % len(FAULTS)]
            return name, name, FAULTS[name]
        from fuzz_calls import DRAWING, SELDOM, arguments, told

        label = self.labels[number % len(self.labels)]
        while label in DRAWING and number // len(self.labels) % SELDOM:
            label = chance.choice(self.labels)
        given = arguments(self.calls[label], self.values, chance)
        return told(label, given), "", lambda: self.calls[label](**given)

    def shorter(self, entry, path, opener, how):
        """Open a shortened file, and compare the result with that of the complete file."""
        from fuzz_short import digest

        if entry not in self.whole:
            self.warnings.clear()
            self.whole[entry] = (digest(opener(entry.folder / entry.main)), set(self.warnings))
        self.warnings.clear()
        found, (whole, warned) = digest(opener(path)), self.whole[entry]
        if how and found != whole and not set(self.warnings) - warned:
            _accepted(entry.main)

    def run(self, number):
        from voxflat.errors import VoxflatError
        from voxflat.io.reading import reading

        what, kind, case = self.drawn(number)
        self.opened.clear()
        self.warnings.clear()
        before, start = _memory(), time.perf_counter()
        outcome, where, trace = "result", "", ""
        try:
            with reading(READING):
                case()
        except Accepted as error:
            outcome, where = "accepted", str(error)
        except VoxflatError as error:
            text = str(error)
            outcome = "refused" if text.strip() and "\n" not in text else "not one line"
            where = "" if outcome == "refused" else _place(error)
        except OSError as error:
            outcome = "refused" if error.errno is not None and error.filename is not None else "raw"
            where = "" if outcome == "refused" else f"{type(error).__name__} from {_place(error)}"
        except Exception as error:
            outcome = "raw"
            where, trace = f"{type(error).__name__} from {_place(error)}", traceback.format_exc()
            what = f"{what}\n        {' '.join(str(error).split())[:150]}"
        if self.opened:
            outcome, where = "outside", f"{kind}: opened {self.opened[0]}"
        told = {"outcome": outcome, "kind": kind, "what": what, "where": where, "trace": trace}
        return told | {"seconds": time.perf_counter() - start, "memory": max(0, _memory(peak=True) - before)}


def _place(error):
    """Return the innermost function of the package in a traceback."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if "/voxflat/" in frame.filename]
    if not frames:
        return "no function of voxflat"
    return f"{frames[-1].filename.rpartition('/voxflat/')[2]}:{frames[-1].lineno} {frames[-1].name}"


def _memory(*, peak=False):
    """Return the memory of this process, bytes, or its peak since the last call without `peak`."""
    if not peak:
        Path("/proc/self/clear_refs").write_text("5")
    status = Path("/proc/self/status").read_text()
    return 1024 * int(status.partition("VmHWM:" if peak else "VmRSS:")[2].split()[0])


def work(kind, seed):
    """Run the cases whose numbers arrive on standard input; write one line per outcome to standard output."""
    answers = os.fdopen(os.dup(1), "w")
    with tempfile.TemporaryDirectory() as directory:
        folder = Path(directory)
        (folder / "here").mkdir()
        cases = Cases(folder, kind, seed)
        os.chdir(folder / "here")
        logging.getLogger("voxflat").propagate = False
        printed = (folder / "printed").open("w+b")
        for stream in (1, 2):
            os.dup2(printed.fileno(), stream)
        limit = 1024 * int(Path("/proc/self/status").read_text().partition("VmSize:")[2].split()[0]) + ADDRESSES
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        print("ready", file=answers, flush=True)
        for line in sys.stdin:
            found = cases.run(int(line))
            sys.stdout.flush()
            sys.stderr.flush()
            if size := printed.seek(0, os.SEEK_END):
                printed.seek(0)
                text = printed.read(min(size, 400)).decode("utf-8", "replace")
                printed.truncate(0)
                if found["outcome"] in ("result", "refused"):
                    found |= {"outcome": "printed", "where": " ".join(text.split())[:200]}
            print(json.dumps(found), file=answers, flush=True)


# ------------------------------------------------------------------------------------------------- caller


class Worker:
    """A process that runs one case after the other, and is replaced when it ends or hangs."""

    def __init__(self, kind, seed):
        self.command = [sys.executable, __file__, "--work", kind, "--seed", str(seed)]
        self.start()

    def start(self):
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        self.process = subprocess.Popen(self.command, **pipes, env={**os.environ, "MPLBACKEND": "agg"})
        if self._line(300) != "ready\n":
            raise SystemExit(f"a worker does not start: {' '.join(self.command)}")

    def _line(self, seconds):
        """Return the next line: empty if the process has ended, None if it is late."""
        if not select.select([self.process.stdout], [], [], seconds)[0]:
            return None
        return self.process.stdout.readline()

    def run(self, number, seconds=None):
        """Run a case; one that is late is repeated with more time, because other programs may have delayed it."""
        self.process.stdin.write(f"{number}\n")
        self.process.stdin.flush()
        line = self._line(seconds or DEADLINE)
        if line:
            found = json.loads(line)
            if found["outcome"] in ("result", "refused") and found["memory"] > MOST:
                found |= {"outcome": "memory", "where": f"{found['what'][:60]}: more than {MOST >> 20} MiB"}
            return found
        if line is None:
            self.process.kill()
        status = self.process.wait()
        self.start()
        if line is None and seconds is None:
            return self.run(number, 4 * DEADLINE)
        outcome = "hang" if line is None else "crash"
        where = f"more than {4 * DEADLINE:g} s" if line is None else f"status {status}"
        return {"outcome": outcome, "kind": "", "what": "", "where": where, "seconds": DEADLINE, "memory": 0}

    def stop(self):
        self.process.stdin.close()
        self.process.wait()


def run(kind, numbers, seed, workers):
    """Run cases, print a summary, and return the findings."""
    if not numbers:
        return []
    bar = tqdm(total=len(numbers), desc=kind, disable=not sys.stderr.isatty())
    turns, outcomes, kinds, findings = count(numbers.start), Counter(), Counter(), {}
    slowest, greatest = (0.0, 0), (0, 0)

    def turn(_):
        nonlocal slowest, greatest
        worker = Worker(kind, seed)
        while (number := next(turns)) < numbers.stop:
            found = worker.run(number)
            outcomes[found["outcome"]] += 1
            kinds[found["kind"], found["outcome"]] += 1
            slowest, greatest = max(slowest, (found["seconds"], number)), max(greatest, (found["memory"], number))
            if found["outcome"] not in ("result", "refused"):
                findings.setdefault(f"{found['outcome']}: {found['where']}", []).append((number, found["what"]))
            bar.update()
        worker.stop()

    start = time.monotonic()
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(turn, range(workers)))
    bar.close()
    took = time.monotonic() - start
    counted = ", ".join(f"{n:,} {name}" for name, n in outcomes.most_common())
    print(f"{len(numbers):,} {kind} in {took:.0f} s: {counted}")
    print(f"  slowest: {slowest[0]:.1f} s ({kind} {slowest[1]}); most memory: {greatest[0] >> 20} MiB ({greatest[1]})")
    for kind_of in sorted({of for of, _ in kinds if of}):
        print(f"  {kind_of}: {', '.join(f'{n:,} {what}' for (of, what), n in kinds.most_common() if of == kind_of)}")
    for name, cases in sorted(findings.items(), key=lambda item: -len(item[1])):
        number, what = cases[0]
        again = f"python {sys.argv[0]} --seed {seed} --case {kind} {number}"
        print(f"{len(cases):5} x {name}\n        {what}\n        {again}")
    return list(findings)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=int, default=100_000, help="number of damaged files")
    parser.add_argument("--short", type=int, default=50_000, help="number of shortened files")
    parser.add_argument("--calls", type=int, default=1_000_000, help="number of calls of the public API")
    parser.add_argument("--first", type=int, default=0, help="number of the first case of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--case", nargs=2, metavar=("KIND", "NUMBER"), help="run only this case, in this process")
    parser.add_argument("--work", choices=("files", "short", "calls", "faults"), help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.work:
        work(asked.work, asked.seed)
    elif asked.case:
        again(asked.case[0], int(asked.case[1]), asked.seed)
    else:
        found = []
        for kind, number in (("files", asked.files), ("short", asked.short), ("calls", asked.calls)):
            found += run(kind, range(asked.first, asked.first + number), asked.seed, asked.workers)
        sys.exit(f"{len(found)} findings" if found else 0)


def again(kind, number, seed):
    """Run one case in this process, print its details, and keep the damaged file."""
    folder = Path(tempfile.mkdtemp(prefix="fuzz_"))
    cases = Cases(folder, kind, seed)
    (folder / "here").mkdir()
    os.chdir(folder / "here")
    print(f"in {folder}\n{cases.drawn(number)[0]}", flush=True)
    found = cases.run(number)
    print(f"{found['outcome']}: {found['where']}, {found['seconds']:.2f} s, {found['memory'] >> 20} MiB")
    print(found["trace"])


if __name__ == "__main__":
    main()
