"""Registration to fsaverage's sphere."""

from types import SimpleNamespace

import anatomy
import lab
import numpy as np
import pytest
from refusals import refused
from studies import before_subdivision

import voxflat
from voxflat.surfaces.standard.pattern import icosphere
from voxflat.surfaces.standard.registration import _validated


def folds(points, faces):
    """Return the number of flipped triangles on the sphere."""
    return int((np.linalg.det(points[faces.astype(np.int64)]) <= 0).sum())


def unit(points):
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def apart(points, others):
    """Return the mean angle between positions, in mm on a sphere with the area of a hemisphere."""
    return 72 * np.arccos(np.clip((points * others).sum(axis=1), -1, 1)).mean()


def rotation(seed):
    matrix = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return matrix * np.linalg.det(matrix)


@pytest.fixture(scope="module")
def hemispheres():
    """Return points, triangles and registered sphere of both sides: a quarter of fsaverage5's pial vertices."""
    faces = before_subdivision(lab.fsaverage5("white_left")[1], lab.VERTICES)
    places = {side: [lab.fsaverage5(f"{kind}_{side}")[0] for kind in ("pial", "sphere")] for side in ("left", "right")}
    return {side: (pial[: lab.VERTICES], faces, sphere[: lab.VERTICES]) for side, (pial, sphere) in places.items()}


@pytest.fixture(scope="module")
def left(hemispheres):
    return voxflat.surface(hemispheres["left"][:2]).register()


def test_the_icosphere_covers_the_sphere_once():
    points, faces = icosphere(3)
    assert (len(points), len(faces)) == (642, 1280)
    assert np.allclose(np.linalg.norm(points, axis=1), 1)
    assert folds(points, faces) == 0
    assert len(np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)) == 1920


@pytest.mark.medium
def test_a_hemisphere_is_registered_to_a_few_millimetres(hemispheres, left):
    _, faces, sphere = hemispheres["left"]
    assert left.side == "left"
    assert left.confidence > 0.99
    assert folds(left.points, faces) == 0
    assert np.allclose(np.linalg.norm(left.points, axis=1), 1)
    assert apart(left.points, unit(sphere)) < 2.5


@pytest.mark.slow
def test_the_side_is_found_however_it_is_turned_scaled_and_numbered(hemispheres):
    points, faces, sphere = hemispheres["right"]
    plain = voxflat.surface((points, faces)).register()
    assert plain.side == "right"
    assert apart(plain.points, unit(sphere)) < 2.5
    order = np.random.default_rng(0).permutation(len(points))  # where each vertex goes
    turned = np.empty_like(points)
    turned[order] = points @ rotation(1).T * 1e-3 + [4, -5, 6]
    other = voxflat.surface((turned, order[faces])).register()
    assert other.side == "right"
    assert apart(other.points[order], plain.points) < 1.5


@pytest.mark.slow
def test_threads_change_no_bit(hemispheres, left):
    assert np.array_equal(voxflat.surface(hemispheres["left"][:2]).register(threads=1).points, left.points)


@pytest.mark.slow
def test_a_mirrored_hemisphere_is_the_other_side(hemispheres):
    points, faces, _ = hemispheres["left"]
    assert voxflat.surface((points * [-1, 1, 1], faces[:, ::-1])).register().side == "right"


@pytest.mark.slow
def test_a_medial_wall_that_is_left_out_does_not_matter(hemispheres, left):
    points, faces, _ = hemispheres["left"]
    wall = np.linalg.norm(points - lab.fsaverage5("white_left")[0][: lab.VERTICES], axis=1) < 0.3
    kept = faces[~wall[faces].any(axis=1)]
    made = voxflat.surface((points, kept)).register()
    assert made.side == "left"
    assert folds(made.points, made.surface.faces) == 0
    assert apart(made.points, left.points[made.surface.vertices]) < 5
    assert np.isnan(made.sphere).any(axis=1).sum() == len(points) - len(made.points)


@pytest.mark.slow
def test_the_wrong_side_is_refused(hemispheres):
    whole = voxflat.surface(hemispheres["left"][:2])
    refused(r"side is 'right', but .* the left side .*. Pass side='left'", whole.register, side="right")


def ball(radii, waves=0, seed=0):
    points, faces = icosphere(4)
    rng = np.random.default_rng(seed)
    ripples = np.cos(points @ (6 * rng.normal(size=(3, waves))) + rng.uniform(0, 6.3, waves)).sum(axis=1)
    return points * np.asarray(radii) * (1 + 0.02 * ripples)[:, None], faces


@pytest.mark.medium
def test_a_ball_is_no_hemisphere():
    refused("not a cortical hemisphere", voxflat.surface(ball([50, 50, 50])).register)


@pytest.mark.slow
@pytest.mark.parametrize("waves", [0, 60])
def test_an_ellipsoid_is_no_hemisphere_even_with_random_folds(waves):
    refused("not a cortical hemisphere", voxflat.surface(ball([40, 85, 60], waves)).register)


@pytest.mark.medium
def test_handles_and_sides_that_do_not_exist_are_refused(hemispheres):
    refused("side is 'both'. Pass 'left' or 'right'", voxflat.surface(hemispheres["left"][:2]).register, side="both")
    ring = np.zeros((24, 24, 8), dtype=np.uint8)
    ring[4:20, 4:20, 2:6] = 1
    ring[9:15, 9:15] = 0
    refused(r"1 handle\(s\), but a sphere has none. .*repair", voxflat.surface(ring, repair="none").register)


def test_it_can_be_cancelled(hemispheres):
    with pytest.raises(voxflat.Cancelled):
        voxflat.surface(hemispheres["left"][:2]).register(progress=lambda stage, done, total: False)


@pytest.mark.medium
@pytest.mark.parametrize("name", ["lh.sphere.reg.surf.gii", "lh.sphere.reg"])
def test_the_file_is_a_sphere_of_radius_100_of_the_same_vertices(hemispheres, left, tmp_path, name):
    left.save(tmp_path / name)
    read = voxflat.surface(tmp_path / name)
    assert np.allclose(read.points, 100 * left.points, atol=1e-4)
    assert np.array_equal(np.sort(read.faces, axis=1), np.sort(hemispheres["left"][1], axis=1))
    assert read.metadata["structure"] in ("CortexLeft", None)
    assert left.provenance["parameters"]["side"] == "left"


@pytest.mark.slow
@pytest.mark.parametrize("side", ["left", "right"])
def test_without_a_sphere_standard_cuts_lie_where_they_do_with_it(hemispheres, side):
    points, faces, sphere = hemispheres[side]
    known = voxflat.surface((points, faces)).cut(cuts="standard", sphere=sphere, relax=False)
    found = voxflat.surface((points @ rotation(3) + [10, 20, 30], faces)).cut(cuts="standard", relax=False)
    assert [cut.name for cut in found.cuts] == ["calcarine", "medial 1", "medial 2", "medial 3", "temporal"]
    topology = found.surface.core.topology()
    assert (topology["euler"], len(topology["loops"])) == (1, 1)
    assert any("registered by its folds" in warning for warning in found.warnings)
    for ours, theirs in zip(found.cuts, known.cuts, strict=True):
        distances = np.linalg.norm(points[ours.ids][:, None] - points[theirs.ids], axis=2)
        assert distances.min(axis=1).mean() < 5


@pytest.mark.medium
def test_a_registration_is_a_sphere(hemispheres, left):
    whole = voxflat.surface(hemispheres["left"][:2])
    plain, given = (whole.cut("standard", sphere=sphere, relax=False) for sphere in (None, left))
    assert [cut.ids.tolist() for cut in given.cuts] == [cut.ids.tolist() for cut in plain.cuts]
    assert given.sphere.name == plain.sphere.name
    refused(
        "the surface is the right hemisphere, but the files specify the left one",
        voxflat.surface(hemispheres["right"][:2]).cut,
        sphere=left,
    )


@pytest.mark.slow
def test_a_volume_gets_standard_cuts_too():
    """A hemisphere from voxels is cut, and the separate piece beside it is excluded."""
    white, _, faces = lab.hemisphere()
    labels, affine, _ = anatomy.voxelise(white, faces, 2.0)
    labels[:4, :4, :4] = 1
    found = voxflat.surface(labels, affine=affine).cut(cuts="standard", relax=False)
    assert len(found.cuts) == 5
    topology = found.surface.core.topology()
    assert (topology["euler"], len(topology["loops"])) == (1, 1)


@pytest.mark.parametrize(("better", "worse", "confidence"), [(1.4, 0.46, 0.62), (1.24, 0.1, 0.73), (1.3, 0.32, None)])
def test_the_evidence_is_the_agreement_plus_its_margin(better, worse, confidence):
    alignments = [{"score": score, "rigid": None, "correlations": None} for score in (worse, better)]
    found = {"template": 1, "alignments": alignments, "correlations": None, "affine": None, "points": None}
    whole = SimpleNamespace(origin=SimpleNamespace(structure=None))
    if confidence is None:  # 2.28 is less than 2.3
        refused(r"not a cortical hemisphere \(confidence 0\.44\)", _validated, whole, found, None, ())
    else:
        assert _validated(whole, found, None, ()).confidence == pytest.approx(confidence, abs=0.005)
