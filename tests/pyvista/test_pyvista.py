import inspect
import json
import subprocess
import sys
import warnings

import composed
import numpy as np
import pytest
import pyvista as pv
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused
from textures import needs_window

import voxflat
from voxflat import InputError
from voxflat._pyvista import BlocksAccessor, VoxflatAccessor, to_polydata, to_surface_polydata
from voxflat._pyvista.options import CutOptions, FlattenOptions, PartOptions, PlaceOptions
from voxflat.methods import Voxflat

SHAPE = (20, 26, 10)
PLACES = {
    "plain": {},
    "spacing and origin": {"spacing": (0.5, 0.7, 2.0), "origin": (-40.0, 3.0, 12.5)},
    "extent": {"spacing": (0.5, 0.7, 2.0), "origin": (-40.0, 3.0, 12.5), "offset": (3, -5, 7)},
    "rotated": {"spacing": (1.0, 2.0, 0.5), "origin": (1.0, 2.0, 3.0), "offset": (1, 2, 3), "turn": 1.0},
    "mirrored": {"spacing": (1.0, 2.0, 0.5), "offset": (1, 2, 3), "turn": -1.0},
}


def sheet(shape=SHAPE):
    """Return a curved sheet, one voxel thick, with a different height along each axis."""
    i, j, k = np.indices(shape)
    return (k == np.rint(4 + 3 * np.sin(i / 7) * np.cos(j / 30)).astype(int)).astype(np.uint8)


def solid(shape=SHAPE):
    """Return the voxels below a smooth surface, away from the border of the volume."""
    i, j, k = np.indices(shape)
    inside = (k <= 5 + 2 * np.sin(i / 5) * np.cos(j / 6)) & (np.minimum(i, j) > 0) & (i < 19) & (j < 25) & (k > 0)
    return inside.astype(np.uint8)


def bumpy():
    """Return a triangle mesh with bumps, 40 by 30 mm, and arrays of many kinds."""
    mesh = pv.Plane(i_size=40.0, j_size=30.0, i_resolution=20, j_resolution=15).triangulate()
    mesh.points[:, 2] = 3 * np.sin(mesh.points[:, 0] / 6) * np.cos(mesh.points[:, 1] / 9)
    mesh["height"] = mesh.points[:, 2].copy()
    mesh["right"] = mesh.points[:, 0] > 0
    mesh["colour"] = np.arange(3 * mesh.n_points, dtype=np.uint8).reshape(-1, 3)
    mesh["name"] = np.array([f"point {number}" for number in range(mesh.n_points)])
    return mesh


def image_of(volume, in_cells=False, name="labels", turn=None, **place):
    image = pv.ImageData(dimensions=np.array(volume.shape) + in_cells, **place)
    if turn is not None:
        q, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
        image.direction_matrix = q * np.array([1, 1, turn * np.sign(np.linalg.det(q))])
    (image.cell_data if in_cells else image.point_data)[name] = volume.ravel(order="F")
    return image


def fresh(code):
    """Run code in a new process and return its output."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.fixture(scope="module")
def image():
    return image_of(sheet(), spacing=(1.0, 1.5, 1.0))


@pytest.fixture(scope="module", params=["grossmann2002", "voxflat"])
def flat_map(request, image):
    if request.param == "grossmann2002":
        return image.voxflat.flatten(method=voxflat.methods.Grossmann2002(sources=60))
    flat_map = image_of(solid()).voxflat.flatten(seed_point=(10, 13, 6), radius=10.0)
    assert flat_map.metadata["method"] == "voxflat"  # the default method
    return flat_map


@pytest.mark.medium
@pytest.mark.parametrize("in_cells", [False, True], ids=["points", "cells"])
@pytest.mark.parametrize("place", PLACES.values(), ids=PLACES)
def test_points_lie_where_vtk_has_them(place, in_cells):
    """Voxels are at their centres; subvoxel positions are at most one voxel away along each axis."""

    def apart(volume, **how):
        image = image_of(volume, in_cells, **place)
        flat_map = image.voxflat.flatten(**how)
        centres = image.cell_centers().points if in_cells else image.points
        number = np.ravel_multi_index(tuple(flat_map.ids.T), SHAPE, order="F")
        linear = image.index_to_physical_matrix[:3, :3]
        return np.linalg.solve(linear, (flat_map.points - centres[number]).T)  # voxels

    at_centres = apart(sheet(), method=voxflat.methods.Grossmann2002(sources=10))
    assert_allclose(at_centres, np.zeros((3, sheet().sum())), atol=2e-4)
    finer = apart(solid(), method=Voxflat(sources=10), seed_point=(10, 13, 6), radius=8.0)
    assert np.abs(finer).max() < 1 + 1e-9
    assert np.abs(finer.mean(axis=1)).max() < 0.5


@pytest.mark.parametrize("in_cells", [False, True], ids=["points", "cells"])
def test_voxel_at_finds_every_centre(in_cells):
    image = image_of(sheet(), in_cells, **PLACES["rotated"])
    centres = image.cell_centers().points if in_cells else image.points
    for number in (0, 17, 1234, len(centres) - 1):
        assert image.voxflat.voxel_at(centres[number]) == np.unravel_index(number, SHAPE, order="F")
    refused("outside the image", image.voxflat.voxel_at, (1e3, 0, 0))


@pytest.mark.parametrize("in_cells", [False, True], ids=["points", "cells"])
def test_a_single_slice_of_voxels(in_cells):
    image = pv.ImageData(dimensions=(9 + in_cells, 8 + in_cells, 1), spacing=(1, 1, 3), origin=(0, 0, 5))
    image["mask"] = np.ones(72, dtype=np.uint8)
    flat_map = image.voxflat.flatten(method=voxflat.methods.Grossmann2002(sources=10))
    assert len(flat_map) == 72
    assert set(flat_map.points[:, 2]) == {5.0}


@pytest.mark.medium
@pytest.mark.parametrize(
    ("method", "volume"), [("grossmann2002", sheet()), ("voxflat", solid()), ("schwartz1989", solid())]
)
def test_result_is_that_of_voxflat_flatten_on_the_array(method, volume):
    image = image_of(volume, name="other", **PLACES["rotated"])
    image["brain"] = 3 * image["other"] + 1
    affine = image.index_to_physical_matrix.copy()
    affine[:3, 3] = image.points[0]
    options = {"label": 4, "seed_point": (10, 12, 6), "radius": 12.0, "sources": 40, "seed": 5, "method": method}
    expected = composed.flatten(3 * volume + 1, affine=affine, **options)
    given = composed.with_method(options)
    found = image.voxflat.flatten("brain", **given)
    assert found.metadata["method"] == method
    assert_array_equal(found.ids, expected.ids)
    assert_allclose(found.uv, expected.uv, atol=1e-6)
    assert_array_equal(image.voxflat("brain", **given).points[:, :2], found.uv)


def test_the_volume_is_a_view(image):
    assert np.shares_memory(image.voxflat.volume().data, image["labels"])


@pytest.mark.parametrize("dtype", [bool, np.int64, np.float32, np.uint16])
def test_types_of_labels(dtype):
    image = image_of(sheet().astype(dtype))
    assert len(image.voxflat.flatten(method=voxflat.methods.Grossmann2002(sources=10))) == sheet().sum()


@pytest.mark.slow
@pytest.mark.parametrize(("method", "volume"), [("grossmann2002", sheet()), ("voxflat", solid())])
def test_keep_is_an_array_of_the_image_or_another_image(method, volume):
    spacing = (1.0, 1.5, 1.0)
    half = np.zeros(SHAPE, dtype=np.uint8)
    half[:, :13] = 1
    both = image_of(volume, spacing=spacing)
    both["half"] = half.ravel(order="F")
    other = image_of(half, spacing=spacing)
    options = {"sources": 20, "method": method} | ({"relax": False} if method == "voxflat" else {})
    expected = composed.flatten(volume, spacing=spacing, keep=half, **options).ids
    assert expected[:, 1].max() == 12
    for keep in ("half", other, half):
        assert_array_equal(both.voxflat.flatten("labels", keep=keep, **composed.with_method(options)).ids, expected)


def test_colours_are_sampled_onto_the_map(flat_map):
    colours = image_of(sheet(), spacing=np.diag(flat_map.metadata["affine"])[:3])
    colours["rgb"] = np.tile(np.array([10, 20, 30], dtype=np.uint8), (colours.n_points, 1))
    pixels = flat_map.image(colours.voxflat.volume("rgb")).data
    assert {tuple(pixel) for pixel in pixels[pixels[..., 3] > 0].tolist()} == {(10, 20, 30, 255)}
    refused("one value (a|per) voxel", colours.voxflat, "rgb")


def test_a_mesh_is_flattened_with_all_its_arrays():
    mesh = bumpy()
    mesh["distance_error"] = np.full(mesh.n_points, 7.0)  # the map has an array of this name
    mesh.cell_data["area"] = mesh.compute_cell_sizes()["Area"]
    mesh.cell_data["torn"] = np.arange(mesh.n_cells)  # also a name in the map
    mesh.field_data["subject"] = ["bert"]
    before = mesh.copy()
    with pytest.warns(UserWarning, match="array '(distance_error|torn)', so the array of the mesh is named 'mesh_"):
        flat = mesh.voxflat(method=Voxflat(sources=60))
    flat_map = mesh.voxflat.flatten(method=Voxflat(sources=60))
    assert mesh == before  # the mesh is unchanged
    assert_array_equal(flat.point_data["mesh_distance_error"], 7)
    assert flat.field_data["subject"].tolist() == ["bert"]
    in_space = flat.copy()
    in_space.points = flat["surface_points"]
    assert_allclose(in_space.compute_cell_sizes()["Area"], flat.cell_data["area"], rtol=1e-5)
    cells = flat.cell_data["mesh_torn"]
    same = np.sort(flat["vertex_ids"][flat.regular_faces], axis=1) == np.sort(mesh.regular_faces[cells], axis=1)
    assert same.all()
    ids = flat.point_data["vertex_ids"]
    assert_array_equal(np.sort(ids), np.arange(mesh.n_points))
    assert set(flat.point_data) >= set(mesh.point_data)
    assert_array_equal(flat.active_texture_coordinates, mesh.active_texture_coordinates[ids])
    assert flat.point_data["Texture Coordinates"].shape == (mesh.n_points, 2)  # those of the map
    for name in ("height", "right", "colour", "name", "Normals"):
        assert_array_equal(flat.point_data[name], mesh.point_data[name][ids])
        assert flat.point_data[name].dtype == mesh.point_data[name].dtype
    assert_array_equal(flat.point_data["distance_error"], flat_map.distortion.per_point)
    assert flat.active_scalars_name == "distance_error"
    assert_array_equal(flat.point_data["surface_points"], mesh.points[ids])
    assert_array_equal(flat.points[:, :2], flat_map.uv.astype(flat.points.dtype))
    assert not flat.points[:, 2].any()
    assert flat.cell_data["torn"].dtype == bool
    assert not flat.cell_data["torn"].any()
    triangles = (set(map(frozenset, faces.tolist())) for faces in (ids[flat.regular_faces], mesh.regular_faces))
    assert next(triangles) == next(triangles)
    assert flat_map.distortion.raw.relative_error < 0.03
    assert "voxel_ids" not in flat.point_data
    description = json.loads(flat.field_data["voxflat"][0])
    assert (description["method"], description["kind"], description["vertices"]) == ("voxflat", "mesh", mesh.n_points)


def test_keep_is_an_array_of_the_mesh():
    mesh = bumpy()
    flat = mesh.voxflat(method=Voxflat(sources=40), keep="right")
    assert flat.point_data["right"].all()
    assert flat.n_points == mesh["right"].sum()
    mask = mesh.voxflat(method=Voxflat(sources=40), keep=np.asarray(mesh["right"]))
    assert_array_equal(flat.point_data["vertex_ids"], mask.point_data["vertex_ids"])
    assert not mesh.voxflat(method=Voxflat(sources=40), drop="right").point_data["right"].any()
    refused("contains no triangle", mesh.voxflat, keep=np.zeros(mesh.n_points, dtype=bool))
    refused(r"'misspelt' is neither a point array nor a file.*right", mesh.voxflat, drop="misspelt")


def test_arrays_of_both_sides_of_a_cut():
    """Points on a cut, and their values, occur twice in the map."""
    ball = pv.Icosphere(radius=20.0, nsub=2)
    ball["number"] = np.arange(ball.n_points)
    meridian = np.flatnonzero((np.abs(ball.points[:, 1]) < 1e-3) & (ball.points[:, 0] > -1e-3))
    path = voxflat.surface(ball).path(int(meridian[ball.points[meridian, 2].argmin()]), 0, geodesic="edges").ids
    flat = ball.voxflat(method=Voxflat(sources=40), cuts=[path.tolist()])
    assert_array_equal(flat.point_data["number"], flat.point_data["vertex_ids"])
    numbers, counts = np.unique(flat.point_data["number"], return_counts=True)
    assert len(numbers) == ball.n_points
    assert set(numbers[counts == 2]) == set(path[1:-1])
    assert counts.max() == 2


def test_lines_beside_triangles_are_left_out():
    mesh = bumpy()
    lines = pv.PolyData(mesh.points, faces=mesh.faces, lines=[2, 0, 1])
    lines.cell_data["number"] = np.arange(lines.n_cells)  # the line is the first cell
    flat = lines.voxflat(method=Voxflat(sources=10))
    assert flat.n_points == lines.n_points
    assert sorted(flat.cell_data["number"]) == [*range(1, lines.n_cells)]


def test_what_means_nothing_for_a_mesh_is_refused():
    mesh = bumpy()
    refused("scalars is 'height', but this option applies only to images", mesh.voxflat, "height")
    refused("label does not apply when the input is a mesh", mesh.voxflat, label=1)
    for call in (mesh.voxflat.volume, lambda: mesh.voxflat.voxel_at((0, 0, 0))):
        refused("the PolyData is not a volume", call)


def open_cylinder():
    """Return a structured grid of quads, rolled up to a cylinder with a slit."""
    angle, height = np.meshgrid(np.linspace(0.3, 6.0, 24), np.linspace(0, 20, 12), indexing="ij")
    return pv.StructuredGrid(10 * np.cos(angle), 10 * np.sin(angle), height)


@pytest.mark.medium
def test_numbers_are_those_of_the_datasets_points():
    grid = open_cylinder()
    seed = 24 * 6 + 12
    flat = grid.voxflat(method=Voxflat(sources=np.array([seed, seed + 1, seed - 24])), seed_point=seed, radius=6.0)
    assert np.linalg.norm(flat["surface_points"] - grid.points[seed], axis=1).max() <= 6
    keep = np.zeros(grid.n_points, dtype=bool)
    keep[: 24 * 5] = True
    grid.point_data["lower"] = keep
    for region in (keep, "lower", np.flatnonzero(keep)):
        assert grid.voxflat(method=Voxflat(sources=10), keep=region)["lower"].all()
    solid = pv.RectilinearGrid(*3 * (np.arange(6.0),))
    inside = int(solid.find_closest_point((2.5, 2.5, 2.5)))
    with pytest.raises(InputError, match=f"seed_point: point {inside} is not on the surface of the RectilinearGrid"):
        solid.voxflat(seed_point=inside, radius=2.0)
    refused("Extract its surface first", pv.ImageData(dimensions=(3, 3, 3)).voxflat.geodesic, 0)
    refused("UnstructuredGrid: has no points", pv.UnstructuredGrid().voxflat)


def test_distances_and_paths_along_a_grid():
    grid = open_cylinder()
    measured = grid.voxflat.geodesic(0, method="exact")
    assert isinstance(measured, pv.StructuredGrid)
    assert "geodesic_distance" not in grid.point_data
    angle, height = np.meshgrid(np.linspace(0.3, 6.0, 24), np.linspace(0, 20, 12), indexing="ij")
    chord = 2 * 10 * np.sin((6.0 - 0.3) / 23 / 2)  # the width of each of its 23 flat strips
    unrolled = np.hypot(23 * chord * (angle - 0.3) / (6.0 - 0.3), height).ravel(order="F")
    assert_allclose(measured["geodesic_distance"], unrolled, rtol=1e-5, atol=1e-4)
    both = grid.voxflat.geodesic([0, grid.n_points - 1], method="exact")["geodesic_distance"]
    assert_allclose(both, np.minimum(unrolled, unrolled[::-1]), rtol=1e-5, atol=1e-4)
    line = grid.voxflat.path(0, grid.n_points - 1)
    along = np.linalg.norm(np.diff(line.points, axis=0), axis=1).sum()
    assert line.field_data["length"][0] == pytest.approx(unrolled[-1], rel=1e-5) == pytest.approx(along, rel=1e-5)
    assert line["vertex_ids"][[0, -1]].tolist() == [0, grid.n_points - 1]


@pytest.mark.medium
def test_blocks_are_flattened_one_by_one(capsys):
    blocks = pv.MultiBlock({"tube": open_cylinder(), "nothing": None, "more": pv.MultiBlock({"bumps": bumpy()})})
    flat = blocks.voxflat(method=Voxflat(sources=10), progress_bar=True)
    assert flat.keys() == ["tube", "nothing", "more"]
    assert flat["nothing"] is None
    assert flat["more"]["bumps"].n_points == bumpy().n_points
    assert "100%" in capsys.readouterr().err
    with pytest.raises(InputError, match="block 'points': PolyData: has no faces, only 4 cells"):
        pv.MultiBlock({"points": pv.PolyData(np.eye(4, 3))}).voxflat()


@pytest.mark.medium
def test_results_of_blocks_within_blocks_are_named_by_their_path():
    blocks = pv.MultiBlock({"tube": open_cylinder(), "more": pv.MultiBlock({"bumps": bumpy(), "none": None})})
    flat = blocks.voxflat(method=Voxflat(sources=10))
    measured = blocks.voxflat.measure(flat, sources=10)
    assert measured["more"]["bumps"] == bumpy().voxflat.measure(flat["more"]["bumps"], sources=10)
    assert measured["more"]["none"] is None
    flat_maps = blocks.voxflat.flatten(method=Voxflat(sources=10))
    assert list(flat_maps) == list(blocks.voxflat.check()) == ["tube", "more/bumps"]
    with pytest.raises(InputError, match="Pass a MultiBlock with one map for each of the 2 blocks"):
        blocks.voxflat.measure(pv.MultiBlock([flat["tube"]]))
    refused("got PolyData for the maps. Pass a MultiBlock", blocks.voxflat.measure, flat["tube"])


def test_verbs_of_one_surface_are_refused_for_blocks():
    blocks = pv.MultiBlock({"tube": open_cylinder()})
    verbs = {name for name in dir(VoxflatAccessor) if not name.startswith(("_", "to_"))}
    unknown = verbs - set(dir(BlocksAccessor))
    assert unknown == {"geodesic", "path", "texture", "plot", "morph", "show", "export_html", "volume", "voxel_at"}
    for name in unknown:
        with pytest.raises(AttributeError, match=rf"Call it on one block: blocks\['tube'\]\.voxflat\.{name}\("):
            getattr(blocks.voxflat, name)
    with pytest.raises(AttributeError, match="'BlocksAccessor' object has no attribute 'flaten'"):
        blocks.voxflat.flaten()
    twice = pv.MultiBlock()
    for _ in range(2):
        twice.append(pv.Plane(), "plane")
    refused("two blocks have the name 'plane'", twice.voxflat.check)
    with pytest.raises(InputError, match="block 'table' has type Table, which has no surface"):
        pv.MultiBlock({"table": pv.Table({"a": np.arange(2)})}).voxflat()


def test_options_are_those_of_the_functions():
    part = PartOptions.__annotations__.keys()
    for options, verb in ((FlattenOptions, voxflat.Surface.flatten), (CutOptions, voxflat.Surface.cut)):
        assert options.__annotations__.keys() == part | (inspect.signature(verb).parameters.keys() - {"self"})
    for function in (voxflat.check, voxflat.surface):
        assert PlaceOptions.__annotations__.keys() <= inspect.signature(function).parameters.keys()
    own = inspect.signature(VoxflatAccessor.patches).parameters
    for name in ("max_angle", "bound", "count", "seeds", "seed"):
        assert own[name].default == inspect.signature(voxflat.Surface.patches).parameters[name].default


def test_a_wrong_name_lists_the_arrays():
    image = image_of(sheet(), name="left")
    image["right"] = image["left"]
    refused("no array 'middle'.*The image has the arrays left, right", image.voxflat, "middle")
    refused("The image has no arrays", pv.ImageData(dimensions=(3, 3, 3)).voxflat)
    image.set_active_scalars(None)
    refused(r"no array of the image is active.*The image has the arrays left, right", image.voxflat)


def test_what_of_an_image_is_no_volume_to_be_flattened_is_refused(image):
    image = image.copy()
    refused("no voxel has label 7", image.voxflat, label=7)
    with pytest.raises(TypeError, match="unexpected keyword argument 'lable'"):
        image.voxflat(lable=1)
    image["vectors"] = np.zeros((image.n_points, 3))
    refused("'vectors' has 3 components", image.voxflat, "vectors")
    image.cell_data["labels"] = np.zeros(image.n_cells)
    refused("both have an array 'labels'", image.voxflat, "labels")


def test_polydata_holds_the_map_in_the_plane_and_in_space(flat_map):
    mesh = to_polydata(flat_map)
    assert_allclose(mesh.points[:, :2], flat_map.uv, atol=1e-4)
    assert (mesh.points[:, 2] == 0).all()
    assert_array_equal(mesh.regular_faces, flat_map.faces)
    assert_array_equal(mesh.point_data["distance_error"], flat_map.distortion.per_point)
    assert_array_equal(mesh.point_data["voxel_ids"], flat_map.ids)
    assert_array_equal(mesh.point_data["surface_points"], flat_map.points)
    assert_array_equal(mesh.cell_data["torn"], flat_map.torn)
    assert mesh.active_scalars_name == "distance_error"
    assert (mesh.compute_normals(auto_orient_normals=False)["Normals"][:, 2] > 0.99).all()
    surface = to_surface_polydata(flat_map)
    assert_allclose(surface.points, flat_map.points, atol=1e-4)
    assert np.ptp(surface.points[:, 2]) > 1
    assert_array_equal(surface.regular_faces, mesh.regular_faces)
    assert surface.array_names == mesh.array_names


def test_description_survives_a_file(flat_map, tmp_path):
    to_polydata(flat_map).save(tmp_path / "map.vtp")
    for mesh in (to_polydata(flat_map), pv.read(tmp_path / "map.vtp")):
        description = json.loads(mesh.field_data["voxflat"][0])
        assert description["method"] == flat_map.metadata["method"]
        assert description["affine"] == flat_map.metadata["affine"]
        assert description["distortion"]["raw"]["relative_error"] == flat_map.distortion.raw.relative_error
        assert mesh.active_texture_coordinates.shape == (len(flat_map), 2)


@pytest.mark.medium
@pytest.mark.parametrize("name", ["TextureCoordinates", "Texture Coordinates"])
def test_a_textured_globe_shows_the_same_world_on_its_map(name):
    globe = pv.Icosphere(nsub=3)
    x, y, z = globe.points.T
    globe.point_data[name] = np.column_stack([0.5 + np.arctan2(y, x) / (2 * np.pi), np.arccos(2 * z) / np.pi])
    globe.GetPointData().SetActiveTCoords(name)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        flat = globe.voxflat(method=Voxflat(sources=30))
    is_told = any("named 'mesh_Texture Coordinates'" in str(one.message) for one in caught)
    assert is_told == (name == "Texture Coordinates")
    assert_array_equal(flat.active_texture_coordinates, globe.active_texture_coordinates[flat["vertex_ids"]])
    shown, texture = flat.voxflat.texture(np.zeros((8, 8, 3), dtype=np.uint8))
    assert texture.n_components == 3
    assert_allclose(shown.active_texture_coordinates, flat.point_data["Texture Coordinates"], atol=1e-6)


@pytest.mark.parametrize("shape", [(64, 64), (40, 90), (90, 40)])
def test_texture_coordinates_lay_a_picture_as_texture_does(flat_map, shape):
    height, width = shape
    rows, columns = np.indices(shape, dtype=np.float64)
    expected = flat_map.texture(np.stack([columns, rows], axis=-1))
    s, t = to_polydata(flat_map, picture_shape=shape).active_texture_coordinates.T
    # pixel centres have half-integer coordinates; row 0 is the top, where t = 1
    found = np.stack([s * width - 0.5, (1 - t) * height - 0.5], axis=-1).clip(0, [width - 1, height - 1])
    assert_allclose(found, expected, atol=1e-9 * max(shape))
    assert min(s.min(), t.min()) >= 0
    assert max(s.max(), t.max()) <= 1


@needs_window
def test_vtk_draws_the_picture_upright(flat_map):
    picture = np.zeros((64, 64, 3), dtype=np.uint8)
    picture[:32, :, 0] = 255  # red at the top
    picture[32:, 32:, 2] = 255  # blue at the lower right
    plotter = pv.Plotter(off_screen=True, window_size=[120, 120])
    plotter.add_mesh(to_polydata(flat_map), texture=pv.Texture(picture), lighting=False)
    plotter.view_xy()
    drawn = plotter.screenshot(return_img=True)
    plotter.close()
    assert drawn[45, 50].tolist() == [255, 0, 0]
    assert drawn[75, 70].tolist() == [0, 0, 255]
    assert drawn[75, 50].tolist() == [0, 0, 0]


@pytest.mark.slow
def test_entry_point_needs_no_import_of_voxflat():
    code = """
import sys
import numpy as np
import pyvista as pv
assert "voxflat" not in sys.modules
image = pv.ImageData(dimensions=(12, 9, 3))
image["mask"] = (image.points[:, 2] == 1).astype(np.uint8)
print(image.voxflat(method="grossmann2002").n_points)
"""
    assert fresh(code) == ["108"]


@pytest.mark.slow
def test_before_pyvista_0_48_importing_the_module_is_enough():
    code = """
import numpy as np
import pyvista as pv
vars(pv).pop("register_dataset_accessor", None)
import voxflat._pyvista
image = pv.ImageData(dimensions=(12, 9, 3))
image["mask"] = (image.points[:, 2] == 1).astype(np.uint8)
flat = image.voxflat(method=voxflat.methods.Grossmann2002(sources=9))
print(type(vars(pv.DataSet)["voxflat"]).__name__, flat.n_points)
"""
    assert fresh(code) == ["property", "108"]
