import json
import os
import subprocess
import sys

import numpy as np
import pytest

pv = pytest.importorskip("pyvista")

import voxflat  # noqa: E402
from voxflat import InputError  # noqa: E402
from voxflat._pyvista import to_polydata, to_surface_polydata  # noqa: E402

SHAPE = (20, 26, 10)
PLACES = {
    "plain": {},
    "spacing and origin": {"spacing": (0.5, 0.7, 2.0), "origin": (-40.0, 3.0, 12.5)},
    "extent": {"spacing": (0.5, 0.7, 2.0), "origin": (-40.0, 3.0, 12.5), "offset": (3, -5, 7)},
    "rotated": {"spacing": (1.0, 2.0, 0.5), "origin": (1.0, 2.0, 3.0), "offset": (1, 2, 3), "turn": 1.0},
    "mirrored": {"spacing": (1.0, 2.0, 0.5), "offset": (1, 2, 3), "turn": -1.0},
}


def sheet(shape=SHAPE):
    """A curved sheet, one voxel thick, with a height of its own along each axis."""
    i, j, k = np.indices(shape)
    return (k == np.rint(4 + 3 * np.sin(i / 7) * np.cos(j / 30)).astype(int)).astype(np.uint8)


def turned(sign):
    q, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    return q * np.array([1, 1, sign * np.sign(np.linalg.det(q))])


def image_of(volume, in_cells=False, name="labels", turn=None, **place):
    image = pv.ImageData(dimensions=np.array(volume.shape) + in_cells, **place)
    if turn is not None:
        image.direction_matrix = turned(turn)
    (image.cell_data if in_cells else image.point_data)[name] = volume.ravel(order="F")
    return image


def fresh(code):
    """Run code in a process of its own and return what it prints."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.fixture(scope="module")
def image():
    return image_of(sheet(), spacing=(1.0, 1.5, 1.0))


@pytest.fixture(scope="module")
def flat_map(image):
    return image.voxflat.flatten(sources=60)


# ------------------------------------------------------------------------------------------ images in


@pytest.mark.parametrize("in_cells", [False, True], ids=["points", "cells"])
@pytest.mark.parametrize("place", PLACES.values(), ids=PLACES)
def test_points_lie_where_vtk_has_them(place, in_cells):
    image = image_of(sheet(), in_cells, **place)
    flat_map = image.voxflat.flatten(sources=10)
    centres = image.cell_centers().points if in_cells else image.points
    number = np.ravel_multi_index(tuple(flat_map.ids.T), SHAPE, order="F")
    np.testing.assert_allclose(flat_map.points, centres[number], atol=1e-4)
    assert len(flat_map) == sheet().sum()


@pytest.mark.parametrize("in_cells", [False, True], ids=["points", "cells"])
def test_voxel_at_finds_every_centre(in_cells):
    image = image_of(sheet(), in_cells, **PLACES["rotated"])
    centres = image.cell_centers().points if in_cells else image.points
    for number in (0, 17, 1234, len(centres) - 1):
        assert image.voxflat.voxel_at(centres[number]) == np.unravel_index(number, SHAPE, order="F")
    with pytest.raises(InputError, match="outside the image"):
        image.voxflat.voxel_at((1e3, 0, 0))


@pytest.mark.parametrize("in_cells", [False, True], ids=["points", "cells"])
def test_a_single_slice_of_voxels(in_cells):
    image = pv.ImageData(dimensions=(9 + in_cells, 8 + in_cells, 1), spacing=(1, 1, 3), origin=(0, 0, 5))
    image["mask"] = np.ones(72, dtype=np.uint8)
    flat_map = image.voxflat.flatten(sources=10)
    assert len(flat_map) == 72
    assert set(flat_map.points[:, 2]) == {5.0}


def test_result_is_that_of_voxflat_flatten_on_the_array():
    image = image_of(sheet(), name="other", **PLACES["rotated"])
    image["brain"] = 3 * image["other"] + 1
    affine = image.index_to_physical_matrix.copy()
    affine[:3, 3] = image.points[0]
    options = {"label": 4, "seed_point": (10, 12, 6), "radius": 12.0, "sources": 40, "seed": 5}
    expected = voxflat.flatten(3 * sheet() + 1, affine=affine, **options)
    found = image.voxflat.flatten("brain", **options)
    np.testing.assert_array_equal(found.ids, expected.ids)
    np.testing.assert_allclose(found.uv, expected.uv, atol=1e-6)
    np.testing.assert_array_equal(image.voxflat("brain", **options).points[:, :2], found.uv)


def test_the_volume_is_a_view(image):
    assert np.shares_memory(image.voxflat.volume().data, image["labels"])


@pytest.mark.parametrize("dtype", [bool, np.int64, np.float32, np.uint16])
def test_types_of_labels(dtype):
    assert len(image_of(sheet().astype(dtype)).voxflat.flatten(sources=10)) == sheet().sum()


def test_keep_is_an_array_of_the_image_or_another_image(image):
    half = np.zeros(SHAPE, dtype=np.uint8)
    half[:, :13] = 1
    both = image.copy()
    both["half"] = half.ravel(order="F")
    other = image_of(half, spacing=image.spacing)
    expected = voxflat.flatten(sheet(), spacing=image.spacing, keep=half, sources=20).ids
    for keep in ("half", other, half):
        np.testing.assert_array_equal(both.voxflat.flatten("labels", keep=keep, sources=20).ids, expected)


def test_colours_are_sampled_onto_the_map(image, flat_map):
    colours = image_of(sheet(), spacing=image.spacing)
    colours["rgb"] = np.tile(np.array([10, 20, 30], dtype=np.uint8), (image.n_points, 1))
    pixels = flat_map.image(colours.voxflat.volume("rgb")).data
    assert {tuple(pixel) for pixel in pixels[pixels[..., 3] > 0].tolist()} == {(10, 20, 30, 255)}
    with pytest.raises(InputError, match="one value a voxel"):
        colours.voxflat("rgb")


# -------------------------------------------------------------------------------------------- errors


def test_meshes_are_refused_with_a_remedy():
    with pytest.raises(InputError, match="triangle meshes are not supported yet; give a label volume"):
        pv.Sphere().voxflat()
    ticks = np.arange(4.0)
    grid = pv.RectilinearGrid(ticks, ticks, ticks)
    for mesh in (grid, grid.cast_to_unstructured_grid(), grid.cast_to_structured_grid()):
        with pytest.raises(InputError, match=f"{type(mesh).__name__}: give an ImageData.*resample"):
            mesh.voxflat()


def test_a_wrong_name_lists_the_arrays():
    image = image_of(sheet(), name="left")
    image["right"] = image["left"]
    with pytest.raises(InputError, match="no array 'middle'; the image has the arrays left, right"):
        image.voxflat("middle")
    with pytest.raises(InputError, match="the image has no array"):
        pv.ImageData(dimensions=(3, 3, 3)).voxflat()
    image.set_active_scalars(None)
    with pytest.raises(InputError, match=r"scalars are not given; the image has the arrays left, right"):
        image.voxflat()


def test_arrays_that_are_no_volume_are_refused(image):
    image = image.copy()
    image["vectors"] = np.zeros((image.n_points, 3))
    with pytest.raises(InputError, match="'vectors' has 3 components"):
        image.voxflat("vectors")
    image.cell_data["labels"] = np.zeros(image.n_cells)
    with pytest.raises(InputError, match="both have an array 'labels'"):
        image.voxflat("labels")


def test_refusals_of_flatten_reach_the_user(image):
    with pytest.raises(InputError, match="no voxel has label 7"):
        image.voxflat(label=7)
    with pytest.raises(TypeError, match="unexpected keyword argument 'lable'"):
        image.voxflat(lable=1)


# ----------------------------------------------------------------------------------------- meshes out


def test_polydata_holds_the_map(flat_map):
    mesh = to_polydata(flat_map)
    np.testing.assert_allclose(mesh.points[:, :2], flat_map.uv, atol=1e-4)
    assert (mesh.points[:, 2] == 0).all()
    np.testing.assert_array_equal(mesh.regular_faces, flat_map.faces)
    np.testing.assert_array_equal(mesh.point_data["distortion"], flat_map.distortion.per_point)
    np.testing.assert_array_equal(mesh.point_data["voxel_ids"], flat_map.ids)
    np.testing.assert_array_equal(mesh.point_data["surface_points"], flat_map.points)
    np.testing.assert_array_equal(mesh.cell_data["torn"], flat_map.torn)
    assert mesh.active_scalars_name == "distortion"
    assert (mesh.compute_normals(auto_orient_normals=False)["Normals"][:, 2] > 0.99).all()


def test_surface_polydata_has_the_same_data_in_space(flat_map):
    flat, surface = to_polydata(flat_map), to_surface_polydata(flat_map)
    np.testing.assert_allclose(surface.points, flat_map.points, atol=1e-4)
    np.testing.assert_array_equal(surface.regular_faces, flat.regular_faces)
    assert surface.array_names == flat.array_names


def test_description_survives_a_file(flat_map, tmp_path):
    to_polydata(flat_map).save(tmp_path / "map.vtp")
    for mesh in (to_polydata(flat_map), pv.read(tmp_path / "map.vtp")):
        description = json.loads(mesh.field_data["voxflat"][0])
        assert description["method"] == flat_map.metadata["method"]
        assert description["affine"] == flat_map.metadata["affine"]
        assert description["distortion"]["raw"]["relative_error"] == flat_map.distortion.raw.relative_error
        assert mesh.active_texture_coordinates.shape == (len(flat_map), 2)


@pytest.mark.parametrize("shape", [(64, 64), (40, 90), (90, 40)])
def test_texture_coordinates_lay_a_picture_as_texture_does(flat_map, shape):
    height, width = shape
    rows, columns = np.indices(shape, dtype=np.float64)
    expected = flat_map.texture(np.stack([columns, rows], axis=-1))
    s, t = to_polydata(flat_map, picture_shape=shape).active_texture_coordinates.T
    # pixel centres lie at half-integers of the picture's size; row 0 is the top, where t = 1
    found = np.stack([s * width - 0.5, (1 - t) * height - 0.5], axis=-1).clip(0, [width - 1, height - 1])
    np.testing.assert_allclose(found, expected, atol=1e-9 * max(shape))
    assert min(s.min(), t.min()) >= 0
    assert max(s.max(), t.max()) <= 1


@pytest.mark.skipif(
    sys.platform == "linux" and "DISPLAY" not in os.environ and pv.vtk_version_info < (9, 4),
    reason="this VTK draws only with a display",
)
def test_vtk_draws_the_picture_upright(flat_map):
    picture = np.zeros((64, 64, 3), dtype=np.uint8)
    picture[:32, :, 0] = 255  # red above
    picture[32:, 32:, 2] = 255  # blue at the lower right
    plotter = pv.Plotter(off_screen=True, window_size=[120, 120])
    plotter.add_mesh(to_polydata(flat_map), texture=pv.Texture(picture), lighting=False)
    plotter.view_xy()
    drawn = plotter.screenshot(return_img=True)
    plotter.close()
    assert drawn[45, 50].tolist() == [255, 0, 0]
    assert drawn[75, 70].tolist() == [0, 0, 255]
    assert drawn[75, 50].tolist() == [0, 0, 0]


# -------------------------------------------------------------------------------------- registration


@pytest.mark.skipif(not hasattr(pv, "register_dataset_accessor"), reason="PyVista before 0.48 has no accessors")
def test_entry_point_needs_no_import_of_voxflat():
    code = """
import sys
import numpy as np
import pyvista as pv
assert "voxflat" not in sys.modules
image = pv.ImageData(dimensions=(12, 9, 3))
image["mask"] = (image.points[:, 2] == 1).astype(np.uint8)
print(image.voxflat(sources=9).n_points)
"""
    assert fresh(code) == ["108"]


def test_before_pyvista_0_48_importing_the_module_is_enough():
    code = """
import numpy as np
import pyvista as pv
vars(pv).pop("register_dataset_accessor", None)
import voxflat._pyvista
image = pv.ImageData(dimensions=(12, 9, 3))
image["mask"] = (image.points[:, 2] == 1).astype(np.uint8)
print(type(vars(pv.DataSet)["voxflat"]).__name__, image.voxflat(sources=9).n_points)
"""
    assert fresh(code) == ["property", "108"]


def test_importing_voxflat_imports_no_front_end():
    code = """
import sys
import voxflat
print(*({"pyvista", "vtkmodules", "matplotlib", "napari", "itk", "nibabel"} & set(sys.modules)))
"""
    assert fresh(code) == []
