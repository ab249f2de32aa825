"""The napari plugin in a real window: what it offers, what it computes, and that the window stays alive."""

import time

import numpy as np
import pytest
import shapes
from napari_window import (
    FLIP,
    PATIENCE,
    bumps,
    cap,
    choose,
    choose_whole,
    run,
    sphere,
    wait_for_threads,
    wait_until_drawn,
)
from npe2 import PluginManifest
from numpy.testing import assert_allclose, assert_array_equal

import voxflat
from voxflat._napari.layers.seed import seed_of
from voxflat._napari.layers.volumes import LayerVolume
from voxflat._napari.results.maps import flat_map_reader
from voxflat._napari.results.report import figures

napari = pytest.importorskip("napari")
from napari.layers import Image, Labels, Surface  # noqa: E402
from qtpy.QtCore import QTimer  # noqa: E402


@pytest.fixture(scope="module")
def large_mesh():
    """A dome of many triangles: some seconds of work from 4000 sources."""
    points, faces, _ = bumps(150)
    points[:, 2] = -0.005 * ((points[:, :2] - 149) ** 2).sum(axis=1)
    return points, faces


@pytest.fixture(scope="module")
def large():
    """A thick shell: some seconds of work from 6000 sources."""
    x = np.indices((150, 150, 150)) - 75
    return (np.abs(np.sqrt((x**2).sum(axis=0)) - 65) < 1.5).astype(np.uint8)


def start_large(widget, qtbot, large, sources=6000):
    """Start what takes seconds, and wait until the core is amid it."""
    widget.form.seed.set_point(tuple(int(n) for n in np.argwhere(large)[0]))
    widget.form.radius.setValue(90)
    start(widget, qtbot, sources)


def start(widget, qtbot, sources):
    widget.form.sources.setValue(sources)
    widget.start.click()
    qtbot.waitUntil(lambda: widget.bar.value() > 0, timeout=PATIENCE)


def same_map(layer, expected):
    """Whether a layer has exactly this map."""
    flat_map = layer.metadata["voxflat"]
    for name in ("uv", "points", "ids", "faces", "sources", "eigenvalues"):
        assert_array_equal(getattr(flat_map, name), getattr(expected, name))
    assert_array_equal(flat_map.distortion.per_point, expected.distortion.per_point)
    assert flat_map.metadata == {**expected.metadata, "napari": flat_map.metadata["napari"]}


# --------------------------------------------------------------------------------------- what is offered


def test_manifest_is_valid_and_its_commands_resolve():
    manifest = PluginManifest.from_distribution("voxflat")
    manifest.validate_imports()
    assert [widget.display_name for widget in manifest.contributions.widgets] == [
        "Flatten surface",
        "Flatten in patches",
    ]


def test_menus_of_a_real_viewer(make_napari_viewer):
    viewer = make_napari_viewer()

    def texts(menu, *path):
        for title in path:
            menu = next(action.menu() for action in menu.actions() if action.text().replace("&", "") == title)
            menu.aboutToShow.emit()
        return [action.text() for action in menu.actions()]

    names = ("Flatten surface", "Flatten in patches")
    assert {f"{name} (voxflat)" for name in names} <= set(texts(viewer.window.layers_menu, "Transform"))
    assert texts(viewer.window.plugins_menu, "voxflat") == [f"{name} (voxflat)" for name in names]
    assert "Demo cortex (MNI152) (voxflat)" in texts(viewer.window.file_menu, "Open Sample")


def test_importing_voxflat_imports_no_napari():
    import subprocess
    import sys

    code = "import sys, voxflat; sys.exit(any(m.split('.')[0] in ('napari', 'qtpy') for m in sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_demo_cortex_is_a_sample(make_napari_viewer):
    pytest.importorskip("nilearn")
    from voxflat.demo import SEED_POINT, THRESHOLD, demo_cortex

    viewer = make_napari_viewer()
    viewer.open_sample("voxflat", "demo_cortex")
    t1, labels, seed = viewer.layers
    white_matter, _, _ = demo_cortex()
    assert isinstance(t1, Image)
    assert labels.data.dtype == np.uint8
    assert_array_equal(labels.data, white_matter.data > THRESHOLD)
    assert_allclose(LayerVolume.of(t1).place.affine, white_matter.affine)
    assert_allclose(LayerVolume.of(labels).place.affine, white_matter.affine)
    assert seed_of(seed, labels) == SEED_POINT


# ---------------------------------------------------------------------------------------------- choices


def test_layers_and_labels_are_listed(open_widget, qtbot):
    labels = cap()
    labels[0, 0, 0] = 7
    viewer, widget = open_widget(Image(np.ones((4, 4)), name="flat picture"), Labels(labels, name="parts"))
    assert widget.form.surface.layer is viewer.layers["parts"]
    qtbot.waitUntil(lambda: widget.form.label.count() == 2)
    assert [widget.form.label.itemData(n) for n in range(2)] == [3, 7]
    viewer.layers["parts"].selected_label = 7
    assert widget.form.label.label == 7
    viewer.layers["parts"].selected_label = 5  # is not there
    assert widget.form.label.label == 7
    viewer.layers["parts"].name = "regions"
    assert widget.form.surface.currentText() == "regions"
    viewer.layers["regions"].data_setitem((np.array([0]),) * 3, 9)
    qtbot.waitUntil(lambda: widget.form.label.findData(9) >= 0)
    viewer.layers.remove("regions")
    assert widget.form.surface.layer is None
    assert not widget.form.label.count()


def test_threshold_starts_amid_the_contrast_limits(open_widget):
    _, widget = open_widget(Image(np.linspace(0, 10, 1000).reshape(10, 10, 10)))
    assert widget.form.threshold.value() == pytest.approx(5)
    assert widget.form.threshold.isVisibleTo(widget)
    assert not widget.form.label.isVisibleTo(widget)


def test_the_form_follows_the_kind_of_layer(open_widget):
    points, faces, values = bumps()
    viewer, widget = open_widget(Image(np.random.default_rng(0).random((5, 5, 5)), name="T1"))
    form = widget.form
    viewer.add_surface((points, faces, values), name="mesh")
    viewer.add_surface((points, faces), name="same vertices")
    viewer.add_surface((points[:4], faces[:1] * 0 + [0, 1, 2]), name="other vertices")
    form.surface.choose(viewer.layers["mesh"])
    assert form.sampled.layer is viewer.layers["mesh"]
    assert [form.sampled.itemText(n) for n in range(form.sampled.count())] == ["nothing", "T1", "mesh", "same vertices"]
    assert not any(field.isVisibleTo(form) for field in (form.label, form.threshold, form.method, form.sample_depth))
    choose(form.patch, "values")
    assert not form.seed.isVisibleTo(form)
    form.surface.choose(viewer.layers["T1"])
    assert form.sampled.layer is viewer.layers["T1"]
    assert form.patch.findData("values") < 0
    assert form.patch.currentData() == "disk"
    assert all(field.isVisibleTo(form) for field in (form.threshold, form.method, form.sample_depth, form.seed))


# --------------------------------------------------------------------------------------------- flattening


@pytest.mark.parametrize("method", ["voxflat", "grossmann2002", "zigelman2002", "schwartz1989"])
def test_result_is_that_of_the_library(open_widget, qtbot, method):
    labels, t1 = cap(), np.random.default_rng(0).random((24, 24, 24)).astype(np.float32)
    viewer, widget = open_widget(
        Image(t1, affine=FLIP, units="mm", name="T1"), Labels(labels, affine=FLIP, units="mm", name="sheet")
    )
    qtbot.waitUntil(lambda: widget.form.label.label == 3)
    assert widget.form.method.currentData() == "voxflat"
    choose(widget.form.method, method)
    choose_whole(widget)
    widget.form.sources.setValue(200)
    widget.form.pixel_size.setValue(1.25)
    run(widget, qtbot)
    expected = voxflat.flatten(labels, method=method, affine=FLIP, label=3, sources=200)
    picture = expected.image(t1, 1.25)
    flattened, distortion = viewer.layers["T1 flattened"], viewer.layers["sheet distortion"]
    assert_array_equal(flattened.data, picture.data)
    assert_array_equal(distortion.data, expected.heat_map(1.25).data)
    for layer in (flattened, distortion):
        assert_allclose(layer.scale, 1.25)
        assert_allclose(layer.translate, (-picture.origin[1], picture.origin[0]))
        assert [str(unit) for unit in layer.units] == ["millimeter", "millimeter"]
        assert np.isfinite(layer.contrast_limits).all()
        same_map(layer, expected)
        assert layer.metadata["parameters"] is layer.metadata["voxflat"].metadata
        assert layer.metadata["parameters"]["napari"] == {"layer": "sheet", "world_axes": "RAS", "unit": "millimeter"}
        assert layer.metadata["distortion"]["raw"]["stress_1"] == expected.distortion.raw.stress_1
    assert ("torn faces" in dict(figures(expected))) == (method == "grossmann2002")
    assert ("flipped triangles" in dict(figures(expected))) == (method != "grossmann2002")
    assert "fraction" in distortion.metadata["colours"]
    assert distortion.colorbar.visible
    assert f"{100 * expected.distortion.raw.relative_error:.1f} %" in widget.status.text()


def test_only_the_map_is_shown_then_the_volume_again(open_widget, qtbot):
    viewer, widget = open_widget(Labels(cap(), name="sheet"), Image(cap().astype(float), name="T1"), show=True)
    qtbot.waitUntil(lambda: widget.form.label.label == 3)
    choose_whole(widget)
    viewer.dims.ndisplay = 3
    viewer.dims.order = (2, 0, 1)
    viewer.dims.point = (5, 6, 7)
    viewer.layers["T1"].visible = False
    viewer.reset_view()
    camera = getattr(viewer, "scene", viewer).camera  # before napari 0.9 the viewer's own
    before = (camera.center, camera.zoom, viewer.dims.order, viewer.dims.point)
    run(widget, qtbot)
    assert {layer.name for layer in viewer.layers if layer.visible} == {"T1 flattened", "sheet distortion"}
    assert viewer.dims.ndisplay == 2
    assert viewer.dims.order == (0, 1, 2)
    extent = viewer.layers["sheet distortion"].extent.world
    assert_allclose(camera.center[-2:], extent.mean(axis=0), atol=1e-6)
    if hasattr(viewer, "canvas"):
        assert viewer.canvas.grid.enabled
        shown = np.array(viewer.canvas.viewbox_size(viewer.layers)) / camera.zoom
        assert 0.85 < np.max((extent[1] - extent[0]) / shown) < 1
    widget.results.toggle.click()
    assert {layer.name for layer in viewer.layers if layer.visible} == {"sheet"}
    assert viewer.dims.ndisplay == 3
    assert_allclose(camera.center, before[0])
    assert (camera.zoom, viewer.dims.order, viewer.dims.point) == before[1:]
    assert not hasattr(viewer, "canvas") or not viewer.canvas.grid.enabled
    widget.results.toggle.click()
    viewer.layers.remove("T1 flattened")
    viewer.layers.remove("sheet distortion")
    assert viewer.layers["sheet"].visible
    assert not widget.results.toggle.isEnabled()


def test_atlas_on_the_map_is_a_labels_layer(open_widget, qtbot):
    atlas = np.zeros((24, 24, 24), dtype=np.int32)
    atlas[12:], atlas[:12] = 1001, 2035
    viewer, widget = open_widget(Labels(atlas, name="atlas"), Labels(cap(), name="sheet"))
    qtbot.waitUntil(lambda: widget.form.label.label == 3)
    choose_whole(widget)
    widget.form.sampled.choose(viewer.layers["atlas"])
    run(widget, qtbot)
    layer = viewer.layers["atlas flattened"]
    assert isinstance(layer, Labels)
    assert set(np.unique(layer.data)) == {0, 1001, 2035}


def test_colours_on_the_map(open_widget, qtbot):
    colours = np.random.default_rng(0).integers(0, 255, (24, 24, 24, 3), dtype=np.uint8)
    viewer, widget = open_widget(Image(colours, rgb=True, name="stain"), Labels(cap(), name="sheet"))
    qtbot.waitUntil(lambda: widget.form.label.label == 3)
    choose_whole(widget)
    run(widget, qtbot)
    assert viewer.layers["stain flattened"].rgb


def test_dask_above_a_threshold(open_widget, qtbot):
    dask = pytest.importorskip("dask.array")
    volume = cap() / 3.0
    viewer, widget = open_widget(Image(dask.from_array(volume, chunks=8), name="probability", contrast_limits=(0, 1)))
    choose_whole(widget)
    run(widget, qtbot)
    flat_map = viewer.layers["probability distortion"].metadata["voxflat"]
    assert_array_equal(flat_map.uv, voxflat.flatten(volume, threshold=0.5).uv)


def test_saved_map_opens_in_napari(open_widget, qtbot, tmp_path, monkeypatch):
    viewer, widget = open_widget(Labels(cap(), name="sheet"))
    qtbot.waitUntil(lambda: widget.form.label.label == 3)
    choose_whole(widget)
    run(widget, qtbot)
    path = str(tmp_path / "map.npz")
    monkeypatch.setattr("voxflat._napari.results.map_panel.QFileDialog.getSaveFileName", lambda *args: (path, ""))
    widget.results.save.click()
    (opened,) = viewer.open(path, plugin="voxflat")
    assert opened.name == "map distortion"
    assert_array_equal(opened.data, viewer.layers["sheet distortion"].data)
    np.savez(tmp_path / "other.npz", data=np.ones(3))
    assert flat_map_reader(str(tmp_path / "other.npz")) is None


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
    widget.form.seed.set_point(312)
    widget.form.radius.setValue(7)
    run(widget, qtbot)
    placed = points * [0.25, -0.5, 0.5] + [1, 2, 3]
    expected = voxflat.flatten((placed, faces[:, ::-1]), seed_point=312, radius=7)  # mirrored: outside stays outside
    same_map(viewer.layers["bumps distortion"], expected)
    assert "bumps flattened" not in viewer.layers  # it has no values
    assert np.linalg.norm(expected.points - placed[312], axis=1).max() <= 7


def test_fsaverage_by_the_vertices_of_its_flat_map(open_widget, qtbot):
    pytest.importorskip("nilearn")
    from nilearn.datasets import fetch_surf_fsaverage

    files = fetch_surf_fsaverage("fsaverage5")
    white, flat = (voxflat.io.read_mesh(files[name]) for name in ("white_left", "flat_left"))
    kept = np.zeros(len(white.points))
    kept[flat.faces] = 1
    viewer, widget = open_widget(Surface((white.points, white.faces, kept), name="white"))
    choose(widget.form.patch, "values")
    run(widget, qtbot, timeout=PATIENCE)
    expected = voxflat.flatten((white.points, white.faces), keep=kept)
    same_map(viewer.layers["white distortion"], expected)
    assert len(expected) > 9000


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


# ------------------------------------------------------------------------------------------------ trouble


def degenerate_mesh():
    points, faces, _ = bumps()
    points[faces[7, 0]] = points[faces[7, 1]]
    return Surface((points, faces))


def nan_mesh():
    points, faces, _ = bumps()
    points[30, 1] = np.nan
    return Surface((points, faces))


def nan_image():
    volume = cap().astype(float)
    volume[0, 0, 0] = np.nan
    return Image(volume, contrast_limits=(0, 3))


BAD_LAYERS = [
    (lambda: Labels(np.zeros((9, 9, 9), dtype=np.uint8)), "every voxel is 0"),
    (lambda: Labels(np.ones((9, 9), dtype=np.uint8)), "2 dimensions"),
    (lambda: Labels(np.ones((2, 9, 9, 9), dtype=np.uint8)), "4 dimensions"),
    (nan_image, "NaN"),
    (lambda: Surface((np.zeros((3, 2)), np.array([[0, 1, 2]]))), "2 dimensions"),
    (lambda: Surface((bumps()[0], np.array([[0, 1, 26, 25]]))), "4 corners instead of 3"),
    (lambda: Surface((bumps()[0], bumps()[1], np.ones((2, 625)))), "2 axes of values"),
    (degenerate_mesh, "has no area"),
    (nan_mesh, "finite"),
]


def test_bad_input_is_one_line_and_no_layer(open_widget, qtbot, messages):
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
    qtbot.waitUntil(lambda: widget.form.label.label == 3)
    run(widget, qtbot)
    assert "good distortion" in viewer.layers


def test_a_closed_surface_is_refused_by_the_papers_method(open_widget, qtbot, messages):
    _, widget = open_widget(Labels(np.pad(np.ones((5, 5, 5), dtype=np.uint8), 2)))
    choose(widget.form.method, "grossmann2002")
    choose_whole(widget)
    run(widget, qtbot)
    assert "closed" in messages[-1].message
    choose(widget.form.method, "voxflat")
    run(widget, qtbot)
    assert "cut open" in widget.results.warnings.text()


def test_missing_choices_are_named(open_widget, messages):
    viewer, widget = open_widget()
    widget.start.click()
    assert "nothing to flatten" in messages[-1].message
    viewer.add_labels(cap())
    widget.start.click()
    assert "no seed point" in messages[-1].message
    choose_whole(widget)
    viewer.add_image(np.ones((24, 24, 24)), units="mm")
    widget.start.click()
    assert "units" in messages[-1].message


def test_a_bug_comes_with_its_traceback(open_widget, qtbot, messages, monkeypatch):
    def broken(*args):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr("voxflat._napari.job.Job.run", broken)
    viewer, widget = open_widget(Labels(cap()))
    choose_whole(widget)
    run(widget, qtbot)
    assert isinstance(messages[0].exception, ZeroDivisionError)
    assert len(viewer.layers) == 1


def test_cancel_is_prompt(open_widget, qtbot, large):
    viewer, widget = open_widget(Labels(large, name="shell"))
    start_large(widget, qtbot, large)
    before = time.perf_counter()
    widget.stop.click()
    qtbot.waitUntil(widget.start.isEnabled, timeout=5_000)
    seconds = time.perf_counter() - before
    print(f"cancelled in {seconds:.3f} s")
    assert seconds < 1  # some 0.02 s where the machine has nothing else to do
    assert widget.status.text() == "cancelled"
    assert [layer.name for layer in viewer.layers] == ["shell", "seed point"]
    widget.form.radius.setValue(15)
    widget.form.sources.setValue(50)
    run(widget, qtbot)
    assert "shell distortion" in viewer.layers


def test_cancel_of_a_mesh_is_prompt(open_widget, qtbot, large_mesh):
    viewer, widget = open_widget(Surface(large_mesh, name="dome"))
    choose_whole(widget)
    start(widget, qtbot, 4000)
    before = time.perf_counter()
    widget.stop.click()
    qtbot.waitUntil(widget.start.isEnabled, timeout=5_000)
    assert time.perf_counter() - before < 1
    assert widget.status.text() == "cancelled"
    assert [layer.name for layer in viewer.layers] == ["dome"]


def test_window_stays_alive(open_widget, qtbot, large):
    viewer, widget = open_widget(Labels(large), Image(large.astype(np.float32)), show=True)
    ticks = []
    timer = QTimer()
    timer.setInterval(5)
    timer.timeout.connect(lambda: ticks.append((time.perf_counter(), len(viewer.layers))))
    wait_until_drawn(viewer, qtbot)
    start_large(widget, qtbot, large, sources=500)
    timer.start()
    qtbot.waitUntil(widget.start.isEnabled, timeout=PATIENCE)
    timer.stop()
    times, layers = np.transpose(ticks)
    gap = np.diff(times[layers == layers[0]]).max()
    print(f"longest gap {gap:.3f} s while computing, {np.diff(times).max():.3f} s when napari adds the map's layers")
    assert gap < 0.5  # some 0.03 s where the machine has nothing else to do


def test_removing_the_mesh_meanwhile_is_safe(open_widget, qtbot, large_mesh):
    viewer, widget = open_widget(Surface(large_mesh, name="dome"))
    choose_whole(widget)
    start(widget, qtbot, 200)
    viewer.layers.clear()
    qtbot.waitUntil(widget.start.isEnabled, timeout=PATIENCE)
    assert "dome flat distortion" in viewer.layers


def test_removing_the_layer_meanwhile_is_safe(open_widget, qtbot, large):
    viewer, widget = open_widget(Labels(large, name="shell"))
    start_large(widget, qtbot, large, sources=300)
    viewer.layers.clear()
    qtbot.waitUntil(widget.start.isEnabled, timeout=PATIENCE)
    assert "shell distortion" in viewer.layers


@pytest.mark.parametrize("close", ["window", "dock"])
def test_closing_meanwhile_cancels(open_widget, qtbot, large, close, endings, messages):
    viewer, widget = open_widget(Labels(large))
    start_large(widget, qtbot, large)
    layers = list(viewer.layers)
    if close == "window":
        viewer.close()
    else:
        viewer.window.remove_dock_widget(widget)
    wait_for_threads(qtbot)
    assert endings == [voxflat.Cancelled]
    assert messages == []
    if close == "dock":
        assert list(viewer.layers) == layers
        viewer.add_labels(cap())  # nothing listens any more


def test_the_map_shows_the_volume_at_a_depth(make_napari_viewer, qtbot):
    ball = shapes.ball(12).astype(np.uint8)
    along = np.indices(ball.shape)[0].astype(np.float32)
    viewer = make_napari_viewer()
    viewer.add_image(along, name="i")
    viewer.add_labels(ball, name="ball")
    viewer.add_points([[24, 14, 14]], name="seed")
    _, widget = viewer.window.add_plugin_dock_widget("voxflat", "Flatten surface")
    qtbot.waitUntil(lambda: widget.form.seed.point is not None)
    widget.form.radius.setValue(12)
    means = []
    for depth in (0, 2):
        widget.form.sample_depth.setValue(depth)
        widget.flatten()
        qtbot.waitUntil(lambda: widget.start.isEnabled(), timeout=PATIENCE)
        newest = [layer for layer in viewer.layers if layer.name.startswith("i flattened")][-1]
        means.append(np.nanmean(newest.data))
    assert 1 < means[1] - means[0] < 2  # the patch faces along i
