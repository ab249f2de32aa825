"""The guarantees of the default method for any surface, and the effects of its options."""

import composed
import hard_shapes
import numpy as np
import pytest
import textures
from hard_shapes import sheet, signed_areas
from refusals import refused

import voxflat
from voxflat.methods import Voxflat


def dome(u, v):
    u, v = u - u.mean(), v - v.mean()
    r = np.hypot(u, v) + 1e-9
    return 20 * np.sin(r / 20) * u / r, 20 * np.sin(r / 20) * v / r, 20 * np.cos(r / 20)


HILL = sheet(dome, (20.0, 15.0), (21, 16))


@pytest.mark.slow
def test_weighting_leads_from_near_to_far_distances():
    # more than a hemisphere, where one is had at the price of the other
    cap = sheet(dome, (52.0, 52.0), (27, 27))
    maps = [voxflat.flatten(cap, method=Voxflat(weighting=weighting)) for weighting in (0, 0.5, 1)]
    figures = [voxflat.measure(cap, flat.uv, sources=200).raw for flat in maps]
    assert np.all(np.diff([one.relative_error_10mm for one in figures]) > 0)
    assert np.all(np.diff([one.relative_error for one in figures]) < 0)
    assert [flat.metadata["weighting"] for flat in maps] == [0, 0.5, 1]
    assert all(flat.distortion.triangles.flipped == 0 for flat in maps)


def test_options_are_refused_before_anything_is_done():
    def progress(stage, done, total):
        raise AssertionError(stage)

    wrong = [("weighting", 2), ("geodesic", "edges"), ("weighting", "near"), ("relax", -1.0), ("relax", np.nan)]
    for name, value in [*wrong, ("scale", "lengths")]:
        refused(f"{name} is", composed.flatten, HILL, progress=progress, **{name: value})


@pytest.mark.slow
def test_distances_that_are_too_long_are_told():
    usual = voxflat.flatten(HILL, method=Voxflat(sources=30))
    assert 0 <= usual.metadata["distance_error"] < 2e-3
    assert not usual.metadata["warnings"]
    slivers = hard_shapes.surface(hard_shapes.slivers)
    asked = voxflat.flatten(slivers, method=Voxflat(geodesic="graph"))
    assert asked.metadata["distance_error"] > 0.02
    assert asked.metadata["geodesic"] == "graph"
    assert any("distances by graph paths have a mean error of" in text for text in asked.metadata["warnings"])
    assert asked.distortion.reference == "exact"  # what is too long does not judge itself
    found = voxflat.flatten(slivers)
    assert found.metadata["distance_error"] < 0.01
    assert found.metadata["geodesic"] == "marching"
    assert any("Distances are measured by fast marching instead" in text for text in found.metadata["warnings"])
    assert found.distortion.reference == "exact"
    for flat in (asked, found):  # the triangles of a sheet determine its map
        assert flat.distortion.raw.relative_error < 1e-5
    exact = voxflat.flatten(slivers, method=Voxflat(geodesic="exact"))
    assert exact.metadata["distance_error"] == 0
    assert (exact.distortion.reference, exact.distortion.sources) == ("exact", 200)
    assert not exact.metadata["warnings"]


@pytest.mark.medium
def test_distances_are_judged_by_exact_ones_where_they_were_asked_for():
    flat = voxflat.flatten(HILL, method=Voxflat(sources=30, geodesic="exact"))
    judged = voxflat.measure(HILL, flat, reference="exact", sources=200, seed=0)
    assert flat.distortion.reference == "exact"
    error, scatter = flat.distortion.raw.relative_error, flat.distortion.standard_error.raw.relative_error
    assert abs(error - judged.raw.relative_error) < 5 * scatter + 1e-6


def test_the_scale_is_of_distances_or_of_areas():
    methods = (Voxflat(sources=60, scale=scale) for scale in ("distances", "areas"))
    distances, areas = (voxflat.flatten(HILL, method=method) for method in methods)
    factor = np.linalg.norm(areas.uv) / np.linalg.norm(distances.uv)
    np.testing.assert_allclose(areas.uv, factor * distances.uv, rtol=0, atol=1e-9)
    assert abs(factor - 1) > 1e-3  # a dome has no map that is right for both
    flat, curved = np.abs(signed_areas(areas.uv, areas.faces)), textures.areas(*HILL)
    assert flat.sum() == pytest.approx(curved.sum(), rel=1e-12)
    assert areas.distortion.triangles.equal_area_scale == pytest.approx(1)
    assert distances.distortion.triangles.equal_area_scale == pytest.approx(factor)
    assert distances.distortion.triangles.equal_area_p95 == pytest.approx(areas.distortion.triangles.areal_p95)
    ratio = flat / curved
    for figure, beyond in (("area_beyond_1_25", 1.25), ("area_beyond_1_5", 1.5), ("area_beyond_2", 2)):
        share = curved[(ratio > beyond) | (ratio < 1 / beyond)].sum() / curved.sum()
        assert getattr(areas.distortion.triangles, figure) == pytest.approx(share, abs=1e-9)
        assert getattr(distances.distortion.triangles, figure) == pytest.approx(share, abs=1e-9)
    assert distances.distortion.best_scale.scale == pytest.approx(1, abs=5e-3)
    assert distances.distortion.raw.relative_error < areas.distortion.raw.relative_error
    assert (distances.metadata["scale"], areas.metadata["scale"]) == ("distances", "areas")
