"""Columns of rims: connected, evenly spread, and never across a sulcus."""

import numpy as np
import pytest
import scipy
from layers import bent_layers
from refusals import refused

import voxflat
from voxflat.io import Volume

CUBE = np.ones((3, 3, 3))


@pytest.fixture(scope="module")
def sphere():
    """Return the rim of a sphere, with its columns, and the direction from the centre of each grey voxel."""
    labels, *_ = bent_layers("sphere", 0.5)
    rim = voxflat.rim(labels)
    ends = (np.array(labels.data.shape) - 1) * 0.5 / 2
    places = np.argwhere(labels.data == 3) * 0.5 - ends - [0.13, 0.27, -0.31]
    return rim, rim.columns(60, seed=3), places / np.linalg.norm(places, axis=1)[:, None], ends


def assert_connected(columns):
    """Check that the voxels of each column touch each other."""
    for number, box in enumerate(scipy.ndimage.find_objects(columns.volume.data), start=1):
        assert box is not None
        assert scipy.ndimage.label(columns.volume.data[box] == number, CUBE)[1] == 1


@pytest.mark.medium
def test_each_voxel_belongs_to_the_nearest_centre(sphere):
    rim, columns, directions, ends = sphere
    centres = columns.centres - ends - [0.13, 0.27, -0.31]
    centres /= np.linalg.norm(centres, axis=1)[:, None]
    near = directions @ centres.T
    found = columns.volume.data[rim.labels.volume.data == 3]
    assert columns.volume.data.dtype == np.int32
    assert (columns.volume.data[rim.labels.volume.data != 3] == 0).all()
    assert (found == near.argmax(axis=1) + 1).mean() > 0.93  # not where two centres are within a voxel of equally near
    behind = near.max(axis=1) - near[np.arange(len(found)), found - 1]
    assert np.rad2deg(behind.max()) < 5


@pytest.mark.medium
def test_columns_are_connected_and_even(sphere):
    rim, columns, *_ = sphere
    assert_connected(columns)
    assert len(columns) == len(columns.centres) == columns.vertex_columns.max() == 60
    assert columns.areas.sum() == pytest.approx(4 * np.pi * 11.25**2, rel=0.02)
    assert columns.areas.max() < 3 * columns.areas.min()
    vertices = [np.flatnonzero((rim.surface.points == centre).all(axis=1))[0] for centre in columns.centres]
    np.testing.assert_array_equal(columns.vertex_columns[vertices], np.arange(1, 61))


@pytest.mark.medium
@pytest.mark.parametrize("thin", [1.5, 4.0])
def test_no_column_crosses_a_sulcus(thin):
    # two flat banks, 4 mm and `thin` mm thick, with one voxel of fluid between them
    x = np.arange(-6, 7, 0.5)
    labels = np.zeros((len(x), 40, 40), dtype=np.int16)
    labels[np.abs(x) < 0.1] = 1
    banks = (x > 0) & (x <= 4), (x < 0) & (x >= -thin)
    for bank, beyond in zip(banks, (1, -1), strict=True):
        labels[bank] = 3
        labels[np.flatnonzero(bank)[-1 if beyond == 1 else 0] + beyond] = 2
    rim = voxflat.rim(Volume(labels, np.diag([0.5, 0.5, 0.5, 1])))
    columns = rim.columns(area=9.0)
    assert_connected(columns)
    sides = [set(np.unique(columns.volume.data[bank])) - {0} for bank in banks]
    assert not sides[0] & sides[1]
    assert sides[0] | sides[1] == set(range(1, len(columns) + 1))
    assert columns.areas.sum() == pytest.approx(2 * 20**2, rel=0.06)
    assert len(columns) == round(columns.areas.sum() / 9)


@pytest.mark.medium
def test_winding_banks_around_narrow_fluid_stay_apart():
    x, y, _ = np.meshgrid(np.arange(0, 11, 0.4), np.arange(0, 16, 0.4), np.arange(8), indexing="ij")
    middle = x - 5.5 - 0.8 * np.sin(y / 2.5)
    distance = np.where(y > 4, abs(middle), np.hypot(middle, y - 4)) - 0.21  # from fluid that is one voxel wide
    labels = np.select([distance < 0, distance <= 2.5], [1, 3], 2)
    rim = voxflat.rim(Volume(labels, np.diag([0.4, 0.4, 0.4, 1])))
    is_deep = (labels == 3) & (y > 6.5) & (y < 14)
    bank = np.where(is_deep, np.where(middle > 0, 1, 2), 0)
    columns = rim.columns(80).volume.data
    assert not set(columns[bank == 1]) & set(columns[bank == 2])
    depth = 1 - distance / 2.5  # along x, which is nearly perpendicular to the banks
    signal = np.where(middle > 0, 5 + depth, -5 - depth)
    profile = rim.profile(signal, bank, count=5, layering="equidistant")
    for mean, sign in zip(profile.mean, (1, -1), strict=True):
        np.testing.assert_allclose(sign * mean, 5 + profile.depths, atol=0.06)


def test_grey_matter_across_the_fluid_belongs_to_no_column(caplog):
    labels = np.zeros((20, 14, 6), dtype=np.int16)
    for low, high, label in ((0, 2, 2), (2, 7, 3), (7, 8, 1), (10, 11, 1), (11, 17, 3), (17, 20, 1)):
        labels[low:high] = label
    rim = voxflat.rim(labels)
    own, across = labels[:10] == 3, labels[10:] == 3
    columns = rim.columns(6).volume.data
    share = 100 * across.sum() / (own.sum() + across.sum())
    assert f"the depth of {share:.1f} % of the grey matter is uncertain" in caplog.text
    assert f"{share:.1f} % (not connected to a border through grey matter" in caplog.text
    assert (columns[:10][own] > 0).all()
    assert (columns[10:] == 0).all()
    flat_map = rim.surface.flatten()
    shape = flat_map.raster().shape
    painted = rim.paint(np.ones((3, *shape)), flat_map).data
    assert painted[:10][own].all()
    assert not painted[10:].any()
    everything = flat_map.regions(np.ones(shape))
    assert rim.profile(rim.depth(), everything, count=2).voxels.sum() == own.sum()


def reaching(columns, labels, label):
    """Return the number of columns that touch a border."""
    touching = scipy.ndimage.binary_dilation(labels == label, CUBE) & (labels == 3)
    return len(np.setdiff1d(columns.volume.data[touching], 0))


@pytest.mark.medium
def test_columns_reach_both_borders_where_they_narrow(caplog):
    # a thin blade of white matter in a gyrus whose crown is twice as thick as its banks
    x, y, _ = np.meshgrid(np.arange(-4, 22), np.arange(-14, 15), np.arange(6), indexing="ij")
    labels = np.where((np.maximum(x - 8, 0) / 12) ** 2 + (y / 6) ** 2 < 1, 3, 1)
    labels[(x <= 8) & (y == 0)] = 2
    rim = voxflat.rim(labels)
    columns = rim.columns(40)
    assert_connected(columns)
    assert reaching(columns, labels, 2) == reaching(columns, labels, 1) == 40
    assert "do not reach both borders" not in caplog.text
    narrow = rim.columns(200)  # too many for the voxels at the tip of the blade
    missed = 200 - min(reaching(narrow, labels, 2), reaching(narrow, labels, 1))
    assert missed > 0
    assert f"{missed} of 200 columns do not reach both borders" in caplog.text


def test_columns_depend_on_the_seed_alone():
    rim = voxflat.rim(voxflat.samples.rim())
    one, same, other = (rim.columns(40, seed=seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(one.volume.data, same.volume.data)
    assert (one.centres[0] != other.centres[0]).any()


@pytest.mark.medium
def test_no_column_is_empty():
    labels = np.zeros((60, 14, 1), dtype=np.uint8)  # one slice
    for low, high, label in ((2, 4, 2), (4, 8, 3), (8, 10, 1)):
        labels[:, low:high] = label
    rim = voxflat.rim(Volume(labels, np.diag([0.5, 0.5, 2.0, 1])))
    columns = rim.columns(40)
    assert_connected(columns)
    assert set(np.unique(columns.volume.data)) == set(range(41))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "pass either count"),
        ({"count": 3, "area": 2.0}, "pass either count"),
        ({"count": 0}, "count is 0. Pass a whole number of columns"),
        ({"count": 2.5}, "count is 2.5"),
        ({"count": True}, "count is True"),
        ({"count": 10**9}, "1000000000 columns exceed the"),
        ({"area": 0.0}, "area is 0.0. Pass a positive number"),
        ({"area": float("nan")}, "area is nan"),
        ({"area": 1e-12}, "exceed the"),
        ({"area": "2"}, "area is '2'"),
        ({"count": 3, "seed": -1}, "seed is -1"),
    ],
)
def test_wrong_arguments(given, message):
    rim = voxflat.rim(voxflat.samples.rim())
    refused(message, rim.columns, **given)


def test_columns_can_be_cancelled():
    rim = voxflat.rim(voxflat.samples.rim())
    with pytest.raises(voxflat.Cancelled):
        rim.columns(40, progress=lambda *_: False)


@pytest.mark.medium
def test_fragments_get_no_column(sphere, caplog):
    labels, *_ = bent_layers("sphere", 0.5)
    data = labels.data.copy()
    data[:6, :6, :6] = 1
    data[1:5, 1:5, 1:5] = 3
    data[2:4, 2:4, 2:4] = 2
    rim = voxflat.rim(Volume(data, labels.affine))
    assert len(rim.surface.points) == len(sphere[0].surface.points)
    columns = rim.columns(60, seed=3)
    assert (columns.volume.data[:6, :6, :6] == 0).all()
    assert "56 of" in caplog.text
    assert (columns.areas > 0.5 * sphere[1].areas.min()).all()
