"""What goes with a layer is deleted where the viewer draws, which napari does not see to.

When a layer goes napari (0.9) has vispy (0.16, 0.17) delete its programs, buffers and textures at once, in whatever
context of OpenGL is current: between two frames Qt's own, in which it puts the window together. Mesa's renderer in
software, which shares no compiled shaders between contexts, then draws one of the next frames without a vertex shader,
which ends the process.
"""

import weakref
from contextlib import suppress
from typing import Any

from napari import Viewer


def keep_canvas_current(viewer: Viewer) -> None:
    """Make the canvas's context current before each layer of a viewer, not its proxy, goes, while both live."""
    qt_viewer = getattr(getattr(viewer, "window", None), "_qt_viewer", None)
    canvas = getattr(getattr(qt_viewer, "canvas", None), "native", None)
    if not hasattr(canvas, "makeCurrent"):
        return

    kept = weakref.ref(canvas)

    def make_current(_: Any) -> None:
        canvas = kept()
        with suppress(RuntimeError):  # Qt may have deleted it, as the window closes
            if canvas is not None and canvas.isValid():  # valid once it was shown
                canvas.makeCurrent()

    viewer.layers.events.removing.connect(make_current)  # napari deletes at `removed`, before what others do there
