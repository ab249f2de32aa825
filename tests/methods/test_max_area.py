"""A bound on area changes holds for every triangle of the map, or an error is raised."""

import pickle

import numpy as np
import pytest
from hard_shapes import signed_areas, turned
from refusals import refused
from textures import areas

import voxflat
from voxflat import InputError
from voxflat.methods import Voxflat


def cap(degrees, radius=20.0):
    """Return a spherical cap with the given angle from its pole to its border."""
    polar = np.radians(np.linspace(degrees, 0, 17)[:-1])
    return turned([(radius * np.sin(angle), radius * np.cos(angle)) for angle in polar], 36, closed=True)


def changes(flat):
    """Return the factor by which the area of each triangle changes, at the scale that preserves the total area."""
    on_surface, on_map = areas(flat.points, flat.faces), np.abs(signed_areas(flat.uv, flat.faces))
    ratio = on_map / on_map.sum() * on_surface.sum() / on_surface
    return np.maximum(ratio, 1 / ratio)


@pytest.mark.medium
def test_no_triangle_is_beyond_the_bound():
    surface = cap(115)
    usual = voxflat.flatten(surface, method=Voxflat(sources=60), relax=False)
    assert changes(usual).max() > 1.2
    assert "area_change" not in usual.metadata
    for bound in (1.2, 1.1):
        flat = voxflat.flatten(surface, method=Voxflat(sources=60, max_area=bound), relax=False)
        assert changes(flat).max() <= bound
        assert flat.metadata["max_area"] == bound
        assert flat.metadata["area_change"] == pytest.approx(changes(flat).max(), rel=1e-9)
        assert (flat.distortion.triangles.flipped, flat.distortion.triangles.covering) == (0, 0)
        assert flat.distortion.best_scale.relative_error < 1.3 * usual.distortion.best_scale.relative_error


def test_a_bound_that_is_kept_anyhow_changes_nothing():
    surface = cap(40)
    usual = voxflat.flatten(surface, method=Voxflat(sources=60), relax=False)
    flat = voxflat.flatten(surface, method=Voxflat(sources=60, max_area=3), relax=False)
    np.testing.assert_array_equal(flat.uv, usual.uv)


@pytest.mark.slow
def test_what_cannot_be_had_is_refused_with_the_best_and_cuts_that_help():
    surface = cap(172)
    message = r"one triangle changes by .* Add the cuts that voxflat\.worst_places suggests"
    with pytest.raises(voxflat.AreaBoundError, match=message) as found:
        voxflat.flatten(surface, method=Voxflat(sources=60, max_area=1.2), relax=False)
    error = found.value
    assert isinstance(error, InputError)
    assert changes(error.best).max() == pytest.approx(error.best.metadata["area_change"], rel=1e-9)
    assert changes(error.best).max() > 1.2
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), len(again.best)) == (str(error), len(error.best))
    assert error.places.places
    assert error.places.places[0].cut is not None
    assert all(len(path) > 1 for path in error.places.cuts())


@pytest.mark.parametrize("bound", [1, 0.5, np.nan, np.inf, "2", True, [2.0]])
def test_a_bound_that_is_none_is_refused(bound):
    refused("max_area is", Voxflat, max_area=bound)
