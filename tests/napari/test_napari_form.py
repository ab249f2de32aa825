"""The form of *Flatten surface*: its defaults, its choices, and its plan."""

import json
import subprocess
import sys
import threading
from functools import partial

import numpy as np
import pytest
import shapes
import tifffile
from napari.layers import Image, Labels, Layer, Surface
from napari_window import PATIENCE, bumps, cap, choose, open_file, run, sphere, wait_for_threads
from numpy.testing import assert_allclose, assert_array_equal
from scipy import ndimage

import voxflat
from voxflat._napari.layers import declared_size
from voxflat._napari.layers.world import MADE_FROM, WORLD
from voxflat._napari.viewer_state import ViewerState
from voxflat.demo import DEPTH


def newest_map(viewer):
    return ViewerState.of(viewer).current.flat_map


def test_parts_are_those_of_the_library(open_widget, qtbot):
    points, faces, values = bumps(25)
    above = points + [0, 0, 1] * np.where(np.arange(len(points)) % 2 == 0, 0.5, 0.6)[:, None]
    pial, white = Surface((above, faces), name="lh.pial"), Surface((points, faces, values), name="lh.white")
    viewer, widget = open_widget(pial, white)
    form = widget.form
    form.surface.choose(viewer.layers["lh.white"])
    assert form.pial.layer is viewer.layers["lh.pial"]
    run(widget, qtbot)  # one click
    midway = voxflat.surface((points, faces), pial=(viewer.layers["lh.pial"].vertices, faces))
    assert_array_equal(newest_map(viewer).uv, voxflat.flatten(midway).uv)

    form.pial.choose(None)
    form.pial.activated.emit(0)  # as a click does
    corners = np.array([5 * 25 + 5, 5 * 25 + 18, 18 * 25 + 18, 18 * 25 + 5])
    drawn = viewer.add_shapes([points[corners] + 0.2], shape_type="polygon", ndim=3, name="drawn")
    choose(form.patch, "polygon")
    assert form.polygon.layer is drawn
    run(widget, qtbot)
    expected = voxflat.surface((points, faces)).polygon(corners).flatten()
    assert_array_equal(newest_map(viewer).uv, expected.uv)
    assert 100 < len(expected) < 400
    form.polygon.choose(viewer.add_points(points[corners[:2]], name="two"))
    widget.start.click()
    assert "'two' has 2 corners" in widget.status.text()

    choose(form.patch, "whole")
    choose(form.method, "zigelman2002")
    form.options.sources.setValue(49)
    form.options.mirror.setChecked(True)
    form.options.seed.setValue(3)
    assert not form.options.weighting.isVisibleTo(form.options)  # it is the default method's
    run(widget, qtbot)
    same = voxflat.flatten((points, faces), method=voxflat.methods.Zigelman2002(sources=49), mirror=True, seed=3)
    assert_array_equal(newest_map(viewer).uv, same.uv)


def test_drawings_on_the_map_and_later_layers_do_not_change_the_part_to_flatten(open_widget, qtbot):
    points, faces, _ = bumps(25)
    viewer, widget = open_widget(Surface((points, faces), name="bumps"))
    form, corners = widget.form, points[[130, 143, 468, 455]]
    seed = viewer.add_points(points[[300]], name="seed")
    viewer.add_points(points[[10]], name="bumps points", metadata={MADE_FROM: "bumps"})  # as on the map
    choose(form.patch, "disk")
    form.radius.setValue(8)
    run(widget, qtbot)
    assert form.seed.point == 300
    viewer.add_points(points[[20]], name="later")
    assert form.seed.point == 300
    viewer.layers.remove(seed)
    assert form.seed.point == 20
    drawn = viewer.add_shapes([corners], shape_type="polygon", ndim=3, name="drawn")
    made = {"name": "bumps shortest path", "metadata": {MADE_FROM: "bumps"}}
    viewer.add_shapes([corners[:2]], shape_type="path", ndim=3, **made)
    choose(form.patch, "polygon")
    assert form.polygon.layer is drawn
    run(widget, qtbot)
    viewer.add_shapes([corners[1:]], shape_type="polygon", ndim=3, name="later shapes")
    assert form.polygon.layer is drawn


def test_stacks_without_a_unit_have_the_axes_of_a_microscope(open_widget, qtbot, tmp_path):
    """The library reads a TIFF file as z, y, x; other axes would mirror the map."""
    file = tmp_path / "stack.tif"
    ball = 3 * shapes.ball(6).astype(np.uint8)
    tifffile.imwrite(file, ball)
    viewer, widget = open_widget(Labels(cap(), name="cap", units="mm"))
    assert widget.form.world.currentData() == "RAS"
    viewer.open(str(file), plugin="napari", layer_type="image")
    viewer.add_labels(ball, name="painted")
    for name in ("painted", "stack"):
        widget.form.surface.choose(viewer.layers[name])
        assert widget.form.world.currentData() == "SAR"
    widget.form.surface.choose(viewer.layers["cap"])
    assert widget.form.sampled.layer is None  # the unit of the stack does not match
    widget.form.surface.choose(viewer.layers["stack"])
    assert widget.form.threshold.value() == 1.5  # napari shows bytes from 0 to 255
    run(widget, qtbot)
    expected = voxflat.surface(file, threshold=1.5, spacing=(1, 1, 1), unit="mm").flatten()
    shown = {tuple(voxel): uv for voxel, uv in zip(newest_map(viewer).ids[:, ::-1], newest_map(viewer).uv, strict=True)}
    uv = np.array([shown[tuple(voxel)] for voxel in expected.ids])
    areas = [
        np.linalg.det(places[expected.faces[:, 1:]] - places[expected.faces[:, :1]]) for places in (uv, expected.uv)
    ]
    assert np.median(areas[0]) * np.median(areas[1]) > 0  # not mirrored


def test_each_layer_has_its_own_world_axes(open_widget, qtbot):
    """Axes that were chosen for one layer would mirror the map of another one."""
    made = Labels(cap(), name="made", units="mm", metadata={MADE_FROM: "first", WORLD: "LPS"})
    viewer, widget = open_widget(*(Labels(cap(), name=name, units="mm") for name in ("first", "second")), made)
    _, check = viewer.window.add_plugin_dock_widget("voxflat", "Check surface")

    def shown(name):
        for form in (widget.form, check.form):
            form.surface.choose(viewer.layers[name])
        return [form.world.currentData() for form in (widget.form, check.form)]

    assert shown("first") == ["RAS", "RAS"]
    choose(widget.form.world, "SPL")
    assert check.form.world.currentData() == "SPL"  # of the same layer
    assert shown("second") == ["RAS", "RAS"]
    assert shown("made") == ["LPS", "LPS"]
    choose(check.form.world, "SAR")
    assert [*shown("first"), *shown("made")] == ["SPL", "SPL", "SAR", "SAR"]
    widget.form.surface.choose(viewer.layers["second"])
    qtbot.waitUntil(lambda: widget.form.label.label == 3, timeout=PATIENCE)
    run(widget, qtbot)
    assert newest_map(viewer).metadata["napari"]["world_axes"] == "RAS"


@pytest.mark.parametrize("unit", ["pixel", "micrometer"])
def test_the_plan_tells_that_a_layer_has_no_unit_of_length(open_widget, qtbot, unit):
    _, widget = open_widget(Labels(cap(), name="cap", units=unit))
    qtbot.waitUntil(lambda: "points" in widget.form.plan.text(), timeout=PATIENCE)
    assert ("assumed to be in mm" in widget.form.plan.text()) == (unit == "pixel")


def test_the_voxel_size_in_a_tiff_file_is_offered_and_used_for_all_layers_with_its_voxels(open_widget, qtbot, tmp_path):
    """napari's own reader leaves out the size, and the segmentation drawn on the stack has none either."""
    path, drawn = tmp_path / "stack & co.tif", cap()
    about = {"axes": "ZYX", "spacing": 1.0, "unit": "um"}
    tifffile.imwrite(path, drawn.astype(np.uint16), imagej=True, resolution=(2, 2), metadata=about)
    viewer, widget = open_widget(Labels(drawn, name="segmentation"))
    (stack,) = viewer.open(str(path), plugin="napari")
    widget.form.surface.choose(viewer.layers["segmentation"])
    told = "stack &amp; co.tif has voxels of 1 x 0.5 x 0.5 µm (z, y, x)"
    qtbot.waitUntil(lambda: told in widget.form.plan.text(), timeout=PATIENCE)
    viewer.dims.set_current_step(0, 12)
    widget.form.plan.linkActivated.emit("size")
    assert viewer.dims.current_step[0] == 12
    assert stack.thumbnail[..., :3].any()  # napari showed nothing after units changed
    for layer in (stack, viewer.layers["segmentation"]):
        assert_allclose(layer.scale, [1, 0.5, 0.5])
        assert set(map(str, layer.units)) == {"micrometer"}
    assert "µm" in widget.form.radius.suffix()
    assert told not in widget.form.plan.text()


def test_headers_of_tiff_files_are_not_read_in_the_thread_of_the_window(open_widget, qtbot, tmp_path, monkeypatch):
    """They take a second for 5,000 pages."""
    threads, read = [], declared_size.open_tiff

    def watched(path):
        threads.append(threading.current_thread())
        return read(path)

    monkeypatch.setattr(declared_size, "open_tiff", watched)
    about = {"axes": "ZYX", "spacing": 1.0, "unit": "um"}
    tifffile.imwrite(tmp_path / "stack.tif", cap().astype(np.uint16), imagej=True, resolution=(2, 2), metadata=about)
    viewer, widget = open_widget()
    viewer.open(str(tmp_path / "stack.tif"), plugin="napari")
    qtbot.waitUntil(lambda: "use this size" in widget.form.plan.text(), timeout=PATIENCE)
    assert len(threads) == 1
    assert threading.main_thread() not in threads


def test_a_layer_without_labels_is_refused_until_it_is_painted(open_widget, qtbot):
    ball = shapes.ball(5)
    viewer, widget = open_widget(Labels(np.zeros(ball.shape, np.uint8), name="drawn"))
    form = widget.form
    told = "Layer 'drawn' has no labels. Paint the part to flatten, or choose another layer."
    qtbot.waitUntil(lambda: form.plan.text() == told, timeout=PATIENCE)
    assert not widget.start.isEnabled()
    viewer.layers["drawn"].data = ball.astype(np.uint8)
    qtbot.waitUntil(lambda: "points" in form.plan.text(), timeout=PATIENCE)
    assert "has no labels" not in form.plan.text()
    assert widget.start.isEnabled()
    viewer.layers["drawn"].data = np.zeros(ball.shape, np.uint8)
    qtbot.waitUntil(lambda: form.plan.text() == told, timeout=PATIENCE)
    viewer.window.remove_dock_widget(widget)
    _, widget = viewer.window.add_plugin_dock_widget("voxflat", "Flatten surface")
    qtbot.waitUntil(lambda: not widget.start.isEnabled(), timeout=PATIENCE)
    viewer.add_image(ball.astype(np.float32), name="image")
    widget.form.surface.choose(viewer.layers["image"])
    assert widget.start.isEnabled()
    wait_for_threads(qtbot)


def test_mask_threshold_and_plan_of_a_volume(open_widget, qtbot):
    ball = shapes.ball(10)
    smooth = np.linalg.norm(np.indices(ball.shape) - np.array(ball.shape)[:, None, None, None] // 2, axis=0)
    probability = np.clip(1.3 - smooth / 20, 0, 1).astype(np.float32)  # 0.9 at 8 voxels from the middle
    half = np.zeros(ball.shape, np.uint8)
    half[ball.shape[0] // 2 :] = 1
    viewer, widget = open_widget(Labels(half, name="half"), Image(probability, name="white"))
    form = widget.form
    form.surface.choose(viewer.layers["white"])
    assert form.sampled.layer is viewer.layers["white"]  # there is no other image
    layers = len(viewer.layers)
    form.threshold.slider.sliderPressed.emit()
    preview = viewer.layers[viewer.layers.index("white") + 1]
    assert preview.data is viewer.layers["white"].data  # no copy
    form.threshold.slider.setValue(form.threshold.slider.maximum())
    form.threshold.setValue(0.9)
    inside = probability > np.float32(0.9)
    assert preview.contrast_limits[0] == pytest.approx(0.9)
    assert form.surface.findText(preview.name) < 0
    form.threshold.preview.click()
    assert len(viewer.layers) == layers

    edge = int(np.count_nonzero(inside & ~ndimage.binary_erosion(inside)))
    qtbot.waitUntil(lambda: "points" in form.plan.text(), timeout=PATIENCE)
    qtbot.waitUntil(lambda: f"{float(f'{edge:.2g}'):,.0f}\u00a0points" in form.plan.text(), timeout=PATIENCE)
    assert "automatic cuts" in form.plan.text()
    choose(form.options.fields["cuts"], "standard")
    assert "standard cuts" in form.plan.text()
    choose(form.options.fields["cuts"], None)

    choose(form.patch, "mask")
    assert form.masked_by.layer is viewer.layers["half"]
    run(widget, qtbot)
    expected = voxflat.surface(probability, threshold=0.9, affine=np.eye(4)).keep(half).flatten()
    assert_array_equal(newest_map(viewer).uv, expected.uv)


def test_the_surface_follows_the_selection_until_the_user_chooses(open_widget, qtbot):
    points, faces, _ = bumps(9)
    cube = np.zeros((9, 9, 9), np.uint8)
    cube[2:7, 2:7, 2:7] = 1
    viewer, widget = open_widget(Image(cube.astype(np.float32), name="T1"))
    chosen = widget.form.surface
    assert chosen.layer is viewer.layers["T1"]
    mesh = viewer.add_surface((points, faces), name="mesh")
    assert chosen.layer is mesh
    older, newer = (viewer.add_labels(cube, name=name) for name in ("older", "newer"))
    assert chosen.layer is newer
    viewer.add_image(cube.astype(np.float32), name="T2")  # napari selects it, nobody else
    assert chosen.layer is newer
    qtbot.wait(10)
    for layer in (older, mesh, viewer.layers["T1"]):
        viewer.layers.selection.active = layer
        assert chosen.layer is layer
    viewer.layers.selection.active = viewer.add_points([[4, 4, 4]], name="seed")
    assert chosen.layer is viewer.layers["T1"]
    chosen.setCurrentIndex(chosen.findText("T1"))
    chosen.activated.emit(chosen.currentIndex())  # as a click does
    viewer.layers.selection.active = older
    assert chosen.layer is viewer.layers["T1"]
    viewer.layers.remove("T1")
    assert chosen.layer in (older, newer)  # what was chosen is gone
    viewer.layers.clear()
    viewer.layers.extend(Surface((points, faces), name=name) for name in ("first", "second"))
    qtbot.wait(10)
    viewer.layers.selection.active = viewer.layers["first"]
    run(widget, qtbot)
    viewer.layers.selection.active = viewer.layers["second"]
    assert chosen.layer is viewer.layers["first"]  # as it was flattened


CLOSED_MEANWHILE = """
import sys
import threading
from functools import partial
import napari, numpy as np
from qtpy.QtCore import QTimer
i, j, k = np.indices((60, 60, 60)) - 29.5
viewer = napari.Viewer(show=True)
viewer.add_labels((np.sqrt(i**2 + j**2 + k**2) + 3 * np.sin(i / 5) * np.sin(j / 6) < 24).astype(np.uint8))
_, widget = viewer.window.add_plugin_dock_widget("voxflat", "Flatten surface")
QTimer.singleShot(0, widget.start.click)
QTimer.singleShot(int(sys.argv[1]), lambda: viewer.window._qt_window.close(confirm_need=False))
napari.run()
"""


@pytest.mark.parametrize("after", [5, 300, 301, 1000])  # ms; at 300 the plan begins to count
def test_a_window_closed_during_a_run_ends_the_program_quietly(after):
    done = subprocess.run([sys.executable, "-c", CLOSED_MEANWHILE, str(after)], capture_output=True, text=True)
    assert (done.returncode, "Traceback" in done.stderr) == (0, False), done.stderr


def test_defaults(open_widget):
    points, faces = sphere()
    head = np.zeros((70, 80, 60), np.uint8)
    head[10:60, 10:60, 10:50] = 1
    viewer, widget = open_widget(Labels(head, affine=np.diag([1.5, 1.5, 1.5, 1]), units="mm", name="head"))
    viewer.add_image(head.astype(np.float32), affine=np.diag([1.5, 1.5, 1.5, 1]), units="mm", name="T1")
    form = widget.form
    assert form.sampled.layer is viewer.layers["T1"]
    assert form.sample_depth.value() == DEPTH  # T1 is constant along the border of white matter
    viewer.layers.remove("head")
    viewer.add_labels(head, scale=(200, 200, 200), units="micrometer", name="embryo")
    form.surface.choose(viewer.layers["embryo"])
    assert form.sample_depth.value() == 0
    form.surface.choose(viewer.add_surface((points, faces), name="lh.white"))
    assert form.sample_depth.value() == DEPTH
    assert "Opens a closed surface along automatic cuts" in form.plan.text()
    assert f"{len(points):,}\u00a0points" in form.plan.text()
    form.sample_depth.setValue(1.25)
    form.sample_depth.editingFinished.emit()  # as the user does
    form.surface.choose(viewer.layers["embryo"])
    assert form.sample_depth.value() == 1.25


def boxes(form):
    """Return what the form shows, by the names of its fields."""
    options = form.options.options(form.method.currentData())
    part = form.patch.currentData(), form.radius.value(), form.seed.point
    return form.surface.layer.name, form.label.currentData(), part, form.world.currentData(), options


@pytest.mark.parametrize("first", ["map", "layer"])
def test_the_settings_come_back_with_the_saved_map(open_widget, make_napari_viewer, qtbot, tmp_path, first):
    labels = cap()
    labels[labels > 0] = 5
    labels[0, 0, 0] = 3
    viewer, widget = open_widget(Labels(labels, name="sheet"))
    form = widget.form
    qtbot.waitUntil(lambda: form.label.count() == 2, timeout=PATIENCE)
    form.label.choose(5)
    choose(form.world, "LPS")
    choose(form.patch, "disk")
    form.radius.setValue(7.5)
    seed = tuple(int(n) for n in np.argwhere(labels == 5)[200])
    form.seed.set_point(seed)
    options = form.options
    options.mirror.setChecked(True)
    options.sources.setValue(25)
    options.weighting.setValue(0.3)
    options.seed.setValue(4)
    choose(options.fields["relax"], False)
    choose(options.fields["scale"], "areas")
    choose(form.sampled, None)
    form.pixel_size.setValue(0.7)
    run(widget, qtbot)
    expected, uv = boxes(form), ViewerState.of(viewer).current.flat_map.uv
    path = tmp_path / "map.voxflat"
    viewer.layers.selection = {viewer.layers["sheet distortion"]}
    viewer.layers.save(str(path), selected=True, plugin="voxflat")

    # the settings of a dock that was closed
    viewer.window.remove_dock_widget(widget)
    _, widget = viewer.window.add_plugin_dock_widget("voxflat", "Flatten surface")
    qtbot.waitUntil(lambda: boxes(widget.form) == expected, timeout=PATIENCE)
    viewer.close()

    viewer = make_napari_viewer()
    _, widget = viewer.window.add_plugin_dock_widget("voxflat", "Flatten surface")
    form = widget.form
    form.radius.setValue(12.0)  # which an undo brings back
    viewer.add_labels(np.pad(labels, 1), name="another")
    open_layer = partial(viewer.add_labels, labels, name="sheet")
    for step in (open_layer, partial(open_file, viewer, qtbot, path))[:: 1 if first == "layer" else -1]:
        step()
    assert first == "layer" or "Restored" in widget.status.text() or "Open 'sheet'" in widget.status.text()
    qtbot.waitUntil(lambda: form.label.count() == 2 and boxes(form) == expected, timeout=PATIENCE)
    assert form.pixel_size.value() == 0.7
    assert form.sampled.layer is None
    assert widget.status.text() == "Restored the settings."
    widget.results.settings.click()
    assert (form.radius.value(), form.patch.currentData(), form.options.sources.value()) == (12.0, "whole", 0)
    widget.results.settings.click()
    qtbot.waitUntil(lambda: boxes(form) == expected, timeout=PATIENCE)
    run(widget, qtbot)
    assert_array_equal(ViewerState.of(viewer).current.flat_map.uv, uv)


def test_settings_that_do_not_exist_are_told(open_widget, make_napari_viewer, qtbot, tmp_path):
    labels = cap()
    viewer, widget = open_widget(Labels(labels, name="sheet"), Labels(labels, name="mask"))
    form = widget.form
    form.surface.choose(viewer.layers["sheet"])
    qtbot.waitUntil(lambda: form.label.label == 3, timeout=PATIENCE)
    choose(form.patch, "mask")
    form.masked_by.choose(viewer.layers["mask"])
    run(widget, qtbot)
    path = tmp_path / "map.voxflat"
    flat_map = ViewerState.of(viewer).current.flat_map
    record = flat_map.details["napari"]["form"]
    record |= {"method": "unheard of", "radius": "wide", "options": {**record["options"], "sources": -3}}
    flat_map.save(path)
    viewer.close()

    viewer = make_napari_viewer()
    _, widget = viewer.window.add_plugin_dock_widget("voxflat", "Flatten surface")
    open_file(viewer, qtbot, path)
    assert widget.status.text() == "Open 'sheet' to restore the settings."
    viewer.add_labels(np.pad(labels, 1), name="sheet")
    viewer.layers[-1].name = "wider"
    viewer.add_labels(np.where(labels, 8, 0), name="sheet")
    qtbot.waitUntil(lambda: "does not contain label 3" in widget.status.text(), timeout=PATIENCE)
    told = widget.status.text()
    for part in ("Label: 'sheet' does", "Mask: layer 'mask' is not open", "Method: 'unheard of'", "Radius: 'wide'"):
        assert part in told
    assert "sources -3 is not between 0 and 100000" in told
    assert widget.form.label.label == 8
    viewer.add_labels(labels, name="mask")
    assert widget.form.masked_by.layer is viewer.layers["mask"]
    assert "Mask" not in widget.status.text()


def restored(form, record, qtbot):
    """Restore settings as they are in a file, and return the settings of the form."""
    form.restore(json.loads(json.dumps(record)))
    qtbot.waitUntil(lambda: not form.label.isVisibleTo(form) or form.label._labels is not None, timeout=PATIENCE)
    return json.loads(json.dumps(form.record()))


def _with_threshold(viewer, form, qtbot):
    form.threshold.setValue(0.6)


def _with_frame(viewer, form, qtbot):
    qtbot.waitUntil(lambda: form.label.label == 3, timeout=PATIENCE)
    choose(form.frames, "one")
    viewer.dims.set_current_step(0, 1)


def _with_pial(viewer, form, qtbot):
    form.surface.choose(viewer.layers["lh.white"])
    form.pial.choose(viewer.layers["lh.middle"])


@pytest.mark.parametrize("chosen", [_with_threshold, _with_frame, _with_pial])
def test_threshold_frame_and_pial_surface_come_back_with_the_saved_map(
    open_widget, make_napari_viewer, qtbot, tmp_path, chosen
):
    (points, faces, _), names = bumps(15), ("lh.white", "lh.middle", "lh.pial")
    layers = {
        _with_threshold: [(ndimage.gaussian_filter(cap().astype(float), 1), {"name": "level"}, "image")],
        _with_frame: [(np.stack([cap(), cap()[::-1, :, ::-1]]), {"name": "frames"}, "labels")],
        _with_pial: [
            ((points + np.array([0, 0, (1 + 0.2 * z) * z]), faces), {"name": name}, "surface")
            for z, name in enumerate(names)
        ],
    }[chosen]
    viewer, widget = open_widget(*(Layer.create(*data) for data in layers))
    chosen(viewer, widget.form, qtbot)
    run(widget, qtbot)
    newest_map(viewer).save(tmp_path / "saved.voxflat")
    expected = json.loads(json.dumps(widget.form.record()))
    uv = newest_map(viewer).uv
    viewer.close()

    viewer = make_napari_viewer()
    _, widget = viewer.window.add_plugin_dock_widget("voxflat", "Flatten surface")
    open_file(viewer, qtbot, tmp_path / "saved.voxflat")
    assert json.loads(json.dumps(widget.form.record())) != expected
    for data in layers:
        viewer.add_layer(Layer.create(*data))
    qtbot.waitUntil(lambda: json.loads(json.dumps(widget.form.record())) == expected, timeout=PATIENCE)
    assert widget.status.text() == "Restored the settings."
    run(widget, qtbot)
    assert_array_equal(newest_map(viewer).uv, uv)


def test_the_pial_surface_is_restored_also_if_it_was_not_used(open_widget, qtbot):
    points, faces, _ = bumps()
    names = ("lh.white", "lh.middle", "lh.pial")
    viewer, widget = open_widget(
        *(Surface((points + np.array([0, 0, z]), faces), name=name) for z, name in enumerate(names))
    )
    form = widget.form
    form.surface.choose(viewer.layers["lh.white"])
    for name in ("lh.pial", None, "lh.middle"):
        form.pial.choose(None if name is None else viewer.layers[name])
        record = form.record()
        form.pial.choose(viewer.layers["lh.pial" if name != "lh.pial" else "lh.middle"])
        assert restored(form, record, qtbot) == json.loads(json.dumps(record))
        assert (form.pial.layer and form.pial.layer.name) == name


def test_continue_is_restored_if_its_map_is_displayed(open_widget, make_napari_viewer, qtbot, tmp_path):
    mesh = bumps(15)[:2]
    viewer, widget = open_widget(Surface(mesh, name="bumps"))
    run(widget, qtbot)
    newest_map(viewer).save(tmp_path / "first.voxflat")
    widget.form.continues.setChecked(True)
    record = widget.form.record()
    run(widget, qtbot)
    newest_map(viewer).save(tmp_path / "second.voxflat")
    viewer.close()

    viewer = make_napari_viewer()
    viewer.add_surface(mesh, name="bumps")
    _, widget = viewer.window.add_plugin_dock_widget("voxflat", "Flatten surface")
    open_file(viewer, qtbot, tmp_path / "second.voxflat")
    qtbot.waitUntil(lambda: bool(widget.status.text()), timeout=PATIENCE)
    assert not widget.form.continues.isChecked()
    assert "Continue: the map from which it started is not displayed" in widget.status.text()
    open_file(viewer, qtbot, tmp_path / "first.voxflat")
    restored(widget.form, record, qtbot)
    assert widget.form.continues.isChecked()
    assert widget.status.text() == "Restored the settings."


@pytest.mark.parametrize("name", ["Draw cuts", "Cortical depth", "Check surface", "Flatten in patches"])
def test_every_dock_restores_its_settings_and_tells_so(open_widget, qtbot, name):
    labels = np.where(cap() > 0, 5, 0)
    labels[0, 0, 0] = 3
    viewer, dock = open_widget(Labels(labels, name="sheet"), Labels(np.pad(labels, 1), name="other"), name=name)
    form = dock.form
    form.surface.choose(viewer.layers["sheet"])
    qtbot.waitUntil(lambda: form.label.count() == 2, timeout=PATIENCE)
    form.label.choose(3)
    choose(form.world, "LPS")
    for field, value in (("count", 7), ("area", 2.5), ("bound", 1.5), ("glue", 2.0)):
        if hasattr(form, field):
            getattr(form, field).setValue(value)
    expected = form.record()
    viewer.window.remove_dock_widget(dock)
    _, dock = viewer.window.add_plugin_dock_widget("voxflat", name)
    qtbot.waitUntil(lambda: dock.form.record() == expected, timeout=PATIENCE)
    told = dock.table.toPlainText if name == "Check surface" else dock.status.text
    qtbot.waitUntil(lambda: told() == "Restored the settings.", timeout=PATIENCE)


def test_a_form_that_was_closed_without_layers_suits_the_next_ones(open_widget, qtbot):
    viewer, widget = open_widget(Labels(cap(), name="sheet"), Image(cap().astype(float), name="T1"))
    choose(widget.form.method, "schwartz1989")
    viewer.layers.clear()
    viewer.window.remove_dock_widget(widget)
    viewer.add_image(cap().astype(float) + 1, name="other")
    viewer.add_labels(cap(), name="cells")
    _, widget = viewer.window.add_plugin_dock_widget("voxflat", "Flatten surface")
    qtbot.waitUntil(lambda: widget.status.text() == "Restored the settings.", timeout=PATIENCE)
    assert widget.form.method.currentData() == "schwartz1989"
    assert widget.form.surface.layer is viewer.layers["cells"]
    assert widget.form.sampled.layer is viewer.layers["other"]


def test_closing_the_form_tells_that_its_run_was_cancelled(open_widget, qtbot, messages):
    viewer, widget = open_widget(Labels(cap(), name="sheet"))
    qtbot.waitUntil(lambda: widget.form.label.label == 3, timeout=PATIENCE)
    widget.start.click()
    assert not widget.start.isEnabled()
    viewer.window.remove_dock_widget(widget)
    told = "Flatten surface: cancelled, because its dock was closed. Open the dock and start it again"
    assert [one.message for one in messages] == [told]
    wait_for_threads(qtbot)
    assert ViewerState.of(viewer).current is None
