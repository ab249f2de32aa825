"""Drawn cuts: clicks on the surface in 3D, undo and redo, evaluating, saving, loading and using them."""

import json

import lab
import nibabel as nib
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from napari.layers import Surface
from napari_window import (
    PATIENCE,
    bumps,
    click_middle,
    map_dock,
    open_file,
    run,
    sphere,
    wait_for_picture,
    wait_until_drawn,
)
from numpy.testing import assert_allclose, assert_array_equal
from qtpy.QtCore import Qt
from qtpy.QtWidgets import QApplication, QFileDialog

import voxflat
from voxflat._napari.editing.drawing import Drawing
from voxflat._napari.results.sketch import Sketch
from voxflat._napari.viewer_state import ViewerState
from voxflat.errors import InputError
from voxflat.surfaces.standard.template import read_template

POINTS, FACES, _ = bumps()
WHOLE = voxflat.surface((POINTS, FACES))
STEPS = st.one_of(
    st.tuples(st.just("add_stop"), st.integers(0, len(POINTS) - 1)),
    st.tuples(st.sampled_from(["end_cut", "undo", "redo"])),
    st.tuples(st.just("remove"), st.integers(0, 2)),
)


@given(st.lists(STEPS, max_size=12))
def test_every_step_can_be_undone_and_redone(steps):
    drawing = Drawing(WHOLE)
    for name, *values in steps:
        if name == "remove" and values[0] >= len(drawing.cuts):
            continue
        getattr(drawing, name)(*values)
        for cut in drawing.cuts:
            vertices = drawing.vertices(cut)
            assert (vertices[0], vertices[-1]) == (cut.stops[0], cut.stops[-1])
            assert set(cut.stops) <= set(vertices.tolist())
    states = [(drawing.cuts, drawing.is_open)]
    while drawing.can_undo:
        drawing.undo()
        states.append((drawing.cuts, drawing.is_open))
    assert states[-1] == ((), False)
    for state in states[-2::-1]:
        drawing.redo()
        assert (drawing.cuts, drawing.is_open) == state


def test_a_cut_is_the_shortest_path_between_points():
    drawing = Drawing(WHOLE)
    for stop in (12, 312, 318):
        drawing.add_stop(stop)
    way = voxflat.surface(WHOLE).path(12, 312, 318, geodesic="edges")
    (cut,) = drawing.cuts
    assert drawing.length(cut) == pytest.approx(way.length)
    assert_array_equal(drawing.paths()["drawn 1"], way.ids)
    drawing.add_stop(318)  # clicked twice
    assert drawing.cuts == (cut,)
    two = voxflat.surface((np.concatenate([POINTS, POINTS + 100]), np.concatenate([FACES, FACES + len(POINTS)])))
    apart = Drawing(two)
    apart.add_stop(0)
    with pytest.raises(InputError):
        apart.add_stop(len(POINTS))
    assert apart.cuts[0].stops == (0,)  # as it was


def press(dock, qtbot, *names):
    """Press buttons, and wait until the task of each has finished."""
    for name in names:
        assert getattr(dock, name).isEnabled()
        getattr(dock, name).click()
        qtbot.waitUntil(dock.begin.isEnabled, timeout=PATIENCE)


def draw(dock, *stops):
    """Add points, as clicks on the surface do."""
    for stop in stops:
        dock._do(lambda drawing, stop=stop: drawing.add_stop(stop))


def test_cuts_are_clicked_evaluated_saved_loaded_and_used(open_widget, qtbot, tmp_path, monkeypatch):
    points, faces = sphere(200)
    viewer, widget = open_widget(Surface((points, faces), name="ball"), show=True)
    _, dock = viewer.window.add_plugin_dock_widget("voxflat", "Draw cuts")

    assert not dock.draw.isEnabled()
    press(dock, qtbot, "begin")
    assert viewer.dims.ndisplay == 3
    assert not viewer.layers["ball"].visible
    camera = getattr(viewer, "scene", viewer).camera
    canvas = viewer.window._qt_viewer.canvas.native
    clicked = []
    for direction in ((1, 0, 0.2), (0.6, 0.1, -1), (0, 1, 0.1)):
        camera.set_view_direction(view_direction=direction, up_direction=(0, 0.3, 1))
        camera.center = (0, 0, 0)
        wait_until_drawn(viewer, qtbot)
        click_middle(canvas, qtbot)
        place = -20 * np.array(direction) / np.linalg.norm(direction)  # what looks at the eye
        clicked.append(int(np.linalg.norm(points - place, axis=1).argmin()))
    assert len(dock.drawing.cuts) == 1
    stops = dock.drawing.cuts[0].stops
    assert np.linalg.norm(points[list(stops)] - points[clicked], axis=1).max() < 7  # an edge is 5 mm long
    assert dock.cuts.rowCount() == 1
    assert len(viewer.layers["cuts"].data) == len(dock.drawing.paths()["drawn 1"]) - 1
    control, shift = Qt.KeyboardModifier.ControlModifier, Qt.KeyboardModifier.ShiftModifier
    for where in (canvas, dock.cuts):  # keys work in both
        qtbot.keyClick(where, Qt.Key.Key_Z, control)
        assert dock.drawing.cuts[0].stops == stops[:2]
        qtbot.keyClick(where, Qt.Key.Key_Z, control | shift)
        assert dock.drawing.cuts[0].stops == stops

    press(dock, qtbot, "evaluate")
    assert dock.cuts.item(0, 2).text().endswith(" %")
    assert "error with all cuts" in dock.status.text()
    path = tmp_path / "cuts.json"
    monkeypatch.setattr(QFileDialog, "getSaveFileName", lambda *_: (str(path), ""))
    dock.save.click()
    saved = json.loads(path.read_text())
    assert dict(zip(saved["names"], saved["cuts"], strict=True)) == {
        "drawn 1": dock.drawing.paths()["drawn 1"].tolist()
    }

    dock.use.click()
    assert "along the drawn lines" in widget.form.plan.text()
    run(widget, qtbot)
    assert "ball distortion" in viewer.layers, widget.status.text()
    expected = voxflat.flatten((points, faces), cuts=str(path))  # by the command line's way
    assert_array_equal(viewer.layers["ball distortion"].metadata["voxflat"].uv, expected.uv)

    dock.remove.setEnabled(True)
    dock.cuts.setCurrentCell(0, 0)
    dock.remove.click()
    assert dock.cuts.rowCount() == 0
    press(dock, qtbot, "automatic")
    found = voxflat.surface((points, faces)).cut(cuts="automatic")
    assert [len(path) for path in dock.drawing.paths().values()] == [len(cut.ids) for cut in found.cuts]
    titles = [dock.cuts.item(row, 0).text() for row in range(dock.cuts.rowCount())]
    assert titles == [found.title(number) for number in range(len(found.cuts))]  # as the command line's
    assert titles[0].startswith("cut 1, ")
    monkeypatch.setattr(QFileDialog, "getOpenFileName", lambda *_: (str(path), ""))
    press(dock, qtbot, "load")
    assert dock.drawing.cuts[0].name == "drawn 1"

    viewer.window.remove_dock_widget(dock)
    assert [layer.name for layer in viewer.layers if layer.name in ("cuts", "stops of cuts")] == []
    assert viewer.layers["ball"].visible
    assert len(ViewerState.of(viewer).cuts_of(viewer.layers["ball"]).paths) == 1  # closing the dock loses nothing


def test_a_cut_of_a_left_hemisphere_is_medial_instead_of_right(open_widget, qtbot):
    points, faces = sphere(200)
    _, dock = open_widget(Surface((points, faces), metadata={"structure": "CortexLeft"}), name="Draw cuts")
    press(dock, qtbot, "begin")
    qtbot.waitUntil(dock.draw.isEnabled, timeout=PATIENCE)
    draw(dock, *np.argsort(points[:, 0])[-2:])
    assert dock.cuts.item(0, 0).text() == "drawn 1, medial"


def test_standard_cuts_show_the_excluded_part_and_make_a_template(make_napari_viewer, qtbot, tmp_path, monkeypatch):
    lab.write(tmp_path)
    ball = lab.fsaverage5("sphere_left")[0][: lab.VERTICES]
    nib.freesurfer.write_geometry(tmp_path / "lh.sphere.reg", ball, lab.hemisphere()[2])
    expected = voxflat.surface(tmp_path / "lh.white").cut(cuts="standard", relax=False)
    viewer = make_napari_viewer()
    viewer.open(str(tmp_path / "lh.white"), plugin="voxflat")
    _, widget = viewer.window.add_plugin_dock_widget("voxflat", "Flatten surface")
    _, dock = viewer.window.add_plugin_dock_widget("voxflat", "Draw cuts")
    assert not dock.template.isEnabled()
    press(dock, qtbot, "begin", "standard")
    left_out = expected.left_out
    assert 0 < len(left_out) < 400
    assert_array_equal(dock.drawing.left_out, left_out)
    seen = viewer.layers["lh.white (cuts)"].vertex_colors
    assert (seen[left_out, 0] > seen[left_out, 2]).all()

    dock.undo.click()
    assert len(dock.drawing.left_out) == 0
    assert (seen[left_out, 0] > seen[left_out, 2]).all()
    seen = viewer.layers["lh.white (cuts)"].vertex_colors
    assert (seen[:, 0] == seen[:, 2]).all()
    dock.redo.click()

    for name, button in (("cuts", "save"), ("mine", "template")):
        monkeypatch.setattr(QFileDialog, "getSaveFileName", lambda *_, name=name: (str(tmp_path / name), ""))
        press(dock, qtbot, button)
    assert json.loads((tmp_path / "cuts.json").read_text())["drop"] == left_out.tolist()
    assert "the same cuts on every brain" in dock.status.text(), dock.status.text()
    assert [line.name for line in read_template(tmp_path / "mine.json").cuts] == [cut.name for cut in expected.cuts]
    again = voxflat.surface(tmp_path / "lh.white").cut(cuts=tmp_path / "mine.json", relax=False)
    for one, other in zip(expected.cuts, again.cuts, strict=True):
        assert one.ids.tolist() == other.ids.tolist()

    dock.use.click()
    asked = widget.form.options.options("voxflat")
    assert_array_equal(asked["drop"], left_out)
    assert {name: path.tolist() for name, path in asked["cuts"].items()} == {
        cut.name: cut.ids.tolist() for cut in expected.cuts
    }


def test_using_cuts_opens_the_form(make_napari_viewer, qtbot):
    viewer = make_napari_viewer()
    viewer.add_surface(sphere(200), name="ball")
    _, dock = viewer.window.add_plugin_dock_widget("voxflat", "Draw cuts")
    press(dock, qtbot, "begin")
    press(dock, qtbot, "automatic")
    dock.use.click()
    _, widget = viewer.window.add_plugin_dock_widget("voxflat", "Flatten surface")
    assert widget.form.surface.layer.name == "ball"
    assert "along the drawn lines" in widget.form.plan.text()


def test_the_table_makes_the_standard_map_and_one_drawn_cut_more(make_napari_viewer, qtbot, tmp_path, monkeypatch):
    lab.write(tmp_path)
    ball = lab.fsaverage5("sphere_left")[0][: lab.VERTICES]
    nib.freesurfer.write_geometry(tmp_path / "lh.sphere.reg", ball, lab.hemisphere()[2])
    viewer = make_napari_viewer()
    viewer.open(str(tmp_path / "lh.white"), plugin="voxflat")
    _, widget = viewer.window.add_plugin_dock_widget("voxflat", "Flatten surface")
    run(widget, qtbot)
    state = ViewerState.of(viewer)
    first = state.current.flat_map
    assert first.metadata["frame"] == "standard"
    names = first.metadata["cut_names"]
    _, dock = viewer.window.add_plugin_dock_widget("voxflat", "Draw cuts")
    press(dock, qtbot, "begin")
    assert [cut.name for cut in dock.drawing.cuts] == names
    dock.use.click()
    run(widget, qtbot)
    second = state.current.flat_map
    assert second is not first
    assert (second.metadata["frame"], second.metadata["cut_names"]) == ("standard", names)
    assert_array_equal(second.ids, first.ids)
    assert np.abs(second.uv - first.uv).max() < 1e-9

    on_a_cut = int(first.metadata["cuts"][0][len(first.metadata["cuts"][0]) // 2])
    inner = np.setdiff1d(first.ids, np.concatenate(first.metadata["cuts"]))
    places = dock.drawing.surface.points
    apart = np.linalg.norm(places[inner] - places[on_a_cut], axis=1)
    draw(dock, on_a_cut, int(inner[np.abs(apart - 15).argmin()]))
    dock.again.click()
    qtbot.waitUntil(lambda: state.current.flat_map is not second and state.is_settled, timeout=PATIENCE)
    qtbot.waitUntil(widget.start.isEnabled, timeout=PATIENCE)
    third = state.current.flat_map
    assert third.metadata["cut_names"] == [*names, "drawn 1"]
    assert third.metadata["frame"] == "standard"
    assert_array_equal(np.unique(third.ids), np.unique(first.ids))

    monkeypatch.setattr(QFileDialog, "getExistingDirectory", lambda *_: str(tmp_path))
    widget.results.copy.click()
    script = QApplication.clipboard().text()
    exec(compile(script.replace("lh.white.voxflat", str(tmp_path / "again.voxflat")), "script", "exec"), {})
    assert_array_equal(voxflat.load(tmp_path / "again.voxflat").uv, third.uv)


def test_a_closed_line_is_named_by_its_name_in_the_table(open_widget, qtbot):
    viewer, widget = open_widget(Surface(sphere(200), name="ball"))
    _, dock = viewer.window.add_plugin_dock_widget("voxflat", "Draw cuts")
    press(dock, qtbot, "begin")
    draw(dock, 60, 64)
    dock.end_cut.click()
    points = dock.drawing.surface.points
    corners = [int(np.linalg.norm(points - corner, axis=1).argmin()) for corner in 20 * np.eye(3)]
    draw(dock, *corners, corners[0])
    dock.use.click()
    messages = []
    press(dock, qtbot, "evaluate")
    messages.append(dock.status.text())
    run(widget, qtbot)
    messages.append(widget.status.text())
    for message in messages:
        assert message.startswith("cut 'drawn 2' separates"), message
        assert "Shorten or remove this cut" in message


@pytest.mark.slow
def test_cuts_outlive_begin_another_layer_and_the_dock(make_napari_viewer, qtbot):
    viewer = make_napari_viewer()
    viewer.add_surface(sphere(200), name="ball")
    viewer.add_surface(bumps()[:2], name="bumps")
    window, dock = viewer.window.add_plugin_dock_widget("voxflat", "Draw cuts")

    def begin(dock, name):
        dock.form.surface.choose(viewer.layers[name])
        press(dock, qtbot, "begin")

    begin(dock, "ball")
    draw(dock, 3, 50)
    dock.end_cut.click()
    draw(dock, 70, 90)
    stops = [cut.stops for cut in dock.drawing.cuts]
    assert len(stops) == 2
    begin(dock, "ball")
    assert [cut.stops for cut in dock.drawing.cuts] == stops
    assert "are back" in dock.status.text()
    dock.form.surface.choose(viewer.layers["bumps"])  # the drawing stays until Begin
    draw(dock, 100)
    stops = [cut.stops for cut in dock.drawing.cuts]
    assert stops[1] == (70, 90, 100)
    begin(dock, "bumps")
    assert dock.drawing.cuts == ()
    begin(dock, "ball")
    viewer.window.remove_dock_widget(window)
    _, dock = viewer.window.add_plugin_dock_widget("voxflat", "Draw cuts")
    begin(dock, "ball")
    assert [cut.stops for cut in dock.drawing.cuts] == stops
    assert dock.cuts.rowCount() == 2
    dock.undo.click()  # with its history
    assert [cut.stops for cut in dock.drawing.cuts] == [stops[0], stops[1][:2]]


def test_one_more_cut_continues_from_the_displayed_map(open_widget, qtbot, tmp_path, monkeypatch, messages):
    points, faces = sphere(200)
    viewer, widget = open_widget(Surface((points, faces), name="ball"))
    state = ViewerState.of(viewer)
    assert not widget.form.continues.isVisibleTo(widget)
    run(widget, qtbot)
    first = state.current.flat_map
    assert widget.form.continues.isVisibleTo(widget)
    _, dock = viewer.window.add_plugin_dock_widget("voxflat", "Draw cuts")
    press(dock, qtbot, "begin")  # begins with the cuts of the map, as From map does
    assert "the cuts of the displayed map" in dock.status.text()
    told = first.metadata
    own = [*told["cuts"], *(cut["ids"] for cut in told["automatic_cuts"])]
    assert [path.tolist() for path in dock.drawing.paths().values()] == own
    assert len(dock.drawing.left_out) == 0
    assert [cut.name for cut in dock.drawing.cuts] == [f"cut {n}" for n in range(1, len(own) + 1)]

    on_a_cut = own[0][len(own[0]) // 2]
    uncut = np.setdiff1d(np.arange(len(points)), np.concatenate(own))
    apart = np.linalg.norm(points[uncut, None] - points[np.concatenate(own)], axis=2).min(axis=1)
    draw(dock, on_a_cut, int(uncut[apart.argmax()]))
    assert len(dock.drawing.cuts) == len(own) + 1
    dock.again.click()
    assert not messages
    dock.again.click()
    assert ["is still running" in message.message for message in messages] == [True]
    messages.clear()
    qtbot.waitUntil(lambda: state.current.flat_map is not first and state.is_settled, timeout=PATIENCE)
    qtbot.waitUntil(widget.start.isEnabled, timeout=PATIENCE)  # its thread may end after the map is there
    second = state.current.flat_map
    paths = {f"cut {n}": np.asarray(path) for n, path in enumerate(own, 1)}
    paths["drawn 1"] = dock.drawing.paths()["drawn 1"]
    expected = voxflat.flatten((points, faces), method=voxflat.methods.Voxflat(start=first), cuts=paths)
    assert_array_equal(second.uv, expected.uv)
    assert second.metadata["cut_names"] == [*paths]
    assert second.metadata["start"] is True
    assert len(second) > len(first)  # both sides of the new cut
    assert widget.form.continues.isChecked()

    # the script goes on from the same map
    monkeypatch.setattr(QFileDialog, "getExistingDirectory", lambda *_: str(tmp_path))
    widget.results.copy.click()
    script = QApplication.clipboard().text()
    assert "start=start" in script
    exec(compile(script.replace("ball.voxflat", str(tmp_path / "again.voxflat")), "script", "exec"), {})
    assert_array_equal(voxflat.load(tmp_path / "again.voxflat").uv, second.uv)

    # a map from which one cannot continue is reported, and stays
    dock.undo.click()
    dock.remove.setEnabled(True)
    dock.cuts.setCurrentCell(0, 0)
    dock.remove.click()
    dock.again.click()
    qtbot.waitUntil(lambda: widget.start.isEnabled(), timeout=PATIENCE)
    assert widget.status.text().startswith("the displayed map is cut at vertex"), widget.status.text()
    assert "Press From map in Draw cuts" in widget.status.text()
    assert state.current.flat_map is second
    viewer.layers.remove("ball")
    assert not widget.form.continues.isChecked()


def test_surfaces_too_small_to_evaluate_and_gains_beside_their_cuts(open_widget, qtbot):
    """A single point is not a cut, and has no gain; changed cuts do not show the gains of the previous ones."""
    viewer, dock = open_widget(Surface(sphere(40), name="tiny"), name="Draw cuts")

    def gains():
        return [dock.cuts.item(row, 2).text() for row in range(dock.cuts.rowCount())]

    press(dock, qtbot, "begin")
    draw(dock, 5)  # the first cut is a single point
    dock._do(Drawing.end_cut)
    draw(dock, 0, 20)
    press(dock, qtbot, "evaluate")
    assert gains() == ["", "unknown"]
    assert "too small" in dock.status.text()
    dock._on_evaluated((0.1, [0.02]))
    assert gains() == ["", "+2.0 %"]
    assert "all cuts: 10.0 %" in dock.status.text()
    dock.evaluate.click()
    draw(dock, 30)  # as a click on the surface meanwhile
    qtbot.waitUntil(dock.begin.isEnabled, timeout=PATIENCE)
    assert gains() == ["", ""]
    assert "Evaluate them again" in dock.status.text()

    dock.begin.click()  # and closed while its layers come, one by one
    qtbot.waitUntil(lambda: dock._layers is not None and "tiny (cuts)" in viewer.layers, timeout=PATIENCE)
    assert not dock.begin.isEnabled()
    viewer.window.remove_dock_widget(dock)
    (tiny,) = viewer.layers
    assert tiny.visible
    assert {*viewer.window._qt_viewer.controls.widgets} == {tiny}


def test_a_template_needs_a_sphere_or_a_brain(open_widget, qtbot, tmp_path, monkeypatch):
    viewer, dock = open_widget(Surface(sphere(150), name="ball"), name="Draw cuts")
    press(dock, qtbot, "begin")
    draw(dock, 0, 40)
    monkeypatch.setattr(QFileDialog, "getSaveFileName", lambda *_: (str(tmp_path / "t.json"), ""))
    press(dock, qtbot, "template")
    assert dock.status.text() not in ("", "making the template…")
    assert not (tmp_path / "t.json").exists()
    viewer.bind_key("Shift-N", print)
    _, flat = viewer.window.add_plugin_dock_widget("voxflat", "Flat map")  # the key binding of the user is kept
    for one in (dock, flat):
        viewer.window.remove_dock_widget(one)
    assert [*viewer.keymap.values()] == [print]


def test_drawings_and_cuts_come_back_with_the_saved_map(flattened, make_napari_viewer, qtbot, tmp_path, monkeypatch):
    points, faces, _ = bumps()
    viewer, widget, dock = flattened(Surface((points, faces), name="bumps"))
    _, cuts = viewer.window.add_plugin_dock_widget("voxflat", "Draw cuts")
    press(cuts, qtbot, "begin")
    draw(cuts, 30, 300)
    cuts.end_cut.click()
    draw(cuts, 400, 500)
    drawn = cuts.drawing.cuts
    viewer.layers.remove("bumps")  # and opened again
    viewer.add_surface((points, faces), name="again")
    press(cuts, qtbot, "begin")
    assert cuts.drawing.cuts == drawn

    u, v = dock.prepared.run.flat_map.uv.mean(axis=0)
    dock._draw_on(Sketch(((None, (u, v)),), ((None, ((u - 5, v), (u + 5, v), (u, v + 5))),)))
    wait_for_picture(dock, qtbot)
    path = tmp_path / "map.voxflat"
    monkeypatch.setattr(QFileDialog, "getSaveFileName", lambda *_: (str(path), ""))
    widget.results.save.click()
    region, marked = viewer.layers["bumps regions"].vertex_values, viewer.layers["bumps points"].data
    by_layer = tmp_path / "layer.npz"
    viewer.layers.selection = {viewer.layers["bumps distortion"]}
    viewer.layers.save(str(by_layer), selected=True, plugin="voxflat")
    assert voxflat.load(by_layer).metadata == voxflat.load(path).metadata
    viewer.close()

    viewer = make_napari_viewer(show=True)
    viewer.open(str(path), plugin="voxflat")
    dock = map_dock(viewer, qtbot)
    wait_for_picture(dock, qtbot)
    assert_array_equal(viewer.layers["map regions"].vertex_values, region)
    assert_allclose(viewer.layers["map points"].data, marked)
    assert not dock.undo.isEnabled()
    viewer.add_surface((points[:, ::-1], faces), name="another")
    _, cuts = viewer.window.add_plugin_dock_widget("voxflat", "Draw cuts")
    press(cuts, qtbot, "begin")
    assert cuts.drawing.cuts == ()
    viewer.add_surface((points, faces), name="bumps")
    cuts.form.surface.choose(viewer.layers["bumps"])
    press(cuts, qtbot, "begin")
    assert cuts.drawing.cuts == drawn
    assert "are back" in cuts.status.text()
    session = ViewerState.of(viewer).with_session(dock.prepared.run.flat_map).metadata["napari"]
    told = voxflat.load(path).metadata["napari"]
    assert json.loads(json.dumps(session)) == told


def test_drawn_cuts_are_chosen_again_for_a_saved_map_and_keep_their_names(
    open_widget, make_napari_viewer, qtbot, tmp_path
):
    points, faces = sphere(200)
    viewer, widget = open_widget(Surface((points, faces), name="ball"))
    _, dock = viewer.window.add_plugin_dock_widget("voxflat", "Draw cuts")
    press(dock, qtbot, "begin")
    draw(dock, 3, 50, 90)
    paths = dock.drawing.paths()
    dock.use.click()
    run(widget, qtbot)
    first = ViewerState.of(viewer).current.flat_map
    path = tmp_path / "map.voxflat"
    ViewerState.of(viewer).with_session(first).save(path)
    viewer.close()

    viewer = make_napari_viewer()
    open_file(viewer, qtbot, path)
    viewer.add_surface((points, faces), name="ball")
    _, widget = viewer.window.add_plugin_dock_widget("voxflat", "Flatten surface")
    qtbot.waitUntil(lambda: widget.form.options.cuts == "drawn", timeout=PATIENCE)
    assert_array_equal(widget.form.options.options("voxflat")["cuts"]["drawn 1"], paths["drawn 1"])
    assert "along the drawn lines" in widget.form.plan.text()
    run(widget, qtbot)
    state = ViewerState.of(viewer)
    assert_array_equal(state.current.flat_map.uv, first.uv)

    _, dock = viewer.window.add_plugin_dock_widget("voxflat", "Draw cuts")
    press(dock, qtbot, "begin")
    assert [cut.name for cut in dock.drawing.cuts] == ["drawn 1"]
    second = state.current.flat_map
    dock.again.click()
    qtbot.waitUntil(lambda: state.current.flat_map is not second and state.is_settled, timeout=PATIENCE)
    qtbot.waitUntil(widget.start.isEnabled, timeout=PATIENCE)
    assert state.current.flat_map.metadata["cut_names"] == ["drawn 1"]
    widget.form.options._cuts.setCurrentIndex(0)
    assert widget.form.continues.isChecked()
    third = state.current.flat_map
    run(widget, qtbot)
    assert state.current.flat_map is not third
    assert state.current.flat_map.metadata["cut_names"] == ["drawn 1"]
