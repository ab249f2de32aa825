"""*Copy as Python* gives a script that computes the same map, bit by bit, without a window."""

import subprocess
import sys
from functools import partial

import nibabel as nib
import numpy as np
import tifffile
from napari.layers import Image, Labels, Layer, Surface
from napari.layers._source import layer_source
from napari_window import FLIP, bumps, cap, open_file, run_whole
from numpy.testing import assert_array_equal
from qtpy.QtWidgets import QApplication

import voxflat
from voxflat._napari.files.volumes import volume_layers
from voxflat._napari.job import Job, PatchesJob
from voxflat._napari.layers.meshes import LayerMesh
from voxflat._napari.layers.sampled import overlay, shown
from voxflat._napari.layers.volumes import LayerVolume
from voxflat._napari.scripts import OpenedFile, Recipe
from voxflat._napari.viewer_state import ViewerState
from voxflat.io import Mesh, Space, VolumeGeometry, write_mesh, write_volume


def from_file(make, path):
    """A layer as a reader of napari would add it."""
    with layer_source(path=str(path)):
        return make()


def jobs(folder):
    """Jobs of all kinds, by the name of the flattened layer."""
    points, faces, values = bumps()
    write_volume(folder / "t1.npz", np.random.default_rng(0).random((24, 24, 24)), FLIP)
    t1 = voxflat.io.read_volume(folder / "t1.npz")
    t1 = from_file(lambda: Image(t1.data, affine=t1.affine, units="mm", name="T1"), folder / "t1.npz")
    sheet = Labels(cap(), affine=FLIP, units="mm", name="my sheet")
    yield Job(LayerVolume.of(sheet), label=3, options={"sources": 200}, shown=shown(t1, "RAS", 0.5), pixel_size=1.25)
    chance = Image(cap() / 3.0, units="mm", name="chance")
    yield Job(LayerVolume.of(chance), method="grossmann2002", threshold=0.5, seed_point=(12, 12, 18), radius=6.0)
    space = Space("tkRAS", VolumeGeometry.conformed((3.0, -20.0, 15.0)))
    write_mesh(folder / "lh.white", Mesh(points, faces, space=space))
    mesh = voxflat.io.read_mesh(folder / "lh.white")
    placed = mesh.space.to_scanner(mesh.points)
    white = from_file(lambda: Surface((placed, mesh.faces, values), name="lh.white", units="mm"), folder / "lh.white")
    taken = LayerMesh.of(white)
    assert not Recipe(Job(taken)).needs_folder()  # all of it lies in a file
    yield Job(taken, keep=taken.kept(), shown=overlay(white, taken), values=overlay(white, taken))
    corners = points[[100, 112, 400, 412]]
    yield Job(LayerMesh.of(Surface((points, faces), name="bumps", units="mm")), polygon=corners[[0, 1, 3, 2]])
    yield Job(LayerVolume.of(Labels(voxflat.samples.rim().data, name="rim", units="mm")), rim="rim")
    yield PatchesJob(LayerMesh.of(Surface((points, faces), name="parts", units="mm")), {"max_angle": 10.0}, glue=1.4)


def test_the_same_bits(tmp_path):
    scripts, expected = [], {}
    for job in jobs(tmp_path):
        recipe = Recipe(job)
        result = recipe.run(lambda *_: True)
        assert recipe.needs_folder()
        script = recipe.script(tmp_path)
        assert "napari" not in script.split('"""')[2]
        scripts.append(script)
        expected[job.surface.origin["layer"].replace(" ", "_")] = result.flat_map
    assert f"read_volume({str(tmp_path / 't1.npz')!r})" in scripts[0]
    assert f"read_mesh({str(tmp_path / 'lh.white')!r})" in scripts[2]
    whole = "\n\n".join(scripts)  # in one process: starting one takes longer than all of them
    (tmp_path / "again.py").write_text(whole)
    subprocess.run([sys.executable, "again.py"], cwd=tmp_path, check=True)
    for name, flat_map in expected.items():
        again = (voxflat.load_atlas if name == "parts" else voxflat.load)(tmp_path / f"{name}.voxflat")
        assert_array_equal(again.uv, flat_map.uv)
        for known in ("space", "structure"):
            assert again.metadata.get(known) == flat_map.metadata.get(known)
    assert (tmp_path / "T1_flattened.png").is_file()


def test_values_of_a_file_are_read_from_it(tmp_path, monkeypatch):
    points, faces, values = bumps()
    values = values.astype(np.float32)
    write_mesh(tmp_path / "lh.white", Mesh(points, faces, space=Space("scanner")))
    nib.freesurfer.write_morph_data(tmp_path / "lh.thickness", values)
    placed = voxflat.io.read_mesh(tmp_path / "lh.white").points
    white = from_file(lambda: Surface((placed, faces), name="lh.white", units="mm"), tmp_path / "lh.white")
    data = (placed, faces, values.astype(np.float64))
    thick = from_file(lambda: Surface(data, name="lh.thickness", units="mm"), tmp_path / "lh.thickness")
    for known in (True, False):
        recipe = Recipe(Job(LayerMesh.of(white), shown=shown(thick, "RAS")))
        result = recipe.run(lambda *_: True)
        assert recipe.needs_folder() is not known
        script = recipe.script(tmp_path)
        assert ("read_overlay" in script) is known
        monkeypatch.chdir(tmp_path)
        found = {}
        exec(script, found)
        assert_array_equal(found["image"].data, result.flat_map.image(thick.vertex_values).data)
        thick.vertex_values = 2 * thick.vertex_values  # which no file holds


def test_voxels_of_a_file_are_read_from_it_in_the_order_of_the_layer(tmp_path, monkeypatch):
    """Readers of napari turn the axes of files, TIFF files have no affine, and users set the spacing of layers."""
    monkeypatch.chdir(tmp_path)
    sheet = cap()[:, :23, :22]
    tifffile.imwrite("stack.tif", sheet)
    write_volume("mirrored.nii.gz", sheet.transpose(2, 0, 1), FLIP[:, [2, 0, 1, 3]])
    turned, affine = (data for data, _, _ in volume_layers(tmp_path / "mirrored.nii.gz")), FLIP
    layers = {
        "stack.tif": (Labels(sheet, scale=(0.3, 0.2, 0.2), units="µm", name="stack"), "SAR"),
        "mirrored.nii.gz": (Labels(*turned, affine=affine, units="mm", name="turned"), "RAS"),
    }
    for name, (layer, world) in layers.items():
        layer = from_file(partial(Layer.create, *layer.as_layer_data_tuple()), tmp_path / name)
        recipe = Recipe(Job(LayerVolume.of(layer, world), label=3))
        result = recipe.run(lambda *_: True)
        assert not recipe.needs_folder()
        found = {}
        exec(recipe.script(), found)
        assert_array_equal(found["flat_map"].uv, result.flat_map.uv)
        assert {path.name for path in tmp_path.iterdir()} == {*layers, f"{layer.name}.voxflat"}
        (tmp_path / f"{layer.name}.voxflat").unlink()
        layer.data[0, 0, 0] = 9  # which the file does not contain
        assert Recipe(Job(LayerVolume.of(layer, world), label=3)).needs_folder()


def test_a_click_copies_the_script(open_widget, qtbot, messages, monkeypatch, tmp_path):
    viewer, widget = open_widget(Labels(cap(), name="sheet"))
    run_whole(widget, qtbot)
    monkeypatch.setattr("qtpy.QtWidgets.QFileDialog.getExistingDirectory", lambda *_: str(tmp_path))
    assert widget.results.copy.isVisibleTo(widget)
    widget.results.copy.click()
    script = QApplication.clipboard().text()
    compile(script, "script", "exec")
    assert "voxflat.surface(volume, label=3" in script
    (saved,) = tmp_path.iterdir()
    assert_array_equal(np.load(saved)["data"], cap())
    viewer.layers["sheet"].data_setitem((np.array([0]),) * 3, 9)
    messages.clear()
    widget.results.copy.click()
    assert "were changed after" in messages[-1].message
    viewer.layers["sheet distortion"].metadata["voxflat"].save(tmp_path / "map.voxflat")
    open_file(viewer, qtbot, tmp_path / "map.voxflat")
    widget.results.copy.click()
    assert f"voxflat.load({str(tmp_path / 'map.voxflat')!r})" in QApplication.clipboard().text()


def test_copied_scripts_run_as_they_are_and_give_the_map_of_the_window(make_napari_viewer, qtbot, messages, tmp_path):
    points, faces, _ = bumps()
    write_mesh(tmp_path / "lh.white", Mesh(points, faces, space=Space("scanner")))
    viewer = make_napari_viewer()
    open_file(viewer, qtbot, tmp_path / "lh.white")
    _, widget = viewer.window.add_plugin_dock_widget("voxflat", "Flatten surface")
    run_whole(widget, qtbot)

    def copied():
        QApplication.clipboard().clear()
        widget.results.copy.click()
        script = QApplication.clipboard().text()
        script += f"\nflat_map.save({str(tmp_path / 'again.voxflat')!r}, overwrite=True)"
        subprocess.run([sys.executable, "-c", script], cwd=tmp_path, check=True)
        return voxflat.load(tmp_path / "again.voxflat").uv

    flat_map = ViewerState.of(viewer).current.flat_map
    assert_array_equal(copied(), flat_map.uv)
    saved = tmp_path / "saved.voxflat"
    flat_map.save(saved)
    open_file(viewer, qtbot, saved)
    assert ViewerState.of(viewer).current.flat_map is not flat_map
    assert widget.results.copy.isVisibleTo(widget)
    assert_array_equal(copied(), flat_map.uv)
    voxflat.surface((2 * points, faces)).flatten().save(saved, overwrite=True)
    widget.results.copy.click()
    assert "saved.voxflat: contains another map than the opened one" in messages[-1].message


def test_an_opened_atlas_is_loaded_by_its_script(tmp_path):
    points, faces, _ = bumps()
    path = tmp_path / "atlas.voxflat"
    voxflat.surface((points, faces)).patches(max_angle=10.0).save(path)
    atlas, found = voxflat.load_atlas(path), {}
    exec(OpenedFile(str(path), atlas).script(), found)
    assert_array_equal(found["atlas"].uv, atlas.uv)
