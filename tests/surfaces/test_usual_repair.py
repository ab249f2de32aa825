"""The default repair of a mask removes handles that noise causes, and changes nothing else."""

import composed
import numpy as np
import pytest
import shapes
from refusals import refused
from scipy.ndimage import gaussian_filter

import voxflat
from voxflat.io.volumes import write_volume


def with_handles():
    """Return a ball with three thin bridges across a groove of four voxels."""
    groove = shapes.ball(12).astype(np.uint8)
    middle = len(groove) // 2
    groove[middle - 2 : middle + 2, :, middle + 3 :] = 0
    groove[middle - 2 : middle + 2, [middle - 5, middle, middle + 5], middle + 6] = 1
    return groove


def handles(surface):
    return surface.core.topology()["handles"]


@pytest.mark.parametrize("label", [None, 2])
def test_handles_of_a_mask_are_repaired_and_it_is_said(label):
    volume = with_handles()
    image = volume * np.uint8(label or 1)
    image[:2, :2, :2] = 41 if label else 0  # another structure
    made = voxflat.surface(image, label=label)
    assert handles(voxflat.surface(image, label=label, repair="none")) == 3
    assert handles(made) == 0
    assert made.metadata["repair"]["handles"] == 3
    assert any("repaired 3 handle(s)" in warning and "repair='none'" in warning for warning in made.warnings)
    changed = made.changed_voxels()
    assert 0 < np.count_nonzero(changed) <= 0.01 * volume.sum()
    assert volume[changed == 1].all()
    assert not volume[changed == 2].any()


def test_what_has_no_handles_is_left_as_it_is():
    volume = shapes.ball(9)
    volume[0, 0, :2] = 1  # a speck
    volume[9, 9, 9] = 0  # a cavity
    usual, none = (voxflat.surface(volume, repair=repair) for repair in (None, "none"))
    np.testing.assert_array_equal(usual.points, none.points)
    np.testing.assert_array_equal(usual.faces, none.faces)
    assert "repair" not in usual.metadata


def test_only_handles_change():
    volume = np.pad(with_handles(), ((0, 6), (0, 0), (0, 0)))
    volume[-3:-1, 3:5, 3:5] = 1  # another piece, which the repair of all would drop
    made = voxflat.surface(volume)
    assert (np.asarray(made.ids)[:, 0] >= volume.shape[0] - 3).any()
    assert made.metadata["repair"]["dropped"] == []


@pytest.mark.medium
@pytest.mark.parametrize("seed", range(6))
def test_no_handle_is_left_whatever_else_stays(seed):
    """Cavities and specks stay, and none of them becomes a handle by the repair next to it."""
    rng = np.random.default_rng(seed)
    distance = np.linalg.norm(np.indices((34, 34, 34)) - 17, axis=0)
    noise = gaussian_filter(rng.normal(size=(34, 34, 34)), 0.7)
    ball = distance + 18 * gaussian_filter(rng.normal(size=(34, 34, 34)), 1.2) < 13
    volume = (ball & (noise > np.quantile(noise, 0.03))) | (noise > np.quantile(noise, 0.9995))
    made, none = (shapes.two_sided(volume, repair=repair) for repair in (None, "none"))
    assert handles(made._with_core(made.core.largest_piece())) == 0
    assert handles(none) - handles(made) >= made.metadata["repair"]["handles"] > 0
    assert len(made.core.topology()["components"]) > 1


def test_what_is_a_ring_stays_one_and_it_is_said():
    i, j, k = np.indices((33, 33, 13)) - np.array([16, 16, 6])[:, None, None, None]
    ring = (np.hypot(np.hypot(i, j) - 10, k) < 4.5).astype(np.uint8)
    made = voxflat.surface(ring)
    assert handles(made) == 1
    assert any("Use repair='voxels' to remove" in warning for warning in made.warnings)
    assert handles(voxflat.surface(ring, repair="voxels")) == 0


def test_a_sheet_is_not_repaired():
    sheet = np.zeros((20, 20, 5), np.uint8)
    sheet[2:18, 2:18, 2] = 1
    sheet[8:12, 8:12, 2] = 0  # a hole, not a handle
    made = voxflat.surface(sheet)
    assert made.metadata["sheet"]
    assert "repair" not in made.metadata


@pytest.mark.slow
@pytest.mark.parametrize("name", ["label.nii.gz", "probability.nii.gz", "wm.mgz"])
def test_masks_as_labs_have_them_lose_their_handles(tmp_path, name):
    volume = with_handles()
    image, options = {
        "label.nii.gz": (volume * np.uint8(7), {}),
        "probability.nii.gz": (gaussian_filter(np.pad(volume, 2).astype(np.float32), 0.4), {"threshold": 0.5}),
        "wm.mgz": (volume * np.uint8(110), {"threshold": 100}),
    }[name]
    write_volume(tmp_path / name, image, np.diag([-1.0, 1, 1, 1]))
    usual, none = (voxflat.surface(tmp_path / name, **options, repair=repair) for repair in (None, "none"))
    assert handles(none) > 0
    assert handles(usual) == 0


@pytest.mark.slow
def test_the_map_is_the_best_of_any_repair():
    volume = with_handles()
    of = {"sources": 60, "relax": False}
    flat, cut = (composed.flatten(voxflat.surface(volume, repair=way), **of) for way in (None, "cuts"))
    assert flat.distortion.raw.relative_error <= 1.1 * cut.distortion.raw.relative_error


@pytest.mark.parametrize("labels", [(2, 3, 41, 42), (2, 41)])
def test_white_matter_of_freesurfer_is_named_where_a_label_is_wanted(labels):
    volume = np.zeros((8, 8, 8), np.int32)
    for number, label in enumerate(labels):
        volume[2 * number : 2 * number + 2] = label
    refused(r"label=2 is the left and label=41 the right", voxflat.flatten, volume)
