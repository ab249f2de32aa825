"""Figures of flat maps: folds, data pixel by pixel, names, annotations, layers."""

import dataclasses
import logging
import re
from xml.etree import ElementTree

import composed
import numpy as np
import pytest
import tifffile
from command_line import fail, run, succeed
from hard_shapes import sheet
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.textpath import TextPath
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image
from refusals import refused

import voxflat
from voxflat import figures
from voxflat.figures.flat_maps import folds
from voxflat.figures.marks import cut_names, directions, round_length, side
from voxflat.figures.names import place_names, text_size
from voxflat.figures.overlays import painted
from voxflat.io.label_tables import LabelTable
from voxflat.io.origin import VoxelOrigin
from voxflat.io.spaces import Space
from voxflat.io.volumes import Volume
from voxflat.maps.parcels import parcels_of
from voxflat.methods import Voxflat
from voxflat.surfaces.cuts import Cut

pytestmark = pytest.mark.slow  # figures have at least 850 pixels

LONG, HIGH = 40, 16  # vertices of the sheet, 1 mm apart
COUNT = LONG * HIGH
AWAY = Volume(np.ones((4, 4, 4), np.float32), np.eye(4) + np.eye(4, k=3) * 900)

FROM_CIFTI = "sub-01_task-language_space-fsLR_den-91k_stat-z_statmap.dscalar.nii, MATH-STORY"


def in_structure(flat_map, structure):
    return dataclasses.replace(flat_map, origin=dataclasses.replace(flat_map.origin, structure=structure))


@pytest.fixture(scope="module")
def flat_map():
    """Return the map of a surface in a sagittal plane with vertical furrows, seen from the left."""
    ends = (LONG - 1, HIGH - 1)
    points, faces = sheet(lambda y, z: (-0.3 * np.cos(2 * np.pi * y / 10) - 30, y, z), ends, (LONG, HIGH))
    flat = voxflat.flatten((points, faces[:, ::-1]), Voxflat(sources=40), relax=False)  # −x is outside
    return in_structure(flat, "CortexLeft")


@pytest.fixture(scope="module")
def cut_map(flat_map):
    """Return a map whose points 20 and 300 are points 5 and 200 on the other side of two named cuts."""
    ids = flat_map.ids.copy()
    ids[[20, 300]] = ids[[5, 200]]
    cuts = tuple(Cut(ids[[n]], None, "template", name) for n, name in ((5, "calcarine"), (200, "temporal")))
    return dataclasses.replace(flat_map, ids=ids, cuts=cuts)


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    """Use half the resolution, which is four times as fast; tests of the resolution undo this."""
    monkeypatch.setattr("voxflat.figures.page._MOST_PIXELS", 850)
    monkeypatch.setattr("voxflat.figures.page._LEAST_DPI", 150)


@pytest.fixture
def saved(flat_map, tmp_path):
    flat_map.save(tmp_path / "map.npz")
    return tmp_path / "map.npz"


def layer(figure, gid):
    """Return the images of a layer of the map."""
    return [image.get_array() for image in figure.axes[1].images if image.get_gid() == gid]


def shown_data(figure):
    """Return the pixels of the data, and the size of a pixel in mm."""
    (shown,) = layer(figure, "data")
    left, right, *_ = figure.axes[1].images[1].get_extent()
    return shown, (right - left) / shown.shape[1]


def texts(figure, gid=None):
    return [text for text in figure.axes[0].texts if gid in (None, text.get_gid())]


def test_gyri_are_light_and_sulci_dark(flat_map):
    (shown,) = layer(figures.flat_map(flat_map), "curvature")
    assert len(np.unique(shown[..., 0])) > 10
    raster = flat_map.raster(0.1)
    pixels = folds(flat_map, raster)
    y = raster.interpolate(flat_map.points)[..., 1]
    inner, wave = raster.inside & (y > 8) & (y < 32), np.cos(2 * np.pi * y / 10)
    crown, bottom = inner & (wave > 0.9), inner & (wave < -0.9)
    assert (pixels[crown, 0] > pixels[bottom, 0].max() + 40).all()
    assert (pixels[..., :3] == pixels[..., :1]).all()  # grey
    assert (pixels[..., 3] == np.where(raster.inside, 255, 0)).all()
    depth = folds(flat_map, raster, "sulcal depth")
    assert depth[crown, 0].mean() > depth[bottom, 0].mean() + 15
    bare = folds(dataclasses.replace(flat_map, curvature=None, sulcal_depth=None), raster)
    assert len(np.unique(bare[bare[..., 3] > 0], axis=0)) == 1


@pytest.mark.parametrize(
    ("above", "below", "passes"),
    [
        (None, None, lambda v: np.isfinite(v)),
        (0.5, None, lambda v: v > 0.5),
        (None, -0.5, lambda v: v < -0.5),
        (0.5, -0.5, lambda v: np.abs(v) > 0.5),
        (-0.5, 0.5, lambda v: np.abs(v) < 0.5),
    ],
)
@pytest.mark.parametrize("opacity", [1.0, 0.4])
def test_thresholds_and_opacity_pixel_by_pixel(above, below, passes, opacity):
    data = np.linspace(-1, 1, 2001).reshape(1, -1)
    data[0, ::100] = np.nan
    pixels = painted(data, "RdBu_r", (-1.0, 1.0), above=above, below=below, opacity=opacity)
    with np.errstate(invalid="ignore"):
        shown = passes(data)
    assert (pixels[..., 3] == np.where(shown, round(255 * opacity), 0)).all()
    expected = colormaps["RdBu_r"]((data[shown] + 1) / 2, bytes=True)
    assert_array_equal(pixels[shown][:, :3], expected[:, :3])


def test_an_overlay_lies_where_the_map_shows_it(flat_map):
    values = np.repeat(np.arange(float(LONG)), HIGH)  # y
    look = {"threshold": (20, None), "limits": (0, 40), "colour_map": "magma"}
    figure = figures.flat_map(flat_map, figures.Overlay(values, **look))
    shown, size = shown_data(figure)
    expected = flat_map.image(values, size).data
    assert shown.shape[:2] == expected.shape
    with np.errstate(invalid="ignore"):
        assert ((shown[..., 3] == 255) == (expected > 20)).all()
    assert figure.axes[2].get_title() == "overlay"


def test_limits_by_percentiles_and_by_sign(flat_map):
    values = np.linspace(0, 100, COUNT)
    bar = figures.flat_map(flat_map, figures.Overlay(values, limits=("10%", "90%"))).axes[2]
    assert bar.get_xlim() == pytest.approx((10, 90), abs=1)
    bar = figures.flat_map(flat_map, figures.Overlay(values - 30, label="effect (%)")).axes[2]
    assert bar.get_xlim()[0] == pytest.approx(-bar.get_xlim()[1])
    assert bar.get_title() == "effect (%)"


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"overlay": None, "threshold": 1.0}, "the overlay has no values. Pass data"),
        ({"overlay": None, "period": 360}, "the overlay has no values. Pass data"),
        ({"overlay": AWAY}, "does not overlap the map"),
        ({"overlay": np.ones(3)}, "3 values"),
        ({"limits": (3, 2)}, "Pass the lower limit first"),
        ({"limits": (3,)}, "two numbers"),
        ({"limits": ("a", "2%")}, "limit is 'a'. Pass"),
        ({"colour_map": "nothing"}, "no colour map"),
        ({"overlay": np.full(640, np.nan)}, "no value"),
        ({"opacity": 2.0}, "opacity"),
        ({"overlay": None, "opacity": 0.5}, "neither data nor parcels. Pass"),
        ({"underlay": "sulc"}, "underlay"),
        ({"width": 5.0}, "width"),
        ({"width": "a"}, "the width is 'a'. Pass a number"),
        ({"threshold": -1}, "threshold is -1. Pass"),
        ({"threshold": (1, 2, 3)}, "a pair"),
        ({"opacity": np.zeros(640)}, "0 everywhere"),
        ({"period": 360, "colour_map": "viridis"}, "'viridis' is not cyclic"),
        ({"period": 360, "colour_map": "none"}, "no colour map"),
        ({"period": 360, "limits": (0, 90)}, "limits do not apply to phases"),
        ({"period": -1}, "period is -1"),
        ({"period": 360, "zero": "left"}, "zero is 'left'"),
        ({"strength": np.ones(COUNT)}, "strength is given without threshold"),
        ({"strength": np.full(COUNT, np.nan), "threshold": (0, None)}, "the strength has no values on the map"),
        ({"strength": np.ones((COUNT, 2)), "threshold": (0, None)}, "Choose one"),
    ],
)
def test_what_is_wrong_is_named(flat_map, wrong, said):
    refused(said, composed.flat_map, flat_map, **{"overlay": np.arange(float(COUNT)), **wrong})


def test_colours_and_labels_are_shown_as_they_are(flat_map):
    colours = np.tile(np.array([[10, 200, 30]], dtype=np.uint8), (COUNT, 1))
    (shown,) = layer(figures.flat_map(flat_map, colours), "data")
    assert (shown[..., 3] > 0).sum() > 1000
    refused("contains colours, not values", figures.flat_map, flat_map, figures.Overlay(colours, threshold=3))
    figure = figures.flat_map(flat_map, np.repeat([3, 9], COUNT // 2))
    assert len(figure.axes) == 2  # no colour bar
    (shown,) = layer(figure, "data")
    assert len(np.unique(shown[shown[..., 3] > 0], axis=0)) == 2


def test_thresholds_that_nothing_passes_are_told(flat_map, caplog):
    figures.flat_map(flat_map, figures.Overlay(np.linspace(0, 1, COUNT), threshold=(7, None)))
    assert "No value of the overlay passes" in caplog.text


def test_a_threshold_is_symmetric_and_a_second_map_is_the_opacity(flat_map):
    values, sure = np.linspace(-5, 5, COUNT), np.repeat(np.linspace(0, 4, LONG), HIGH)
    shown, size = shown_data(figures.flat_map(flat_map, figures.Overlay(values, threshold=2.3)))
    with np.errstate(invalid="ignore"):
        assert_array_equal(shown[..., 3] > 0, np.abs(flat_map.image(values, size).data) > 2.3)
    figure = figures.flat_map(flat_map, values, opacity=figures.Overlay(sure, limits=(0, 2)))
    (shown,) = layer(figure, "data")
    expected = 255 * np.clip(np.nan_to_num(flat_map.image(sure, size).data) / 2, 0, 1)
    assert_allclose(shown[..., 3], np.round(expected), atol=1)
    assert "opacity: overlay from 0 to 2" in figure.axes[2].get_title(loc="right")


def test_both_hemispheres_share_one_scale_of_lengths_and_colours(flat_map):
    right = dataclasses.replace(in_structure(flat_map, "CortexRight"), uv=flat_map.uv * (-0.5, 0.5))
    low, high = np.linspace(0, 1, COUNT), np.linspace(2, 6, COUNT)
    figure = figures.flat_map([flat_map, right], figures.Overlay((low, high), label="effect"))
    paper, first, second, bar = figure.axes
    assert bar.get_xlim() == pytest.approx((0, 6), abs=0.3)
    spans = [np.diff(axes.get_xlim())[0] / axes.get_position().width for axes in (first, second)]
    assert spans[0] == pytest.approx(spans[1])
    letters = {text.get_text(): text.get_position()[0] for text in paper.texts if text.get_text() in ("L", "R")}
    assert letters["L"] < 20 < 170 - 20 < letters["R"]
    means = [axes.images[1].get_array()[..., :3].mean() for axes in (first, second)]
    assert means[0] < means[1]  # viridis is dark for low and light for high values
    refused("got 3 maps. Pass one map, or two, such as both hemispheres", figures.flat_map, [flat_map] * 3)


def test_labels_of_two_maps_keep_their_colours():
    """The overlay is a volume of labels, whose kind is found from the pixels of both maps."""
    volume = voxflat.samples.ball() * np.where(np.arange(24) < 12, 3, 7)[:, None, None]
    sides = [voxflat.surface(volume > 0).disk((12, 12, k), 9).flatten() for k in (4, 19)]
    figure = figures.flat_map(sides, Volume(volume.astype(np.uint8), np.eye(4)))
    _, *drawn = figure.axes
    assert len(drawn) == 2  # no colour bar
    colours = [{tuple(colour) for colour in one.images[1].get_array().reshape(-1, 4) if colour[3] > 0} for one in drawn]
    assert colours[0] == colours[1]
    assert len(colours[0]) == 3  # 3, 7, and grey for 0


def test_a_figure_fills_the_axes_that_it_is_given(flat_map):
    figure = Figure(figsize=(8, 4), dpi=100)
    left, right = figure.subplots(1, 2)
    assert figures.flat_map(flat_map, np.linspace(0, 1, COUNT), ax=right) is figure
    FigureCanvasAgg(figure).draw()
    inner = right.child_axes
    assert [len(axes.images) for axes in inner] == [0, 2, 1]  # paper, map, colour bar
    box = right.get_window_extent()
    for axes in inner:
        own = axes.get_window_extent()
        assert box.x0 - 1 <= own.x0 < own.x1 <= box.x1 + 1
        assert box.y0 - 1 <= own.y0 < own.y1 <= box.y1 + 1
    assert not left.child_axes


@pytest.mark.parametrize("zero", ["right", "top"])
def test_phases_have_a_wheel_and_are_shown_where_they_are_strong(flat_map, zero):
    phase = np.repeat(np.linspace(-180, 170, LONG), HIGH)
    strength = np.tile(np.linspace(0, 1, HIGH), LONG)
    how = {"period": 360, "zero": zero, "strength": strength, "threshold": (0.5, None), "interpolation": "nearest"}
    figure = composed.flat_map(flat_map, phase, **how)
    shown, size = shown_data(figure)
    strong = flat_map.image(strength, size).data
    with np.errstate(invalid="ignore"):
        assert_array_equal(shown[..., 3] > 0, strong > 0.5)
    turns = flat_map.image(phase % 360, size, interpolation="nearest").data / 360
    seen = shown[..., 3] > 0
    assert_array_equal(shown[seen][:, :3], colormaps["hsv"](turns[seen], bytes=True)[:, :3])
    wheel = figure.axes[2].images[0].get_array()
    side = len(wheel)
    for turn in (0.1, 0.35, 0.6, 0.85):
        angle = 2 * np.pi * (turn if zero == "right" else 0.25 - turn)
        row, column = (round(side / 2 * (1 + 0.8 * of)) for of in (-np.sin(angle), np.cos(angle)))
        expected = np.array(colormaps["hsv"](turn, bytes=True), dtype=int)
        assert np.abs(wheel[row, column] - expected).max() <= 12
    assert wheel[side // 2, side // 2, 3] == wheel[0, 0, 3] == 0
    assert [text.get_text() for text in texts(figure, "data")] == ["0", "90", "180", "270", "overlay, overlay > 0.5"]
    places = [text.get_position() for text in texts(figure, "data")][:4]
    assert np.argmax([x for x, _ in places]) == (0 if zero == "right" else 1)
    assert np.argmax([y for _, y in places]) == (1 if zero == "right" else 0)


def test_radians_are_named_so_and_the_wheel_is_data(cut_map, tmp_path):
    phases = figures.Overlay(np.linspace(0, 6, COUNT), period=2 * np.pi, colour_map="twilight")
    figure = figures.flat_map(cut_map, phases)
    numbers = [text.get_text() for text in texts(figure, "data")][:4]
    assert numbers == ["0", "π/2", "π", "3π/2"]
    figures.save(figure, tmp_path / "a.svg")
    ids = re.findall(r'\bid="([^"]+)"', (tmp_path / "a.svg").read_text())
    assert len(ids) == len(set(ids))
    (data,) = (child for child in ElementTree.parse(tmp_path / "a.svg").getroot() if child.get("id") == "layer-data")
    assert [text.text for text in data.iter("{http://www.w3.org/2000/svg}text")][:4] == numbers
    assert len(list(data.iter("{http://www.w3.org/2000/svg}image"))) == 2


def test_names_lie_in_their_regions_and_boxes_are_disjoint():
    labels = np.full((300, 400), -1)
    labels[:, :200], labels[:150, 200:], labels[150:, 200:230], labels[150:, 230:] = 1, 2, 3, 4
    long = "a name that is much too long for this " * 3
    names = {1: "superior frontal", 2: "G_and_S_cingul-Mid-Ant", 3: "thin", 4: long}
    placed, left_out = place_names(labels, names, 0.1)
    assert left_out == [long]
    seen = np.zeros(labels.shape, bool)
    for name in placed:
        top, left = round(name.row - (name.height - 1) / 2), round(name.column - (name.width - 1) / 2)
        box = np.s_[top : top + name.height, left : left + name.width]
        assert (labels[box] == name.label).all()
        assert not seen[box].any()
        seen[box] = True
        ink = TextPath((0, 0), max(name.text.split("\n"), key=len), size=name.size).get_extents()
        along = (name.height if name.is_upright else name.width) * 0.1
        assert ink.width * 25.4 / 72 < along
    assert {name.label for name in placed if name.is_upright} == {3}
    assert text_size("a\nb", 6.0)[1] == pytest.approx(2 * text_size("a", 6.0)[1])


def test_parcels_have_the_colours_and_names_of_the_table(flat_map, caplog):
    caplog.set_level(logging.INFO, logger="voxflat")
    labels = np.repeat([1, 2, 0, 5], COUNT // 4)
    names = {0: "Unknown", 1: "one", 2: "namewithoutanyroominitsparcelhoweversmallitis", 5: "five"}
    table = LabelTable(names, {1: (10, 200, 30), 2: (0, 0, 250), 5: (7, 7, 7)})
    found = parcels_of(flat_map, labels, table=table)
    figure = figures.flat_map(flat_map, parcels=found, opacity=0.5)
    (shown,) = layer(figure, "parcels")
    colours = {tuple(colour) for colour in np.unique(shown[shown[..., 3] > 0], axis=0).tolist()}
    assert colours == {(10, 200, 30, 128), (0, 0, 250, 128), (7, 7, 7, 128)}
    assert {text.get_text() for text in texts(figure, "names")} == {"one", "five"}
    assert "1 of 3 names do not fit" in caplog.text
    over = figures.flat_map(flat_map, np.arange(COUNT, dtype=float), parcels=found)
    assert layer(over, "parcels") == []  # the data are coloured instead
    assert [lines.get_gid() for lines in over.axes[1].collections] == ["parcels", "marks"]


def test_directions_are_those_of_the_points(flat_map):
    found = {one.letter: np.array([one.u, one.v]) for one in directions(flat_map)}
    assert set(found) == {"A", "S"}
    centre = flat_map.points.mean(axis=0)
    for letter, axis in (("A", 1), ("S", 2)):
        ahead = flat_map.points[:, axis] > centre[axis] + 4
        behind = flat_map.points[:, axis] < centre[axis] - 4
        towards = flat_map.uv[ahead].mean(axis=0) - flat_map.uv[behind].mean(axis=0)
        assert found[letter] @ towards / np.linalg.norm(towards) > 0.999
    assert found["A"][0] < -0.99  # anterior is on the left in a view from the left
    assert {"A", "S", "L"} <= {text.get_text() for text in texts(figures.flat_map(flat_map), "marks")}


def test_directions_of_a_stack_are_its_axes(tmp_path):
    """A microscope does not know right, anterior and superior."""
    i, j, k = np.indices((20, 20, 20)) - 9.5
    path, spacing = tmp_path / "ball.tif", {"spacing": 2, "unit": "um"}
    about = {"imagej": True, "resolution": (0.5, 0.5), "metadata": {"axes": "ZYX", **spacing}}
    tifffile.imwrite(path, (i**2 + j**2 + k**2 < 64).astype(np.uint8), **about)
    cap = voxflat.surface(path).disk((9, 9, 17), 10.0)  # at the end of z
    found = {one.letter: np.array([one.u, one.v]) for one in directions(cap.flatten())}
    assert found.keys() == {"x", "y"}
    told = voxflat.check(path).table()
    assert "RAS" not in told
    assert "orientation" not in told
    assert "RAS" not in succeed("check", path, "--smooth", 8).stdout


def test_an_unknown_space_has_no_directions_and_no_side(flat_map, caplog):
    caplog.set_level(logging.INFO, logger="voxflat")
    bare = in_structure(flat_map, None)
    assert (directions(bare), side(bare)) == ([], None)
    marks = {text.get_text() for text in texts(figures.flat_map(bare), "marks")}
    assert len(marks) == 1  # the scale bar
    assert "space of the surface is unknown" in caplog.text
    assert side(dataclasses.replace(bare, details={**bare.details, "sphere": {"side": "right"}})) == "R"


def test_the_scale_bar_is_as_long_as_it_says(flat_map):
    figure = figures.flat_map(flat_map)
    paper, axes = figure.axes[:2]
    (bar,) = paper.lines
    (text,) = (text for text in texts(figure) if text.get_text().endswith(" mm"))
    pixels = np.ptp(paper.transData.transform(np.column_stack(bar.get_data()))[:, 0])
    one_mm = np.diff(axes.transData.transform([(0, 0), (1, 0)])[:, 0])[0]
    assert pixels / one_mm == pytest.approx(float(text.get_text()[:-3]))
    across = np.diff(axes.transData.transform([(0, 0), (0, 1)])[:, 1])[0]
    assert across == pytest.approx(one_mm)  # the scale is the same in both directions
    assert [round_length(room) for room in (0.7, 1, 4.9, 5, 99)] == [0.5, 1, 2, 5, 50]


def test_cuts_have_their_names_between_their_lips(cut_map):
    cut = dataclasses.replace(cut_map, cuts=(cut_map.cuts[0], dataclasses.replace(cut_map.cuts[1], name=None)))
    ((name, places),) = cut_names(cut)
    assert name == "calcarine"
    assert_allclose(places[0], cut.uv[[5, 20]].mean(axis=0))
    assert "calcarine" in {text.get_text() for text in texts(figures.flat_map(cut), "marks")}


def test_pictures_are_wide_and_their_fonts_readable(flat_map, tmp_path, monkeypatch):
    monkeypatch.undo()  # full resolution
    figure = figures.flat_map(flat_map, np.arange(COUNT, dtype=float), title="sheet")
    figures.save(figure, tmp_path / "a.png")
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.width >= 1600
    assert figure.get_size_inches()[0] * 25.4 == pytest.approx(85)
    sizes = [text.get_fontsize() for text in texts(figure)]
    sizes += [text.get_fontsize() for text in (figure.axes[2].title, *figure.axes[2].get_xticklabels())]
    assert min(sizes) >= 6


def test_an_svg_has_layers_and_its_text_is_text(flat_map, tmp_path):
    found = parcels_of(flat_map, np.repeat([1, 2], COUNT // 2), table=LabelTable({1: "front", 2: "back"}))
    figure = figures.flat_map(flat_map, np.arange(COUNT, dtype=float), parcels=found)
    figures.save(figure, tmp_path / "a.svg", {"voxflat": "x"})
    figures.save(figure, tmp_path / "b.svg", {"voxflat": "x"})
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()
    root = ElementTree.parse(tmp_path / "a.svg").getroot()
    ink = "{http://www.inkscape.org/namespaces/inkscape}"
    layers = {child.get(f"{ink}label"): child for child in root if child.get(f"{ink}groupmode") == "layer"}
    assert list(layers) == ["background", "curvature", "data", "parcels", "names", "marks"]
    tag = "{http://www.w3.org/2000/svg}"
    assert [text.text for text in layers["names"].iter(f"{tag}text")] == ["front", "back"]
    assert len(list(layers["curvature"].iter(f"{tag}image"))) == 1
    assert list(layers["parcels"].iter(f"{tag}path"))
    ids = re.findall(r'\bid="([^"]+)"', (tmp_path / "a.svg").read_text())
    assert len(ids) == len(set(ids))
    assert set(re.findall(r"url\(#([^)]+)\)", (tmp_path / "a.svg").read_text())) <= set(ids)
    figures.save(figures.scatter(flat_map), tmp_path / "c.svg")
    assert "inkscape" not in (tmp_path / "c.svg").read_text()


class TestCommand:
    def test_the_map_alone_is_its_folds(self, saved, tmp_path, monkeypatch):
        monkeypatch.undo()  # full resolution
        assert "1700 x" in succeed("figure", saved, "-o", tmp_path / "a.png").output
        with Image.open(tmp_path / "a.png") as picture:
            assert '"function": "flat_map"' in picture.text["Provenance"]
        assert run("figure", saved, "-o", tmp_path / "a.tif").exit_code != 0

    def test_data_and_parcels(self, saved, tmp_path):
        np.save(tmp_path / "stat.npy", np.linspace(-3, 3, COUNT))
        np.save(tmp_path / "areas.npy", np.repeat([1, 2], COUNT // 2))
        (tmp_path / "areas.tsv").write_text("index\tname\n1\tfront\n2\tback\n")
        look = ["--above", 1, "--below", -1, "--range", "2%,98%", "--cmap", "seismic", "--opacity", 0.8, "--unit", "z"]
        parcels = ["--parcels", tmp_path / "areas.npy", "--table", tmp_path / "areas.tsv"]
        succeed("figure", saved, "--overlay", tmp_path / "stat.npy", *look, *parcels, "-o", tmp_path / "a.svg")
        text = (tmp_path / "a.svg").read_text()
        assert all(word in text for word in ("stat.npy (z)", ">front<", 'label="data"'))

    def test_wrong_usage(self, saved, tmp_path):
        for options, said in (
            (["--above", "2"], "--above: only with --overlay"),
            (["--table", saved], "--table requires --parcels"),
            (["--overlay", saved, "--range", "1"], "is not a pair"),
            (["--opacity", "3"], "opacity"),
        ):
            fail(2, said, "figure", saved, *options, "-o", tmp_path / "a.png")


def test_what_is_drawn_into_a_figure_finds_its_place(flat_map, tmp_path):
    """A closed path that Inkscape draws in a new layer becomes a region at the same position."""
    figures.save(figures.flat_map(flat_map, title="sheet"), tmp_path / "folds.svg")
    text = (tmp_path / "folds.svg").read_text()
    root = ElementTree.fromstring(text)
    left, right, bottom, top = (float(value) for value in root.get("data-voxflat-extent").split())
    x, y, width, height = (float(value) for value in root.get("data-voxflat-axes").split())
    assert (left, bottom) == pytest.approx(flat_map.uv.min(axis=0), abs=1e-6)
    assert (right, top) == pytest.approx(flat_map.uv.max(axis=0), abs=1e-6)
    assert width / (right - left) == pytest.approx(height / (top - bottom), rel=1e-3)
    corners = flat_map.uv[[0, LONG * HIGH - HIGH, LONG * HIGH - 1]]
    drawn = (corners - [left, top]) * [width / (right - left), -height / (top - bottom)] + [x, y]
    path = " L ".join(f"{u:.6f},{v:.6f}" for u, v in drawn)
    triangle = f'<path inkscape:label="corner" d="M {path} Z" style="fill:#ff0000"/>'
    layer = f'<g inkscape:groupmode="layer" inkscape:label="rois" id="layer9">{triangle}</g>'
    (tmp_path / "drawn.svg").write_text(text.replace("</svg>", f"{layer}</svg>"))
    drawn, given = flat_map.regions(tmp_path / "drawn.svg"), flat_map.regions({"corner": corners})
    assert drawn.names == ("corner",)
    low, high = flat_map.uv.min(axis=0), flat_map.uv.max(axis=0)
    places = np.random.default_rng(0).uniform(low, high, (4000, 2))
    differing = drawn.at(places) != given.at(places)
    assert 500 < (given.at(places) > 0).sum() < 3000
    assert differing.mean() < 0.002  # only pixels at the border differ


def test_depth_is_of_volumes_alone(flat_map):
    """The depth does not apply to values at vertices, but to parcels from a volume."""
    values = np.arange(COUNT, dtype=float)
    for depth in ({"depth": 2.0}, {"fraction": 0.5}):
        refused("apply only to volumes", composed.flat_map, flat_map, values, **depth)
    beside = np.full((4, 4, 4), 7, np.uint8)  # starts 10 mm outside the sheet
    affine = np.diag([25.0, 25, 25, 1])
    affine[:3, 3] = (-140 + 12.5, -12.5, -12.5)
    of = {"overlay": values, "parcels": Volume(beside, affine)}
    refused("does not overlap the map", composed.flat_map, flat_map, **of)
    assert "7" in {text.get_text() for text in texts(composed.flat_map(flat_map, **of, depth=20))}


@pytest.mark.parametrize("width", [60, 85])
def test_the_bars_label_stays_on_the_paper(flat_map, width):
    values = np.arange(COUNT, dtype=float)
    for label in ("z", "grey matter, 2 mm outside white matter", "W" * 200, FROM_CIFTI):
        figure = figures.flat_map(flat_map, figures.Overlay(values, label=label), width=width)
        axes = figure.axes[2]
        (title,) = (text for text in (axes.title, axes._right_title) if text.get_text())
        figure.draw_without_rendering()
        box = title.get_window_extent()
        assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1
        assert title.get_text() == label or "…" in title.get_text()
        assert box.y0 > axes.get_window_extent().y1  # descenders do not touch the frame
        assert not label.endswith("MATH-STORY") or title.get_text().endswith("MATH-STORY")  # the map in the file
        for mark in texts(figure, "marks"):
            assert not box.overlaps(mark.get_window_extent())


@pytest.mark.parametrize(("low", "high"), [(-2.51, 4.13), (0.0212, 0.087), (1003.5, 1009), (-3e-7, 8e-7), (2, 2e7)])
def test_a_bar_labels_its_ends_and_marks_its_thresholds(flat_map, low, high):
    above = low + 0.6 * (high - low)
    over = figures.Overlay(np.linspace(low, high, COUNT), limits=(low, high), threshold=(above, None))
    figure = figures.flat_map(flat_map, over)
    figure.draw_without_rendering()
    bar = figure.axes[2]
    labels = {at: text for at, text in zip(bar.get_xticks(), bar.get_xticklabels(), strict=True)}
    for end in (low, high, above):
        told = float(labels[end].get_text().replace("\N{MINUS SIGN}", "-"))
        assert told == pytest.approx(end, abs=0.01 * (high - low))
    (line,) = bar.lines
    assert_allclose(line.get_xdata(), above)
    boxes = [text.get_window_extent() for text in labels.values()]
    assert not any(one.overlaps(other) for n, one in enumerate(boxes) for other in boxes[:n])


def test_a_threshold_of_another_map_is_not_marked(flat_map):
    values = np.linspace(0, 1, COUNT)
    over = figures.Overlay(values, strength=values, threshold=0.5)
    assert not figures.flat_map(flat_map, over).axes[2].lines


def test_names_of_cuts_stay_on_the_page_and_beside_the_names_of_parcels(flat_map, tmp_path):
    ids, uv = flat_map.ids, flat_map.uv
    edges = [int(np.argmin(uv[:, 0])), int(np.argmax(uv[:, 0])), int(np.argmax(uv[:, 1]))]
    table = tmp_path / "names.tsv"
    table.write_text("index\tname\n1\tprecuneus\n")
    parcels = np.ones(COUNT, dtype=int)

    def boxes(cuts):
        cut = dataclasses.replace(flat_map, cuts=[Cut(np.array(ids), None, "template", "calcarine") for ids in cuts])
        figure = figures.flat_map(cut, parcels=parcels, table=table)
        figure.draw_without_rendering()
        found = {name: [] for name in ("calcarine", "precuneus")}
        for text in texts(figure):
            if text.get_text() in found:
                found[text.get_text()].append((text.get_bbox_patch() or text).get_window_extent())
        return figure, found["calcarine"], found["precuneus"][0]

    figure, drawn, parcel = boxes([[int(ids[n])] for n in [*edges, *edges[:1]]])
    for n, box in enumerate(drawn):
        assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1
        assert figure.bbox.y0 <= box.y0 < box.y1 <= figure.bbox.y1
        assert not any(box.overlaps(other) for other in drawn[:n])
    at = figure.axes[1].transData.inverted().transform([(parcel.x0 + parcel.x1) / 2, (parcel.y0 + parcel.y1) / 2])
    near = int(np.argmin(np.linalg.norm(uv - at, axis=1)))
    _, (over,), parcel = boxes([[int(ids[near])]])
    assert not over.overlaps(parcel)


@pytest.mark.parametrize("name", ["back", "posterior"])
def test_the_name_of_a_chart_is_beside_the_arrows_and_on_the_page(flat_map, name):
    charts = [{"count": 2, "name": one} for one in ("front", name)]
    origin = VoxelOrigin(affine=np.eye(4), shape=(9, 9, 9), space=Space("scanner"))
    both = [
        dataclasses.replace(flat_map, uv=flat_map.uv + n, origin=origin, details={**flat_map.details, "chart": one})
        for n, one in enumerate(charts)
    ]
    drawn = figures.flat_map(both)
    canvas = FigureCanvasAgg(drawn)
    boxes = [text.get_window_extent(canvas.get_renderer()) for text in texts(drawn, "marks")]
    assert {"front", name} <= {text.get_text() for text in texts(drawn, "marks")}
    for number, box in enumerate(boxes):
        assert box.x0 >= 0
        assert box.x1 <= drawn.bbox.width
        assert not any(box.overlaps(other) for other in boxes[number + 1 :])
