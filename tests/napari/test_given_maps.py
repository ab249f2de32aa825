"""A flat map of another tool and its surface, opened in any order, are a flat map in napari."""

import html
import threading

import nibabel as nib
import numpy as np
import pytest
from napari.layers import Surface
from napari_window import bumps, map_dock, open_file, run, wait_for_threads
from numpy.testing import assert_allclose, assert_array_equal

import voxflat
from voxflat._napari.files import given_maps
from voxflat._napari.map_viewer.viewer_parts import camera
from voxflat._napari.scripts import OpenedFile
from voxflat._napari.viewer_state import ViewerState
from voxflat.io import Mesh, write_mesh

POINTS, FACES, _ = bumps(15)
FLAT = np.column_stack([1.1 * POINTS[:, 0] + 0.1 * POINTS[:, 1], POINTS[:, 1], 0 * POINTS[:, 0]]).astype(np.float32)


@pytest.fixture
def files(tmp_path):
    write_mesh(tmp_path / "lh.mid.surf.gii", Mesh(POINTS, FACES, structure="CortexLeft"))
    write_mesh(tmp_path / "lh.flat.surf.gii", Mesh(FLAT, FACES, structure="CortexLeft"))
    return tmp_path / "lh.mid.surf.gii", tmp_path / "lh.flat.surf.gii"


def maps(layers):
    return {id(found): found for layer in layers if (found := layer.metadata.get("voxflat")) is not None}


@pytest.mark.slow
@pytest.mark.parametrize("order", [(0, 1), (1, 0)], ids=["surface first", "map first"])
def test_both_files_are_a_map_in_any_order(make_napari_viewer, qtbot, messages, files, order):
    viewer = make_napari_viewer(show=True)
    for number in order:
        open_file(viewer, qtbot, files[number])
    (flat_map,) = maps(viewer.layers).values()
    assert "lh.flat.surf.gii is opened as a flat map of lh.mid.surf.gii" in [one.message for one in messages]
    assert_array_equal(flat_map.uv, FLAT[flat_map.ids, :2])
    assert_allclose(flat_map.points, POINTS[flat_map.ids], atol=1e-5)
    dock = map_dock(viewer, qtbot)
    spot = dock.prepared.spot(*flat_map.uv[100])
    assert_allclose(spot.point, POINTS[flat_map.ids[100]], atol=1e-4)
    open_file(viewer, qtbot, files[0])  # the surface once more
    assert len(maps(viewer.layers)) == 1
    code = OpenedFile(str(files[1]), flat_map).script()
    names = {}
    exec(code, names)
    assert_array_equal(names["flat_map"].uv, flat_map.uv)
    wait_for_threads(qtbot)


@pytest.mark.slow
def test_wrong_partners_are_told_in_one_line(make_napari_viewer, qtbot, messages, files, tmp_path):
    viewer = make_napari_viewer()
    points, faces, _ = bumps(16)
    write_mesh(tmp_path / "other.surf.gii", Mesh(points, faces))
    open_file(viewer, qtbot, tmp_path / "other.surf.gii")
    open_file(viewer, qtbot, files[1])
    text = "also open its surface with 225 vertices, which no open surface has"
    assert [one.message.partition("volumes, ")[2] for one in messages] == [text]
    order = np.random.default_rng(0).permutation(len(POINTS))
    write_mesh(tmp_path / "lh.renumbered.surf.gii", Mesh(POINTS, order[FACES]))
    messages.clear()
    assert len(open_file(viewer, qtbot, tmp_path / "lh.renumbered.surf.gii")) == 1
    (message,) = messages
    assert "triangles are triangles of the surface" in message.message
    assert "\n" not in message.message
    assert not maps(viewer.layers)


@pytest.mark.slow
def test_a_saved_map_without_its_surface_needs_it(make_napari_viewer, qtbot, messages, tmp_path):
    voxflat.load((FLAT, FACES)).save(tmp_path / "map.voxflat")
    assert open_file(make_napari_viewer(), qtbot, tmp_path / "map.voxflat") == []
    (message,) = messages
    assert message.message.endswith("Open the file of the flat map, and that of its surface")


def test_scripts_of_changed_layers_are_refused(files):
    flat_map = voxflat.load(files[1], surface=(POINTS, FACES))
    with pytest.raises(voxflat.InputError, match="Save the map, and open that file"):
        OpenedFile(str(files[1]), flat_map).script()


def test_a_map_is_loaded_in_another_thread_and_can_be_cancelled(
    make_napari_viewer, qtbot, messages, files, monkeypatch
):
    threads, state = [], None

    def load(flat, surface, *, progress):
        threads.append(threading.current_thread())
        next(iter(state.loading)).quit()  # as a click on Cancel in the activity dock
        return voxflat.load(flat, surface, progress=progress)

    monkeypatch.setattr(given_maps, "load", load)
    viewer = make_napari_viewer()
    state = ViewerState.of(viewer)
    open_file(viewer, qtbot, files[0])
    (layer,) = open_file(viewer, qtbot, files[1])
    assert threads
    assert threading.main_thread() not in threads
    assert not maps(viewer.layers)
    assert [one.message for one in messages] == []
    assert layer in viewer.layers
    wait_for_threads(qtbot)


def test_a_flat_map_alone_shows_values_and_is_seen_from_above(make_napari_viewer, qtbot, messages, files, tmp_path):
    viewer = make_napari_viewer()
    (layer,) = open_file(viewer, qtbot, files[1])
    (message,) = messages
    assert "It shows values and labels of its vertices. To measure distances and to sample volumes, also open its" in (
        message.message
    )
    assert viewer.dims.ndisplay == 3
    qtbot.waitUntil(lambda: np.allclose(camera(viewer).view_direction, (0, 0, -1), atol=1e-6))
    assert_allclose(camera(viewer).up_direction, (0, 1, 0), atol=1e-6)
    values = np.arange(len(FLAT), dtype=np.float32)
    stub = nib.gifti.GiftiLabelTable()
    stub.labels.append(nib.gifti.GiftiLabel(0, 1, 1, 1, 0))
    stub.labels[0].label = "???"  # as Workbench and SUIT write it to files of values
    image = nib.GiftiImage(darrays=[nib.gifti.GiftiDataArray(values, "NIFTI_INTENT_SHAPE")], labeltable=stub)
    nib.save(image, tmp_path / "lh.depth.shape.gii")
    (shown,) = open_file(viewer, qtbot, tmp_path / "lh.depth.shape.gii")
    assert_array_equal(shown.vertices, layer.vertices)
    assert_array_equal(shown.vertex_values, values)
    assert shown.vertex_colors is None


@pytest.mark.parametrize("has_values", [False, True])
def test_a_flat_layer_is_chosen_in_the_form(open_widget, qtbot, has_values):
    """Layers of another reader, which have no file."""
    values = (np.linspace(1, 2, len(POINTS)),) if has_values else ()
    surface = Surface((POINTS, FACES, *values), name="mid", units="mm")
    flat = Surface((FLAT, FACES), name="other tool", units="mm")
    viewer, widget = open_widget(surface, flat)
    form = widget.form
    form.surface.choose(surface)
    assert form.flat.layer is None
    assert (widget.start.text(), form.patch.isHidden(), form.flat.isHidden()) == ("Flatten surface", False, False)
    form.flat.choose(flat)
    assert (widget.start.text(), form.patch.isHidden(), form.method.isHidden()) == ("Show flat map", True, True)
    assert html.unescape(form.plan.text()) == "Shows the flat map 'other tool' of this surface. No point is moved."
    run(widget, qtbot)
    (flat_map,) = maps(viewer.layers).values()
    assert flat_map.method == "given"
    assert_array_equal(flat_map.uv, FLAT[flat_map.ids, :2].astype(np.float64))
    assert_allclose(flat_map.points, POINTS[flat_map.ids])
    assert any("flattened" in layer.name for layer in viewer.layers) is has_values
    script = ViewerState.of(viewer).current.script
    assert script.needs_folder()
    assert "flat_map = voxflat.load(flat, surface=surface)" in script.script()
    form.flat.choose(None)
    assert (widget.start.text(), form.patch.isHidden()) == ("Flatten surface", False)


def test_only_flat_layers_of_the_surface_are_offered(open_widget):
    surface = Surface((POINTS, FACES), name="mid")
    points, faces, _ = bumps(16)
    other = Surface((np.column_stack([points[:, :2], 0 * points[:, 0]]), faces), name="another mesh")
    _, widget = open_widget(surface, Surface((POINTS + 1, FACES), name="curved"), other)
    widget.form.surface.choose(surface)
    assert widget.form.flat.count() == 1
    assert widget.form.flat.isHidden()
