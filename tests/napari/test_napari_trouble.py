"""Errors, cancelling, and layers removed during a run: messages appear, and the window stays responsive."""

import time

import numpy as np
import pytest
from napari.layers import Image, Labels, Points, Shapes, Surface
from napari_window import (
    PATIENCE,
    bumps,
    cap,
    choose,
    choose_whole,
    open_file,
    run,
    run_whole,
    wait_for_picture,
    wait_for_threads,
    wait_until_drawn,
)
from qtpy.QtCore import QPoint, QTimer
from qtpy.QtWidgets import QPushButton

import voxflat
from voxflat._napari.job import Job
from voxflat._napari.viewer_state import ViewerState


def dome(size):
    points, faces, _ = bumps(size)
    points[:, 2] = -0.75 / size * ((points[:, :2] - size + 1) ** 2).sum(axis=1)
    return points, faces


@pytest.fixture(scope="module")
def large():
    """A thick shell: many seconds of work from 6000 sources within 60 mm, a second or two from a few within 25 mm."""
    x = np.indices((72, 72, 72)) - 36
    return (np.abs(np.sqrt((x**2).sum(axis=0)) - 28) < 1.5).astype(np.uint8)


def start_large(widget, qtbot, large, sources=6000, radius=60):
    """Start a long run, and wait until the core is working."""
    choose(widget.form.patch, "disk")
    widget.form.seed.set_point(tuple(int(n) for n in np.argwhere(large)[0]))
    widget.form.radius.setValue(radius)
    start(widget, qtbot, sources)


def start(widget, qtbot, sources=None):
    if sources is not None:
        widget.form.options.sources.setValue(sources)
    widget.start.click()
    qtbot.waitUntil(lambda: widget._worker.stage[1] > 0, timeout=PATIENCE)  # the bar is updated four times per second


POINTS, FACES, _ = bumps()
BAD_LAYERS = [
    (lambda: Labels(np.ones((9, 9), dtype=np.uint8)), "2 dimensions"),
    (lambda: Labels(np.stack([np.zeros((9, 9, 9), np.uint8), np.ones((9, 9, 9), np.uint8)])), "frame 0: no voxel"),
    (lambda: Image(np.where(cap() > 0, 3, np.nan), contrast_limits=(0, 3)), "NaN"),
    (lambda: Surface((np.zeros((3, 2)), np.array([[0, 1, 2]]))), "2 dimensions"),
    (lambda: Surface((POINTS, np.array([[0, 1, 26, 25]]))), "not triangles (4 corners)"),
    (lambda: Surface((POINTS, FACES, np.ones((2, 625)))), "have 2 axes"),
    (lambda: Surface((np.where(POINTS > 47, np.inf, POINTS), FACES)), "lies beyond"),
]


def test_bad_input_gives_a_one_line_message_and_adds_no_layer(open_widget, qtbot, messages):
    viewer, widget = open_widget()
    for layer, message in BAD_LAYERS:
        viewer.layers.clear()
        messages.clear()
        bad = viewer.add_layer(layer())
        widget.form.surface.choose(bad)
        choose_whole(widget)
        run(widget, qtbot)
        assert len(messages) == 1, message
        assert str(messages[0].severity) == "error"
        assert message in messages[0].message
        assert "\n" not in messages[0].message
        assert not hasattr(messages[0], "exception")  # no traceback
        assert message in widget.status.text()
        assert list(viewer.layers) == [bad]
        assert widget.start.isEnabled()
    viewer.add_labels(cap(), name="good")  # and it goes on
    widget.form.surface.choose(viewer.layers["good"])
    qtbot.waitUntil(lambda: widget.form.label.label == 3, timeout=PATIENCE)
    run(widget, qtbot)
    assert "good distortion" in viewer.layers


def test_a_closed_surface_is_refused_by_grossmann2002(open_widget, qtbot, messages):
    viewer, widget = open_widget(Labels(np.pad(np.ones((5, 5, 5), dtype=np.uint8), 2)), show=True)
    viewer.window._qt_window.resize(1000, 600)
    choose(widget.form.method, "grossmann2002")
    choose_whole(widget)
    run(widget, qtbot)
    assert "closed" in messages[-1].message
    choose(widget.form.method, "voxflat")
    run(widget, qtbot)
    shown, flat = widget.results.warnings, viewer.window.dock_widgets["Flat map (voxflat)"]
    assert shown.visibleRegion().isEmpty()  # the map is in front
    assert flat.warned.visibleRegion().boundingRect() == flat.warned.rect()
    assert flat.warned.text() == f"⚠ {shown.text().count('⚠')} warnings"
    assert "cut open" in flat.warned.toolTip()
    flat.warned.click()
    qtbot.waitUntil(lambda: shown.visibleRegion().contains(QPoint(5, 5)), timeout=PATIENCE)  # below the form
    assert "cut open" in shown.text()
    viewer.window._qt_window.resize(1000, 1000)
    qtbot.waitUntil(lambda: shown.visibleRegion().boundingRect() == shown.rect(), timeout=PATIENCE)


def test_missing_choices_are_named(open_widget, messages):
    viewer, widget = open_widget()
    widget.start.click()
    assert "no surface to flatten" in messages[-1].message
    viewer.add_labels(cap())
    for part, missing in (("disk", "no seed point"), ("polygon", "no polygon"), ("mask", "no mask")):
        choose(widget.form.patch, part)
        widget.start.click()
        assert missing in messages[-1].message
        assert missing in widget.status.text()
    choose_whole(widget)
    assert widget.status.text() == ""
    viewer.add_image(np.ones((24, 24, 24)), units="mm")
    widget.start.click()
    assert "units" in messages[-1].message


@pytest.mark.parametrize("name", ["Flatten surface", "Flatten in patches", "Draw cuts", "Check surface"])
def test_an_error_goes_away_once_the_input_is_mended(open_widget, qtbot, name):
    viewer, dock = open_widget(name=name)
    begin = next(button for button in dock.findChildren(QPushButton) if button.text() in (name, "Begin", "Check"))
    shown = (lambda: dock.table.toPlainText()) if name == "Check surface" else dock.status.text
    begin.click()
    assert "no surface to flatten" in shown()
    layer = viewer.add_surface((POINTS, FACES))
    assert shown() == ""
    several = np.ones((2, len(POINTS)))
    for attribute, bad, error, good in (
        ("data", (POINTS, FACES, several), "have 2 axes", (POINTS, FACES)),
        ("units", "s", "units", "mm"),
    ):
        setattr(layer, attribute, bad)
        begin.click()
        qtbot.waitUntil(lambda error=error: error in shown(), timeout=PATIENCE)
        setattr(layer, attribute, good)
        assert shown() == ""


def test_errors_about_the_part_go_away_once_it_is_drawn(open_widget):
    viewer, widget = open_widget(Labels(cap()))
    drawn = np.array([[8.0, 8, 20], [8, 16, 20], [16, 16, 20]])
    line = Shapes([drawn[:2]], shape_type="path")
    for part, layer in (("disk", Points(drawn)), ("polygon", line), ("mask", Labels(cap()))):
        choose(widget.form.patch, part)
        widget.start.click()
        assert "There is no" in widget.status.text()
        viewer.add_layer(layer)
        assert widget.status.text() == ""
    choose(widget.form.patch, "polygon")
    widget.start.click()
    assert "has 2 corners" in widget.status.text()
    line.data = [drawn]
    assert widget.status.text() == ""


def test_measures_are_those_of_the_map_that_is_there(open_widget, qtbot):
    viewer, widget = open_widget(Surface((POINTS, FACES), name="it"))
    _, measure = viewer.window.add_plugin_dock_widget("voxflat", "Measure map")
    assert "There is no flat map" in measure.table.toPlainText()
    run(widget, qtbot)
    assert measure.table.toPlainText().startswith("it\n")


def test_a_bug_comes_with_its_traceback(open_widget, qtbot, messages, monkeypatch):
    def broken(*args):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr("voxflat._napari.job.Job.run", broken)
    viewer, widget = open_widget(Labels(cap()))
    choose_whole(widget)
    run(widget, qtbot)
    assert isinstance(messages[0].exception, ZeroDivisionError)
    assert len(viewer.layers) == 1


def begin(open_widget, qtbot, large, kind, few):
    """Begin to flatten a layer: seconds of work, or a second or two if `few`."""
    if kind == "patches":
        viewer, widget = open_widget(Surface(bumps(200)[:2], name="it"), name="Flatten in patches")
        choose(widget.form.limit, "count")
        widget.form.count.setValue(200)  # tries many angles
        start(widget, qtbot)
    elif kind == "mesh":
        viewer, widget = open_widget(Surface(dome(50 if few else 150), name="it"))
        choose_whole(widget)
        start(widget, qtbot, 200 if few else 4000)
    else:
        viewer, widget = open_widget(Labels(large, name="it"))
        start_large(widget, qtbot, large, **({"sources": 300, "radius": 25} if few else {}))
    return viewer, widget


@pytest.mark.parametrize("kind", ["volume", "mesh", "patches"])
def test_cancel_is_prompt(open_widget, qtbot, large, kind):
    viewer, widget = begin(open_widget, qtbot, large, kind, few=False)
    before, layers = time.perf_counter(), list(viewer.layers)
    widget.stop.click()
    qtbot.waitUntil(widget.start.isEnabled, timeout=5_000)
    assert time.perf_counter() - before < 1  # about 0.02 s on an idle machine
    assert widget.status.text() == "Cancelled"
    assert list(viewer.layers) == layers
    if kind != "patches":
        widget.form.radius.setValue(15)
        widget.form.options.sources.setValue(50)
        run(widget, qtbot)
        assert "it distortion" in viewer.layers


@pytest.mark.parametrize("kind", ["volume", "mesh"])
def test_removing_the_layer_during_a_run_is_safe(open_widget, qtbot, large, kind):
    viewer, _ = begin(open_widget, qtbot, large, kind, few=True)
    viewer.layers.clear()
    qtbot.waitUntil(lambda: "it distortion" in viewer.layers, timeout=PATIENCE)


def test_window_stays_alive(open_widget, qtbot, large):
    viewer, widget = open_widget(Labels(large), Image(large.astype(np.float32)), show=True)
    ticks, timer = [], QTimer()
    timer.timeout.connect(lambda: ticks.append((time.perf_counter(), len(viewer.layers))))
    wait_until_drawn(viewer, qtbot)
    start_large(widget, qtbot, large, sources=500, radius=32)
    timer.start(5)
    qtbot.waitUntil(widget.start.isEnabled, timeout=PATIENCE)
    timer.stop()
    times, layers = np.transpose(ticks)
    computing = times[layers == layers[0]]
    assert np.diff(computing).max() < np.ptp(computing) / 2


@pytest.mark.parametrize("close", ["window", "dock"])
def test_closing_during_a_run_cancels_it(open_widget, qtbot, large, close, messages, monkeypatch):
    run, endings = Job.run, []

    def watched(job, progress):
        try:
            return run(job, progress)
        except Exception as error:
            endings.append(type(error))
            raise

    monkeypatch.setattr(Job, "run", watched)
    viewer, widget = open_widget(Labels(large))
    start_large(widget, qtbot, large)
    layers = list(viewer.layers)
    if close == "window":
        viewer.close()
    else:
        viewer.window.remove_dock_widget(widget)
    wait_for_threads(qtbot)
    assert endings == [voxflat.Cancelled]
    assert ["because its dock was closed" in one.message for one in messages] == [True] * (close == "dock")
    if close == "dock":
        assert list(viewer.layers) == layers
        viewer.add_labels(cap())  # nothing follows the viewer any more


def test_rgb_pages_are_added_in_3d(open_widget, qtbot, tmp_path):
    """napari cannot add a hidden RGB image in 3D."""
    mesh = bumps(9)[:2]
    voxflat.surface(mesh).patches(count=2).save(tmp_path / "atlas.voxflat")
    viewer, widget = open_widget(Surface(mesh, name="grid"), name="Flatten in patches")
    viewer.dims.ndisplay = 3
    run(widget, qtbot)
    open_file(viewer, qtbot, tmp_path / "atlas.voxflat")
    pages = [viewer.layers[f"{name} patches"] for name in ("grid", "atlas")]
    qtbot.waitUntil(lambda: not any(page.visible for page in pages), timeout=PATIENCE)


def test_all_layers_are_removed_and_others_added(open_widget, qtbot):
    """From 3D, with the map's dock open."""
    viewer, widget = open_widget(Labels(cap(), name="sheet"), Image(cap().astype(float), name="T1"), show=True)
    viewer.dims.ndisplay = 3
    box = widget.form.surface
    box.activated.emit(box.currentIndex())  # by the user
    run_whole(widget, qtbot)
    viewer.layers.clear()
    assert box.layer is None
    viewer.add_labels(cap(), name="another")
    assert box.layer is viewer.layers["another"]
    viewer.add_points([[3, 3, 3]])
    wait_until_drawn(viewer, qtbot)


def test_results_name_their_map(open_widget, qtbot):
    viewer, widget = open_widget(Labels(cap(), name="sheet"))
    run_whole(widget, qtbot)
    assert widget.results.title.text() == "Map of <b>sheet</b>"
    viewer.add_labels(np.ones((9, 9), np.uint8), name="picture")
    widget.form.surface.choose(viewer.layers["picture"])
    run(widget, qtbot)
    assert "2 dimensions" in widget.status.text()
    assert widget.results.title.text() == "Previous result: Map of <b>sheet</b>"


def test_texts_belong_to_the_map_and_the_action_that_is_shown(flattened, qtbot, messages):
    sheet = Labels(cap(), name="sheet", units="mm")
    seconds = Image(np.ones((24, 24, 24), np.float32), name="seconds", units="s")
    viewer, widget, dock = flattened(sheet, seconds)
    state = ViewerState.of(viewer)
    assert "mean distance error" in widget.status.text()
    dock.keep.setChecked(True)
    widget.form.options.sources.setValue(20)
    run(widget, qtbot, dock)
    assert "mean distance error" in widget.status.text()
    assert viewer.status == widget.status.text()
    state.choose(state.runs[0])  # the figures are those of the other map
    assert viewer.status == widget.status.text() == ""
    state.choose(state.runs[1])

    def show(name):
        dock.contents.setCurrentText(name)
        wait_for_picture(dock, qtbot)

    show("seconds")
    assert "'seconds' are second" in dock.text.text()
    choose(widget.form.patch, "disk")
    widget.start.click()
    assert "There is no seed point" in widget.status.text()
    show("Areas")
    assert dock.text.text().startswith("Point at the map")
    assert widget.status.text() == ""


def test_two_docks_fit_a_small_screen(open_widget, qtbot):
    viewer, widget = open_widget(Labels(cap(), name="sheet"), show=True)
    viewer.window.add_plugin_dock_widget("voxflat", "Flatten in patches")
    qtbot.waitUntil(lambda: widget.form.label.label == 3, timeout=PATIENCE)
    widget.parentWidget().raise_()  # the two are tabs
    choose_whole(widget)
    run(widget, qtbot)
    widget.parentWidget().raise_()  # in front of the map, which came
    window = viewer.window._qt_window
    assert window.minimumSizeHint().height() <= 740
    window.resize(1366, 740)
    wait_until_drawn(viewer, qtbot)
    assert (window.width(), window.height()) == (1366, 740)

    def is_wide_enough():  # the figures widen the dock, which Qt does in turns of its own
        return widget.scrolled.viewport().width() >= widget.scrolled.widget().minimumSizeHint().width()

    qtbot.waitUntil(is_wide_enough, timeout=PATIENCE)
    bar = widget.scrolled.verticalScrollBar()
    bar.setValue(bar.maximum())  # the last of the figures can be seen, and the buttons stay
    inside = widget.results.save.mapTo(widget.scrolled.viewport(), widget.results.save.rect().center())
    assert widget.scrolled.viewport().rect().contains(inside)
    assert widget.start.visibleRegion().boundingRect() == widget.start.rect()
