"""Charts of closed surfaces and tubes: sectors around the axis, seams, overlap, and alignment of the maps."""

import json

import numpy as np
import pytest
import scipy
from command_line import fail, succeed
from hard_shapes import signed_areas, turned
from organs import bent_tube, ellipsoid, nearest, slopes, triangles
from refusals import refused
from triangle_meshes import torus

import voxflat


def longitudes(points):
    """Return angles around the x axis from z towards y, which is up if x goes to the right and z to the viewer."""
    return np.arctan2(points[:, 1], points[:, 2])


def apart(angles, others):
    return np.abs(np.angle(np.exp(1j * (angles - others))))


@pytest.fixture(scope="module")
def egg():
    return voxflat.surface(ellipsoid(), unit="µm")


@pytest.mark.medium
def test_charts_are_equal_sectors_that_cover_each_triangle_once(egg):
    front = nearest(egg.points, [0, 0, 10])
    middle = longitudes(egg.points[front][None])
    for count in (2, 3, 5):
        charts = egg.charts(count, front=front)
        of = triangles(charts)
        assert sum(map(len, of)) == len(set.union(*of)) == len(egg.faces)
        for number, chart in enumerate(charts):
            places = chart.surface.points[chart.surface.faces].mean(axis=1)
            is_clear = np.hypot(*places[:, 1:].T) > 4  # an edge spans a large angle near the ends
            off = apart(longitudes(places[is_clear]), middle + 2 * np.pi * number / count)
            assert off.max() < np.pi / count + 0.15
            assert chart.surface.core.topology()["euler"] == 1


@pytest.mark.medium
def test_the_seam_of_a_single_chart_is_opposite_the_front(egg):
    for angle in (0.0, 2.0, -1.2):
        front = nearest(egg.points, [0, 10 * np.sin(angle), 10 * np.cos(angle)])
        chart = egg.charts(front=front, axis=[nearest(egg.points, [x, 0, 0]) for x in (-30, 30)])[0]
        (cut,) = chart.cuts
        seam = egg.points[cut.ids]
        assert seam[0, 0] < -29 < 29 < seam[-1, 0]
        inner = seam[np.hypot(*seam[:, 1:].T) > 4]
        assert apart(longitudes(inner), angle + np.pi).max() < 0.25
        length = np.linalg.norm(np.diff(seam, axis=0), axis=1).sum()
        assert 0.98 < length / (2 * 30 * scipy.special.ellipe(1 - 1 / 9)) < 1.25  # edges zigzag
        assert (
            chart.warnings[-1] == f"the surface is closed, so it was cut along a seam from end to end ({length:.0f} µm)"
        )
        assert triangles([chart])[0] == triangles(egg.charts(2))[0] | triangles(egg.charts(2))[1]


@pytest.mark.medium
def test_maps_are_aligned_with_the_anterior_end_on_the_left(egg):
    ends = [nearest(egg.points, [x, 0, 0]) for x in (-30, 30)]
    front = nearest(egg.points, [0, 0, 10])
    for axis, to_right, counts in ((None, 1, (1,)), (ends, 1, (3,)), (ends[::-1], -1, (2,))):
        for count in counts:
            for number, chart in enumerate(egg.charts(count, axis=axis, front=front)):
                flat_map = chart.flatten()
                along, up = slopes(flat_map)
                angle = to_right * 2 * np.pi * number / count
                assert along[0] * to_right > 0.5
                assert abs(along[1:]).max() < 0.1
                upwards = to_right * np.array([0, np.cos(angle), -np.sin(angle)])
                assert up @ upwards > 0.98 * np.linalg.norm(up)
                assert (signed_areas(flat_map.uv, flat_map.faces) > 0).all()
                assert flat_map.metadata["frame"] == "axis"
                np.testing.assert_allclose(flat_map.uv.mean(axis=0), 0, atol=1e-9)
                tips = flat_map.uv[np.isin(flat_map.ids, ends)]
                assert np.ptp(tips[:, 0]) > 0.85 * np.ptp(flat_map.uv[:, 0])


def test_mirrored_charts_are_mirrored(egg):
    plain, mirrored = (egg.charts(2)[0].flatten(mirror=mirror) for mirror in (False, True))
    np.testing.assert_array_equal(mirrored.uv, plain.uv * [-1, 1])


def test_neighbouring_charts_share_a_band_of_the_given_width(egg):
    front = nearest(egg.points, [0, 0, 10])
    both = egg.charts(2, front=front, overlap=8.0)
    shared = np.isin(np.arange(len(egg)), both[0].surface.vertices) & np.isin(
        np.arange(len(egg)), both[1].surface.vertices
    )
    assert len(set.union(*triangles(both))) == len(egg.faces)
    middle = np.abs(egg.points[:, 0]) < 10
    radius = np.hypot(*egg.points[middle, 1:].T)
    to_border = radius * np.abs(np.pi / 2 - apart(longitudes(egg.points[middle]), 0.0))
    assert shared[middle][to_border < 4 - 1.5].all()  # paths along edges are longer
    assert not shared[middle][to_border > 4 + 2.5].any()
    assert [one.surface.core.topology()["euler"] for one in both] == [1, 1]
    assert [one.metadata["chart"]["name"] for one in both] == ["front", "back"]


@pytest.mark.medium
def test_a_bent_organ_is_charted_from_tip_to_tip():
    points, faces = ellipsoid(2500)
    points *= [2, 1, 1]
    angle, radius = points[:, 0] / 30, 30 + points[:, 1]
    bent = np.stack([radius * np.sin(angle), radius * np.cos(angle), points[:, 2]], axis=1)
    organ = voxflat.surface((bent, faces), unit="µm")
    chart = organ.charts()[0]
    ends = points[chart.metadata["chart"]["axis"], 0]
    assert ends[0] < -55
    assert ends[1] > 55
    seam = points[chart.cuts[0].ids]
    assert seam[np.abs(seam[:, 0]) < 50, 1].min() > 0  # on the convex side
    along, _ = slopes(chart.flatten())
    assert along[0] > 4 * np.abs(along[1:]).max()
    pair = organ.charts(2, overlap=4.0)
    assert len(set.union(*triangles(pair))) == len(faces)
    errors = [one.flatten().distortion.best_scale.relative_error for one in (chart, *pair)]
    assert max(errors[1:]) < errors[0] / 2


@pytest.mark.medium
@pytest.mark.parametrize("front", [0.0, 1.5, np.pi, 4.0])
def test_the_seam_of_a_tube_is_opposite_the_front_in_the_conformal_angle(front):
    points, faces, angles = bent_tube()
    tube = voxflat.surface((points, faces))
    fine = np.linspace(0, 2 * np.pi, 2001)
    conformal = scipy.integrate.cumulative_trapezoid(1 / (30 + 8 * np.cos(fine)), fine, initial=0)
    conformal *= 2 * np.pi / conformal[-1]
    start = nearest(points, [0, 30 + 8 * np.cos(front), 8 * np.sin(front)])
    back = np.interp(angles[start], fine, conformal) + np.pi
    (chart,) = tube.charts(front=start)
    off = apart(np.interp(angles[chart.cuts[0].ids], fine, conformal), back)
    assert off.max() < 2 * np.pi / 40 * 1.3
    flat_map = chart.flatten()
    assert flat_map.metadata["cuts_by"] == "charts"
    assert abs(flat_map.uv[flat_map.ids == start]).max() < 2.5  # the front is in the centre
    assert "a tube" in chart.warnings[-1]
    right = tube.charts(front=start, axis=(len(points) - 1, 0))[0].flatten()
    assert slopes(right)[0] @ slopes(flat_map)[0] < 0


def test_the_largest_component_is_charted(egg, caplog):
    points, faces = ellipsoid(400)
    both = np.concatenate([egg.points, 0.3 * points + 50]), np.concatenate([egg.faces.astype(int), faces + len(egg)])
    (chart,) = voxflat.surface(both).charts()
    assert set(chart.surface.vertices) == set(range(len(egg)))
    assert sum("2 components; only the largest is used" in record.message for record in caplog.records) == 1


@pytest.mark.medium
def test_relaxation_cuts_are_added_on_request(egg):
    plain, relaxed = (egg.charts(relax=relax)[0] for relax in (None, True))
    assert {cut.reason for cut in plain.cuts} == {"given"}
    assert {cut.reason for cut in relaxed.cuts} == {"given", "relaxation"}
    errors = [one.flatten().distortion.best_scale.relative_error for one in (plain, relaxed)]
    assert errors[1] < errors[0]


@pytest.mark.medium
def test_the_command_line_writes_a_map_for_each_chart(tmp_path):
    np.save(tmp_path / "ball.npy", voxflat.samples.ball())
    given = ["flatten", tmp_path / "ball.npy", "--front", "12,12,19", "--axis", "4,12,12", "19,12,12"]
    told = json.loads(succeed(*given, "--charts", 2, "--overlap", 2, "--json", "-o", tmp_path / "b.npz").stdout)
    surface = voxflat.surface(voxflat.samples.ball())
    charts = surface.charts(2, axis=[(4, 12, 12), (19, 12, 12)], front=(12, 12, 19), overlap=2.0)
    for name, chart, one in zip(("front", "back"), charts, told["charts"], strict=True):
        saved = voxflat.load(tmp_path / f"{name}.b.npz")
        np.testing.assert_array_equal(saved.uv, chart.flatten().uv)
        assert saved.metadata["chart"] == chart.metadata["chart"]
        assert saved.metadata["chart"]["name"] == name
        assert one["output"] == str(tmp_path / f"{name}.b.npz")
    assert not (tmp_path / "b.npz").exists()
    assert "the chart 'front'" in succeed(*given, "--charts", 2, "-o", tmp_path / "b.npz").output
    succeed(*given, "--charts", 1, "-o", tmp_path / "b.npz")
    assert (tmp_path / "b.npz").exists()
    fail(2, "--axis, --front and --overlap require --charts", *given, "-o", tmp_path / "b.npz")
    also = ("--cuts", "automatic", "-o", tmp_path / "b.npz")
    fail(2, "--charts cannot be combined with --cuts, --sphere and --adapt", *given, "--charts", 1, *also)
    fail(2, "--store holds the distances of one map", *given, "--charts", 2, "--store", tmp_path / "s", *also[2:])


def test_what_cannot_be_charted_is_refused(egg):
    refused("this one is a disk. Flatten it without charts", voxflat.samples.hill().charts)
    refused("the surface has 1 handle", voxflat.surface(torus()).charts)
    holes = voxflat.surface(turned([(10 + height, height) for height in range(9)], 24, closed=False))
    refused("has 3 boundary loops. Close the holes", holes.drop([100]).charts)
    for count in (0, -1, 2.0, True, 65, "2"):
        refused("count is .*. Pass a number of charts from 1 to 64", egg.charts, count)
    refused("too few triangles for 64 charts", voxflat.surface(ellipsoid(60)).charts, 64)
    for overlap in (-1.0, np.nan, np.inf):
        refused("overlap is .*. Pass the width", egg.charts, 2, overlap=overlap)
    refused("the overlap is 'x'. Pass a number", egg.charts, 2, overlap="x")
    refused("does not apply to a single chart", egg.charts, overlap=2.0)
    refused("overlap is 60, so that a chart would cover the surface", egg.charts, 2, overlap=60.0)
    refused("are the same point. Pass two different points", egg.charts, axis=(7, 7))
    for axis in (7, "ab", (1, 2, 3)):
        refused("the axis is .*. Pass two points", egg.charts, axis=axis)
    refused("the posterior end of the axis is 0.5. Pass a vertex number", egg.charts, axis=(1, 0.5))
    refused("the front is 'x'. Pass a vertex number", egg.charts, front="x")
    refused("vertex 99999 is not on the surface", egg.charts, front=99999)
    refused("the front lies at an end of the axis", egg.charts, axis=(3, 1400), front=3)
    neighbours = egg.faces[0, :2].tolist()
    refused("are neighbours on the surface", egg.charts, axis=neighbours)
    points, faces, _ = bent_tube()
    tube = voxflat.surface((points, faces))
    refused("nearest to the same end of the tube", tube.charts, axis=(0, 1))
    refused("the front must be three voxel indices", voxflat.surface(voxflat.samples.ball()).charts, front=3)
