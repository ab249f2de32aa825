"""Where programs of OpenGL are deleted when layers go."""

import numpy as np
import pytest
from napari.layers import Image, Points
from napari_window import PATIENCE
from qtpy.QtGui import QOpenGLContext
from vispy.gloo.glir import GlirProgram

pytestmark = pytest.mark.slow  # a window


@pytest.mark.parametrize("dock", ["Check surface", "Flat map", "Measure map"])
def test_what_goes_with_a_layer_is_deleted_where_the_viewer_draws(open_widget, qtbot, monkeypatch, dock):
    contexts = {"draw": [], "delete": []}

    def watch(name, method):
        def watched(*given):
            contexts[name].append(QOpenGLContext.currentContext())
            return method(*given)

        monkeypatch.setattr(GlirProgram, name, watched)

    watch("draw", GlirProgram.draw)
    watch("delete", GlirProgram.delete)
    viewer, _ = open_widget(Image(np.eye(9)), Points([[5, 5], [6, 6]]), show=True, name=dock)
    own = viewer.window._qt_viewer.canvas.native
    qtbot.waitUntil(lambda: len(contexts["draw"]) >= 2, timeout=PATIENCE)
    own.doneCurrent()  # between two frames another one is current, or none
    viewer.layers.pop()
    viewer.layers.clear()
    assert contexts["delete"]
    assert all(context is own.context() for context in contexts["draw"] + contexts["delete"])
