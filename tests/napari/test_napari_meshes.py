"""The napari plugin flattens meshes."""

import composed
import numpy as np
import pytest
from napari.layers import Image, Surface
from napari_window import bumps, choose, choose_whole, run, run_whole, same_map, sphere
from numpy.testing import assert_allclose, assert_array_equal
from triangle_meshes import ON_BOWL, write_bowl

import voxflat
from voxflat._napari.layers.volumes import LayerVolume
from voxflat._napari.results.report import figures
from voxflat._napari.viewer_state import ViewerState
from voxflat._napari.wording import in_window
from voxflat.io import Mesh, Space, read_mesh


def test_mesh_result_is_that_of_the_library(open_widget, qtbot):
    points, faces, values = bumps()
    layer = Surface((points, faces, values), name="bumps", units="mm", colormap="viridis")
    viewer, widget = open_widget(layer)
    run_whole(widget, qtbot)
    expected = voxflat.flatten(Mesh(points, faces, space=Space("scanner")))  # as the layer's unit is a length
    picture, heat = expected.image(values), expected.heat_map()
    assert [layer.name for layer in viewer.layers] == ["bumps", "bumps flattened", "bumps distortion"]
    image, distortion = viewer.layers[1:]
    for layer in (image, distortion):
        same_map(layer, expected)
        assert [str(unit) for unit in layer.units] == ["millimeter", "millimeter"]
    assert_array_equal(image.data, picture.data)
    assert_array_equal(distortion.data, heat.data)
    assert_allclose(image.translate, (-picture.origin[1], picture.origin[0]))
    assert image.colormap.name == "viridis"
    ids, places = image.metadata["voxflat"].locate()  # from pixels to vertices
    assert ids.shape == image.data.shape
    assert np.linalg.norm(places - points[ids], axis=-1)[ids >= 0].max() < 3


def test_the_form_gives_the_same_map_as_the_other_interfaces(open_widget, qtbot, tmp_path):
    """The mesh and options of `test_the_same_map_through_every_door`: the same arrays, bit by bit."""
    mesh = read_mesh(write_bowl(tmp_path / "bowl.vtp"))
    viewer, widget = open_widget(Surface((mesh.points, mesh.faces), name="bowl"))
    choose_whole(widget)
    for name, value in ON_BOWL.items():
        getattr(widget.form.options, name).setValue(value)
    run(widget, qtbot)
    found, own = ViewerState.of(viewer).current.flat_map, composed.flatten(str(tmp_path / "bowl.vtp"), **ON_BOWL)
    for name in ("uv", "ids", "faces", "points"):
        assert getattr(found, name).tobytes() == getattr(own, name).tobytes()
    assert found.distortion.per_point.tobytes() == own.distortion.per_point.tobytes()
    assert found.distortion.triangles.areal.tobytes() == own.distortion.triangles.areal.tobytes()


@pytest.mark.parametrize("name", ["bumps", "bowl"])
def test_patch_of_nonzero_values(open_widget, qtbot, name):
    if name == "bumps":
        points, faces, values = bumps()
    else:  # which is relaxed
        points, faces = sphere(150)
        values = (points[:, 2] < 12).astype(float)
    viewer, widget = open_widget(Surface((points, faces, values), name=name))
    choose(widget.form.patch, "values")
    run(widget, qtbot)
    expected = voxflat.surface((points, faces)).keep(values != 0).flatten()
    same_map(viewer.layers[f"{name} distortion"], expected)
    assert set(expected.ids) == set(np.flatnonzero(values))
    reasons = {cut["reason"] for cut in expected.metadata["automatic_cuts"]}
    assert reasons == ({"relaxation"} if name == "bowl" else set())


def test_disk_of_a_mesh_in_microns(open_widget, qtbot):
    points, faces, _ = bumps()
    affine = np.diag([250.0, -500, 500, 1])
    affine[:3, 3] = (1000, 2000, 3000)
    viewer, widget = open_widget(Surface((points, faces), name="bumps", affine=affine, units="micrometer"))
    choose(widget.form.patch, "disk")
    choose(widget.form.world, "RAS")
    widget.form.seed.set_point(312)
    widget.form.radius.setValue(7000)
    run(widget, qtbot)
    placed = points * [250.0, -500, 500] + [1000, 2000, 3000]
    turned = Mesh(placed, faces[:, ::-1], space=Space("scanner"))  # mirrored: outside stays outside
    expected = voxflat.surface(turned, unit="µm").disk(312, 7000).flatten()
    same_map(viewer.layers["bumps distortion"], expected)
    assert "bumps flattened" not in viewer.layers  # it has no values
    assert np.linalg.norm(expected.points - placed[312], axis=1).max() <= 7000


def test_closed_surface_is_cut_open_with_a_warning(open_widget, qtbot):
    viewer, widget = open_widget(Surface(sphere(100), name="ball"))
    run_whole(widget, qtbot)
    expected = voxflat.flatten(sphere(100))
    same_map(viewer.layers["ball distortion"], expected)
    (warning,) = (text for text in expected.metadata["warnings"] if "cut open" in text)
    assert in_window(warning[1:]) in widget.results.warnings.text()
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
    assert_allclose(viewer.layers["bumps i flattened"].data, x + 2, atol=1e-4)
    widget.form.sample_depth.setValue(1.5)
    run(widget, qtbot)
    volume = LayerVolume.of(viewer.layers["i"]).read()
    assert_array_equal(viewer.layers["bumps i flattened, 1.5 outside"].data, expected.image(volume, depth=1.5).data)
    widget.form.sampled.choose(others)
    run(widget, qtbot)
    nearest = expected.locate()[0]
    assert_array_equal(viewer.layers["bumps others flattened"].data, np.where(nearest < 0, np.nan, nearest))
