"""Operations of ``mesh.voxflat`` other than flattening: cut, measure, texture, plot and morph; and seed points."""

import importlib.util
import json
import logging

import numpy as np
import pytest
import pyvista as pv
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image
from refusals import refused

import voxflat
from voxflat.methods import Voxflat

ALGORITHM = {"algorithm": "dataset_surface"} if pv.version_info >= (0, 47) else {}


def saddle(count=16):
    """Return a structured grid of quads, 20 by 20, which is not a plane."""
    x, y = np.meshgrid(np.linspace(-10, 10, count), np.linspace(-10, 10, count), indexing="ij")
    return pv.StructuredGrid(x, y, 0.08 * (x * x - y * y))


@pytest.fixture(scope="module")
def ball():
    return pv.Icosphere(radius=20.0, nsub=2)


@pytest.fixture(scope="module")
def flat_ball(ball):
    """Return the map of the ball, which has a cut."""
    return ball.voxflat(method=Voxflat(sources=30), relax=False)


@pytest.fixture(scope="module")
def flat():
    grid = saddle()
    grid.point_data["number"] = np.arange(grid.n_points)
    return grid.voxflat(method=Voxflat(sources=30), relax=False)


def test_every_measure_is_an_array(flat):
    assert {"distance_error", "areal", "angle"} <= set(flat.point_data)
    assert {"isometric", "quasi_conformal", "flipped"} <= set(flat.cell_data)
    areas = flat.compute_cell_sizes()["Area"]
    in_space = flat.copy()
    in_space.points = flat["surface_points"]
    growth = areas / in_space.compute_cell_sizes()["Area"]
    assert (growth <= flat["isometric"] ** 2 * (1 + 1e-5)).all()
    assert (1 / growth <= flat["isometric"] ** 2 * (1 + 1e-5)).all()
    assert not flat["flipped"].any()
    assert flat["flipped"].dtype == bool


@pytest.mark.medium
def test_a_place_is_a_point_a_position_or_a_cell():
    grid = saddle()
    number = 40
    expected = grid.voxflat.geodesic(number)["geodesic_distance"]
    near = np.add(grid.points[number], [0.2, -0.1, 0.3])
    cell = grid.get_cell(12)
    for place in (near, near.tolist(), [near], [number]):
        assert_array_equal(grid.voxflat.geodesic(place)["geodesic_distance"], expected)
    of_cell = grid.voxflat.geodesic(cell)["geodesic_distance"]
    assert of_cell.argmin() in cell.point_ids
    assert_array_equal(grid.voxflat.geodesic([cell, near])["geodesic_distance"], np.minimum(expected, of_cell))
    line = grid.voxflat.path(near, cell, 255)
    assert line["vertex_ids"][0] == number
    assert line["vertex_ids"][-1] == 255
    disks = [grid.voxflat(method=Voxflat(sources=10), seed_point=seed, radius=6.0) for seed in (number, near)]
    assert_array_equal(disks[0]["vertex_ids"], disks[1]["vertex_ids"])


def test_the_corner_of_a_cell_is_the_nearest_to_its_middle():
    triangle = pv.PolyData(np.array([[9, 0, 0], [0, 1, 0], [0, 0, 0], [9, -9, 0.0]]), [3, 0, 1, 2, 3, 0, 2, 3])
    assert triangle.voxflat.geodesic(triangle.get_cell(0))["geodesic_distance"].argmin() == 2


def test_places_that_are_none_are_refused(caplog):
    grid = saddle()
    for bad, message in (
        ([0.0, np.nan, 1.0], "finite positions"),
        ([0.0, 1.0], r"shape \(2,\)"),
        ("a", "Pass point numbers, positions"),
        (99999, "point 99999 is not on the surface of the StructuredGrid"),
        (pv.Sphere().get_cell(3), "the cell is not on the surface"),
    ):
        refused(message, grid.voxflat.geodesic, bad)
    refused(r"seed_point is \[1, 2, 3\]. Pass one point number", grid.voxflat, seed_point=(1, 2, 3), radius=3.0)
    with caplog.at_level(logging.WARNING, logger="voxflat"):
        grid.voxflat.geodesic([0.0, 0.0, 80.0])
    assert "the position [0.0, 0.0, 80.0] is 72.73 away from the surface" in caplog.text


def test_positions_in_an_image_are_voxels():
    image = pv.ImageData(dimensions=(14, 12, 8), spacing=(1.0, 2.0, 1.5), origin=(-3.0, 5.0, 2.0))
    i, j, k = np.indices((14, 12, 8))
    image["mask"] = ((k < 4) & (k > 0) & (i % 13 > 0) & (j % 11 > 0)).astype("uint8").ravel(order="F")
    voxel = (6, 6, 3)
    position = np.array([-3.0, 5.0, 2.0]) + np.array(voxel) * [1.0, 2.0, 1.5] + 0.2
    disks = [image.voxflat(method=Voxflat(sources=9), seed_point=seed, radius=4.0) for seed in (voxel, position)]
    assert_array_equal(disks[0].points, disks[1].points)


def with_a_merged_vertex():
    """Return a plane in which point 60 is duplicated; triangles without area connect the two points."""
    mesh = pv.Plane(i_size=10, j_size=10, i_resolution=10, j_resolution=10).triangulate()
    faces, twin = mesh.regular_faces.copy(), mesh.n_points
    around = faces[(faces == 60).any(axis=1)]
    ring = {}
    for face in around:
        first, second = np.roll(face, -list(face).index(60))[1:]
        ring[int(first)] = int(second)
    order = [next(iter(ring))]
    while len(order) < len(ring):
        order.append(ring[order[-1]])
    half = len(order) // 2
    new = [[twin if n >= half else 60, order[n], order[(n + 1) % len(order)]] for n in range(len(order))]
    new += [[60, order[half], twin], [twin, order[0], 60]]
    rest = faces[(faces != 60).all(axis=1)]
    return pv.PolyData.from_regular_faces(np.vstack([mesh.points, mesh.points[60]]), np.vstack([rest, new]))


def test_merged_points_have_the_distance_of_the_one_that_they_are():
    mesh = with_a_merged_vertex()
    distances = mesh.voxflat.geodesic(0, method="exact")["geodesic_distance"]
    assert_allclose(distances, np.linalg.norm(mesh.points - mesh.points[0], axis=1), rtol=1e-5)
    assert_allclose(mesh.voxflat.geodesic(mesh.n_points - 1)["geodesic_distance"][60], 0)


@pytest.mark.medium
def test_a_surface_is_cut_open_with_its_data(ball):
    ball = ball.copy()
    ball.point_data["number"] = np.arange(ball.n_points)
    ball.cell_data["cell"] = np.arange(ball.n_cells)
    before = ball.copy()
    opened = ball.voxflat.cut(relax=False)
    assert ball == before
    cuts = json.loads(opened.field_data["voxflat"][0])["cuts"]
    assert [cut["reason"] for cut in cuts] == ["closed sphere"]
    along = cuts[0]["ids"]
    assert opened.n_points == ball.n_points + len(along) - 2  # the end points are not duplicated
    assert sorted(set(opened["vertex_ids"][opened["cut"] == 0])) == sorted(along)
    assert set(opened["cut"]) == {-1, 0}
    assert opened.active_scalars_name == "cut"
    length = np.linalg.norm(np.diff(ball.points[along], axis=0), axis=1).sum()
    assert cuts[0]["length"] == pytest.approx(length, rel=1e-6)
    rim = opened.extract_feature_edges(feature_edges=False, manifold_edges=False, non_manifold_edges=False)
    assert rim.n_cells == 2 * (len(along) - 1)
    assert_array_equal(opened["number"], opened["vertex_ids"])
    assert_allclose(opened.points, ball.points[opened["number"]])
    assert_array_equal(np.sort(opened["cell"]), np.arange(ball.n_cells))
    assert opened.voxflat.check().can_flatten


def test_given_cuts_of_a_grid():
    grid = saddle()
    middle = [16 * n + 8 for n in range(8)]  # from one side to the middle
    opened = grid.voxflat.cut(cuts=[middle], relax=False)
    assert json.loads(opened.field_data["voxflat"][0])["cuts"][0]["ids"] == middle
    assert opened.n_points == grid.n_points + len(middle) - 1


def test_a_map_of_ours_is_measured_with_its_cuts(ball, flat_ball):
    flat_map = ball.voxflat.flatten(method=Voxflat(sources=30), relax=False)
    expected = voxflat.measure(ball, flat_map, sources=20, seed=3)
    measured = ball.voxflat.measure(flat_ball, sources=20, seed=3)
    assert_allclose(measured["distance_error"], expected.per_point, rtol=1e-4)  # points are float32 in PyVista
    assert_allclose(measured["areal"], expected.triangles.areal, atol=1e-4)
    figures = json.loads(measured.field_data["voxflat"][0])["distortion"]
    assert figures["raw"]["relative_error"] == pytest.approx(expected.raw.relative_error, rel=1e-5)
    assert_allclose(measured.points, flat_ball.points, atol=1e-5)
    assert_array_equal(measured["vertex_ids"], flat_ball["vertex_ids"])
    assert measured.n_points > ball.n_points
    assert_allclose(ball.voxflat.measure(flat_map, sources=20, seed=3)["distance_error"], expected.per_point)


def test_a_map_of_another_tool_is_measured():
    grid = saddle()
    grid.point_data["number"] = np.arange(grid.n_points)
    shadow = grid.extract_surface(**ALGORITHM).project_points_to_plane(normal=(0, 0, 1))
    measured = grid.voxflat.measure(shadow, sources=20)
    assert_array_equal(measured["number"], measured["vertex_ids"])
    assert_allclose(measured.points[:, :2], grid.points[measured["number"], :2], atol=1e-5)
    slope = np.hypot(0.16 * grid.points[:, 0], 0.16 * grid.points[:, 1])
    steep = slope[measured["vertex_ids"]] > 1.5
    assert measured["areal"][steep].max() < np.log2(1 / np.hypot(1, 1.3))
    of_places = grid.voxflat.measure(np.asarray(grid.points)[:, :2], sources=20)
    assert_allclose(of_places["distance_error"], measured["distance_error"], rtol=1e-6)


def test_an_image_is_cut_and_its_map_measured():
    image = pv.ImageData(dimensions=(9, 9, 9))
    image["mask"] = (np.linalg.norm(image.points - 4, axis=1) < 3.6).astype("uint8")
    assert image.voxflat.cut(relax=False)["voxel_ids"].shape[1] == 3
    flat = image.voxflat(method=Voxflat(sources=20), relax=False)
    measured = image.voxflat.measure(flat, sources=20)
    assert_array_equal(measured["voxel_ids"], flat["voxel_ids"])
    assert_allclose(measured["areal"], flat["areal"], atol=1e-4)


def test_maps_of_other_surfaces_are_refused(ball, flat_ball):
    refused(r"not on the surface|not a vertex of the surface", pv.Icosphere(nsub=1).voxflat.measure, flat_ball)
    refused("not flat", ball.voxflat.measure, ball)
    refused("has 5 points, but the surface", ball.voxflat.measure, np.zeros((5, 2)))
    points, faces = np.asarray(flat_ball.points), flat_ball.regular_faces
    ids = flat_ball["vertex_ids"]
    for bad, message in (
        ((points[:, 0], faces, ids), "the map is an array of shape"),
        ((points, faces + len(points), ids), "the triangles of the map refer to points"),
        ((points, faces[:, :2], ids), "the triangles of the map are"),
        ((points, faces, ids[1:]), "Pass one vertex number per point"),
        ((points, faces, ids + 10**6), "vertex 1000000 of the map is not"),
        ((points * np.nan, faces, ids), "not flat or not finite"),
    ):
        refused(message, voxflat.measure, ball, bad)


def test_a_picture_lies_as_that_of_the_map(flat):
    grid, before = saddle(), flat.copy()
    picture = np.random.default_rng(0).integers(0, 256, (30, 40, 3), dtype=np.uint8)
    surface, texture = flat.voxflat.texture(picture)
    assert flat == before
    expected = grid.voxflat.flatten(method=Voxflat(sources=30), relax=False).textured(picture)
    assert np.abs(surface["colours"].astype(int) - expected.colours).max() <= 1
    assert_allclose(surface.active_texture_coordinates, expected.texture_coordinates, atol=1e-6)
    assert_allclose(surface.points, flat["surface_points"], atol=1e-5)
    assert_array_equal(texture.to_array(), picture)
    assert not texture.repeat
    refused("does not cover the map", flat.voxflat.texture, picture, 0.1)
    assert flat.voxflat.texture(picture, 0.1, repeat=True)[1].repeat


def clicked(plotter, column, place):
    """Click on a point in the view of a column."""
    renderer = plotter.renderers[column]
    renderer.SetWorldPoint(*place, 1.0)
    renderer.WorldToDisplay()
    x, y, _ = renderer.GetDisplayPoint()
    plotter.iren._mouse_left_button_click(round(x), round(y))


def marks(plotter):
    """Return the positions of the marks in each column."""
    found = []
    for renderer in plotter.renderers:
        actors = [actor for actor in renderer.actors.values() if isinstance(actor, pv.Actor) and actor.GetVisibility()]
        shown = [pv.wrap(actor.GetMapper().GetInput()) for actor in actors]
        found.append([mesh.points[0] for mesh in shown if mesh.n_points == 1])
    return found


@pytest.mark.slow
def test_a_click_marks_the_place_on_both_sides(flat):
    before = flat.copy()
    plotter = flat.voxflat.plot("areal", off_screen=True, show=False, window_size=(600, 300))
    plotter.show(auto_close=False, interactive=False)
    assert marks(plotter) == [[], []]
    corners = flat.regular_faces[200]
    place = np.array([0.6, 0.3, 0.1]) @ flat.points[corners]
    clicked(plotter, 1, place)
    in_space, in_plane = marks(plotter)
    pixel = 2 * plotter.renderers[1].camera.parallel_scale / 300
    assert_allclose(in_plane[0], place, atol=1.5 * pixel)
    assert_allclose(in_space[0], np.array([0.6, 0.3, 0.1]) @ flat["surface_points"][corners], atol=3 * pixel)
    texts = [actor.GetText(2) for actor in plotter.renderers[1].actors.values() if hasattr(actor, "GetText")]
    nearest = corners[0]
    assert f"point {flat['vertex_ids'][nearest]}\narea, log2(flat / surface): {flat['areal'][nearest]:.4g}" in texts
    assert len(plotter.scalar_bars) == 1
    ranges = [
        actor.GetMapper().GetScalarRange()
        for renderer in plotter.renderers
        for actor in renderer.actors.values()
        if isinstance(actor, pv.Actor) and actor.GetMapper().GetInput().GetNumberOfPoints() == flat.n_points
    ]
    assert len(ranges) == 2
    assert ranges[0] == ranges[1]
    assert ranges[0][0] == -ranges[0][1]
    plotter.close()
    assert flat == before


@pytest.mark.slow
def test_pictures_of_all_kinds_of_arrays(flat, tmp_path):
    flat = flat.copy()
    flat.point_data["rgb"] = np.tile(np.array([250, 20, 30], dtype=np.uint8), (flat.n_points, 1))
    flat.cell_data["name"] = np.array(["a"] * flat.n_cells)
    for name in ("rgb", "flipped", "number", None):
        flat.voxflat.plot(name, off_screen=True, screenshot=tmp_path / f"{name}.png", window_size=(200, 100))
    red = np.asarray(Image.open(tmp_path / "rgb.png").convert("RGB"))[:, 100:]
    assert (red == [250, 20, 30]).all(axis=2).mean() > 0.2
    refused(r"no array 'areel'.*areal", flat.voxflat.plot, "areel")
    refused("Choose an array with one number", flat.voxflat.plot, "surface_points")
    refused("clim is \\(1, 0\\)", flat.voxflat.plot, clim=(1, 0))
    refused("radius: the mesh is already a flat map", flat.voxflat.plot, radius=3.0)


def test_a_morph_leads_from_the_surface_to_the_map(flat_ball):
    before = flat_ball.copy()
    morph = flat_ball.voxflat.morph(4)
    assert len(morph) == len(list(morph)) == 4
    assert_allclose(morph[0].points, flat_ball["surface_points"])
    first, last = morph[0].points, morph[-1].points
    assert_allclose(morph[1:][0].points, (2 * first + last) / 3)
    assert_allclose(morph.at(1).points, last)
    some = np.random.default_rng(1).integers(0, len(last), (50, 2)).T
    apart = [np.linalg.norm(np.subtract(*points[some]), axis=1) for points in (last, flat_ball.points)]
    assert_allclose(apart[0], apart[1], atol=1e-4)
    assert set(morph[2].array_names) == set(flat_ball.array_names)
    assert flat_ball == before
    for bad in (1, 2.5, "many"):
        refused("Pass a whole number of at least 2", flat_ball.voxflat.morph, bad)
    refused(r"share is 1\.2", morph.at, 1.2)


def test_what_is_flat_already_stays_where_it_is():
    """A plane anywhere in space is its own map and is not mirrored."""
    plane = pv.Plane(center=(9, 4, 7), direction=(1, 2, 2), i_size=10, j_size=8).triangulate()
    morph = plane.voxflat.morph(3)
    assert_allclose(morph[-1].points, morph[0].points, atol=2e-3 * plane.length)


@pytest.mark.slow
def test_a_film_goes_there_and_back(flat, tmp_path):
    morph = flat.voxflat.morph(4)
    morph.save(tmp_path / "unfold.gif", window_size=(96, 96), fps=10)
    with Image.open(tmp_path / "unfold.gif") as film:
        assert film.n_frames == 6
        frames = []
        for number in range(6):
            film.seek(number)
            assert film.info["duration"] == 100
            frames.append(np.asarray(film.convert("RGB")).astype(int))
    apart = [[np.abs(a - b).mean() for b in frames] for a in frames]
    assert apart[0][3] > apart[0][1] > 0
    assert apart[1][5] < 0.1 * apart[0][3]
    assert apart[2][4] < 0.1 * apart[0][3]
    refused("cannot write unfold.avi: .* Use a name that ends in .mp4 or .gif", morph.save, tmp_path / "unfold.avi")
    refused("fps is 0", morph.save, tmp_path / "other.gif", fps=0)
    refused("that are even", morph.save, tmp_path / "unfold.mp4", window_size=(101, 96))
    if importlib.util.find_spec("imageio_ffmpeg"):
        morph.save(tmp_path / "unfold.mp4", window_size=(96, 96))
        import imageio_ffmpeg

        assert imageio_ffmpeg.count_frames_and_secs(tmp_path / "unfold.mp4")[0] == 6
    else:
        refused("requires imageio_ffmpeg. Install it", morph.save, tmp_path / "unfold.mp4", window_size=(96, 96))
    assert {path.name for path in tmp_path.iterdir()} <= {"unfold.gif", "unfold.mp4"}


@pytest.mark.slow
def test_the_slider_unfolds(flat):
    plotter = flat.voxflat.morph(2).plot(off_screen=True, show=False, window_size=(200, 160))
    plotter.show(auto_close=False, interactive=False)
    actor = next(actor for actor in plotter.actors.values() if isinstance(actor, pv.Actor))

    def mesh():
        return pv.wrap(actor.GetMapper().GetInput())

    assert_allclose(mesh().points, flat["surface_points"], atol=1e-5)
    slider = plotter.slider_widgets[0]
    slider.GetRepresentation().SetValue(1.0)
    slider.InvokeEvent("InteractionEvent")
    plotter.render()  # like the interactor
    flat_now = np.array(mesh().points)
    normal = np.linalg.svd(flat_now - flat_now.mean(axis=0))[1]
    assert normal[2] < 1e-4 * normal[0]
    plotter.close()
