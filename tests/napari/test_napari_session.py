"""Work that a user has done outlives docks, windows, layers and further maps, in any order of actions."""

from dataclasses import replace

import numpy as np
import pytest
from napari.layers import Labels, Layer, Surface
from napari_window import PATIENCE, bumps, map_dock, open_file, run, wait_for_picture, wait_for_threads
from numpy.testing import assert_array_equal
from qtpy.QtWidgets import QDialog, QMessageBox

import voxflat
from voxflat import samples
from voxflat._napari.map_viewer.dock import GO, MEASURE, REGION
from voxflat._napari.results.sketch import Sketch
from voxflat._napari.samples import demo_embryo, demo_rim
from voxflat._napari.viewer_state import ViewerState


def press(dock, button, qtbot):
    button.click()
    qtbot.waitUntil(lambda: dock._worker is None, timeout=PATIENCE)


def layers_of(sample):
    return [Layer.create(*data) for data in sample]


def everything(flat_map):
    """A point, a region and a distance on a map."""
    u, v = flat_map.uv.mean(axis=0)
    region = ((u - 5, v), (u + 5, v), (u, v + 5))
    return Sketch(((None, (u, v)),), ((None, region),), (None, ((u - 5, v), (u + 5, v))))


def saved_drawings(state, run, folder):
    """Return the drawings of a map that is saved now."""
    state.with_session(run.flat_map).save(folder / "now.voxflat", overwrite=True)
    return Sketch.of(voxflat.load(folder / "now.voxflat").metadata["napari"])


def test_unfinished_drawings_are_continued_after_the_dock_the_layer_and_the_window_were_closed(
    flattened, make_napari_viewer, qtbot, tmp_path
):
    viewer, _, dock = flattened(Surface(bumps()[:2], name="bumps"))
    u, v = dock.prepared.run.flat_map.uv.mean(axis=0)

    def click(dock, *places):
        for du, dv in places:
            dock.canvas.clicked.emit(u + du, v + dv)
        wait_for_picture(dock, qtbot)

    dock.click.setCurrentText(MEASURE)
    click(dock, (-5, 0), (5, 0))
    dock.undo.click()
    dock.redo.click()
    dock.click.setCurrentText(REGION)
    click(dock, (-5, -5), (5, -5))
    viewer.window.remove_dock_widget(dock)
    viewer.layers.remove("bumps")
    dock = map_dock(viewer, qtbot)
    assert dock.click.currentText() == REGION
    click(dock, (0, 5))
    drawn = dock.prepared.run.sketches.now
    assert len(drawn.corners) == 3
    dock.click.setCurrentText(GO)  # the corners are discarded, and brought back
    assert dock.prepared.run.sketches.now.corners == ()
    dock.undo.click()
    assert (dock.prepared.run.sketches.now, dock.click.currentText()) == (drawn, GO)  # undo keeps the action of a click
    dock.click.setCurrentText(REGION)  # which continues with these corners
    assert dock.prepared.run.sketches.now == drawn
    path = tmp_path / "map.voxflat"
    viewer.layers.selection = {viewer.layers["bumps distortion"]}
    viewer.layers.save(str(path), selected=True, plugin="voxflat")
    length = viewer.layers["bumps shortest path"].data[0]
    viewer.close()

    viewer = make_napari_viewer()
    open_file(viewer, qtbot, path)
    dock = map_dock(viewer, qtbot)
    assert dock.prepared.run.sketches.now == drawn
    assert_array_equal(viewer.layers["map shortest path"].data[0], length)
    assert dock.click.currentText() == REGION
    dock.canvas.double_clicked.emit()
    wait_for_picture(dock, qtbot)
    assert viewer.layers["map regions"].vertex_values.max() == 1
    wait_for_threads(qtbot)


def test_the_layers_of_two_maps_of_one_surface_begin_with_the_names_of_their_maps(flattened, qtbot, tmp_path):
    viewer, widget, dock = flattened(Surface(bumps(13), name="bumps"))
    state, titles = ViewerState.of(viewer), ("bumps", "bumps (2)", "saved", "saved (2)")
    dock.keep.setChecked(True)
    run(widget, qtbot, dock)
    state.current.flat_map.save(tmp_path / "saved.voxflat")
    for _ in range(2):
        open_file(viewer, qtbot, tmp_path / "saved.voxflat")
    dock.on_surface.click()
    dock.outlined.click()
    for number in range(4):
        state.choose(state.runs[number])
        wait_for_picture(dock, qtbot)
        dock._draw_on(everything(dock.prepared.run.flat_map))
        wait_for_picture(dock, qtbot)
    assert [dock.runs.itemText(number) for number in range(4)] == [f"{n}: {t}" for n, t in enumerate(titles, 1)]
    parts = ["distortion", "points", "regions", "shortest path"]
    expected = [f"{title} {part}" for title in titles for part in parts]
    expected += ["bumps flattened", "bumps (2) flattened", "saved (2) in map colours", "saved (2) outline", "bumps"]
    assert sorted(layer.name for layer in viewer.layers) == sorted(expected)
    wait_for_threads(qtbot)


def test_a_map_is_removed_from_the_list_after_a_question_if_its_drawings_are_not_saved(
    flattened, qtbot, monkeypatch, tmp_path
):
    viewer, widget, dock = flattened(Surface(bumps(13)[:2], name="bumps"))
    state, asked, answers = ViewerState.of(viewer), [], [QMessageBox.StandardButton.No]
    dock.keep.setChecked(True)
    for _ in range(3):
        run(widget, qtbot, dock)
    first, second, third, fourth = state.runs
    own = viewer.add_points([[1.0, 2.0, 3.0]], name="own")

    def question(parent, title, text):
        asked.append(text)
        return answers[-1]

    def is_removed(*removed):
        dock.remove.click()
        wait_for_picture(dock, qtbot)
        return not any(one in state.runs for one in removed)

    monkeypatch.setattr("qtpy.QtWidgets.QMessageBox.question", question)
    viewer.layers.remove("bumps (4) distortion")
    assert dock.runs.count() == 4  # removed layers of a map do not remove it
    state.choose(third)
    assert is_removed(third)
    assert asked == []
    assert state.current is fourth
    for number, one in enumerate((first, second)):
        state.choose(one)
        wait_for_picture(dock, qtbot)
        dock._draw_on(everything(one.flat_map))
        wait_for_picture(dock, qtbot)
        if number:
            state.save(one.flat_map, str(tmp_path / "map.voxflat"))
            assert is_removed(one)
        else:
            assert not is_removed(one)
            assert "Removing the map 'bumps' also" in asked[0]
            assert "what you drew on the map" in asked[0]
            answers.append(QMessageBox.StandardButton.Yes)
            assert is_removed(one)
            qtbot.waitUntil(lambda: len(viewer.layers) == 3, timeout=PATIENCE)
    assert len(asked) == 2  # not about saved drawings
    qtbot.waitUntil(lambda: list(viewer.layers) == [viewer.layers["bumps"], own], timeout=PATIENCE)
    assert dock.prepared.run is fourth
    assert not dock.remove.isVisible()
    wait_for_threads(qtbot)


@pytest.mark.parametrize("what", ["points", "regions", "shortest path"])
def test_a_layer_with_drawings_that_the_user_removes_is_removed_from_its_map(flattened, qtbot, tmp_path, what):
    viewer, _, dock = flattened(Surface(bumps()[:2], name="bumps"))
    run, state = dock.prepared.run, ViewerState.of(viewer)
    drawn = everything(run.flat_map)
    dock._draw_on(drawn)
    wait_for_picture(dock, qtbot)
    shown = {part: viewer.layers[f"bumps {part}"].data[-1] for part in run.sketches.layers}
    left = {"points": replace(drawn, marks=()), "regions": replace(drawn, regions=())}
    left["shortest path"] = replace(drawn, distance=None)

    def parts():
        wait_for_picture(dock, qtbot)
        there = [part for part in shown if f"bumps {part}" in viewer.layers]
        return {part for part in there if len(viewer.layers[f"bumps {part}"].data)}

    viewer.layers.remove(f"bumps {what}")
    assert parts() == {*shown} - {what}
    assert f"What you deleted from 'bumps {what}' was removed from the map" in dock.text.text()
    assert run.sketches.now == left[what]
    assert len(dock.canvas.drawn.lines) == (what != "regions")
    assert saved_drawings(state, run, tmp_path) == left[what]
    dock.undo.click()
    assert parts() == {*shown}
    assert run.sketches.now == drawn
    for part, places in shown.items():
        assert_array_equal(viewer.layers[f"bumps {part}"].data[-1], places)
    dock.redo.click()
    assert parts() == {*shown} - {what}
    dock.undo.click()
    wait_for_picture(dock, qtbot)

    viewer.window.remove_dock_widget(dock)  # the map knows about it without its dock
    viewer.layers.remove(f"bumps {what}")
    assert saved_drawings(state, run, tmp_path) == left[what]
    dock = map_dock(viewer, qtbot)
    assert parts() == {*shown} - {what}
    dock.undo.click()
    assert parts() == {*shown}
    wait_for_threads(qtbot)


def test_points_that_the_user_deletes_are_removed_from_their_map(flattened, qtbot, tmp_path):
    viewer, _, dock = flattened(Surface(bumps()[:2], name="bumps"))
    run, state = dock.prepared.run, ViewerState.of(viewer)
    u, v = run.flat_map.uv.mean(axis=0)
    marks = tuple((None, (u + du, v)) for du in (-5, 0, 0, 5))
    for count in range(1, 5):
        dock._draw_on(Sketch(marks[:count]))
    wait_for_picture(dock, qtbot)
    layer = viewer.layers["bumps points"]
    places = layer.data.copy()
    own = layer.add([[1.0, 2.0, 3.0]])  # which is no mark of the map
    assert own is None
    layer.selected_data = {0, 1}
    layer.remove_selected()
    assert run.sketches.now.marks == marks[2:] == saved_drawings(state, run, tmp_path).marks
    assert "was removed from the map" in dock.text.text()
    dock.undo.click()
    wait_for_picture(dock, qtbot)
    assert run.sketches.now.marks == marks
    assert_array_equal(layer.data[1:], places)
    dock.undo.click()
    wait_for_picture(dock, qtbot)
    assert run.sketches.now.marks == marks[:3]
    assert_array_equal(layer.data[1:], places[:3])
    layer.selected_data = {0}
    layer.remove_selected()
    assert run.sketches.now.marks == marks[:3]
    wait_for_threads(qtbot)


@pytest.mark.parametrize("what", ["in map colours", "outline"])
def test_a_layer_that_a_box_shows_can_be_removed_and_shown_again(flattened, qtbot, what):
    viewer, _, dock = flattened(Surface(bumps(13)[:2], name="bumps"))
    box = {"in map colours": dock.on_surface, "outline": dock.outlined}[what]
    for _ in range(2):
        box.click()
        wait_for_picture(dock, qtbot)
        viewer.layers.remove(f"bumps {what}")
        wait_for_picture(dock, qtbot)
        assert not box.isChecked()
        assert viewer.layers["bumps"].visible
    wait_for_threads(qtbot)


def test_napari_asks_before_it_closes_a_window_with_maps(flattened, qtbot, monkeypatch):
    from napari._qt import qt_main_window

    viewer, _, dock = flattened(Surface(bumps(13)[:2], name="bumps"))
    u, v = dock.prepared.run.flat_map.uv.mean(axis=0)
    dock.click.setCurrentText(REGION)
    dock.canvas.clicked.emit(u, v)
    viewer.layers.remove("bumps")  # the layers of the map remain
    asked = []

    class Declined:
        def __init__(self, *given, **how):
            asked.append("asked")

        def exec_(self):
            return QDialog.DialogCode.Rejected

    class ByUser:
        def spontaneous(self):
            return True

        def ignore(self):
            asked.append("ignored")

    monkeypatch.setattr(qt_main_window, "ConfirmCloseDialog", Declined)
    monkeypatch.setattr(qt_main_window.get_settings().application, "confirm_close_window", True)  # napari's default
    viewer.window._qt_window.closeEvent(ByUser())
    assert asked == ["asked", "ignored"]
    assert ViewerState.of(viewer).current.sketches.now.corners == ((u, v),)


def test_the_layers_that_a_dock_made_are_not_replaced_once_they_are_edited(open_widget, qtbot):
    viewer, dock = open_widget(Labels(samples.rim().data, name="rim"), name="Cortical depth")
    qtbot.waitUntil(lambda: dock.form.label.rim == "rim", timeout=PATIENCE)
    dock.form.count.setValue(3)
    press(dock, dock.layers, qtbot)
    dock.form.count.setValue(4)
    press(dock, dock.layers, qtbot)
    made = viewer.layers["rim in layers"]
    assert made.data.max() == 4
    made.data[0, 0, 0] = 9
    for count in (5, 6):
        dock.form.count.setValue(count)
        press(dock, dock.layers, qtbot)
    assert made in viewer.layers
    assert made.data.max() == 9
    assert [(layer.name, layer.data.max()) for layer in viewer.layers[2:]] == [("rim in layers [1]", 6)]
    wait_for_threads(qtbot)


def test_labels_in_the_window_of_a_flat_volume_come_back(open_widget, qtbot, messages):
    viewer, widget = open_widget(*layers_of(demo_rim()))
    qtbot.waitUntil(lambda: widget.form.label.rim == "rim", timeout=PATIENCE)
    run(widget, qtbot)
    _, dock = viewer.window.add_plugin_dock_widget("voxflat", "Cortical depth")
    qtbot.waitUntil(lambda: dock.form.label.rim == "rim", timeout=PATIENCE)
    dock.form.count.setValue(3)
    press(dock, dock.flatten, qtbot)
    flat = dock.flat_window.viewer
    image = flat.layers[0]
    place = {name: getattr(image, name) for name in ("scale", "translate", "units")}
    painted = flat.add_labels((image.data > 0).astype(int), name="active", **place).data.copy()
    flat.add_labels(np.zeros(image.data.shape, dtype=int), name="empty", **place)
    flat.add_points([[0.5, 1, 2]], name="peaks")
    del flat, image, place
    viewer.window.remove_dock_widget(dock)
    assert any("'active', 'peaks'" in one.message for one in messages)
    _, dock = viewer.window.add_plugin_dock_widget("voxflat", "Cortical depth")
    qtbot.waitUntil(lambda: dock.form.label.rim == "rim", timeout=PATIENCE)
    press(dock, dock.flatten, qtbot)
    layers = dock.flat_window.viewer.layers
    assert [layer.name for layer in layers][1:] == ["active", "peaks"]
    assert_array_equal(layers["active"].data, painted)
    assert_array_equal(layers["peaks"].data, [[0.5, 1, 2]])
    del layers
    viewer.window.remove_dock_widget(dock)
    wait_for_threads(qtbot)


def test_drawings_in_the_window_of_a_movie_keep_their_maps(open_widget, qtbot, monkeypatch):
    found = samples.embryo(2)
    monkeypatch.setattr(samples, "embryo", lambda: found)
    viewer, widget = open_widget(*layers_of(demo_embryo()), show=True)
    state = ViewerState.of(viewer)
    qtbot.waitUntil(lambda: "voxels" in widget.form.label.currentText(), timeout=PATIENCE)
    run(widget, qtbot)
    dock = map_dock(viewer, qtbot)
    first = state.current
    press(dock, dock.movie, qtbot)
    flat = dock.movies.window.viewer
    flat._new_labels()
    flat.layers[-1].data[0, 70:75, 80:85] = 3
    painted, name = flat.layers[-1].data.copy(), flat.layers[-1].name
    flat.add_points([[0, 1, 2]], name="cells")
    del flat
    run(widget, qtbot, dock)
    assert [one is first for one in state.runs] == [True, False]
    run(widget, qtbot, dock)
    assert [one is first for one in state.runs] == [True, False]
    state.choose(first)
    wait_for_picture(dock, qtbot)
    press(dock, dock.movie, qtbot)
    layers = dock.movies.layers
    assert {layer.name for layer in layers[1:]} == {name, "cells"}
    assert_array_equal(next(layer for layer in layers if layer.name == name).data, painted)
    del layers
    viewer.window.remove_dock_widget(dock)
    wait_for_threads(qtbot)
