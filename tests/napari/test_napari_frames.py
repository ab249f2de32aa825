"""Movies in napari's window: what belongs to which frame, and work that must not be lost."""

import numpy as np
import pytest
import tifffile
from napari.layers import Image, Labels, Points, Shapes
from napari_window import PATIENCE, map_dock, wait_for_picture, wait_for_threads
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial import cKDTree

from voxflat import samples
from voxflat._napari.job import Frames, Job
from voxflat._napari.layers.volumes import LayerVolume, frames_of, time_axis
from voxflat._napari.results.flat_layers import Run
from voxflat._napari.viewer_state import ViewerState

FRAMES = 3


@pytest.fixture(scope="module")
def data():
    """The nuclei and the labels of the sample, with the axes t, z, y, x."""
    embryo = samples.embryo(FRAMES)
    return [np.stack([volume.data.T for volume in volumes]) for volumes in (embryo.images, embryo.labels)]


PLACE = {"scale": (1, 5, 2.5, 2.5), "translate": (0, -47.5, -60, -125), "units": ("pixel", "µm", "µm", "µm")}


def layer_of(kind, data, name, *, channels=False, **place):
    """Return a layer, whose channels, if any, lie between time and space."""
    about, between = {**PLACE, **place}, {"scale": 1, "translate": 0, "units": "pixel"}
    if channels:
        about = {key: (value[0], between[key], *value[1:]) for key, value in about.items()}
    return kind(data, name=name, **about)


@pytest.fixture(scope="module")
def flattened_layers(data):
    """A function that returns the map of labels, which is computed once for each place of the layer."""
    known = {}

    def found(labels):
        key = labels.ndim, labels.scale.tobytes(), tuple(map(str, labels.units))
        if key not in known:
            volume = LayerVolume.of(labels, "SAR", (1, *[0] * (labels.ndim - 4)))
            frames = Frames(frames_of(volume), 1, time_axis(labels))
            known[key] = Job(surface=volume, label=1, frames=frames).run(lambda *_: True)
        return known[key]

    return found


@pytest.fixture
def opened(make_napari_viewer, qtbot, flattened_layers):
    """A function that opens layers and the dock *Flat map* with the map of the Labels layer 'embryo'."""

    def dock_of(*layers, show=False):
        viewer = make_napari_viewer(show=show)
        for layer in layers:
            viewer.add_layer(layer)
        ViewerState.of(viewer).add(Run(flattened_layers(viewer.layers["embryo"]), "embryo"))
        qtbot.waitUntil(lambda: ViewerState.of(viewer).is_settled, timeout=PATIENCE)
        return viewer, map_dock(viewer, qtbot)

    yield dock_of
    wait_for_threads(qtbot)


@pytest.fixture
def movie(opened, data):
    """The sample, with its map of all frames."""
    viewer, dock = opened(layer_of(Image, data[0], "nuclei"), layer_of(Labels, data[1], "embryo"))
    return viewer, dock, ViewerState.of(viewer).current.layers.movie.series


def at_frame(viewer, dock, frame, qtbot, axis=0):
    viewer.dims.set_current_step(axis, frame)
    wait_for_picture(dock, qtbot)


def done(dock, qtbot):
    qtbot.waitUntil(lambda: dock._worker is None, timeout=PATIENCE)
    return dock.text.text()


def show_movie(dock, qtbot, name="nuclei"):
    dock.contents.setCurrentText(name)
    wait_for_picture(dock, qtbot)
    dock.movie.click()
    return done(dock, qtbot), dock.movies.window.viewer


def painted(flat, *disks, name="cells"):
    """Paint disks (label, frame, row, column, radius) in a new Labels layer over the movie."""
    image = flat.layers[0]
    rows, columns = np.indices(image.data.shape[1:])
    values = np.zeros(image.data.shape, dtype=int)
    for label, frame, row, column, radius in disks:
        values[frame, np.hypot(rows - row, columns - column) < radius] = label
    return flat.add_labels(values, name=name, scale=image.scale, translate=image.translate, units=image.units)


def sent(viewer, dock, layer, qtbot):
    """Send labels to the volume, and return the message."""
    dock.segmentations.box.setCurrentIndex(dock.segmentations._layers.index(layer))
    dock.segmentations.send.click()
    return done(dock, qtbot)


def distances(series, frame, places):
    """Return the distances of positions (z, y, x) from the edges of the surface of a frame, which paths cross."""
    corners = series.points[frame][series.flat_map.faces]
    share = np.linspace(0, 1, 9)[:, None, None, None]
    edges = share * corners + (1 - share) * np.roll(corners, 1, axis=1)
    return cKDTree(edges.reshape(-1, 3)[:, ::-1]).query(places)[0]


@pytest.mark.parametrize("frame", [0, 2])
def test_drawings_lie_on_the_displayed_frame(movie, qtbot, frame):
    viewer, dock, series = movie
    at_frame(viewer, dock, frame, qtbot)
    uv = series.flat_map.uv
    middle = np.linalg.norm(uv - uv.mean(axis=0), axis=1).argmin()
    other = np.abs(np.linalg.norm(uv - uv[middle], axis=1) - 60).argmin()
    dock.click.setCurrentText("measures a distance")
    for point in (middle, other):
        dock.canvas.clicked.emit(*uv[point])
    wait_for_picture(dock, qtbot)
    path = next(layer for layer in viewer.layers if isinstance(layer, Shapes))
    places = path.data[0]
    assert_array_equal(places[:, 0], frame)
    assert distances(series, frame, places[:, 1:]).max() < 0.7
    assert distances(series, 1, places[:, 1:]).max() > 2
    length = np.linalg.norm(np.diff(places[:, 1:], axis=0), axis=1).sum()
    assert dock.text.text().startswith(f"{length:.1f} µm along")
    assert f"frame {frame}" in dock.text.text()
    dock.click.setCurrentText("draws a region")
    for corner in ((-12, -12), (12, -12), (12, 12), (-12, 12)):
        dock.canvas.clicked.emit(*(uv[middle] + corner))
    dock.canvas.double_clicked.emit()
    wait_for_picture(dock, qtbot)
    region = viewer.layers[f"embryo regions of frame {frame}"]
    inside = np.array([region.data_to_world(voxel) for voxel in np.argwhere(region.data)])
    assert_array_equal(inside[:, 0], frame)
    assert_allclose(inside[:, 1:].mean(axis=0), series.points[frame][middle][::-1], atol=5)
    dock.click.setCurrentText("marks a point")
    dock.canvas.clicked.emit(*uv[middle])
    wait_for_picture(dock, qtbot)
    (points,) = [layer for layer in viewer.layers if isinstance(layer, Points)]
    assert_allclose(points.data, [[frame, *series.points[frame][middle][::-1]]], atol=1e-4)
    at_frame(viewer, dock, 1, qtbot)
    dock.canvas.clicked.emit(*uv[middle])
    wait_for_picture(dock, qtbot)
    assert_array_equal(points.data[:, 0], [frame, 1])


def test_the_voxel_is_that_of_the_displayed_frame(movie, qtbot):
    viewer, dock, series = movie
    for frame in range(FRAMES):
        at_frame(viewer, dock, frame, qtbot)
        for row in range(0, len(series.flat_map), 97):
            dock.canvas.pointed.emit(*series.flat_map.uv[row])
            voxel = [int(n) for n in dock.text.text().split("voxel ")[1].split(" ·")[0].split(", ")]
            exact = viewer.layers["embryo"].world_to_data([frame, *dock.link._marked[::-1]])[1:]
            assert np.abs(voxel - exact).max() < (1.5 if frame == 1 else 0.51)


def test_times_in_other_units(opened, data, qtbot):
    """The labels have a frame per minute, and the image has one in 60 seconds."""
    image = layer_of(Image, data[0], "nuclei", scale=(60, 5, 2.5, 2.5), units=("s", "µm", "µm", "µm"))
    labels = layer_of(Labels, data[1], "embryo", units=("minute", "µm", "µm", "µm"))
    viewer, dock = opened(image, labels)
    series = ViewerState.of(viewer).current.layers.movie.series
    for frame in (2, 0, 1):
        viewer.dims.set_point(0, 60 * frame)
        wait_for_picture(dock, qtbot)
        assert dock._frame == frame
        assert_array_equal(dock.prepared.points, series.points[frame])
    _, flat = show_movie(dock, qtbot)
    volumes = [LayerVolume.of(image, "SAR", (frame,)).read() for frame in range(FRAMES)]
    expected = np.nanmean(series.images(volumes, interpolation="linear").data.reshape(FRAMES, -1), axis=1)
    assert_allclose(np.nanmean(flat.layers[0].data, axis=(1, 2)), expected, rtol=1e-4)
    assert str(flat.layers[0].units[0]) == "minute"
    flat.dims.set_current_step(0, 2)
    assert viewer.dims.point[0] == 120
    cells = painted(flat, (4, 2, 75, 80, 12))
    assert "Added" in sent(viewer, dock, cells, qtbot)
    found = viewer.layers["cells in the volume"]
    assert found.data_to_world((2, 1, 1, 1)) == pytest.approx(labels.data_to_world((2, 1, 1, 1)))
    assert str(found.units[0]) == "minute"
    wait_for_picture(dock, qtbot)


def test_an_image_with_fewer_frames_is_not_repeated(opened, data, qtbot):
    viewer, dock = opened(layer_of(Image, data[0][:2], "short"), layer_of(Labels, data[1], "embryo"))
    message, flat = show_movie(dock, qtbot, "short")
    assert "no frame 2" in message
    assert np.isfinite(flat.layers[0].data[:2]).any(axis=(1, 2)).all()
    assert np.isnan(flat.layers[0].data[2]).all()
    at_frame(viewer, dock, 2, qtbot)
    assert "'short' has no values" in dock.text.text()
    assert dock.picture is None
    assert dock.prepared.frame == 2
    at_frame(viewer, dock, 1, qtbot)
    assert dock.picture is not None


def test_channels_of_one_layer_only(opened, data, qtbot):
    """The viewer aligns the last axes, so that the time of the labels lies on the channels of the image."""
    stack = np.stack([data[0], data[0][::-1]], axis=1)
    viewer, dock = opened(layer_of(Image, stack, "stack", channels=True), layer_of(Labels, data[1], "embryo"))
    message, flat = show_movie(dock, qtbot, "stack")
    assert "Split the channels" in message
    assert flat is None
    assert dock.picture is None
    wait_for_picture(dock, qtbot)
    viewer.layers.remove("stack")
    viewer.add_layer(layer_of(Image, stack.swapaxes(0, 1), "first", channels=True))
    message, flat = show_movie(dock, qtbot, "first")  # channels come first, so that the times are aligned
    assert "in all frames" in message
    assert np.ptp(np.nanmean(flat.layers[0].data, axis=(1, 2))) > 0


def test_labels_in_the_volume_span_the_channels(opened, data, qtbot):
    stack, labels = (np.stack([one, one], axis=1) for one in data)
    viewer, dock = opened(
        layer_of(Image, stack, "stack", channels=True), layer_of(Labels, labels, "embryo", channels=True)
    )
    _, flat = show_movie(dock, qtbot, "stack")
    cells = painted(flat, (6, 0, 75, 80, 12), (6, 2, 75, 80, 12))
    assert "Added" in sent(viewer, dock, cells, qtbot)
    found = viewer.layers["cells in the volume"]
    assert found.data.shape == (FRAMES, 1, *data[1].shape[1:])
    voxel = np.argwhere(found.data[2, 0])[0]
    for channel in (0, 1):
        viewer.dims.set_point(range(5), found.data_to_world((2, channel, *voxel)))
        viewer.dims.set_current_step(1, channel)
        assert 6 in found._slice.image.raw
    viewer.dims.set_current_step(0, 1)
    assert 6 not in found._slice.image.raw
    wait_for_picture(dock, qtbot)


def test_labels_without_voxels_are_named(movie, qtbot):
    viewer, dock, _ = movie
    _, flat = show_movie(dock, qtbot)
    inside = np.isfinite(flat.layers[0].data).all(axis=0)
    outside = np.argwhere(~inside)[0]
    assert outside.max() < 60
    cells = painted(flat, (5, 0, 75, 80, 12), (9, 1, *outside, 0.5))
    message = sent(viewer, dock, cells, qtbot)
    assert message.startswith("Added 'cells in the volume' from -3.15 to 3.15 µm. Left out")
    assert message.endswith("label 9 in frame 1")
    found = viewer.layers["cells in the volume"]
    assert [np.unique(frame).tolist() for frame in found.data] == [[0, 5], [0], [0]]
    tiny = painted(flat, (7, 1, *outside, 0.5), name="tiny")
    assert "No label of 'tiny' contains" in sent(viewer, dock, tiny, qtbot)


def test_edited_labels_in_the_volume_are_kept(movie, qtbot):
    viewer, dock, _ = movie
    _, flat = show_movie(dock, qtbot)
    cells = painted(flat, (5, 0, 75, 80, 12))
    sent(viewer, dock, cells, qtbot)
    first = viewer.layers["cells in the volume"]
    cells.data[0][cells.data[0] == 5] = 6
    assert "Added 'cells in the volume'" in sent(viewer, dock, cells, qtbot)
    assert np.unique(first.data).tolist() == [0, 6]  # nobody had edited the layer
    first.data[0, 0, 0, 0] = 77
    assert "Added 'cells in the volume [1]'" in sent(viewer, dock, cells, qtbot)
    assert first.data[0, 0, 0, 0] == 77
    other = painted(flat, (8, 1, 75, 80, 12), name="cells")
    other.name = "cells"
    flat.layers.remove(cells)
    other.name = "cells"
    sent(viewer, dock, other, qtbot)
    assert len([layer for layer in viewer.layers if layer.name.startswith("cells in the volume")]) == 3


def test_labels_go_to_the_grid_of_the_current_map(movie, qtbot, data, flattened_layers):
    viewer, dock, _ = movie
    _, flat = show_movie(dock, qtbot)
    sent(viewer, dock, painted(flat, (5, 0, 75, 80, 12)), qtbot)
    first = viewer.layers["cells in the volume"]
    before = first.extent.world.copy()
    large = layer_of(Labels, data[1], "large", scale=(1, 10, 5, 5))
    viewer.add_layer(large)
    ViewerState.of(viewer).add(Run(flattened_layers(large), "large"))
    qtbot.waitUntil(lambda: ViewerState.of(viewer).is_settled, timeout=PATIENCE)
    wait_for_picture(dock, qtbot)
    _, flat = show_movie(dock, qtbot)
    message = sent(viewer, dock, painted(flat, (5, 0, 75, 80, 12)), qtbot)
    assert "Added 'cells in the volume [1]'" in message
    assert_array_equal(first.extent.world, before)
    assert_allclose(viewer.layers["cells in the volume [1]"].extent.world, large.extent.world)


@pytest.mark.parametrize("how", ["another map", "closed"])
def test_painted_labels_are_kept(movie, qtbot, messages, flattened_layers, how):
    viewer, dock, _ = movie
    _, flat = show_movie(dock, qtbot)
    show_movie(dock, qtbot, "embryo")
    cells = painted(flat, (5, 0, 75, 80, 12), (6, 2, 40, 60, 9))
    values, place = cells.data.copy(), cells.data_to_world((2, 30, 40))
    run, slices = ViewerState.of(viewer).current, viewer.dims.nsteps[:2]
    if how == "closed":
        viewer.window.remove_dock_widget(dock)
    else:
        ViewerState.of(viewer).keeps_earlier = True
        ViewerState.of(viewer).add(Run(run.layers, "another"))
        qtbot.waitUntil(lambda: ViewerState.of(viewer).is_settled, timeout=PATIENCE)
        wait_for_picture(dock, qtbot)
    assert "'cells'" in messages[-1].message
    kept = viewer.layers["cells"]
    assert not kept.visible
    assert viewer.dims.nsteps[:2] == slices
    assert_array_equal(kept.data, values[:, None])
    assert_allclose(np.delete(kept.data_to_world((2, 0, 30, 40)), 1), place)
    assert [layer for layer in viewer.layers if isinstance(layer, Labels)] == [viewer.layers["embryo"], kept]
    assert viewer.layers.units is not None
    if how == "closed":
        dock = map_dock(viewer, qtbot)
    assert "Added" in sent(viewer, dock, kept, qtbot)
    found = viewer.layers["cells in the volume"]
    assert [np.unique(frame).tolist() for frame in found.data] == [[0, 5], [0], [0, 6]]
    _, flat = show_movie(dock, qtbot)
    assert "cells" not in viewer.layers
    assert_array_equal(flat.layers["cells"].data, values)
    assert_allclose(flat.layers["cells"].data_to_world((2, 30, 40)), place)
    flat.layers["cells"].data[:] = 0  # nothing to keep


def test_an_edited_movie_is_not_replaced(movie, qtbot):
    _, dock, _ = movie
    _, flat = show_movie(dock, qtbot, "embryo")
    show_movie(dock, qtbot, "embryo")
    assert len(flat.layers) == 1
    flat.layers[0].data[0, :9] = 7
    show_movie(dock, qtbot, "embryo")
    assert [(layer.data[0] == 7).any() for layer in flat.layers] == [True, False]
    flat.layers[0].data[:] = 0


@pytest.mark.parametrize("name", ["nuclei", "embryo"])
def test_movies_can_be_saved(movie, qtbot, name, tmp_path):
    _, dock, _ = movie
    _, flat = show_movie(dock, qtbot, name)
    (layer,) = flat.layers
    layer.data[1, 3, 4] = 9  # by hand
    assert layer.save(str(tmp_path / "flat.tif"), plugin="voxflat")
    found = tifffile.imread(tmp_path / "flat.tif")
    assert_array_equal(np.nan_to_num(found).reshape(layer.data.shape), np.nan_to_num(layer.data))
    with tifffile.TiffFile(tmp_path / "flat.tif") as file:
        assert file.series[0].axes.startswith("T")
    layer.data[:] = 0


def test_cancel_is_part_of_the_dock(opened, data, qtbot):
    _, dock = opened(layer_of(Image, data[0], "nuclei"), layer_of(Labels, data[1], "embryo"), show=True)
    dock.contents.setCurrentText("nuclei")
    dock.movie.click()
    assert dock.stop.isVisibleTo(dock)
    assert dock.stop.window() is dock.window()
    assert not dock.stop.isWindow()
    dock.stop.click()
    assert done(dock, qtbot) == "Cancelled"


def test_frames_that_do_not_fit_are_in_the_panel(open_widget, data, flattened_layers, monkeypatch):
    labels = layer_of(Labels, data[1], "embryo")
    _, widget = open_widget(labels)
    layers = flattened_layers(labels)
    widget.results.show_run(Run(layers, "embryo"))
    assert "frame 2" not in widget.results.warnings.text()
    warning = "the moved surface does not fit frame 2. Check the surfaces there"
    monkeypatch.setattr(type(layers.movie.series), "warnings", (warning,))
    widget.results.show_run(Run(layers, "embryo"))
    assert "The moved surface does not fit frame 2" in widget.results.warnings.text()
    assert not widget.results.warnings.isHidden()


@pytest.mark.parametrize("channels", [0, 2])
def test_images_of_movies_are_chosen_if_nothing_else_is_open(open_widget, qtbot, data, channels):
    nuclei = np.stack([data[0]] * channels, axis=1) if channels else data[0]
    image = layer_of(Image, nuclei, "nuclei", channels=bool(channels))
    viewer, widget = open_widget(image)
    assert widget.form.surface.layer is image
    labels = viewer.add_layer(layer_of(Labels, data[1], "embryo"))
    assert widget.form.surface.layer is labels
    qtbot.wait(50)  # the selection of new layers is ignored
    viewer.layers.selection.active = image
    assert widget.form.surface.layer is image
    for threshold in (1e9, -1e9):
        widget.form.threshold.setValue(threshold)
        assert widget.form.threshold.value() == threshold
    assert widget.form.threshold.slider.value() == 0
