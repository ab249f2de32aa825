"""Maps in a browser: what the page holds, and what it shows and says, in headless Chromium."""

import base64
import html
import json
import re
import zlib

import numpy as np
import pytest
from lab_runs import console_of
from numpy.testing import assert_allclose, assert_array_equal

pv = pytest.importorskip("pyvista")

from voxflat import InputError  # noqa: E402
from voxflat._pyvista.browser import page_of  # noqa: E402
from voxflat._pyvista.laying import laid  # noqa: E402

pytestmark = pytest.mark.slow  # opens a browser


@pytest.fixture(scope="module")
def flat():
    ball = pv.Icosphere(radius=20.0, nsub=2)
    ball.point_data["height </script>"] = ball.points[:, 2]
    ball.cell_data["number"] = np.arange(ball.n_cells)
    return ball.voxflat(sources=20, relax=False)


def scene_of(text):
    content = json.loads(re.search(r'<script type="application/json">(.*?)</script>', text, re.DOTALL)[1])
    data, arrays, at = zlib.decompress(base64.b64decode(content["data"])), {}, 0
    for array in content["arrays"]:
        coded = np.frombuffer(data, "<u2", array["length"], at)
        arrays[array["name"]] = np.where(coded == 65535, np.nan, array["low"] + array["step"] * coded)
        at += 2 * array["length"]
    return content, arrays, np.frombuffer(data, "<u4", offset=at).reshape(-1, 3)


def test_the_page_holds_the_map_and_all_its_values(flat, tmp_path):
    before = flat.copy()
    flat.voxflat.export_html(tmp_path / "ball.html", 'A <b>"ball"')
    assert flat == before
    text = (tmp_path / "ball.html").read_text()
    assert "<h1>A &lt;b&gt;&#34;ball&#34;</h1>" in text
    assert not re.search(r'(src|href)="?(https?:)?//', text)
    content, arrays, faces = scene_of(text)
    assert_array_equal(faces, flat.regular_faces)
    assert_array_equal(content["ids"], flat["vertex_ids"])
    assert_allclose(arrays["uv"].reshape(-1, 2), flat.points[:, :2], atol=1e-3)
    assert_allclose(arrays["folded"].reshape(-1, 3), flat["surface_points"], atol=1e-3)
    _, places = laid(np.asarray(flat.points, dtype=float), np.asarray(flat["surface_points"], dtype=float))
    assert_allclose(arrays["smooth"].reshape(-1, 3), places, atol=2e-3)
    assert_allclose(arrays["distance_error"], 100 * flat["distance_error"], atol=1e-3)
    assert_allclose(arrays["height </script>"], flat["height </script>"], atol=1e-3)
    assert next(layer["name"] for layer in content["layers"]) == "distance_error"
    assert {"areal", "angle", "isometric", "quasi_conformal", "flipped", "number"} <= set(arrays)


def test_the_pointer_reads_values_and_the_slider_unfolds(flat, tmp_path):
    move = """<script>setTimeout(() => {
      const viewer = document.querySelector(".viewer").viewer, canvas = document.querySelector("canvas.flat");
      const box = canvas.getBoundingClientRect();
      const uv = viewer.values.uv, x = uv.filter((_, n) => n % 2 === 0), y = uv.filter((_, n) => n % 2 === 1);
      const [left, right, low, high] = [Math.min(...x), Math.max(...x), Math.min(...y), Math.max(...y)];
      const scale = 0.96 * Math.min(box.width / (right - left), box.height / (high - low));  // the map fills the canvas
      canvas.dispatchEvent(new PointerEvent("pointermove", {
        clientX: box.left + box.width / 2 + scale * (x[40] - (left + right) / 2) + 2,
        clientY: box.top + box.height / 2 - scale * (y[40] - (low + high) / 2) - 2 }));
      const slider = document.querySelector("input[type=range]");
      slider.value = 1; slider.dispatchEvent(new Event("input"));
      const select = document.querySelector("select");
      select.selectedIndex = 1; select.dispatchEvent(new Event("change"));
      document.body.dataset.places = Array.from(viewer.places.slice(0, 30)).map((v) => v.toFixed(3)).join(" ");
      document.body.dataset.marked = viewer.marked;
      document.body.dataset.bars = Array.from(document.querySelectorAll(".bar")).filter((bar) => !bar.hidden).length;
    }, 3000);</script>"""
    page = tmp_path / "page.html"
    page.write_text(flat.voxflat.show("Ball").html.replace("</body>", f"{move}</body>"))
    said, drawn = console_of(page, "--window-size=1280,900")
    assert said == []
    marked = int(re.search(r'data-marked="(\d+)"', drawn)[1])
    told = re.search(r"<output>Vertex (\d+), at \((.*?)\) mm\. mean relative error of distances \(%\): (\S+) ", drawn)
    assert int(told[1]) == flat["vertex_ids"][marked]
    assert_allclose([float(part) for part in told[2].split(",")], flat["surface_points"][marked], atol=0.06)
    assert float(told[3]) == pytest.approx(100 * flat["distance_error"][marked], rel=0.006)
    assert marked == 40
    _, places = laid(np.asarray(flat.points, dtype=float), np.asarray(flat["surface_points"], dtype=float))
    shown = np.array(re.search(r'data-places="([^"]*)"', drawn)[1].split(), dtype=float).reshape(-1, 3)
    assert_allclose(shown, places[:10], atol=5e-3)
    assert 'data-bars="1"' in drawn


def test_a_notebook_shows_the_page(flat):
    page = flat.voxflat.show("Ball")
    frame = page._repr_html_()
    assert html.unescape(re.search(r'srcdoc="([^"]*)"', frame)[1]) == page.html
    assert repr(page).startswith("<MapPage: 0.")


def test_large_maps_make_no_large_pages():
    count = 300
    plane = pv.Plane(i_size=200, j_size=200, i_resolution=count, j_resolution=count).triangulate()
    plane.clear_data()
    plane.point_data["surface_points"] = np.asarray(plane.points, dtype=np.float64)
    plane.point_data["value"] = np.random.default_rng(0).random(plane.n_points)  # does not shrink
    assert plane.n_points > 90_000
    assert len(page_of(plane, "plane").html) < 1e6


def test_what_cannot_be_a_page_is_refused(flat, tmp_path):
    with pytest.raises(InputError, match=r"cannot save a page as map\.txt"):
        flat.voxflat.export_html(tmp_path / "map.txt")
    with pytest.raises(InputError, match="radius: the mesh is a flat map already"):
        flat.voxflat.show(radius=2.0)
    bare = flat.copy()
    for data in (bare.point_data, bare.cell_data):
        for name in set(data) - {"surface_points", "vertex_ids"}:
            del data[name]
    with pytest.raises(InputError, match="there is nothing to show"):
        bare.voxflat.show()
    assert not list(tmp_path.iterdir())
