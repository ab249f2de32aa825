"""A hemisphere is extracted from a whole brain in any position and orientation."""

import json
import pickle
import re

import nibabel as nib
import numpy as np
import pytest
from command_line import run, succeed
from PIL import Image
from refusals import refused
from scipy import ndimage
from scipy.spatial.transform import Rotation

import voxflat
from voxflat.demo import demo_cortex
from voxflat.io import Volume
from voxflat.surfaces import hemispheres

SIDES = ("left", "right")


@pytest.fixture(scope="module")
def brain():
    """Return the probability of white matter in MNI152, from 0 to 1."""
    return demo_cortex()[0]


def parted(white, affine):
    """Label the voxels of MNI152's white matter by their coordinates: 1 left, 2 right, 3 neither."""
    x, y, z = (affine[axis, 3] + affine[axis, axis] * np.arange(length) for axis, length in enumerate(white.shape))
    labels = np.where(white, 3, 0).astype(np.uint8)
    for label, beyond in enumerate((x >= 0, x <= 0), 1):
        side = white.copy()
        side[beyond] = False
        side[np.ix_(np.abs(x) <= 20, (y > -45) & (y < 0), z == -14)] = False
        components, _ = ndimage.label(side)
        labels[components == np.bincount(components.ravel())[1:].argmax() + 1] = label
    return labels


def moved(data, affine, transform, spacing, shape, order):
    """Return a volume transformed in world coordinates and resampled to another grid."""
    grid = np.diag([spacing] * 3 + [1.0])
    grid[:3, 3] = -np.array(shape) * spacing / 2 + [0, -20, 10]
    back = np.linalg.inv(affine) @ np.linalg.inv(transform) @ grid
    return ndimage.affine_transform(data, back[:3, :3], back[:3, 3], output_shape=shape, order=order), grid


def turned(axis, degrees, scale=1.0):
    transform = np.eye(4)
    transform[:3, :3] = scale * Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    transform[:3, 3] = 5, -8, 12
    return transform


CASES = {
    "coarse": (np.eye(4), 1.5, (150, 170, 150)),
    "nods": (turned("x", 20), 1.0, (210, 250, 230)),
    "tilts": (turned("y", -20), 1.0, (210, 250, 230)),
    "turns": (turned("z", 20), 1.0, (210, 250, 230)),
    "small and fine": (turned("z", 5, 0.85), 0.7, (280, 320, 280)),
    "cropped": (np.eye(4), 1.0, (200, 190, 160)),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_each_side_is_found_wherever_the_brain_lies(brain, case):
    truth = parted(brain.data > 0.5, brain.affine)
    data, grid = moved(brain.data, brain.affine, *CASES[case], order=1)
    labels, _ = moved(truth, brain.affine, *CASES[case], order=0)
    white = data > 0.5
    volume = Volume(np.where(data > 0, data, 0).astype(np.float32), grid)
    for number, side in enumerate(SIDES, 1):
        found = voxflat.hemisphere(volume, side, threshold=0.5).data > 0
        wanted = labels == number
        dice = 2 * (found & white & wanted).sum() / ((found & white).sum() + (wanted & white).sum())
        assert dice > 0.97
        assert (found & white & (labels == 3 - number)).sum() <= 0.01 * wanted.sum()
        assert 0.05 < (found & ~white).sum() / wanted.sum() < 0.2  # ventricles and deep nuclei


@pytest.mark.slow
def test_axes_may_run_either_way(brain):
    half = voxflat.hemisphere(brain, "left", threshold=0.5)
    flip = np.diag([-1.0, 1, -1, 1])
    flip[0, 3], flip[2, 3] = brain.data.shape[0] - 1, brain.data.shape[2] - 1
    flipped = Volume(np.ascontiguousarray(brain.data[::-1, :, ::-1]), brain.affine @ flip)
    other = voxflat.hemisphere(flipped, "left", threshold=0.5).data[::-1, :, ::-1]
    assert (other != half.data).mean() < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("side", SIDES)
def test_a_hemisphere_becomes_a_sphere_and_a_standard_map(brain, side):
    whole = voxflat.surface(voxflat.hemisphere(brain, side, threshold=0.5), repair="voxels")
    topology = whole.core.topology()
    assert (topology["handles"], topology["loops"], len(topology["components"])) == (0, [], 1)
    opened = whole.cut("standard")
    assert 4000 < len(opened.left_out) < 9000  # the medial wall
    flat_map = opened.flatten()
    assert flat_map.distortion.raw.relative_error < 0.12
    record = flat_map.provenance["parameters"]["of"]["parameters"]["of"]["parameters"]["source"]
    assert (record["function"], record["parameters"]["side"]) == ("hemisphere", side)
    text = voxflat.cite(flat_map).text
    assert "located by registering the pattern of its folds to fsaverage." in text
    assert "sphere" not in text


@pytest.mark.slow
def test_the_command_takes_a_file_as_it_is(brain, tmp_path):
    data, grid = moved(brain.data, brain.affine, np.eye(4), 1.5, (150, 170, 150), 1)
    nib.save(nib.Nifti1Image((255 * np.clip(data, 0, 1)).astype(np.uint8), grid), tmp_path / "wm.nii.gz")
    command = ["flatten", tmp_path / "wm.nii.gz", "--hemisphere", "left", "-o", tmp_path / "lh.npz"]
    succeed(*command)
    flat_map = voxflat.load(tmp_path / "lh.npz")
    assert flat_map.metadata["cut_names"][0] == "calcarine"
    assert flat_map.distortion.raw.relative_error < 0.12
    assert "wm.nii.gz" in str(flat_map.provenance)
    threshold = re.search(r"'side': 'left', 'threshold': ([\d.]+)", str(flat_map.provenance))[1]
    assert 64 < float(threshold) < 192  # Otsu's, of values up to 255
    assert "--label and --hemisphere cannot be combined" in run(*command, "--label", 1).output


@pytest.mark.slow
def test_labels_of_freesurfer_and_synthseg_say_it(brain):
    labels = parted(brain.data > 0.5, brain.affine)
    segmentation = np.choose(labels, [0, 2, 41, 16]).astype(np.int16)
    segmentation[80:90, 110:120, 85:90][segmentation[80:90, 110:120, 85:90] == 0] = 4  # lateral ventricle
    both = np.zeros(labels.shape, dtype=bool)
    both[92:104, 120:124, 85:90] = True
    segmentation[both & (segmentation > 0)] = 251  # corpus callosum, of both sides
    left, right = (voxflat.hemisphere(Volume(segmentation, brain.affine), side).data > 0 for side in SIDES)
    assert (left & (segmentation == 2)).sum() > 0.99 * (segmentation == 2).sum()
    assert (left[segmentation == 4]).all()
    assert not (left & np.isin(segmentation, (16, 41))).any()
    assert not (left & right).any()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("given", "said"),
    [
        (np.linalg.norm(np.indices((60, 60, 60)) - 30, axis=0) < 25, "does not match the white matter of a whole"),
        (np.zeros((9, 9, 9), np.uint8), "no voxel is above the threshold"),
        (np.zeros((9, 9, 9, 3), np.uint8), "a 3-D volume"),
    ],
)
def test_what_is_no_brain_is_refused(given, said):
    refused(said, voxflat.hemisphere, Volume(given, np.diag([2.0, 2, 2, 1])), "left")


@pytest.mark.slow
def test_the_command_maps_both_sides(brain, tmp_path):
    data, grid = moved(brain.data, brain.affine, np.eye(4), 2.0, (110, 130, 110), 1)
    nib.save(nib.Nifti1Image(data.astype(np.float32), grid), tmp_path / "wm.nii.gz")
    arguments = ["flatten", str(tmp_path / "wm.nii.gz"), "--hemisphere", "both", "--sidecar", "--json"]
    done = succeed(*arguments, "-o", tmp_path / "map.npz")
    names = ["lh.map.npz", "rh.map.npz"]
    assert {path.name for path in tmp_path.iterdir()} == {*names, *(f"{name}.json" for name in names), "wm.nii.gz"}
    left, right = (voxflat.load(tmp_path / name).points[:, 0].mean() for name in names)
    assert left < -20 < 20 < right
    assert [json.loads(line)["output"] for line in done.stdout.splitlines()] == [str(tmp_path / n) for n in names]
    warnings = [line for line in done.stderr.splitlines() if "repaired " in line and "handle(s)" in line]
    assert len(warnings) == 2  # one a side


@pytest.mark.slow
def test_what_failed_is_shown(tmp_path):
    ball = np.linalg.norm(np.indices((60, 60, 60)) - 30, axis=0) < 25
    nib.save(nib.Nifti1Image(ball.astype(np.uint8), np.diag([2.0, 2, 2, 1])), tmp_path / "ball.nii.gz")
    arguments = ("flatten", tmp_path / "ball.nii.gz", "--hemisphere", "left", "-o", tmp_path / "lh.npz")
    done = run(*arguments)
    assert done.exit_code == 1
    assert f"{tmp_path / 'lh.npz.failed.png'} shows" in done.output
    with Image.open(tmp_path / "lh.npz.failed.png") as picture:
        assert np.asarray(picture.convert("L")).std() > 50
    assert not (tmp_path / "lh.npz").exists()
    assert "lh.npz.failed.png shows" in run(*arguments).output  # our own picture is replaced
    (tmp_path / "lh.npz.failed.png").write_text("of someone else")
    assert "does not match" in run(*arguments).output
    assert (tmp_path / "lh.npz.failed.png").read_text() == "of someone else"
    with pytest.raises(voxflat.HemisphereError) as failed:
        voxflat.hemisphere(tmp_path / "ball.nii.gz", "left")
    again = pickle.loads(pickle.dumps(failed.value))
    assert str(again) == str(failed.value)
    assert (again.white == ball).all()
    assert again.template.any()


@pytest.mark.slow
def test_both_sides_share_one_alignment(brain):
    coarse = Volume(np.ascontiguousarray(brain.data[::2, ::2, ::2]), brain.affine @ np.diag([2.0, 2, 2, 1]))
    stages = set()
    for side in SIDES:
        voxflat.hemisphere(coarse, side, threshold=0.5, progress=lambda stage, *_: stages.add(stage))
    assert "aligning the brain, left" in stages
    assert "aligning the brain, right" not in stages


@pytest.mark.slow
def test_it_can_be_stopped(brain):
    coarse = Volume(np.ascontiguousarray(brain.data[::3, ::3, ::3] > 0.5), brain.affine @ np.diag([3.0, 3, 3, 1]))
    for number in (1, 3):
        left = iter([True] * (number - 1) + [False])  # a further report raises StopIteration
        with pytest.raises(voxflat.Cancelled, match="cancelled while aligning the brain"):
            voxflat.hemisphere(coarse, "left", progress=lambda *_, left=left: next(left))
        assert list(left) == []
    stages = set()
    voxflat.hemisphere(coarse, "left", progress=lambda stage, *_: stages.add(stage))
    assert stages == {"aligning the brain, left", "extracting the hemisphere, left"}


@pytest.mark.slow
def test_one_hemisphere_alone_is_not_split(brain):
    half = voxflat.hemisphere(brain, "left", threshold=0.5)
    refused(r"does not match|contains no white matter of the right", voxflat.hemisphere, half, "right")


def test_otsus_threshold_has_the_least_variance_within_both_classes():
    rng = np.random.default_rng(2)
    values = np.clip(np.concatenate([rng.normal(60, 25, 3000), rng.normal(150, 30, 1000)]).round(), 0, 255)
    values[:2] = 0, 255  # a bin for each whole number
    within = [len(part) * part.var() for at in range(1, 255) for part in (values[values <= at], values[values > at])]
    best = 1 + np.add(within[::2], within[1::2]).argmin()
    assert best < hemispheres._otsu(values) < best + 1


def test_coarse_voxels_have_the_mean_and_the_centre_of_their_voxels():
    white = np.random.default_rng(0).random((7, 12, 5)) < 0.4
    affine = np.array([[0, -0.5, 0, 9.0], [0.7, 0, 0, -3], [0, 0.1, 2.0, 5], [0, 0, 0, 1]])
    shares, coarse = hemispheres._coarse(white, affine)
    steps = 3, 4, 1  # of 2 mm
    padded = np.zeros((9, 12, 5))
    padded[:7] = white
    assert shares.shape == (3, 3, 5)
    for at in np.ndindex(shares.shape):
        block = np.array([np.add(np.multiply(at, steps), more) for more in np.ndindex(steps)])
        assert shares[at] == pytest.approx(padded[tuple(block.T)].mean(), abs=1e-6)
        np.testing.assert_allclose(coarse @ [*at, 1], affine @ [*block.mean(axis=0), 1], atol=1e-12)


def test_the_slope_of_the_alignment_is_that_of_the_image_per_mm():
    grid = np.array([[0, -1.5, 0, 9.0], [2.0, 0, 0, -3], [0, 0.2, 2.5, 5], [0, 0, 0, 1]])
    index = np.indices((9, 9, 9)).reshape(3, -1)
    slope = [0.02, -0.03, 0.01]
    values = (slope @ (grid[:3, :3] @ index + grid[:3, 3:])).reshape(9, 9, 9)
    points = (grid[:3, :3] @ [[3, 5.5, 4], [4, 3.2, 2], [5, 4, 6]] + grid[:3, 3:]).T
    pair = hemispheres._Pair(values.astype(np.float32), np.linalg.inv(grid), points, np.full(3, 0.5))
    error, residual, found = pair._compared(np.eye(4))
    np.testing.assert_allclose(found, [slope] * 3, atol=1e-6)
    np.testing.assert_allclose(residual, points @ slope - 0.5, atol=1e-6)
    assert error == pytest.approx((residual**2).mean())
