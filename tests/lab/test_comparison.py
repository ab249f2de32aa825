"""Outliers and means of a group, compared with NumPy and SciPy and with figures by hand."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import norm

import voxflat
from voxflat.distortion.distortion import _DISTANCES, _TRIANGLES
from voxflat.lab.columns import columns_of, measures_in
from voxflat.lab.comparison import Row, Sums, outliers, outliers_by_chance
from voxflat.lab.group import _with_outliers
from voxflat.lab.results import FIGURES, title_of


@pytest.mark.medium
def test_outliers_by_chance_are_those_of_a_normal_distribution():
    draws = np.random.default_rng(5).standard_normal((1000, 20))
    assert outliers_by_chance(20) == pytest.approx(np.mean([outliers(of).sum() for of in draws]), rel=0.25)
    assert outliers_by_chance(4) == 0
    assert outliers_by_chance(2000) == pytest.approx(2000 * 0.000465, rel=0.2)  # P(|z| > 3.5)


def test_outliers_are_3_5_standard_deviations_of_a_normal_distribution_away():
    limit = 3.5 / norm.ppf(0.75)  # the median absolute deviation of these values is 1
    for x, is_outlier in ((0.999 * limit, False), (1.001 * limit, True)):
        values = 7 + np.array([0, -1, 1, -1, 1, np.nan, -1, 1, -x, x])
        assert_array_equal(outliers(values), [False] * 8 + [is_outlier] * 2)
    assert not outliers(np.ones(9)).any()


def test_outliers_of_a_study_are_high_or_low_among_the_hemispheres_of_their_side():
    def row(number, letter, error, flipped=0):
        record = {"figures": {"best_scale": {"relative_error": error}, "triangles": {"flipped": flipped}}}
        return Row(f"sub-{number}", "", letter, "", record)

    errors = (0.050, 0.051, 0.052, 0.053, 0.054, 0.1, 5.0, 0.001)  # the mean is larger than 0.1
    left = [row(n, "L", error, flipped=n == 2) for n, error in enumerate(errors)]
    right = [row(n, "R", error) for n, error in enumerate((0.1, 0.1, 0.11, 0.12, 0.09))]
    found = [row.outliers.get("best_scale.relative_error") for row in _with_outliers(left + right)]
    assert found == [None] * 5 + ["high", "high", "low"] + [None] * 5
    assert [n for n, row in enumerate(_with_outliers(left)) if "triangles.flipped" in row.outliers] == [2]


def test_only_measures_of_the_page_and_errors_of_maps_are_outliers():
    def row(number):
        triangles = {"flipped": 9 - number, "collapsed": 99 * (number == 0), "edge": 0.1 + (number == 0)}
        return Row(f"sub-{number}", "", "L", "", {"figures": {"triangles": triangles}})

    marked = [row.outliers for row in _with_outliers([row(n) for n in range(10)])]
    assert marked[0] == {"triangles.edge": "high", "triangles.flipped": "high"}
    assert marked[1:] == [{"triangles.flipped": "high"}] * 8 + [{}]  # more than 0, even below the median


def test_percentages_of_studies_are_those_of_the_tables_of_maps():
    factors = {key: factor for _, key, factor, _ in (*_DISTANCES, *_TRIANGLES)}
    assert {key: of[1] for key, of in FIGURES.items()} == {key: factors[key.split(".")[-1]] for key in FIGURES}


@pytest.mark.medium
def test_a_table_has_a_column_for_each_band_and_the_values_of_its_maps():
    """A hemisphere of an earlier version, without bands, and a smaller one."""
    hill = voxflat.samples.hill()
    small = {"figures": voxflat.measure(hill, hill.points[:, :2], sources=20).figures()}
    human = {"figures": {"best_scale": {"relative_error_10mm": 0.07}, "triangles": {"edge": 0.1}}}
    columns = columns_of([human, small])
    names = ["best_scale.relative_error_10mm", "best_scale.relative_error_1.5mm"]
    assert [name for name in columns if name in names] == names
    assert "δ up to 1.5 mm" in columns[names[1]]["Description"]
    assert set(measures_in(human)) | set(measures_in(small)) <= set(columns)
    assert (measures_in(human)[names[0]], measures_in(human).get(names[1])) == (0.07, None)
    assert measures_in(small)["interior.relative_error_5mm"] == small["figures"]["interior"]["relative_error_5mm"]
    assert measures_in(small)["interior_share"] == small["figures"]["interior_share"] > 0.9
    assert title_of("best_scale.relative_error_30mm", [human]) == "Distance error up to 30 mm"
    assert title_of("best_scale.relative_error_30mm", [human, small]) == "Distance error up to 30 mm or 5 mm"


@pytest.mark.parametrize(("values", "number"), [((0, 1, 2, 90), 0), ((0, 1, 2, 3, 90), 1), ((0, 1, 2, np.nan, 90), 0)])
def test_five_values_are_needed_for_an_outlier(values, number):
    assert outliers(np.array(values, dtype=float)).sum() == number


def test_sums_forget_no_map_where_another_has_no_value():
    flat = voxflat.flatten(np.ones((12, 9, 1), int), method=voxflat.methods.Voxflat(sources=20))
    sums = Sums(tuple(flat.uv.min(axis=0)), tuple(flat.uv.max(axis=0)))
    for one in (flat.uv[:, 0], np.where(flat.uv[:, 1] > 0, np.nan, 3.0), flat.uv[:, 0] + 6):
        sums.add(flat, one)
    found = sums.result("u", "L")
    at = np.isfinite(found.mean.data) & (found.count.data == 2)
    assert_allclose(found.mean.data[at], sums.places[..., 0][at] + 3, atol=1e-9)
    assert_allclose(found.deviation.data[at], np.sqrt(18), atol=1e-9)


@pytest.mark.parametrize(("maps", "needed"), [(2, 2), (3, 2), (4, 2), (5, 3), (6, 3)])
def test_means_and_deviations_are_numpys_where_at_least_half_of_the_maps_have_a_value(maps, needed):
    flat = voxflat.flatten(np.ones((12, 9, 1), int), method=voxflat.methods.Voxflat(sources=20))
    sums = Sums(flat.uv.min(axis=0), flat.uv.max(axis=0))
    u, values = np.floor(flat.uv[:, 0]), np.random.default_rng(maps).normal(size=maps)
    for number, value in enumerate(values):  # fewer and fewer maps have a value to the right
        sums.add(flat, np.where(u < -3 + 1.5 * number, value, np.nan))
    found = sums.result("u", "L")
    assert set(range(1, maps + 1)) <= set(found.count.data.ravel().tolist())
    for count in range(needed):
        assert np.isnan([of.data[found.count.data == count] for of in (found.mean, found.deviation)]).all()
    for count in range(needed, maps + 1):
        have, at = values[maps - count :], found.count.data == count
        assert_allclose(found.mean.data[at], have.mean(), rtol=1e-12)
        assert_allclose(found.deviation.data[at], have.std(ddof=1), rtol=1e-12)
