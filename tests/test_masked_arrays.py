"""Masked entries of NumPy arrays become NaN where a missing value has a meaning, and are refused elsewhere."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from refusals import refused

import voxflat
from voxflat import figures, io
from voxflat.samples import hill

FLAT = hill().flatten()
SURFACE = hill()
N = FLAT.metadata["vertices"]


def masked(values, first=3):
    """Return values of which the first few are masked, and of which the data below the mask are plausible."""
    array = np.ma.masked_array(values)
    array[np.unravel_index(np.arange(first), array.shape)] = np.ma.masked
    return array


POINTS, FACES, VALUES = SURFACE.points, SURFACE.faces.astype(np.int64), np.linspace(1.0, 2.0, N)
BALL = voxflat.samples.ball()
PIXELS = FLAT.raster().shape

AS_NAN = {
    "image": lambda v: FLAT.image(v).data,
    "images": lambda v: FLAT.images(np.ma.column_stack([v, v])).data,
    "list of channels": lambda v: FLAT.images(v[:, None])[0].data,
    "interpolate": lambda v: FLAT.raster().interpolate(v[FLAT.ids]),
}

REFUSED = {
    "points of a surface": lambda: voxflat.surface((masked(POINTS), FACES)),
    "triangles of a surface": lambda: voxflat.surface((POINTS, masked(FACES))),
    "Mesh": lambda: io.Mesh(masked(POINTS), FACES),
    "volume": lambda: voxflat.surface(masked(BALL)),
    "Volume": lambda: io.Volume(masked(BALL), np.eye(4)),
    "write_volume": lambda: io.write_volume("never.nii", masked(BALL), np.eye(4)),
    "labels at vertices": lambda: FLAT.image(masked(np.arange(N))),
    "colours": lambda: FLAT.image(masked(np.zeros((N, 3), np.uint8))),
    "volume of an image": lambda: FLAT.image(masked(BALL.astype(float))),
    "keep": lambda: SURFACE.keep(masked(np.arange(N) < N // 2)),
    "keep numbers": lambda: SURFACE.keep(masked(np.arange(50))),
    "drop": lambda: SURFACE.drop(masked(np.arange(N) < 9)),
    "find": lambda: SURFACE.find(masked(np.arange(9))),
    "disk": lambda: SURFACE.disk(masked(np.array([5, 6, 7])), 4.0),
    "polygon": lambda: SURFACE.polygon(masked(np.array([0, 40, 80, 120]))),
    "cuts": lambda: SURFACE.cut(cuts=[masked(np.array([5, 6, 7, 8]))]),
    "geodesic": lambda: SURFACE.geodesic(masked(np.arange(9))),
    "points_to_map": lambda: FLAT.points_to_map(masked(POINTS[:5])),
    "points in a list": lambda: FLAT.points_to_map([masked(point, 1) for point in POINTS[:5]]),
    "look_up": lambda: FLAT.look_up(masked(FLAT.uv[:5])),
    "vectors_to_map": lambda: FLAT.vectors_to_map(POINTS[:5], masked(POINTS[:5])),
    "vectors_to_surface": lambda: FLAT.vectors_to_surface(FLAT.uv[:5], masked(FLAT.uv[:5])),
    "polygons": lambda: FLAT.regions({"a": masked(np.array([[-5.0, -5], [5, -5], [0, 5], [1, 1]]))}),
    "label image": lambda: FLAT.regions(masked(np.ones(PIXELS, int))),
    "texture": lambda: FLAT.texture(masked(np.zeros((20, 20, 3), np.uint8))),
    "measure": lambda: voxflat.measure(SURFACE, masked(FLAT.uv)),
    "measure with triangles": lambda: voxflat.measure(SURFACE, (masked(FLAT.uv), FLAT.faces)),
    "measure with vertices": lambda: voxflat.measure(SURFACE, (FLAT.uv, FLAT.faces, masked(FLAT.ids))),
    "mask of a range image": lambda: voxflat.range_image(np.zeros((9, 9)), 1.0, mask=masked(np.ones((9, 9), bool))),
    "parcels": lambda: figures.flat_map(FLAT, parcels=masked(np.ones(N, int))),
}


@pytest.mark.parametrize("door", AS_NAN)
def test_masked_floats_at_vertices_are_nan(door):
    given = masked(VALUES, 40)
    found, expected = AS_NAN[door](given), AS_NAN[door](np.ma.masked_array(given.filled(np.nan)))
    assert np.isnan(found).sum() > np.isnan(AS_NAN[door](np.ma.masked_array(VALUES))).sum()
    assert_array_equal(found, expected)


@pytest.mark.parametrize("door", REFUSED)
def test_masked_entries_are_refused_where_a_missing_value_has_no_meaning(door):
    refused("mask", REFUSED[door])


def test_masked_arrays_without_masked_entries_are_arrays():
    assert_array_equal(FLAT.image(np.ma.masked_array(VALUES)).data, FLAT.image(VALUES).data)
    assert len(voxflat.surface((np.ma.masked_array(POINTS), np.ma.masked_array(FACES)))) == len(SURFACE)
