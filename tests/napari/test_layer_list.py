"""Layers are added to the list step by step, and their OpenGL objects are deleted in the right context."""

import numpy as np
import pytest
from napari.layers import Image, Points, Surface
from napari_window import PATIENCE
from qtpy.QtGui import QOpenGLContext
from vispy.gloo.glir import GlirProgram

from voxflat._napari.results.layer_list import insert, make_room


@pytest.mark.parametrize("dock", ["Check surface", "Flat map", "Measure map"])
def test_opengl_objects_of_a_layer_are_deleted_in_the_context_of_the_canvas(open_widget, qtbot, monkeypatch, dock):
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
    own.doneCurrent()  # between two frames another context is current, or none
    viewer.layers.pop()
    viewer.layers.clear()
    assert contexts["delete"]
    assert all(context is own.context() for context in contexts["draw"] + contexts["delete"])


@pytest.mark.parametrize(
    "layer",
    [
        Image(np.eye(90), scale=(0.25, 0.25), translate=(-200, 30), units="mm"),
        Image(np.zeros((9, 9, 9)), translate=(0, 50, 0), units="mm"),
    ],
    ids=["flat", "in space"],
)
def test_sliders_are_extended_before_a_layer_is_added(open_widget, layer):
    corners = 40 * np.array([[0, 0, 0], [0, 1, 0], [1, 0, 1.0]])
    viewer, _ = open_widget(Surface((corners, np.array([[0, 1, 2]])), units="mm"))
    before, changes = viewer.dims.range, []
    make_room(viewer, layer)
    assert viewer.dims.range != before
    viewer.dims.events.range.connect(changes.append)
    insert(viewer, layer)
    assert not changes  # so that layers are not sliced again in the same step
    viewer.layers.remove(layer)
    assert viewer.dims.range == before


def test_a_layer_with_more_dimensions_extends_the_sliders(make_napari_viewer):
    viewer = make_napari_viewer()
    before = viewer.dims.range
    make_room(viewer, Image(np.zeros((4, 4, 4))))
    assert viewer.dims.range == before
