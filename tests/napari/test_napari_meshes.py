"""The napari plugin flattens meshes."""

import numpy as np
import pytest
from napari_maps import same_map
from napari_window import (
    PATIENCE,
    bumps,
    choose,
    choose_whole,
    run,
    sphere,
)
from numpy.testing import assert_allclose, assert_array_equal

import voxflat
from voxflat._napari.results.report import figures

napari = pytest.importorskip("napari")
from napari.layers import Image, Surface  # noqa: E402

pytestmark = pytest.mark.slow  # a window


# ---------------------------------------------------------------------------------------- flattening meshes


def test_mesh_result_is_that_of_the_library(open_widget, qtbot):
    points, faces, values = bumps()
    layer = Surface((points, faces, values), name="bumps", units="mm", colormap="viridis")
    viewer, widget = open_widget(layer)
    choose_whole(widget)
    run(widget, qtbot)
    expected = voxflat.flatten((points, faces))
    picture, heat = expected.image(values), expected.heat_map()
    names = ["bumps", "bumps flat", "bumps flat distortion", "bumps flattened", "bumps distortion"]
    assert [layer.name for layer in viewer.layers] == names
    flat, warm, image, distortion = viewer.layers[1:]
    for layer in viewer.layers[1:]:
        same_map(layer, expected)
        assert [str(unit) for unit in layer.units] == ["millimeter", "millimeter"]
    assert_array_equal(image.data, picture.data)
    assert_array_equal(distortion.data, heat.data)
    assert_allclose(image.translate, (-picture.origin[1], picture.origin[0]))
    assert image.colormap.name == flat.colormap.name == "viridis"
    for surface, carried in ((flat, values), (warm, None)):
        assert isinstance(surface, Surface)
        assert_array_equal(surface.vertices, np.stack([-expected.uv[:, 1], expected.uv[:, 0]], axis=1))
        assert_array_equal(surface.faces, expected.faces)
        assert_array_equal(surface.features["vertex"], expected.ids)
        expected_values = expected.distortion.per_point if carried is None else carried[expected.ids]
        assert_array_equal(surface.vertex_values, expected_values)
    assert not flat.visible
    assert image.visible
    ids, places = image.metadata["voxflat"].locate()  # from pixels to vertices
    assert ids.shape == image.data.shape
    assert np.linalg.norm(places - points[ids], axis=-1)[ids >= 0].max() < 3
    assert widget.results.toggle.text() == "Show surface"
    widget.results.toggle.click()
    assert [layer.name for layer in viewer.layers if layer.visible] == ["bumps"]
    flat.visible = True
    widget.results.toggle.click()
    assert [layer.name for layer in viewer.layers if layer.visible] == names[3:]


def test_patch_of_the_values_that_are_not_0(open_widget, qtbot):
    points, faces, values = bumps()
    viewer, widget = open_widget(Surface((points, faces, values), name="bumps"))
    choose(widget.form.patch, "values")
    run(widget, qtbot)
    expected = voxflat.flatten((points, faces), keep=values != 0)
    same_map(viewer.layers["bumps distortion"], expected)
    assert set(expected.ids) == set(np.flatnonzero(values))
    assert viewer.layers["bumps flat"].vertex_values.min() > 0


def test_disk_of_a_mesh_in_microns(open_widget, qtbot):
    points, faces, _ = bumps()
    affine = np.diag([250.0, -500, 500, 1])
    affine[:3, 3] = (1000, 2000, 3000)
    viewer, widget = open_widget(Surface((points, faces), name="bumps", affine=affine, units="micrometer"))
    choose(widget.form.patch, "disk")
    widget.form.seed.set_point(312)
    widget.form.radius.setValue(7)
    run(widget, qtbot)
    placed = points * [0.25, -0.5, 0.5] + [1, 2, 3]
    expected = voxflat.flatten((placed, faces[:, ::-1]), seed_point=312, radius=7)  # mirrored: outside stays outside
    same_map(viewer.layers["bumps distortion"], expected)
    assert "bumps flattened" not in viewer.layers  # it has no values
    assert np.linalg.norm(expected.points - placed[312], axis=1).max() <= 7


def test_a_region_is_relaxed_as_the_library_does(open_widget, qtbot):
    points, faces = sphere(300)
    kept = (points[:, 2] < 12).astype(float)
    viewer, widget = open_widget(Surface((points, faces, kept), name="bowl"))
    choose(widget.form.patch, "values")
    run(widget, qtbot, timeout=PATIENCE)
    expected = voxflat.flatten((points, faces), keep=kept)
    same_map(viewer.layers["bowl distortion"], expected)
    assert {cut["reason"] for cut in expected.metadata["automatic_cuts"]} == {"relaxation"}


def test_closed_surface_is_cut_open_and_says_so(open_widget, qtbot):
    points, faces = sphere()
    viewer, widget = open_widget(Surface((points, faces), name="ball"))
    choose_whole(widget)
    run(widget, qtbot)
    expected = voxflat.flatten((points, faces))
    same_map(viewer.layers["ball distortion"], expected)
    (warning,) = (text for text in expected.metadata["warnings"] if "cut open" in text)
    assert warning[1:] in widget.results.warnings.text()
    assert widget.results.warnings.isVisibleTo(widget.results)
    shown = dict(figures(expected))
    assert shown["automatic cuts"].startswith(f"{len(expected.metadata['automatic_cuts'])}, ")
    assert shown["flipped triangles"].startswith(str(expected.distortion.triangles.flipped))
    assert "torn faces" not in shown


def test_a_mesh_shows_a_volume_or_another_layer_of_its_vertices(open_widget, qtbot):
    points, faces, _ = bumps()
    mesh = Surface((points, faces), name="bumps")
    others = Surface((points + 1, faces, np.arange(len(points))), name="others")
    along = np.indices((60, 60, 30))[0].astype(np.float32)
    viewer, widget = open_widget(others, mesh, Image(along, name="i", translate=(-2, -2, -8)))
    widget.form.surface.choose(mesh)
    choose_whole(widget)
    assert widget.form.sampled.layer is viewer.layers["i"]
    run(widget, qtbot)
    expected = voxflat.flatten((points, faces))
    x = expected.raster().interpolate(points[expected.ids, :1])[..., 0]
    assert_allclose(viewer.layers["i flattened"].data, x + 2, atol=1e-4)
    widget.form.sampled.choose(others)
    run(widget, qtbot)
    nearest = expected.locate()[0]
    assert_array_equal(viewer.layers["others flattened"].data, np.where(nearest < 0, np.nan, nearest))


def test_saved_map_of_a_mesh_opens_in_napari(open_widget, tmp_path):
    points, faces, _ = bumps()
    viewer, _ = open_widget()
    expected = voxflat.flatten((points, faces))
    expected.save(tmp_path / "map.npz")
    opened = viewer.open(str(tmp_path / "map.npz"), plugin="voxflat")
    assert [layer.name for layer in opened] == ["map flat distortion", "map distortion"]
    assert_array_equal(opened[0].vertex_values, expected.distortion.per_point)


def test_a_map_of_microns_fills_the_canvas(open_widget, qtbot):
    points, faces, _ = bumps()
    viewer, widget = open_widget(Surface((1000 * points, faces), name="bumps", units="micrometer"), show=True)
    choose_whole(widget)
    run(widget, qtbot)
    extent = viewer.layers["bumps distortion"].extent.world * 1000
    canvas = getattr(viewer, "scene", viewer).camera
    shown = np.array(viewer.canvas.viewbox_size(viewer.layers)) / canvas.zoom
    assert 0.85 < np.max((extent[1] - extent[0]) / shown) < 1
    np.testing.assert_allclose(canvas.center[-2:], extent.mean(axis=0), atol=1e-3)
