import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as nps
from refusals import refused
from scipy import ndimage

import voxflat
from voxflat import _core
from voxflat.surfaces import foreground as module
from voxflat.surfaces.foreground import foreground, labels_in, touching_labels

INTEGERS = st.sampled_from(["bool", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"])


@given(INTEGERS.flatmap(lambda dtype: nps.arrays(dtype, (3, 4, 5))))
def test_labels_are_counted(data):
    values, counts = np.unique(data, return_counts=True)
    assert labels_in(data) == {int(v): int(n) for v, n in zip(values, counts, strict=True) if v != 0}


@pytest.fixture(scope="module")
def thin_slabs():
    """Divide volumes into slabs of one layer."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_SLAB", 1)
        yield


@given(
    nps.arrays(np.uint8, (3, 4, 5), elements=st.integers(0, 99)),
    st.sampled_from(["bool", "uint8", "int64", "float16", "float32", "float64"]),
)
def test_labels_are_the_same_in_slabs(thin_slabs, data, kind):
    data = data.astype(kind)
    mask = data[::-1] > 0
    inside = np.where(mask, data, 0)
    for given_mask, values in ((None, data), (mask, inside)):
        counts = {int(value): int((values == value).sum()) for value in np.unique(values) if value}
        found = labels_in(data, given_mask)
        assert list(found.items()) == sorted(counts.items())


def test_distant_whole_numbers_of_half_precision_are_labels():
    assert labels_in(np.array([[[-1.0, 2048.0, 2048.0]]], dtype=np.float16)) == {-1: 1, 2048: 2}
    assert labels_in(np.array([[[1e30, 1e30, 0.0]]])) == {int(1e30): 2}


@given(labels=nps.arrays(np.int8, (3, 4, 5), elements=st.integers(0, 3)), only=st.integers(1, 3))
def test_labels_touch_if_they_share_a_face(thin_slabs, labels, only):
    mask = (labels > 0) & (labels != only)
    counts = {label: int((mask & (labels == label)).sum()) for label in (1, 2, 3)}
    large = [label for label, count in counts.items() if count and count >= 0.2 * mask.sum()]
    layers = [np.moveaxis(labels, axis, 0) for axis in range(3)]
    pairs = {pair for of in layers for pair in zip(of[:-1].ravel(), of[1:].ravel(), strict=True)}
    pairs |= {(b, a) for a, b in pairs}
    expected = [a for a in large if any((a, b) in pairs for b in large if b != a)]
    assert touching_labels(labels, mask) == expected


@given(
    shape=st.tuples(*[st.integers(1, 12)] * 3),
    density=st.floats(0, 1),
    order=st.permutations(range(3)),
    seed=st.integers(0, 2**32 - 1),
)
def test_components_are_those_of_scipy(shape, density, order, seed):
    mask = np.random.default_rng(seed).random(shape).transpose(order) <= density
    mask.flat[0] = True
    counts = np.bincount(ndimage.label(mask)[0].ravel())[1:]
    assert sorted(_core.component_sizes(mask).tolist()) == sorted(counts.tolist())


@pytest.mark.parametrize("kind", [np.int16, np.float32, np.float64])
def test_the_order_in_memory_does_not_matter(kind):
    data = (100 * np.exp(-(((np.indices((20, 22, 24)) - 10) / 6) ** 2).sum(axis=0))).astype(kind)
    one, other = (voxflat.surface(values, threshold=50) for values in (data, np.asfortranarray(data)))
    np.testing.assert_array_equal(one.points, other.points)
    assert (one.metadata, one.provenance) == (other.metadata, other.provenance)


@given(nps.arrays(np.int16, (3, 4, 5), elements=st.integers(-2, 2)), st.integers(-3, 3))
def test_a_label_or_a_threshold_selects(data, value):
    for options, expected in (({"label": value}, data == value), ({"threshold": value}, data > value)):
        if expected.any():
            np.testing.assert_array_equal(foreground(data, **options), expected)
        else:
            refused("no voxel", foreground, data, **options)


@pytest.mark.parametrize("kind", [bool, np.uint8, np.int64, np.float16, np.float64])
@pytest.mark.parametrize("label", [2**64, -(10**400)])
def test_labels_beyond_the_values_type_are_of_no_voxel(kind, label):
    refused("no voxel has label", foreground, np.ones((2, 2, 2), dtype=kind), label=label)


def test_whole_floats_are_labels_and_others_are_not():
    assert labels_in(np.array([[[0.0, 3.0, 3.0]]])) == {3: 2}
    assert labels_in(np.array([[[0.0, 3.5]]])) is None
    assert labels_in(np.arange(5000.0).reshape(5, 10, 100)) is None  # intensities that happen to be whole
    labels = np.array([[[0.0, 1.0, 2.0]]])
    refused("pass a label or a threshold; the volume has labels 1, 2", foreground, labels)
    intensities = np.arange(8**3, dtype=np.uint16).reshape(8, 8, 8)
    told = "pass a label or a threshold; the values are 511 whole numbers from 1 to 511, labels or intensities"
    refused(told, foreground, intensities)  # nothing about labels of FreeSurfer, such as 2 and 41


def test_nothing_of_half_precision_is_above_what_it_cannot_hold():
    refused("no voxel is above the threshold 100000", foreground, np.ones((2, 2, 2), np.float16), threshold=1e5)


def near(points, shape=(80, 50, 50)):
    """Return the voxels within a distance of points (x, y, z, distance)."""
    places = np.indices(shape)
    return (
        sum(np.linalg.norm(places - np.reshape(point, (3, 1, 1, 1)), axis=0) < radius for *point, radius in points) > 0
    )


def bent(x, y, z):
    return (x / 38) ** 2 + ((y + 8 * np.cos(x / 20)) / 12) ** 2 + (z / 10) ** 2 < 1


SOLIDS = {
    "touching": (near([(20, 25, 25, 15), (44, 25, 25, 12)]), "two parts (66 and 34 % of its voxels)"),
    "by one voxel": (near([(16, 25, 25, 10.5), (36, 25, 25, 10.5)]), "two parts (50 and 50 % of its voxels)"),
    "apart": (near([(16, 25, 25, 10), (46, 25, 25, 10)]), None),
    "ball": (near([(25, 25, 25, 20)]), None),
    "wide contact": (near([(24, 25, 25, 14), (36, 25, 25, 14)]), None),
    "small beside large": (near([(24, 25, 25, 20), (50, 25, 25, 7)]), None),
    "bean": (bent(*(np.indices((80, 40, 40)) - np.array([40, 20, 20])[:, None, None, None])), None),
    "sheet": (np.abs(np.indices((80, 40, 40))[2] - 20 - 4 * np.sin(np.indices((80, 40, 40))[0] / 9)) < 3, None),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SOLIDS)
@pytest.mark.parametrize("spacing", [(1, 1, 1), (1, 1, 3)])
def test_two_objects_that_touch_are_pointed_out(name, spacing):
    mask, told = SOLIDS[name]
    advice = "\n".join(voxflat.check(np.pad(mask, 1)[:, :, :: spacing[2]], spacing=spacing).advice)
    assert ("If two objects touch there" in advice) == (told is not None)
    if spacing == (1, 1, 1):
        assert (told or "") in advice


def organs(apart=(0, 0, 0), sizes=(6, 5), dtype=np.uint8):
    """Return two blocks with the labels 4 and 9; the second begins at the far corner of the first, moved by `apart`."""
    labels = np.zeros((20, 20, 20), dtype=dtype)
    labels[2 : 2 + sizes[0], 2:8, 2:8] = 4
    x, y, z = np.add(apart, (2 + sizes[0], 3, 3))
    labels[x : x + sizes[1], y : y + 5, z : z + 5] = 9
    return labels


@pytest.mark.medium
@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.float32])
@pytest.mark.parametrize("options", [{"threshold": 0.5}, {"label": [4, 9]}, {"label": [9, 4]}])
def test_labels_that_touch_and_form_one_surface_are_named(options, dtype):
    told = "labels 4 and 9 touch, so they form one surface. If they are different objects, choose one label"
    surface = voxflat.surface(organs(dtype=dtype), **options)
    assert surface.warnings == (told,)
    advice = surface.check().advice
    assert told in advice
    assert not any("If two objects touch there" in one for one in advice)
    three = organs(dtype=dtype)
    three[2:8, 8:13, 2:8] = 6
    warnings = voxflat.surface(three, threshold=0.5).warnings
    assert "labels 4, 6 and 9 touch, so they form one surface" in warnings[0]


@pytest.mark.parametrize(
    ("labels", "options"),
    [
        (organs(), {"label": 4}),
        (organs((1, 0, 0)), {"threshold": 0.5}),
        (organs(sizes=(12, 1)), {"threshold": 0.5}),  # 25 of 457 voxels: a part of the same object
        (np.where(organs(), 1.0 + np.indices((20, 20, 20))[0] / 30, 0), {"threshold": 0.5}),
        (np.pad(np.indices((18, 18, 18)).sum(axis=0), 1), {"threshold": 9}),
    ],
)
def test_one_label_labels_apart_small_labels_and_intensities_are_no_joined_labels(labels, options):
    told = " ".join(voxflat.surface(labels, **options).warnings)
    assert "so they form one surface" not in told
