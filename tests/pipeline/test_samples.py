"""The synthetic embryo is what its documentation says."""

import numpy as np
import pytest
import scipy
from refusals import refused

import voxflat
from voxflat import samples


def distances(surface, places):
    return voxflat._core.NearestFinder(surface.points, np.ascontiguousarray(surface.faces)).find(places, np.inf)[2]


@pytest.fixture(scope="module")
def embryo():
    return samples.embryo(frames=3)


@pytest.mark.medium
def test_the_nuclei_of_each_frame_are_on_its_surface(embryo):
    for labels, points in zip(embryo.labels, embryo.points, strict=True):
        apart = distances(voxflat.surface(labels), points)
        assert np.median(apart) < 0.4  # µm
        assert np.percentile(apart, 95) < 1.25  # half of a voxel of 2.5 x 2.5 x 5 µm


def test_each_nucleus_is_brighter_than_the_tissue_around_it(embryo):
    for image, points in zip(embryo.images, embryo.points, strict=True):
        brightest = scipy.ndimage.maximum_filter(image.data, 3)
        places = np.round((points - image.affine[:3, 3]) / image.spacing).astype(int)
        assert np.percentile(brightest[tuple(places.T)], 5) > 45  # the tissue itself is at most 0.12 of 255


def test_the_embryo_grows_bends_and_stays_within_its_volume(embryo):
    volumes = [labels.data.sum() * np.prod(labels.spacing) for labels in embryo.labels]
    assert volumes[0] == pytest.approx(4 / 3 * np.pi * 90 * 40 * 35, rel=0.02)
    assert volumes[-1] == pytest.approx(1.25 * 1.1**2 * volumes[0], rel=0.02)
    for labels in embryo.labels:
        places = np.argwhere(labels.data)
        assert (places.min(axis=0) > 0).all()
        assert (places.max(axis=0) < np.array(labels.data.shape) - 1).all()


def test_the_movie_is_small_reproducible_and_in_micrometres(embryo):
    again = samples.embryo(frames=3)
    for one, other in zip((*embryo.images, *embryo.labels), (*again.images, *again.labels), strict=True):
        assert one.unit == "µm"
        assert one.data.nbytes < 200_000
        np.testing.assert_array_equal(one.data, other.data)
    assert len(samples.embryo(1).labels) == 1


@pytest.mark.parametrize("frames", [0, -1, 2.5, True, "6"])
def test_other_numbers_of_frames_are_refused(frames):
    refused("Pass a positive whole number", samples.embryo, frames)


@pytest.mark.slow
def test_the_positions_show_how_well_a_movie_is_followed(embryo):
    series = voxflat.flatten_series([voxflat.surface(labels) for labels in embryo.labels])
    faces = np.ascontiguousarray(series.flat_map.faces)
    triangles, weights, _ = voxflat._core.NearestFinder(series.points[0], faces).find(embryo.points[0], np.inf)
    for frame in (1, 2):
        found = np.einsum("pc,pcx->px", weights, series.points[frame][faces[triangles]])
        drift = np.linalg.norm(found - embryo.points[frame], axis=1)
        assert np.median(drift) < 0.03 * np.ptp(embryo.points[frame][:, 0])
