"""Rims: depth, thickness and layers of a segmentation, on shapes whose depth is known."""

import re
from itertools import product

import mesh_files
import nibabel
import numpy as np
import pytest
import scipy
import tifffile
from command_line import fail, succeed
from layers import bent_layers
from refusals import refused

import voxflat
from voxflat import _core
from voxflat.io import Volume
from voxflat.laminar.banks import crosses
from voxflat.laminar.labels import Layered, _extended, grown, reached
from voxflat.laminar.rim import _is_fragment
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


@pytest.mark.medium
@pytest.mark.parametrize("shape", SHAPES)
def test_depth_of_known_shapes(rims, shape):
    rim, _, *truth = rims[shape]
    for error in errors(rim, truth):
        assert error.mean() < 0.04
        assert np.quantile(error, 0.95) < 0.12


@pytest.mark.medium
def test_finer_voxels_give_better_depths(rims):
    labels, *truth = bent_layers("cylinder", 0.3)
    for coarse, fine in zip(
        errors(rims["cylinder"][0], rims["cylinder"][2:]), errors(voxflat.rim(labels), truth), strict=True
    ):
        assert fine.mean() < 0.8 * coarse.mean()


@pytest.mark.medium
def test_equivolume_differs_from_equidistant_as_volume_does(rims):
    rim, _, volume, height = rims["cylinder"]
    found = rim.depth("equivolume").data - rim.depth("equidistant").data
    inside = ~np.isnan(height)
    slope = np.polyfit((volume - height)[inside], found[inside], 1)[0]
    assert 0.8 < slope < 1.1


@pytest.mark.medium
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


@pytest.mark.medium
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


def ring(radius, labels, height):
    """Return the equivolume depth in the slices of a sphere, each on its own, from the equidistant depth."""
    z = (np.arange(labels.data.shape[2]) - (labels.data.shape[2] - 1) / 2) * labels.affine[2, 2] + 0.31
    inner, outer = (np.maximum(end**2 - z**2, 0) for end in (radius, radius + 2.5))
    return ((radius + 2.5 * height) ** 2 - z**2 - inner) / (outer - inner)


@pytest.mark.medium
@pytest.mark.parametrize(
    ("shape", "count"), [*product(("cylinder", "fold"), (1, 3, 5, 15)), ("sphere", 1), ("sphere", 3)]
)
def test_the_ends_of_a_slab_are_not_curved(shape, count):
    labels, volume, height = bent_layers(shape, 0.3)
    if shape == "sphere":  # so few slices do not show its curvature across them
        volume = ring(10.0, labels, height)
    first = (labels.data.shape[2] - count) // 2
    slab = np.s_[:, :, first : first + count]
    depth = voxflat.rim(Volume(labels.data[slab], labels.affine)).depth().data
    error = (depth - volume[slab])[8:-8]  # a fold is curved at the ends of its labels
    assert abs(np.nanmean(error)) < 0.005
    assert abs(np.nanmean(error[:, :, 0])) < 0.005


@pytest.mark.medium
def test_curvature_across_slices_is_seen_up_to_the_ends():
    labels, volume, _ = bent_layers("sphere", 0.3)
    slab = np.s_[:, :, (labels.data.shape[2] - 15) // 2 : (labels.data.shape[2] + 15) // 2]
    error = voxflat.rim(Volume(labels.data[slab], labels.affine)).depth().data - volume[slab]
    assert abs(np.nanmean(error)) < 0.005
    assert abs(np.nanmean(error[:, :, [0, 1, -2, -1]])) < 0.01


@pytest.mark.medium
@pytest.mark.parametrize("shape", ["cylinder", "fold"])  # the inner border of the sphere may not be outside
def test_borders_are_treated_alike(rims, shape):
    rim, labels, *_ = rims[shape]
    swapped = voxflat.rim(labels, inner=1, outer=2, grey=3)
    np.testing.assert_allclose(1 - swapped.values.depth, rim.values.depth, atol=1e-6)


@pytest.mark.medium
def test_layers_of_a_slice_have_equal_areas():
    axis = np.arange(-5, 5, 0.1) + 0.05
    radius = np.hypot(*np.meshgrid(axis, axis))[..., None]
    labels = np.select([radius < 2, radius <= 4], [2, 3], 1)
    counts = np.bincount(voxflat.rim(labels, spacing=(0.1, 0.1, 0.1)).layers(5).data.ravel())[1:]
    np.testing.assert_allclose(counts, counts.mean(), rtol=0.05)


@pytest.mark.medium
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


@pytest.mark.medium
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


def test_fragments_are_small_and_less_than_a_hundredth_of_the_largest_component():
    meshes = [mesh_files.grid(2, step=side) for side in (10.0, 1.5, 0.9)]  # 100, 2.25 and 0.81 mm²
    points = np.concatenate([mesh.points + np.array([20.0 * n, 0, 0]) for n, mesh in enumerate(meshes)])
    faces = np.concatenate([mesh.faces + 4 * n for n, mesh in enumerate(meshes)])
    core, _ = _core.Surface.from_triangles(points, faces)
    assert _is_fragment(core, 50.0).tolist() == [False] * 4 + [True] * 2
    assert not _is_fragment(core, 0.8).any()


def sulcus(gap, spacing=0.5, thickness=2.5):
    """Return the rim of a sulcus whose banks are some mm apart, and its depth within the sulcus."""
    x, y, _ = np.meshgrid(np.arange(-9, 9, spacing), np.arange(-6, 16, spacing), np.arange(8), indexing="ij")
    x, y = x + 0.13, y + 0.07
    side = np.where(y > 0, np.abs(x) - gap / 2, np.hypot(np.maximum(np.abs(x) - gap / 2, 0), y))
    distance = np.minimum(side, 12 - y)  # from cerebrospinal fluid
    labels = np.select([distance <= 0, distance <= thickness], [1, 3], 2)
    return labels, np.where((labels == 3) & (y < 7), 1 - distance / thickness, np.nan)


@pytest.mark.medium
def test_banks_that_touch_are_separated(caplog):
    mean = {}
    for gap in (0.0, 1.6):
        labels, truth = sulcus(gap)
        rim = voxflat.rim(labels, spacing=(0.5, 0.5, 0.5))
        mean[gap] = np.nanmean(np.abs(rim.depth("equidistant").data - truth))
        points = rim.surface.points[rim.surface.faces] - (8.87, 5.93, 0)
        is_deep = (points[..., 1] > 1).all(axis=1)
        assert (np.ptp(np.sign(points[is_deep, :, 0]), axis=1) == 0).all()  # no bridge between the banks
        assert len(rim.surface.core.topology()["components"]) == 1
        assert ("banks that touch without an outer border" in caplog.text) == (gap == 0)
        rim.columns(80)  # they reach the border that was placed
        assert "do not reach both borders" not in caplog.text
        caplog.clear()
    assert mean[0.0] < 1.1 * mean[1.6] < 0.06


@pytest.mark.parametrize("thin", ["outer", "inner"])
def test_columns_stay_in_their_bank(thin):
    labels = np.zeros((26, 6, 6), np.uint8)  # a thick and a thin bank, with a thin line between them
    ends = {"outer": (2, 1), "inner": (1, 2)}[thin]
    labels[:3], labels[3:16], labels[16], labels[17:20], labels[20:] = ends[0], 3, ends[1], 3, ends[0]
    rim = voxflat.rim(labels)
    expected = (np.arange(13) + 0.5) / 13
    found = rim.depth("equidistant").data[3:16, 3, 3]
    np.testing.assert_allclose(found, expected if thin == "outer" else 1 - expected, atol=0.02)
    assert abs(np.diff(rim.surface.white_points[:, 0] > 16)).max() == 1
    assert (abs(rim.surface.white_points[:, 0] - rim.surface.pial_points[:, 0]) < 13.1).all()


@pytest.mark.medium
def test_islands_are_no_borders(rims):
    rim, labels, *_ = rims["sphere"]
    filled = labels.data.copy()
    center = np.array(filled.shape) // 2
    around = np.linalg.norm(np.indices(filled.shape) - center[:, None, None, None], axis=0) * 0.5
    filled[(filled == 0) & (around < 9)] = 2
    filled[center[0] + 15, center[1], center[2]] = 1  # fluid in the white matter
    found = voxflat.rim(Volume(filled, labels.affine))
    np.testing.assert_allclose(found.values.depth, rim.values.depth, atol=0.02)


def test_streamlines_point_outwards(tmp_path):
    labels, *_ = bent_layers("sphere", 0.8)
    turned = np.eye(4)
    turned[:3, :3] = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0] * 0.8
    directions = voxflat.rim(Volume(labels.data, turned)).streamlines()
    voxels = np.argwhere(labels.data == 3)
    radii = (voxels - (np.array([0.13, 0.27, -0.31]) / 0.8 + 18)) @ turned[:3, :3].T
    radii /= np.linalg.norm(radii, axis=1, keepdims=True)
    found = directions.data[tuple(voxels.T)]
    angles = np.degrees(np.arccos((found * radii).sum(axis=1).clip(-1, 1)))
    assert angles.mean() < 4
    assert np.quantile(angles, 0.95) < 10
    assert directions.data.dtype == np.float32
    assert np.isnan(directions.data[labels.data != 3]).all()
    for name in ("v.nii.gz", "v.mgz"):
        voxflat.io.write_volume(tmp_path / name, directions.data, turned, is_vectors=True)
        np.testing.assert_array_equal(nibabel.load(tmp_path / name).get_fdata(), directions.data)
    refused("Pass vectors of shape", voxflat.io.write_volume, tmp_path / "v.nii", labels.data, turned, is_vectors=True)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda v: {"inner": v, "grey": 3}, r"has several values \(1 to 3\). Pass a mask with one value"),
        (lambda v: {"inner": 3, "grey": 3, "outer": 1}, "inner border lies within the grey matter"),
        (lambda v: {"inner": v == 3, "grey": v == 3}, "inner border lies within the grey matter"),
        (lambda v: {"inner": np.where(v == 2, 1, np.nan), "grey": 3}, "contains NaN"),
        (lambda v: {"inner": Volume(1 * (v == 2), np.eye(4)), "grey": 3}, "affines of the mask"),
        (lambda v: {"outer": 1}, "inner is missing"),
    ],
)
def test_wrong_masks(rims, make, message):
    refused(message, voxflat.rim, rims["fold"][1], **make(rims["fold"][1].data))


@pytest.mark.medium
def test_doubtful_rims_are_reported(rims, caplog):
    labels = rims["fold"][1].data
    speck = labels.copy()
    speck[5, :4, 2] = 3
    for change, options, message in (
        (labels, {"spacing": (500, 500, 500)}, r"median thickness of the grey matter is 2.48e\+03 mm. Check the voxel"),
        (speck, {}, r"0.12 % of the grey matter is uncertain: 0.12 % \(parts that do not touch both borders\)"),
        (labels, {"inner": labels > 1, "grey": 3, "outer": 1}, "3240 voxels are grey matter and inner border"),
    ):
        voxflat.rim(change, **options).layers(3)
        assert re.search(message, caplog.text)
        caplog.clear()


@pytest.mark.medium
@pytest.mark.parametrize("spacing", [(1e6, 1e6, 1e6), (0.01, 1.0, 1.0), (0.3, 0.3, 6.0)])
def test_unusual_voxels(rims, spacing):
    depth = voxflat.rim(rims["fold"][1].data, spacing=spacing).values.depth
    assert np.isfinite(depth).all()


def test_volumes_with_one_time_point(rims):
    rim, labels, *_ = rims["fold"]
    np.testing.assert_array_equal(
        voxflat.rim(labels.data[..., None], affine=labels.affine).values.depth, rim.values.depth
    )


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
        (lambda v: v + 0.4, "contains the value .*, which is not a label"),
        (lambda v: np.where(v == 3, 2.95, v), "contains the value 2.95, .* Resample the rim with nearest-neighbour"),
        (lambda v: np.where(v == 3, np.nan, v), "NaN or infinite"),
        (lambda v: np.stack([v] * 2, -1), "Select one 3-D volume"),
        (lambda v: v[..., 0], "Select one 3-D volume"),
        (lambda v: np.stack([v.astype(np.uint8)] * 3, -1), "as for colours"),
        (lambda v: -v, "its labels are -3, -2, -1"),
        (lambda v: v == 3, "its labels are 1"),
        (lambda v: np.choose(v, [0, 2, 3, 1]), r"touches the inner border \(label 2\)"),
        (lambda v: np.choose(v, [0, 0, 2, 3]), "or hemisphere='left' for FreeSurfer's ribbon"),
        (lambda v: np.choose(v, [0, 0, 41, 42]), "labels 41 and 42 of FreeSurfer's ribbon. Pass hemisphere"),
        (lambda v: v[:0], "shape"),
    ],
)
def test_wrong_rims(rims, change, message):
    refused(message, voxflat.rim, change(rims["fold"][1].data))


def test_swapped_borders_of_a_closed_surface(rims):
    labels = rims["sphere"][1]
    refused("inner border encloses the outer border. Swap", voxflat.rim, labels, inner=1, outer=2, grey=3)


@pytest.mark.medium
def test_swapped_borders_of_an_open_rim_are_reported(rims, caplog):
    x, y = np.meshgrid(np.arange(-32, 32, 0.8), np.arange(-6, 10, 0.8), indexing="ij")
    where = np.linspace(-40, 40, 8001)
    line = np.stack([where, 2 * np.sin(np.pi * where / 8)], axis=1)
    nearest = scipy.spatial.cKDTree(line).query(np.stack([x, y], axis=-1) + 0.03)[1]
    slope = np.cos(np.pi * where / 8) * np.pi / 4
    height = (y + 0.03 - line[nearest, 1]) * np.hypot(1, slope)[nearest]  # the foot is perpendicular to the line
    thickness = 2.5 + 0.4 * np.sin(np.pi * where / 8)[nearest]  # gyri are thicker than sulci
    parts = [
        (height > -2) & (height < 0),
        (height >= 0) & (height <= thickness),
        (height > 0) & (height < thickness + 2),
    ]
    labels = np.repeat(np.select(parts, [2, 3, 1], 0)[..., None], 24, axis=2)
    voxflat.rim(labels, spacing=(0.8, 0.8, 0.8))
    for shape in ("cylinder", "fold"):
        voxflat.rim(rims[shape][1])
        voxflat.rim(rims[shape][1], inner=1, outer=2, grey=3)
    assert not caplog.text
    voxflat.rim(labels, spacing=(0.8, 0.8, 0.8), inner=1, outer=2, grey=3)
    assert "labels of the borders may be swapped" in caplog.text


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


@pytest.mark.medium
def test_maps_of_rims_can_be_saved(rims, tmp_path):
    flat_map = voxflat.rim(voxflat.samples.rim()).surface.flatten()  # the grey matter reaches the ends of the volume
    flat_map.save(tmp_path / "map.npz")
    loaded = voxflat.load(tmp_path / "map.npz")
    np.testing.assert_array_equal(loaded.white_points, flat_map.white_points)
    assert "halfway between the inner and the outer border of segmented grey matter" in str(voxflat.cite(loaded))
    np.testing.assert_array_equal(
        loaded.image(rims["fold"][1], fraction=0.5).data, flat_map.image(rims["fold"][1], fraction=0.5).data
    )


@pytest.mark.medium
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
    assert not (tmp_path / "layers_streamlines.nii.gz").exists()
    succeed("layers", *given, "--streamlines", "-o", tmp_path / "more.nii.gz")
    written = nibabel.load(tmp_path / "more_streamlines.nii.gz").get_fdata()
    np.testing.assert_array_equal(written, rim.streamlines().data)
    fail(1, "it is an input. Choose another name", "layers", *given, "-o", tmp_path / "white.nii.gz")
    fail(1, "it is an input. Choose another name", "layers", *given, "-o", tmp_path / "rim.nii.gz")


@pytest.mark.medium
def test_rims_in_stacks_of_channels_and_other_units(tmp_path):
    """Depths, thickness and areas are in mm, whatever the unit of the file."""
    sample = voxflat.samples.rim()
    pages = np.stack([0 * sample.data, sample.data]).transpose(3, 0, 2, 1)
    about = {"axes": "ZCYX", "Channel": {"Name": ["raw", "rim"]}}
    about |= {f"PhysicalSize{axis}": 500.0 for axis in "XYZ"} | {f"PhysicalSize{axis}Unit": "µm" for axis in "XYZ"}
    stack, one = tmp_path / "s.ome.tif", tmp_path / "one.nii.gz"
    tifffile.imwrite(stack, pages, metadata=about)
    voxflat.io.write_volume(one, sample.data, np.diag([0.5, 0.5, 0.5, 1]))

    def both(command, *words, endings, option="--channel"):
        for path, of in ((stack, (option, "rim")), (one, ())):
            succeed(command, path, *of, *words, "-o", tmp_path / f"{path.name[0]}.nii.gz", "--overwrite")
        for ending in endings:
            found, expected = (voxflat.io.read_volume(tmp_path / f"{name}{ending}.nii.gz") for name in "so")
            np.testing.assert_allclose(found.data, expected.data, rtol=1e-5)
            np.testing.assert_allclose(found.affine, expected.affine)

    fail(1, "has 2 channels", "layers", stack, "-n", 3, "-o", tmp_path / "s.nii.gz")
    fail(1, "with --rim-channel", "profile", stack, "--volume", one, "-n", 4, "-o", tmp_path / "s.tsv")
    both("layers", "-n", 3, endings=("", "_depth", "_thickness"))
    both("columns", "-n", 9, endings=("",))
    voxflat.rim(one).surface.flatten().save(tmp_path / "map.npz")
    succeed("image", tmp_path / "map.npz", "--volume", one, "--depths", 3, "-o", tmp_path / "values.nii.gz")
    both("paint", "--map", tmp_path / "map.npz", "--values", tmp_path / "values.nii.gz", endings=("",))
    for path, of in ((stack, ("--rim-channel", "rim")), (one, ())):
        succeed("profile", path, *of, "--volume", one, "-n", 4, "-o", tmp_path / f"{path.name[0]}.tsv")
    assert (tmp_path / "s.tsv").read_text() == (tmp_path / "o.tsv").read_text()


@pytest.mark.medium
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


@pytest.mark.medium
def test_a_rim_is_flattened_as_its_middle_surface():
    refused(r"labels 1, 2, 3. For a rim .* use voxflat.rim", voxflat.flatten, voxflat.samples.rim())
    rim = voxflat.rim(voxflat.samples.rim())
    np.testing.assert_array_equal(voxflat.flatten(rim).uv, rim.surface.flatten().uv)
    assert voxflat.surface(rim).points.shape == rim.surface.points.shape
    assert voxflat.check(rim).can_flatten
    assert rim.surface.flatten().provenance["parameters"]["of"]["function"] == "rim"
    refused("label does not apply when the input is a Surface", voxflat.surface, rim, label=3)
    refused("a CutSurface is cut open already", voxflat.surface, rim.surface.cut())


def test_masks_and_labels_grow_as_those_of_scipy():
    random = np.random.default_rng(0)
    for shape in ((7, 8, 9), (6, 1, 5)):
        mask = random.random(shape) < 0.04
        np.testing.assert_array_equal(grown(mask), scipy.ndimage.binary_dilation(mask, np.ones((3, 3, 3))))
        for steps in (1, 3):
            np.testing.assert_array_equal(reached(mask, steps), scipy.ndimage.binary_dilation(mask, iterations=steps))
        labels = random.integers(1, 4, shape).astype(np.uint8)
        beyond = np.array([[2, 0], [1, 3], [0, 6]])
        padded = np.pad(labels, beyond)
        for spacing in (1.0, 2.0, 0.5), (1.0, 1.0, 1.0):
            nearest = scipy.ndimage.distance_transform_edt(
                padded == 0, sampling=spacing, return_distances=False, return_indices=True
            )
            found = _extended(labels, beyond, Volume(labels, np.diag([*spacing, 1.0])))
            np.testing.assert_array_equal(found, padded[tuple(nearest)])


def test_a_way_crosses_a_border_between_its_ends():
    labels = np.full((12, 5, 5), 2, dtype=np.uint8)
    labels[6] = 3
    affine = np.diag([0.5, 0.7, 2.0, 1.0])
    affine[:3, 3] = 9.0
    rim = Layered(labels, labels, np.zeros(3, dtype=np.int64), affine, Volume(labels, affine))
    starts, ends = (
        rim.places(np.array(voxels)) for voxels in ([[2, 2, 2]] * 4, [[10, 2, 3], [5, 0, 4], *[[9, 2, 2]] * 2])
    )
    np.testing.assert_array_equal(crosses(rim, 3, starts, ends, np.array([0.0, 0.0, 1.9, 3.5])), [0, 2])
