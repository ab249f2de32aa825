"""What this plugin costs when napari starts: CPU time of fresh processes, with its manifest and without it."""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys

_START = """
import importlib.metadata, json, os, sys, time
os.environ["QT_QPA_PLATFORM"] = "offscreen"
left_out = "voxflat" if sys.argv[1] == "without" else ""
found = importlib.metadata.distributions
importlib.metadata.distributions = lambda **how: (one for one in found(**how) if one.name != left_out)
import napari.viewer
from napari._qt.qt_event_loop import get_qapp
from napari._app_model import get_app_model
get_qapp()
from napari.plugins import _initialize_plugins
from npe2 import PluginManager
start = time.process_time()
_initialize_plugins()
manifests = time.process_time() - start
assert ("voxflat" in PluginManager.instance()) == (sys.argv[1] == "with")
imported = sum(name.split(".")[0] == "voxflat" for name in sys.modules)
start = time.process_time()
viewer = napari.Viewer(show=False)
window = time.process_time() - start
dock = 0.0
if sys.argv[1] == "with":
    imported = sum(name.split(".")[0] == "voxflat" for name in sys.modules)
    start = time.process_time()
    import voxflat._napari.widgets.flatten_surface
    dock = time.process_time() - start
print(json.dumps({"manifests": manifests, "window": window, "imports": dock, "imported": imported}), flush=True)
os._exit(0)
"""


def started(how: str) -> dict[str, float]:
    """Start napari in a process of its own, with this plugin or without it; return seconds of CPU time."""
    run = subprocess.run([sys.executable, "-c", _START, how], check=True, capture_output=True, text=True)
    told: dict[str, float] = json.loads(run.stdout.splitlines()[-1])
    return told


def main() -> None:
    """Start napari again and again, in turn with and without this plugin."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=10)
    times = parser.parse_args().times
    for how in ("with", "without"):
        started(how)  # bytecode, and what the system keeps of files
    runs = [(started("with"), started("without")) for _ in range(times)]
    for name, what in (("manifests", "manifests of all plugins"), ("window", "the window, not shown")):
        ours, others = ([1000 * run[which][name] for run in runs] for which in (0, 1))
        print(
            f"{what}: {statistics.median(ours):.0f} ms of CPU time with voxflat ({min(ours):.0f} to {max(ours):.0f}), "
            f"{statistics.median(others):.0f} without ({min(others):.0f} to {max(others):.0f})"
        )
    print(f"modules of voxflat that are imported by then: {max(ours['imported'] for ours, _ in runs)}")
    imports = [1000 * ours["imports"] for ours, _ in runs]
    print(f"the imports of the first dock, when it opens: {statistics.median(imports):.0f} ms")
    print(f"medians of {times}, load {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
