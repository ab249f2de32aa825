"""A flat map of another tool and its surface, opened in any order, are a flat map in napari."""

import numpy as np
import pytest
from napari_window import bumps, map_dock, open_file, wait_for_threads
from numpy.testing import assert_allclose, assert_array_equal

import voxflat
from voxflat._napari.scripts import OpenedFile
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
    text = "To see it as a flat map, also open its surface with 225 vertices, which no open surface has"
    assert [one.message for one in messages] == [f"lh.flat.surf.gii is flat. {text}"]
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
