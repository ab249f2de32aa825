"""Profiles: mean and standard deviation along cortical depth, on shapes whose depth is known."""

import csv
import json

import numpy as np
import pytest
import tifffile
from command_line import fail, succeed
from layers import bent_layers
from nibabel import Nifti1Image
from refusals import refused

import voxflat
from voxflat.io import Volume
from voxflat.maps.depth import LAYERINGS

CENTRE = np.array([14.53, 14.67, 14.09])  # of the sphere, whose inner border has a radius of 10 mm


@pytest.fixture(scope="module")
def sphere():
    """Return the rim of a sphere, its labels, and the true equivolume and equidistant depth."""
    labels, *truth = bent_layers("sphere", 0.6)
    return voxflat.rim(labels), labels, *truth


@pytest.fixture(scope="module")
def gyrus():
    """Return the rim of half a cylinder, its map, and the place of each voxel of grey matter: arc and z in mm."""
    labels = voxflat.samples.rim()
    rim = voxflat.rim(labels)
    x, y, z = np.argwhere(labels.data == 3).T * 0.4
    return rim, rim.surface.flatten(), 5.75 * np.arctan2(x - 7.8, y), z


def height(points):
    """Return the true equidistant depth in the sphere."""
    return (np.linalg.norm(points - CENTRE, axis=-1) - 10) / 2.5


def centres(shape, affine):
    """Return the centres of voxels."""
    return np.moveaxis(np.indices(shape), 0, -1) @ affine[:3, :3].T + affine[:3, 3]


def in_labels(labels, values):
    """Return a volume with values in the voxels of grey matter, and NaN elsewhere."""
    data = np.full(labels.data.shape, np.nan)
    data[labels.data == 3] = values
    return Volume(data, labels.affine)


@pytest.mark.medium
@pytest.mark.parametrize("layering", LAYERINGS)
def test_a_function_of_depth_is_its_own_profile(sphere, layering):
    rim, labels, *truth = sphere
    depth = dict(zip(LAYERINGS, truth, strict=True))[layering]
    profile = rim.profile(Volume(np.cos(3 * depth), labels.affine), layering=layering)
    assert profile.mean.shape == profile.sd.shape == profile.voxels.shape == (1, 20)
    np.testing.assert_allclose(profile.depths, np.linspace(0.025, 0.975, 20))
    np.testing.assert_allclose(profile.mean[0], np.cos(3 * profile.depths), atol=0.05)
    assert profile.voxels.sum() == np.sum(labels.data == 3)
    assert not profile.missing.any()


@pytest.mark.medium
def test_values_by_hand(sphere):
    rim, labels, *_ = sphere
    data = np.random.default_rng(0).normal(1000, 3, labels.data.shape)
    regions = np.indices(labels.data.shape)[0] // 17  # 0 to 2; 0 is outside all regions
    profile = rim.profile(data, regions, count=7, layering="equidistant")
    layers = rim.layers(7, "equidistant").data
    assert (profile.keys, profile.names) == ((1, 2), ("1", "2"))
    for place in np.ndindex(profile.mean.shape):
        own = data[(regions == profile.keys[place[0]]) & (layers == place[1] + 1)]
        assert profile.voxels[place] == len(own)
        assert profile.mean[place] == pytest.approx(own.mean(), rel=1e-13)
        assert profile.sd[place] == pytest.approx(own.std(ddof=1), rel=1e-10)


def test_another_grid(sphere):
    rim, labels, *_ = sphere
    affine = np.array([[0, -0.8, 0, 29.63], [0.7, 0, 0, -0.53], [0, 0, 0.5, -0.81], [0, 0, 0, 1]])
    places = centres((44, 38, 62), affine)
    profile = rim.profile(Volume(height(places), affine), count=5, layering="equidistant")
    np.testing.assert_allclose(profile.mean[0], profile.depths, atol=0.03)
    labelled = Volume(np.where(places[..., 0] > 14.43, 4, 9), affine)
    halves = rim.profile(labels.data * 1.0, labelled, count=5)
    column = np.rint((29.63 - centres(labels.data.shape, labels.affine)[..., 0]) / 0.8)  # nearest one
    right = 29.63 - 0.8 * column > 14.43
    expected = [np.bincount(rim.layers(5).data[side], minlength=6)[1:] for side in (right, ~right)]
    np.testing.assert_array_equal(halves.voxels, expected)
    assert halves.keys == (4, 9)


def test_voxels_without_a_value_are_left_out_and_counted(sphere):
    rim, labels, *truth = sphere
    data = np.where(np.indices(labels.data.shape)[1] < 20, np.nan, truth[1])
    data[:, 20] = np.inf
    profile = rim.profile(Volume(data, labels.affine), layering="equidistant", count=4)
    left_out = np.sum(labels.data[:, :21] == 3)  # neighbours keep their values
    assert left_out > 0
    np.testing.assert_array_equal(profile.missing, [left_out])
    assert profile.voxels.sum() == np.sum(labels.data == 3) - left_out
    np.testing.assert_allclose(profile.mean[0], profile.depths, atol=0.03)
    cropped = labels.affine.copy()
    cropped[:3, 3] += labels.affine[:3, 1] * 21
    outside = rim.profile(Volume(data[:, 21:], cropped), layering="equidistant", count=4)
    np.testing.assert_array_equal(outside.mean, profile.mean)
    np.testing.assert_array_equal(outside.missing, profile.missing)


@pytest.mark.medium
def test_layers_without_voxels(gyrus):
    rim, *_ = gyrus
    mask = rim.layers(4).data == 2
    mask[tuple(np.argwhere(rim.layers(4).data == 4)[0])] = True
    profile = rim.profile(rim.thickness(), mask, count=4)
    np.testing.assert_array_equal(profile.voxels > 0, [[False, True, False, True]])
    np.testing.assert_array_equal(np.isnan(profile.mean), [[True, False, True, False]])
    np.testing.assert_array_equal(np.isnan(profile.sd), [[True, False, True, True]])  # one voxel has no sd
    assert "grey" not in profile.table()
    assert profile.table().count("–") == 5


@pytest.mark.medium
def test_channels(gyrus, tmp_path):
    rim, *_ = gyrus
    labels = voxflat.samples.rim()
    data = np.random.default_rng(1).normal(size=(*labels.data.shape, 3)).astype(np.float32)
    data[..., 2][labels.data == 3] = np.where(np.arange(5680) < 100, np.nan, 1)
    image = Nifti1Image(data, labels.affine)
    profile = rim.profile(image, count=6)
    assert profile.mean.shape == (1, 6, 3)
    assert profile.channels == ("0", "1", "2")
    np.testing.assert_array_equal(profile.missing, [[0, 0, 100]])
    np.testing.assert_array_equal(rim.profile(data, count=6).mean, profile.mean)
    for channel in range(3):
        one = rim.profile(image, count=6, channel=channel)
        assert one.channels == ()
        for name in ("mean", "sd", "voxels"):
            np.testing.assert_array_equal(getattr(one, name), getattr(profile, name)[..., channel])
        np.testing.assert_array_equal(one.mean, rim.profile(data[..., channel], count=6).mean)
    profile.save(tmp_path / "profile.csv")
    with (tmp_path / "profile.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["layer"], row["channel"]) for row in rows[:4]] == [("1", "0"), ("1", "1"), ("1", "2"), ("2", "0")]


@pytest.mark.medium
def test_channels_of_the_same_name_are_called_by_number(tmp_path):
    """In profiles, in tables of regions, and in the message that lists them, as they are chosen."""
    sample = voxflat.samples.rim()
    about = {"axes": "ZCYX", "Channel": {"Name": ["rim", "gfp", "gfp"]}}
    about |= {f"PhysicalSize{axis}": 0.5 for axis in "XYZ"} | {f"PhysicalSize{axis}Unit": "mm" for axis in "XYZ"}
    stack = tmp_path / "stack.ome.tif"
    tifffile.imwrite(
        stack, np.stack([sample.data, sample.data + 1, 5 * sample.data]).transpose(3, 0, 2, 1), metadata=about
    )
    rim = voxflat.rim(voxflat.io.read_volume(stack, "rim"))
    profile = rim.profile(stack, count=2)
    assert profile.channels == ("rim", "1", "2")
    np.testing.assert_array_equal(profile.mean[..., 2], rim.profile(stack, count=2, channel=2).mean)
    flat_map = rim.surface.flatten()
    refused(r"has 3 channels \(rim, 1: gfp, 2: gfp\)", flat_map.image, stack)
    refused(r"has 3 channels .* \(rim, 1: gfp, 2: gfp\)", voxflat.io.read_volume, stack)
    refused(
        r"has 2 channels named 'gfp' \(numbers \[1, 2\]\). Choose one by its number",
        flat_map.image,
        stack,
        channel="gfp",
    )
    (low, _), (high, _) = np.sort(flat_map.uv, axis=0)[[0, -1]] / 4
    square = {"square": [(low, low), (high, low), (high, high), (low, high)]}
    assert {"mean_rim", "mean_1", "mean_2"} <= set(flat_map.regions(square).properties(flat_map.images(stack)))


def test_integers_are_not_mixed(gyrus):
    rim, *_ = gyrus
    layers = rim.layers(3)
    shifted = layers.affine.copy()
    shifted[0, 3] += 0.1
    profile = rim.profile(Volume(layers.data, shifted), count=3)
    np.testing.assert_array_equal(profile.mean, [[1, 2, 3]])
    np.testing.assert_array_equal(profile.sd, 0)
    mixed = rim.profile(Volume(layers.data, shifted), count=3, interpolation="linear")
    assert (mixed.sd > 0.1).all()


def rectangle(flat_map, arcs, heights):
    """Return a rectangle of the cylinder, between two arcs and two heights, as a polygon on its map."""
    x, y, z = flat_map.points.T
    place = np.stack([5.75 * np.arctan2(x - 7.8, y), z, np.ones(len(x))], axis=1)
    fit, *_ = np.linalg.lstsq(place, flat_map.uv, rcond=None)
    assert np.abs(place @ fit - flat_map.uv).max() < 0.1
    corners = [(arcs[0], heights[0]), (arcs[1], heights[0]), (arcs[1], heights[1]), (arcs[0], heights[1])]
    return np.array([(*corner, 1) for corner in corners]) @ fit


def test_a_drawn_region_holds_the_columns_below_it(gyrus):
    rim, flat_map, arc, z = gyrus
    drawn = {"V1": rectangle(flat_map, (-7, -1.6), (1, 5)), "V2": rectangle(flat_map, (0, 6), (2.2, 6.6))}
    regions = flat_map.regions(drawn)
    masks = [(arc > -7) & (arc < -1.6) & (z > 1) & (z < 5), (arc > 0) & (arc < 6) & (z > 2.2) & (z < 6.6)]
    labels = voxflat.samples.rim()
    inside = rim.profile(in_labels(labels, masks[0] + 2.0 * masks[1]), regions, count=5)
    assert inside.names == ("V1", "V2")
    np.testing.assert_allclose(inside.mean, np.broadcast_to([[1], [2]], (2, 5)), atol=0.15)  # voxels on the outline
    np.testing.assert_allclose(inside.mean.mean(axis=1), [1, 2], atol=0.03)
    by_mask = rim.profile(rim.depth(), in_labels(labels, masks[0] + 2.0 * masks[1]), count=5)
    by_map = rim.profile(rim.depth(), regions, count=5)
    np.testing.assert_allclose(by_map.voxels.sum(axis=1), by_mask.voxels.sum(axis=1), rtol=0.02)
    np.testing.assert_allclose(by_map.mean, by_mask.mean, atol=0.01)
    painted = flat_map.regions(np.nan_to_num(regions.image().data) * 5)
    by_image = rim.profile(rim.depth(), painted, count=5)
    assert by_image.keys == (5, 10)
    np.testing.assert_allclose(by_image.voxels.sum(axis=1), by_mask.voxels.sum(axis=1), rtol=0.05)


def test_columns_beyond_a_map_belong_to_no_region(gyrus):
    rim, _, arc, z = gyrus
    seed = int(np.abs(rim.surface.points - [7.8, 5.75, 4]).sum(axis=1).argmin())
    x, y, height = rim.surface.points[seed]
    flat_map = rim.surface.disk(rim.surface.ids[seed], 2.5).flatten()
    away = np.hypot(arc - 5.75 * np.arctan2(x - 7.8, y), z - height)
    everything = flat_map.regions({"all": [[-50, -50], [50, -50], [50, 50], [-50, 50]]})
    labels = voxflat.samples.rim()
    near = rim.profile(in_labels(labels, away < 2.5 + 0.3), everything, count=3)
    assert near.mean.min() == 1
    core = away < 2.5 - 0.6
    assert (rim.profile(in_labels(labels, core), everything, count=1).mean * near.voxels.sum()).round() == core.sum()


def test_figures(gyrus):
    from matplotlib.figure import Figure

    rim, *_ = gyrus
    regions = np.indices((40, 20, 20))[0] // 20 + 1
    profile = rim.profile(rim.thickness(), regions, count=8)
    axes = profile.plot(label="thickness (mm)").axes[0]
    assert (axes.get_ylabel(), axes.get_xlabel()) == ("thickness (mm)", "equivolume depth")
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["1", "2"]
    for line, band, mean, sd in zip(axes.lines, axes.collections, profile.mean, profile.sd, strict=True):
        np.testing.assert_array_equal(line.get_xydata(), np.stack([profile.depths, mean], axis=1))
        extent = band.get_paths()[0].get_extents()
        np.testing.assert_allclose([extent.y0, extent.y1], [(mean - sd).min(), (mean + sd).max()])
    own = Figure().add_subplot()
    assert profile.plot(ax=own) is own
    many = rim.profile(rim.thickness(), np.indices((40, 20, 20))[0], count=2)
    refused("has 34 lines .* at most 20. Choose fewer regions", many.plot)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"volume": np.ones((3, 4, 5))}, "shape .3, 4, 5. and no affine, but the rim has shape .40, 20, 20."),
        ({"volume": np.ones((40, 20, 20), complex)}, "complex128. Convert them"),
        ({"volume": np.full((40, 20, 20), np.nan)}, "no finite values in the grey matter of the regions"),
        ({"volume": Volume(np.ones((5, 5, 5)), np.diag([1.0, 1, 1, 1]) + np.eye(4, k=3) * 90)}, "Check its affine"),
        ({"volume": np.zeros((40, 20, 20, 3), np.uint8)}, "contains colours, which have no mean"),
        ({"volume": np.ones((40, 20, 20, 2)), "channel": 2}, "has no map 2. Pass a number from 0 to 1"),
        ({"regions": np.ones((3, 4, 5))}, "but the rim has shape"),
        ({"regions": np.zeros((40, 20, 20))}, "contain no voxel of grey matter"),
        ({"regions": np.full((40, 20, 20), 1.5)}, "contain the value 1.5, which is not a label"),
        ({"regions": -np.ones((40, 20, 20))}, "range from -1 to -1. Use numbers from 1"),
        ({"regions": np.ones((40, 20, 20, 2))}, "consist of 2 volumes"),
        ({"regions": np.zeros((40, 20, 20, 3), np.uint8)}, "as for colours"),
        ({"count": 0}, "count is 0. Pass a whole number"),
        ({"count": 2.5}, "count is 2.5"),
        ({"layering": "laplace"}, "layering is 'laplace'"),
        ({"interpolation": "majority"}, "interpolation is 'majority'. Pass 'linear' or 'nearest'"),
    ],
)
def test_refusals(gyrus, given, message):
    rim, *_ = gyrus
    refused(message, rim.profile, **{"volume": np.ones((40, 20, 20)), **given})


def test_regions_without_voxels(gyrus):
    rim, flat_map, *_ = gyrus
    small = flat_map.regions({"V1": flat_map.uv[0] + [[0, 0], [1e-4, 0], [0, 1e-4]]})
    refused("region V1 contains no voxel of grey matter. Draw a larger region", rim.profile, rim.depth(), small)
    hill = voxflat.samples.hill()
    elsewhere = voxflat.flatten((hill.points + 500, hill.faces)).regions({"V1": [[-5, -5], [5, -5], [0, 5]]})
    refused("no column of grey matter lies on the map of the regions", rim.profile, rim.depth(), elsewhere)


def test_files(gyrus, tmp_path):
    rim, *_ = gyrus
    mask = rim.layers(2).data == 1
    profile = rim.profile(rim.depth("equidistant"), mask, count=2)
    profile.save(tmp_path / "profile.tsv", sidecar=True)
    lines = (tmp_path / "profile.tsv").read_text().splitlines()
    assert lines[0] == "region\tlayer\tdepth\tmean\tsd\tvoxels"
    region, layer, depth, mean, sd, voxels = lines[1].split("\t")
    assert (region, layer, depth, voxels) == ("1", "1", "0.25", str(mask.sum()))
    np.testing.assert_allclose([float(mean), float(sd)], [profile.mean[0, 0], profile.sd[0, 0]], rtol=1e-7)
    assert lines[2] == "1\t2\t0.75\tn/a\tn/a\t0"
    assert json.loads((tmp_path / "profile.tsv.json").read_text())["parameters"]["count"] == 2
    refused("cannot save a profile as profile.xlsx. Use a name that ends in .tsv or .csv", profile.save, "profile.xlsx")


@pytest.mark.medium
def test_command(gyrus, tmp_path):
    rim, flat_map, *_ = gyrus
    labels, volume = voxflat.samples.rim(), rim.thickness()
    files = {
        name: tmp_path / name for name in ("rim.nii.gz", "bold.nii.gz", "map.npz", "rois.json", "out.tsv", "f.png")
    }
    voxflat.io.write_volume(files["rim.nii.gz"], labels.data, labels.affine)
    voxflat.io.write_volume(files["bold.nii.gz"], volume.data, volume.affine)
    flat_map.save(files["map.npz"])
    polygon = {"V1": rectangle(flat_map, (-7, -1.6), (1, 5)).tolist()}
    files["rois.json"].write_text(json.dumps(polygon))
    given = ("profile", files["rim.nii.gz"], "--volume", files["bold.nii.gz"], "-o", files["out.tsv"])
    drawn = ("--map", files["map.npz"], "--regions", files["rois.json"])
    told = json.loads(succeed(*given, *drawn, "-n", 5, "--figure", files["f.png"], "--json").stdout)
    read = voxflat.rim(files["rim.nii.gz"])  # its affine has single precision
    expected = read.profile(files["bold.nii.gz"], flat_map.regions(polygon), count=5)
    assert (told["regions"], told["voxels"], told["missing"]) == (["V1"], [int(expected.voxels.sum())], [0])
    expected.save(tmp_path / "expected.tsv")
    assert files["out.tsv"].read_bytes() == (tmp_path / "expected.tsv").read_bytes()
    assert files["f.png"].read_bytes()[:4] == b"\x89PNG"
    assert "1 region with 5680 voxels in 20 layers" in succeed(*given).stdout
    fail(2, "--map requires --regions", *given, *drawn[:2])
    fail(2, "--regions rois.json contains drawn regions and requires --map", *given, *drawn[2:])
    fail(1, "none.nii.gz: No such file", *given, "--regions", tmp_path / "none.nii.gz")
    fail(2, "--layer requires --map", *given, "--layer", "rois")
    fail(2, "--label requires --figure", *given, "--label", "t")
    fail(1, "unknown file format. Choose a name that ends in .tsv or .csv", *given[:-1], tmp_path / "out.nii")
