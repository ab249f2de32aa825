"""Kill, stop and terminate every command at random moments: nothing may be lost, and nothing left.

    make soak
    python docs/benchmarks/signals_soak.py --each 10     # of each signal

Each case runs one command of the program in a folder of its own, in half of them where an older result stands in the
place of the new one, and sends SIGKILL, SIGINT (Ctrl-C) or SIGTERM up to a little after the end that it is known to
have. Then every file must be as it was before or as an undisturbed run writes it; after SIGINT and SIGTERM there is no
other, no process goes on, at most one line is said, and it was quick; and the same call, again, ends well and with the
same results. What changes from run to run (seconds) must at least be whole.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import random
import re
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
import zipfile
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import nibabel as nib
import numpy as np
import psutil
import studies
from PIL import Image

import voxflat
from voxflat import io as files

SIGNALS = {"kill": signal.SIGKILL, "Ctrl-C": signal.SIGINT, "term": signal.SIGTERM}
DEADLINE = 60.0
TEMPORARY = re.compile(r"^\.[0-9a-f]{8}\.|/\.[0-9a-f]{8}\.")
"""What a file is called until it is complete: `voxflat.io.files.temporary_beside`."""

OLD = b"what was here before\n"
MARK = "VOXFLAT_SOAK"
CALLERS = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}

COMMANDS: dict[str, tuple[str, tuple[str, ...]]] = {
    "check": ("check v.nii.gz --json", ()),
    "surface": ("surface v.nii.gz --label 1 --repair voxels --repaired changed.nii.gz -o s.vtp", ("s.vtp",)),
    "flatten": ("flatten v.nii.gz --label 1 -o new.npz", ("new.npz",)),
    "flatten mesh": ("flatten lh.white --pial lh.pial --cuts automatic -o new.flat.surf.gii", ("new.flat.surf.gii",)),
    "cut": ("cut lh.white --pial lh.pial -o cuts.json", ("cuts.json",)),
    "register": ("register lh.white -o lh.sphere.reg", ("lh.sphere.reg",)),
    "path": ("path v.nii.gz 0,0,6 19,0,6 --label 1 -o way.txt", ("way.txt",)),
    "measure": ("measure lh.white map.npz --sources 100 --heat-maps heat.png", ("heat.png",)),
    "worst": ("worst map.npz --beyond 1.1 -o worst.tsv --save-cuts relief.json --figure worst.png", ("worst.tsv",)),
    "patches": ("patches lh.white --glue 1.5 -o atlas.npz --page page.png", ("atlas.npz", "page.png")),
    "texture": ("texture map.npz picture.png -o bricks.obj", ("bricks.obj",)),
    "rows": ("rows v.nii.gz --label 1 --sources 400 --geodesic exact --store store", ()),
    "image": ("image voxels.npz --volume t1.nii.gz --pixel-size 0.1 -o t1.png", ("t1.png",)),
    "image series": ("image voxels.npz --volume series.nii.gz --pixel-size 0.3 -o t1.nii.gz", ("t1.nii.gz",)),
    "image zarr": ("image voxels.npz --volume series.nii.gz --pixel-size 0.3 -o t1.zarr", ()),
    "heat map": ("image map.npz --heat-map -o heat.tif", ("heat.tif",)),
    "figure": ("figure map.npz --overlay lh.curv -o curv.svg", ("curv.svg",)),
    "movie": ("movie voxels.npz --overlay series.nii.gz --size 320 -o bold.gif", ("bold.gif",)),
    "points": ("points map.npz points.csv --limit 50 -o out.csv", ("out.csv",)),
    "regions": ("regions map.npz --polygons areas.json -o lh.areas.annot", ("lh.areas.annot",)),
    "freesurfer": ("freesurfer sub-01 --hemi lh --cuts automatic --overlay curv", ()),
    "bids": ("bids study maps participant --hemi L --cuts automatic", ()),
}
"""Each command by what it is called here, and the files that an older result stands in place of."""


COMPLETE = {"image zarr": "t1.zarr"}
"""Results that are directories: there wholly or not at all, and never replaced."""


def inputs(folder: Path) -> None:
    """Write what the commands read."""
    i, j = np.indices((20, 20))
    volume = np.zeros((20, 20, 12), np.uint8)
    volume[i, j, np.round(6 + 3 * np.sin(i / 6) * np.sin(j / 6)).astype(int)] = 1
    affine = np.eye(4)
    series = np.random.default_rng(0).normal(100, 5, (*volume.shape, 20)).astype(np.float32)
    files.write_volume(folder / "v.nii.gz", volume, affine)
    files.write_volume(folder / "t1.nii.gz", np.random.default_rng(1).random(volume.shape, np.float32), affine)
    nib.save(nib.Nifti1Image(series, affine), folder / "series.nii.gz")
    voxflat.surface(folder / "v.nii.gz", label=1).flatten(voxflat.methods.Voxflat(sources=50)).save(
        folder / "voxels.npz"
    )
    of = studies.hemisphere("lh", 162)
    for name, points in (("white", "white"), ("pial", "pial")):
        nib.freesurfer.write_geometry(folder / f"lh.{name}", of[points], of["faces"])
    nib.freesurfer.write_morph_data(folder / "lh.curv", of["curv"])
    flat = voxflat.flatten(voxflat.surface(folder / "lh.white", pial=folder / "lh.pial"), cuts="automatic")
    flat.save(folder / "map.npz")
    centre, reach = np.median(flat.uv, axis=0), 0.2 * np.ptp(flat.uv, axis=0).min()
    square = centre + reach * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    (folder / "areas.json").write_text(json.dumps({"a": square.tolist()}))
    rows = "".join(f"{x},{y},{z}\n" for x, y, z in flat.points[:50])
    (folder / "points.csv").write_text("x,y,z\n" + rows)
    Image.fromarray(np.random.default_rng(2).integers(0, 255, (200, 300, 3), np.uint8)).save(folder / "picture.png")
    studies.write_freesurfer(folder / "sub-01", "lh", of)
    for n in (1, 2):
        one = studies.warped(studies.hemisphere("lh", 162), n)
        studies.write_derivatives(folder / "study" / f"sub-{n:02}" / "anat", f"sub-{n:02}", "lh", one)


def contents(folder: Path) -> dict[str, bytes]:
    """Return all files of a folder, by their paths in it; the lock of a store says who had it last."""
    found = (path for path in folder.rglob("*") if path.is_file() and path.name != "lock")
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in found}


def is_whole(name: str, data: bytes) -> bool:
    """Say whether a file that differs from run to run is complete."""
    try:
        if name.endswith((".json", ".jsonl")):
            return all(
                json.loads(line) is not None for line in ([data] if name.endswith("json") else data.splitlines())
            )
        if name.endswith(".npz"):
            return zipfile.ZipFile(io.BytesIO(data)).testzip() is None
        if name.endswith(".html"):
            return data.rstrip().endswith(b"</html>")
        if name.endswith(".png"):
            Image.open(io.BytesIO(data)).verify()
    except (ValueError, OSError, SyntaxError, zipfile.BadZipFile):
        return False
    return len(data) > 0


def _hear_ctrl_c() -> None:
    """Let a program take Ctrl-C as in a terminal: what a shell starts in the background ignores it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@dataclass
class Known:
    """What an undisturbed run of a command takes and writes."""

    arguments: list[str]
    old: tuple[str, ...]
    seconds: float
    status: int
    results: dict[str, bytes]
    is_fixed: dict[str, bool] = field(default_factory=dict)


class Soak:
    """The folder in which all is done, and what was found."""

    def __init__(self, folder: Path, chance: random.Random) -> None:
        self.folder, self.chance = folder, chance
        self.given, self.work = folder / "given", folder / "work"
        self.given.mkdir()
        inputs(self.given)
        self.before = contents(self.given)
        self.mark = f"{os.getpid()}.{time.time_ns()}"
        self.findings: list[str] = []
        self.outcomes: Counter[str] = Counter()
        self.waits: dict[str, list[float]] = {name: [] for name in SIGNALS}
        self.leftovers = 0

    def fresh(self, old: tuple[str, ...] = ()) -> None:
        """Lay the inputs out anew."""
        shutil.rmtree(self.work, ignore_errors=True)
        shutil.copytree(self.given, self.work)
        for name in old:
            (self.work / name).write_bytes(OLD)

    def start(self, arguments: list[str]) -> subprocess.Popen[str]:
        """Start the program in the folder."""
        return subprocess.Popen(
            [sys.executable, "-m", "voxflat.cli", *arguments],
            cwd=self.work,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            env={**CALLERS, MARK: self.mark, "MPLBACKEND": "agg"},
            preexec_fn=_hear_ctrl_c,
        )

    def undisturbed(self, command: str, old: tuple[str, ...]) -> Known:
        """Run a command twice, for what it writes and what of that is the same each time."""
        arguments, runs, seconds, status = command.split(), [], [], 0
        for _ in range(2):
            self.fresh()
            start = time.monotonic()
            process = self.start(arguments)
            told = process.communicate(timeout=10 * DEADLINE)[1]
            seconds.append(time.monotonic() - start)
            status = process.returncode
            if status not in (0, 1) or (status == 1 and command.split()[0] != "check"):
                raise SystemExit(f"voxflat {command} fails: {told}")
            runs.append({name: data for name, data in contents(self.work).items() if self.before.get(name) != data})
        same = {name: data == runs[1].get(name) for name, data in runs[0].items()}
        return Known(arguments, old, min(seconds), status, runs[0], same)

    def compare(self, known: Known, how: str, old: tuple[str, ...], *, is_over: bool) -> list[str]:
        """Return what is wrong with the files of the folder: after an interruption, or when the command has ended."""
        wrong, now = [], contents(self.work)
        store = "store/" if "--store" in known.arguments else None
        for name, data in self.before.items():
            if name not in known.results and now.get(name) != data:
                wrong.append(f"{name} was {'changed' if name in now else 'lost'}")
        for name in old:
            if name not in now:
                wrong.append(f"the old {name} was lost")
        for name, data in now.items():
            if name in self.before and data == self.before[name]:
                continue
            if not is_over and ((name in old and data == OLD) or (store and name.startswith(store))):
                continue
            if TEMPORARY.search(name):
                if how == "kill":
                    self.leftovers += not is_over
                    continue
                wrong.append(f"{name} was left")
            elif name not in known.results:
                wrong.append(f"{name} was left")
            elif known.is_fixed[name] and data != known.results[name]:
                wrong.append(f"{name} is neither old nor new")
            elif not is_whole(name, data):
                wrong.append(f"{name} is cut short")
        if is_over:
            wrong += [f"{name} is missing" for name in known.results if name not in now]
        return wrong

    def survivors(self) -> list[str]:
        """Return what processes of ours are left after a moment, and end them."""
        end = time.monotonic() + 10
        while True:
            left = []
            for process in psutil.process_iter():
                try:
                    if process.environ().get(MARK) == self.mark and process.status() != psutil.STATUS_ZOMBIE:
                        left.append(process)
                except (psutil.Error, OSError):
                    continue
            if not left or time.monotonic() > end:
                break
            time.sleep(0.05)
        told = [" ".join(process.cmdline())[-80:] for process in left]
        for process in left:
            process.kill()
        return told

    def case(self, name: str, known: Known, how: str) -> None:
        """Interrupt a command once."""
        old = known.old if self.chance.random() < 0.5 else ()
        after = self.chance.uniform(0, 1.05 * known.seconds)
        self.fresh(old)
        process = self.start(known.arguments)
        wrong: list[str] = []
        try:
            told = process.communicate(timeout=after)[1]
        except subprocess.TimeoutExpired:
            sent = time.monotonic()
            process.send_signal(SIGNALS[how])
            try:
                told = process.communicate(timeout=DEADLINE)[1]
                self.waits[how].append(time.monotonic() - sent)
            except subprocess.TimeoutExpired:
                process.kill()
                told = process.communicate()[1]
                wrong.append(f"went on for {DEADLINE:g} s")
        number = SIGNALS[how]
        ended = {-number: "ended by it", 128 + number: "tidied up", known.status: "was done before"}
        if process.returncode not in ended:
            wrong.append(f"status {process.returncode}: {told.strip()[-300:]}")
        elif not all(line.startswith("voxflat: ") for line in told.splitlines()):
            wrong.append(f"said {told.strip()[-600:]!r}")
        self.outcomes[f"{how}: {ended.get(process.returncode, 'failed')}"] += 1
        wrong += [f"still runs: {line}" for line in self.survivors()]
        wrong += self.compare(known, how, old, is_over=False)
        if name in COMPLETE and COMPLETE[name] in {path.name for path in self.work.iterdir()}:
            shutil.rmtree(self.work / COMPLETE[name])  # it is there already, and directories are not replaced
        again = self.start(known.arguments)
        try:
            told = again.communicate(timeout=10 * DEADLINE)[1]
        except subprocess.TimeoutExpired:
            again.kill()
            told = again.communicate()[1]
        if again.returncode != known.status:
            wrong.append(f"the same call again: status {again.returncode}: {told.strip()[-300:]}")
        wrong += self.compare(known, how, (), is_over=True)
        self.findings += [f"{name}, {how} after {after:.3f} s: {text}" for text in dict.fromkeys(wrong)]


def main() -> None:
    """Interrupt all commands in turn."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--each", type=int, default=100, help="cases of each signal")
    parser.add_argument("--commands", nargs="+", choices=COMMANDS, default=list(COMMANDS))
    parser.add_argument("--seed", type=int, default=0)
    asked: Any = parser.parse_args()
    chance = random.Random(asked.seed)
    with tempfile.TemporaryDirectory() as directory:
        soak = Soak(Path(directory), chance)
        known = {}
        for name in asked.commands:
            known[name] = soak.undisturbed(*COMMANDS[name])
            changing = [file for file, is_fixed in known[name].is_fixed.items() if not is_fixed]
            print(f"{name}: {known[name].seconds:.1f} s, {len(known[name].results)} files, {changing}", flush=True)
        for number in range(asked.each):
            for how in SIGNALS:
                name = asked.commands[(number + 7 * list(SIGNALS).index(how)) % len(asked.commands)]
                seen = len(soak.findings)
                if sys.stderr.isatty():
                    print(f"{number:4} {how:7}{name}", end="\r", file=sys.stderr)
                soak.case(name, known[name], how)
                for finding in soak.findings[seen:]:
                    print(f"  {finding}", flush=True)
    for outcome, count in sorted(soak.outcomes.items()):
        print(f"{count:5} {outcome}")
    for how, waits in soak.waits.items():
        if waits:
            print(f"{how}: {statistics.median(waits):.2f} s until it had ended, {max(waits):.2f} s at most")
    print(f"{soak.leftovers} temporary files after kills, which no later run minds")
    total = asked.each * len(SIGNALS)
    print(f"{total} signals to {len(asked.commands)} commands: {len(soak.findings)} findings")
    sys.exit(bool(soak.findings))


if __name__ == "__main__":
    main()
