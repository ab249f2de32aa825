"""Maps of any tool and in any format are measured alike, against distances that were computed before."""

import json

import numpy as np
import pytest
from command_line import fail, succeed

import voxflat
from voxflat.benchmark.manifest import chosen
from voxflat.benchmark.prepare import load
from voxflat.benchmark.score import cut_length, load_result, measure, score
from voxflat.benchmark.truth import load_truth, stored
from voxflat.io import Mesh, write_mesh

MEASURES = ("relative_error", "relative_error_30mm", "relative_error_10mm", "stress_1", "edge", "angle")


@pytest.fixture(scope="module")
def squeezed(small):
    """Return the U seen from the side, whose distances are wrong."""
    return load(small, "u-shape").points[:, [0, 2]]


def test_the_true_distances_are_exact(small):
    made = load(small, "u-shape")
    truth = load_truth(small, made)
    assert len(truth.sources) == 100
    rows = made.cut.geodesic(truth.sources[:5], geodesic="exact")
    np.testing.assert_allclose(truth.cut[:5], rows.values if hasattr(rows, "values") else np.asarray(rows), rtol=1e-6)
    np.testing.assert_array_equal(truth.cut, truth.uncut)


def test_distances_of_another_surface_are_not_used(small, tmp_path):
    import dataclasses

    made = load(small, "u-shape")
    moved = dataclasses.replace(made, points=made.points + 1)
    assert stored(small, made) is not None
    assert stored(small, moved) is None


@pytest.mark.slow
def test_all_formats_give_the_same_figures(small, squeezed, tmp_path):
    made = load(small, "u-shape")
    flat = Mesh(np.pad(squeezed, ((0, 0), (0, 1))), made.faces)
    textured = Mesh(made.points, made.faces, texture_coordinates=squeezed)
    for ending in (".surf.gii", ".ply", ".vtp"):
        (tmp_path / ending[1:]).mkdir()
        write_mesh(tmp_path / ending[1:] / f"u-shape{ending}", flat)
    (tmp_path / "obj").mkdir()
    write_mesh(tmp_path / "obj/u-shape.obj", textured)
    for name, arrays in {
        "uv": {"uv": squeezed},
        "three": {"uv": squeezed, "faces": made.faces, "vertices": np.arange(len(squeezed))},
    }.items():
        (tmp_path / name).mkdir()
        np.savez(tmp_path / name / "u-shape.npz", **arrays)
    folders = sorted(path for path in tmp_path.iterdir())
    assert len(folders) == 6
    found = [score(small, folder, "given", chosen(["u-shape"]))["surfaces"]["u-shape"] for folder in folders]
    for other in found[1:]:
        for name in MEASURES:
            assert other["measures"][name] == pytest.approx(found[0]["measures"][name], rel=1e-4), name


@pytest.mark.medium
def test_figures_are_those_of_voxflat_measure(small, squeezed):
    made = load(small, "u-shape")
    truth = load_truth(small, made)
    found = measure(made, truth, squeezed, "given")["measures"]
    sources = truth.sources.astype(np.uint32)
    bands = (5.0, 10.0, 15.0, 30.0)
    (judged,) = made.cut.core.judge([np.ascontiguousarray(squeezed)], sources, "exact", 1 << 30, 0, bands)
    for name in ("relative_error", "stress_1", "scale"):  # many distances are exactly 10 mm, up to rounding
        assert found[name] == pytest.approx(judged["best_scale"][name], rel=1e-4)
    distortion = voxflat.measure(made.cut, squeezed, sources=1)
    for name in ("angle", "equal_area_median", "equal_area_p95", "area_beyond_1_5", "flipped", "covering"):
        assert found[name] == pytest.approx(getattr(distortion.triangles, name), rel=1e-9)


@pytest.mark.medium
def test_the_best_map_of_a_bent_u_has_no_errors_except_around_its_notch(small):
    made = load(small, "u-shape")
    found = measure(made, load_truth(small, made), made.cut.flatten(relax=False).uv, "given")["measures"]
    assert found["edge"] < 1e-6
    assert found["symmetric_dirichlet_mean"] == pytest.approx(4)
    assert (found["flipped"], found["covering"], found["vertices_lost"], found["cut_length"]) == (0, 0, 0, 0)


@pytest.mark.medium
def test_free_cuts_are_measured_along_the_cuts_of_the_map(cube, cube_folder):
    _, made = cube
    truth = load_truth(cube_folder, made)
    flat = made.uncut.flatten()
    found = measure(made, truth, flat, "free")["measures"]
    assert found["edge"] < 1e-5
    assert found["relative_error"] < found["uncut_relative_error"]
    assert found["cut_length"] == pytest.approx(cut_length(made, made.points, made.faces, made.vertices))
    given = measure(made, truth, made.cut.flatten(relax=False), "given")["measures"]
    assert given["uncut_relative_error"] > 0.05


def test_the_length_of_cuts_counts_both_sides_once(cube):
    _, made = cube
    counts = np.bincount(made.vertices)
    assert (counts > 1).any()
    length = cut_length(made, made.points, made.faces, made.vertices)
    assert length > 7 * 20 * 0.999  # a tree of edges of 20 mm that reaches all eight corners
    assert cut_length(made, made.uncut_points, made.uncut_faces, np.arange(len(made.uncut_points))) == 0


def test_vertices_that_a_map_omits_are_counted(small, squeezed):
    made = load(small, "u-shape")
    kept = (made.faces > 400).all(axis=1)
    used, faces = np.unique(made.faces[kept], return_inverse=True)
    flat = squeezed[used], faces.reshape(-1, 3), used
    found = measure(made, load_truth(small, made), flat, "given")["measures"]
    assert found["vertices_lost"] == len(made.points) - len(used) >= 400
    assert found["sources"] < 100


def test_the_command_writes_a_result_and_names_what_is_missing(small, squeezed, tmp_path):
    (tmp_path / "maps").mkdir()
    np.savez(tmp_path / "maps/u-shape.npz", uv=squeezed)
    run = {"tool": "side view", "version": "1", "costs": {"u-shape": {"wall": 2.5}}, "missing": {"cone": "crashed"}}
    (tmp_path / "maps/run.json").write_text(json.dumps(run))
    words = ["bench", "score", small, tmp_path / "maps", "--surface", "u-shape"]
    text = succeed(*words, "-o", tmp_path / "a.json").stdout
    assert "u-shape: distance errors" in text
    succeed(*words, "-o", tmp_path / "b.json")
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()
    result = load_result(tmp_path / "a.json")
    assert (result["tool"], result["track"], result["missing"]) == ("side view", "given", {})
    assert result["surfaces"]["u-shape"]["costs"] == {"wall": 2.5}
    fail(1, "is not a directory", "bench", "score", small, tmp_path / "none", "-o", tmp_path / "c.json")
    (tmp_path / "maps/u-shape.ply").write_bytes(b"ply")
    fail(1, "contains several maps of u-shape", *words, "-o", tmp_path / "c.json")
    (tmp_path / "maps/u-shape.npz").unlink()
    fail(1, "u-shape.ply", *words, "-o", tmp_path / "c.json")
    (tmp_path / "maps/u-shape.ply").unlink()
    fail(1, "contains no map of the chosen surfaces", *words, "-o", tmp_path / "c.json")
    assert not (tmp_path / "c.json").exists()


@pytest.mark.medium
def test_the_commands_prepare_a_surface_and_its_distances(tmp_path):
    text = succeed("bench", "fetch", tmp_path, "--surface", "u-shape").stdout
    assert text == "1 of 1 surfaces are ready\n"
    told = json.loads(succeed("bench", "truth", tmp_path, "--json").stdout)
    assert told["surfaces"]["u-shape"]["sources"] == 100
    again = json.loads(succeed("bench", "truth", tmp_path, "--json").stdout)
    assert again == told
    fail(1, "does not contain the surface", "bench", "truth", tmp_path, "--surface", "cone")
    names = [one["name"] for one in json.loads(succeed("bench", "list", "--quick", "--json").stdout)["surfaces"]]
    assert names == [entry.name for entry in chosen(quick=True)]
