"""*Flatten in patches* in napari's real window."""

from functools import partial

import numpy as np
import pytest
import shapes
from napari.layers import Image, Labels, Surface
from napari_window import PATIENCE, choose, map_dock, open_file, run, sphere, wait_for_picture
from numpy.testing import assert_allclose, assert_array_equal

import voxflat
from voxflat._napari.map_viewer.dock import MARK
from voxflat._napari.results import layer_list


@pytest.fixture
def open_widget(open_widget):
    return partial(open_widget, name="Flatten in patches")


def limit(widget, name, value):
    choose(widget.form.limit, name)
    getattr(widget.form, name).setValue(value)


def same_atlas(layer, expected):
    atlas = layer.metadata["voxflat"]
    for name in ("points", "faces", "piece_ids", "uv", "stretch"):
        assert_array_equal(getattr(atlas, name), getattr(expected, name))


def test_result_is_that_of_the_library(open_widget, qtbot, tmp_path, monkeypatch):
    points, faces = sphere()
    values = points[:, 2] ** 2
    viewer, widget = open_widget(Surface((points, faces, values), name="ball", units="mm", colormap="viridis"))
    limit(widget, "max_angle", 25)
    run(widget, qtbot)
    expected = voxflat.surface((points, faces)).patches(25)
    names = [layer.name for layer in viewer.layers]
    assert names == ["ball", "ball in patches", "ball patches", "ball flattened", "ball C"]
    surface, patches, image, heat = viewer.layers[1:]
    for layer in viewer.layers[1:]:
        same_atlas(layer, expected)
    assert_array_equal(image.data, expected.image(values).data)
    assert_array_equal(heat.data, expected.heat_map().data)
    assert image.colormap.name == "viridis"
    picture = expected.heat_map()
    for layer in (patches, image, heat):
        assert_allclose(layer.translate, (-picture.origin[1], picture.origin[0]))
        assert not layer.visible
        assert [str(unit) for unit in layer.units] == ["millimeter", "millimeter"]
    assert heat.contrast_limits[0] == 1
    assert f"{len(expected)} patches" in widget.status.text()
    assert "C ≤ 1.4663" in widget.status.text()
    assert_array_equal(surface.faces, expected.uv_faces)
    assert_allclose(surface.vertices[surface.faces], points[expected.faces], atol=1e-9)
    dock = map_dock(viewer, qtbot)
    dock.click.setCurrentText(MARK)
    page = expected.page()._triangles
    dock.canvas.clicked.emit(*page.uv[page.faces[0]].mean(axis=0))
    wait_for_picture(dock, qtbot)
    (marked,) = viewer.layers["ball points"].data
    path = str(tmp_path / "atlas.npz")
    monkeypatch.setattr("voxflat._napari.results.map_panel.QFileDialog.getSaveFileName", lambda *args: (path, ""))
    widget.results.save.click()
    assert_array_equal(voxflat.FlatAtlas.load(path).uv, expected.uv)
    widget.form.max_angle.setValue(40)
    viewer.layers.clear()
    open_file(viewer, qtbot, path)
    wait_for_picture(dock, qtbot)
    assert_array_equal(viewer.layers["atlas points"].data, [marked])
    viewer.add_surface((points, faces, values), name="ball")
    qtbot.waitUntil(lambda: widget.form.max_angle.value() == 25, timeout=PATIENCE)
    assert widget.status.text() == "Restored the settings."


def test_colours_of_patches_are_the_same_on_page_and_surface(open_widget, qtbot):
    viewer, widget = open_widget(Surface(sphere(), name="ball"))
    limit(widget, "count", 40)
    run(widget, qtbot)
    surface, patches = viewer.layers["ball in patches"], viewer.layers["ball patches"]
    atlas = surface.metadata["voxflat"]
    assert len(atlas) <= 40
    shown = np.round(255 * np.asarray(surface.vertex_colors)).astype(int)[atlas.uv_faces]
    assert (shown == shown[:, :1]).all()
    triangles = atlas.page().face_ids()
    inside = triangles >= 0
    assert_array_equal(patches.data[inside][:, :3], shown[triangles[inside], 0, :3])
    assert (patches.data[~inside][:, 3] == 0).all()


@pytest.mark.parametrize("world", ["RAS", "SPL"])
def test_a_label_and_a_volume(open_widget, qtbot, world):
    ball = shapes.ball(9).astype(np.uint8) * 3
    along = np.indices(ball.shape)[0].astype(np.float32)
    scale = (0.5, 0.6, 0.7)
    labels = Labels(ball, name="ball", scale=scale, units="mm")
    viewer, widget = open_widget(Image(along, name="i", scale=scale, units="mm"), labels)
    widget.form.surface.choose(labels)
    qtbot.waitUntil(lambda: widget.form.label.label == 3, timeout=PATIENCE)
    choose(widget.form.world, world)
    limit(widget, "max_angle", 30)
    widget.form.sampled.choose(viewer.layers["i"])
    run(widget, qtbot)
    surface = viewer.layers["ball in patches"]
    atlas = surface.metadata["voxflat"]
    assert atlas.ids.shape == atlas.points.shape
    found = np.argwhere(ball) * scale  # in the viewer's world, whatever its axes are
    for end in (np.min, np.max):
        assert_allclose(end(surface.vertices, axis=0), end(found, axis=0), atol=0.7)
    image = viewer.layers["ball i flattened"].data
    ids = atlas.page().locate()[0]
    inside = ids[..., 0] >= 0
    assert np.nanmax(np.abs(image[inside] - ids[inside][:, 0])) < 2.5


def test_an_atlas_replaces_one_with_fewer_points(open_widget, qtbot):
    viewer, widget = open_widget(Surface(sphere(), name="ball"))
    assert viewer.dims.ndisplay == 2  # napari looks up the colours of the points in the slice
    limit(widget, "count", 12)
    run(widget, qtbot)
    surface = viewer.layers["ball in patches"]
    surface.visible = True
    fewer = len(surface.vertices)
    limit(widget, "count", 100)
    run(widget, qtbot)
    assert viewer.layers["ball in patches"] is surface
    assert len(surface.vertices) > fewer
    assert len(surface.vertex_colors) == len(surface.vertices)
    assert_array_equal(viewer.layers["ball C"].data, surface.metadata["voxflat"].heat_map().data)


def test_a_layer_that_fails_does_not_stop_the_others(open_widget, qtbot, monkeypatch):
    viewer, widget = open_widget(Surface(sphere(), name="ball"))
    limit(widget, "count", 12)
    run(widget, qtbot)
    fill, failures = layer_list._fill, []

    def fails_once(layer, data):
        if not failures:
            failures.append(layer.name)
            raise RuntimeError("no such layer")
        fill(layer, data)

    monkeypatch.setattr(layer_list, "_fill", fails_once)
    limit(widget, "count", 100)
    with qtbot.captureExceptions() as caught:
        run(widget, qtbot)
    assert [str(error) for _, error, _ in caught] == ["no such layer"]
    assert failures == ["ball in patches"]
    atlas = viewer.layers["ball C"].metadata["voxflat"]
    assert len(atlas) > 12
    assert_array_equal(viewer.layers["ball C"].data, atlas.heat_map().data)


def test_only_the_chosen_limit_is_asked(open_widget):
    _, widget = open_widget(Surface(sphere()))
    fields = {name: getattr(widget.form, name) for name in ("max_angle", "bound", "count")}
    for chosen in fields:
        choose(widget.form.limit, chosen)
        assert [name for name, field in fields.items() if field.isVisibleTo(widget)] == [chosen]


def test_bad_input_gives_a_one_line_message(open_widget, qtbot, messages):
    viewer, widget = open_widget(Surface(sphere()))
    limit(widget, "count", 1)
    run(widget, qtbot)
    assert "too few" in messages[-1].message
    assert "\n" not in messages[-1].message
    assert len(viewer.layers) == 1


def test_glued(open_widget, qtbot):
    points, faces = sphere()
    viewer, widget = open_widget(Surface((points, faces), name="ball"))
    limit(widget, "max_angle", 12)
    assert widget.form.glue.text() == "not glued"
    widget.form.glue.setValue(1.4)
    run(widget, qtbot)
    expected = voxflat.surface((points, faces)).patches(12).glue(1.4)
    surface, _, heat = viewer.layers[1:]
    same_atlas(heat, expected)
    assert_array_equal(heat.data, expected.heat_map().data)
    assert f"{len(expected)} piece" in widget.status.text()
    # of one patch one colour, also where it is glued to others
    shown = np.asarray(surface.vertex_colors)[surface.faces]
    assert (shown == shown[:, :1]).all()
    assert len(np.unique(shown[:, 0], axis=0)) > len(expected)
    assert_allclose(surface.vertices[surface.faces], points[expected.faces], atol=1e-9)


@pytest.mark.parametrize("glue", [None, 1.4])
def test_a_saved_atlas_is_opened(make_napari_viewer, qtbot, tmp_path, glue):
    atlas = voxflat.surface(sphere()).patches(25)
    atlas = atlas if glue is None else atlas.glue(glue)
    atlas.save(tmp_path / "ball.npz")
    viewer = make_napari_viewer()
    open_file(viewer, qtbot, tmp_path / "ball.npz")
    assert [layer.name for layer in viewer.layers] == ["ball in patches", "ball patches", "ball C"]
    assert not any(layer.visible for layer in viewer.layers)  # the dock shows them
    same_atlas(viewer.layers["ball C"], atlas)
    assert_array_equal(viewer.layers["ball C"].data, atlas.heat_map().data)
