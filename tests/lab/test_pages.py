"""Parts of HTML pages: reduced points, and values that equal the values in the files."""

import json
import re
from itertools import pairwise

import nibabel as nib
import numpy as np
import pytest
from hard_shapes import signed_areas
from lab_runs import drawn_with, scene_of
from numpy.testing import assert_allclose, assert_array_equal

import voxflat
from voxflat.lab.pages import Layer, layers_of, scene, thinned
from voxflat.lab.results import LoadedResults, Results

pytestmark = pytest.mark.slow  # its fixtures take seconds


@pytest.fixture(scope="module")
def shown(made):
    return LoadedResults.read(Results.in_freesurfer(made, "lh"))


@pytest.mark.parametrize("most", [60, 200, 10_000])
def test_fewer_points_keep_the_outline_the_cuts_and_the_area(shown, most):
    flat = shown.flat_map
    ids = np.unique(flat.ids, return_inverse=True)[1]
    points, faces = thinned(flat.uv, flat.faces, ids, most)
    assert len(points) == len(np.unique(points))
    assert set(np.unique(faces)) == set(range(len(points)))
    doubled = np.flatnonzero(np.bincount(ids)[ids] > 1)
    assert np.isin(doubled, points).all()
    assert len(points) <= len(doubled) + 2.5 * most  # cells at the border contain small parts of the map
    kept, whole = (signed_areas(flat.uv, corners).sum() for corners in (points[faces], flat.faces))
    assert kept == pytest.approx(whole, rel=0.15 if most == 60 else 0.06)
    if most == 10_000:
        assert len(faces) == len(flat.faces)


def test_a_scene_holds_the_values_of_the_files(shown):
    layers = layers_of([shown.values])[0]
    content, found, faces = scene_of(scene(shown.flat_map, layers, shown.cuts))
    flat = shown.flat_map
    assert content["points"] == len(np.unique(flat.faces))
    assert_allclose(found["uv"].reshape(-1, 2), flat.uv, atol=0.01)
    assert_allclose(found["folded"].reshape(-1, 3), flat.points, atol=0.01)
    assert_array_equal(faces, flat.faces)
    assert [layer.name for layer in layers][:2] == ["z", "thickness"]  # in the order of the command
    for name, factor in (("thickness", 1), ("distanceerror", 100), ("areachange", 1)):
        wanted = factor * shown.values[name]
        assert_allclose(found[name], wanted, atol=1e-4 * np.ptp(wanted))
    assert list(content["cuts"]) == ["calcarine", "medial 1", "medial 2", "medial 3", "temporal"]
    for line, cut in zip(content["cuts"].values(), flat.metadata["cuts"], strict=True):
        assert_array_equal(np.array(content["ids"])[line], cut)


def test_cuts_stay_closed_where_the_surface_is_shown_smooth(shown):
    _, found, _ = scene_of(scene(shown.flat_map, layers_of([shown.values])[0], {}))
    smooth, ids = found["smooth"].reshape(-1, 3), shown.flat_map.ids
    assert max(np.ptp(smooth[ids == vertex], axis=0).max() for vertex in np.unique(ids)) < 0.01
    moved = np.linalg.norm(smooth - shown.flat_map.points, axis=1)
    assert np.median(moved) > 1
    assert (moved < 0.02).any()  # the rim


def test_text_of_users_cannot_end_a_script(shown):
    hostile = {"</script><b>": next(iter(shown.cuts.values()))}
    text = scene(shown.flat_map, layers_of([shown.values])[0], hostile)
    assert "<" not in text
    assert list(json.loads(text)["cuts"]) == list(hostile)


def test_the_sides_of_cuts_are_shown_on_the_map(made, tmp_path):
    tell = """
      const { cutSides, content } = document.querySelector(".viewer").viewer;
      const ids = cutSides.map((edges) => edges.map((edge) => edge.map((point) => content.ids[point])));
      document.body.dataset.sides = JSON.stringify(ids);"""
    drawn = drawn_with(tell, (made / "voxflat.html").read_text(), tmp_path)
    flat = voxflat.load(made / "surf" / "lh.voxflat.flat.npz")
    sides = json.loads(re.search(r'data-sides="([^"]+)"', drawn)[1])
    for shown, cut in zip(sides, flat.metadata["cuts"], strict=True):
        edges = sorted(sorted(edge) for edge in pairwise(cut))
        assert sorted(sorted(edge) for edge in shown) == sorted(2 * edges)  # either side of each


def test_the_pointer_reads_what_the_files_hold(made, tmp_path):
    across, down = 0.35, 0.4  # of the canvas
    move = f"""
      const canvas = document.querySelector("canvas.flat"), box = canvas.getBoundingClientRect();
      const at = {{ clientX: box.left + {across} * box.width, clientY: box.top + {down} * box.height }};
      canvas.dispatchEvent(new PointerEvent("pointermove", at));"""
    drawn = drawn_with(move, (made / "voxflat.html").read_text(), tmp_path)
    told = re.search(r"<output>Vertex (\d+), at \((.*?)\) mm\. Z: (\S+) · Thickness: (\S+) mm · ", drawn)
    vertex = int(told[1])
    flat = voxflat.load(made / "surf" / "lh.voxflat.flat.npz")
    low, high = flat.uv.min(axis=0), flat.uv.max(axis=0)
    size = max((high - low) / [1.2, 1.0]) / 0.96  # height of the canvas in mm; it is 1.2 times as wide
    wanted = (low + high) / 2 + size * np.array([1.2 * (across - 0.5), 0.5 - down])
    apart = np.linalg.norm(flat.uv - wanted, axis=1)
    assert np.linalg.norm(flat.uv[flat.ids == vertex][0] - wanted) < apart.min() + 1
    assert_allclose([float(part) for part in told[2].split(",")], flat.points[flat.ids == vertex][0], atol=0.06)
    thickness = nib.freesurfer.read_morph_data(made / "surf" / "lh.thickness")[vertex]
    assert float(told[4]) == pytest.approx(thickness, rel=0.006)


def test_the_worst_places_are_those_of_the_map_and_a_click_shows_them(made, tmp_path):
    worst = voxflat.worst_places(voxflat.load(made / "surf" / "lh.voxflat.flat.npz"))
    text = (made / "voxflat.html").read_text()
    table = text[text.index('<table class="worst">') :]
    rows = re.findall(r"<tr><td>.*?</tr>", table[: table.index("</table>")], re.DOTALL)
    assert len(rows) == len(worst.places) > 0
    for row, place in zip(rows, worst.places, strict=True):
        cells = [re.sub("<.*?>", "", cell) for cell in re.findall(r"<td.*?>(.*?)</td>", row)]
        area, ratios = f"{place.area:.1f}", f"{place.median_ratio:.2f} (extreme {place.worst_ratio:.2f})"
        assert cells[:4] == [str(place.number), place.kind, area, ratios]
        assert cells[5] == ("–" if place.cut is None else f"{place.cut.length:.0f}")
    click = """
      const views = [...document.querySelectorAll(".viewer")].map((root) => root.viewer.axes().away[0]);
      document.body.dataset.views = JSON.stringify(views);
      document.querySelector(".viewer").viewer.zoom = 8;
      document.querySelector("[data-place]").click();
      const seen = document.querySelector(".viewer").viewer, at = seen.spaceView();
      const spot = seen.places.subarray(3 * seen.marked);
      const on = (k) => at[k] * spot[0] + at[4 + k] * spot[1] + at[8 + k] * spot[2] + at[12 + k];
      document.body.dataset.place = Math.max(Math.abs(on(0)), Math.abs(on(1)));
      const viewer = document.querySelector(".viewer").viewer, out = viewer.normals.subarray(3 * viewer.marked);
      const towards = viewer.axes().away.reduce((sum, value, k) => sum - value * out[k], 0);
      document.body.dataset.towards = towards / Math.hypot(out[0], out[1], out[2]);
      const flat = viewer.flat, gl = flat.gl, width = gl.drawingBufferWidth, height = gl.drawingBufferHeight;
      const pixels = new Uint8Array(4 * width * height), green = [0, 0, 0];
      gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
      for (let n = 0; n < width * height; n++) {
        if (pixels[4 * n] || pixels[4 * n + 1] !== 255 || pixels[4 * n + 2]) continue;
        green[0] += n % width + 0.5, green[1] += Math.floor(n / width) + 0.5, green[2]++;
      }
      const view = viewer.flatView(), uv = viewer.values.uv.subarray(2 * viewer.marked);
      const wanted = [width, height].map((size, k) => ((view[5 * k] * uv[k] + view[12 + k] + 1) * size) / 2);
      document.body.dataset.off = Math.hypot(...wanted.map((value, k) => green[k] / green[2] - value));"""
    drawn = drawn_with(click, text, tmp_path)
    shown = [float(part) for part in re.search(r"<output>Vertex \d+, at \((.*?)\) mm", drawn)[1].split(",")]
    assert_allclose(shown, worst.places[0].point, atol=3)  # pages have fewer points
    assert [np.sign(x) for x in json.loads(re.search(r'data-views="(.*?)"', drawn)[1])] == [1, -1]  # from the sides
    assert float(re.search(r'data-place="(.*?)"', drawn)[1]) < 1  # on the canvas, at any zoom before
    assert float(re.search(r'data-towards="(.*?)"', drawn)[1]) == pytest.approx(1, abs=1e-3)
    assert float(re.search(r'data-off="(.*?)"', drawn)[1]) < 1.5  # pixels from the mark on the map to its point


def test_folds_do_not_darken_diverging_colours():
    def layer(low, high, name="z"):
        return Layer(name, "Z", "", np.zeros(1), "RdBu_r", (low, high))

    assert layer(0.0, 3.0).is_shaded
    assert not layer(-3.0, 3.0).is_shaded  # dark red is a high value
    assert not layer(0.0, 3.0, "distanceerror").is_shaded
