"""Ensure that the OpenGL objects of removed layers are deleted in the context of the canvas.

When a layer is removed, napari (0.9) makes vispy (0.16, 0.17) delete its programs, buffers and textures immediately, in
the current OpenGL context. Between two frames, this is the context in which Qt composes the window. Mesa's software
renderer does not share compiled shaders between contexts; it then draws one of the next frames without a vertex shader,
which ends the process.
"""

import weakref
from contextlib import suppress
from typing import Any

from napari import Viewer


def keep_canvas_current(viewer: Viewer) -> None:
    """Make the canvas context current before any layer is removed; `viewer` must not be a proxy."""
    qt_viewer = getattr(getattr(viewer, "window", None), "_qt_viewer", None)
    canvas = getattr(getattr(qt_viewer, "canvas", None), "native", None)
    if not hasattr(canvas, "makeCurrent"):
        return
    reference = weakref.ref(canvas)

    def make_current(_: Any) -> None:
        canvas = reference()
        with suppress(RuntimeError):  # Qt may have deleted the canvas when the window was closed
            if canvas is not None and canvas.isValid():  # the canvas is valid once it has been shown
                canvas.makeCurrent()

    viewer.layers.events.removing.connect(make_current)  # napari deletes at `removed`, before other callbacks
