"""Periodic maps of tubes: the chart "cylinder", its period, its distortion around the tube, and the caps."""

import numpy as np
import pytest
from command_line import fail, succeed
from hard_shapes import signed_areas
from organs import bent_tube, ellipsoid, nearest, slopes, triangles
from refusals import refused

import voxflat

AROUND, ALONG = 30, 18


def tube(radius, twist=0.5):
    """Return a tube along x, 40 long, with the radius at each position; rings are turned by a twist."""
    x = np.linspace(0, 40, ALONG + 1)
    angles = 2 * np.pi * (np.arange(AROUND) + twist * np.arange(ALONG + 1)[:, None]) / AROUND
    wide = np.array([radius(at) for at in x])[:, None]
    points = np.stack([np.broadcast_to(x[:, None], angles.shape), wide * np.cos(angles), wide * np.sin(angles)], -1)
    a = np.arange(ALONG * AROUND).reshape(ALONG, AROUND)
    b, c = np.roll(a, -1, axis=1), a + AROUND
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([b, np.roll(c, -1, axis=1), c], -1)])
    return points.reshape(-1, 3), faces.reshape(-1, 3)


def test_a_tube_is_placed_on_the_cylinder_of_its_length_and_area():
    points, faces = tube(lambda x: 8.0, twist=0)
    (chart,) = voxflat.surface((points, faces)).charts("cylinder")
    along, around = chart.chart.onto.T
    np.testing.assert_allclose(along, points[:, 0] - 20, atol=1e-9)
    known = np.unique(around[np.isfinite(around)].round(6))
    np.testing.assert_allclose(np.diff(known), 2 * 8 * np.sin(np.pi / AROUND), atol=1e-4)  # side of the polygon


def distances_around(surface, flat_map, count=60):
    """Return exact distances around the tube and distances to the nearest copy on the map, from some vertices."""
    _, rows = np.unique(flat_map.ids, return_index=True)
    assert (flat_map.ids[rows] == np.arange(len(surface))).all()
    sources = np.random.default_rng(3).choice(len(surface), count, replace=False)
    exact = np.asarray(surface.geodesic(sources, geodesic="exact"))
    steps = flat_map.uv[rows][sources][:, None] - flat_map.uv[rows]
    copies = [steps + np.array([0, turns * flat_map.period]) for turns in range(-3, 4)]
    return exact, np.linalg.norm(copies, axis=3).min(axis=0)


def error(exact, flat):
    """Return the mean relative error at scale 1, and the least one at any scale."""
    ratio = flat[exact > 0] / exact[exact > 0]
    errors = [np.abs(scale * ratio - 1).mean() for scale in np.linspace(0.9, 1.1, 801)]
    return np.abs(ratio - 1).mean(), min(errors)


def test_a_cylinder_is_unrolled_exactly():
    points, faces = tube(lambda x: 8.0)
    surface = voxflat.surface((points, faces), unit="µm")
    (chart,) = surface.charts("cylinder")
    flat_map = chart.flatten()
    polygon = 2 * AROUND * 8 * np.sin(np.pi / AROUND)
    assert abs(flat_map.period / polygon - 1) < 2e-3
    assert abs(flat_map.period / (2 * np.pi * 8) - 1) < 3e-3
    assert flat_map.distortion.best_scale.relative_error < 1e-3
    assert flat_map.distortion.triangles.areal_p95 < 5e-3
    along, _ = slopes(flat_map)
    np.testing.assert_allclose(along, [1, 0, 0], atol=5e-3)
    assert chart.metadata["chart"]["name"] == "cylinder"
    assert len(flat_map.faces) == len(faces)


def sides_of(flat_map):
    """Return the rows of the lower and the upper side of the seam."""
    order = np.lexsort([flat_map.uv[:, 1], flat_map.ids])
    same = np.flatnonzero(np.diff(flat_map.ids[order]) == 0)
    return order[same], order[same + 1]


@pytest.mark.parametrize("shape", ["cone", "bent"])
def test_the_sides_of_the_seam_differ_by_the_period_and_no_triangle_is_flipped(shape):
    points, faces = tube(lambda x: 5 + x / 10) if shape == "cone" else bent_tube(rings=30, around=24)[:2]
    surface = voxflat.surface((points, faces))
    (chart,) = surface.charts("cylinder")
    flat_map = chart.flatten()
    lower, upper = sides_of(flat_map)
    assert len(lower) == len(chart.cuts[0].ids) == len(flat_map) - len(points)
    np.testing.assert_allclose(flat_map.uv[upper] - flat_map.uv[lower], [[0, flat_map.period]] * len(lower), atol=1e-9)
    assert (signed_areas(flat_map.uv, flat_map.faces) > 0).all()
    figures = flat_map.distortion.triangles
    assert (figures.flipped, figures.covering, figures.crossings) == (0, 0, 0)
    low, high = (2 * np.pi * 5, 2 * np.pi * 9) if shape == "cone" else (2 * np.pi * 7, 2 * np.pi * 9)
    assert low < flat_map.period < high


@pytest.mark.medium
@pytest.mark.parametrize("shape", ["cone", "bent"])
def test_the_distortion_is_that_of_distances_around_the_tube(shape):
    points, faces = tube(lambda x: 5 + x / 10) if shape == "cone" else bent_tube(rings=30, around=24)[:2]
    surface = voxflat.surface((points, faces), unit="µm")
    flat_map = surface.charts("cylinder")[0].flatten()
    raw, best = error(*distances_around(surface, flat_map))
    measured = voxflat.measure(surface, flat_map)
    for found in (measured, flat_map.distortion):
        assert abs(found.raw.relative_error - raw) < 0.05 * raw
        assert abs(found.best_scale.relative_error - best) < 0.05 * best
    assert len(measured.per_point) == len(flat_map)
    lower, upper = sides_of(flat_map)
    np.testing.assert_array_equal(measured.per_point[lower], measured.per_point[upper])
    np.testing.assert_array_equal(flat_map.distortion.per_point[lower], flat_map.distortion.per_point[upper])
    # as a plain strip, the map would be compared with distances that the seam blocks
    strip = voxflat.measure(surface, (flat_map.uv, flat_map.faces, flat_map.ids))
    assert abs(strip.raw.relative_error - raw) > 0.05 * raw


@pytest.mark.medium
def test_hardly_any_period_and_scale_of_a_straight_map_are_better():
    points, faces = tube(lambda x: 5 + x / 10)
    surface = voxflat.surface((points, faces))
    flat_map = surface.charts("cylinder")[0].flatten()
    exact, flat = distances_around(surface, flat_map)
    angles, x = np.arctan2(points[:, 2], points[:, 1]), points[:, 0]
    sources = np.random.default_rng(3).choice(len(surface), len(exact), replace=False)
    turn = np.angle(np.exp(1j * (angles[sources][:, None] - angles))) / (2 * np.pi)
    step = x[sources][:, None] - x
    straight = [error(exact, np.hypot(step, period * turn))[1] for period in np.linspace(28, 60, 33)]
    assert error(exact, flat)[1] < min(straight) * 1.05  # which also keeps areas and angles


@pytest.mark.medium
def test_maps_are_measured_with_their_period_by_any_solver():
    points, faces, _ = bent_tube(rings=30, around=24)
    surface = voxflat.surface((points, faces))
    (chart,) = surface.charts("cylinder")
    methods = [voxflat.methods.Voxflat(geodesic=name, sources=60) for name in ("graph", "exact")]
    maps = {one.geodesic: chart.flatten(one) for one in methods}
    assert maps["exact"].distortion.reference == "exact"
    errors = [one.distortion.best_scale.relative_error for one in maps.values()]
    assert abs(errors[0] - errors[1]) < 0.05 * errors[0]
    one, other = (voxflat.compare(surface, {**maps, "strip": surface.charts()[0].flatten()})[name] for name in maps)
    assert abs(one.best_scale.relative_error - other.best_scale.relative_error) < 0.05 * errors[0]


@pytest.mark.medium
def test_the_period_is_saved_and_scaled(tmp_path):
    points, faces, _ = bent_tube(rings=30, around=24)
    (chart,) = voxflat.surface((points, faces)).charts("cylinder")
    flat_map = chart.flatten()
    flat_map.save(tmp_path / "map.npz")
    saved = voxflat.load(tmp_path / "map.npz")
    assert saved.period == flat_map.period
    refused("a periodic map has no eigenvalues", voxflat.figures.spectrum, saved)
    pixels = flat_map.period / flat_map.pixel_size
    assert abs(pixels - round(pixels)) < 1e-9
    assert abs(flat_map.pixel_size / flat_map.spacing - 0.5) < 0.02
    by_area = chart.flatten(voxflat.methods.Voxflat(scale="areas"))
    assert abs(by_area.distortion.triangles.equal_area_scale - 1) < 1e-6
    ratio = by_area.period / flat_map.period
    np.testing.assert_allclose(np.ptp(by_area.uv, axis=0), ratio * np.ptp(flat_map.uv, axis=0), rtol=1e-6)
    mirrored = chart.flatten(mirror=True)
    np.testing.assert_array_equal(mirrored.uv, flat_map.uv * [-1, 1])
    assert mirrored.period == flat_map.period


def test_one_period_of_an_image_has_no_seam():
    points, faces, angles = bent_tube(rings=30, around=24)
    (chart,) = voxflat.surface((points, faces)).charts("cylinder")
    flat_map = chart.flatten()
    values = np.sin(angles)
    image = flat_map.image(values)
    one = image.one_period(flat_map.period)
    assert len(one.data) == round(flat_map.period / one.pixel_size) < len(image.data)
    assert abs(one.extent[3] - one.extent[2] - flat_map.period) < 1e-9
    assert abs(one.extent[2] + one.extent[3]) <= one.pixel_size * (1 + 1e-9)
    middle = one.data[:, 12:-12]
    assert np.isfinite(middle).all()
    steps = np.abs(np.diff(np.concatenate([middle, middle[:1]]), axis=0)).max(axis=1)
    assert steps[-1] <= steps[:-1].max()
    # each pixel shows what the map shows at its position, or one period away
    u, v = (
        one.origin[axis] + sign * one.pixel_size * np.arange(size)
        for axis, sign, size in ((0, 1, one.data.shape[1]), (1, -1, len(one.data)))
    )
    places = np.stack(np.meshgrid(u, v), axis=-1)
    shown = np.full(one.data.shape, np.nan)
    for turns in (-1, 0, 1):
        found = flat_map.look_up(places + np.array([0, turns * flat_map.period]))
        inside = found.face_ids >= 0
        shown[inside] = (found.weights * values[flat_map.ids][flat_map.faces[found.face_ids]]).sum(axis=-1)[inside]
    np.testing.assert_allclose(shown[:, 12:-12], middle, atol=1e-5)
    colours = voxflat.maps.raster.FlatImage(image.colours(), image.pixel_size, image.origin, "colours")
    assert (colours.one_period(flat_map.period).data[:, 12:-12, 3] == 255).all()
    # labels that were drawn on one period, across its border
    labels = np.where(np.isfinite(one.data) & (np.abs(v)[:, None] > flat_map.period / 4), 3, 0)
    regions = flat_map.regions(labels)
    beyond = np.abs((flat_map.uv[:, 1] + flat_map.period / 2) % flat_map.period - flat_map.period / 2)
    clear = np.abs(beyond - flat_map.period / 4) > 2 * one.pixel_size
    np.testing.assert_array_equal(regions.labels[clear], np.where(beyond > flat_map.period / 4, 3, 0)[clear])
    figures = regions.properties()
    assert abs(figures["map_area"][0] / (labels > 0).sum() / one.pixel_size**2 - 1) < 0.01
    refused("the map is not periodic", image.one_period, None)
    refused(
        "the period is .* pixels, not a whole number. Pass a pixel size",
        flat_map.image(values, pixel_size=1.0).one_period,
        flat_map.period,
    )
    refused("the period is", image.one_period, np.nan)


@pytest.mark.medium
def test_the_ends_of_a_closed_organ_become_caps():
    points, faces = ellipsoid(2500)
    points *= [1, 1.2, 1.2]  # 5 : 2 : 2
    egg = voxflat.surface((points, faces), unit="µm")
    front = nearest(points, [0, 0, 12])
    charts = egg.charts("cylinder", front=front)
    assert [one.metadata["chart"]["name"] for one in charts] == ["cylinder", "anterior", "posterior"]
    of = triangles(charts)
    assert sum(map(len, of)) == len(set.union(*of)) == len(faces)
    maps = [one.flatten() for one in charts]
    assert [one.period is None for one in maps] == [False, True, True]
    assert max(one.distortion.best_scale.relative_error for one in maps) < 0.08
    assert 0.85 * 24 * np.pi < maps[0].period < 24 * np.pi
    for flat_map, towards in zip(maps, (0, -1, 1), strict=True):
        assert (signed_areas(flat_map.uv, flat_map.faces) > 0).all()
        assert np.sign(np.round(flat_map.points[:, 0].mean() / 20)) == towards
    # a cap continues the cylinder: towards the cylinder at the front, upwards where the cylinder goes up
    for flat_map, sign in zip(maps[1:], (1, -1), strict=True):
        along, up = slopes(flat_map)
        assert sign * along[2] > 0.7
        assert up[1] > 0.7
    shared = egg.charts("cylinder", front=front, overlap=4.0)
    assert triangles(shared)[0] == of[0]
    assert all(more > plain for more, plain in zip(triangles(shared)[1:], of[1:], strict=True))


@pytest.mark.medium
def test_the_command_line_writes_the_cylinder_and_its_caps(tmp_path):
    points, faces = ellipsoid(800)
    voxflat.io.write_mesh(tmp_path / "egg.ply", voxflat.io.Mesh(points, faces))
    output = succeed("flatten", tmp_path / "egg.ply", "--charts", "cylinder", "-o", tmp_path / "e.npz").output
    assert "the chart 'cylinder'" in output
    assert "period  " in output
    maps = [voxflat.load(tmp_path / f"{name}.e.npz") for name in ("cylinder", "anterior", "posterior")]
    assert [one.metadata["chart"]["name"] for one in maps] == ["cylinder", "anterior", "posterior"]
    points, faces, _ = bent_tube(rings=30, around=24)
    voxflat.io.write_mesh(tmp_path / "gut.ply", voxflat.io.Mesh(points, faces))
    succeed("flatten", tmp_path / "gut.ply", "--charts", "cylinder", "-o", tmp_path / "g.npz")
    assert sorted(path.name for path in tmp_path.glob("*.g.npz")) == ["cylinder.g.npz"]
    given = ("flatten", tmp_path / "gut.ply", "-o", tmp_path / "h.npz", "--charts")
    fail(2, "'round' is neither a number from 1 to 64 nor 'cylinder'", *given, "round")
    fail(2, "--store holds the distances of one map", *given, "cylinder", "--store", tmp_path / "s")


def test_what_a_cylinder_cannot_be_is_refused():
    points, faces, _ = bent_tube(rings=30, around=24)
    gut = voxflat.surface((points, faces))
    refused("count is 'tube'. Pass a number of charts from 1 to 64, or 'cylinder'", gut.charts, "tube")
    refused("relax does not apply to a cylinder", gut.charts, "cylinder", relax=True)
    refused("overlap does not apply to a tube", gut.charts, "cylinder", overlap=2.0)
    refused("this one is a disk", voxflat.samples.hill().charts, "cylinder")
    (chart,) = gut.charts("cylinder")
    refused(
        "the method 'zigelman2002' cannot make a periodic map. Use the method 'voxflat'", chart.flatten, "zigelman2002"
    )
    refused("rows does not apply to the chart 'cylinder'", chart.flatten, rows=True)
    for more in ({"max_area": 2.0}, {"start": chart.flatten()}):
        refused(f"{next(iter(more))} does not apply to the chart", chart.flatten, voxflat.methods.Voxflat(**more))
    refused("sources", chart.flatten, voxflat.methods.Voxflat(sources=2))
