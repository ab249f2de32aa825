"""From files to a map and back, in the real window, with menus and clicks only.

``--pictures FOLDER`` (``make pictures``) saves the pictures of docs/napari.md, and flattens the complete demo cortex.
"""

from itertools import product

import nibabel as nib
import numpy as np
import pytest
from mesh_files import fsaverage5
from napari_clicks import Hand
from napari_window import wait_for_threads, wait_until_drawn
from numpy.testing import assert_array_equal
from qtpy.QtCore import QPoint, Qt
from qtpy.QtWidgets import QApplication
from scipy.spatial import ConvexHull

import voxflat
from voxflat._napari.map_viewer.viewer_parts import canvas_widget
from voxflat._napari.viewer_state import ViewerState
from voxflat.io import Mesh, Space, VolumeGeometry, write_mesh

FSAVERAGE2 = 162  # whose vertices are the first of fsaverage5's
SMALL, LARGE = (1366, 768), (1600, 1000)
THEMES = ("dark", "light")


@pytest.fixture
def pictures(request, tmp_path):
    """The folder for pictures of the window."""
    return request.config.getoption("pictures") or tmp_path / "pictures"


@pytest.fixture
def window(make_napari_viewer, qtbot):
    """A function that opens a window of a size, and returns the viewer and a simulated user."""

    def opened(size):
        viewer = make_napari_viewer(show=True)
        viewer.window._qt_window.resize(*size)
        viewer.theme = "dark"
        wait_until_drawn(viewer, qtbot)
        return viewer, Hand(viewer.window, qtbot)

    yield opened
    wait_for_threads(qtbot)


@pytest.fixture
def look(request, tmp_path):
    """A function that checks that widgets are fully visible, in another size and theme each time."""
    in_all = request.config.getoption("pictures") is not None
    seen = []

    def looked(hand, viewer, name, *parts):
        window = viewer.window._qt_window
        before = window.size(), viewer.theme
        looks = product((SMALL, LARGE), THEMES) if in_all else [((SMALL, "dark"), (LARGE, "light"))[len(seen) % 2]]
        for size, theme in looks:
            window.resize(*size)
            viewer.theme = theme
            hand.wait(lambda size=size: (window.width(), window.height()) == size)
            for part in parts:
                hand.wait(lambda part=part: part.visibleRegion().boundingRect() == part.rect())
            hand.picture(tmp_path / f"{name}_{size[0]}_{theme}.png")
        seen.append(name)
        if in_all:
            window.resize(before[0])
            viewer.theme = before[1]
            hand.wait(lambda: window.size() == before[0])

    return looked


@pytest.fixture
def hemisphere(request):
    """A function that reads the left hemisphere of fsaverage5, or of a coarser mesh without `--pictures`."""

    def read(name):
        points, faces = nib.load(fsaverage5(f"{name}_left")).agg_data(("pointset", "triangle"))
        if request.config.getoption("pictures") is not None:
            return points, faces
        sphere = nib.load(fsaverage5("sphere_left")).agg_data("pointset")[:FSAVERAGE2]
        faces = ConvexHull(sphere).simplices
        a, b, c = np.moveaxis(sphere[faces], 1, 0)
        turned = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0
        faces[turned] = faces[turned, ::-1]
        return points[:FSAVERAGE2], faces

    return read


@pytest.fixture
def subject(tmp_path, hemisphere):
    """A FreeSurfer folder with a left hemisphere."""
    surf = tmp_path / "subject" / "surf"
    surf.mkdir(parents=True)
    space = Space("tkRAS", VolumeGeometry.conformed())
    for name, ours in (("white", "white"), ("pial", "pial"), ("infl", "inflated"), ("sphere", "sphere.reg")):
        points, faces = hemisphere(name)
        write_mesh(surf / f"lh.{ours}", Mesh(points, faces, space=space))
    between = np.linalg.norm(hemisphere("pial")[0] - hemisphere("white")[0], axis=1)
    nib.freesurfer.write_morph_data(surf / "lh.thickness", between.astype(np.float32))
    return surf


def dock(viewer, name):
    return viewer.window.dock_widgets[f"{name} (voxflat)"]


def open_files(hand, viewer, *paths):
    for path in paths:
        before = len(viewer.layers)
        hand.answer(path)
        hand.menu("File", "Open File(s)")
        hand.wait(lambda before=before: len(viewer.layers) > before)


def flatten(hand, viewer):
    """Press *Flatten surface*, and wait for the map."""
    widget = dock(viewer, "Flatten surface")
    hand.press(widget.start)
    hand.wait(widget.start.isEnabled)
    assert ViewerState.of(viewer).current is not None, widget.status.text()
    flat = dock(viewer, "Flat map")
    hand.wait(lambda: flat.is_drawn)
    return flat


def show(hand, flat, name):
    hand.choose(flat.contents, name)
    hand.wait(lambda: flat.is_drawn)


def point_at(hand, flat, row):
    """Point into a triangle at a vertex until the line below the map describes the place."""
    flat_map = flat.prepared.run.flat_map
    u, v = flat_map.uv[flat_map.faces[(flat_map.faces == row).any(axis=1)][0]].mean(axis=0)

    def told():
        hand.move(flat.canvas.viewport(), flat.canvas.position(u, v))
        return any(f" {unit} · " in flat.text.text() for unit in ("mm", "µm"))

    hand.wait(told)


def parts_of(flat):
    """The widgets of the dock *Flat map* that must always be visible."""
    return flat.canvas, flat.legend, flat.text, flat.contents, flat.on_surface, flat.outlined, flat.whole, flat.keep


def test_a_freesurfer_directory(window, subject, pictures, look, tmp_path):
    viewer, hand = window(SMALL)
    open_files(hand, viewer, *(subject / f"lh.{name}" for name in ("pial", "inflated", "white", "thickness")))
    hand.menu("Layers", "Transform", "Flatten surface (voxflat)")
    widget = dock(viewer, "Flatten surface")
    chosen = widget.form.surface, widget.form.pial, widget.form.sampled
    assert [choice.currentText() for choice in chosen] == ["lh.white", "lh.pial", "lh.thickness"]
    assert "standard cuts, located by lh.sphere.reg" in widget.form.plan.text()
    widget.form.surface.choose(viewer.layers["lh.pial"])
    assert widget.form.pial.layer is None  # it lies there itself
    assert "midway" not in widget.form.plan.text()
    widget.form.surface.choose(viewer.layers["lh.white"])
    viewer.layers["lh.pial"].visible = False  # it covers the thickness
    hand.picture(pictures / "napari_form.png")
    look(hand, viewer, "form", widget.start, widget.form.surface, widget.form.plan)
    flat = flatten(hand, viewer)
    flat_map = ViewerState.of(viewer).current.flat_map
    assert flat_map.metadata["cuts_by"] == "standard"
    expected = voxflat.surface(str(subject / "lh.white"), pial=str(subject / "lh.pial"))
    assert_array_equal(flat_map.uv, voxflat.flatten(expected).uv)
    assert flat.contents.currentText() == "lh.thickness"
    show(hand, flat, "Distances")
    hand.wheel(canvas_widget(flat), -5)  # because the dock leaves less room
    point_at(hand, flat, len(flat_map) // 2)
    assert (flat.prepared.side, {one.letter for one in flat.prepared.directions}) == ("L", {"A", "S"})
    hand.picture(pictures / "napari_map.png")
    look(hand, viewer, "map", *parts_of(flat))
    show(hand, flat, "lh.thickness")
    hand.picture(pictures / "napari_thickness.png")
    show(hand, flat, "Areas")
    hand.picture(tmp_path / "napari_areas.png")

    # cuts of one's own
    hand.menu("Layers", "Transform", "Draw cuts (voxflat)")
    cuts = dock(viewer, "Draw cuts")
    hand.choose(cuts.form.surface, "lh.white")
    assert cuts.form.shown_on.currentText() == "lh.inflated"
    for button in (cuts.begin, cuts.automatic):
        hand.press(button)
        hand.wait(cuts.begin.isEnabled)
    found = len(cuts.drawing.cuts)
    assert found > 2
    canvas = canvas_widget(cuts)
    for shift in (-30, 30):
        hand.click(canvas, QPoint(canvas.width() // 2 + shift, canvas.height() // 2))
    assert len(cuts.drawing.cuts) == found + 1
    hand.press(cuts.evaluate)
    hand.wait(cuts.begin.isEnabled)
    assert all("%" in cuts.cuts.item(row, 2).text() for row in range(found))
    hand.picture(pictures / "napari_cuts.png")
    look(hand, viewer, "cuts", cuts.begin, cuts.cuts, cuts.use, cuts.status)
    hand.press(cuts.undo)
    hand.press(cuts.undo)
    assert len(cuts.drawing.cuts) == found
    hand.press(cuts.use)
    viewer.window.remove_dock_widget(cuts)
    assert "along the drawn lines" in widget.form.plan.text()

    # the script does the same without a window
    widget.parentWidget().raise_()
    hand.wait(widget.results.copy.isVisible)
    widget.scrolled.ensureWidgetVisible(widget.results.copy)
    hand.press(widget.results.copy)
    script = QApplication.clipboard().text()
    assert ".flatten(" in script
    assert f"read_overlay({str(subject / 'lh.thickness')!r}" in script  # all lies in files: nothing is asked

    # saved by the menu, and opened again in an empty window
    viewer.layers.selection = {next(layer for layer in viewer.layers if layer.name.endswith("distortion"))}
    saved = tmp_path / "mine.voxflat"
    hand.answer(saved, kind="voxflat flat map")
    hand.menu("File", "Save Selected Layers")
    hand.wait(saved.is_file)
    viewer.layers.clear()
    open_files(hand, viewer, saved)
    assert_array_equal(ViewerState.of(viewer).current.flat_map.uv, flat_map.uv)
    again = dock(viewer, "Flat map")
    hand.wait(lambda: again.is_drawn)


def test_the_demo_cortex(window, pictures, look, request):
    viewer, hand = window(LARGE)
    hand.menu("File", "Open Sample", "voxflat", "Demo cortex (MNI152)")
    hand.wait(lambda: len(viewer.layers) == 3)
    hand.menu("Layers", "Transform", "Flatten surface (voxflat)")
    widget = dock(viewer, "Flatten surface")
    hand.wait(lambda: "points" in widget.form.plan.text())
    assert widget.form.sampled.currentText() == "T1"
    if request.config.getoption("pictures") is None:  # a hemisphere takes a minute and a half
        hand.choose(widget.form.patch, "disk")
        hand.type(widget.form.radius, "15")
    flat = flatten(hand, viewer)
    assert flat.contents.currentText() == "T1"
    hand.wheel(canvas_widget(flat), -1)
    point_at(hand, flat, len(flat.prepared.run.flat_map) // 2)
    hand.picture(pictures / "napari.png")
    look(hand, viewer, "demo", *parts_of(flat))


def test_a_rim(window, pictures, look, tmp_path, qtbot):
    viewer, hand = window(SMALL)
    hand.menu("File", "Open Sample", "voxflat", "Demo rim (synthetic gyrus)")
    hand.menu("Layers", "Transform", "Flatten surface (voxflat)")
    widget = dock(viewer, "Flatten surface")
    hand.wait(lambda: widget.form.label.rim == "rim")
    hand.picture(tmp_path / "rim_form.png")
    flat = flatten(hand, viewer)
    uv = flat.prepared.run.flat_map.uv
    hand.choose(flat.click, "draws a region")
    centre, size = (uv.min(axis=0) + uv.max(axis=0)) / 2, np.ptp(uv, axis=0)
    canvas = flat.canvas.viewport()
    for number, (low, high) in enumerate(((0.08, 0.42), (-0.42, -0.08)), 1):  # halves of the gyrus
        for shift in ((-0.4, low), (0.4, low), (0.4, high), (-0.4, high)):
            last = flat.canvas.position(*(centre + size * shift))
            hand.click(canvas, last)
        qtbot.mouseDClick(canvas, Qt.MouseButton.LeftButton, pos=last)
        hand.wait(lambda number=number: f"The map has {number} region" in flat.text.text())
    hand.picture(tmp_path / "rim_map.png")

    hand.menu("Layers", "Measure", "Cortical depth (voxflat)")
    depth = dock(viewer, "Cortical depth")
    hand.wait(lambda: depth.form.label.rim == "rim")
    assert [box.currentText() for box in (depth.form.sampled, depth.form.regions)] == ["activity", "rim regions"]
    for button in (depth.layers, depth.measure):
        hand.press(button)
        hand.wait(button.isEnabled)
    assert depth.profile.names == ("region 1", "region 2")
    hand.picture(pictures / "napari_layers.png")
    look(hand, viewer, "depth", depth.layers, depth.measure, depth.status, depth.plot, depth.save)
    hand.press(depth.flatten)
    hand.wait(depth.flatten.isEnabled)
    shown = depth.flat_window.viewer
    assert shown.dims.axis_labels[0] == "depth"
    height = np.ptp(shown.layers[0].extent.world[:, 1])
    hand.wait(lambda: height * shown.camera.zoom < shown.window._qt_viewer.canvas.size[0])  # all of the map is visible
    assert shown.window._qt_window.grab().save(str(tmp_path / "flat_volume.png"))


def test_a_movie(window, pictures, look, tmp_path):
    """Flatten all frames, paint a cell on the flat movie, and find it in the volume at another time."""
    viewer, hand = window(SMALL)
    hand.menu("File", "Open Sample", "voxflat", "Synthetic embryo")
    hand.menu("Layers", "Transform", "Flatten surface (voxflat)")
    widget = dock(viewer, "Flatten surface")
    hand.wait(lambda: "voxels" in widget.form.label.currentText())
    assert widget.form.frames.currentText() == "all, on one map"
    assert widget.form.sampled.currentText() == "nuclei"
    viewer.dims.set_current_step(0, 0)
    flat = flatten(hand, viewer)
    flat.depths.setValue(-4)
    hand.press(flat.movie)
    hand.wait(flat.movie.isEnabled)
    shown = flat.movies.window.viewer
    shown._new_labels()
    cells = shown.layers[-1]
    flat_map = flat.prepared.run.flat_map
    cells.name, cells.brush_size = "cells", 14
    for number, x in enumerate((-50, 0, 50), 1):  # on the side that faces the camera
        u, v = flat_map.uv[np.linalg.norm(flat_map.points - (x, 0, 30), axis=1).argmin()]
        for frame in range(6):
            cells.paint(np.round(cells.world_to_data((frame, -v, u))), number)
    hand.press(flat.segmentations.send)
    hand.wait(lambda: "Added" in flat.text.text())
    viewer.dims.set_current_step(0, 5)
    viewer.dims.ndisplay = 3
    hand.press(flat.on_surface)
    hand.wait(lambda: flat.is_drawn)
    found = viewer.layers["cells in the volume"]
    assert [np.unique(frame).tolist() for frame in found.data] == [[0, 1, 2, 3]] * 6
    assert shown.dims.current_step[0] == 5
    viewer.layers["nuclei"].visible = False
    viewer.reset_view()
    point_at(hand, flat, int(np.linalg.norm(flat_map.points - (25, 10, 30), axis=1).argmin()))
    hand.picture(pictures / "napari_tissue.png")
    assert shown.window._qt_window.grab().save(str(tmp_path / "flat_movie.png"))
    look(hand, viewer, "movie", *parts_of(flat), flat.movie, flat.segmentations.send)
