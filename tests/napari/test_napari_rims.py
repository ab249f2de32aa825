"""Rims in napari's window: the middle surface, layers, flat volumes and profiles."""

import nibabel as nib
import numpy as np
import pytest
from napari import current_viewer
from napari.layers import Image, Labels, Surface
from napari_window import PATIENCE, bumps, choose, map_dock, run, wait_for_threads
from numpy.testing import assert_allclose, assert_array_equal
from qtpy.QtWidgets import QWidget

import voxflat
from voxflat._napari.map_viewer.dock import REGION
from voxflat._napari.map_viewer.flat_window import FlatWindow
from voxflat._napari.samples import demo_rim
from voxflat._napari.viewer_state import ViewerState
from voxflat.io import Volume

COUNT = 5


@pytest.fixture(scope="module")
def sample():
    """The rim and the volume of the sample data, as in Python."""
    (activity, _, _), (labels, about, _) = demo_rim()
    return voxflat.rim(Volume(labels, about["affine"])), Volume(activity, about["affine"])


def layers_of_sample():
    kinds = {"image": Image, "labels": Labels}
    return [kinds[kind](data, **about) for data, about, kind in demo_rim()]


def rim_of(form, qtbot):
    """Wait until the labels are listed, and return the chosen rim."""
    qtbot.waitUntil(lambda: "voxels" in form.label.itemText(form.label.count() - 1), timeout=PATIENCE)
    return form.label.rim


def scale_bar_of(viewer):
    """Return the text of the scale bar that the window shows."""
    canvas = viewer.window._qt_viewer.canvas._scene_canvas
    nodes = [canvas.central_widget]
    for node in nodes:
        nodes += node.children
    (bar,) = (node for node in nodes if type(node).__name__ == "ScaleBar" and node.visible)
    return bar.text.text


def press(dock, button, qtbot):
    """Press a button, and wait until its work is done."""
    button.click()
    qtbot.waitUntil(lambda: not dock.stop.isEnabled(), timeout=PATIENCE)
    return dock.status.text()


def test_a_rim_is_offered_as_a_label(open_widget, qtbot):
    data = voxflat.samples.rim().data
    viewer, widget = open_widget(Labels(data, name="trim"))
    form = widget.form
    assert rim_of(form, qtbot) is None  # the name says nothing
    assert [form.label.itemData(row) for row in range(form.label.count())] == ["rim", 1, 2, 3]
    assert form.label.label == 1
    for name, other, kind in (("sub-1_rim", data, "rim"), ("ribbon", np.choose(data, [0, 41, 2, 3]), None)):
        form.surface.choose(viewer.add_labels(other, name=name))
        assert rim_of(form, qtbot) == kind
    ribbon = np.choose(data, [0, 41, 2, 3])
    ribbon[0, 0] = 42
    form.surface.choose(viewer.add_labels(ribbon, name="lh+rh.ribbon"))
    assert rim_of(form, qtbot) == "left"
    assert "halfway between the borders" in form.plan.text()
    viewer.layers["lh+rh.ribbon"].selected_label = 3
    assert form.label.rim == "left"  # painting does not change what is flattened
    form.label.choose(3)
    assert (form.label.rim, form.label.label) == (None, 3)
    assert "Repairs topology" in form.plan.text()


def test_layers_flat_volume_and_profile(open_widget, qtbot, sample, monkeypatch, tmp_path):
    rim, activity = sample
    viewer, widget = open_widget(*layers_of_sample(), show=True)
    assert rim_of(widget.form, qtbot) == "rim"
    run(widget, qtbot)
    flat_map = ViewerState.of(viewer).current.flat_map
    assert_array_equal(flat_map.uv, rim.surface.flatten().uv)
    drawn = map_dock(viewer, qtbot)
    drawn.click.setCurrentText(REGION)
    active = flat_map.uv[flat_map.points[:, 2] > 9]  # half of the gyrus
    (left, low), (right, top) = np.quantile(active, (0.1, 0.9), axis=0)
    corners = np.array([(left, low), (right, low), (right, top), (left, top)])
    for place in corners:
        drawn.canvas.clicked.emit(*place)
    drawn.canvas.double_clicked.emit()
    qtbot.waitUntil(lambda: "rim regions" in viewer.layers, timeout=PATIENCE)

    _, dock = viewer.window.add_plugin_dock_widget("voxflat", "Cortical depth")
    assert rim_of(dock.form, qtbot) == "rim"
    assert [box.currentText() for box in (dock.form.regions, dock.form.sampled)] == ["rim regions", "activity"]
    dock.form.count.setValue(COUNT)
    choose(dock.form.layering, "equidistant")
    assert "standard deviation" in press(dock, dock.measure, qtbot)
    expected = rim.profile(
        activity, regions=flat_map.regions({"region 1": corners}), count=COUNT, layering="equidistant"
    )
    assert dock.profile.names == ("region 1",)
    assert np.abs(dock.profile.mean - expected.mean).max() < 0.1  # the map's regions end between voxels
    assert dock.profile.mean[0, COUNT // 2] > dock.profile.mean[0, 0] + 0.4  # the activity lies in the middle
    monkeypatch.setattr("qtpy.QtWidgets.QFileDialog.getSaveFileName", lambda *_: (str(tmp_path / "mine"), ""))
    dock.save.click()
    assert (tmp_path / "mine.tsv").read_text().count("region 1\t") == COUNT
    dock.form.regions.choose(None)
    choose(dock.form.layering, "equivolume")
    press(dock, dock.measure, qtbot)
    assert_array_equal(dock.profile.mean, rim.profile(activity, count=COUNT).mean)

    press(dock, dock.layers, qtbot)
    assert_array_equal(viewer.layers["rim in layers"].data, rim.layers(COUNT).data)
    viewer.layers.selection = {viewer.layers["rim in layers"]}
    viewer.layers.save(str(tmp_path / "layers.nii.gz"), selected=True, plugin="voxflat")
    assert_array_equal(nib.load(tmp_path / "layers.nii.gz").get_fdata(), rim.layers(COUNT).data)
    assert_allclose(nib.load(tmp_path / "layers.nii.gz").affine, rim.layers(COUNT).affine, atol=1e-6)
    dock.form.area.setValue(10.0)
    assert "columns" in press(dock, dock.columns, qtbot)
    assert_array_equal(viewer.layers["rim in columns"].data, rim.columns(area=10.0).volume.data)
    assert widget.form.surface.layer is viewer.layers["rim"]
    for _ in range(2):  # the window is used again after it was closed
        press(dock, dock.flatten, qtbot)
        flat = dock.flat_window.viewer
        (layer,) = flat.layers
        depths = [(k + 0.5) / COUNT for k in range(COUNT)]
        stack = flat_map.images(activity, fraction=depths, interpolation="linear")
        assert_array_equal(layer.data, np.stack([image.data for image in stack]).astype(np.float32))
        assert flat.dims.axis_labels[0] == "depth"
        assert flat.dims.nsteps[0] == COUNT
        assert_allclose(layer.data_to_world((0, 0, 0)), (0.1, -stack.origin[1], stack.origin[0]))
        saved = tmp_path / f"volume{len(list(tmp_path.iterdir()))}.nii.gz"
        layer.save(str(saved), plugin="voxflat")
        stack.save(tmp_path / "expected.nii.gz", overwrite=True)
        written, same = (nib.load(path) for path in (saved, tmp_path / "expected.nii.gz"))
        assert_array_equal(written.get_fdata(), same.get_fdata())
        assert_array_equal(written.affine, same.affine)
        assert flat.window._qt_window.isVisible()
        assert [str(one) for one in layer.units] == ["pixel", "millimeter", "millimeter"]
        assert scale_bar_of(flat).endswith(" mm")
        flat.window._qt_window.close()
        assert not flat.window._qt_window.isVisible()
        assert current_viewer() is getattr(viewer, "__wrapped__", viewer)  # not the hidden one
    del flat
    viewer.window.remove_dock_widget(dock)
    assert dock.flat_window.viewer is None
    wait_for_threads(qtbot)


def test_a_window_that_is_not_shown_yet_is_not_the_current_viewer(make_napari_viewer, qtbot):
    viewer, owner = make_napari_viewer(show=True), QWidget()
    qtbot.addWidget(owner)
    window = FlatWindow(owner, "flat")
    with pytest.raises(ValueError, match="nonsense"):
        window.show((np.ones((2, 2)), {"name": "flat"}, "nonsense"))
    assert window.viewer is not None
    assert current_viewer() is viewer
    window.show((np.ones((2, 2)), {"name": "flat"}, "image"))
    assert current_viewer() is window.viewer
    window.close()
    assert current_viewer() is viewer


def test_by_default_there_is_one_layer_per_voxel_of_the_thickness(open_widget, qtbot, sample):
    rim, activity = sample
    viewer, dock = open_widget(*layers_of_sample(), name="Cortical depth")
    assert rim_of(dock.form, qtbot) == "rim"
    assert dock.form.count.text() == "automatic"
    thickness = 2.5 / 0.4  # mm, of the demo rim, whose radii are 4.5 and 7 mm
    assert press(dock, dock.layers, qtbot) == "Divided 'rim' into 6 layers."
    assert abs(thickness - 6) < 0.5
    assert_array_equal(viewer.layers["rim in layers"].data, rim.layers(6).data)
    assert "in 6 layers" in press(dock, dock.measure, qtbot)
    assert_array_equal(dock.profile.mean, rim.profile(activity, count=6).mean)


def test_other_docks_take_a_rim(open_widget, qtbot, sample):
    viewer, check = open_widget(layers_of_sample()[1], name="Check surface")
    assert rim_of(check.form, qtbot) == "rim"
    check.start.click()
    points = f"{len(sample[0].surface):,}"
    qtbot.waitUntil(lambda: points in check.table.toPlainText(), timeout=PATIENCE)
    _, cuts = viewer.window.add_plugin_dock_widget("voxflat", "Draw cuts")
    assert rim_of(cuts.form, qtbot) == "rim"
    cuts.begin.click()
    qtbot.waitUntil(lambda: cuts.drawing is not None, timeout=PATIENCE)
    assert_array_equal(cuts.drawing.points, sample[0].surface.points)
    _, patches = viewer.window.add_plugin_dock_widget("voxflat", "Flatten in patches")
    assert rim_of(patches.form, qtbot) == "rim"
    run(patches, qtbot)
    assert_array_equal(ViewerState.of(viewer).current.flat_map.points, sample[0].surface.points)


def test_what_is_missing_is_named(open_widget, qtbot, messages):
    activity, rim = layers_of_sample()
    _, dock = open_widget(activity, name="Cortical depth")
    press(dock, dock.measure, qtbot)
    assert "Layer 'activity' is not used as a rim" in dock.status.text()
    press(dock, dock.flatten, qtbot)
    assert "There is no map with an inner and an outer border" in dock.status.text()
    dock._viewer.add_layer(rim)
    dock._viewer.layers.remove("activity")
    assert rim_of(dock.form, qtbot) == "rim"
    press(dock, dock.measure, qtbot)
    assert "There is no volume to sample" in dock.status.text()
    assert len(messages) == 3


def test_cancelling_leaves_nothing(open_widget, qtbot):
    viewer, dock = open_widget(*layers_of_sample(), name="Cortical depth")
    assert rim_of(dock.form, qtbot) == "rim"
    dock.layers.click()
    assert not dock.measure.isEnabled()
    dock.stop.click()
    qtbot.waitUntil(dock.layers.isEnabled, timeout=PATIENCE)
    assert dock.status.text() == "Cancelled"
    assert len(viewer.layers) == 2


def test_a_flat_volume_between_white_and_pial(open_widget, qtbot):
    points, faces, _ = bumps(13)
    low, high = (points + np.array([0, 0, up]) for up in (5.0, 7.0))
    white, pial = Surface((low, faces), name="lh.white"), Surface((high, faces), name="lh.pial")
    height = Image(np.indices((30, 30, 20))[2].astype(np.float32), name="height")
    viewer, widget = open_widget(white, pial, height)
    assert widget.form.pial.layer is viewer.layers["lh.pial"]
    run(widget, qtbot)
    _, dock = viewer.window.add_plugin_dock_widget("voxflat", "Cortical depth")
    dock.form.sampled.choose(viewer.layers["height"])
    press(dock, dock.flatten, qtbot)
    assert len(dock.flat_window.viewer.layers[0].data) == 3  # the fewest, because the cortex is 2 voxels thick
    dock.form.count.setValue(4)
    press(dock, dock.flatten, qtbot)
    (layer,) = dock.flat_window.viewer.layers
    steps = np.diff(layer.data, axis=0)
    assert_allclose(steps[np.isfinite(steps)], 0.5, atol=0.1)  # a quarter of 2 mm
