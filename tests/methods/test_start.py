"""Optimisation continues from a given flat map."""

import itertools
from dataclasses import replace

import composed
import hard_shapes
import numpy as np
import pytest
from hard_shapes import signed_areas
from refusals import refused

import voxflat
from voxflat.methods import Voxflat

COLUMNS = 41


def hill(columns=COLUMNS):
    """Return a hump on a square grid of 1 mm."""
    grid = (columns - 1, columns - 1), (columns, columns)
    return hard_shapes.sheet(lambda u, v: (u, v, 14 * np.exp(-((u - 18) ** 2 + (v - 22) ** 2) / 90)), *grid)


SURFACE = hill()


@pytest.fixture(scope="module")
def known():
    return voxflat.flatten(SURFACE, method=Voxflat(sources=60))


def energy(flat):
    return flat.metadata["descent"]["energies"][-1]


def is_good(flat):
    triangles = flat.distortion.triangles
    folds = (triangles.flipped, triangles.covering, triangles.crossings)
    return (signed_areas(flat.uv, flat.faces) > 0).all() and folds == (0, 0, 0)


def begun(start, **options):
    return composed.flatten(SURFACE, start=start, sources=60, **options)


@pytest.mark.medium
def test_a_map_that_is_done_ends_at_once_where_it_is(known):
    again = begun(known)
    assert energy(again) == pytest.approx(energy(known), rel=1e-4)
    assert len(again.metadata["descent"]["energies"]) <= 8 < len(known.metadata["descent"]["energies"])
    assert again.metadata["start"] is True
    assert "start" not in known.metadata
    assert np.abs(again.uv - known.uv).max() < 0.2  # it lies as the start does


@pytest.mark.slow
@pytest.mark.parametrize(
    ("moved", "hand"),
    [
        (lambda uv: 17 - 3.5 * uv, 1),
        (lambda uv: uv[:, ::-1] * [1, 40], -1),
        (lambda uv: uv * [-1e-3, 1e-3], -1),
        (lambda uv: uv * 1e250, 1),
    ],
)
def test_a_start_may_lie_anywhere_at_any_scale_and_mirrored(known, moved, hand):
    again = begun(moved(known.uv))
    assert energy(again) == pytest.approx(energy(known), rel=1e-3)
    assert is_good(again)
    np.testing.assert_array_equal(begun(moved(known.uv), mirror=True).uv, again.uv * [-1, 1])


@pytest.mark.medium
@pytest.mark.parametrize(("shift", "folds"), [(0.2, 0), (0.9, 100)])
def test_a_shaken_map_comes_back_and_its_folds_are_mended(known, shift, folds):
    inside = np.pad(np.ones((COLUMNS - 2, COLUMNS - 2)), 1).reshape(-1, 1)
    shaken = known.uv + inside * np.random.default_rng(1).uniform(-shift, shift, known.uv.shape)
    assert ((signed_areas(shaken, known.faces) < 0).sum() > 100) == (folds > 0)
    again = begun(shaken)
    assert again.metadata["descent"]["energies"][0] > 1.05 * energy(known)
    assert energy(again) == pytest.approx(energy(known), rel=1e-3)
    assert is_good(again)


@pytest.mark.slow
def test_where_the_finest_level_cannot_be_mended_a_coarser_one_is():
    surface = hill(75)
    known = voxflat.flatten(surface, method=Voxflat(sources=60))
    shaken = known.uv + np.random.default_rng(1).uniform(-0.9, 0.9, known.uv.shape)
    stages = []
    method = Voxflat(sources=60, start=shaken)
    again = voxflat.flatten(surface, method=method, progress=lambda stage, *_: stages.append(stage))
    assert "optimising distances and shapes on a coarse level" in stages
    assert "unfolding" not in stages
    assert energy(again) == pytest.approx(energy(known), rel=1e-3)
    assert is_good(again)


@pytest.mark.medium
def test_what_cannot_be_mended_is_refused(known):
    rolled = np.stack([np.cos(known.uv[:, 0]), known.uv[:, 1]], 1)
    refused(r"the start has \d+ flipped triangles that cannot be unfolded", begun, rolled)
    angle = np.ptp(known.uv[:, 0]) ** -1 * 7.5 * (known.uv[:, 0] - known.uv[:, 0].min())  # more than once around
    radius = 60 - known.uv[:, 1]
    wound = np.stack([radius * np.cos(angle), radius * np.sin(angle)], 1)
    refused(r"the boundary of the start crosses or touches itself \d+ times", begun, wound)
    refused("the start has almost no area", begun, known.uv * [1, 0])


@pytest.mark.medium
def test_a_start_of_another_surface_is_refused_by_name(known):
    refused("the map has 1600 points, but the surface has 1681 vertices", begun, known.uv[:1600])
    other = known.uv.copy()
    other[7] = np.nan
    told = r"does not contain 3 of the 3200 triangles to be flattened \(for example, the triangle of vertices \[\d"
    refused(told, begun, other, keep=np.ones(len(other), dtype=bool))


@pytest.mark.medium
def test_a_start_says_what_is_flattened_and_where_it_is_cut(tmp_path):
    points, faces = hard_shapes.sheet(lambda u, v: (4 * np.cos(u), 4 * np.sin(u), v), (2 * np.pi, 30.0), (25, 31))
    surface, number = (points[: 24 * 31], faces % (24 * 31)), np.arange(24 * 31).reshape(24, 31)
    first = voxflat.flatten(surface, method=Voxflat(sources=60))
    cuts = [cut["ids"] for cut in first.metadata["automatic_cuts"]]
    first.save(tmp_path / "map.npz")
    for start in (first, tmp_path / "map.npz"):
        again = voxflat.flatten(surface, method=Voxflat(sources=60, start=start))
        assert (again.metadata["cuts_by"], again.metadata["automatic_cuts"]) == ("start", [])
        both = cuts, again.metadata["cuts"]
        edges, found = ({frozenset(pair) for path in paths for pair in itertools.pairwise(path)} for paths in both)
        assert edges == found
        assert len(again) == len(first)
        assert energy(again) == pytest.approx(energy(first), rel=1e-3, abs=1e-6)
    line = number[5] if cuts[0][0] not in number[5] else number[15]
    how = {"method": Voxflat(start=first), "cuts": [line.tolist()], "relax": False}
    refused(r"start is cut at vertex \d+, but the surface is not", voxflat.flatten, surface, **how)


@pytest.mark.slow
def test_a_start_may_be_of_a_part(known):
    kept = np.ones(len(SURFACE[0]), dtype=bool)
    kept[: 3 * COLUMNS] = False
    part = voxflat.surface(SURFACE).keep(kept).flatten(Voxflat(sources=60), relax=False)
    again = voxflat.flatten(SURFACE, method=Voxflat(sources=60, start=part))
    assert np.array_equal(again.ids, part.ids)
    assert energy(again) == pytest.approx(energy(part), rel=1e-3)
    path = [COLUMNS * 18 + n for n in range(12)]  # one more cut, from the border
    further = voxflat.flatten(SURFACE, method=Voxflat(sources=60, start=part), cuts={"further": path})
    assert np.array_equal(np.unique(further.ids), np.unique(part.ids))
    assert further.metadata["cut_names"] == ["further"]
    assert len(further) == len(part) + 11
    smaller = voxflat.surface(SURFACE).keep(kept).flatten(Voxflat(sources=60, start=known), relax=False)
    assert energy(smaller) == pytest.approx(energy(part), rel=1e-3)


def test_voxels_have_starts_too():
    solid = np.zeros((24, 20, 6), np.uint8)
    solid[2:22, 2:18, 2:4] = 1
    first = voxflat.surface(solid).disk((12, 10, 3), 9.0).flatten(Voxflat(sources=40))
    again = voxflat.flatten(solid, method=Voxflat(sources=40, start=first))
    assert np.array_equal(again.ids, first.ids)
    assert energy(again) == pytest.approx(energy(first), rel=1e-3, abs=1e-6)


@pytest.mark.slow
def test_the_lips_of_a_new_cut_open(known):
    path = [COLUMNS * 18 + n for n in range(23)]  # from the border to the top
    cut = begun(known, cuts=[path])
    fresh = voxflat.flatten(SURFACE, method=Voxflat(sources=60), cuts=[path])
    assert len(cut) == len(SURFACE[0]) + 22
    assert is_good(cut)
    assert energy(cut) == pytest.approx(energy(fresh), rel=5e-3)
    assert energy(begun(replace(known, uv=known.uv * 1.5), cuts=[path])) == pytest.approx(energy(cut), rel=1e-3)


@pytest.mark.medium
def test_the_same_start_gives_the_same_bits(known):
    shaken = known.uv + np.random.default_rng(5).uniform(-0.5, 0.5, known.uv.shape)
    one, two = (begun(shaken, threads=threads).uv for threads in (1, 3))
    np.testing.assert_array_equal(one, two)
