"""One map for a group of people: `voxflat.flatten_group`."""

import itertools

import numpy as np
import pytest

import voxflat
from voxflat.errors import Cancelled, InputError

HILL = voxflat.samples.hill()
POINTS, FACES = HILL.points, HILL.faces
HEIGHTS = (0.4, 1.0, 1.6)


def person(height, scale=1.0, number=0):
    """Return a hill of some height, with bumps that only this person has."""
    random = np.random.default_rng(number)
    waves = random.normal(size=(3, 2)) * 0.3
    bumps = sum(np.sin(POINTS[:, :2] @ wave + random.uniform(0, 6)) for wave in waves)
    return scale * (
        POINTS * [1, 1, height] + np.column_stack([0 * bumps, 0 * bumps, 0.4 * bumps * (number > 0)])
    ), FACES


PEOPLE = [person(height, number=number) for number, height in enumerate(HEIGHTS, 1)]


@pytest.fixture(scope="module")
def of_people():
    return voxflat.flatten_group(PEOPLE)


def error(points, flat_map):
    of = voxflat.measure((points, FACES), (flat_map.uv, flat_map.faces, flat_map.ids), reference="graph")
    return of.best_scale.relative_error


@pytest.mark.medium
def test_a_group_of_equal_surfaces_has_the_map_of_one():
    group, alone = voxflat.flatten_group([PEOPLE[0]] * 3), voxflat.flatten(PEOPLE[0])
    apart = [np.linalg.norm(flat.uv[:, None] - flat.uv[None], axis=2) for flat in (group, alone)]
    assert np.abs(apart[0] - apart[1]).max() < 0.01 * apart[1].max()
    figures = [flat.distortion.best_scale.relative_error for flat in (group, alone)]
    assert figures[0] == pytest.approx(figures[1], rel=0.02)
    assert group.spread.max() < 1e-6
    np.testing.assert_allclose(group.points - group.points.mean(0), alone.points - alone.points.mean(0), atol=1e-9)


@pytest.mark.medium
def test_the_size_of_people_does_not_matter_and_the_map_has_the_mean_size(of_people):
    scaled = [(scale * points, FACES) for (points, _), scale in zip(PEOPLE, (0.8, 1.0, 1.2), strict=True)]
    flat = voxflat.flatten_group(scaled)
    errors = [[row["relative_error"] for row in one.metadata["people"]] for one in (flat, of_people)]
    np.testing.assert_allclose(*errors, rtol=0.02)
    scales = [row["scale"] for row in flat.metadata["people"]]
    np.testing.assert_allclose(np.divide(scales, scales[1]), [0.8, 1.0, 1.2], rtol=0.05)


@pytest.mark.medium
def test_the_map_does_not_depend_on_the_order_of_people_nor_on_threads(of_people):
    for order, threads in zip(itertools.permutations(range(3)), (1, 2, 3, 1, 2, 3), strict=True):
        flat = voxflat.flatten_group([PEOPLE[number] for number in order], threads=threads)
        for name in ("uv", "points", "normals", "spread"):
            assert np.array_equal(getattr(flat, name), getattr(of_people, name)), (order, name)
        assert np.array_equal(flat.distortion.per_point, of_people.distortion.per_point)
        assert flat.distortion.figures() == of_people.distortion.figures()
        rows, others = flat.metadata["people"], of_people.metadata["people"]
        for row, number in zip(rows, order, strict=True):
            assert {**row, "surface": ""} == {**others[number], "surface": ""}


@pytest.mark.medium
def test_the_map_is_better_for_people_than_that_of_any_other_person(of_people):
    maps = [voxflat.flatten(one) for one in PEOPLE]
    errors = np.array([[error(points, flat) for flat in maps] for points, _ in PEOPLE])
    of_group = np.array([error(points, of_people) for points, _ in PEOPLE])
    others = errors[~np.eye(3, dtype=bool)].reshape(3, 2)
    assert of_group.mean() < others.mean(axis=1).mean()
    assert (of_group < others.max(axis=1)).all()
    assert of_people.distortion.triangles.flipped == 0


@pytest.mark.medium
def test_the_table_and_the_spread_are_those_of_the_people(of_people, tmp_path):
    for (points, _), row in zip(PEOPLE, of_people.metadata["people"], strict=True):
        assert row["relative_error"] == pytest.approx(error(points, of_people), rel=0.05)  # from other sources
    rows = of_people.metadata["people"]
    assert of_people.distortion.best_scale.relative_error == pytest.approx(
        np.mean([row["relative_error"] for row in rows])
    )
    changes = []
    for points, _ in PEOPLE:
        triangles = voxflat.measure((points, FACES), (of_people.uv, of_people.faces, of_people.ids)).triangles
        changes.append(triangles.areal + 2 * np.log2(triangles.equal_area_scale))
    np.testing.assert_allclose(of_people.spread, np.std(changes, axis=0), atol=1e-6)
    of_people.save(tmp_path / "group.npz")
    again = voxflat.load(tmp_path / "group.npz")
    assert again.metadata["people"] == rows
    assert np.array_equal(again.spread, of_people.spread)
    image, drawn = again.heat_map(1.0, of="spread"), voxflat.figures.heat_map(again, 1.0, of="spread").axes[0].images[0]
    np.testing.assert_allclose(image.data, again.image(again.spread, 1.0).data, atol=1e-6)
    np.testing.assert_array_equal(np.ma.filled(drawn.get_array(), np.nan), image.data)
    assert drawn.get_clim() == pytest.approx((0, np.percentile(again.spread, 99)))


def test_the_spread_of_a_map_of_one_person_is_refused():
    with pytest.raises(InputError, match="no spread between people"):
        HILL.flatten().heat_map(of="spread")


@pytest.mark.medium
def test_the_map_is_measured_on_the_person_and_not_on_the_mean_surface(of_people):
    other = person(2.2, number=9)
    own = voxflat.flatten(other)
    places = (of_people.uv, of_people.faces, of_people.ids)
    for found in (voxflat.measure(other, of_people), voxflat.compare(other, {"own": own, "group": of_people})["group"]):
        assert found.best_scale.relative_error == voxflat.measure(other, places).best_scale.relative_error


@pytest.mark.medium
def test_weights_pull_the_map_towards_people():
    towards = [voxflat.flatten_group(PEOPLE, weights=weights) for weights in ([9, 1, 1], [1, 1, 9])]
    for number, (near, far) in ((0, towards), (2, towards[::-1])):
        assert error(PEOPLE[number][0], near) < error(PEOPLE[number][0], far)
    many = voxflat.flatten_group([PEOPLE[0], PEOPLE[2], PEOPLE[2]])
    same = voxflat.flatten_group([PEOPLE[0], PEOPLE[2]], weights=[1, 2])
    np.testing.assert_allclose(many.uv, same.uv, atol=0.01 * np.ptp(same.uv))


@pytest.mark.medium
def test_a_person_may_lie_anywhere(of_people):
    turned = [(one @ np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0] + 50, FACES) for one, _ in PEOPLE]
    if np.linalg.det(np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]) < 0:
        turned = [(points * [-1, 1, 1], FACES) for points, _ in turned]
    flat = voxflat.flatten_group([PEOPLE[0], PEOPLE[1], turned[2]])
    assert flat.distortion.best_scale.relative_error == pytest.approx(
        of_people.distortion.best_scale.relative_error, rel=0.02
    )


FEWER = (POINTS[:-1], FACES[(len(POINTS) - 1 > FACES).all(axis=1)])
WRONG = {
    "another mesh": (lambda: [PEOPLE[0], FEWER], r"surface 2 has 440 vertices, but surface 1 has 441\. Pass surfaces"),
    "other triangles": (
        lambda: [PEOPLE[0], (POINTS, np.vstack([FACES[1:], [[0, 20, 440]]]))],
        r"surface 2 does not have the triangles of surface 1\. Pass",
    ),
    "a mirror image": (
        lambda: [PEOPLE[0], (PEOPLE[1][0] * [-1, 1, 1], FACES)],
        "surface 2 is a mirror image of surface 1",
    ),
    "one": (lambda: [PEOPLE[0]], r"the list has 1 surface\(s\)\. Pass at least two"),
    "no list": (lambda: HILL, "Pass a list of surfaces"),
    "a volume": (lambda: [PEOPLE[0], voxflat.samples.ball()], "surface 2 is .* Pass a mesh"),
    "no position": (
        lambda: [PEOPLE[0], (np.where(np.arange(441)[:, None] == 7, np.nan, POINTS), FACES)],
        "surface 2 has",
    ),
    "another hemisphere": (
        lambda: [voxflat.io.Mesh(POINTS, FACES, structure=f"Cortex{side}") for side in ("Left", "Right")],
        "surface 2: belongs to the right hemisphere, but surface 1 belongs to the left one",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_surfaces_that_do_not_match_are_refused_in_one_line(name):
    people, message = WRONG[name]
    with pytest.raises(InputError, match=message) as caught:
        voxflat.flatten_group(people())
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("weights", [[1, 2], [1, 0, 1], [1, -1, 1], [1, np.nan, 1], [1, np.inf, 1], "abc"])
def test_wrong_weights_are_refused(weights):
    with pytest.raises(InputError, match="weights"):
        voxflat.flatten_group(PEOPLE, weights=weights)


@pytest.mark.medium
def test_progress_is_reported_and_can_cancel():
    stages = []

    def progress(stage, done, total):
        stages.append(stage)
        return len(stages) < 30

    with pytest.raises(Cancelled):
        voxflat.flatten_group(PEOPLE * 5, progress=progress, threads=1)
    assert stages


@pytest.mark.medium
def test_the_map_has_the_unit_of_the_surfaces():
    people = [voxflat.surface(one, unit="µm") for one in PEOPLE[:2]]
    assert voxflat.flatten_group(people).origin.unit == voxflat.flatten(people[0]).origin.unit
