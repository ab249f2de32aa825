import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as nps
from refusals import refused

import voxflat
from voxflat.surfaces.foreground import foreground, labels_in

INTEGERS = st.sampled_from(["bool", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"])


@given(INTEGERS.flatmap(lambda dtype: nps.arrays(dtype, (3, 4, 5))))
def test_labels_are_counted(data):
    values, counts = np.unique(data, return_counts=True)
    assert labels_in(data) == {int(v): int(n) for v, n in zip(values, counts, strict=True) if v != 0}


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
