import json
import shlex
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import how_to
import numpy as np
import pytest
from command_line import succeed
from refusals import refused
from scipy.spatial.transform import Rotation
from triangle_meshes import square

import voxflat
from voxflat import figures, io
from voxflat.maps.worst_places import area_changes
from voxflat.maps.worst_search import _place, _Ways
from voxflat.methods import Grossmann2002, Voxflat


def laid(points, faces, uv):
    """A map that lies as given, judged anew."""
    flat_map = voxflat.flatten((points, faces), Voxflat(sources=10), relax=False)
    figures = voxflat.measure((points, faces), uv, sources=5).triangles
    return replace(flat_map, uv=uv, distortion=replace(flat_map.distortion, triangles=figures))


def swollen(size=30, middles=((8, 8, 0.4), (21, 20, -0.4)), radius=4.0):
    """A square sheet whose map is shrunk around one place and stretched around another: (u, v, by how much)."""
    points, faces = square(size)
    uv = points[:, :2].copy()
    for *middle, inwards in middles:
        away = points[:, :2] - middle
        uv -= inwards * away * np.exp(-(away**2).sum(axis=1) / radius**2)[:, None]
    return points, faces, uv


@pytest.fixture(scope="module")
def both():
    return laid(*swollen())


@pytest.fixture(scope="module")
def pit():
    points, faces = square(40)
    away = points[:, :2] - [24, 17]
    points[:, 2] = -12 * np.exp(-(away**2).sum(axis=1) / 30)
    return points, faces, voxflat.flatten((points, faces), relax=False)


@pytest.mark.slow
def test_both_signs_are_found_where_they_are(both):
    worst = voxflat.worst_places(both, beyond=1.25)
    places = {place.kind: place for place in worst.places[:2]}
    assert np.linalg.norm(places["shrunk"].point - [8, 8, 0]) < 1.5
    assert np.linalg.norm(places["stretched"].point - [21, 20, 0]) < 1.5
    # in its middle the map is (1 - 0.4)² and (1 + 0.4)² times as large
    scale = both.distortion.triangles.equal_area_scale
    assert places["shrunk"].worst_ratio == pytest.approx(0.36 * scale**2, rel=0.1)
    assert places["stretched"].worst_ratio == pytest.approx(1.96 * scale**2, rel=0.1)
    assert places["shrunk"].worst_ratio < places["shrunk"].median_ratio < 1 / 1.25
    assert places["stretched"].worst_ratio > places["stretched"].median_ratio > 1.25
    for place in worst.places:
        row = np.flatnonzero(both.ids == place.id)[0]
        assert np.array_equal(both.points[row], place.point)
        assert np.array_equal(both.uv[row], place.uv)


@pytest.mark.slow
@pytest.mark.parametrize("beyond", [1.25, 1.5, 2])
def test_all_places_together_are_the_share_that_the_figures_have(both, beyond):
    worst = voxflat.worst_places(both, 10_000, beyond=beyond, cuts=False)
    share = getattr(both.distortion.triangles, f"area_beyond_{beyond}".replace(".", "_"))
    assert worst.share == pytest.approx(share, abs=1e-9)
    assert sum(place.share for place in worst.places) == pytest.approx(worst.share)
    assert len(worst.places) == worst.found
    assert sum(len(place.triangles) for place in worst.places) == np.count_nonzero(worst.numbers)
    areas, logs = area_changes(both)
    for place in worst.places:
        assert np.array_equal(np.flatnonzero(worst.numbers == place.number), place.triangles)
        change = logs[place.triangles]
        assert (change > np.log2(beyond)).all() or (change < -np.log2(beyond)).all()
        assert place.area == pytest.approx(areas[place.triangles].sum())
        assert place.excess == pytest.approx((areas[place.triangles] * np.abs(change)).sum())


@pytest.mark.slow
def test_the_worst_comes_first_and_places_do_not_touch(both):
    worst = voxflat.worst_places(both, 10_000, beyond=1.1, cuts=False)
    assert worst.found > 2
    assert [place.number for place in worst.places] == list(range(1, worst.found + 1))
    assert np.all(np.diff([place.excess for place in worst.places]) <= 0)
    for kind in ("stretched", "shrunk"):
        corners = [set(both.faces[place.triangles].ravel()) for place in worst.places if place.kind == kind]
        assert sum(map(len, corners)) == len(set().union(*corners))
    fewer = voxflat.worst_places(both, 2, beyond=1.1, cuts=False)
    assert fewer.found == worst.found
    assert [place.excess for place in fewer.places] == [place.excess for place in worst.places[:2]]


@pytest.mark.slow
def test_where_nothing_changes_nothing_is_found():
    points, faces = square(8)
    worst = voxflat.worst_places(laid(points, faces, 3 * points[:, :2]))
    assert (worst.places, worst.found, worst.share, worst.cuts()) == ((), 0, 0, [])
    assert worst.table() == "0 regions where areas change by more than a factor of 1.5 (0.00 % of the surface)"
    assert not worst.numbers.any()


@pytest.mark.slow
def test_a_triangle_without_area_on_the_map_does_not_outweigh_all():
    points, faces, uv = swollen()
    uv[faces[0, 0]] = uv[faces[0, 1]]
    worst = voxflat.worst_places(laid(points, faces, uv), beyond=1.25, cuts=False)
    assert np.isfinite([place.excess for place in worst.places]).all()
    assert np.linalg.norm(worst.places[0].point[:2] - points[faces[0, 0], :2]) > 3


@pytest.mark.slow
def test_neither_rotation_nor_the_order_of_vertices_matters(both):
    points, faces, uv = swollen()
    rng = np.random.default_rng(0)
    order = rng.permutation(len(points))
    new = np.argsort(order)
    turn = Rotation.random(random_state=1)
    other = laid(turn.apply(points[order]), new[faces][rng.permutation(len(faces))], uv[order])
    one, two = (voxflat.worst_places(flat_map, 2, beyond=1.25) for flat_map in (both, other))
    for a, b in zip(one.places, two.places, strict=True):
        assert (a.kind, len(a.triangles)) == (b.kind, len(b.triangles))
        assert np.allclose(turn.apply(a.point.copy()), b.point)
        assert (a.area, a.excess, a.worst_ratio) == pytest.approx((b.area, b.excess, b.worst_ratio))
        assert order[b.id] == a.id


@pytest.mark.slow
def test_a_pit_is_shrunk_and_its_cut_relieves_it(pit, tmp_path):
    points, faces, flat_map = pit
    worst = voxflat.worst_places(flat_map)
    first = worst.places[0]
    assert first.kind == "shrunk"
    assert np.linalg.norm(first.point[:2] - [24, 17]) < 3
    path = first.cut.ids
    edges = {frozenset(pair) for face in faces.tolist() for pair in zip(face, face[1:] + face[:1], strict=True)}
    assert all(frozenset(pair) in edges for pair in pairwise(path.tolist()))
    on_border = (points[path, :2] == 0) | (points[path, :2] == 40)
    assert on_border.any(axis=1).tolist() == [False] * (len(path) - 1) + [True]
    assert first.cut.length == pytest.approx(np.linalg.norm(np.diff(points[path], axis=0), axis=1).sum())
    assert np.array_equal(points[path], first.cut.points)

    worst.save_cuts(tmp_path / "cuts.json", 1)
    for cuts in (tmp_path / "cuts.json", worst.cuts(1)):
        relieved = voxflat.flatten((points, faces), cuts=cuts)
        assert np.array_equal(relieved.ids[relieved.faces], flat_map.ids[flat_map.faces])
        areas, logs = area_changes(relieved)
        assert (areas * np.abs(logs))[first.triangles].sum() < first.excess / 2
        assert relieved.distortion.triangles.area_beyond_1_5 < flat_map.distortion.triangles.area_beyond_1_5 / 2


@pytest.mark.slow
def test_the_gain_is_that_of_the_sketch_without_and_with_the_cut(pit):
    from voxflat.surfaces.cuts import sketch_error

    points, faces, flat_map = pit
    worst = voxflat.worst_places(flat_map, 1)
    whole = voxflat.surface((points, faces))
    with_cut = voxflat.surface((points, faces)).cut(cuts=worst.cuts(1), relax=False).surface
    assert worst.sketch_error == sketch_error(whole, None, None)
    assert worst.places[0].cut.gain == pytest.approx(worst.sketch_error - sketch_error(with_cut, None, None))


@pytest.mark.slow
def test_what_touches_the_border_is_cut_on_inwards():
    flat_map = laid(*swollen(middles=((0, 15, -0.5),)))
    (place, *_) = voxflat.worst_places(flat_map, 1).places
    assert (place.kind, place.point[0] < 3) == ("stretched", True)
    deepest = flat_map.points[flat_map.faces[place.triangles], 0].max()
    assert place.cut.points[0, 0] > 2 * deepest  # the inner end
    assert place.cut.points[-1, 0] == 0


@pytest.mark.slow
def test_a_map_with_cuts_hands_them_on(tmp_path):
    points, faces = square(20)
    cut = np.flatnonzero((points[:, 0] == 10) & (points[:, 1] < 8))
    keep = points[:, 0] < 19
    flat_map = voxflat.surface((points, faces)).keep(keep).flatten(Voxflat(sources=20), cuts=[cut])
    worst = voxflat.worst_places(flat_map)
    assert worst.cuts()[0] == cut.tolist()
    worst.save_cuts(tmp_path / "cuts.json")
    assert json.loads((tmp_path / "cuts.json").read_text())["drop"] == np.flatnonzero(~keep).tolist()
    again = voxflat.flatten((points, faces), Voxflat(sources=20), cuts=tmp_path / "cuts.json")
    assert np.array_equal(again.ids, flat_map.ids)


@pytest.mark.slow
def test_parcels_name_the_places(both):
    labels = np.where(both.points[:, 0] < 15, 3, 7)
    worst = voxflat.worst_places(both, 2, beyond=1.25, cuts=False, parcels=labels)
    assert {place.kind: place.parcel for place in worst.places} == {"shrunk": "3", "stretched": "7"}
    assert "parcel" in worst.table().splitlines()[1]


@pytest.mark.slow
def test_files(both, tmp_path):
    worst = voxflat.worst_places(both, 2, beyond=1.25)
    worst.save(tmp_path / "worst.json")
    content = json.loads((tmp_path / "worst.json").read_text())
    assert content.pop("provenance")["function"] == "worst_places"
    assert content == worst.figures()
    worst.save(tmp_path / "worst.tsv")
    head, *rows = [line.split("\t") for line in (tmp_path / "worst.tsv").read_text().splitlines()]
    assert len(rows) == 2
    for row, place in zip(rows, worst.places, strict=True):
        told = dict(zip(head, row, strict=True))
        assert float(told["area_mm2"]) == place.area
        assert float(told["cut_length_mm"]) == place.cut.length
        assert told["parcel"] == "n/a"
    refused(r"ends in \.json or \.tsv", worst.save, tmp_path / "worst.xml")


@pytest.mark.slow
def test_what_cannot_be_meant_is_refused(both):
    refused("beyond is 1. Pass a factor greater than 1", voxflat.worst_places, both, beyond=1)
    refused("beyond is nan. Pass a factor", voxflat.worst_places, both, beyond=np.nan)
    for count in (-1, 1.5):
        refused(f"count is {count}", voxflat.worst_places, both, count)
    refused("there is no region 2. Pass a number from 1 to 1", voxflat.worst_places(both, 1, cuts=False).cuts, 2)
    flat_map = voxflat.flatten(np.ones((9, 9, 1), int), method=Grossmann2002(sources=20))
    refused("no triangles on which to measure areas", voxflat.worst_places, flat_map)


@pytest.mark.slow
def test_figures_show_them(both, tmp_path):
    worst = voxflat.worst_places(both, 2, beyond=1.25)
    drawn = figures.worst_places(worst)
    assert {text.get_text() for text in drawn.axes[0].texts} == {"1", "2"}
    figures.save(drawn, tmp_path / "worst.png", worst.provenance)
    assert (tmp_path / "worst.png").stat().st_size > 10_000
    pytest.importorskip("pyvista")
    picture, without = (figures.worst_places_3d(w, size=(600, 300)) for w in (worst, replace(worst, places=())))
    assert picture.shape == (300, 600, 3)
    assert (picture != without).any(axis=2).sum() > 200  # outlines, cuts and numbers


@pytest.mark.slow
def test_the_commands_of_the_how_to_run(pit, tmp_path, monkeypatch):
    points, faces, flat_map = pit
    monkeypatch.chdir(tmp_path)
    flat_map.save("map.npz")
    io.write_mesh("pit.ply", io.Mesh(points, faces))
    commands = how_to.commands(how_to.text("worst-places"))
    assert len(commands) == 2
    for command in commands:
        result = succeed(*shlex.split(command))
    assert "1 shrunk" in result.output
    succeed("flatten", "pit.ply", "--cuts", "cuts.json", "-o", "relieved.npz")
    relieved = voxflat.load("relieved.npz").distortion.triangles
    assert relieved.area_beyond_1_5 < flat_map.distortion.triangles.area_beyond_1_5 / 2
    assert (tmp_path / "worst.tsv").read_text().startswith("number\tkind\tarea_mm2")


def test_the_median_of_a_place_counts_every_part_of_its_area_alike():
    points, faces = square(4)
    across = np.array([0, 4.0, 7, 9, 10])[points[:, 0].astype(int)]  # columns 4, 3, 2 and 1 wide, and 2.5 on the map
    flat_map = laid(np.column_stack([across, points[:, 1:]]), faces, points[:, :2] * [2.5, 1])
    areas, logs = area_changes(flat_map)
    place = _place(flat_map, 1, np.arange(len(faces)), areas, logs, areas.sum(), None)
    assert (place.median_ratio, place.worst_ratio) == pytest.approx((2.5 / 3, 2.5))


def test_a_cut_from_the_border_is_three_times_as_deep_as_the_place():
    points, faces = square(20)
    ways = _Ways(laid(points, faces, points[:, :2].copy()), 1, None)
    middles = points[faces].mean(axis=1)
    for depth, reach in ((2, 6), (3, 9)):  # rectangles at the left border, with their corners' depth
        inside = np.flatnonzero((middles[:, 0] < depth) & (np.abs(middles[:, 1] - 10) < 0.5 * depth))
        path = points[ways._through(np.unique(faces[inside]), SimpleNamespace(area=float(depth**2)))]
        assert path[-1, 0] == 0
        assert path[0, 0] == reach
