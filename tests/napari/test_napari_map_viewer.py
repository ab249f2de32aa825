"""The dock *Flat map* in a real window: its contents, and its link with the viewer."""

import gc
import json
import re

import dask.array as da
import nibabel as nib
import numpy as np
import pandas
import PIL.Image
import pytest
import tifffile
from napari.layers import Image, Labels, Surface
from napari.utils.colormaps import DirectLabelColormap
from napari_clicks import move
from napari_window import (
    PATIENCE,
    bumps,
    cap,
    choose,
    click_middle,
    map_dock,
    open_file,
    prepared_map_of,
    run,
    run_whole,
    sphere,
    wait_for_picture,
    wait_for_threads,
    wait_until_drawn,
)
from numpy.testing import assert_allclose, assert_array_equal
from qtpy.QtCore import QPoint, QRect, Qt
from qtpy.QtGui import QColor
from qtpy.QtWidgets import QApplication, QFileDialog, QWidget
from scipy.ndimage import maximum_filter, minimum_filter
from scipy.spatial import cKDTree

import voxflat
from voxflat._napari.files.writers import write_regions
from voxflat._napari.layers.world import WORLD
from voxflat._napari.map_viewer.drawings import put, regions
from voxflat._napari.map_viewer.viewer_parts import camera, canvas_widget, projected, show_sagittal
from voxflat._napari.results.flat_layers import Run
from voxflat._napari.results.maps import map_layers
from voxflat._napari.results.report import figures
from voxflat._napari.results.sketch import Sketch
from voxflat._napari.viewer_state import ViewerState
from voxflat.maps.colours import label_colour

SCALE, CORNER = np.array([2.0, 0.5, 3.0]), np.array([5.0, -40.0, 7.0])  # world's axes are y, x, z of LPS in "SPL" …


def to_map(dock, qtbot, u, v):
    move(qtbot, dock.canvas.viewport(), dock.canvas.position(u, v))


@pytest.mark.parametrize("unit", ["mm", "micrometer"])
def test_map_and_volume_are_linked(flattened, qtbot, unit):
    """Lookups in both directions, for a mesh in mm with the axes x, y, z, and one in µm with the axes z, y, x."""
    points, faces, values = bumps()
    factor = {"mm": 1.0, "micrometer": 1000.0}[unit]
    place = {"scale": factor * SCALE, "translate": factor * CORNER, "units": unit}
    volume = Image(np.random.default_rng(0).random((60, 60, 30)).astype(np.float32), name="v", **place)
    viewer, _, dock = flattened(volume, Surface((points, faces, values), name="bumps", **place))
    flat_map = dock.prepared.run.flat_map
    assert dock.prepared.unit == {"mm": "mm", "micrometer": "µm"}[unit]
    world = factor * (points * SCALE + CORNER)
    axes = {"mm": [0, 1, 2], "micrometer": [2, 1, 0]}[unit]  # of the world, for x, y and z
    u, v = flat_map.uv[int(np.flatnonzero(flat_map.ids == 12 * 25 + 12)[0])]

    # the map points: the ring is where the vertex is, in a slice of any depth and in 3D
    to_map(dock, qtbot, u, v)
    marked = dock.link.to_world(dock.link._marked)
    pixel = 1 / dock.canvas.scale_factor  # on the map; the surface is stretched by at most 3 here
    assert_allclose(marked, world[312], atol=6 * pixel)
    told = int(re.search(r"vertex (\d+) ", dock.text.text())[1])  # a pixel is half of what vertices are apart here
    assert any({312, told} <= set(triangle) for triangle in flat_map.ids[flat_map.faces].tolist())
    canvas = canvas_widget(dock)
    for ndisplay in (2, 3):
        viewer.dims.ndisplay = ndisplay
        viewer.reset_view()
        qtbot.wait(50)
        to_map(dock, qtbot, u, v)
        marked = dock.link.to_world(dock.link._marked)  # another place if the size of the dock has changed
        view = viewer.window._qt_viewer.canvas.view
        shown = [marked[axis] for axis in reversed(viewer.dims.displayed)]
        at = [*shown, 0, 1] if ndisplay == 2 else [*shown, 1]
        x, y, _, w = (view.transform * view.scene.transform).map(at)
        assert_allclose(projected(viewer, marked, (canvas.width(), canvas.height())), (x / w, y / w), atol=1)
        assert dock.link.ring.isVisible()
        centre = dock.link.ring.geometry().center()
        assert_allclose((centre.x(), centre.y()), (x / w, y / w), atol=2)
    # in 3D the mouse on the canvas over the vertex: the map shows its place
    camera(viewer).set_view_direction(view_direction=(0.1, 0.1, -1), up_direction=(0, -1, 0))
    camera(viewer).center = world[312]
    wait_until_drawn(viewer, qtbot)
    expected = flat_map.points_to_map(world[312][axes])[0]

    def ring():
        """Point at the middle of the canvas, and return where the ring of the map is."""
        move(qtbot, canvas, QPoint(canvas.width() // 2, canvas.height() // 2))
        return np.array([dock.canvas.ring.pos().x(), -dock.canvas.ring.pos().y()])

    # the sliders, that 3D has not, give their height to the canvas when Qt comes to it
    qtbot.waitUntil(lambda: np.abs(ring() - expected).max() < 1.5 * factor, timeout=PATIENCE)
    assert dock.canvas.ring.isVisible()

    # a click on the map: the slices go there
    viewer.dims.ndisplay = 2
    dock.canvas.fit()
    qtbot.mouseClick(dock.canvas.viewport(), Qt.MouseButton.LeftButton, pos=dock.canvas.position(u, v))
    assert_allclose(np.array(viewer.dims.point), world[312], atol=6 * pixel + factor)
    assert_allclose(np.array(camera(viewer).center)[-2:], world[312][1:], atol=6 * pixel)
    wait_until_drawn(viewer, qtbot)

    # and in the slice: the ring of the map comes to the middle
    there = np.array([viewer.dims.point[0], *camera(viewer).center[-2:]])  # the slice is that of a voxel
    expected = flat_map.points_to_map(there[axes])[0]
    qtbot.waitUntil(lambda: np.abs(ring() - expected).max() < 1.5 * factor, timeout=PATIENCE)
    found = ring()
    click_middle(canvas, qtbot)
    seen, viewport = dock.canvas.position(*found), dock.canvas.viewport()
    assert_allclose((seen.x(), seen.y()), (viewport.width() / 2, viewport.height() / 2), atol=3)
    move(qtbot, canvas, QPoint(2, 2))  # far from the surface
    assert not dock.canvas.ring.isVisible()


def test_the_view_does_not_change_and_layers_are_added_hidden(open_widget, qtbot):
    sheet, t1 = Labels(cap(), name="sheet"), Image(cap().astype(float), name="T1")
    viewer, widget = open_widget(sheet, t1, show=True)
    viewer.dims.ndisplay = 3
    viewer.dims.order = (2, 0, 1)
    viewer.dims.point = (5, 6, 7)
    viewer.layers["T1"].visible = False
    viewer.layers.selection = {viewer.layers["T1"]}
    viewer.reset_view()

    def state():
        of = camera(viewer)
        visible = {layer.name for layer in viewer.layers if layer.visible}
        return of.center, of.zoom, of.angles, *viewer.dims.order, viewer.dims.point, viewer.dims.ndisplay, visible

    before = state()
    run_whole(widget, qtbot)
    dock = map_dock(viewer, qtbot)
    assert state() == before
    assert set(viewer.layers.selection) == {viewer.layers["T1"]}
    assert [layer.name for layer in viewer.layers] == ["sheet", "T1", "sheet T1 flattened", "sheet distortion"]
    assert dock.contents.content is viewer.layers["T1"]
    wait_for_threads(qtbot)


def test_an_image_of_the_map_has_the_same_top_as_in_the_dock(flattened, qtbot):
    viewer, _, _ = flattened(Labels(cap(), name="sheet", units="mm"))
    show_sagittal(viewer)
    viewer.reset_view()
    flat = viewer.layers["sheet distortion"]
    height, width = flat.data.shape
    upper_left = np.zeros((height, width), dtype=np.float32)
    upper_left[: height // 2, : width // 2] = 1  # high v, low u

    def seen():
        of = camera(viewer)
        return viewer.dims.order, of.orientation2d, of.center, of.zoom

    before = seen()
    viewer.layers["sheet"].visible = False
    flat.data, flat.colormap, flat.contrast_limits = upper_left, "gray", (0, 1)
    flat.visible = True
    picture = viewer.screenshot(canvas_only=True, flash=False)[..., :3].mean(axis=2)
    middle = np.array(picture.shape) / 2
    where = np.argwhere(picture > 200).mean(axis=0)
    assert (where < middle).all()  # rows increase downwards, columns to the right
    flat.visible = False
    assert seen() == before
    flat.visible = True
    assert viewer.dims.order == (0, 1, 2)
    viewer.layers.remove(flat)
    assert seen() == before


def test_contents_of_the_map(flattened, qtbot):
    """Measures, layers that are added and change their display, depths, and time points of large series."""
    along = np.indices((24, 24, 24))[2].astype(np.float32)
    series = da.from_array(np.stack([along, 100 + along]), chunks=(1, 8, 8, 8))
    viewer, _, dock = flattened(Image(along, name="k"), Labels(cap(), name="sheet"))
    flat_map = dock.prepared.run.flat_map
    names = [dock.contents.itemText(n) for n in range(dock.contents.count())]
    assert names == ["Distances", "Areas", "Angles", "sheet", "k", "Folds only"]

    def shown(name):
        dock.contents.setCurrentIndex(dock.contents.findText(name))
        wait_for_picture(dock, qtbot)
        return dock.picture

    heat = shown("Distances")
    assert_allclose(heat.data, 100 * flat_map.heat_map(dock.prepared.pixel_size).data, rtol=1e-5)
    assert heat.scale.title == dock.legend.scale.title == "mean relative error of distances (%)"
    areas = shown("Areas")
    low, high = areas.scale.limits
    assert low == -high < 0
    assert areas.scale.title == "area, log2(flat / surface)"
    assert 0 < np.nanmedian(shown("Angles").data) < 45
    assert shown("Folds only") is None
    assert dock.legend.scale is None

    on_surface = shown("k")
    expected = flat_map.image(along, dock.prepared.pixel_size, interpolation="linear").data
    assert_allclose(on_surface.data, expected, rtol=1e-5)
    viewer.layers["k"].contrast_limits = (3, 30)
    viewer.layers["k"].colormap = "viridis"
    wait_for_picture(dock, qtbot)
    assert dock.legend.scale.limits == (3, 30)
    assert_array_equal(dock.legend.scale.colours[0, :3], [68, 1, 84])
    labels = shown("sheet")
    assert set(np.unique(labels.data[np.isfinite(labels.data)])) <= {0, 3}

    viewer.add_image(series, name="series")
    first = shown("series")
    viewer.dims.set_current_step(0, 1)
    wait_for_picture(dock, qtbot)
    assert_allclose(dock.picture.data - first.data, np.where(np.isnan(expected), np.nan, 100), atol=1e-3)
    viewer.layers.remove("series")
    assert dock.contents.currentText() == "Distances"
    viewer.layers["k"].name = "height"
    assert dock.contents.findText("height") >= 0
    wait_for_picture(dock, qtbot)

    u, v = flat_map.uv[np.linalg.norm(flat_map.uv - flat_map.uv.mean(axis=0), axis=1).argmin()]

    def told():
        to_map(dock, qtbot, u, v)
        return dock.text.text()

    qtbot.waitUntil(lambda: "voxel" in told(), timeout=PATIENCE)  # docks are laid out in turns of Qt's own
    assert "distance error" in dock.text.text()
    shown("Areas")
    qtbot.waitUntil(lambda: bool(re.search(r" · Areas [+−]\d+\.\d\s% · ", told())), timeout=PATIENCE)
    viewer.theme = "light"
    assert dock.canvas.backgroundBrush().color().lightness() > 200


def test_a_group_map_shows_the_spread_between_people(open_widget, qtbot, tmp_path):
    hill = voxflat.samples.hill()
    flat_map = voxflat.flatten_group([(hill.points * [1, 1, height], hill.faces) for height in (0.5, 1.5)])
    flat_map.save(tmp_path / "group.npz")
    viewer, _ = open_widget(show=True)
    open_file(viewer, qtbot, tmp_path / "group.npz")
    dock = map_dock(viewer, qtbot)
    dock.contents.setCurrentIndex(dock.contents.findText("Spread between people"))
    wait_for_picture(dock, qtbot)
    expected = flat_map.heat_map(dock.prepared.pixel_size, of="spread").data
    assert_allclose(dock.picture.data, expected, rtol=1e-5)
    assert dock.legend.scale.title == "spread between people, log2(area)"


def test_depths_are_sampled_and_only_the_latest_is_shown(flattened, qtbot):
    along = np.linalg.norm(np.indices((60, 60, 60)) - 29.5, axis=0).astype(np.float32)
    layer = Image(along, name="r", translate=(-29.5, -29.5, -29.5))
    viewer, _, dock = flattened(layer, Surface(sphere(150), name="ball"))
    assert dock.contents.content is viewer.layers["r"]
    for depth in (-2, 1, 3):
        dock.depths.setValue(depth)
        QApplication.processEvents()
    wait_for_picture(dock, qtbot)
    assert abs(np.nanmedian(dock.picture.data) - 23) < 0.3


def widgets_in(viewer):
    """How many widgets the window has; the application's are other tests', too, until Qt deletes them."""
    return len(viewer.window._qt_window.findChildren(QWidget))


def test_a_run_replaces_the_earlier_one_or_both_are_kept(flattened, qtbot):
    viewer, widget, dock = flattened(Surface(bumps(13), name="bumps"))
    layers = list(viewer.layers)
    state = ViewerState.of(viewer)
    widget.form.options.sources.setValue(40)
    run(widget, qtbot)
    widgets = widgets_in(viewer)
    for _ in range(2):
        run(widget, qtbot, dock)
    assert list(viewer.layers) == layers  # the same, with other data
    assert viewer.layers["bumps distortion"].metadata["voxflat"] is state.current.flat_map
    assert dock.prepared.run is state.current
    qtbot.waitUntil(lambda: widgets_in(viewer) <= widgets, timeout=PATIENCE)
    assert not dock.runs.isVisible()

    dock.keep.click()
    run(widget, qtbot, dock)
    names = [layer.name for layer in viewer.layers]
    assert names == ["bumps", *(f"bumps{of} {kind}" for of in ("", " (2)") for kind in ("flattened", "distortion"))]
    assert dock.runs.isVisible()
    assert dock.runs.count() == 2
    dock.runs.setCurrentIndex(0)
    dock.runs.activated.emit(0)
    wait_for_picture(dock, qtbot)
    assert dock.prepared.run is state.runs[0]
    assert widget.results.flat_map is state.runs[0].flat_map

    # closing docks loses nothing
    viewer.window.remove_dock_widget(dock)
    viewer.window.remove_dock_widget(widget)
    again = map_dock(viewer, qtbot)
    assert again is not dock
    assert again.prepared.run is state.runs[0]
    assert again.keep.isChecked()
    assert again.runs.count() == 2
    _, form = viewer.window.add_plugin_dock_widget("voxflat", "Flatten surface")
    assert form.results.title.text() == "Map of <b>bumps</b>"
    state.remove(state.runs[0])
    qtbot.waitUntil(lambda: len(viewer.layers) == 3)


def test_layers_have_controls_unless_they_are_not_added(make_napari_viewer, qtbot):
    layers = map_layers(voxflat.flatten(bumps(9)[:2], method=voxflat.methods.Voxflat(sources=20)), "it")
    viewer = make_napari_viewer()
    state, controls = ViewerState.of(viewer), viewer.window._qt_viewer.controls
    state.add(Run(layers, "it"))
    qtbot.waitUntil(lambda: len(controls.widgets) > len(viewer.layers))  # they are made ahead
    state.remove(state.current)
    assert len(controls.widgets) == 0
    state.add(Run(layers, "it"))
    qtbot.waitUntil(lambda: state.is_settled)
    assert set(controls.widgets) == {*viewer.layers} == {viewer.layers["it distortion"]}
    assert controls.count() == 2  # and the empty one
    viewer.layers.selection = {*viewer.layers}
    assert controls.currentWidget() is controls.widgets[viewer.layers[0]]


def test_docks_open_as_tabs_and_stay_where_they_are_moved(make_napari_viewer, qtbot):
    viewer = make_napari_viewer(show=True)
    window = viewer.window._qt_window
    window.resize(1366, 768)
    docks = []
    for name in ("Flatten surface", "Check surface", "Draw cuts", "Flat map"):
        dock, widget = viewer.window.add_plugin_dock_widget("voxflat", name)
        qtbot.waitUntil(lambda dock=dock: set(window.tabifiedDockWidgets(dock)) == {*docks})
        qtbot.waitUntil(lambda widget=widget: not widget.visibleRegion().isEmpty())  # in front
        docks.append(dock)
    assert (window.width(), window.height()) == (1366, 768)  # it does not grow beyond a small screen
    moved = docks[1]
    window.addDockWidget(Qt.DockWidgetArea.LeftDockWidgetArea, moved)
    moved.hide()
    moved.show()
    QApplication.processEvents()
    assert window.dockWidgetArea(moved) == Qt.DockWidgetArea.LeftDockWidgetArea
    assert moved not in window.tabifiedDockWidgets(docks[0])


def test_menu_entries_bring_docks_behind_other_tabs_to_the_front(make_napari_viewer, qtbot):
    viewer = make_napari_viewer(show=True)
    docks = {}
    for name in ("Flatten surface", "Measure map"):
        docks[name], widget = viewer.window.add_plugin_dock_widget("voxflat", name)
        qtbot.waitUntil(lambda widget=widget: not widget.visibleRegion().isEmpty())
    form, measures = docks.values()

    def choose_entry(name):  # as napari does
        dock = docks[name]
        dock.setVisible(not dock.isVisible())

    def is_in_front(dock):
        return dock.isVisible() and not dock.visibleRegion().isEmpty()

    choose_entry("Flatten surface")
    qtbot.waitUntil(lambda: is_in_front(form) and not is_in_front(measures))
    choose_entry("Flatten surface")  # which is in front
    qtbot.waitUntil(lambda: is_in_front(measures) and form.isHidden())
    choose_entry("Flatten surface")
    qtbot.waitUntil(lambda: is_in_front(form) and not is_in_front(measures))
    measures.setFloating(True)
    qtbot.waitUntil(lambda: is_in_front(measures))
    choose_entry("Measure map")
    choose_entry("Measure map")
    qtbot.waitUntil(lambda: is_in_front(measures))
    measures.setFloating(False)
    form.raise_()
    qtbot.waitUntil(lambda: is_in_front(form) and not is_in_front(measures))
    viewer.window.remove_dock_widget(measures)  # from behind
    QApplication.processEvents()
    assert measures.isHidden()
    assert is_in_front(form)


def test_all_controls_of_the_map_fit_into_a_narrow_window(flattened, qtbot):
    viewer, _, dock = flattened(Labels(cap(), name="cap"))
    dock._depth_row.show()
    for shown, hidden in [(dock.depth_unit, dock.movie), (dock.movie, dock.depth_unit)]:  # pial surfaces, movies
        hidden.hide()
        shown.show()
        QApplication.processEvents()
        assert viewer.window._qt_window.width() == 1000  # the width that the fixture sets
        for control in (dock.contents, dock.click, dock.whole, dock.keep, dock.on_surface, shown):
            assert control.width() >= 0.9 * control.minimumSizeHint().width()
        for slider in (dock.opacity, dock.depths):
            assert slider._slider.width() >= 25


def test_the_line_below_the_map_explains_the_chosen_click_and_fits(flattened, qtbot):
    _, _, dock = flattened(Labels(cap(), name="cap"))
    hints = {"draws a region": "double-click", "measures a distance": "two ends", "marks a point": "mark"}
    for action, words in hints.items():
        dock.click.setCurrentText(action)
        assert words in dock.text.text()
    dock._show_location(dock.prepared.spot(0.0, 0.0), (0.0, 0.0))
    text, wrap = dock.text.text(), Qt.TextFlag.TextWordWrap
    needed = dock.text.fontMetrics().boundingRect(0, 0, dock.text.width(), 0, wrap, text)
    assert "distance error" in dock.text.text()
    assert needed.height() <= dock.text.height()


def test_the_surface_has_the_colours_of_the_map(flattened, qtbot):
    points, faces, values = bumps()
    viewer, widget, dock = flattened(Surface((points, faces, values), name="bumps", colormap="viridis", scale=SCALE))
    t1 = viewer.add_image(np.ones((5, 5, 5)), name="T1")
    viewer.dims.ndisplay = 3
    dock.opacity.setValue(1)
    dock.on_surface.click()
    wait_for_picture(dock, qtbot)
    layer = viewer.layers["bumps in map colours"]
    assert not t1.visible  # it would cover the surface
    assert_allclose(camera(viewer).up_direction, (0, 0, 1), atol=1e-6)  # superior
    world = layer.vertices[layer.faces].mean(axis=1)
    assert_allclose(np.sort(world, axis=0), np.sort((points * SCALE)[faces].mean(axis=1), axis=0), atol=1e-9)
    scale, ids = dock.picture.scale, dock.prepared.run.flat_map.ids
    expected = scale.paint(values[ids][None])[0] / 255
    assert np.median(np.abs(layer.vertex_colors - expected)) < 0.02
    dock.contents.setCurrentIndex(0)
    wait_for_picture(dock, qtbot)
    assert viewer.layers["bumps in map colours"] is layer
    assert np.median(np.abs(layer.vertex_colors - expected)) > 0.05
    dock.on_surface.click()
    assert not layer.visible
    assert viewer.layers["bumps"].visible
    assert t1.visible
    camera(viewer).angles = (10, 20, 30)
    dock.on_surface.click()
    wait_for_picture(dock, qtbot)
    assert layer.visible
    assert_allclose(camera(viewer).angles, (10, 20, 30))  # as the user has turned it
    assert not viewer.layers["bumps"].visible

    hidden = viewer.add_image(np.ones((5, 5, 5)), name="hidden by the user", visible=False)
    viewer.dims.ndisplay = 2
    assert [one.visible for one in (t1, viewer.layers["bumps"])] == [True, False]
    viewer.dims.ndisplay = 3  # after In 3D
    assert not t1.visible
    t1.visible = True  # the user wants to see both
    dock.contents.setCurrentIndex(1)
    wait_for_picture(dock, qtbot)
    assert t1.visible
    viewer.dims.ndisplay = 2
    dock.on_surface.click()
    assert [one.visible for one in (t1, hidden, viewer.layers["bumps"])] == [True, False, True]
    dock.on_surface.click()
    wait_for_picture(dock, qtbot)

    choose(widget.form.patch, "values")  # the next map, of fewer points, takes the layer over
    run(widget, qtbot, dock)
    assert len(layer.vertices) == len(dock.prepared.points) < len(points)
    assert layer.vertex_colors.shape == (len(layer.vertices), 4)
    assert layer.metadata["voxflat"] is dock.prepared.run.flat_map
    assert [layer.visible, viewer.layers["bumps"].visible] == [True, False]
    viewer.window.remove_dock_widget(dock)  # whose box is the way back
    assert "bumps in map colours" not in viewer.layers
    assert viewer.layers["bumps"].visible


@pytest.mark.parametrize("layer", [lambda: Surface(bumps()[:2]), lambda: Labels(cap())], ids=["mesh", "voxels"])
def test_in_3d_before_the_switch_to_3d_shows_the_surface_upright_and_uncovered(flattened, qtbot, layer):
    t1 = Image(np.ones((24, 24, 24)), name="T1")  # as napari's own readers add it
    viewer, _, dock = flattened(t1, layer())
    dock.on_surface.click()
    wait_for_picture(dock, qtbot)
    assert t1.visible
    viewer.dims.ndisplay = 3
    assert not t1.visible
    assert_allclose(camera(viewer).up_direction, (0, 0, 1), atol=1e-6)
    assert_allclose(camera(viewer).view_direction, (-1, 0, 0), atol=1e-6)  # laterally, because x is positive
    viewer.dims.ndisplay = 2
    assert t1.visible


@pytest.mark.parametrize("name", ["Flatten surface", "Check surface"])
@pytest.mark.parametrize(("x", "structure"), [(-80, None), (80, None), (80, "CortexLeft")])
def test_meshes_of_other_readers_are_seen_upright_from_their_side(open_widget, name, x, structure):
    points, faces, _ = bumps()
    mesh = Surface((points, faces), translate=(x, 0, 0), metadata={} if structure is None else {"structure": structure})
    viewer, widget = open_widget(mesh, name=name)
    if name == "Flatten surface":
        choose(widget.form.patch, "disk")
        widget.form.seed.pick.click()  # which switches to 3D
    else:
        viewer.dims.ndisplay = 3
    towards = -1 if x > 0 and structure is None else 1
    assert_allclose(camera(viewer).view_direction, (towards, 0, 0), atol=1e-6)
    assert_allclose(camera(viewer).up_direction, (0, 0, 1), atol=1e-6)
    camera(viewer).angles = (10, 20, 30)  # as the user has turned it
    viewer.dims.ndisplay = 2
    viewer.dims.ndisplay = 3
    assert_allclose(camera(viewer).angles, (10, 20, 30))


def test_each_region_on_a_mesh_keeps_its_own_colour(make_napari_viewer):
    points, faces, _ = bumps(15)
    prepared, viewer = prepared_map_of(points, faces), make_napari_viewer()
    uv = prepared.run.flat_map.uv
    (left, low), (right, high) = np.quantile(uv, (0.1, 0.9), axis=0)
    middle = (left + right) / 2
    parts = [[(a, low), (b, low), (b, high), (a, high)] for a, b in ((left, middle), (middle, right))]
    layer = None
    for count in (1, 2):
        layer = put(viewer, regions(prepared, parts[:count]).layer, layer, prepared)
        for number in range(count + 1):
            shown = layer.vertex_colors[layer.vertex_values == number][:, :3]
            assert_allclose(shown, np.broadcast_to(np.divide(label_colour(number), 255), shown.shape), atol=1e-6)
    assert len(viewer.layers) == 1
    assert np.abs(np.diff([label_colour(number) for number in range(3)], axis=0)).max(axis=1).min() > 70


def click(dock, qtbot, *places):
    for u, v in places:
        qtbot.mouseClick(dock.canvas.viewport(), Qt.MouseButton.LeftButton, pos=dock.canvas.position(u, v))


def test_regions_on_a_mesh_are_saved_at_its_vertices(flattened, qtbot, tmp_path):
    points, faces, values = bumps()
    viewer, _, dock = flattened(Surface((points, faces, values), name="bumps"))
    flat_map = dock.prepared.run.flat_map
    u, v = flat_map.uv.mean(axis=0)
    dock.click.setCurrentText("draws a region")
    for label, middle in enumerate((u - 6, u + 6), 1):  # the second one updates the layer
        click(dock, qtbot, *[(middle + x, v + y) for x, y in ((-5, -5), (5, -5), (5, 5), (-5, 5))])
        qtbot.mouseDClick(dock.canvas.viewport(), Qt.MouseButton.LeftButton, pos=dock.canvas.position(middle, v))
        wait_for_picture(dock, qtbot)
        assert viewer.layers["bumps regions"].vertex_values.max() == label
    regions = viewer.layers["bumps regions"]
    viewer.layers.selection = {regions}
    expected = np.zeros(len(points), dtype=int)
    expected[flat_map.ids] = regions.vertex_values
    assert set(expected) == {0, 1, 2}
    for name in ("regions.label.gii", "lh.regions.annot"):
        viewer.layers.save(str(tmp_path / name), selected=True, plugin="voxflat")
    gifti = nib.load(tmp_path / "regions.label.gii")
    assert_array_equal(gifti.darrays[0].data, expected)
    assert [gifti.labeltable.get_labels_as_dict()[key] for key in (1, 2)] == ["region 1", "region 2"]
    for number in (1, 2):  # the same colour in the file, in the viewer and on the map
        assert_allclose(gifti.labeltable.labels[number].rgba[:3], np.divide(label_colour(number), 255), atol=0.01)
        middle = dock.canvas.position(u + (-6, 6)[number - 1], v + 5)
        around = dock.canvas.viewport().grab(QRect(middle - QPoint(0, 3), middle + QPoint(0, 3))).toImage()
        colours = [QColor(around.pixel(0, row)).getRgb()[:3] for row in range(around.height())]
        assert label_colour(number) in colours
    read, _, names = nib.freesurfer.read_annot(tmp_path / "lh.regions.annot")
    assert_array_equal(np.array([*names, b"none"])[read] == b"region 2", expected == 2)
    viewer.open(str(tmp_path / "regions.label.gii"), plugin="voxflat")  # shown in its colours, with its names
    dock.contents.setCurrentText("regions.label.gii")
    wait_for_picture(dock, qtbot)
    at = np.abs(flat_map.uv - (u + 6, v)).sum(axis=1).argmin()
    move(qtbot, dock.canvas.viewport(), dock.canvas.position(*flat_map.uv[at]))
    assert "regions.label.gii region 2" in dock.text.text()
    colour = gifti.labeltable.labels[2].rgba
    row, column = np.argwhere(dock.picture.data == 2)[0]
    assert_array_equal(dock.picture.pixels[row, column], np.round(255 * np.array(colour)))
    viewer.layers.selection = {regions}
    viewer.layers.save(str(tmp_path / "regions.tsv"), selected=True, plugin="voxflat")
    assert len(pandas.read_csv(tmp_path / "regions.tsv", sep="\t")) == 2
    regions.vertex_values = regions.vertex_values * 0
    with pytest.raises(voxflat.VoxflatError, match="were changed"):
        viewer.layers.save(str(tmp_path / "changed.annot"), selected=True, plugin="voxflat")
    assert not (tmp_path / "changed.annot").exists()


def test_labels_painted_on_the_map_of_a_mesh_are_saved_at_its_vertices(flattened, qtbot, tmp_path, monkeypatch):
    points, faces, values = bumps()
    viewer, _, dock = flattened(Surface((points, faces, values), name="bumps"))
    flat_map, flat = dock.prepared.run.flat_map, viewer.layers["bumps distortion"]
    columns = np.indices(flat.data.shape)[1]
    painted = np.where(columns < flat.data.shape[1] // 2, 2, 7)
    painted[: flat.data.shape[0] // 3] = 0
    names = {"index": [0, 2, 7], "name": ["", "V1", "MT"]}
    colours = DirectLabelColormap(color_dict={None: "black", 2: "#102030", 7: "#ff8000"})
    place = {"scale": flat.scale, "translate": flat.translate, "units": flat.units}
    viewer.add_labels(painted, name="painted", features=names, colormap=colours, **place)
    u, v = flat_map.uv.T
    pixels = np.round([flat.world_to_data((-b, a)) for a, b in zip(u, v, strict=True)]).astype(int)
    is_even = maximum_filter(painted, 3) == minimum_filter(painted, 3)
    clear = np.zeros(len(points), dtype=bool)  # at which no other label is near
    clear[flat_map.ids] = is_even[tuple(pixels.T)]
    assert clear.mean() > 0.9
    expected = np.zeros(len(points), dtype=int)
    expected[flat_map.ids] = painted[tuple(pixels.T)]
    for kind, name in (("(*.annot)", "lh.painted"), ("", "painted"), ("(*.tsv)", "painted"), ("", "one.label")):
        monkeypatch.setattr(QFileDialog, "getSaveFileName", lambda *_, at=(str(tmp_path / name), kind): at)
        dock.segmentations.save.click()
        qtbot.waitUntil(dock.segmentations.save.isEnabled, timeout=PATIENCE)
    assert "only one region, not 2" in dock.text.text()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["lh.painted.annot", "painted.label.gii", "painted.tsv"]
    gifti = nib.load(tmp_path / "painted.label.gii")
    assert_array_equal(gifti.darrays[0].data[clear], expected[clear])
    table = {label.key: (label.label, *np.round(255 * np.array(label.rgba[:3]))) for label in gifti.labeltable.labels}
    assert (table[2], table[7]) == (("V1", 16, 32, 48), ("MT", 255, 128, 0))
    read, colours, names = nib.freesurfer.read_annot(tmp_path / "lh.painted.annot")
    for label, name, colour in ((2, b"V1", (16, 32, 48)), (7, b"MT", (255, 128, 0))):
        assert_array_equal((np.array([*names, b"none"])[read] == name)[clear], (expected == label)[clear])
        assert tuple(colours[names.index(name), :3]) == colour
    for name in ("painted.label.gii", "lh.painted.annot"):  # by napari's own command
        viewer.layers.selection = {viewer.layers["painted"]}
        viewer.layers.save(str(tmp_path / f"by.{name}"), selected=True, plugin="voxflat")
        assert (tmp_path / f"by.{name}").read_bytes() == (tmp_path / name).read_bytes()
    viewer.layers["painted"].data = painted[1:]
    with pytest.raises(voxflat.VoxflatError, match=r"not those of an open map \('bumps'\)"):
        viewer.layers.save(str(tmp_path / "other.label.gii"), selected=True, plugin="voxflat")
    viewer.layers.selection = {viewer.layers["bumps"]}
    with pytest.raises(voxflat.VoxflatError, match="contains no regions"):
        viewer.layers.save(str(tmp_path / "other.label.gii"), selected=True, plugin="voxflat")


def test_drawings_on_a_map_of_voxels(flattened, qtbot, tmp_path):
    viewer, _, dock = flattened(Labels(cap(), name="sheet", scale=(2.0, 2.0, 2.0), units="mm"))
    flat_map = dock.prepared.run.flat_map
    u, v = flat_map.uv.mean(axis=0)
    dock.click.setCurrentText("marks a point")
    click(dock, qtbot, (u, v), (u + 6, v))
    wait_for_picture(dock, qtbot)
    expected = flat_map.look_up([(u, v), (u + 6, v)]).points
    assert_allclose(viewer.layers["sheet points"].data, expected, atol=3 / dock.canvas.scale_factor)

    dock.click.setCurrentText("draws a region")
    click(dock, qtbot, *[(u - 8, v - 8), (u + 8, v - 8), (u + 8, v + 8), (u - 8, v + 8)])
    qtbot.mouseDClick(dock.canvas.viewport(), Qt.MouseButton.LeftButton, pos=dock.canvas.position(u, v))
    wait_for_picture(dock, qtbot)
    assert dock.text.text() == "The map has 1 region, in the volume from -0.5 to 3 mm"
    regions = viewer.layers["sheet regions"]
    inside = np.abs(flat_map.uv - (u, v)).max(axis=1) < 7.5
    outside = np.abs(flat_map.uv - (u, v)).max(axis=1) > 8.5
    assert regions.data[tuple(flat_map.ids[inside].T)].all()
    assert regions.data[tuple(flat_map.ids[outside].T)].mean() < 0.1
    assert_allclose(regions.data_to_world((3, 4, 5)), (6, 8, 10))
    assert_allclose(regions.get_color(1)[:3], np.divide(label_colour(1), 255), atol=1e-6)  # as on the map
    viewer.layers.selection = {regions}
    file = tmp_path / "regions.nii.gz"
    assert viewer.layers.save(str(file), selected=True, plugin="voxflat") == [str(file)]
    assert_array_equal(nib.load(file).get_fdata(), regions.data)
    assert_allclose(nib.load(file).affine, np.diag([2.0, 2, 2, 1]))
    regions.metadata = {**regions.metadata, WORLD: "LPS"}  # as chosen in the form
    viewer.layers.save(str(file), selected=True, plugin="voxflat")
    assert_allclose(nib.load(file).affine, np.diag([-2.0, -2, 2, 1]))
    with pytest.raises(voxflat.VoxflatError, match=r"Use \.nii\.gz"):  # which has no position in space
        viewer.layers.save(str(tmp_path / "regions.tif"), selected=True, plugin="voxflat")
    viewer.layers.save(str(tmp_path / "regions.csv"), selected=True, plugin="voxflat")
    table = pandas.read_csv(tmp_path / "regions.csv")
    assert_allclose(table["map_area_mm2"], [256], rtol=0.05)
    assert_allclose(table[["u_mm", "v_mm"]], [(u, v)], atol=1)
    with pytest.raises(voxflat.VoxflatError, match="no mesh vertices"):
        viewer.layers.save(str(tmp_path / "regions.label.gii"), selected=True, plugin="voxflat")
    regions.data[0, 0, 0] = 1
    with pytest.raises(voxflat.VoxflatError, match="were changed"):
        viewer.layers.save(str(tmp_path / "changed.csv"), selected=True, plugin="voxflat")

    flat = viewer.layers["sheet distortion"]
    place = {"scale": flat.scale, "translate": flat.translate, "units": flat.units}
    viewer.add_labels(np.isfinite(flat.data).astype(int), name="painted", **place)
    dock.segmentations.send.click()
    qtbot.waitUntil(lambda: "painted in the volume" in viewer.layers, timeout=PATIENCE)
    painted = viewer.layers["painted in the volume"]
    viewer.layers.selection = {painted}
    viewer.layers.save(str(file), selected=True, plugin="voxflat")
    assert_array_equal(nib.load(file).get_fdata(), painted.data)
    assert_allclose(nib.load(file).affine, np.diag([2.0, 2, 2, 1]))
    wait_for_threads(qtbot)

    dock.click.setCurrentText("measures a distance")
    for reach in (5, 9):  # the second takes the place of the first
        click(dock, qtbot, (u - reach, v), (u + reach, v))
        wait_for_picture(dock, qtbot)
    over = float(dock.text.text().split()[0])
    assert viewer.layers["sheet shortest path"].shape_type == ["path"]
    assert len(dock.canvas.annotations.lines) == 1
    assert abs(over - 18) < 2
    way = viewer.layers["sheet shortest path"].data[0]
    assert_allclose(np.linalg.norm(np.diff(way, axis=0), axis=1).sum(), over, atol=0.1)


def test_a_page_of_patches(open_widget, qtbot):
    points, faces = sphere()
    viewer, widget = open_widget(Surface((points, faces), name="ball"), name="Flatten in patches", show=True)
    run(widget, qtbot)
    dock = map_dock(viewer, qtbot)
    assert dock.contents.currentText() == "Patches"
    for n in range(4):
        dock.contents.setCurrentIndex(n)
        wait_for_picture(dock, qtbot)
        assert dock.picture.pixels[..., 3].any()
    u, v = dock.prepared.run.flat_map.page().corners[7].mean(axis=0)
    spot = dock.prepared.spot(u, v)
    assert_allclose(spot.point, points[faces[7]].mean(axis=0), atol=1e-6)
    assert_allclose(dock.prepared.place(spot.point), (u, v), atol=1e-6)
    wait_for_threads(qtbot)


def test_the_dock_without_a_run_and_closed_again(open_widget, qtbot):
    viewer, _ = open_widget(Labels(cap()), show=True, name="Flat map")
    for _ in range(2):
        _, dock = viewer.window.add_plugin_dock_widget("voxflat", "Flat map")
        assert "Flatten a surface" in dock.text.text()
        viewer.window.remove_dock_widget(dock)
    del dock
    QApplication.processEvents()
    gc.collect()
    assert len(viewer.mouse_move_callbacks) == 0
    viewer.add_image(np.ones((3, 3, 3)))  # nobody listens


def square(u, v, side=5):
    return [(u + x, v + y) for x, y in ((-side, -side), (side, -side), (side, side), (-side, side))]


def draw_region(dock, qtbot, u, v):
    dock.click.setCurrentText("draws a region")
    click(dock, qtbot, *square(u, v))
    qtbot.mouseDClick(dock.canvas.viewport(), Qt.MouseButton.LeftButton, pos=dock.canvas.position(u, v))
    wait_for_picture(dock, qtbot)


def test_lengths_without_a_unit_are_not_in_mm_and_regions_then_reach_a_voxel_to_each_side(flattened, qtbot):
    """A layer without a unit may show any tissue, in which the depths of the cortex have no meaning."""
    viewer, _, dock = flattened(Labels(cap(), name="sheet"))
    flat_map = dock.prepared.run.flat_map
    u, v = flat_map.uv.mean(axis=0)
    draw_region(dock, qtbot, u, v)
    told = dock.text.text()
    assert told == f"The map has 1 region, in the volume from {-flat_map.spacing:.3g} to {flat_map.spacing:.3g}"
    labelled = np.argwhere(viewer.layers["sheet regions"].data)
    assert 0.9 < cKDTree(flat_map.points).query(labelled)[0].max() < 1.8  # voxels
    dock.click.setCurrentText("measures a distance")
    click(dock, qtbot, (u, v), (u + 6, v))
    wait_for_picture(dock, qtbot)
    measured = dock.text.text()
    to_map(dock, qtbot, u, v)
    texts = [told, measured, dock.text.text(), dock.legend._unit, dock.depth_unit.itemText(0)]
    texts += [text for row in figures(flat_map) for text in row]
    assert not [text for text in texts if "mm" in text]
    assert "along the surface" in measured


def test_what_is_drawn_on_a_map_is_undone_and_outlives_the_dock_and_the_next_map(flattened, qtbot):
    points, faces, values = bumps()
    viewer, widget, dock = flattened(Surface((points, faces, values), name="bumps"))
    state = ViewerState.of(viewer)
    first = state.current
    u, v = first.flat_map.uv.mean(axis=0)
    control, shift = Qt.KeyboardModifier.ControlModifier, Qt.KeyboardModifier.ShiftModifier

    def undo(times=1, key=control):
        QApplication.setActiveWindow(viewer.window._qt_window)
        dock.canvas.setFocus()
        for _ in range(times):
            qtbot.keyClick(dock.canvas, Qt.Key.Key_Z, key)
        wait_for_picture(dock, qtbot)

    assert not dock.undo.isEnabled()
    draw_region(dock, qtbot, u - 6, v)
    draw_region(dock, qtbot, u + 6, v)
    both = viewer.layers["bumps regions"].vertex_values
    undo()
    assert len(first.sketches.now.corners) == 4  # of the second region
    assert viewer.layers["bumps regions"].vertex_values.max() == 1
    undo(4)
    assert first.sketches.now.corners == ()
    undo(5, control | shift)
    assert not dock.redo.isEnabled()
    assert_array_equal(viewer.layers["bumps regions"].vertex_values, both)

    dock.click.setCurrentText("marks a point")
    own = viewer.add_points([[1.0, 2, 3]], name="bumps points", features={"vertex": ["a"], "surface": ["mine"]})
    click(dock, qtbot, (u, v), (u + 3, v))
    wait_for_picture(dock, qtbot)
    assert_array_equal(own.data, [[1.0, 2, 3]])  # a layer of the user
    marks = viewer.layers["bumps points [1]"]
    marked = marks.data.copy()
    assert len(marked) == 2
    undo()
    assert_array_equal(marks.data, marked[:1])
    undo(1, control | shift)
    assert_allclose(marks.data, marked)
    marks.data = marks.data[[1]]  # a point that the user has deleted is not missed
    undo(2)
    assert len(marks.data) == 0

    dock.click.setCurrentText("measures a distance")
    click(dock, qtbot, (u - 5, v), (u + 5, v), (u, v - 4), (u, v + 4))
    wait_for_picture(dock, qtbot)
    path, measured = viewer.layers["bumps shortest path"], []
    for times, key in ((0, control), *[(1, control)] * 4, (4, control | shift)):
        undo(times, key)
        measured.append((dock.text.text(), len(path.data), path.visible))
    assert measured[0] == measured[5] != measured[1] == measured[2]
    assert measured[3] == measured[4] == ("", 0, False)
    assert viewer.layers["bumps shortest path"] is path

    viewer.window.remove_dock_widget(dock)
    del dock
    dock = map_dock(viewer, qtbot)
    draw_region(dock, qtbot, u, v + 8)
    assert viewer.layers["bumps regions"].vertex_values.max() == 3
    assert [layer.name for layer in viewer.layers].count("bumps regions") == 1

    run(widget, qtbot, dock)  # the next map replaces maps on which nothing is drawn
    assert [one is first for one in state.runs] == [True, False]
    assert not dock.undo.isEnabled()
    dock.runs.setCurrentIndex(0)
    dock.runs.activated.emit(0)
    wait_for_picture(dock, qtbot)
    undo(5 + 5 + 5)
    assert "bumps regions" not in viewer.layers
    undo(5, control | shift)
    assert viewer.layers["bumps regions"].vertex_values.max() == 1


def test_a_region_that_cannot_be_drawn_does_not_spoil_the_next_one(flattened, qtbot):
    viewer, _, dock = flattened(Surface(bumps()[:2], name="bumps"))
    u, v = dock.prepared.run.flat_map.uv.mean(axis=0)
    dock._draw_on(Sketch(regions=((None, ((u, v), (u + 1, v))),)))  # two corners only
    wait_for_picture(dock, qtbot)
    assert "region 1" in dock.text.text()
    assert not dock.undo.isEnabled()
    dock.click.setCurrentText("draws a region")
    sketches, viewport = dock.prepared.run.sketches, dock.canvas.viewport()
    click(dock, qtbot, (u - 6, v - 6))
    assert "Undo" in dock.text.text()  # tells how to remove a corner
    click(dock, qtbot, (u + 6, v))  # the first half of the double click is a corner as well
    qtbot.mouseDClick(viewport, Qt.MouseButton.LeftButton, pos=dock.canvas.position(u + 6, v))
    assert "at least 3 corners" in dock.text.text()
    assert sketches.now.corners == ()
    dock.undo.click()
    assert len(sketches.now.corners) == 2  # both of them
    dock.redo.click()
    dock.canvas.clicked.emit(u + 1000, v)
    assert "outside the map" in dock.text.text()
    draw_region(dock, qtbot, u, v)
    assert viewer.layers["bumps regions"].vertex_values.max() == 1
    ((_, corners),) = sketches.now.regions
    assert len(corners) == 4


def test_a_map_on_which_the_user_has_painted_is_not_replaced(flattened, qtbot):
    sheet = cap()
    areas = np.where(np.indices(sheet.shape)[0] > 12, 4, 1).astype(np.uint8)
    viewer, widget, dock = flattened(Labels(sheet, name="sheet"))
    state, form = ViewerState.of(viewer), widget.form
    viewer.add_labels(areas, name="areas")
    form.surface.choose(viewer.layers["sheet"])
    form.sampled.choose(viewer.layers["areas"])
    qtbot.waitUntil(lambda: form.label.label == 3, timeout=PATIENCE)
    run(widget, qtbot, dock)
    run(widget, qtbot, dock)
    assert len(state.runs) == 1  # nothing is painted

    flat = viewer.layers["sheet areas flattened"]
    flat.visible = True
    flat.data_setitem((np.array([10, 10]), np.array([10, 11])), 9)
    painted, run_of_paint = flat.data.copy(), state.current
    run(widget, qtbot, dock)
    assert run_of_paint in state.runs
    assert_array_equal(flat.data, painted)
    flat.undo()
    run(widget, qtbot, dock)
    assert len(state.runs) == 1

    place = {name: getattr(viewer.layers["sheet distortion"], name) for name in ("scale", "translate", "units")}
    own = viewer.add_labels(np.zeros(viewer.layers["sheet distortion"].data.shape, dtype=int), name="own", **place)
    run(widget, qtbot, dock)
    assert len(state.runs) == 1  # the empty layer lies on the new map
    own.data_setitem((np.array([10, 10]), np.array([10, 11])), 2)
    first = state.current
    form.options.sources.setValue(20)
    for _ in range(3):
        run(widget, qtbot, dock)
        assert [one is first for one in state.runs] == [True, False]  # maps do not accumulate
    spot = viewer.add_points([[0.0, 0.0]], name="spot", ndim=2)
    second = state.current
    viewer.layers.remove(own)
    run(widget, qtbot, dock)
    assert [one is second for one in state.runs] == [True, False]
    viewer.layers.remove(spot)
    run(widget, qtbot, dock)
    assert len(state.runs) == 1


@pytest.fixture
def tissue(flattened, qtbot):
    """A stack in µm, its segmentation, and the map of the segmentation, with the layer flattened onto it."""
    place = {"scale": (0.9, 0.4, 0.4), "translate": (30.0, -20.0, 10.0), "units": "µm"}
    values = np.random.default_rng(0).random((24, 24, 24)).astype(np.float32)
    viewer, _, dock = flattened(Image(values, name="nuclei", **place), Labels(cap(), name="cells", **place))
    wait_for_picture(dock, qtbot)
    return viewer, dock, viewer.layers["cells nuclei flattened"]


def paint_over(viewer, flat):
    """Paint two labels on the flattened image, in a Labels layer as napari makes it beside it."""
    columns = np.indices(flat.data.shape)[1]
    painted = np.where(np.isfinite(flat.data), 1 + (columns > flat.data.shape[1] // 2), 0)
    place = {"scale": flat.scale, "translate": flat.translate, "units": flat.units}
    return viewer.add_labels(painted, name="painted", **place)


def save_layer(viewer, layer, path):
    viewer.layers.selection = {layer}
    viewer.layers.save(str(path), selected=True, plugin="voxflat")


@pytest.mark.parametrize("ending", [".tif", ".nii.gz"])
def test_images_of_a_map_in_micrometres_are_saved_like_those_of_python(tissue, tmp_path, ending):
    viewer, dock, flat = tissue
    flat_map = dock.prepared.run.flat_map
    expected = flat_map.heat_map(flat.scale[0])
    expected.save(tmp_path / f"python{ending}")
    for layer in (flat, paint_over(viewer, flat)):
        save_layer(viewer, layer, tmp_path / f"napari{ending}")
        if ending == ".tif":
            found, wanted = (tifffile.TiffFile(tmp_path / f"{one}.tif").ome_metadata for one in ("napari", "python"))
            sizes = re.findall(r"PhysicalSize\S+", wanted)
            assert f'"{flat.scale[0]:.9g}"' in sizes[0]
            assert 'Unit="&#181;m"' in sizes[1]
            assert re.findall(r"PhysicalSize\S+", found) == sizes
        else:
            found, wanted = (nib.load(tmp_path / f"{one}.nii.gz") for one in ("napari", "python"))
            assert_allclose(np.linalg.norm(found.affine[:3, 0]), flat.scale[0] / 1000, rtol=1e-6)
            assert_allclose(found.affine, wanted.affine)
            assert found.header.get_xyzt_units() == wanted.header.get_xyzt_units()
            data = np.where(np.isnan(flat.data), np.nan, layer.data)
            assert_allclose(found.get_fdata()[..., 0], data.astype(np.float32))
    flat.scale = np.array(flat.scale) * (1, 2)
    with pytest.raises(voxflat.VoxflatError, match=r"not square \(\S+ x \S+ µm\)"):
        save_layer(viewer, flat, tmp_path / f"other{ending}")


def test_labels_painted_on_the_map_of_a_volume_are_saved_in_the_plane_and_in_the_volume(
    tissue, qtbot, tmp_path, messages
):
    viewer, dock, flat = tissue
    painted, flat_map = paint_over(viewer, flat), dock.prepared.run.flat_map
    save_layer(viewer, painted, tmp_path / "painted.png")
    assert PIL.Image.open(tmp_path / "painted.png").size == flat.data.shape[::-1]
    assert write_regions(str(tmp_path / "a.nii.gz"), [painted.as_layer_data_tuple()])
    low, high = -flat_map.spacing, flat_map.spacing
    regions = flat_map.regions(painted.data, pixel_size=flat.scale[0])
    regions.save(tmp_path / "b.nii.gz", depth=(low, high))
    found, expected = (nib.load(tmp_path / name) for name in ("a.nii.gz", "b.nii.gz"))
    assert_array_equal(found.get_fdata(), expected.get_fdata())
    assert_allclose(found.affine, expected.affine)
    assert set(np.unique(found.get_fdata())) == {0, 1, 2}
    told = f"Saved the regions in the volume from {low:.3g} to {high:.3g} µm"
    assert [one.message for one in messages if "Saved" in one.message] == [told]
    dock.segmentations.send.click()
    qtbot.waitUntil(lambda: "Added" in dock.text.text(), timeout=PATIENCE)
    assert dock.text.text() == f"Added 'painted in the volume' from {low:.3g} to {high:.3g} µm"


def test_a_segmentation_that_was_opened_is_saved_where_it_lies(tissue, tmp_path):
    viewer, dock, _ = tissue
    save_layer(viewer, viewer.layers["cells"], tmp_path / "cells.nii.gz")
    saved, flat_map = voxflat.io.read_volume(tmp_path / "cells.nii.gz"), dock.prepared.run.flat_map
    assert_allclose(saved.in_unit("µm").affine, flat_map.affine, atol=1e-4)
    assert_array_equal(saved.data, cap())


def test_pointing_at_an_image_of_the_map_means_a_place_on_the_map(tissue, qtbot):
    """Not the place in the slice that has the same coordinates."""
    viewer, dock, flat = tissue
    flat_map, canvas = dock.prepared.run.flat_map, canvas_widget(dock)
    for layer in viewer.layers:
        layer.visible = layer is flat
    flat.translate = np.add(flat.translate, (3, 5))  # moved aside by the user
    row, column = np.array(flat.data.shape) // 2
    u, v = flat_map.raster(flat.scale[0]).origin + flat.scale[0] * np.array([column, -row])

    def look_at(row, column):
        camera(viewer).center = (0, *flat.data_to_world((row, column)))
        wait_until_drawn(viewer, qtbot)
        move(qtbot, canvas, QPoint(canvas.width() // 2, canvas.height() // 2))

    look_at(row, column)
    pixel = flat.scale[0]
    assert dock.canvas.ring.isVisible()
    assert_allclose((dock.canvas.ring.pos().x(), -dock.canvas.ring.pos().y()), (u, v), atol=pixel)
    shown = [float(number) for number in dock.text.text().replace("−", "-").split(" µm")[0].split(", ")]
    assert_allclose(shown, flat_map.look_up([u, v]).points, atol=2 * pixel)
    click_middle(canvas, qtbot)
    seen, viewport = dock.canvas.position(u, v), dock.canvas.viewport()
    assert_allclose((seen.x(), seen.y()), (viewport.width() / 2, viewport.height() / 2), atol=4)

    to_map(dock, qtbot, u, v)  # the viewer does not show this place, but the image of the map
    assert dock.link.ring.isHidden()

    painted = paint_over(viewer, flat)  # over the place of the map, not of the moved image
    painted.translate = np.array(flat.translate) - (3, 5)
    flat.visible = False
    viewer.layers.selection.active = painted
    painted.mode = "paint"
    moved = []
    dock.link.clicked.connect(moved.append)
    camera(viewer).center = (0, -v, u)
    wait_until_drawn(viewer, qtbot)
    move(qtbot, canvas, QPoint(canvas.width() // 2, canvas.height() // 2))
    assert_allclose((dock.canvas.ring.pos().x(), -dock.canvas.ring.pos().y()), (u, v), atol=pixel)
    click_middle(canvas, qtbot)
    assert not moved
    painted.mode = "pan_zoom"
    click_middle(canvas, qtbot)
    assert_allclose(moved, [(u, v)], atol=pixel)

    painted.visible, flat.visible = False, True
    look_at(0, 0)  # outside the map
    assert np.isnan(flat.data[0, 0])
    assert not dock.canvas.ring.isVisible()


def test_saved_images_of_a_map_are_opened_on_it(tissue, qtbot, tmp_path, messages):
    """Those of napari and of Python, whose files are in mm, as flat layers of the kind that was saved."""
    viewer, dock, flat = tissue
    flat_map, painted = dock.prepared.run.flat_map, paint_over(viewer, flat)
    save_layer(viewer, flat, tmp_path / "values.nii.gz")
    save_layer(viewer, painted, tmp_path / "labels.nii.gz")
    flat_map.heat_map(flat.scale[0]).save(tmp_path / "python.nii")
    assert not messages
    for name, data in (
        ("values", flat.data),
        ("labels", painted.data),
        ("python", viewer.layers["cells distortion"].data),
    ):
        path = next(tmp_path.glob(f"{name}.*"))
        (opened,) = open_file(viewer, qtbot, path)
        assert isinstance(opened, Labels if name == "labels" else Image)
        assert_allclose(opened.data, data, rtol=1e-6)
        assert opened.units == flat.units
        for corner in ((0, 0), np.array(data.shape) - 1):
            assert_allclose(opened.data_to_world(corner), flat.data_to_world(corner), rtol=1e-5, atol=1e-5)
        assert ViewerState.of(viewer).run_under(opened) is dock.prepared.run
    other = nib.load(tmp_path / "python.nii")  # a slice of another program
    nib.save(nib.Nifti1Image(other.get_fdata(), other.affine), tmp_path / "slice.nii")
    assert open_file(viewer, qtbot, tmp_path / "slice.nii")[0].ndim == 3
    save_layer(viewer, painted, tmp_path / "labels.tif")
    assert ["labels.tif as an image in pixels" in one.message for one in messages] == [True]


def test_layers_with_values_of_a_depth_tell_it(open_widget, qtbot, tmp_path):
    place = {"scale": (0.9, 0.4, 0.4), "units": "µm"}
    values = np.random.default_rng(0).random((24, 24, 24)).astype(np.float32)
    viewer, widget = open_widget(Image(values, name="nuclei", **place), Labels(cap(), name="cells", **place))
    qtbot.waitUntil(lambda: widget.form.label.label == 3, timeout=PATIENCE)
    choose(widget.form.patch, "whole")
    widget.form.sample_depth.setValue(-0.5)
    run(widget, qtbot)
    flat = viewer.layers["cells nuclei flattened, 0.5 µm inside"]
    assert "0.5 µm inside the surface" in flat.metadata["colours"]
    save_layer(viewer, flat, tmp_path / "flat.nii.gz")
    (extension,) = nib.load(tmp_path / "flat.nii.gz").header.extensions
    told = json.loads(extension.get_content())
    assert (told["function"], told["parameters"]["depth"]) == ("image", -0.5)
