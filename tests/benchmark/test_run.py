"""Tools run one map per process, within a limit, and what they cannot do is recorded with the reason."""

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from command_line import fail, succeed

import voxflat
from voxflat.benchmark import run as running
from voxflat.benchmark.making import make
from voxflat.benchmark.manifest import chosen
from voxflat.benchmark.prepare import load
from voxflat.benchmark.score import load_result
from voxflat.benchmark.tools import FREE, GIVEN, PUBLISHED, TOOLS, NoMapError, Tool, on_circle, tutte
from voxflat.io.files import EXTRAS


@pytest.fixture
def job(small):
    made = load(small, "u-shape")
    return {"points": made.points, "faces": made.faces}


def test_the_boundary_on_a_circle_keeps_its_shares_and_the_area(job):
    loop, circle = on_circle(job)
    radius = np.linalg.norm(circle, axis=1)
    np.testing.assert_allclose(np.pi * radius**2, 2700, rtol=1e-3)
    steps = np.linalg.norm(circle - np.roll(circle, 1, axis=0), axis=1)
    lengths = np.linalg.norm(job["points"][loop] - np.roll(job["points"][loop], 1, axis=0), axis=1)
    np.testing.assert_allclose(steps / steps.sum(), lengths / lengths.sum(), rtol=1e-2)


def test_each_inner_vertex_of_tuttes_map_is_in_the_middle_of_its_neighbours(job):
    flat = tutte(job, {})
    loop, circle = on_circle(job)
    np.testing.assert_array_equal(flat.uv[loop], circle)
    near = [set() for _ in flat.uv]
    for a, b, c in job["faces"].tolist():
        near[a] |= {b, c}
        near[b] |= {a, c}
        near[c] |= {a, b}
    inner = np.setdiff1d(np.arange(len(flat.uv)), loop)
    middle = np.array([flat.uv[sorted(near[vertex])].mean(axis=0) for vertex in inner])
    np.testing.assert_allclose(flat.uv[inner], middle, atol=1e-9)
    assert voxflat.measure((job["points"], job["faces"]), flat.uv, sources=1).triangles.flipped == 0


@pytest.mark.slow
def test_tools_make_and_score_maps_and_keep_them(small, tmp_path):
    words = ["bench", "run", small, "--surface", "u-shape", "-o", tmp_path / "out"]
    succeed(*words, "--tools", "voxflat,tutte,published")
    results = {name: load_result(tmp_path / f"out/given-{name}.json") for name in ("voxflat", "tutte")}
    assert not (tmp_path / "out/given-published.json").exists()  # nobody published a map of this surface
    measures = {name: result["surfaces"]["u-shape"]["measures"] for name, result in results.items()}
    assert measures["voxflat"]["edge"] < 1e-6 < measures["tutte"]["edge"]
    assert results["voxflat"]["version"] == f"voxflat {voxflat.__version__}"
    costs = results["voxflat"]["surfaces"]["u-shape"]["costs"]
    assert 0 < costs["cpu"] < 60
    assert 0.01 < costs["peak"] < 4
    before = (tmp_path / "out/given-voxflat.json").read_bytes()
    succeed(*words, "--tools", "voxflat")
    assert (tmp_path / "out/given-voxflat.json").read_bytes() == before  # nothing is made twice
    record = tmp_path / "out/given/voxflat/run.json"
    earlier = json.loads(record.read_text())
    for changed in ({"code": "of another day"}, {"inputs": {"u-shape": {}}}):  # another program, and another surface
        record.write_text(json.dumps(earlier | changed))
        np.savez(tmp_path / "out/given/voxflat/u-shape.npz", uv=load(small, "u-shape").points[:, :2] ** 2)
        succeed(*words, "--tools", "voxflat")
        again = load_result(tmp_path / "out/given-voxflat.json")
        assert again["surfaces"]["u-shape"]["measures"] == measures["voxflat"]
    (tmp_path / "out/given/voxflat/u-shape.npz").unlink()
    succeed(*words, "--tools", "voxflat")
    again = load_result(tmp_path / "out/given-voxflat.json")
    assert again["surfaces"]["u-shape"]["measures"] == measures["voxflat"]


@pytest.mark.slow
def test_charts_of_a_tool_that_cuts_are_measured(small, tmp_path):
    succeed("bench", "run", small, "--surface", "u-shape", "--track", "free", "--tools", "xatlas", "-o", tmp_path)
    measures = load_result(tmp_path / "free-xatlas.json")["surfaces"]["u-shape"]["measures"]
    assert 0 < measures["within_charts"] <= 1
    assert measures["vertices_lost"] == 0
    assert measures["edge"] < 0.05


@pytest.mark.slow
def test_a_tool_that_takes_too_long_is_ended_with_its_programs(job):
    with pytest.raises(NoMapError, match=r"made no map within 0 s"):
        make("voxflat", job, 0.3)
    tetrahedron = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    with pytest.raises(NoMapError, match=r"the surface is closed\. Cut it open"):
        make("tutte", {"points": np.eye(4, 3), "faces": tetrahedron}, 60)


def test_a_tool_that_is_not_installed_is_recorded(small, tmp_path, monkeypatch):
    tool = Tool("none", "nothing", ("no-such-package",), (GIVEN,), tutte)
    monkeypatch.setitem(running.TOOLS, "none", tool)
    told = []
    assert running.run(small, tmp_path, ["none"], GIVEN, chosen(["u-shape"]), tell=told.append) == []
    record = json.loads((tmp_path / "given/none/run.json").read_text())
    assert record["missing"] == {
        "u-shape": "no-such-package is not installed. Run pip install 'voxflat[bench]'",
    }


def test_unknown_tools_and_tracks_are_refused(small, tmp_path):
    words = ["bench", "run", small, "-o", tmp_path / "out"]
    fail(1, "arapp is not a tool of the track 'given'. Choose from voxflat, arap", *words, "--tools", "arapp")
    fail(1, "arap is not a tool of the track 'free'", *words, "--tools", "arap", "--track", "free")
    assert not (tmp_path / "out").exists()
    assert running.checked_tools("all", GIVEN)[-1] == PUBLISHED
    assert "xatlas" in running.checked_tools("all", FREE)


def test_every_package_of_a_tool_is_in_the_extra():
    text = (Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8")
    listed = re.search(r"^bench = \[ # other tools.*?^\]", text, re.MULTILINE | re.DOTALL)[0]
    assert all(f'"{package}' in listed for tool in TOOLS.values() for package in tool.packages[:1])
    assert {"igl", "uvunwrap", "pymeshlab"} <= set(EXTRAS)
    assert "igl" not in sys.modules
