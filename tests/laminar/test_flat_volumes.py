"""Flat volumes: N layers of the cortex on a map, as files, and back to the voxels of the grey matter."""

import nibabel as nib
import numpy as np
import pytest
import scipy
from command_line import fail, succeed
from layers import bent_layers
from refusals import refused

import voxflat
from voxflat.io import Volume
from voxflat.maps.depth import LAYERINGS

COUNT = 6


@pytest.fixture(scope="module")
def fold():
    """Return the rim of a fold, and its map."""
    rim = voxflat.rim(bent_layers("fold", 0.5)[0])
    return rim, rim.surface.flatten()


@pytest.fixture(scope="module")
def bold(fold):
    """Return a series of three frames: x, y and z in mm."""
    labels = fold[0].labels.volume
    data = np.stack(np.indices(labels.data.shape), axis=-1).astype(np.float32) * 0.5
    image = nib.Nifti1Image(data, labels.affine)
    image.header.set_xyzt_units("mm", "sec")
    image.header.set_zooms((0.5, 0.5, 0.5, 2.0))
    return image


def drawn(flat_map, count=COUNT):
    """Return a flat volume in which each pixel has a label of its own."""
    shape = (count, *flat_map.raster().shape)
    return np.arange(1, np.prod(shape) + 1, dtype=np.int32).reshape(shape)


def on_triangles(points, corners, faces, uv):
    """Return the positions (u, v) of points that lie on triangles, by testing the triangles of near vertices."""
    near = scipy.spatial.cKDTree(corners).query(points, k=12)[1]
    of_vertex = [np.flatnonzero((faces == vertex).any(axis=1)) for vertex in range(len(corners))]
    found = np.full((len(points), 2), np.nan)
    for n, point in enumerate(points):
        for triangle in np.unique(np.concatenate([of_vertex[vertex] for vertex in near[n]])):
            system = np.vstack([corners[faces[triangle]].T, np.ones(3)])
            weights, *_ = np.linalg.lstsq(system, np.append(point, 1), rcond=None)
            if weights.min() > -1e-6 and np.abs(system @ weights - np.append(point, 1)).max() < 1e-6:
                found[n] = weights @ uv[faces[triangle]]
                break
    return found


@pytest.mark.medium
def test_layers_are_sampled_at_their_centres(fold, bold):
    _, flat_map = fold
    stack = flat_map.images(bold, depths=4)
    np.testing.assert_array_equal(stack.data, flat_map.images(bold, fraction=(0.125, 0.375, 0.625, 0.875)).data)
    assert stack.data.shape == (3, 4, *flat_map.raster().shape)
    mean = flat_map.images(bold, depths=4, projection="mean")
    with np.errstate(all="ignore"):
        np.testing.assert_allclose(mean.data, np.nanmean(stack.data, axis=1), atol=1e-9)


@pytest.mark.medium
@pytest.mark.parametrize("layering", LAYERINGS)
def test_they_are_the_layers_of_the_rim(fold, layering):
    rim, flat_map = fold
    stack = flat_map.images(rim.depth(layering), depths=5, layering=layering)
    for layer, image in enumerate(stack.data):
        assert np.nanmean(np.abs(image - (layer + 0.5) / 5)) < 0.02


@pytest.mark.medium
def test_nifti_files_are_volumes_in_mm(fold, bold, tmp_path):
    rim, flat_map = fold
    raster, thickness = flat_map.raster(0.4), np.median(rim.surface.thickness)
    for source, more in ((rim.depth(), ()), (bold, (3,))):
        flat_map.images(source, 0.4, depths=COUNT).save(tmp_path / "flat.nii.gz")
        image = nib.load(tmp_path / "flat.nii.gz")
        assert image.shape == (*raster.shape, COUNT, *more)
        assert image.header.get_xyzt_units() == ("mm", "sec" if more else "unknown")
        np.testing.assert_allclose(image.header.get_zooms()[:2], 0.4)
        np.testing.assert_allclose(COUNT * image.header.get_zooms()[2], thickness, rtol=0.02)
        np.testing.assert_allclose(image.header.get_zooms()[3:], [2.0] if more else [])
        np.testing.assert_allclose(image.affine[:2, 3], raster.origin, rtol=1e-6)
        np.testing.assert_allclose(image.affine[2], np.array([0, 0, 1, 0.5]) * image.header.get_zooms()[2], rtol=1e-6)


@pytest.mark.medium
@pytest.mark.parametrize("radius", [None, 5.0])
def test_each_voxel_reads_the_pixel_of_its_column_and_layer(fold, radius):
    rim, flat_map = fold
    if radius is not None:
        flat_map = rim.surface.disk(rim.surface.ids[300], radius).flatten()
    values, raster = drawn(flat_map), flat_map.raster()
    painted = rim.paint(values, flat_map)
    is_grey = rim.layers(COUNT).data > 0
    assert painted.data.dtype == values.dtype
    assert (painted.data[~is_grey] == 0).all()
    is_on = painted.data[is_grey] > 0
    layer, row, column = np.unravel_index(painted.data[is_grey][is_on] - 1, values.shape)
    assert is_on.mean() > (0.97 if radius is None else 0.2)
    np.testing.assert_array_equal(layer + 1, rim.layers(COUNT).data[is_grey][is_on])
    uv = on_triangles(rim.values.halfway, flat_map.points, flat_map.faces.astype(int), flat_map.uv)
    is_exact = np.isfinite(uv[:, 0])
    assert is_on[is_exact].all()
    beside = rim.values.halfway[is_on & ~is_exact]  # half a voxel beyond the outline
    assert scipy.spatial.cKDTree(flat_map.points).query(beside)[0].max(initial=0) < 0.7
    at = (raster.origin[1] - uv[is_exact, 1]) / 0.25, (uv[is_exact, 0] - raster.origin[0]) / 0.25
    nearest = tuple(np.rint(one).astype(int) for one in at)
    inside = raster.inside[nearest]
    assert inside.all() if radius is None else 0.9 < inside.mean() < 1
    for own, found in zip(nearest, (row[is_exact[is_on]], column[is_exact[is_on]]), strict=True):
        assert (own == found)[inside].mean() > 0.999  # points on a cut have two places
        assert np.abs(own - found)[~inside].max(initial=0) <= 2  # the outline cuts through these pixels
    assert raster.inside[row, column].all()


def test_round_trip(fold):
    rim, flat_map = fold
    layers = rim.layers(COUNT)
    assert (rim.paint(flat_map.images(layers, depths=COUNT), flat_map).data == layers.data).mean() > 0.95
    i, _, k = np.indices(layers.data.shape) // 6
    blocks = Volume(np.where(layers.data > 0, 1 + i + 10 * k, 0).astype(np.uint8), layers.affine)
    back = rim.paint(flat_map.images(blocks, depths=COUNT), flat_map)
    assert back.data.dtype == np.int32
    assert (back.data == blocks.data)[layers.data > 0].mean() > 0.93


def test_all_forms_of_a_flat_volume_give_the_same(fold, tmp_path):
    rim, flat_map = fold
    stack = flat_map.images(rim.thickness(), 0.4, depths=COUNT, layering="equidistant")
    how = {"layering": "equidistant", "background": -1.0}
    expected = rim.paint(stack, flat_map, **how).data
    assert expected.min() == -1
    stack.save(tmp_path / "flat.nii.gz")
    stack.save(tmp_path / "flat.npy")
    for values in (tmp_path / "flat.nii.gz", nib.load(tmp_path / "flat.nii.gz"), tmp_path / "flat.npy", stack.data):
        found = rim.paint(values, flat_map, pixel_size=0.4, **how).data
        np.testing.assert_allclose(found, expected, rtol=1e-6)


@pytest.mark.medium
def test_wrong_flat_volumes(fold, tmp_path):
    rim, flat_map = fold
    values, disk = drawn(flat_map), rim.surface.disk(rim.surface.ids[300], 3.0).flatten()
    stack = flat_map.images(rim.depth(), depths=COUNT)
    stack.save(tmp_path / "flat.nii")
    labels = "sampled at the depth .equivolume .* instead of .equidistant"
    for message, given, of, how in (
        ("the map is 3. Pass a FlatMap", values, 3, {}),
        ("pixels, but the map has", values[:, 1:], flat_map, {}),
        ("pixels, but the map has", values, flat_map, {"pixel_size": 0.5}),
        ("Select one 3-D volume", values[0], flat_map, {}),
        ("Select one 3-D volume", np.stack([values] * 2), flat_map, {}),
        (labels, stack, flat_map, {"layering": "equidistant"}),
        (labels, tmp_path / "flat.nii", flat_map, {"layering": "equidistant"}),
        ("instead of .equivolume 0.0833", flat_map.images(rim.depth(), fraction=(0.1,) * 6), flat_map, {}),
        ("layering is", values, flat_map, {"layering": "thick"}),
        ("background is 0.5, which int32 cannot hold", values, flat_map, {"background": 0.5}),
        ("background is 'x'. Pass a number", values, flat_map, {"background": "x"}),
        ("pixels, but the map has", stack, disk, {}),
    ):
        refused(message, rim.paint, given, of, **how)
    moved = Volume(np.moveaxis(values, 0, 2), np.array([[0, 0.25, 0, 7], [-0.25, 0, 0, 2], [0, 0, 1, 0], [0, 0, 0, 1]]))
    refused("another origin than the map", rim.paint, moved, flat_map)
    other = voxflat.rim(Volume(rim.labels.volume.data, np.diag([0.5, 0.5, 0.5, 1]) + 90 * np.eye(4, k=3)))
    refused("no column of the rim lies on the map", other.paint, values, flat_map)
    for count in (0, 1001, 2.5, "3", True):
        refused("depths is", flat_map.images, rim.depth(), depths=count)
    refused("fraction and depths .* cannot be combined", flat_map.images, rim.depth(), depths=3, fraction=0.5)
    refused("depth .* and depths .* cannot be combined", flat_map.images, rim.depth(), depths=3, depth=1.0)
    refused("requires white and pial", voxflat.samples.hill().flatten().images, rim.depth(), depths=3)


def test_a_disk_around_a_voxel(fold):
    rim, _ = fold
    centre = rim.surface.ids[300]
    flat_map = rim.surface.disk(centre, 3.0).flatten()
    painted = rim.paint(drawn(flat_map), flat_map).data
    is_grey = rim.layers(1).data > 0
    (start, *_) = np.flatnonzero((rim.surface.ids == centre).all(axis=1))
    away = np.linalg.norm(rim.values.halfway - rim.surface.points[start], axis=1)
    is_painted = painted[is_grey] > 0
    assert away[is_painted].max() < 3.0 + 0.25 + 1e-3
    assert is_painted[away < 2.0].mean() > 0.9


@pytest.mark.medium
def test_the_command_line(fold, tmp_path):
    labels = fold[0].labels.volume
    rim, flat, out = tmp_path / "rim.nii.gz", tmp_path / "flat.nii.gz", tmp_path / "out.nii.gz"
    voxflat.io.write_volume(rim, labels.data, labels.affine)
    centre = fold[0].surface.ids[300].tolist()
    disk = ("--seed-point", ",".join(map(str, centre)), "--radius", 4)
    succeed("flatten", rim, "--rim", *disk, "-o", tmp_path / "map.npz")
    flat_map = voxflat.load(tmp_path / "map.npz")
    np.testing.assert_array_equal(flat_map.uv, fold[0].surface.disk(centre, 4.0).flatten().uv)
    image = ("image", tmp_path / "map.npz", "--volume", rim, "-o", flat)
    succeed(*image, "--depths", COUNT)
    succeed("paint", rim, "--map", tmp_path / "map.npz", "--values", flat, "--background", 9, "-o", out)
    expected = fold[0].paint(flat, flat_map, background=9)
    np.testing.assert_array_equal(voxflat.io.read_volume(out).data, expected.data)
    assert set(np.unique(expected.data[labels.data == 3])) >= {3, 9}
    array = tmp_path / "flat.npy"
    succeed(*image[:-1], array, "--depths", COUNT, "--pixel-size", 0.3)
    paint = ("paint", rim, "--map", tmp_path / "map.npz", "--values", array, "-o", out)
    fail(1, "pixels, but the map has", *paint)
    succeed(*paint, "--pixel-size", 0.3)
    painted = fold[0].paint(np.load(array), flat_map, pixel_size=0.3)
    np.testing.assert_array_equal(voxflat.io.read_volume(out).data, painted.data)
    for wrong in (("--depths", 2, "--fraction", 0.5), ("--depths", 2, "--depth", 1), ("--layering", "equivolume")):
        fail(2, "Pass only one of them" if len(wrong) > 2 else "--fraction or --depths", *image, *wrong)
    fail(1, "it is an input", "paint", rim, "--map", tmp_path / "map.npz", "--values", flat, "-o", flat)
