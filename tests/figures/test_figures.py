import dataclasses
import re
import subprocess
import sys
from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.testing import assert_array_equal
from PIL import Image
from refusals import refused
from textures import grid

import voxflat
from voxflat import InputError, figures
from voxflat.figures import worst
from voxflat.figures.colours import LOOKS, top
from voxflat.figures.marks import directions, round_length
from voxflat.figures.views_3d import load_pyvista
from voxflat.maps.colours import are_labels, levels
from voxflat.methods import Voxflat

SHAPE = (22, 26, 12)


def solid():
    """Return a solid with a wavy front towards −x; the front is flattened."""
    i, j, _ = np.indices(SHAPE)
    return (i >= np.rint(6 + 2 * np.sin(j / 5))).astype(np.uint8)


@pytest.fixture(scope="module")
def flat_map():
    front = np.zeros(SHAPE, dtype=np.uint8)
    front[:12, 3:23] = 1
    front &= np.roll(solid(), 1, axis=0) == 0
    return voxflat.surface(solid(), spacing=(1.0, 1.0, 2.0)).keep(front).flatten(Voxflat(sources=80))


def with_errors(flat_map, per_point):
    distortion = dataclasses.replace(flat_map.distortion, per_point=np.asarray(per_point, dtype=np.float64))
    return dataclasses.replace(flat_map, distortion=distortion)


def test_scatter_has_all_pairs_between_equal_axes_and_the_paper_s_figures(flat_map):
    pairs = flat_map.distortion.scatter
    (axes, *_) = figures.scatter(flat_map).axes
    (hexagons,) = axes.collections
    assert hexagons.get_array().sum() == len(pairs)
    low, high = axes.get_xlim()
    assert (low, high) == axes.get_ylim()
    assert low == 0 < pairs.max() < high
    assert axes.get_aspect() == 1
    centres = hexagons.get_offsets()
    step = axes.get_xlim()[1] / 90
    near = np.abs(pairs[:50, None, :] - centres[None]).max(axis=2).min(axis=1)
    assert near.max() <= step  # x is geodesic, and y is flat
    assert "geodesic" in axes.get_xlabel()
    assert "flat" in axes.get_ylabel()
    (diagonal,) = axes.lines
    assert_array_equal(*diagonal.get_data())
    assert tuple(diagonal.get_xdata()) == axes.get_xlim()
    distortion, title = flat_map.distortion, axes.get_title()
    shown = float(re.search(r"= ([\d.]+) mm", title)[1])
    assert abs(shown / distortion.raw.absolute_error - 1) < 0.05
    assert f"{100 * distortion.raw.relative_error:.1f} %" in title
    assert f"{distortion.mean_geodesic:.1f} mm" in title


@pytest.mark.parametrize("pixel_size", [None, 0.7])
def test_heat_map_shows_the_heat_map_s_pixels_in_percent_up_to_the_99th_percentile(flat_map, pixel_size):
    expected, figure = flat_map.heat_map(pixel_size), figures.heat_map(flat_map, pixel_size)
    (shown,), bar = figure.axes[0].images, figure.axes[1]
    assert_array_equal(np.ma.filled(shown.get_array(), np.nan), 100 * expected.data)
    assert (tuple(shown.get_extent()), shown.origin) == (expected.extent, "upper")
    top = 100 * np.percentile(flat_map.distortion.per_point, 99)
    assert shown.get_clim() == pytest.approx((0, top)) == bar.get_ylim()
    assert "%" in bar.get_ylabel()
    no_error = figures.heat_map(with_errors(flat_map, np.zeros(len(flat_map))), pixel_size)
    assert no_error.axes[0].images[0].get_clim() == (0, 1)


def test_heat_map_is_drawn_where_the_map_lies(flat_map):
    upper = flat_map.uv[:, 1] > flat_map.uv[:, 1].mean()
    figure = figures.heat_map(with_errors(flat_map, np.where(upper, 0.2, 0.0)))
    axes = figure.axes[0]
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[::-1]

    def at(u, v):
        column, row = axes.transData.transform((u, v))
        return pixels[int(row), int(column), :3].tolist()

    u, v = flat_map.uv.mean(axis=0)
    inferno = mpl.colormaps["inferno"]
    assert at(u, v + 4) == pytest.approx([255 * c for c in inferno(1.0)[:3]], abs=1)
    assert at(u, v - 4) == pytest.approx([255 * c for c in inferno(0.0)[:3]], abs=1)
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    assert left < flat_map.uv[:, 0].min() < flat_map.uv[:, 0].max() < right
    assert bottom < flat_map.uv[:, 1].min() < flat_map.uv[:, 1].max() < top
    assert at(left + 0.2, top - 0.2) == [255, 255, 255]
    assert axes.get_aspect() == 1
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("u (mm)", "v (mm)")


def test_spectrum_marks_the_two_largest_positive_eigenvalues(flat_map):
    values = np.array([50.0, -40.0, 30.0, 5.0, -1.0])
    axes = figures.spectrum(dataclasses.replace(flat_map, eigenvalues=values)).axes[0]
    assert [bar.get_height() for bar in axes.patches] == np.abs(values).tolist()
    colours = [bar.get_facecolor() for bar in axes.patches]
    used, negative, positive = colours[0], colours[1], colours[3]
    assert colours == [used, negative, used, positive, negative]
    legend = axes.get_legend()
    patches = zip(legend.get_texts(), legend.legend_handles, strict=True)
    names = {text.get_text(): patch.get_facecolor() for text, patch in patches}
    assert names == {"used for the map": used, "other, negative": negative, "other, positive": positive}
    assert len(set(names.values())) == 3
    assert f"{100 * flat_map.metadata['planarity']:.1f} %" in axes.get_title()


@pytest.fixture
def scene():
    """Return the part of an image to the left of its colour bar."""
    try:
        load_pyvista()
    except InputError as error:
        pytest.skip(str(error))
    return lambda picture: picture[:, : int(0.83 * picture.shape[1])].astype(int)


@pytest.mark.medium
@pytest.mark.parametrize("in_place", [False, True])
def test_patch_3d_shows_the_patch_from_outside(flat_map, scene, in_place):
    # the errors are at +y, which is on the left when the front is seen along +x with z up
    far = flat_map.points[:, 1] > flat_map.points[:, 1].mean()
    uneven = with_errors(flat_map, np.where(far, 0.1, 0.0))
    picture = figures.patch_3d(uneven, solid() if in_place else None, size=(300, 200))
    assert (picture.shape, picture.dtype) == ((200, 300, 3), np.uint8)
    bright, dark = bright_and_dark(scene(picture))
    middle = bright.shape[1] / 2
    assert min(bright.sum(), dark.sum()) > 2000
    assert np.nonzero(bright)[1].mean() < 0.8 * middle
    assert np.nonzero(dark)[1].mean() > 1.2 * middle


@pytest.mark.medium
def test_patch_3d_shows_the_surroundings_in_grey(flat_map, scene):
    assert greys(scene(figures.patch_3d(flat_map, solid(), size=(300, 200)))) > 1000
    assert greys(scene(figures.patch_3d(flat_map, size=(300, 200)))) < 100


def bright_and_dark(pixels):
    """Return the pixels with the colours of large errors, and of small errors."""
    red, green, blue = np.moveaxis(pixels, 2, 0)
    return (red > 150) & (blue < red - 40), red + green + blue < 150


def greys(pixels):
    return int(((np.ptp(pixels, axis=2) < 12) & (pixels.min(axis=2) > 60) & (pixels.max(axis=2) < 245)).sum())


@pytest.fixture(scope="module")
def mesh_map():
    """Return a dome and a map of its top; the errors are 0 except on one side."""
    points, faces = grid(30, 30)
    points[:, 2] = 8 * np.sin(points[:, :2] * np.pi / 29).prod(axis=1)
    flat_map = voxflat.surface((points, faces)).disk(465, 9.0).flatten(Voxflat(sources=40))
    return (points, faces), with_errors(flat_map, np.where(flat_map.points[:, 0] > 15, 0.1, 0.0))


@pytest.mark.medium
def test_patch_3d_shows_the_triangles_of_a_mesh_in_the_colours_of_their_errors(mesh_map, scene):
    dome, flat_map = mesh_map
    alone, in_place = (scene(figures.patch_3d(flat_map, of, size=(300, 200))) for of in (None, dome))
    bright, dark = bright_and_dark(alone)  # seen from above: the errors at +x are on the right
    assert min(bright.sum(), dark.sum()) > 2000
    assert np.nonzero(dark)[1].mean() < np.nonzero(bright)[1].mean() - 20
    assert greys(in_place) > greys(alone) + 1000
    drawn = bright | dark
    assert (np.abs(in_place - alone).max(axis=2)[drawn] < 60).mean() > 0.95  # the patch is unchanged


def test_patch_3d_refuses_another_surface(mesh_map, flat_map, scene):
    (points, faces), of_mesh = mesh_map
    fewer = (points[:870], faces[(faces < 870).all(axis=1)])
    refused("has 870 vertices, but the map was made from a mesh with 900", figures.patch_3d, of_mesh, fewer)
    refused("up to 2 mm away from the points", figures.patch_3d, of_mesh, (points + np.array([0, 0, 2]), faces))
    refused("shape", figures.patch_3d, flat_map, solid()[:-1])
    other = solid()[:, :, ::-1].copy() * (np.indices(SHAPE)[1] > 12)
    refused("not in the foreground of this volume", figures.patch_3d, flat_map, other)


def test_patch_3d_without_pyvista_names_the_remedy(flat_map, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyvista", None)
    refused(r"pip install 'voxflat\[pyvista\]'", figures.patch_3d, flat_map)


@pytest.mark.slow
@pytest.mark.parametrize("ending", [".png", ".pdf", ".svg"])
def test_save_writes_what_the_ending_says(tmp_path, ending, flat_map):
    path = tmp_path / f"figure{ending}"
    figures.save(figures.spectrum(flat_map), path)
    assert path.read_bytes()[:4] in (b"\x89PNG", b"%PDF", b"<?xm")
    assert list(tmp_path.iterdir()) == [path]


def test_save_refuses_other_endings(tmp_path):
    for name in ("figure", "figure.xyz"):
        refused(r"\.png, \.pdf or \.svg", figures.save, Figure(), tmp_path / name)
        refused(r"\.png or \.tif", figures.save_picture, np.zeros((2, 2, 3), dtype=np.uint8), tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_save_keeps_the_old_file_if_it_fails(tmp_path, monkeypatch):
    path = tmp_path / "figure.png"
    path.write_text("old")
    monkeypatch.setattr(Figure, "savefig", lambda *args, **kwargs: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        figures.save(Figure(), path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_save_picture_keeps_every_pixel(tmp_path):
    picture = np.random.default_rng(0).integers(0, 255, (7, 9, 3), dtype=np.uint8)
    figures.save_picture(picture, tmp_path / "picture.png")
    assert_array_equal(np.asarray(Image.open(tmp_path / "picture.png")), picture)


@pytest.mark.slow
def test_figures_need_neither_pyplot_nor_pyvista():
    code = "import sys, voxflat.figures; print(*({'matplotlib.pyplot', 'pyvista', 'vtkmodules'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split() == []


def test_colours_end_at_the_99th_percentile_and_those_of_areas_are_symmetric():
    values = np.append(np.arange(101.0), np.nan)
    assert top(values) == 99
    assert LOOKS["areal"].limits(-values) == (-99, 99)
    assert levels(values, None)[1] == (1, 99)


@pytest.mark.parametrize(("room", "length"), [(2.9, 2), (4.9, 2), (5.0, 5), (9.9, 5), (10, 10), (0.3, 0.2)])
def test_scale_bars_are_1_2_or_5_times_a_power_of_ten(room, length):
    assert round_length(room) == pytest.approx(length)


@pytest.mark.parametrize("beyond", [1.5, 2.0])
def test_the_colours_of_the_worst_places_end_at_twice_their_factor(beyond):
    norm = worst._norm(SimpleNamespace(beyond=beyond))
    assert (2**norm.vmin, 2**norm.vmax) == pytest.approx((0.5 / beyond, 2 * beyond))


@pytest.mark.parametrize(("explained", "letters"), [(0.9, "AR"), (0.4, "AR"), (0.2, "R")])
def test_directions_are_those_of_which_the_plane_explains_enough(explained, letters):
    side = 25
    points, faces = grid(side, side)
    uv = points[:, :2] - points[:, :2].mean(axis=0)
    up = np.indices((side, side)).sum(axis=0).ravel() % 2 * 2.0 - 1  # explained by no plane
    near = np.linalg.norm(uv, axis=1) <= 0.35 * np.sqrt(np.prod(np.ptp(uv, axis=0)) / np.pi)
    up *= np.sqrt(1 / explained - 1) * uv[near, 1].std() / up[near].std()
    space = SimpleNamespace(name="scanner", to_scanner=lambda points: points)
    places = np.column_stack([uv[:, 0], uv[:, 1] + up, np.zeros(len(uv))])
    shape = {"uv": uv, "faces": faces, "torn": np.zeros(len(faces), bool)}
    found = directions(SimpleNamespace(space=space, points=places, has_surface=True, **shape))
    assert "".join(sorted(one.letter for one in found)) == letters
    assert [(one.u, one.v) for one in found if one.letter == "R"] == [pytest.approx((1, 0), abs=1e-9)]
    for one in found:
        assert one.share == pytest.approx(1.0 if one.letter == "R" else explained, abs=0.05)


@pytest.mark.parametrize(("rows", "labels"), [(24, False), (40, True)])
def test_images_are_labels_if_most_pixels_equal_those_beside_them(rows, labels):
    data = np.arange(3600.0).reshape(60, 60)
    data[:rows] = 7  # 38 or 65 % of the pairs
    assert are_labels(data) == labels
