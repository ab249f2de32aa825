"""The page of results shows every map, marks the best values, and says where voxflat is not first."""

import copy
import csv
import json

import numpy as np
import pytest
from command_line import fail, succeed

from voxflat.benchmark.manifest import chosen
from voxflat.benchmark.page import markdown, rows_of, write_page
from voxflat.benchmark.prepare import load
from voxflat.benchmark.score import load_result, save_result, score


@pytest.fixture(scope="module")
def results(small, tmp_path_factory):
    """Return two results on the U: one of a map seen from the side, and a better one called voxflat."""
    folder = tmp_path_factory.mktemp("results")
    (folder / "maps").mkdir()
    points = load(small, "u-shape").points
    np.savez(folder / "maps/u-shape.npz", uv=points[:, [0, 2]])
    result = score(small, folder / "maps", "given", chosen(["u-shape"]))
    other = copy.deepcopy(result)
    other |= {"tool": "voxflat", "version": "1", "missing": {"cone": "it is | too steep"}}
    other["surfaces"]["u-shape"]["costs"] = {"wall": 3.0, "cpu": 4.0, "peak": 0.5}
    for name in ("relative_error", "edge"):
        other["surfaces"]["u-shape"]["measures"][name] /= 2
    other["surfaces"]["u-shape"]["measures"]["angle"] *= 2
    for name, content in (("side", result | {"tool": "side"}), ("ours", other)):
        save_result(content, folder / f"{name}.json")
    return [folder / "side.json", folder / "ours.json"]


def test_the_page_marks_the_best_and_lists_where_voxflat_is_not_first(results):
    loaded = [load_result(path) for path in results]
    text = markdown(loaded, rows_of(loaded), {"given": results[0].with_name("results-given.png")})
    cells = [line for line in text.splitlines() if "±" in line]
    ours, side = (next(line for line in cells if line.startswith(f"| {name} |")) for name in ("voxflat", "side"))
    measures = [result["surfaces"]["u-shape"]["measures"] for result in loaded]
    assert f"| **{100 * measures[1]['relative_error']:.2f}** ± " in ours
    assert f"| {100 * measures[0]['relative_error']:.2f} ± " in side
    assert f"**{measures[0]['angle']:.2f}**" in side
    worse = text[text.index("### Where voxflat is not first") :]
    assert f"| u-shape | angles, ° | {measures[1]['angle']:.2f} | {measures[0]['angle']:.2f} (side)" in worse
    assert "| u-shape | edges, %" not in worse
    assert "cone: it is / too steep" in text
    assert "| mris_flatten (FreeSurfer) |" in text


def test_the_command_writes_all_files_with_the_same_numbers(results, tmp_path):
    succeed("bench", "page", *results, "-o", tmp_path / "page")
    names = {path.name for path in (tmp_path / "page").iterdir()}
    assert names == {"results.md", "results.csv", "results.json", "results-given.png"}
    with (tmp_path / "page/results.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    stored = json.loads((tmp_path / "page/results.json").read_text(encoding="utf-8"))["results"]
    by_tool = {result["tool"]: result["surfaces"]["u-shape"] for result in stored}
    assert [row["tool"] for row in rows] == ["voxflat", "side"]  # the smallest error first
    for row in rows:
        for name, value in by_tool[row["tool"]]["measures"].items():
            assert float(row[name]) == pytest.approx(value)
    before = {name: (tmp_path / "page" / name).read_bytes() for name in names}
    write_page(results, tmp_path / "page")
    assert {name: (tmp_path / "page" / name).read_bytes() for name in names} == before


def test_results_that_do_not_belong_together_are_refused(results, tmp_path):
    fail(1, "two results contain a map of u-shape by side", "bench", "page", results[0], results[0], "-o", tmp_path)
    (tmp_path / "other.json").write_text("{}")
    fail(1, "is not a result of `voxflat bench score`", "bench", "page", tmp_path / "other.json", "-o", tmp_path / "a")
    assert not (tmp_path / "a").exists()
