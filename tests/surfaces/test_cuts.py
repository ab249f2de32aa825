"""Relaxation cuts, cuts files, and the medial wall."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from command_line import succeed
from hard_shapes import quads
from mesh_files import icosphere
from refusals import refused

import voxflat
from voxflat.methods import Voxflat
from voxflat.pipeline.cut_surface import whereabouts
from voxflat.surfaces.cuts import Cut
from voxflat.surfaces.parts import medial_wall_of


def ball(n=12):
    """Return a closed sphere of radius 30 mm, whose poles are the last two vertices."""
    polar, around = np.meshgrid(np.pi * np.arange(1, n) / n, np.pi * np.arange(2 * n) / n, indexing="ij")
    places = [np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)]
    points = np.concatenate([np.stack(places, axis=-1).reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]])
    number = np.arange(2 * n * (n - 1)).reshape(n - 1, 2 * n)
    following, pole = np.roll(number, -1, axis=1), np.full(2 * n, number.size)
    ends = [[pole, number[0], following[0]], [pole + 1, following[-1], number[-1]]]
    between = quads(number[:-1], number[1:], following[1:], following[:-1])
    return 30 * points, np.concatenate([*(np.stack(end, axis=1) for end in ends), between])


POINTS, FACES = BALL = ball()
WHOLE = voxflat.surface(BALL)
KEEP = POINTS[:, 2] < 10
CAP = WHOLE.keep(KEEP)


def relaxation(cuts):
    return sum(cut.length for cut in cuts if cut.reason == "relaxation")


@pytest.mark.slow
def test_a_closed_surface_is_relaxed_unless_forbidden():
    plain, relaxed = (WHOLE.flatten(Voxflat(sources=60), relax=relax) for relax in (False, None))
    reasons = [[cut["reason"] for cut in flat.metadata["automatic_cuts"]] for flat in (plain, relaxed)]
    assert reasons[0] == ["closed sphere"]
    assert reasons[1][0] == "closed sphere"
    assert set(reasons[1][1:]) == {"relaxation"}
    assert any("reduce the estimated distance error" in warning for warning in relaxed.metadata["warnings"])
    errors = [flat.distortion.best_scale.relative_error for flat in (plain, relaxed)]
    assert errors[1] < 0.8 * errors[0]


@pytest.mark.slow
def test_a_disk_is_cut_where_it_pays_and_nobody_has_said_where():
    whole, cut = (CAP.flatten(Voxflat(sources=60), relax=relax) for relax in (False, None))
    assert {cut["reason"] for cut in cut.metadata["automatic_cuts"]} == {"relaxation"}
    assert any("reduce the estimated distance error" in warning for warning in cut.metadata["warnings"])
    assert cut.distortion.raw.relative_error < 0.9 * whole.distortion.raw.relative_error
    assert WHOLE.keep(POINTS[:, 2] < -20).cut().cuts == ()  # hardly curved: it does not pay
    given = CAP.cut(cuts=[cut.metadata["automatic_cuts"][0]["ids"]])
    assert [one.reason for one in given.cuts] == ["given"]
    patch = WHOLE.keep((POINTS, FACES[KEEP[FACES].all(axis=1)]))  # a patch of triangles is cut as it is
    assert patch.cut().cuts == ()
    assert patch.cut(relax=True).cuts


@pytest.mark.slow
def test_a_disk_is_cut_to_the_length_that_is_asked_for():
    cut = CAP.cut(relax=60.0)
    assert 40 < relaxation(cut.cuts) <= 60
    topology = cut.surface.core.topology()
    assert (topology["euler"], len(topology["loops"])) == (1, 1)
    for one in cut.cuts:
        assert np.linalg.norm(np.diff(POINTS[one.ids], axis=0), axis=1).sum() == pytest.approx(one.length)
    assert CAP.cut(relax=0).cuts == ()
    assert CAP.cut(relax=True).cuts


def test_own_cuts_are_kept_and_count():
    rim = WHOLE.path(len(POINTS) - 1, int(np.flatnonzero(KEEP)[0]), geodesic="edges")
    cut = CAP.cut(cuts=[rim.ids], relax=rim.length + 40)
    assert cut.cuts[0].reason == "given"
    np.testing.assert_array_equal(cut.cuts[0].ids, rim.ids)
    assert 0 < relaxation(cut.cuts) <= 40
    _, counts = np.unique(cut.surface.vertices, return_counts=True)
    assert np.isin(rim.ids[1:], np.unique(cut.surface.vertices)[counts > 1]).all()


@pytest.mark.slow
def test_a_file_of_cuts_makes_the_same_surface(tmp_path):
    first = WHOLE.drop(~KEEP).cut(relax=80.0)
    first.save(tmp_path / "cuts.json")
    second = WHOLE.cut(cuts=tmp_path / "cuts.json")
    np.testing.assert_array_equal(first.surface.faces, second.surface.faces)
    np.testing.assert_array_equal(first.surface.vertices, second.surface.vertices)
    assert sorted(json.loads((tmp_path / "cuts.json").read_text())["drop"]) == np.flatnonzero(~KEEP).tolist()


def test_a_file_may_name_few_vertices_of_a_cut(tmp_path):
    (tmp_path / "cuts.json").write_text(json.dumps({"cuts": [[len(POINTS) - 1, 0]]}))
    cut = WHOLE.cut(cuts=tmp_path / "cuts.json", relax=False)
    np.testing.assert_array_equal(cut.cuts[0].ids, WHOLE.path(len(POINTS) - 1, 0, geodesic="edges").ids)


def at_every_door(tmp_path, cuts, told):
    """Check that cuts are refused with the same text, after the name or number of the cut."""
    (tmp_path / "cuts.json").write_text(json.dumps({"cuts": [*cuts.values()], "names": [*cuts]}))
    last = len(cuts)
    names = {f"cut {last}": [*cuts.values()], f"cut '{[*cuts][-1]}'": cuts}
    names |= {f"{tmp_path / 'cuts.json'}: cut '{[*cuts][-1]}'": tmp_path / "cuts.json"}
    for name, given in names.items():
        for act in (WHOLE.cut, WHOLE.flatten):
            refused(f"^{re.escape(name)} {told}", act, cuts=given)


def test_a_cut_that_separates_a_piece_is_named_at_every_door(tmp_path):
    loop = [*range(72, 96), 72]  # a parallel
    half, rim = len(loop) // 2, CAP.vertices[CAP.core.topology()["loops"][0]["vertices"]]
    line = WHOLE.path(len(POINTS) - 1, 200, geodesic="edges").ids.tolist()
    told = r"separates [\d.]+ % of the area from the rest of the surface, because it forms a closed line"
    for cuts in ({"ring": loop}, {"line": line, "ring": loop}, {"one": loop[: half + 1], "two": loop[half:]}):
        at_every_door(tmp_path, cuts, told)
    ends = rim[POINTS[rim, 0].argmin()], rim[POINTS[rim, 0].argmax()]
    across = CAP.path(ends[0], len(POINTS) - 1, ends[1], geodesic="edges").ids  # from border to border
    refused("^cut 'across' separates", CAP.cut, {"across": across})


def test_a_cut_that_is_not_a_path_is_named_at_every_door(tmp_path):
    at_every_door(tmp_path, {"dot": [3]}, "has only one vertex")
    refused("^cut 'jump': the vertices 3 and 200 of the path are not connected", WHOLE.cut, {"jump": [3, 200]})
    refused("^cut 1: vertex 20000 is not on the surface", WHOLE.cut, [[3, 20000]])
    refused("the name of a cut is 7", WHOLE.cut, {7: [3, 4]})
    (tmp_path / "cuts.json").write_text(json.dumps({"cuts": [[0, 8]], "names": ["a", "b"]}))
    refused("'names' does not match the 1 cuts", WHOLE.cut, tmp_path / "cuts.json")


def test_names_of_cuts_are_kept_in_maps_files_and_titles(tmp_path):
    lines = {"north": WHOLE.path(len(POINTS) - 2, 100, geodesic="edges").ids, "south": [len(POINTS) - 1, 245, 221]}
    opened = WHOLE.cut(lines, relax=False)
    assert [cut.name for cut in opened.cuts][:2] == ["north", "south"]
    assert opened.title(0).startswith("north, ")
    opened.save(tmp_path / "cuts.json")
    again = WHOLE.cut(tmp_path / "cuts.json", relax=False)
    assert [(cut.name, cut.ids.tolist()) for cut in again.cuts] == [(cut.name, cut.ids.tolist()) for cut in opened.cuts]
    flat = opened.flatten(Voxflat(sources=40))
    assert flat.metadata["cut_names"] == ["north", "south"]
    unnamed = WHOLE.cut([*lines.values()], relax=False).flatten(Voxflat(sources=40))
    np.testing.assert_array_equal(unnamed.uv, flat.uv)
    assert unnamed.metadata["cut_names"] == [None, None]


@pytest.mark.parametrize("content", ["", "[]", '{"cuts": 3}', '{"cuts": [["a"]]}', '{"cuts": [[[1, 2, 3]]]}'])
def test_a_bad_file_of_cuts_is_refused(tmp_path, content):
    (tmp_path / "cuts.json").write_text(content)
    refused(r"cuts\.json", WHOLE.cut, cuts=tmp_path / "cuts.json")
    refused(r"none\.json", WHOLE.cut, cuts=tmp_path / "none.json")


@pytest.mark.parametrize("relax", [-1, float("nan"), float("inf"), "long"])
def test_a_bad_length_is_refused(relax):
    refused("relax", WHOLE.cut, relax=relax)


@pytest.mark.slow
def test_the_medial_wall_is_where_the_surfaces_touch():
    wall = POINTS[:, 2] > 24
    pial = (POINTS * np.where(wall, 1.0, 1.1)[:, None], FACES)
    cut = voxflat.surface(BALL, pial=pial).drop("medial wall").cut()
    np.testing.assert_array_equal(np.sort(cut.left_out), np.flatnonzero(wall))
    for other in (None, (POINTS * 1.1, FACES), BALL):
        refused("label", voxflat.surface(BALL, pial=other).drop, "medial wall")


@pytest.mark.slow
def test_the_command_writes_what_flatten_takes(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    voxflat.io.write_mesh("ball.ply", voxflat.io.Mesh(*BALL))
    np.save("drop.npy", ~KEEP)
    cut = "cut ball.ply --drop drop.npy"
    content = json.loads(succeed(*f"{cut} --relax-length 60 -o cuts.json --json".split()).stdout)
    assert 0 < sum(cut["length"] for cut in content["cuts"]) <= 60
    succeed(*f"{cut} --relax -o open.ply".split())
    assert len(voxflat.io.read_mesh("open.ply").points) > KEEP.sum()
    succeed(*["flatten", "ball.ply", "--cuts", "cuts.json", "--sources", "60", "-o", "map.npz"])
    flat = voxflat.load("map.npz")
    assert flat.metadata["automatic_cuts"] == []
    assert len(flat) == content["vertices"]


@pytest.mark.parametrize("side", [2, 13])
def test_a_path_over_voxels_that_have_two_vertices_stays_on_its_side(side):
    volume = np.zeros((20, 16, 16), dtype=np.uint8)
    volume[2:18, 2:14, 2:7] = 1
    volume[2:18, 7, 7:14] = 1  # a fin, one voxel thick: each of its voxels is seen from either side
    whole = voxflat.surface(volume, spacing=(1, 1, 1))
    start, end = (int(np.argmin(np.linalg.norm(whole.ids - at, axis=1))) for at in ((9, side, 4), (9, 7, 13)))
    steps, _ = whole.core.edge_path(start, end)
    done = whole.cut(cuts=[whole.ids[steps]], relax=False)
    assert len(done.surface) == len(whole) + len(steps) - 2  # all but its ends are doubled


def test_sides_of_a_hemisphere_are_lateral_and_medial():
    for structure, sides in (("CortexLeft", "lm"), ("CortexRight", "ml"), (None, "lr")):
        found = [whereabouts(POINTS[POINTS[:, 0] * sign > 20], POINTS, structure)[0] for sign in (-1, 1)]
        assert "".join(found) == sides
    hemisphere = voxflat.surface(voxflat.io.Mesh(*BALL, structure="CortexLeft"))
    middle = int(POINTS[:, 0].argmax())
    assert hemisphere.cut({"rim": [middle, middle + 24]}, relax=False).title(0) == "rim, medial"


def test_a_cut_is_told_by_its_name_or_number_and_where_it_lies():
    points, faces = ball(16)
    whole = voxflat.surface((points, faces))
    ways = [whole.path(*ends, geodesic="edges").ids for ends in ((480, 0), (481, 448), (224, 232))]
    cuts = (Cut(ways[0], None, "relaxation"), Cut(ways[1], None, "given"), Cut(ways[2], None, "template", "calcarine"))
    made = replace(whole.cut(relax=False), cuts=cuts)
    assert [made.title(n) for n in range(3)] == ["cut 1, superior", "cut 2, inferior", "calcarine, right, anterior"]
    assert whereabouts(points, points) == "middle"


@pytest.mark.parametrize(
    ("share", "apart", "told"),
    [
        (0.1, 0.2, None),
        (0.1, 0.5, "do not touch"),
        (0.25, 0.0, r"covers 2\d"),
        (0.003, 0.0, r"covers 0\.\d"),
    ],
)
def test_a_medial_wall_is_1_to_20_percent_of_a_hemisphere_where_the_cortex_is_thinner_than_0_3_mm(share, apart, told):
    points, faces = icosphere(50.0)
    wall = points[:, 2] > 50 - 100 * share  # Archimedes
    pial = points * (1 + np.where(wall, apart, 3.0) / 50)[:, None]
    surface = voxflat.surface((points, faces), pial=(pial, faces))
    if told:
        refused(told, medial_wall_of, surface)
    else:
        assert medial_wall_of(surface).mean() == pytest.approx(share, rel=0.15)
