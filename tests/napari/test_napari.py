"""The napari plugin in a real window: its menus, its form and its results."""

import re
import subprocess
import sys
from pathlib import Path

import composed
import dask.array as da
import numpy as np
import pytest
from napari.layers import Image, Labels, Surface
from napari_window import (
    DOCKS,
    FLIP,
    PATIENCE,
    bumps,
    cap,
    choose,
    open_file,
    run,
    run_whole,
    same_map,
    wait_for_threads,
)
from npe2 import PluginManifest
from numpy.testing import assert_allclose, assert_array_equal
from qtpy.QtGui import QShortcut
from qtpy.QtWidgets import QAbstractButton, QComboBox, QLabel

import voxflat
from voxflat._napari.layers.seed import seed_of
from voxflat._napari.layers.volumes import LayerVolume
from voxflat._napari.results.report import figures
from voxflat._napari.viewer_state import ViewerState


def test_manifest_is_valid_and_its_commands_resolve():
    manifest = PluginManifest.from_distribution("voxflat")
    manifest.validate_imports()
    assert tuple(widget.display_name for widget in manifest.contributions.widgets) == DOCKS


def texts_of_menu(menu, *path):
    """The entries of a menu, without the suffix that napari adds."""
    for title in path:
        menu = next(action.menu() for action in menu.actions() if action.text().replace("&", "") == title)
        menu.aboutToShow.emit()
    return [action.text().replace("&", "").replace("...", "…") for action in menu.actions()]


def test_menus_of_a_real_viewer(make_napari_viewer):
    viewer = make_napari_viewer()
    transforms = ("Flatten surface", "Flatten in patches", "Draw cuts")
    measures = ("Check surface", "Measure map", "Cortical depth")
    for menu, names in (("Transform", transforms), ("Measure", measures)):
        assert {f"{name} (voxflat)" for name in names} <= set(texts_of_menu(viewer.window.layers_menu, menu))
    assert texts_of_menu(viewer.window.plugins_menu, "voxflat") == [f"{name} (voxflat)" for name in DOCKS]
    samples = ["Demo cortex (MNI152)", "Demo rim (synthetic gyrus)", "Synthetic embryo"]
    assert texts_of_menu(viewer.window.file_menu, "Open Sample", "voxflat") == samples


NO_NAMES = {"Spread between people", "Show flat map"}  # of group maps and of flat maps of other programs
NO_NAMES |= {"(voxflat)", "Point", "Points and Shapes", "New labels layer", "use this size"}  # of napari, and actions


def test_what_the_page_names_is_in_the_window(flattened):
    """The names in italics or bold in docs/napari.md and README.md, the rows of the form, and the keys of docks."""
    points, faces, _ = bumps(9)
    viewer, widget, _ = flattened(Surface((points, faces), name="lh.white"))
    docks = {name: viewer.window.add_plugin_dock_widget("voxflat", name)[1] for name in DOCKS}
    seen = set(DOCKS)
    for dock in docks.values():
        seen |= {part.text() for kind in (QLabel, QAbstractButton) for part in dock.findChildren(kind)}
        seen |= {box.itemText(row) for box in dock.findChildren(QComboBox) for row in range(box.count())}
    manifest = PluginManifest.from_distribution("voxflat")
    seen |= {"voxflat", *(f"voxflat {writer.display_name}" for writer in manifest.contributions.writers)}
    page, readme = ((Path(__file__).parents[2] / name).read_text() for name in ("docs/napari.md", "README.md"))
    named = {bold or italic for bold, italic in re.findall(r"\*\*([^*\n]+)\*\*|\*([^*\n]+)\*", page)}
    named |= set(re.findall(r"\*([A-Z]\w+(?: → [^*]+)+)\*", readme))
    assert len(named) > 40
    for one in sorted(named - NO_NAMES):
        title, *path = one.split(" → ")
        if path:
            entries = texts_of_menu(getattr(viewer.window, f"{title.lower()}_menu"), *path[:-1])
            assert {path[-1], f"{path[-1]} (voxflat)"} & set(entries), one
        else:
            assert one in seen, one

    rows = [line.split("|")[1:-1] for line in page.splitlines() if line.startswith("| ")]
    head = rows.index([" dock ", " key ", " action "])
    form, keys = rows[1:head], rows[head + 1 :]
    asked = {part.text() for part in widget.form.findChildren(QLabel)} | {"Advanced"}
    assert {name.strip() for row in form for name in row[0].split(",")} <= asked
    told, dock = {}, ""
    for row in keys:
        dock = row[0].strip() or dock
        told.setdefault(dock, set()).update(key.strip() for key in row[1].split(","))
    bound = {name: {one.key().toString() for one in dock.findChildren(QShortcut)} for name, dock in docks.items()}
    assert told == {name: found for name, found in bound.items() if found}


def test_napari_reads_only_the_manifest_at_startup():
    code = (
        "import sys; from npe2 import PluginManager; manager = PluginManager(); manager.discover(); "
        "assert 'voxflat' in manager; sys.exit('voxflat' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_opening_docks_does_not_import_slow_modules():
    """The window waits for the imports of the first dock: matplotlib, dask and scipy took two seconds."""
    code = """
import sys, time, napari
from qtpy.QtWidgets import QApplication
viewer = napari.Viewer()
before = set(sys.modules)
for name in sys.argv[1:]:
    viewer.window.add_plugin_dock_widget("voxflat", name)
for _ in range(20):
    QApplication.processEvents()
    time.sleep(0.01)
parts = ("matplotlib", "dask", "scipy.spatial", "scipy.ndimage", "scipy.sparse", "nibabel", "PIL")
viewer.close()
print("imported", *sorted(set(parts) & (set(sys.modules) - before)))
"""
    run = subprocess.run([sys.executable, "-c", code, *DOCKS], check=True, capture_output=True, text=True)
    assert run.stdout.splitlines()[-1] == "imported"


def test_demo_cortex_is_a_sample(make_napari_viewer, qtbot):
    from napari.utils import progress

    from voxflat.demo import THRESHOLD, demo_cortex

    viewer = make_napari_viewer()
    first = viewer.window.add_plugin_dock_widget("voxflat", "Flatten surface")[1].form
    (seed,) = viewer.open_sample("voxflat", "demo_cortex")  # immediately; the others after they are read
    assert not seed.visible  # alone it would fill the view
    window = viewer.window._qt_viewer
    if fonts := getattr(window, "_font_manager", None):  # not in napari 0.6
        assert {*"ÅÉÑŐjgpqy"} <= {*fonts.get_font(window._overlay_font)._glyphs}  # drawn before the first text
    qtbot.waitUntil(lambda: [bar.desc for bar in progress._all_instances] == ["Demo cortex"])
    qtbot.waitUntil(lambda: len(viewer.layers) == 3, timeout=PATIENCE)
    t1, labels, _ = viewer.layers
    qtbot.waitUntil(lambda: not progress._all_instances, timeout=PATIENCE)
    white_matter, template, _ = demo_cortex()
    assert_array_equal(t1.data, template.data)
    for label, side in ((labels.selected_label, "left"), (2, "right")):
        assert_array_equal(labels.data == label, voxflat.hemisphere(white_matter, side, threshold=THRESHOLD).data)
    assert list(labels.features["name"]) == ["", "left hemisphere", "right hemisphere", "cerebellum and brain stem"]
    qtbot.waitUntil(lambda: viewer.layers.selection.active is labels, timeout=PATIENCE)
    qtbot.waitUntil(lambda: all(layer.visible for layer in viewer.layers), timeout=PATIENCE)
    assert {*viewer.window._qt_viewer.controls.widgets} == {*viewer.layers}
    camera = getattr(viewer, "scene", viewer).camera
    # seen from the side, superior above, anterior right
    qtbot.waitUntil(lambda: viewer.dims.order == (0, 2, 1), timeout=PATIENCE)
    assert [str(way).rpartition(".")[2].lower() for way in camera.orientation2d] == ["up", "right"]
    assert_allclose(LayerVolume.of(t1).place.affine, white_matter.affine)
    assert_allclose(LayerVolume.of(labels).place.affine, white_matter.affine)
    assert labels.data[seed_of(seed, labels)] == labels.selected_label
    second = viewer.window.add_plugin_dock_widget("voxflat", "Flatten in patches")[1].form
    for form in (first, second):  # opened before the sample and after it
        assert (form.surface.layer, form.sampled.layer) == (labels, t1)
        qtbot.waitUntil(lambda form=form: form.label.label == 1, timeout=PATIENCE)


def test_a_window_closed_while_the_sample_is_read(make_napari_viewer, qtbot):
    from napari.utils import progress

    viewer = make_napari_viewer()
    seeds = [seed for _ in range(2) for seed in viewer.open_sample("voxflat", "demo_cortex")]
    qtbot.waitUntil(lambda: len(progress._all_instances) == 2, timeout=PATIENCE)
    assert not any(seed.visible for seed in seeds)
    viewer.close()
    wait_for_threads(qtbot)


def test_layers_and_labels_are_listed(open_widget, qtbot):
    labels = cap()
    labels[0, 0, 0] = 7
    viewer, widget = open_widget(Image(np.ones((4, 4)), name="flat picture"), Labels(labels, name="parts"))
    assert widget.form.surface.layer is viewer.layers["parts"]
    qtbot.waitUntil(lambda: widget.form.label.count() == 2, timeout=PATIENCE)
    assert [widget.form.label.itemData(n) for n in range(2)] == [3, 7]
    viewer.layers["parts"].selected_label = 7
    assert widget.form.label.label == 7
    viewer.layers["parts"].selected_label = 5  # is not there
    assert widget.form.label.label == 7
    viewer.layers["parts"].name = "regions"
    assert widget.form.surface.currentText() == "regions"
    viewer.layers["regions"].data_setitem((np.array([0]),) * 3, 9)
    qtbot.waitUntil(lambda: widget.form.label.findData(9) >= 0, timeout=PATIENCE)
    viewer.layers.remove("regions")
    assert widget.form.surface.layer is None
    assert not widget.form.label.count()


def test_the_form_follows_the_kind_of_layer(open_widget):
    points, faces, values = bumps()
    viewer, widget = open_widget(Image(np.linspace(0, 10, 125).reshape(5, 5, 5), name="T1"))
    form = widget.form
    assert form.threshold.value() == pytest.approx(5)  # between the contrast limits
    assert form.threshold.isVisibleTo(widget)
    assert not form.label.isVisibleTo(widget)
    viewer.add_surface((points, faces, values), name="mesh")
    viewer.add_surface((points, faces), name="same vertices")
    viewer.add_surface((points[:4], faces[:1] * 0 + [0, 1, 2]), name="other vertices")
    form.surface.choose(viewer.layers["mesh"])
    assert form.sampled.layer is viewer.layers["mesh"]
    assert [form.sampled.itemText(n) for n in range(form.sampled.count())] == ["nothing", "T1", "mesh", "same vertices"]
    assert not any(field.isVisibleTo(form) for field in (form.label, form.threshold, form.sample_depth))
    assert form.patch.currentData() == "whole"
    assert form.method.findData("grossmann2002") < 0  # it takes voxels
    assert form.pial.isVisibleTo(form)
    assert [form.pial.itemText(n) for n in range(1, form.pial.count())] == ["same vertices"]
    assert form.pial.layer is None
    choose(form.patch, "values")
    assert not form.seed.isVisibleTo(form)
    form.surface.choose(viewer.layers["T1"])
    assert form.sampled.layer is viewer.layers["T1"]
    assert form.patch.findData("values") < 0
    assert form.patch.currentData() == "whole"
    assert form.method.findData("grossmann2002") >= 0
    assert all(field.isVisibleTo(form) for field in (form.threshold, form.method, form.sample_depth))
    choose(form.patch, "disk")
    assert form.seed.isVisibleTo(form)
    assert not form.pial.isVisibleTo(form)


def test_result_is_that_of_the_library(open_widget, qtbot):
    labels, t1 = cap(), np.random.default_rng(0).random((24, 24, 24)).astype(np.float32)
    place = {"affine": FLIP, "units": "mm"}
    viewer, widget = open_widget(Image(t1, **place, name="T1"), Labels(labels, **place, name="sheet"))
    qtbot.waitUntil(lambda: widget.form.label.label == 3, timeout=PATIENCE)
    assert widget.form.method.currentData() == "voxflat"
    choose(widget.form.patch, "whole")
    widget.form.options.sources.setValue(200)
    widget.form.pixel_size.setValue(1.25)
    for method in ("voxflat", "grossmann2002", "zigelman2002", "schwartz1989"):
        choose(widget.form.method, method)
        run(widget, qtbot)
        expected = composed.flatten(labels, method=method, affine=FLIP, label=3, sources=200)
        picture = expected.image(t1, 1.25)
        flattened, distortion = viewer.layers["sheet T1 flattened"], viewer.layers["sheet distortion"]
        assert_array_equal(flattened.data, picture.data)
        assert_array_equal(distortion.data, expected.heat_map(1.25).data)
        for layer in (flattened, distortion):
            assert_allclose(layer.scale, 1.25)
            assert_allclose(layer.translate, (-picture.origin[1], picture.origin[0]))
            assert [str(unit) for unit in layer.units] == ["millimeter", "millimeter"]
            assert np.isfinite(layer.contrast_limits).all()
            same_map(layer, expected)
            told = layer.metadata["parameters"]
            assert told == layer.metadata["voxflat"].metadata
            assert {**told["napari"], "form": None} == {
                "form": None,
                "layer": "sheet",
                "world_axes": "RAS",
                "unit": "millimeter",
            }
            assert layer.metadata["distortion"]["raw"]["stress_1"] == expected.distortion.raw.stress_1
        assert ("torn faces" in dict(figures(expected))) == (method == "grossmann2002")
        assert ("flipped triangles" in dict(figures(expected))) == (method != "grossmann2002")
        assert "fraction" in distortion.metadata["colours"]
        assert f"{100 * expected.distortion.best_scale.relative_error:.1f} %" in widget.status.text()


def test_an_atlas_and_colours_on_the_map(open_widget, qtbot):
    atlas = np.zeros((24, 24, 24), dtype=np.int32)
    atlas[12:], atlas[:12] = 1001, 2035
    colours = np.random.default_rng(0).integers(0, 255, (24, 24, 24, 3), dtype=np.uint8)
    stain = Image(colours, rgb=True, name="stain")
    viewer, widget = open_widget(Labels(atlas, name="atlas"), stain, Labels(cap(), name="sheet"))
    run_whole(widget, qtbot)
    assert viewer.layers["sheet stain flattened"].rgb
    widget.form.sampled.choose(viewer.layers["atlas"])
    run_whole(widget, qtbot)
    layer = viewer.layers["sheet atlas flattened"]
    assert isinstance(layer, Labels)
    assert set(np.unique(layer.data)) == {0, 1001, 2035}


def test_dask_above_a_threshold(open_widget, qtbot):
    volume = cap() / 3.0
    viewer, widget = open_widget(Image(da.from_array(volume, chunks=8), name="probability", contrast_limits=(0, 1)))
    run_whole(widget, qtbot)
    flat_map = viewer.layers["probability distortion"].metadata["voxflat"]
    assert_array_equal(flat_map.uv, voxflat.surface(volume, threshold=0.5).flatten().uv)


def test_saved_map_opens_in_napari(open_widget, qtbot, tmp_path, monkeypatch):
    viewer, widget = open_widget(Labels(cap(), name="sheet"))
    run_whole(widget, qtbot)
    path = str(tmp_path / "map")
    monkeypatch.setattr("voxflat._napari.results.map_panel.QFileDialog.getSaveFileName", lambda *args: (path, ""))
    widget.results.save.click()
    viewer.window._qt_viewer._qt_open([f"{path}.voxflat"], stack=False)  # as File → Open does, without other readers
    qtbot.waitUntil(lambda: ViewerState.of(viewer).is_settled)
    opened = viewer.layers[-1]
    assert opened.name == "map distortion"
    assert_array_equal(opened.data, viewer.layers["sheet distortion"].data)
    voxflat.load(f"{path}.voxflat").save(f"{path}.npz")
    (again,) = open_file(viewer, qtbot, f"{path}.npz")
    assert_array_equal(again.data, opened.data)
