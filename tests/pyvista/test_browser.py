"""Maps in a browser: the contents of a page, and its display in headless Chromium."""

import html
import json
import re

import numpy as np
import pytest
import pyvista as pv
from lab_runs import console_of, drawn_with, scene_of
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused

import voxflat
from voxflat._pyvista.browser import browser_page
from voxflat.maps.placement import aligned
from voxflat.methods import Voxflat

pytestmark = pytest.mark.slow  # opens a browser


@pytest.fixture(scope="module")
def flat():
    ball = pv.Icosphere(radius=20.0, nsub=2)
    ball.point_data["height </script>"] = ball.points[:, 2]
    ball.cell_data["number"] = np.arange(ball.n_cells)
    return ball.voxflat(method=Voxflat(sources=20), relax=False)


def shown_by(text):
    return scene_of(re.search(r'<script type="application/json">(.*?)</script>', text, re.DOTALL)[1])


def smooth_places(flat):
    return aligned(np.asarray(flat.points, dtype=float), np.asarray(flat["surface_points"], dtype=float))[1]


def test_the_page_holds_the_map_and_all_its_values(flat, tmp_path):
    before = flat.copy()
    flat.voxflat.export_html(tmp_path / "ball.html", 'A <b>"ball"')
    assert flat == before
    text = (tmp_path / "ball.html").read_text()
    assert "<h1>A &lt;b&gt;&#34;ball&#34;</h1>" in text
    assert not re.search(r'(src|href)="?(https?:)?//', text)
    content, arrays, faces = shown_by(text)
    assert_array_equal(faces, flat.regular_faces)
    assert_array_equal(content["ids"], flat["vertex_ids"])
    assert_allclose(arrays["uv"].reshape(-1, 2), flat.points[:, :2], atol=1e-3)
    assert_allclose(arrays["folded"].reshape(-1, 3), flat["surface_points"], atol=1e-3)
    assert_allclose(arrays["smooth"].reshape(-1, 3), smooth_places(flat), atol=2e-3)
    assert_allclose(arrays["distance_error"], 100 * flat["distance_error"], atol=1e-3)
    assert_allclose(arrays["height </script>"], flat["height </script>"], atol=1e-3)
    assert next(layer["name"] for layer in content["layers"]) == "distance_error"
    assert {"areal", "angle", "isometric", "quasi_conformal", "flipped", "number"} <= set(arrays)


def test_the_pointer_reads_values_and_the_slider_unfolds(flat, tmp_path):
    move = """
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
    """
    drawn = drawn_with(move, flat.voxflat.show("Ball").html, tmp_path)
    marked = int(re.search(r'data-marked="(\d+)"', drawn)[1])
    told = re.search(r"<output>Vertex (\d+), at \((.*?)\)\. mean relative error of distances \(%\): (\S+) ", drawn)
    assert int(told[1]) == flat["vertex_ids"][marked]
    assert_allclose([float(part) for part in told[2].split(",")], flat["surface_points"][marked], atol=0.06)
    assert float(told[3]) == pytest.approx(100 * flat["distance_error"][marked], rel=0.006)
    assert marked == 40
    shown = np.array(re.search(r'data-places="([^"]*)"', drawn)[1].split(), dtype=float).reshape(-1, 3)
    assert_allclose(shown, smooth_places(flat)[:10], atol=5e-3)
    assert 'data-bars="1"' in drawn


SEEN = """<script>setTimeout(() => {
  const viewer = document.querySelector(".viewer").viewer, facts = parent.document.body.dataset;
  const drawn = (canvas) => {
    const gl = canvas.gl, pixels = new Uint8Array(4 * canvas.element.width * canvas.element.height);
    gl.readPixels(0, 0, canvas.element.width, canvas.element.height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    return pixels.filter((value, n) => n % 4 === 3 && value).length / (pixels.length / 4);
  };
  const ground = getComputedStyle(document.body).backgroundColor, { away } = viewer.axes();
  facts.seen = JSON.stringify({ drawn: [viewer.flat, viewer.space].map(drawn), away, ground, width: innerWidth });
  const right = (one) => one.getBoundingClientRect().right;
  facts.beyond = Math.max(...Array.from(viewer.root.querySelectorAll("*"), right)) - right(viewer.root);
  Array.from(document.querySelectorAll("button")).find((button) => button.textContent === "above").click();
  facts.above = viewer.axes().away[2];
}, 3000);</script>"""


@pytest.mark.parametrize(("width", "dark"), [(1280, False), (390, True)], ids=["desktop", "phone, dark"])
def test_the_page_fits_and_is_drawn(width, dark, tmp_path):
    x, y = np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-2, 2, 17), indexing="ij")
    leaning = pv.StructuredGrid(x, y, 0.2 * (x * x - y * y)).rotate_x(40).rotate_z(70)
    page = tmp_path / "page.html"
    text = leaning.voxflat.show("Leaning", relax=False).html.replace("</body>", f"{SEEN}</body>")
    frame = f'<iframe srcdoc="{html.escape(text)}" style="border: 0; width: {width}px; height: 844px"></iframe>'
    page.write_text(f"<!doctype html><body>{frame}</body>")  # windows of Chromium are at least 500 pixels wide
    scheme = f"--blink-settings=preferredColorScheme={0 if dark else 1}"
    said, drawn = console_of(page, "--window-size=1400,900", scheme)
    assert said == []
    seen = json.loads(html.unescape(re.search(r'data-seen="([^"]*)"', drawn)[1]))
    assert seen["width"] == width
    assert min(seen["drawn"]) > 0.15
    assert (sum(map(int, re.findall(r"\d+", seen["ground"]))) < 200) == dark
    assert float(re.search(r'data-beyond="([^"]*)"', drawn)[1]) <= 0
    normal = pv.Plane().rotate_x(40).rotate_z(70).point_normals[0]
    assert abs(np.dot(seen["away"], normal)) > 0.95  # the view direction of the map
    assert float(re.search(r'data-above="([^"]*)"', drawn)[1]) < -0.99


def test_labels_stay_labels_and_numbers_exact():
    plane = pv.Plane(i_resolution=12, j_resolution=12).triangulate()
    middle = plane.cell_centers().points
    plane.cell_data["code"] = np.where(middle[:, 0] < 0.2, 16_711_680, 3)  # such as colours of an annotation
    plane.cell_data["one"] = np.arange(plane.n_cells) == 100
    plane.cell_data["height"] = middle[:, 1]
    plane.point_data["number"] = 10**9 + np.arange(plane.n_points)
    flat = plane.voxflat(method=Voxflat(sources=20))
    content, arrays, faces = shown_by(flat.voxflat.show().html)
    layers = {layer["name"]: layer for layer in content["layers"]}
    assert set(arrays["code"]) == {3, 16_711_680}
    of_triangles = np.where(arrays["code"] == 3, 1, -1)[faces].sum(axis=1)
    assert_array_equal(of_triangles[np.abs(of_triangles) == 3] > 0, (flat["code"] == 3)[np.abs(of_triangles) == 3])
    assert layers["code"]["labelled"]
    assert len(layers["code"]["colours"]) == 2 * 3
    assert_array_equal(np.flatnonzero(arrays["one"]), np.sort(faces[np.flatnonzero(flat["one"])[0]]))
    assert_array_equal(arrays["number"], flat["number"])
    assert not layers["number"]["labelled"]
    mean = np.bincount(faces.ravel(), np.repeat(flat["height"], 3)) / np.bincount(faces.ravel())
    assert_allclose(arrays["height"], mean, atol=1e-4)


def test_a_map_without_pyvista_has_the_same_page(flat, tmp_path):
    flat_map = pv.Icosphere(radius=20.0, nsub=2).voxflat.flatten(method=Voxflat(sources=20), relax=False)
    voxflat.map_page(flat_map, "Ball").save(tmp_path / "ball.html")
    content, arrays, faces = shown_by((tmp_path / "ball.html").read_text())
    of_mesh, same, triangles = shown_by(flat.voxflat.show("Ball").html)
    assert_array_equal(faces, triangles)
    assert (content["unit"], of_mesh["unit"]) == ("", "")
    for name in ("uv", "folded", "distance_error", "areal", "angle", "isometric", "quasi_conformal", "flipped"):
        assert_allclose(arrays[name], same[name], atol=2e-3)
    assert_allclose(arrays["curvature"], flat_map.curvature, atol=1e-4)


def test_a_notebook_shows_the_page(flat):
    page = flat.voxflat.show("Ball")
    assert html.unescape(re.search(r'srcdoc="([^"]*)"', page._repr_html_())[1]) == page.html
    assert repr(page).startswith("<MapPage: 0.")


def test_large_maps_make_no_large_pages():
    count = 300
    plane = pv.Plane(i_size=200, j_size=200, i_resolution=count, j_resolution=count).triangulate()
    plane.clear_data()
    plane.point_data["surface_points"] = np.asarray(plane.points, dtype=np.float64)
    plane.point_data["value"] = np.random.default_rng(0).random(plane.n_points)  # random values cannot be compressed
    assert plane.n_points > 90_000
    assert len(browser_page(plane, "plane").html) < 1e6


def test_what_cannot_be_a_page_is_refused(flat, tmp_path):
    refused(r"map\.txt: unknown file name ending '\.txt'", flat.voxflat.export_html, tmp_path / "map.txt")
    refused("radius: the mesh is already a flat map", flat.voxflat.show, radius=2.0)
    bare = flat.copy()
    for data in (bare.point_data, bare.cell_data):
        for name in set(data) - {"surface_points", "vertex_ids"}:
            del data[name]
    refused("no array with one number per point", bare.voxflat.show)
    assert not list(tmp_path.iterdir())
