"""Flatten the demo cortex in napari's window, and take a picture of it: docs/pictures/napari.png.

Needs a display, or ``xvfb-run -s "-screen 0 1600x1000x24" python docs/gallery/napari_window.py``.
"""

from __future__ import annotations

import time
from pathlib import Path

import napari
from qtpy.QtWidgets import QApplication

from voxflat import demo
from voxflat._napari.map_viewer.dock import open_flat_map

PICTURE = Path(__file__).parents[1] / "pictures" / "napari.png"


def wait(seconds: float) -> None:
    """Let the window live."""
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        QApplication.processEvents()
        time.sleep(0.01)


def main() -> None:
    """Open the sample, flatten it as a user does, and write the picture."""
    viewer = napari.Viewer()
    wait(0.5)
    viewer.window.resize(1600, 960)
    viewer.open_sample("voxflat", "demo_cortex")
    _, widget = viewer.window.add_plugin_dock_widget("voxflat", "Flatten surface")
    wait(1)  # until the labels are listed
    widget.form.sample_depth.setValue(demo.DEPTH)  # right at the border of white matter T1 is the same everywhere
    widget.start.click()
    while not widget.start.isEnabled():
        wait(0.1)
    if widget.results.flat_map is None:
        raise SystemExit(widget.status.text())
    dock = open_flat_map(viewer)
    while not dock.is_drawn:
        wait(0.1)
    wait(1)
    PICTURE.parent.mkdir(exist_ok=True)
    viewer.screenshot(PICTURE, canvas_only=False, flash=False)
    viewer.close()


if __name__ == "__main__":
    main()
