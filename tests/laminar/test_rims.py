"""Rims: depth, thickness and layers of a segmentation, on shapes whose depth is known."""

import numpy as np
import pytest
from command_line import fail, succeed
from layers import bent_layers
from refusals import refused

import voxflat
from voxflat.io import Volume
from voxflat.maps.depth import LAYERINGS

SHAPES = ("sphere", "cylinder", "fold")


@pytest.fixture(scope="module")
def rims():
    """Return rims with their labels and true depths, by shape."""
    made = {shape: bent_layers(shape, 0.5) for shape in SHAPES}
    return {shape: (voxflat.rim(labels), labels, *truth) for shape, (labels, *truth) in made.items()}


def errors(rim, truth):
    """Return the absolute errors of depth for each layering."""
    for layering, true in zip(LAYERINGS, truth, strict=True):
        found = rim.depth(layering).data
        np.testing.assert_array_equal(np.isnan(found), np.isnan(true))
        yield np.abs(found - true)[~np.isnan(true)]


@pytest.mark.parametrize("shape", SHAPES)
def test_depth_of_known_shapes(rims, shape):
    rim, _, *truth = rims[shape]
    for error in errors(rim, truth):
        assert error.mean() < 0.04
        assert np.quantile(error, 0.95) < 0.12


def test_finer_voxels_give_better_depths(rims):
    labels, *truth = bent_layers("cylinder", 0.3)
    for coarse, fine in zip(
        errors(rims["cylinder"][0], rims["cylinder"][2:]), errors(voxflat.rim(labels), truth), strict=True
    ):
        assert fine.mean() < 0.8 * coarse.mean()


def test_equivolume_differs_from_equidistant_as_volume_does(rims):
    rim, _, volume, height = rims["cylinder"]
    found = rim.depth("equivolume").data - rim.depth("equidistant").data
    inside = ~np.isnan(height)
    slope = np.polyfit((volume - height)[inside], found[inside], 1)[0]
    assert 0.8 < slope < 1.1


@pytest.mark.parametrize("shape", SHAPES)
def test_thickness(rims, shape):
    rim, labels, *_ = rims[shape]
    thickness = rim.thickness().data
    assert abs(np.nanmedian(thickness) - 2.5) < 0.1
    assert (np.isnan(thickness) == (labels.data != 3)).all()
    assert abs(np.median(rim.surface.thickness) - 2.5) < 0.1


@pytest.mark.parametrize("layering", LAYERINGS)
def test_layers_are_depths(rims, layering):
    rim, labels, *_ = rims["fold"]
    layers, depth = rim.layers(7, layering).data, rim.depth(layering).data
    assert layers.dtype == np.int16
    np.testing.assert_array_equal(layers == 0, labels.data != 3)
    inside = layers > 0
    np.testing.assert_array_equal(layers[inside], np.clip(np.ceil(depth[inside] * 7), 1, 7))


def test_layers_have_equal_volumes(rims):
    counts = np.bincount(rims["sphere"][0].layers(4).data.ravel())[1:]
    assert np.ptp(counts) < 0.15 * counts.mean()


def test_the_middle_surface_is_open_where_the_labels_end(rims):
    loops = {shape: len(rims[shape][0].surface.core.topology()["loops"]) for shape in SHAPES}
    assert loops == {"sphere": 0, "cylinder": 2, "fold": 1}
    middle = rims["cylinder"][0].surface
    radius = np.hypot(middle.points[:, 0] - 8.13, middle.points[:, 1] - 8.27)
    assert abs(radius - 5.25).max() < 0.3


def test_a_flat_volume_holds_the_depth_at_which_it_was_sampled(rims):
    rim = rims["fold"][0]
    flat_map = rim.surface.flatten()
    stack = flat_map.images(
        rim.depth("equidistant"), fraction=(0.2, 0.5, 0.8), layering="equidistant", interpolation="linear"
    )
    for fraction, image in zip((0.2, 0.5, 0.8), stack.data, strict=True):
        inside = image[~np.isnan(image)]
        assert abs(inside - fraction).mean() < 0.02


def test_the_affine_does_not_change_depth(rims):
    rim, labels, *_ = rims["fold"]
    turned = np.array([[0, -0.5, 0, 9], [0, 0, 0.5, -4], [-0.5, 0, 0, 2], [0, 0, 0, 1.0]])
    found = voxflat.rim(Volume(labels.data, turned))
    np.testing.assert_allclose(found.values.depth, rim.values.depth, atol=1e-6)
    mirrored = voxflat.rim(Volume(labels.data[::-1], labels.affine)).depth().data[::-1]
    np.testing.assert_allclose(mirrored, rim.depth().data, atol=0.05)


def test_flat_layers_in_anisotropic_voxels():
    labels = np.zeros((12, 12, 24), np.uint8)
    labels[..., 6:9], labels[..., 9:15], labels[..., 15:17] = 2, 3, 1
    rim = voxflat.rim(labels, spacing=(1.0, 2.0, 0.5))
    expected = (np.arange(6) + 0.5) / 6
    np.testing.assert_allclose(rim.depth("equidistant").data[3, 4, 9:15], expected, atol=2e-3)
    np.testing.assert_allclose(rim.values.thickness, 3.0, atol=0.02)


@pytest.mark.parametrize("axis", range(3))
def test_one_slice(axis):
    labels, _, height = bent_layers("fold", 0.5)
    data = np.moveaxis(labels.data[:, :, 3:4], 2, axis)
    found = voxflat.rim(data, spacing=(0.5, 0.5, 0.5))
    error = np.abs(np.moveaxis(found.depth("equidistant").data, axis, 2) - height[:, :, 3:4])
    assert np.nanmean(error) < 0.04
    assert found.surface.flatten().distortion.raw.relative_error < 0.01


def test_labels_from_elsewhere(rims):
    rim, labels, *_ = rims["fold"]
    swapped = np.choose(labels.data, [0, 8, 5, 7])
    for other in (
        voxflat.rim(swapped, inner=5, grey=7, outer=8, affine=labels.affine),
        voxflat.rim(
            labels, inner=labels.data == 2, grey=labels.data == 3, outer=Volume(1 * (labels.data == 1), labels.affine)
        ),
    ):
        np.testing.assert_array_equal(other.values.depth, rim.values.depth)


def test_ribbons(rims):
    _, labels, *_ = rims["sphere"]
    filled = np.where(labels.data == 0, 0, np.choose(labels.data, [0, 0, 41, 42]))
    filled[labels.data.shape[0] // 2 - 3 :][:6, 30:40, 30:40] = 41  # white matter inside the border
    filled[0, 0, :2] = 2, 3
    refused("Pass hemisphere='left' or 'right'", voxflat.rim, filled)
    depth = voxflat.rim(filled, hemisphere="right", affine=labels.affine).depth("equidistant").data
    inside = labels.data == 3
    assert np.abs(depth - rims["sphere"][0].depth("equidistant").data)[inside].mean() < 0.02


def test_almost_whole_labels_are_rounded(rims, caplog):
    rim, labels, *_ = rims["fold"]
    found = voxflat.rim(Volume(labels.data * 0.9999, labels.affine))
    assert "differ from whole numbers by up to 0.0003 and were rounded" in caplog.text
    np.testing.assert_array_equal(found.values.depth, rim.values.depth)


def test_banks_that_touch_are_reported(caplog):
    labels = np.full((60, 12, 30), 2, np.uint8)
    labels[6:54, :, 20:23], labels[:, :, 23:26], labels[:, :, 26:] = 3, 3, 1
    labels[26:34, :, 4:23] = 3  # a sulcus without an outer border
    voxflat.rim(labels)
    assert "of the grey matter is more than 2.5 times as thick as the median. Check whether the banks" in caplog.text


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda v: v * (v != 3),
            r"no voxel with the label 3 \(grey matter\); its labels are 1, 2. Pass the labels as inner",
        ),
        (lambda v: v * (v != 1), r"no voxel with the label 1 \(outer border\)"),
        (lambda v: v * (v != 2), r"no voxel with the label 2 \(inner border\)"),
        (lambda v: v * 0, "its labels are none"),
        (lambda v: v + 0.4, "contains the value .*, which is not a label. Resample the rim with nearest-neighbour"),
        (lambda v: np.where(v == 3, np.nan, v), "NaN or infinite"),
        (lambda v: np.stack([v] * 2, -1), "Select one 3-D volume"),
        (lambda v: v[:0], "shape"),
    ],
)
def test_wrong_rims(rims, change, message):
    refused(message, voxflat.rim, change(rims["fold"][1].data))


def test_swapped_borders_of_a_closed_surface(rims):
    labels = rims["sphere"][1]
    refused("inner border encloses the outer border. Swap", voxflat.rim, labels, inner=1, outer=2, grey=3)


def test_wrong_options(rims):
    rim, labels, *_ = rims["fold"]
    refused("grey is missing", voxflat.rim, labels, inner=2)
    refused("hemisphere selects the labels", voxflat.rim, labels, inner=2, grey=3, hemisphere="left")
    refused("inner is 2.5. Pass a label", voxflat.rim, labels, inner=2.5, grey=3)
    refused("has shape", voxflat.rim, labels, inner=np.ones((2, 2, 2)), grey=3)
    refused("has the label 1. Omit hemisphere", voxflat.rim, labels, hemisphere="left")
    refused("hemisphere is 'up'", voxflat.rim, labels, hemisphere="up")
    refused(
        "no voxel of the grey matter touches",
        voxflat.rim,
        np.array([2, 0, 0, 0, 0, 3, 1]).reshape(7, 1, 1) * np.ones((1, 5, 5), int),
    )
    for count in (0, 1001, 2.5, "3", True):
        refused("count is", rim.layers, count)
    refused("layering is", rim.depth, "laplace")


def test_maps_of_rims_can_be_saved(rims, tmp_path):
    flat_map = voxflat.rim(voxflat.samples.rim()).surface.flatten()  # the grey matter reaches the ends of the volume
    flat_map.save(tmp_path / "map.npz")
    loaded = voxflat.load(tmp_path / "map.npz")
    np.testing.assert_array_equal(loaded.white_points, flat_map.white_points)
    assert "halfway between the inner and the outer border of segmented grey matter" in str(voxflat.cite(loaded))
    np.testing.assert_array_equal(
        loaded.image(rims["fold"][1], fraction=0.5).data, flat_map.image(rims["fold"][1], fraction=0.5).data
    )


def test_layers_on_the_command_line(rims, tmp_path):
    rim, labels, *_ = rims["fold"]
    voxflat.io.write_volume(tmp_path / "rim.nii.gz", labels.data, labels.affine)
    voxflat.io.write_volume(tmp_path / "white.nii.gz", (labels.data == 2).astype(np.uint8), labels.affine)
    given = (tmp_path / "rim.nii.gz", "-n", 3, "--inner", tmp_path / "white.nii.gz", "--grey", 3, "--outer", 1)
    succeed("layers", *given, "-o", tmp_path / "layers.nii.gz")
    for name, expected in (("", rim.layers(3)), ("_depth", rim.depth()), ("_thickness", rim.thickness())):
        found = voxflat.io.read_volume(tmp_path / f"layers{name}.nii.gz")
        np.testing.assert_array_equal(found.data, expected.data)
        np.testing.assert_allclose(found.affine, labels.affine)
    fail(1, "it is an input. Choose another name", "layers", *given, "-o", tmp_path / "white.nii.gz")
    fail(1, "it is an input. Choose another name", "layers", *given, "-o", tmp_path / "rim.nii.gz")


def test_threads_do_not_matter(rims):
    labels = rims["fold"][1]
    one, two = (voxflat.rim(labels, threads=threads).values for threads in (1, 2))
    np.testing.assert_array_equal(one.volume_depth, two.volume_depth)
    np.testing.assert_array_equal(one.points, two.points)


def test_progress_and_cancelling(rims):
    stages = []
    voxflat.rim(rims["fold"][1], progress=lambda stage, done, total: stages.append(stage))
    assert "measuring depth" in stages
    with pytest.raises(voxflat.Cancelled):
        voxflat.rim(rims["fold"][1], progress=lambda stage, done, total: stage != "measuring depth")


def test_provenance_says_how_it_was_made(rims, tmp_path):
    from voxflat.io.volumes import write_volume

    path = tmp_path / "rim.nii.gz"
    write_volume(path, rims["fold"][1].data, rims["fold"][1].affine)
    layers = voxflat.rim(path).layers(3)
    assert layers.provenance["parameters"]["count"] == 3
    assert str(path) in layers.provenance["parameters"]["of"]["files"] or layers.provenance["parameters"]["of"]["files"]
