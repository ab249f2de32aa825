"""Annotations of the volume on the map, and the outline of the map in the volume."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from napari.layers import Image, Points, Shapes, Surface
from napari_window import (
    PATIENCE,
    bumps,
    open_file,
    prepared_map_of,
    run,
    sphere,
    wait_for_picture,
    wait_for_threads,
    wait_until_drawn,
)
from numpy.testing import assert_allclose, assert_array_equal
from qtpy.QtCore import Qt

import voxflat
from voxflat._napari.map_viewer.annotations import Annotation, on_map
from voxflat._napari.map_viewer.patch_outline import edges, in_slice, width
from voxflat._napari.map_viewer.viewer_parts import canvas_widget
from voxflat.maps.plane import LIMIT

RADIUS = 20.0


@pytest.fixture(scope="module")
def plane():
    """A flat grid at height 7 with a spacing of 2 mm, whose map is the same grid, rotated."""
    points, faces, _ = bumps(15)
    points[:, 2] = 7
    return prepared_map_of(points, faces)


@pytest.fixture(scope="module")
def ball():
    """A sphere that was cut open."""
    return prepared_map_of(*sphere(250, RADIUS))


def paths(*lines):
    lines, white = [np.asarray(line, dtype=float) for line in lines], np.full((len(lines), 4), 255, dtype=np.uint8)
    return Annotation(np.empty((0, 3)), np.empty((0, 4), np.uint8), lines, white)


def length(line):
    return np.linalg.norm(np.diff(line, axis=0), axis=1).sum()


inside = st.floats(0, 28)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(inside, inside, st.floats(-9, 9)), min_size=2, max_size=5))
@example([(0.0, 0.0, 0.0), (0.0, 1e-308, 0.0)])  # a step so small that dividing by it overflows
def test_points_above_a_plane_are_projected_onto_it(plane, corners):
    """Points are projected vertically, lines stay straight, and points that are too high are counted."""
    corners = np.array(corners)
    points = corners + np.array([0, 0, 7])
    colours = np.arange(4 * len(points), dtype=np.uint8).reshape(-1, 4)
    found = on_map(plane, [Annotation(points, colours, [], np.empty((0, 4), np.uint8))])
    near = np.abs(corners[:, 2]) <= LIMIT
    assert_array_equal(found.colours, colours[near])
    flat = np.column_stack([points[:, :2], np.full(len(points), 7)])
    assert_allclose(found.dots, plane.places(flat)[near], atol=1e-6)
    assert_allclose(plane.run.flat_map.look_up(found.dots).points[:, :2], corners[near, :2], atol=1e-6)
    assert (f"{(~near).sum()} of {len(near)} points" in found.excluded) == (not near.all())

    low = flat + np.array([0, 0, 3])
    found = on_map(plane, [paths(low)])
    assert found.excluded == ""
    assert_allclose(sum(map(length, found.lines)), length(low), rtol=0.005, atol=0.02)


def test_lines_that_leave_the_surface(plane):
    """Only the near parts of a line are shown, however long it is, and a message reports the others."""
    long, beside, far = [[-1e9, 14, 7], [1e9, 14, 7]], [[-30, -30, 7], [-40, 90, 7]], [[0, 0, 1e6], [9, 9, 1e6]]
    found = on_map(plane, [paths(long), paths(beside, far)])
    (line,) = found.lines
    first, last = line[[0, -1]]
    assert_allclose(np.linalg.norm(last - first), 28, atol=0.1)
    assert "all or parts of 3 of 3 shapes" in found.excluded
    nothing = on_map(plane, [])
    assert (len(nothing.dots), nothing.lines, nothing.excluded) == (0, [], "")


def test_a_line_is_split_at_a_cut(ball):
    turn = np.linspace(0, 2 * np.pi, 60)
    ring = RADIUS * np.column_stack([np.cos(turn), np.sin(turn), 0 * turn])
    found = on_map(ball, [paths(ring, np.roll(ring, 1, axis=1))])
    assert found.excluded == ""
    assert len(found.lines) > 2  # a closed surface is cut at least once around
    steps = np.concatenate([np.linalg.norm(np.diff(line, axis=0), axis=1) for line in found.lines])
    assert steps.max() < 4 * ball.spacing
    assert 0.8 < steps.sum() / (2 * 2 * np.pi * RADIUS) < 1.3


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_slice_of_a_ball_is_a_circle(ball, axis):
    level = 6.5
    border, cuts = edges(ball)
    assert len(border) == 0  # of a closed surface all of the rim is cut
    rim = sum(length(ball.points[line]) for line in ball.rim)
    assert_allclose(2 * np.linalg.norm(cuts[:, 1] - cuts[:, 0], axis=1).sum(), rim)
    surface, marks = in_slice(ball, cuts, axis, level)
    assert_allclose(surface[..., axis], level, atol=1e-12)
    others = [n for n in range(3) if n != axis]
    radius = np.sqrt(RADIUS**2 - level**2)
    assert_allclose(np.linalg.norm(surface[..., others], axis=2), radius, rtol=0.05)
    assert_allclose(np.linalg.norm(surface[:, 1] - surface[:, 0], axis=1).sum(), 2 * np.pi * radius, rtol=0.05)
    crossed = (cuts[:, 0, axis] > level) != (cuts[:, 1, axis] > level)
    assert len(marks) == crossed.sum()
    assert_allclose(np.linalg.norm(marks[:, 1] - marks[:, 0], axis=1), 3 * width(ball))
    assert in_slice(ball, cuts, axis, 2 * RADIUS)[0].shape == (0, 2, 3)


def test_the_border_of_a_part(plane):
    border, cuts = edges(plane)
    assert len(cuts) == 0
    assert_allclose(np.linalg.norm(border[:, 1] - border[:, 0], axis=1).sum(), 4 * 28)


def dots(dock, qtbot):
    wait_for_picture(dock, qtbot)
    return dock.canvas.annotations.dots


def test_the_map_follows_what_is_drawn_in_the_volume(flattened, qtbot):
    points, faces, values = bumps(13)
    place = {"scale": (2000.0, 500.0, 3000.0), "translate": (5e3, -4e3, 7e3), "units": "um"}
    viewer, widget, dock = flattened(Surface((points, faces, values), name="bumps", **place))
    assert not dock.excluded.isVisible()
    spots, shift = points[[30, 100, 120]], np.array([1, 0, 0])
    foci = viewer.add_points(spots, name="foci", face_color=["red", "red", "lime"], **place)
    flat_map = dock.prepared.run.flat_map

    def expected(spots):
        placed = 1000 * (spots * [2, 0.5, 3] + [5, -4, 7])
        return flat_map.points_to_map(placed[..., ::-1], dock.prepared.far)[0]  # the axes are z, y, x

    def same(found, spots):
        wanted = expected(spots)
        assert_allclose(found[np.lexsort(found.T)], wanted[np.lexsort(wanted.T)], atol=1e-6)

    same(dots(dock, qtbot), spots)
    foci.add([points[90], points[90] + [0, 0, 100]])
    same(dots(dock, qtbot), np.array([*spots, points[90]]))
    assert dock.excluded.isVisible()
    assert "1 of 5 points" in dock.excluded.text()
    foci.selected_data = {3, 4}
    foci.remove_selected()
    foci.data = foci.data + shift
    same(dots(dock, qtbot), spots + shift)
    assert not dock.excluded.isVisible()
    foci.translate = np.array(foci.translate) - [2000, 0, 0]
    same(dots(dock, qtbot), spots)
    foci.shown = [True, False, True]
    same(dots(dock, qtbot), spots[[0, 2]])
    foci.visible = False
    assert len(dots(dock, qtbot)) == 0
    foci.visible = True
    same(dots(dock, qtbot), spots[[0, 2]])

    assert dock.canvas.annotations.lines == []
    drawn = viewer.add_shapes([points[[30, 34]]], shape_type="path", edge_color="cyan", name="line", **place)
    wait_for_picture(dock, qtbot)
    line = dock.canvas.annotations.lines[0]
    for at, spot in ((0, 30), (line.elementCount() - 1, 34)):
        assert_allclose((line.elementAt(at).x, -line.elementAt(at).y), expected(points[spot]), atol=1e-6)
    drawn.visible = False
    wait_for_picture(dock, qtbot)
    assert dock.canvas.annotations.lines == []

    # what was marked on one map is on the next one, and edits of the marks stay
    dock.click.setCurrentText("marks a point")
    dock._on_map_clicked(*expected(points[100]))
    wait_for_picture(dock, qtbot)
    marked = viewer.layers["bumps points"]
    marked.selected_data = {0}
    marked.remove_selected()
    dock._on_map_clicked(*expected(points[90]))
    wait_for_picture(dock, qtbot)
    assert len(marked.data) == 1
    foci.visible = False
    run(widget, qtbot, dock)
    flat_map = dock.prepared.run.flat_map
    same(dots(dock, qtbot), points[[90]])
    dock._on_map_clicked(*expected(points[30]))
    wait_for_picture(dock, qtbot)
    layers = marked, viewer.layers["bumps (2) points"]
    assert [[*layer.features["surface"]] for layer in layers] == [["bumps"], ["bumps"]]
    assert [[*layer.features["vertex"]] for layer in layers] == [["90"], ["30"]]
    same(dots(dock, qtbot), points[[90, 30]])


def test_annotations_of_the_displayed_time(flattened, qtbot):
    points, faces, values = bumps(13)
    film = Image(np.zeros((3, 30, 30, 9), dtype=np.uint8), name="film")
    viewer, _, dock = flattened(Surface((points, faces, values), name="bumps"), film)
    flat_map = dock.prepared.run.flat_map
    viewer.add_points([[0, *points[30]], [2, *points[100]]], name="seen at times")
    viewer.add_layer(Shapes([[[2, *points[30]], [2, *points[34]]]], shape_type="line", name="then"))
    viewer.add_layer(Points([[3, 3]], name="flat"))
    for time, spots, lines in ((0, [30], 0), (1, [], 0), (2, [100], 1)):
        viewer.dims.set_point(0, time)
        assert_allclose(dots(dock, qtbot), flat_map.points_to_map(points[spots].reshape(-1, 3))[0], atol=1e-6)
        assert len(dock.canvas.annotations.lines) == lines
    assert not dock.excluded.isVisible()


def test_the_part_is_outlined_in_the_volume(flattened, qtbot):
    points, faces = sphere(200)
    volume = Image(np.zeros((20, 20, 25)), name="v", scale=(3, 3, 2), translate=(-27, -27, -24), units="mm")
    viewer, widget, dock = flattened(Surface((points, faces), name="ball", units="mm"), volume)
    chosen, ranges = set(viewer.layers.selection), viewer.dims.range
    dock.outlined.click()
    wait_for_picture(dock, qtbot)
    layer = viewer.layers["ball outline"]
    assert set(viewer.layers.selection) == chosen
    assert viewer.dims.range == ranges  # the sliders' steps are what they were

    def seen():
        wait_for_picture(dock, qtbot)
        vectors = layer.data * layer.scale
        return vectors[:, 0], vectors[:, 0] + vectors[:, 1], layer.edge_color

    for order in ((0, 1, 2), (2, 0, 1)):
        viewer.dims.order = order
        for level in (-6.0, 9.0):
            viewer.dims.set_point(order[0], level)
            starts, ends, colours = seen()
            here = viewer.dims.point[order[0]]
            part = (colours == colours[0]).all(axis=1)
            assert_allclose(starts[part][:, order[0]], here)
            assert_allclose(np.linalg.norm(ends[part], axis=1), 20, rtol=0.08)
            assert 0 < (~part).sum() < part.sum()
    dock.outlined.click()  # hidden meanwhile
    viewer.dims.set_point(order[0], 24)
    dock.outlined.click()
    assert len(seen()[0]) == 0
    dock.outlined.click()
    viewer.dims.ndisplay = 3
    dock.outlined.click()
    wait_until_drawn(viewer, qtbot)
    starts, _, colours = seen()
    assert len(np.unique(colours, axis=0)) == 1  # all of it is cut
    assert np.linalg.norm(starts, axis=1).min() > 19  # outside, so that the surface does not hide it

    run(widget, qtbot, dock)  # of the next map
    assert len(seen()[0]) == len(edges(dock.prepared)[1])
    canvas = canvas_widget(dock)
    for where in (canvas, dock.canvas):  # keys work in both
        qtbot.keyClick(where, Qt.Key.Key_O, Qt.KeyboardModifier.ShiftModifier)
        wait_for_picture(dock, qtbot)
        assert dock.outlined.isChecked() == layer.visible == (where is not canvas)
    dock.contents.setCurrentIndex(0)
    for key, wanted in ((Qt.Key.Key_N, "Areas"), (Qt.Key.Key_B, "Distances"), (Qt.Key.Key_B, "Folds only")):
        qtbot.keyClick(canvas, key, Qt.KeyboardModifier.ShiftModifier)
        assert dock.contents.currentText() == wanted
    for key in (Qt.Key.Key_M, Qt.Key.Key_R, Qt.Key.Key_D, Qt.Key.Key_G):
        before = dock.click.currentText()
        qtbot.keyClick(canvas, key, Qt.KeyboardModifier.ShiftModifier)
        assert dock.click.currentText() != before
    wait_for_picture(dock, qtbot)
    viewer.layers.remove("ball outline")
    viewer.dims.ndisplay = 2  # the user removed it: it stays away
    wait_for_picture(dock, qtbot)
    assert "ball outline" not in viewer.layers
    assert not dock.outlined.isChecked()
    viewer.window.remove_dock_widget(dock)


def test_the_map_of_a_file_is_painted_and_outlined(qtbot, tmp_path, make_napari_viewer):
    voxflat.flatten(bumps(9)[:2], method=voxflat.methods.Voxflat(sources=20)).save(tmp_path / "map.voxflat")
    viewer = make_napari_viewer(show=True)
    open_file(viewer, qtbot, tmp_path / "map.voxflat")
    _, dock = viewer.window.add_plugin_dock_widget("voxflat", "Flat map")
    wait_for_picture(dock, qtbot)
    listed = len(viewer.layers)
    dock.on_surface.click()
    dock.outlined.click()
    qtbot.waitUntil(lambda: dock.is_drawn and len(viewer.layers) == listed + 2, timeout=PATIENCE)
    wait_for_threads(qtbot)
    assert [layer.visible for layer in viewer.layers][listed:] == [True, True]
    dock.on_surface.click()
    dock.outlined.click()
    assert [layer.visible for layer in viewer.layers][listed:] == [False, False]  # removing a layer is slow in napari
    for layer in viewer.layers[listed:]:  # the eye in the list does the same
        layer.visible = True
    assert dock.on_surface.isChecked()
    assert dock.outlined.isChecked()
    wait_for_picture(dock, qtbot)
