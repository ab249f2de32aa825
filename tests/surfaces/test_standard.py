"""Standard cuts by the registered sphere, templates, and the standard frame."""

import json
from types import SimpleNamespace

import anatomy
import composed
import lab
import nibabel as nib
import numpy as np
import pytest
from command_line import run, succeed
from refusals import refused
from scipy.optimize import minimize
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation
from textures import areas

import voxflat
from voxflat import _core
from voxflat.io.overlays import read_region
from voxflat.methods import Voxflat
from voxflat.methods.common import _in_standard_frame
from voxflat.surfaces.standard.pattern import icosphere
from voxflat.surfaces.standard.sphere import Sphere, _apart, in_triangles, named_space, sphere_of
from voxflat.surfaces.standard.template import read_template, standard_template

NAMES = ["calcarine", "medial 1", "medial 2", "medial 3", "temporal"]
FEW = {"sources": 60, "threads": 1}
_FRAME = ("frame", "frame_points", "cut_names", "sphere")
FEWER = 162  # vertices, of which the first are those of fewer


@pytest.fixture(scope="module")
def sphere():
    return lab.fsaverage5("sphere_left")[0][: lab.VERTICES]


@pytest.fixture(scope="module")
def subject(tmp_path_factory, sphere):
    """Return the directory of a subject with lh.sphere.reg."""
    folder = tmp_path_factory.mktemp("subject")
    lab.write(folder)
    nib.freesurfer.write_geometry(folder / "lh.sphere.reg", sphere, lab.hemisphere()[2])
    return folder


@pytest.fixture(scope="module")
def small_subject(tmp_path_factory, sphere):
    """Return the directory of a subject with a quarter of the vertices, for which cuts are found faster."""
    folder = tmp_path_factory.mktemp("small")
    lab.write(folder, FEWER)
    nib.freesurfer.write_geometry(folder / "lh.sphere.reg", sphere[:FEWER], lab.hemisphere(FEWER)[2])
    return folder


@pytest.fixture(scope="module")
def standard(subject):
    return voxflat.surface(subject / "lh.white").cut()


@pytest.fixture(scope="module")
def flat(subject):
    return composed.flatten(subject / "lh.white", **FEW)


@pytest.mark.slow
def test_the_same_cuts_give_the_same_map_however_they_are_passed(subject, standard, flat, sphere):
    lines, whole = {cut.name: cut.ids for cut in standard.cuts}, voxflat.surface(subject / "lh.white")
    given = whole.drop(standard.left_out).flatten(
        Voxflat(sources=FEW["sources"]), cuts=lines, sphere=subject / "lh.sphere.reg"
    )
    assert {key: given.metadata[key] for key in _FRAME} == {key: flat.metadata[key] for key in _FRAME}
    assert flat.metadata["frame"] == "standard"
    np.testing.assert_allclose(given.uv, flat.uv, rtol=0, atol=1e-9)
    assert "given cuts" in voxflat.cite(given).text


def is_disk(cut):
    topology = cut.surface.core.topology()
    return (topology["euler"], len(topology["loops"]), len(topology["components"])) == (1, 1, 1)


def remeshed(seed, count, warp=0.03):
    """Return another mesh of the hemisphere, its warped sphere, and the true positions on the sphere."""
    random = np.random.default_rng(seed)
    dense, (white, faces) = lab.fsaverage5("sphere_left")[0] / 100, lab.fsaverage5("white_left")
    turn, height = np.arange(count) * 2.4, 1 - (2 * np.arange(count) + 1) / count
    places = np.column_stack([np.sqrt(1 - height**2) * np.cos(turn), np.sqrt(1 - height**2) * np.sin(turn), height])
    places += random.normal(scale=0.9 / np.sqrt(count), size=places.shape)
    places = Rotation.random(random_state=random).apply(places / np.linalg.norm(places, axis=1)[:, None])
    at, weights, _ = in_triangles(dense, faces, places)
    moved = places.copy()
    for _ in range(6):
        wave, way = random.normal(size=3), random.normal(size=3)
        moved += warp / 3 * np.cos(2 * places @ wave + random.uniform(0, 7))[:, None] * way
    moved /= np.linalg.norm(moved, axis=1)[:, None]
    return np.einsum("ij,ijk->ik", weights, white[at]), anatomy.outward_hull(places), moved, places


def turn_between(one, other, places, others):
    """Return the rotation between two maps in degrees, from corresponding points on the sphere."""
    anchors = standard_template("fsaverage", "left").anchors.sphere
    found = []
    for flat_map, on in ((one, places), (other, others)):
        corners, weights, _ = in_triangles(on[flat_map.ids], flat_map.faces, anchors)
        found.append(np.einsum("ij,ijk->ik", weights, flat_map.uv[corners]))
    return np.degrees(_core.turn_onto(found[0], found[0], found[1])[1])


@pytest.mark.medium
def test_a_subject_with_its_sphere_gets_the_five_standard_cuts(standard):
    assert [cut.name for cut in standard.cuts] == NAMES
    assert {cut.reason for cut in standard.cuts} == {"template"}
    assert is_disk(standard)
    assert any("standard cuts (calcarine, medial 1" in warning for warning in standard.warnings)


def test_cuts_are_simple_paths_from_the_wall_that_touch_nothing_else(standard, sphere):
    _, _, faces = lab.hemisphere()
    wall = set(standard.left_out.tolist())
    border = set(np.unique(faces[np.isin(faces, list(wall)).any(axis=1)]).tolist()) - wall
    paths = [cut.ids.tolist() for cut in standard.cuts]
    for path in paths:
        assert len(set(path)) == len(path)
        assert path[0] in border
        assert not border & set(path[1:])
        assert not wall & set(path)
    assert len({vertex for path in paths for vertex in path}) == sum(map(len, paths))
    for cut, line in zip(standard.cuts, standard_template("fsaverage", "left").cuts, strict=True):
        beside = KDTree(line.points).query(sphere[cut.ids] / 100)[0]
        assert np.median(beside) < 0.05  # an edge is 0.07 long
        assert np.linalg.norm(line.points[-1] - sphere[cut.ids[-1]] / 100) < 0.07


def test_the_wall_that_the_template_leaves_out_is_the_subjects_own(standard):
    white, pial, _ = lab.hemisphere()
    thin = np.linalg.norm(white - pial, axis=1) < 0.3
    assert thin[standard.left_out].mean() > 0.6
    assert np.isin(np.flatnonzero(thin), standard.left_out).mean() > 0.9


@pytest.mark.medium
def test_a_label_of_the_wall_stands_in_its_place_and_another_region_does_not(subject):
    own = voxflat.surface(subject / "lh.white").drop(subject / "lh.Medial_wall.label").cut()
    label = read_region(subject / "lh.Medial_wall.label", lab.VERTICES)
    assert np.isin(np.flatnonzero(label), own.left_out).mean() > 0.95  # but for corners of triangles that are kept
    assert label[own.left_out].mean() > 0.95
    assert [cut.name for cut in own.cuts] == NAMES
    assert is_disk(own)
    other = voxflat.surface(subject / "lh.white").drop([1000]).cut()
    assert any("0 % of the region that the template excludes" in warning for warning in other.warnings)
    assert 1000 in other.left_out
    assert len(other.left_out) > 100


def test_standard_cuts_are_made_where_nobody_has_said_what_to_flatten(subject, tmp_path):
    for name in ("lh.white", "lh.Medial_wall.label"):
        (tmp_path / name).write_bytes((subject / name).read_bytes())
    alone = voxflat.surface(tmp_path / "lh.white").cut(relax=False)  # no sphere beside it
    whole = voxflat.surface(subject / "lh.white")
    for cut in (alone, whole.cut(cuts="automatic", relax=False)):
        assert [one.reason for one in cut.cuts] == ["closed sphere"]
    patch = whole.disk(700, 25.0).cut()
    assert (patch.cuts, patch.sphere) == ((), None)
    assert whole.cut(cuts=[lab.hemisphere()[2][0, :2]], relax=False).cuts[0].reason == "given"
    assert whole.geodesic(2).shape[1] == lab.VERTICES  # distances are not asked to be cut


@pytest.mark.slow
def test_cuts_adapt_within_a_distance(subject, standard):
    adapted = voxflat.surface(subject / "lh.white").cut(adapt=12.0)
    by_reason = {reason: [cut for cut in adapted.cuts if cut.reason == reason] for reason in ("template", "relaxation")}
    assert [cut.name for cut in by_reason["template"]] == NAMES
    assert by_reason["relaxation"]
    assert is_disk(adapted)
    white = lab.hemisphere()[0]
    places = KDTree(white[np.concatenate([cut.ids for cut in standard.cuts])])
    assert max(places.query(white[cut.ids])[0].max() for cut in by_reason["relaxation"]) <= 12
    other = {"adapt": 12.0, "cuts": "automatic"}
    for wrong in (other, {"adapt": -1.0}, {"adapt": 5.0, "relax": False}, {"adapt": True}):
        refused("adapt", composed.cut, subject / "lh.white", **wrong)


def test_a_sphere_beside_that_does_not_fit_is_told_and_cuts_are_automatic(subject, sphere, tmp_path):
    (tmp_path / "lh.white").write_bytes((subject / "lh.white").read_bytes())
    nib.freesurfer.write_geometry(tmp_path / "lh.sphere.reg", sphere[:642], anatomy.outward_hull(sphere[:642]))
    cut = voxflat.surface(tmp_path / "lh.white").cut(relax=False)
    assert [cut.reason for cut in cut.cuts] == ["closed sphere"]
    assert any("642 vertices" in warning for warning in cut.warnings)
    refused("642 vertices", voxflat.surface(tmp_path / "lh.white").cut, cuts="standard")


@pytest.mark.slow
def test_check_says_what_standard_and_automatic_cuts_cost(small_subject):
    found = voxflat.check(small_subject / "lh.white")
    assert found.cuts_by == "standard"
    assert [cut["name"] for cut in found.named_cuts] == NAMES
    assert 0 < found.sketch_errors["automatic"] < found.sketch_errors["standard"] < 0.3
    assert "standard: calcarine" in found.table()
    assert found.can_flatten


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_other_meshes_with_warped_spheres_become_disks(seed):
    points, faces, sphere, _ = remeshed(seed, 500 + 400 * seed)
    cut = voxflat.surface((points, faces)).cut(cuts="standard", sphere=100 * sphere)
    assert is_disk(cut)
    assert [cut.name for cut in cut.cuts] == NAMES
    assert cut.sphere.side == "left"  # by the surface itself


@pytest.mark.slow
def test_both_sides_of_fsaverage5_become_disks_in_both_spaces():
    for side in ("left", "right"):
        surface, sphere = lab.fsaverage5(f"white_{side}"), lab.fsaverage5(f"sphere_{side}")[0]
        cut = voxflat.surface(surface).cut(cuts="standard", sphere=sphere)
        assert is_disk(cut)
        assert cut.sphere.side == side
        lines = [standard_template(space, side).cuts for space in ("fsaverage", "fs_LR")]
        for one, other in zip(*lines, strict=True):
            assert one.name == other.name
            lengths = [np.linalg.norm(np.diff(line.points, axis=0), axis=1).sum() for line in (one, other)]
            assert lengths[0] == pytest.approx(lengths[1], rel=0.3)
    left, right = (standard_template("fs_LR", side) for side in ("left", "right"))
    apart = KDTree(left.outlines[0].points * [-1, 1, 1]).query(right.outlines[0].points)[0]
    assert apart.mean() < 0.12  # the sides are mirror images in fs_LR, but people cut them


@pytest.mark.slow
def test_spheres_that_do_not_belong_to_the_surface_are_refused(subject, sphere, tmp_path):
    whole = voxflat.surface(subject / "lh.white")
    white, _, faces = lab.hemisphere()
    nan = sphere.copy()
    nan[7] = np.nan
    turned = Rotation.from_rotvec([0, 0, np.pi / 2]).apply(sphere)
    nib.freesurfer.write_geometry(tmp_path / "rh.sphere.reg", sphere, faces)
    other = np.random.default_rng(0).permutation(lab.VERTICES)
    nib.freesurfer.write_geometry(tmp_path / "lh.sphere.reg", sphere, other[faces])
    for given, reason in (
        (sphere[:-1], "2561 vertices, but the surface has 2562"),
        (white, "not a sphere around the origin"),
        (nan, "finite positions"),
        (np.zeros_like(sphere), "not a sphere around the origin"),
        (sphere * [-1, 1, 1], "mirrored"),
        (sphere[::-1], "flipped on the sphere"),
        (turned, "not registered"),
        (subject / "none", "the file does not exist"),
        (3, "sphere has type int"),
        ("lh.white", "the file does not exist"),
        (tmp_path / "rh.sphere.reg", "belongs to the right hemisphere, but the surface belongs to the left one"),
        (tmp_path / "lh.sphere.reg", "shares only"),
    ):
        refused(reason, sphere_of, whole, given)
    ball = 30 * icosphere(4)[0], icosphere(4)[1]
    refused("not a cortical hemisphere", voxflat.surface(ball).cut, cuts="standard")
    refused("sphere", voxflat.flatten, np.ones((3, 3, 3)), method="grossmann2002", sphere=sphere)


def test_the_side_is_what_the_surface_looks_like_and_the_space_what_the_file_says(sphere):
    white, _, faces = lab.hemisphere()
    whole = voxflat.surface((white + np.array([80, 0, 0]), faces))
    assert sphere_of(whole, 0.01 * sphere)[0].side == "left"
    mirrored = voxflat.surface((white * [-1, 1, 1], faces[:, ::-1]))
    assert sphere_of(mirrored, sphere * [-1, 1, 1])[0].side == "right"
    for name in ("sub-01_hemi-L_space-fsLR_desc-reg_sphere", "S.L.sphere.reg_LR.native", "S.L.sphere.MSMAll.native"):
        assert named_space(name) == "fs_LR"
    of_fsaverage = ("sub-01_hemi-L_desc-reg_sphere.surf.gii", "fs_LR-deformed_to-fsaverage.L.sphere.32k_fs_LR.surf.gii")
    for name in (*of_fsaverage, "tpl-fsLR_space-fsaverage_hemi-L_den-32k_sphere.surf.gii"):
        assert named_space(name) == "fsaverage"
    # a mesh of the anchors alone, which has places in both spaces
    anchors = [standard_template(space, "left").anchors for space in ("fsaverage", "fs_LR")]
    coarse = voxflat.surface((anchors[0].white, anatomy.outward_hull(anchors[0].sphere)))
    for space, of in zip(("fsaverage", "fs_LR"), anchors, strict=True):
        found, warnings = sphere_of(coarse, of.sphere)
        assert found.space == space
        assert any("assumed to be in fs_LR" in warning for warning in warnings) == (space == "fs_LR")


def test_few_triangles_turned_over_are_told(subject, sphere):
    folded = sphere.copy()
    folded[[2000, 2001]] = folded[[2001, 2000]]
    found, warnings = sphere_of(voxflat.surface(subject / "lh.white"), folded)
    assert 0 < found.folded < 26
    assert f"{found.folded} of 5120 triangles are flipped" in warnings[-1]


def test_a_template_of_the_whole_gives_the_same_cuts_again(standard, subject, tmp_path):
    standard.save_template(tmp_path / "mine.json")
    template = read_template(tmp_path / "mine.json")
    assert [line.name for line in template.cuts] == NAMES
    assert {line.root for line in template.cuts} == {"outline"}
    again = voxflat.surface(subject / "lh.white").cut(cuts=tmp_path / "mine.json")
    for one, other in zip(standard.cuts, again.cuts, strict=True):
        assert one.ids.tolist() == other.ids.tolist()
    # the outline runs through vertices that are kept, so that it may leave out one ring less or more
    assert len(set(standard.left_out.tolist()) ^ set(again.left_out.tolist())) <= len(template.outlines[0].points)


@pytest.mark.slow
def test_a_template_of_a_region_with_branching_cuts_serves_another_mesh(subject, sphere, tmp_path):
    patch = voxflat.surface(subject / "lh.white").disk(700, 45.0).cut(sphere=sphere, relax=90.0)
    assert len(patch.cuts) > 0
    patch.save_template(tmp_path / "region.json")
    points, faces, warped, true = remeshed(3, 3000, warp=0.0)
    other = voxflat.surface((points, faces)).cut(cuts=tmp_path / "region.json", sphere=warped)
    assert is_disk(other)
    assert [cut.name for cut in other.cuts] == [f"relaxation {number + 1}" for number in range(len(patch.cuts))]
    of_other, of_patch = (areas(cut.surface.points, cut.surface.faces).sum() for cut in (other, patch))
    assert of_other == pytest.approx(of_patch, rel=0.2)
    centres = [places[cut.surface.ids].mean(axis=0) for places, cut in ((true, other), (sphere / 100, patch))]
    assert np.linalg.norm(centres[0] - centres[1]) < 0.05


@pytest.mark.slow
def test_a_closed_surface_cut_by_lines_alone_makes_a_template(small_subject, tmp_path):
    how = {"cuts": "automatic", "sphere": small_subject / "lh.sphere.reg", "relax": 150.0}
    cut = voxflat.surface(small_subject / "lh.white").cut(**how)
    cut.save_template(tmp_path / "lines.json")
    template = read_template(tmp_path / "lines.json")
    assert template.outlines == ()
    assert template.cuts[0].root is None
    assert is_disk(voxflat.surface(small_subject / "lh.white").cut(cuts=tmp_path / "lines.json"))


def test_what_makes_no_template_is_refused(subject, sphere, tmp_path):
    whole = voxflat.surface(subject / "lh.white")
    refused("this surface has none", whole.cut(cuts="automatic", relax=False).save_template, tmp_path / "t.json")
    refused("no cuts and no excluded vertices", whole.cut(cuts=[], sphere=sphere).save_template, tmp_path / "t.json")
    assert not (tmp_path / "t.json").exists()


@pytest.mark.medium
@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"format": 2}, "newer version"),
        ({"space": "MNI"}, "space is 'MNI'"),
        ({"side": None}, "side is None"),
        ({"cuts": 3}, "cuts is not a list"),
        ({"cuts": [{"name": "", "line": [[1, 0, 0], [0, 1, 0]]}]}, "must have a name"),
        ({"cuts": [{"name": "a", "root": 3, "line": [[1, 0, 0], [0, 1, 0]]}]}, "root of 'a' is not a name"),
        (
            {"cuts": [{"name": "a", "root": "b", "line": [[1, 0, 0], [0.8, 0.6, 0]]}]},
            "'b', the root of 'a', is neither",
        ),
        ({"cuts": [{"name": "a", "line": [[1, 0, 0], [0, 2, 0]]}]}, "unit sphere"),
        ({"cuts": [{"name": "a", "line": [[1, 0, 0], [1, 0, 0]]}]}, "coincide"),
        ({"cuts": [{"name": "a", "line": [[1, 0, 0], [-1, 0, 0]]}]}, "too far apart"),
        ({"cuts": [{"name": "a", "line": [[1, 0, 0], [float("nan"), 0, 0]]}]}, "NaN is not a valid number in JSON"),
        ({"cuts": [{"name": "a", "line": [[1, 0], [0, 1]]}]}, "rows of 3"),
        ({"cuts": [], "outlines": []}, "neither outlines nor cuts"),
        ({"side": "right"}, "the side of the template .* is right, but the side of the sphere .* is left"),
        ({"space": "fs_LR"}, "the space of the template .* is fs_LR, but the space of the sphere .* is fsaverage"),
    ],
)
def test_damaged_templates_are_refused(standard, subject, tmp_path, change, reason):
    standard.save_template(tmp_path / "t.json")
    content = json.loads((tmp_path / "t.json").read_text()) | change
    (tmp_path / "t.json").write_text(json.dumps(content))
    refused(reason, voxflat.surface(subject / "lh.white").cut, cuts=tmp_path / "t.json")


@pytest.mark.medium
def test_maps_cut_by_a_template_lie_as_fsaverage5s_flat_map_does(flat, sphere):
    assert flat.metadata["frame"] == "standard"
    assert flat.metadata["cut_names"] == NAMES
    assert len(flat.metadata["cuts"]) == 5
    assert flat.metadata["cuts_by"] == "standard"
    assert flat.distortion.triangles.flipped == flat.distortion.triangles.crossings == 0
    anchors = standard_template("fsaverage", "left").anchors
    corners, weights, _ = in_triangles(sphere[flat.ids] / 100, flat.faces, anchors.sphere)
    places = np.einsum("ij,ijk->ik", weights, flat.uv[corners])
    assert places.mean(axis=0) == pytest.approx(anchors.flat.mean(axis=0), abs=1e-3)
    assert np.linalg.norm(places - anchors.flat, axis=1).mean() < 12
    assert _core.turn_onto(places, places, anchors.flat)[1] == pytest.approx(0, abs=1e-6)
    places = flat.points
    front, back = (flat.uv[places[:, 1] > 50].mean(axis=0), flat.uv[places[:, 1] < -85].mean(axis=0))
    top, bottom = (flat.uv[places[:, 2] > 65].mean(axis=0), flat.uv[places[:, 2] < -35].mean(axis=0))
    assert front[0] < back[0] - 100  # a left hemisphere seen from outside
    assert top[1] > bottom[1] + 100


@pytest.mark.slow
def test_small_changes_turn_a_map_by_less_than_a_degree(flat, subject, sphere):
    white, _, faces = lab.hemisphere()
    places = sphere / 100
    noise = np.random.default_rng(1).normal(scale=0.1, size=white.shape)
    noisy = composed.flatten((white + noise, faces), cuts="standard", sphere=sphere, **FEW)
    other_seed = composed.flatten(subject / "lh.white", **FEW, seed=5)
    points, triangles, warped, true = remeshed(4, 3000, warp=0.0)
    other_mesh = composed.flatten((points, triangles), cuts="standard", sphere=warped, **FEW)
    for other, on in ((noisy, places), (other_seed, places), (other_mesh, true)):
        assert abs(turn_between(other, flat, on, places)) < 1


@pytest.mark.slow
def test_mirrored_maps_exchange_left_and_right_alone(flat, subject):
    mirrored = composed.flatten(subject / "lh.white", mirror=True, **FEW)
    assert np.array_equal(mirrored.uv, flat.uv * [-1, 1])
    assert np.array_equal(mirrored.faces, flat.faces)
    assert mirrored.metadata["mirrored"]
    assert not flat.metadata["mirrored"]
    assert mirrored.distortion.figures() == flat.distortion.figures()
    image, other = (one.heat_map(2.0).data for one in (flat, mirrored))
    assert np.nanmedian(np.abs(image - other[:, ::-1])) < 0.02


def test_other_maps_stay_as_they_were(subject):
    patch = composed.flatten(subject / "lh.white", seed_point=700, radius=25.0, **FEW)
    assert patch.metadata["frame"] is None
    assert patch.metadata["sphere"] is None
    assert patch.metadata["cut_names"] == []


@pytest.mark.medium
def test_sets_of_points_are_compared_after_the_best_similarity_transform():
    points = np.random.default_rng(3).normal(size=(30, 3))
    turn = Rotation.from_euler("xyz", [20, -130, 70], degrees=True).as_matrix()
    moved = 2.5 * points @ turn.T + [10, -4, 3]
    assert _apart(points, moved) == pytest.approx(0, abs=1e-9)
    for onto in (moved + np.random.default_rng(4).normal(size=(30, 3)), moved * [-1, 1, 1]):  # a reflection is none

        def apart(of, onto=onto):
            return onto - np.exp(of[0]) * points @ Rotation.from_rotvec(of[1:4]).as_matrix().T - of[4:]

        starts = [[0, *axis, *onto.mean(axis=0)] for axis in Rotation.create_group("O").as_rotvec()]
        found = [minimize(lambda of: (apart(of) ** 2).sum(), start) for start in starts]
        best = apart(min(found, key=lambda one: one.fun).x)
        assert _apart(points, onto) == pytest.approx(np.median(np.linalg.norm(best, axis=1)), rel=1e-4)


def test_the_residual_in_the_standard_frame_is_a_root_mean_square():
    places, faces = icosphere(2)
    uv = np.random.default_rng(0).normal(size=(len(places), 2)) * [40, 90]
    sphere = Sphere(places, "fsaverage", "left", "", 0, 0.0)
    _, count, residual = _in_standard_frame(uv, SimpleNamespace(vertices=np.arange(len(places))), faces, sphere)
    anchors = standard_template("fsaverage", "left").anchors
    corners, weights, _ = in_triangles(places, faces, anchors.sphere)
    a, b = (of - of.mean(axis=0) for of in (np.einsum("ij,ijk->ik", weights, uv[corners]), anchors.flat))
    both = (a.T @ b).astype(complex)  # the best rotation makes the trace as large as this (Kabsch 1976)
    most = abs(both[0, 0] + both[1, 1] + 1j * (both[0, 1] - both[1, 0]))
    assert count == len(a)
    assert residual == pytest.approx(np.sqrt(((a**2).sum() + (b**2).sum() - 2 * most) / count), rel=1e-6)


def test_a_turn_onto_places_is_rigid_and_the_best():
    random = np.random.default_rng(0)
    onto = random.normal(size=(20, 2))
    angle = 2.5
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    places = 3 * onto @ turn + [5, -7] + random.normal(scale=0.1, size=onto.shape)
    uv, found = _core.turn_onto(places, places, onto)
    assert found == pytest.approx(-angle, abs=0.05)
    assert np.linalg.norm(uv[0] - uv[1]) == pytest.approx(np.linalg.norm(places[0] - places[1]))
    for more in (-1e-3, 1e-3):
        c, s = np.cos(more), np.sin(more)
        off = (uv - uv.mean(axis=0)) @ [[c, s], [-s, c]] + uv.mean(axis=0)
        assert np.square(off - onto).sum() > np.square(uv - onto).sum()
    assert _core.turn_onto(uv, uv[:1], onto[:1])[1] == 0
    refused("places and onto have \\[2, 3\\] rows", _core.turn_onto, uv, uv[:2], onto[:3])


@pytest.mark.slow
def test_the_command_line_saves_a_template_and_applies_it(small_subject, tmp_path, monkeypatch):
    monkeypatch.chdir(small_subject)

    def told(*words):
        return json.loads(succeed(*words, "--json").stdout)

    template = tmp_path / "t.json"
    cut = told("cut", "lh.white", "-o", tmp_path / "cuts.json", "--save-template", template)
    assert [one["name"] for one in cut["cuts"]] == NAMES
    how = ("--sphere", "lh.sphere.reg", "--sources", 60, "--mirror")
    flat = told("flatten", "lh.white", "--cuts", template, *how, "-o", tmp_path / "map.npz")
    assert flat["cut_names"] == NAMES
    assert (flat["frame"], flat["mirrored"], flat["cuts_by"]) == ("standard", True, str(template))
    assert [flat["sphere"][key] for key in ("space", "side")] == ["fsaverage", "left"]
    assert told("check", "lh.white", "--cuts", "standard")["cuts_by"] == "standard"
    assert run("flatten", "lh.white", "--cuts", "standard", "--cuts", "x", "-o", "m.npz").exit_code == 2
