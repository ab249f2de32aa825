"""Smoothing along a surface: the width that was asked for, on any triangles; borders; missing values."""

import json

import nibabel as nib
import numpy as np
import pytest
from command_line import succeed
from mesh_files import fsaverage5, icosphere
from refusals import refused

import voxflat

WIDTH = 2 * np.sqrt(2 * np.log(2))


def areas(surface):
    a, b, c = np.moveaxis(surface.points[surface.faces], 1, 0)
    each = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6
    return np.bincount(surface.faces.ravel(), np.repeat(each, 3), len(surface))


def measured_widths(surface, vertices, fwhm):
    """Return the width of the kernel around vertices, from its second moment of exact distances: 2 σ² in a plane."""
    kernels = surface.smooth_values(np.eye(surface.count)[:, surface.ids[vertices]], fwhm)[surface.ids]
    measured = surface.geodesic(surface.ids[vertices], geodesic="exact")  # of the largest component
    squares, rows = np.asarray(measured.rows, dtype=np.float64).T ** 2, surface.find(measured.ids)
    weights = (areas(surface)[:, None] * kernels)[rows]
    return WIDTH * np.sqrt((weights * squares).sum(axis=0) / weights.sum(axis=0) / 2)


@pytest.fixture(scope="module")
def uneven():
    """A sheet whose triangles differ in area by a factor of 25, with 2500 random points."""
    import scipy.spatial

    random = np.random.default_rng(3).random((2500, 2))
    points = 60 * (random + 0.9 * np.column_stack([random[:, 0] ** 2, random[:, 1] ** 2])) / 1.9
    faces = scipy.spatial.Delaunay(points).simplices
    thin = np.ptp(points[faces], axis=1).max(axis=1) < 8  # without slivers along the hull
    return voxflat.surface((np.column_stack([points, np.zeros(2500)]), faces[thin]))


@pytest.mark.slow
def test_the_kernel_has_the_width_that_was_asked_for(uneven):
    inner = np.flatnonzero((np.abs(uneven.points[:, :2] - 30) < 6).all(axis=1))
    widths = measured_widths(uneven, inner[:: len(inner) // 12], 8.0)
    assert np.mean(widths) == pytest.approx(8.0, rel=0.02)
    assert np.abs(widths / 8.0 - 1).max() < 0.1
    for side in ("left", "right"):
        cortex = voxflat.surface(fsaverage5(f"white_{side}"), pial=fsaverage5(f"pial_{side}")).drop("medial wall")
        vertices = np.random.default_rng(0).choice(len(cortex), 40, replace=False)
        for fwhm in (8.0, 12.0):
            assert np.median(measured_widths(cortex, vertices, fwhm)) == pytest.approx(fwhm, rel=0.03), (side, fwhm)


def test_constants_and_integrals_are_kept(uneven):
    values = np.column_stack([np.full(len(uneven), 7.0), np.random.default_rng(0).random(len(uneven))])
    given = np.full((uneven.count, 2), 5.0)
    given[uneven.ids] = values
    smooth = uneven.smooth_values(given, 6.0)[uneven.ids]
    np.testing.assert_allclose(smooth[:, 0], 7.0, rtol=1e-12)
    assert areas(uneven) @ smooth[:, 1] == pytest.approx(areas(uneven) @ values[:, 1], rel=1e-12)
    assert values[:, 1].min() < smooth[:, 1].min() <= smooth[:, 1].max() < values[:, 1].max()


def test_nothing_crosses_the_boundary_of_a_part_or_missing_values():
    """A band around the equator separates the two halves of a sphere, as a dropped region and as NaN."""
    sphere = voxflat.surface(icosphere(10.0))
    z = sphere.points[:, 2]
    band = np.abs(z) < 2
    values = np.where(z > 0, 1.0, -1.0)
    dropped = sphere.drop(np.flatnonzero(band)).smooth_values(values, 20.0)
    missing = sphere.smooth_values(np.column_stack([np.where(band, np.nan, values), values]), 20.0)
    np.testing.assert_array_equal(missing[:, 0], dropped)
    np.testing.assert_array_equal(np.isnan(dropped), band)
    np.testing.assert_allclose(dropped[~band], values[~band], rtol=1e-12)
    assert np.abs(missing[~band, 1]).max() < 0.95  # without the band, both halves mix
    infinite = sphere.smooth_values(np.where(band, np.inf, values), 20.0)
    np.testing.assert_array_equal(infinite, dropped)


def test_results_do_not_depend_on_threads_and_other_columns():
    sphere = voxflat.surface(icosphere(10.0))
    values = np.random.default_rng(0).random((len(sphere), 5))
    smooth = sphere.smooth_values(values, 6.0, threads=1)
    np.testing.assert_array_equal(smooth, sphere.smooth_values(values, 6.0, threads=2))
    for n in range(5):
        np.testing.assert_array_equal(smooth[:, n], sphere.smooth_values(values[:, n], 6.0))


def test_the_command_writes_what_the_method_returns(tmp_path):
    sphere = voxflat.surface(icosphere(10.0))
    sphere.save(tmp_path / "lh.white.surf.gii")
    values = np.random.default_rng(0).random((len(sphere), 2)).astype(np.float32)
    arrays = [
        nib.gifti.GiftiDataArray(column, meta={"Name": name}) for column, name in zip(values.T, "ab", strict=True)
    ]
    nib.save(nib.gifti.GiftiImage(darrays=arrays), tmp_path / "lh.z.func.gii")
    surface = voxflat.surface(tmp_path / "lh.white.surf.gii")
    expected = surface.smooth_values(values, 5.0)
    np.testing.assert_array_equal(surface.smooth_values(tmp_path / "lh.z.func.gii", 5.0), expected)
    args = ("smooth", tmp_path / "lh.white.surf.gii", "--values", tmp_path / "lh.z.func.gii", "--fwhm", 5)
    told = json.loads(succeed(*args, "-o", tmp_path / "s.func.gii", "--json").stdout)
    assert (told["maps"], told["vertices"]) == (2, len(sphere))
    assert sorted(map(str.lower, told["provenance"]["files"])) != []
    image = nib.load(tmp_path / "s.func.gii")
    np.testing.assert_allclose(np.column_stack([array.data for array in image.darrays]), expected, rtol=1e-6)
    assert [array.meta["Name"] for array in image.darrays] == ["a", "b"]
    succeed(*args, "-o", tmp_path / "s.npy")
    np.testing.assert_array_equal(np.load(tmp_path / "s.npy"), expected)


def test_refusals():
    sphere = voxflat.surface(icosphere(10.0))
    values = np.zeros(len(sphere))
    for fwhm in (0, -1.0, np.nan, np.inf, "6"):
        refused("fwhm is", sphere.smooth_values, values, fwhm)
    refused("Pass one number, or one row of numbers, for each", sphere.smooth_values, values[:-1], 5.0)
    with pytest.raises(voxflat.Cancelled):
        sphere.smooth_values(values, 5.0, progress=lambda *_: False)
