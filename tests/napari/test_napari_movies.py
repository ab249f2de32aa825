"""Movies of tissue in napari's window: all frames on one map, linked in time, and labels back in the volume."""

import numpy as np
import pytest
from napari.layers import Image, Labels, Surface
from napari_window import PATIENCE, choose, map_dock, open_file, run, wait_for_picture, wait_for_threads
from numpy.testing import assert_allclose, assert_array_equal

import voxflat
from voxflat import samples
from voxflat._napari.map_viewer.dock import MARK, MEASURE, REGION
from voxflat._napari.results.report import figures
from voxflat._napari.samples import demo_embryo
from voxflat._napari.viewer_state import ViewerState
from voxflat.io import Volume

FRAMES, REFERENCE = 3, 1


@pytest.fixture(scope="module")
def embryo():
    """The sample data, with fewer frames."""
    return samples.embryo(FRAMES)


def zyx(volume):
    """Return a volume with its axes in the order of the layers."""
    return Volume(volume.data.T, volume.affine[:, [2, 1, 0, 3]], unit=volume.unit)


@pytest.fixture(scope="module")
def series(embryo):
    """The maps as in Python, from voxels in the same order."""
    return voxflat.flatten_series([voxflat.surface(zyx(labels)) for labels in embryo.labels], reference=REFERENCE)


@pytest.fixture(autouse=True)
def small_sample(embryo, monkeypatch):
    monkeypatch.setattr(samples, "embryo", lambda: embryo)


def layers_of_sample():
    kinds = {"image": Image, "labels": Labels}
    return [kinds[kind](data, **about) for data, about, kind in demo_embryo()]


def listed(form, qtbot):
    """Wait until the labels are listed."""
    qtbot.waitUntil(lambda: "voxels" in form.label.currentText(), timeout=PATIENCE)


def done(dock, qtbot):
    """Wait until the work of the dock *Flat map* is done, and return its message."""
    qtbot.waitUntil(lambda: dock._worker is None, timeout=PATIENCE)
    return dock.text.text()


@pytest.fixture
def movie(open_widget, qtbot):
    """Flatten all frames of the sample at its middle frame, and open the dock *Flat map*."""
    viewer, widget = open_widget(*layers_of_sample(), show=True)
    listed(widget.form, qtbot)
    viewer.dims.set_current_step(0, REFERENCE)
    run(widget, qtbot)
    dock = map_dock(viewer, qtbot)
    yield viewer, widget, dock
    wait_for_threads(qtbot)


def at_frame(viewer, dock, frame, qtbot):
    viewer.dims.set_current_step(0, frame)
    wait_for_picture(dock, qtbot)


def show_movie(dock, qtbot):
    """Show the movie of the chosen layer, and return the viewer of its window."""
    count = len(dock.movies.layers)
    dock.movie.click()
    done(dock, qtbot)
    assert len(dock.movies.layers) == count + 1
    return dock.movies.window.viewer


def test_the_sample_has_micrometres_and_the_axes_of_microscopes(make_napari_viewer, embryo):
    viewer = make_napari_viewer()
    viewer.open_sample("voxflat", "demo_embryo")
    for layer, volume in zip(viewer.layers, (embryo.images[1], embryo.labels[1]), strict=True):
        assert list(map(str, layer.units)) == ["pixel", *["micrometer"] * 3]
        assert_array_equal(layer.data[1], volume.data.T)
        assert_allclose(layer.data_to_world((1, 3, 2, 1))[:0:-1], volume.affine[:3] @ (1, 2, 3, 1))
        assert layer.data.nbytes < 1e6


def test_all_frames_get_the_map_of_python(movie, series, qtbot):
    viewer, widget, dock = movie
    found = ViewerState.of(viewer).current.layers.movie.series
    for name in ("points", "normals", "gaps"):
        assert_array_equal(getattr(found, name), getattr(series, name))
    assert_array_equal(found.flat_map.uv, series.flat_map.uv)
    assert found.reference == REFERENCE
    assert "frame 1" in widget.form.plan.text()
    assert "the other 2 frames" in widget.form.plan.text()
    assert widget.form.patch.isHidden()
    for frame in (2, 0, 1):
        at_frame(viewer, dock, frame, qtbot)
        assert_array_equal(dock.prepared.points, series.points[frame])


def test_lengths_are_shown_in_micrometres(movie, qtbot):
    viewer, widget, dock = movie
    flat_map = ViewerState.of(viewer).current.flat_map
    assert flat_map.metadata["unit"] == "µm"
    texts = [text for row in figures(flat_map) for text in row]
    assert sum("µm" in text for text in texts) > 2
    assert not any("mm" in text for text in texts)
    assert widget.form.sample_depth.suffix() == widget.form.pixel_size.suffix() == widget.form.radius.suffix() == " µm"
    assert dock.legend._unit == "µm"
    assert str(viewer.layers["embryo distortion"].units[0]) == "micrometer"
    dock.canvas.pointed.emit(*flat_map.uv[50])
    assert " µm · voxel" in dock.text.text()
    dock.outlined.click()
    wait_for_picture(dock, qtbot)
    (outline,) = [layer for layer in viewer.layers if layer.name.endswith("outline")]
    assert str(outline.units[-1]) == "micrometer"
    low, high = outline.extent.world[:, -3:]
    ends = viewer.layers["embryo"].extent.world[:, -3:]
    assert (low >= ends[0] - 1).all()
    assert (high <= ends[1] + 1).all()


def test_a_location_stays_with_the_material(movie, series, qtbot):
    viewer, _, dock = movie
    place = series.flat_map.uv[len(series.flat_map) // 3]
    dock.canvas.pointed.emit(*place)
    for frame in (2, 0):
        at_frame(viewer, dock, frame, qtbot)
        expected = series[frame].look_up(place).points
        assert_allclose(dock.link._marked, expected, atol=1e-9)
        assert_allclose(dock.link.to_world(expected)[-3:], expected[::-1])
        assert_allclose(dock.prepared.place(expected), place, atol=1e-6)
    assert np.linalg.norm(series[2].look_up(place).points - series[0].look_up(place).points) > 1
    assert "distance error" not in dock.text.text()  # which is known for the reference frame only
    at_frame(viewer, dock, REFERENCE, qtbot)
    assert "distance error" in dock.text.text()
    dock.canvas.left.emit()
    at_frame(viewer, dock, 0, qtbot)
    assert dock.link._marked is None


def test_the_surface_in_3d_moves_with_time(movie, series, qtbot):
    viewer, _, dock = movie
    dock.on_surface.click()
    for frame in (2, 0):
        at_frame(viewer, dock, frame, qtbot)
        layer = viewer.layers["embryo in map colours"]
        assert layer.visible
        assert_allclose(layer.vertices, series.points[frame][:, ::-1])


def test_growth_is_a_measure_of_movies(movie, series, qtbot):
    viewer, _, dock = movie
    dock.contents.setCurrentText(f"Growth since frame {REFERENCE}")
    for frame in (REFERENCE, 2):
        at_frame(viewer, dock, frame, qtbot)
        expected = np.log2(series.stretches(frame, REFERENCE).prod(axis=1))
        assert np.nanmedian(dock.picture.data) == pytest.approx(np.nanmedian(expected), abs=0.02)
    grown = (1.25 * 1.1) / (1.125 * 1.05)  # in length and in width, from the middle to the last frame
    assert 2 ** np.nanmedian(dock.picture.data) == pytest.approx(grown, rel=0.03)


def test_the_movie_is_one_layer_linked_in_time(movie, embryo, series, qtbot):
    viewer, _, dock = movie
    assert dock.contents.content is viewer.layers["nuclei"]
    dock.depths.setValue(-4)
    flat = show_movie(dock, qtbot)
    (layer,) = flat.layers
    expected = series.images(embryo.images, depth=-4.0, interpolation="linear").data
    assert_array_equal(layer.data, expected.reshape(layer.data.shape).astype(np.float32))
    assert flat.dims.current_step[0] == REFERENCE
    viewer.dims.set_current_step(0, 2)
    assert flat.dims.current_step[0] == 2
    flat.dims.set_current_step(0, 0)
    assert viewer.dims.current_step[0] == 0
    assert list(map(str, layer.units)) == ["pixel", "micrometer", "micrometer"]
    wait_for_picture(dock, qtbot)
    corner = layer.data_to_world((0, 40, 60))[1:]
    dock.movies._on_move(flat, type("Event", (), {"position": (0, *corner)}))
    assert_allclose(dock.link._marked, series[0].look_up((corner[1], -corner[0])).points)
    dock.contents.setCurrentText("embryo")
    show_movie(dock, qtbot)
    assert [type(one) for one in flat.layers] == [Image, Labels]


def test_labels_on_the_map_come_back_in_the_volume(movie, series, qtbot, monkeypatch, tmp_path):
    viewer, _, dock = movie
    assert dock.segmentations.isHidden()
    flat = show_movie(dock, qtbot)
    flat._new_labels()
    labels = flat.layers[-1]
    assert dock.segmentations.layer is labels
    dock.segmentations.send.click()
    assert "has no labels" in done(dock, qtbot)
    rows, columns = np.indices(labels.data.shape[1:])
    inside = np.hypot(rows - 75, columns - 80) < 12  # pixels of 1.67 µm
    labels.data[0, inside], labels.data[2, inside & (columns > 80)] = 7, 200
    dock.segmentations.send.click()
    assert "Added" in done(dock, qtbot)
    found = viewer.layers[f"{labels.name} in the volume"]
    assert found.data.shape == viewer.layers["embryo"].data.shape
    assert [np.unique(frame).tolist() for frame in found.data] == [[0, 7], [0], [0, 200]]
    for at in ((0, 0, 0, 0), (2, 5, 6, 7)):
        assert_allclose(found.data_to_world(at), viewer.layers["embryo"].data_to_world(at))
    for frame, label in ((0, 7), (2, 200)):
        seen = np.argwhere(found.data[frame] == label)
        world = np.array([found.data_to_world((frame, *voxel))[:0:-1] for voxel in seen])
        uv, _ = series[frame].points_to_map(world, 10)
        index = labels.world_to_data
        pixels = np.array([np.round(index((frame, -v, u))).astype(int) for u, v in uv])
        assert (labels.data[tuple(pixels.T)] == label).mean() > 0.9
    viewer.dims.set_current_step(0, 0)
    monkeypatch.setattr("qtpy.QtWidgets.QFileDialog.getSaveFileName", lambda *_: (str(tmp_path / "cells"), ""))
    dock.segmentations.save.click()
    assert "Saved 1 label of frame 0" in done(dock, qtbot)
    header, row = (tmp_path / "cells.tsv").read_text().splitlines()
    named = dict(zip(header.split("\t"), row.split("\t"), strict=True))
    assert named["label"] == "7"
    assert float(named["area_um2"]) == pytest.approx(inside.sum() * labels.scale[-1] ** 2, rel=0.15)
    flat.layers.remove(labels)
    assert dock.segmentations.isHidden()


def test_labels_on_other_pixels_are_refused(movie, qtbot):
    viewer, _, dock = movie
    flat = show_movie(dock, qtbot)
    image = flat.layers[0]
    wrong = (
        Labels(np.ones((20, 20), dtype=int), scale=image.scale[1:], translate=image.translate[1:]),
        Labels(np.ones(image.data.shape[1:], dtype=int), scale=image.scale[1:]),
        Labels(np.ones(image.data.shape[1:], dtype=int), scale=(1, 2)),
        Labels(np.ones((5, *image.data.shape[1:]), dtype=int), scale=image.scale, translate=image.translate),
    )
    before = len(viewer.layers)
    for labels in wrong:
        labels.units = image.units[-labels.ndim :]
        flat.add_layer(labels)
        dock.segmentations.box.setCurrentIndex(dock.segmentations.box.count() - 1)
        dock.segmentations.send.click()
        message = done(dock, qtbot)
        assert "scale, translation and shape" in message
        assert "\n" not in message
    assert len(viewer.layers) == before


def test_flat_labels_of_a_single_map_come_back(open_widget, qtbot, embryo, messages, monkeypatch, tmp_path):
    """Such as a segmentation that a plugin made of the flattened image."""
    nuclei, tissue = (Volume(one[0].data, one[0].affine, unit="µm") for one in (embryo.images, embryo.labels))
    place = {"affine": tissue.affine, "units": ["µm"] * 3}
    viewer, widget = open_widget(
        Image(nuclei.data, name="nuclei", **place), Labels(tissue.data, name="tissue", **place)
    )
    listed(widget.form, qtbot)
    assert widget.form.frames.isHidden()
    choose(widget.form.world, "RAS")
    run(widget, qtbot)
    dock = map_dock(viewer, qtbot)
    assert dock.movie.isHidden()
    flat = viewer.layers["tissue nuclei flattened"]
    rows, columns = np.indices(flat.data.shape)
    cells = np.where(np.isfinite(flat.data), 1 + rows // 30 + 10 * (columns // 30), 0)
    messages.clear()
    viewer.add_labels(cells, name="cells", scale=flat.scale, translate=flat.translate, units=flat.units)
    dock.segmentations.send.click()
    assert "Added" in done(dock, qtbot)
    found = viewer.layers["cells in the volume"]
    flat_map = flat.metadata["voxflat"]
    assert_array_equal(np.unique(found.data), np.unique(cells))
    back = flat_map.image(Volume(found.data, tissue.affine, unit="µm"), flat.scale[0], interpolation="nearest").data
    assert (back == cells)[cells > 0].mean() > 0.9
    assert not [one for one in messages if "cross at" in one.message]
    dock.contents.setCurrentText("nuclei")
    dock.depths.setValue(dock.depths.minimum())
    dock.segmentations.send.click()
    assert "Added" in done(dock, qtbot)
    assert [one for one in messages if "cross at" in one.message and "Use smaller depths" in one.message]

    viewer.layers.selection = {viewer.layers["cells"]}
    viewer.layers.save(str(tmp_path / "menu.tsv"), selected=True, plugin="voxflat")
    monkeypatch.setattr("qtpy.QtWidgets.QFileDialog.getSaveFileName", lambda *_: (str(tmp_path / "dock.tsv"), ""))
    dock.segmentations.save.click()
    assert "Saved" in done(dock, qtbot)
    assert (tmp_path / "menu.tsv").read_text() == (tmp_path / "dock.tsv").read_text()
    with pytest.raises(voxflat.VoxflatError, match=r"has no mesh vertices. Save a label volume \(for example, .nii.gz"):
        viewer.layers.save(str(tmp_path / "cells.label.gii"), selected=True, plugin="voxflat")
    viewer.layers.selection = {found}
    with pytest.raises(voxflat.VoxflatError, match="'cells in the volume' does not lie on a flat map"):
        viewer.layers.save(str(tmp_path / "found.tsv"), selected=True, plugin="voxflat")
    wait_for_threads(qtbot)


def test_the_displayed_frame_alone(open_widget, qtbot, embryo):
    viewer, widget = open_widget(*layers_of_sample())
    listed(widget.form, qtbot)
    viewer.dims.set_current_step(0, 2)
    choose(widget.form.frames, "one")
    assert "in frame 2." in widget.form.plan.text()
    assert "other" not in widget.form.plan.text()
    run(widget, qtbot)
    run_layers = ViewerState.of(viewer).current.layers
    assert run_layers.movie is None
    assert_array_equal(run_layers.flat_map.uv, voxflat.surface(zyx(embryo.labels[2])).flatten().uv)
    dock = map_dock(viewer, qtbot)
    assert dock.frame_hint.isHidden()
    viewer.dims.set_current_step(0, 1)
    assert not dock.frame_hint.isHidden()
    assert dock.frame_hint.text() == "This is the map of frame 2, not of the displayed frame 1."
    wait_for_picture(dock, qtbot)
    wait_for_threads(qtbot)


def test_layers_without_units_have_the_axes_of_microscopes_too(open_widget, qtbot, series):
    layers = layers_of_sample()
    for layer in layers:
        layer.units = ("pixel",) * 4
    viewer, widget = open_widget(*layers)
    listed(widget.form, qtbot)
    viewer.dims.set_current_step(0, REFERENCE)
    run(widget, qtbot)
    found = ViewerState.of(viewer).current.layers.movie.series
    assert_array_equal(found.points, series.points)
    dock = map_dock(viewer, qtbot)
    dock.depths.setValue(-2)
    flat = show_movie(dock, qtbot)
    flat._new_labels()
    flat.layers[-1].data[:, 60:90, 60:90] = 1
    dock.segmentations.send.click()
    assert "Added" in done(dock, qtbot)
    assert [str(unit) for unit in viewer.layers[-1].units] == ["pixel"] * 4
    assert_allclose(viewer.layers[-1].extent.world, viewer.layers["embryo"].extent.world)


@pytest.mark.parametrize("shape", ["one frame", "channels"])
def test_layers_of_one_frame_and_of_several_channels(open_widget, qtbot, embryo, shape):
    data = np.stack([labels.data.T for labels in embryo.labels])
    data = data[1:2] if shape == "one frame" else np.stack([np.zeros_like(data), data], axis=1)
    units = ("pixel",) * (data.ndim - 3) + ("µm",) * 3
    viewer, widget = open_widget(Labels(data, name="tissue", scale=(1,) * (data.ndim - 3) + (5, 2.5, 2.5), units=units))
    if shape == "channels":
        viewer.dims.set_current_step(1, 1)
    listed(widget.form, qtbot)
    assert widget.form.frames.isHidden() == (shape == "one frame")
    run(widget, qtbot)
    layers = ViewerState.of(viewer).current.layers
    assert (layers.movie is None) == (shape == "one frame")
    if layers.movie is not None:
        assert len(layers.movie.series) == FRAMES
        assert layers.movie.time.axis == -5
    wait_for_threads(qtbot)


def test_an_empty_frame_is_named(open_widget, qtbot, messages):
    nuclei, labels = layers_of_sample()
    labels.data[2] = 0
    viewer, widget = open_widget(nuclei, labels)
    listed(widget.form, qtbot)
    run(widget, qtbot)
    assert widget.status.text().startswith("frame 2: ")
    assert "\n" not in widget.status.text()
    assert ViewerState.of(viewer).current is None


@pytest.mark.parametrize("name", ["Check surface", "Draw cuts", "Flatten in patches"])
def test_other_docks_refuse_movies_in_one_line(open_widget, qtbot, messages, name):
    viewer, dock = open_widget(*layers_of_sample(), name=name)
    dock.form.surface.choose(viewer.layers["embryo"])
    listed(dock.form, qtbot)
    getattr(dock, "begin" if name == "Draw cuts" else "start").click()
    assert "has 4 dimensions, not 3. Split it" in messages[-1].message
    wait_for_threads(qtbot)


def test_wrong_orders_while_running(open_widget, qtbot, series):
    """The slider moves, and the layers are removed, while all frames are flattened."""
    viewer, widget = open_widget(*layers_of_sample(), show=True)
    listed(widget.form, qtbot)
    viewer.dims.set_current_step(0, REFERENCE)
    widget.start.click()
    qtbot.waitUntil(lambda: widget._worker is None or "follow" in widget._worker.stage[0], timeout=PATIENCE)
    viewer.dims.set_current_step(0, 2)
    viewer.layers.clear()
    run(widget, qtbot)  # waits, because it is running
    found = ViewerState.of(viewer).current.layers.movie.series
    assert_array_equal(found.points, series.points)
    dock = map_dock(viewer, qtbot)
    assert dock.prepared is not None
    dock.canvas.pointed.emit(*series.flat_map.uv[9])
    dock.movie.click()
    assert "Choose one under Shows" in done(dock, qtbot)
    wait_for_threads(qtbot)


def test_cancelling_takes_no_time(open_widget, qtbot):
    viewer, widget = open_widget(*layers_of_sample())
    listed(widget.form, qtbot)
    widget.start.click()
    qtbot.waitUntil(lambda: "follow" in widget._worker.stage[0], timeout=PATIENCE)
    widget.stop.click()
    assert widget.status.text() == "Cancelling…"
    qtbot.waitUntil(widget.start.isEnabled, timeout=3000)
    assert widget.status.text() == "Cancelled"
    assert ViewerState.of(viewer).current is None


def test_a_movie_can_be_cancelled_and_the_docks_closed(movie, qtbot):
    viewer, _, dock = movie
    dock.movie.click()
    assert not dock.movie.isEnabled()
    dock.stop.click()
    assert done(dock, qtbot) == "Cancelled"
    assert dock.movies.window.viewer is None
    show_movie(dock, qtbot)
    viewer.window.remove_dock_widget(dock)
    assert dock.movies.window.viewer is None
    viewer.dims.set_current_step(0, 2)


def test_saving_a_movie_tells_which_drawings_are_not_in_its_file(movie, qtbot, tmp_path, monkeypatch, messages):
    viewer, widget, dock = movie
    path = tmp_path / "movie.voxflat"
    monkeypatch.setattr("qtpy.QtWidgets.QFileDialog.getSaveFileName", lambda *_: (str(tmp_path / "movie"), ""))
    widget.results.save.click()
    assert [one.message for one in messages] == [f"Saved {path}"]
    flat = show_movie(dock, qtbot)
    flat.add_points([[0, 1, 2]], name="tracks")
    flat.layers.append(Labels(np.ones(flat.layers[0].data.shape, dtype=int), name="cells"))
    flat.add_points(name="empty", ndim=3)
    del flat
    remedy = "The file does not contain {}. Save these layers with File → Save Selected Layers…"
    for names in ("'tracks', 'cells'", "'cells', 'tracks'"):  # of the window, and as the window kept them
        messages.clear()
        widget.results.save.click()
        assert [one.message for one in messages] == [f"Saved {path}. {remedy.format(names)}"]
        dock.movies.close()
    viewer.layers.selection = {viewer.layers["embryo distortion"]}
    viewer.layers.save(str(tmp_path / "frame.surf.gii"), selected=True, plugin="voxflat")
    assert len(voxflat.io.read_mesh(tmp_path / "frame.surf.gii").points) > 0


def world_of_layers(viewer, title):
    """Return the world coordinates of points, paths and labelled voxels that were drawn on the map with a title."""
    found = {}
    for layer in [layer for layer in viewer.layers if "voxflat_made_from" in layer.metadata]:
        places = np.argwhere(layer.data) if isinstance(layer, Labels) else np.vstack(layer.data)
        found[layer.name.removeprefix(title)] = np.array([layer.data_to_world(place) for place in places])
    return found


@pytest.mark.parametrize("saved_by", ["form", "layer list"])
def test_drawings_on_a_movie_come_back_with_its_file(
    movie, series, make_napari_viewer, qtbot, monkeypatch, tmp_path, saved_by
):
    viewer, widget, dock = movie
    path, title = tmp_path / "grown.voxflat", ViewerState.of(viewer).current.title
    u, v = series.flat_map.uv.mean(axis=0)
    size = np.ptp(series.flat_map.uv) / 10
    places = {MARK: [(0, 0)], REGION: [(-1, -1), (1, -1), (0, 1)], MEASURE: [(-1, 0), (1, 0)]}
    for frame, (action, corners) in zip((2, 0, 1), places.items(), strict=True):
        at_frame(viewer, dock, frame, qtbot)
        dock.click.setCurrentText(action)
        for x, y in corners:
            dock.canvas.clicked.emit(u + x * size, v + y * size)
        if action == REGION:
            dock.canvas.double_clicked.emit()
        wait_for_picture(dock, qtbot)
    drawn, expected = dock.prepared.run.sketches.now, world_of_layers(viewer, title)
    assert {*expected} == {" points", " regions of frame 0", " shortest path"}
    assert len(expected[" regions of frame 0"]) > 9
    if saved_by == "form":
        monkeypatch.setattr("qtpy.QtWidgets.QFileDialog.getSaveFileName", lambda *_: (str(path), ""))
        widget.results.save.click()
    else:
        viewer.layers.selection = {viewer.layers[f"{title} distortion"]}
        viewer.layers.save(str(path), selected=True, plugin="voxflat")
    del widget, dock
    viewer.close()
    assert_array_equal(voxflat.load_series(path).points, series.points)

    viewer = make_napari_viewer()
    open_file(viewer, qtbot, path)
    dock = map_dock(viewer, qtbot)
    run = ViewerState.of(viewer).current
    assert run.sketches.now == drawn
    assert run.layers.movie.series.flat_map is run.flat_map
    found = world_of_layers(viewer, "grown")
    assert {*found} == {*expected}
    for name, coordinates in expected.items():
        assert_array_equal(found[name], coordinates)
    scope = {}
    exec(run.script.script(), scope)
    assert_array_equal(scope["series"].points, series.points)
    for layer in layers_of_sample():
        viewer.add_layer(layer)
    for frame in (2, 0, 1):
        at_frame(viewer, dock, frame, qtbot)
        assert_array_equal(dock.prepared.points, series.points[frame])
    dock.click.setCurrentText(MARK)
    dock.canvas.clicked.emit(u, v)
    wait_for_picture(dock, qtbot)
    assert run.sketches.now.marks[-1][0] == 1
    dock.undo.click()
    wait_for_picture(dock, qtbot)
    assert run.sketches.now == drawn
    assert_array_equal(world_of_layers(viewer, "grown")[" points"], expected[" points"])


def test_a_movie_from_python_gets_the_frames_of_its_layer(make_napari_viewer, qtbot, series, tmp_path):
    series.save(tmp_path / "movie.npz")
    viewer = make_napari_viewer()
    for layer in layers_of_sample():
        layer.scale, layer.translate = (5, *layer.scale[1:]), (20, *layer.translate[1:])
        viewer.add_layer(layer)
    open_file(viewer, qtbot, tmp_path / "movie.npz")
    dock = map_dock(viewer, qtbot)
    for frame in (2, 0, 1):
        at_frame(viewer, dock, frame, qtbot)
        assert_array_equal(dock.prepared.points, series.points[frame])
        dock.canvas.pointed.emit(*series.flat_map.uv[50])
        expected = series[frame].look_up(series.flat_map.uv[50]).points
        assert_allclose(dock.link.to_world(expected)[-3:], expected[::-1])


def test_the_script_repeats_the_movie(movie, series, tmp_path, monkeypatch):
    viewer, _, _ = movie
    script = ViewerState.of(viewer).current.script
    assert script.needs_folder()
    monkeypatch.chdir(tmp_path)
    found = {}
    exec(compile(script.script(tmp_path), "script", "exec"), found)
    assert_array_equal(found["series"].points, series.points)
    assert_array_equal(found["flat_map"].uv, series.flat_map.uv)


def test_surfaces_with_time_are_refused_in_one_line(open_widget, qtbot, messages):
    vertices = np.array([[t, *place] for t in (0, 1) for place in ((0, 0, 0), (0, 1, 0), (0, 0, 1))], dtype=float)
    viewer, widget = open_widget(Surface((vertices, np.array([[0, 1, 2], [3, 4, 5]])), name="moving"))
    widget.form.surface.choose(viewer.layers["moving"])
    widget.start.click()
    assert "has 4 dimensions instead of 3. Choose a 3D layer" in widget.status.text()
    assert widget.form.plan.text() == ""
