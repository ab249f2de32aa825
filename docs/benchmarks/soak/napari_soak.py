"""What random use of napari's window leaves behind: cancels at random moments, 30 maps, 200 sequences of actions.

Needs a display, or ``xvfb-run -s "-screen 0 1600x1000x24" python docs/benchmarks/soak/napari_soak.py``.
"""

from __future__ import annotations

import argparse
import copy
import ctypes
import gc
import os
import random
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import napari
import numpy as np
import psutil
from qtpy.QtCore import QEvent, QThreadPool
from qtpy.QtWidgets import QApplication

import voxflat
from voxflat._napari.layers.sampled import Overlay
from voxflat._napari.map_viewer.dock import open_flat_map
from voxflat._napari.results.flat_layers import Run
from voxflat._napari.results.maps import map_layers
from voxflat._napari.viewer_state import ViewerState

_MACHINE = Path(__file__).parents[3] / "tests" / "napari" / "test_napari_machine.py"


class _MallInfo(ctypes.Structure):
    """glibc's `mallinfo2`, bytes."""

    _names = ("arena", "ordblks", "smblks", "hblks", "hblkhd", "usmblks", "fsmblks", "uordblks", "fordblks", "keepcost")
    _fields_ = [(name, ctypes.c_size_t) for name in _names]


def megabytes() -> tuple[float, float]:
    """Return the memory that is resident once what is free was given back, and what of it is allocated, if glibc tells.

    glibc keeps free blocks in a heap of each thread, which it does not give back; what is allocated tells of leaks.
    """
    for _ in range(3):
        gc.collect()
        live(0.05)
    allocated = float("nan")
    glibc = ctypes.CDLL(None) if sys.platform == "linux" else None
    if hasattr(glibc, "mallinfo2"):
        glibc.malloc_trim(0)
        glibc.mallinfo2.restype = _MallInfo
        told = glibc.mallinfo2()
        allocated = (told.uordblks + told.hblkhd) / 1e6
    return psutil.Process().memory_info().rss / 1e6, allocated


def left(viewer: napari.Viewer) -> dict[str, Any]:
    """Return what might be left behind: threads, files, layers."""
    ours = psutil.Process()
    return {
        "threads": sorted(thread.name for thread in threading.enumerate()),
        "system's threads": ours.num_threads(),
        "busy threads": QThreadPool.globalInstance().activeThreadCount(),
        "open files": sorted(file.path for file in ours.open_files()),
        "temporary files": sorted(os.listdir(tempfile.gettempdir())),
        "layers": [layer.name for layer in viewer.layers],
    }


def cancels(times: int, points: int) -> None:
    """Cancel at random moments, and tell what is left."""
    viewer = napari.Viewer()
    points_, faces, values = sheet(points)
    viewer.add_surface((points_, faces, values), name="sheet", units="mm")
    _, widget = viewer.window.add_plugin_dock_widget("voxflat", "Flatten surface")

    def run(seconds: float | None) -> float:
        """Flatten, and cancel after so many seconds; return how long it went on after that, or in all."""
        widget.start.click()
        live(0 if seconds is None else seconds)
        start = time.perf_counter()
        if seconds is not None:
            widget.stop.click()
        while not (widget.start.isEnabled() and ViewerState.of(viewer).is_settled):
            live(0.005)
        return time.perf_counter() - start

    run(None)
    whole = run(None)  # the first also opens the map's dock
    for run_of in ViewerState.of(viewer).runs:
        ViewerState.of(viewer).remove(run_of)
    live(1)
    before, chance, took, done = left(viewer), random.Random(0), [], 0
    for _ in range(times):
        took.append(run(chance.uniform(0, whole)))
        if ViewerState.of(viewer).current is not None:  # it was just done
            done += 1
            ViewerState.of(viewer).remove(ViewerState.of(viewer).current)
    live(1)
    after = left(viewer)
    print(f"{times} cancels within {whole:.1f} s of a run, {done} too late; the longest took {max(took):.2f} s")
    for name in before:
        print(f"  {name:17} {'as before' if after[name] == before[name] else f'{before[name]} -> {after[name]}'}")
    viewer.close()


def maps(times: int, points: int) -> None:
    """Let maps take each other's place, and tell the memory that is taken."""
    vertices, faces, values = sheet(points)
    flat_map = voxflat.flatten((vertices, faces), method=voxflat.methods.Voxflat(sources=50))
    flat_map.metadata["napari"] = {"layer": "sheet", "world_axes": "RAS", "unit": "millimeter"}
    viewer = napari.Viewer()
    viewer.window.resize(1600, 960)
    viewer.add_surface((vertices, faces, values), name="sheet", units="mm")
    viewer.add_image(np.random.default_rng(0).random((200, 200, 60), dtype=np.float32), name="volume", units="mm")
    dock, state, taken = open_flat_map(viewer), ViewerState.of(viewer), []
    for _ in range(times):
        state.add(Run(map_layers(copy.deepcopy(flat_map), "sheet", Overlay("sheet", values)), "sheet"))
        live(0.1)
        while not (state.is_settled and dock.is_drawn):
            live(0.02)
        taken.append(megabytes())
    for what, values in zip(("resident", "allocated"), zip(*taken, strict=True), strict=True):
        print(f"{times} maps of {points:,} points, MB {what} after each: {' '.join(f'{mb:.0f}' for mb in values)}")
        settled = [100 * (mb / values[min(2, times - 1)] - 1) for mb in values[2:]]
        print(f"  from the third: {settled[-1]:+.1f} % at the end, {min(settled):+.1f} to {max(settled):+.1f} between")
    print(f"  layers: {len(viewer.layers)}, widgets: {len(QApplication.allWidgets())}")
    viewer.close()


def live(seconds: float) -> None:
    """Let the window live."""
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        QApplication.processEvents()
        QApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)  # which only a loop of Qt's own does
        time.sleep(0.001)


def sheet(points: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a bumpy sheet of about so many points, 1 mm apart, with values."""
    size = round(points**0.5)
    i, j = np.mgrid[:size, :size]
    height = 4 * np.sin(i / 6) * np.cos(j / 8)
    corner = (i[:-1, :-1] * size + j[:-1, :-1]).ravel()
    lower = np.stack([corner, corner + size, corner + 1], axis=1)
    upper = np.stack([corner + 1, corner + size, corner + size + 1], axis=1)
    vertices = np.stack([1.0 * i, 1.0 * j, height], axis=-1).reshape(-1, 3)
    return vertices, np.concatenate([lower, upper]), height.ravel()


def main() -> None:
    """Cancel, flatten again and again, and do whatever comes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cancels", type=int, default=20)
    parser.add_argument("--maps", type=int, default=30)
    parser.add_argument("--points", type=int, default=150_000, help="of each map")
    parser.add_argument("--sequences", type=int, default=200)
    asked = parser.parse_args()
    if asked.cancels:
        cancels(asked.cancels, asked.points // 8)
    if asked.maps:
        maps(asked.maps, asked.points)
    if asked.sequences:  # in a process of their own, whose crash would be told
        command = [sys.executable, "-m", "pytest", "-q", "-x", str(_MACHINE), "--sequences", str(asked.sequences)]
        sys.exit(subprocess.run(command, check=False).returncode)


if __name__ == "__main__":
    main()
