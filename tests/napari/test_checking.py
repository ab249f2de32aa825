"""*Layers → Measure*: defects of surfaces, and the quality of maps."""

import numpy as np
from napari.layers import Labels
from napari_window import FLIP, PATIENCE, bumps, cap, open_file, run_whole
from numpy.testing import assert_allclose

import voxflat
from voxflat._napari.wording import in_window
from voxflat.io import Mesh, Patch, patch_border, write_mesh, write_patch


def ring():
    """A torus: one handle, around the middle."""
    i, j, k = np.indices((17, 17, 7)) - np.array([8, 8, 3])[:, None, None, None]
    return ((np.hypot(i, j) - 5) ** 2 + k**2 < 5).astype(np.uint8)


def test_check_marks_the_handle(open_widget, qtbot):
    viewer, widget = open_widget(Labels(ring(), name="ring", affine=FLIP, units="mm"), name="Check surface")
    qtbot.waitUntil(lambda: widget.form.label.label == 1, timeout=PATIENCE)
    widget.start.click()
    qtbot.waitUntil(lambda: widget.start.text() == "Check" and bool(widget.table.toPlainText()), timeout=PATIENCE)
    found = voxflat.check(ring(), affine=FLIP, label=1)
    told = widget.table.toPlainText()
    for name, value in found.rows()[1:]:
        assert name in told
        assert value in told
    assert all(in_window(advice)[1:] in told for advice in found.advice)
    assert len(found.handles) == 1
    places = viewer.layers["defects of ring"]
    assert_allclose(places.data[0], found.handles[0]["centre"])
    assert places.features["finding"][0].startswith("handle")
    places.data = places.data + 1  # edited by the user
    edited = places.data.copy()
    widget.start.click()
    qtbot.waitUntil(lambda: "defects of ring [1]" in viewer.layers, timeout=PATIENCE)
    assert_allclose(viewer.layers["defects of ring"].data, edited)


def test_measures_of_a_run_and_of_a_patch_of_another_tool(open_widget, qtbot, tmp_path):
    viewer, widget = open_widget(Labels(cap(), name="sheet"))
    _, measured = viewer.window.add_plugin_dock_widget("voxflat", "Measure map")
    assert measured.table.toPlainText().startswith("There is no flat map")
    run_whole(widget, qtbot)
    viewer.layers.selection.clear()
    measured.start.click()
    flat_map = viewer.layers["sheet distortion"].metadata["voxflat"]
    assert measured.table.toPlainText() == f"sheet\n\n{flat_map.distortion.table()}"
    points, faces, _ = bumps()
    write_mesh(tmp_path / "lh.white", Mesh(points, faces))
    ids = np.arange(len(points))
    flat = np.column_stack([points[:, :2], np.zeros(len(points))])
    write_patch(tmp_path / "lh.all.patch.flat", Patch(ids, flat, patch_border(faces, ids, len(points))))
    (layer,) = open_file(viewer, qtbot, tmp_path / "lh.all.patch.flat")
    viewer.layers.selection = {layer}
    measured.start.click()
    qtbot.waitUntil(lambda: measured.start.text() == "Measure", timeout=PATIENCE)
    expected = voxflat.measure(tmp_path / "lh.white", tmp_path / "lh.all.patch.flat")
    assert measured.table.toPlainText() == expected.table()
