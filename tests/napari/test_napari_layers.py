"""Conversion of layers to volumes, meshes and seed points, in mm and RAS+."""

import nibabel as nib
import numpy as np
import pytest
from napari.layers import Image, Labels, Points, Surface
from napari_window import AFFINE, bumps, cap, click_middle, wait_until_drawn
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused

import voxflat
from voxflat._napari.layers.meshes import LayerMesh
from voxflat._napari.layers.sampled import overlay
from voxflat._napari.layers.seed import describe, first_vertex, first_voxel, nearest_vertex, seed_of, voxel_at
from voxflat._napari.layers.volumes import LayerVolume
from voxflat._napari.layers.world import WORLDS
from voxflat.io import Mesh

TRANSFORMS = [
    {},
    {"scale": (2, 0.5, 1), "translate": (5, -3, 8)},
    {"scale": (-1, 2, 1), "rotate": (20, 30, 40), "translate": (1, 2, 3)},
    {"affine": AFFINE},
    {"affine": AFFINE, "scale": (2, 2, 2), "translate": (1, 0, -4)},
]


@pytest.mark.parametrize("transform", TRANSFORMS)
@pytest.mark.parametrize("kind", [Image, Labels])
def test_affine_agrees_with_the_layer(kind, transform):
    layer = kind(np.ones((5, 6, 7), dtype=np.uint8), **transform)
    affine = LayerVolume.of(layer).place.affine
    for voxel in np.random.default_rng(0).uniform(-5, 9, (10, 3)):
        assert_allclose(affine[:3, :3] @ voxel + affine[:3, 3], layer.data_to_world(voxel), atol=1e-9)


def test_units_become_millimetres_except_micrometres():
    data = np.ones((4, 4, 4))
    microns = LayerVolume.of(Image(data, scale=(250, 250, 500), translate=(1000, 0, 0), units="micrometer"))
    assert_allclose(microns.read().affine, [[250, 0, 0, 1000], [0, 250, 0, 0], [0, 0, 500, 0], [0, 0, 0, 1]])
    assert (microns.origin["unit"], microns.read().unit) == ("micrometer", "µm")
    for units, size in (("cm", 10.0), (("mm", "um", "um"), 1.0)):
        other = LayerVolume.of(Image(data, scale=(1, 1, 1) if units == "cm" else (1, 1000, 1000), units=units))
        assert_allclose(other.read().affine, np.diag([size, size, size, 1]))
        assert other.read().unit == "mm"
    pixels = LayerVolume.of(Image(data))
    assert_allclose(pixels.place.affine, np.eye(4))
    assert "taken as mm" in pixels.origin["unit"]
    points, faces, _ = bumps(4)
    mesh = LayerMesh.of(Surface((points, faces), scale=(250, 250, 500), translate=(1000, 0, 0), units="micrometer"))
    assert_allclose(mesh.read().points, points * [250, 250, 500] + [1000, 0, 0])
    assert mesh.place.unit == "µm"
    assert_array_equal(LayerMesh.of(Surface((points, faces))).read().points, points)
    for of, layer in ((LayerVolume, Image(data)), (LayerMesh, Surface((points, faces)))):
        layer.units = ("second", "mm", "mm")
        refused("second", of.of, layer)


@pytest.mark.parametrize("world", WORLDS)
def test_world_axes_agree_with_nibabel(world):
    affine = LayerVolume.of(Image(np.ones((4, 4, 4)), scale=(1, 2, 3), translate=(5, 6, 7)), world).place.affine
    assert nib.aff2axcodes(affine) == tuple(world)
    assert_allclose(np.linalg.norm(affine[:3, 3]), np.linalg.norm((5, 6, 7)))


def test_wrong_world_axes_mirror_the_map_and_right_ones_do_not():
    labels = np.maximum.accumulate(cap()[:, :, ::-1], axis=2)[
        :, :, ::-1
    ]  # a solid hill, which unlike a surface of one voxel has an outside
    top = np.array([12, 8, np.flatnonzero(labels[12, 8])[-1]])
    reverse = [2, 1, 0]
    lps = np.diag([-1.0, -1, 1, 1]) @ AFFINE
    itk = np.eye(4)  # as ITK's readers give it: axes k, j, i in the world z, y, x of LPS
    itk[:3, :3], itk[:3, 3] = lps[:3, :3][np.ix_(reverse, reverse)], lps[reverse, 3]

    def map_of(layer, world, order):
        disk = voxflat.surface(LayerVolume.of(layer, world).read()).disk(top[order].tolist(), 20)
        flat = disk.flatten(voxflat.methods.Voxflat(sources=200))
        return flat.uv[np.lexsort(flat.ids[:, order].T)] - flat.uv.mean(axis=0)

    expected = map_of(Labels(labels, affine=AFFINE), "RAS", [0, 1, 2])
    right = map_of(Labels(labels.T, affine=itk), "SPL", reverse)
    wrong = map_of(Labels(labels.T, affine=itk), "RAS", reverse)
    assert np.linalg.det(expected.T @ right) > 0
    assert np.linalg.det(expected.T @ wrong) < 0


@pytest.mark.parametrize(
    ("colours", "expected"), [(np.full((4, 4, 4, 3), 0.5, np.float32), 128), (np.full((4, 4, 4, 4), 51, np.uint8), 51)]
)
def test_colours_become_bytes(colours, expected):
    data = LayerVolume.of(Image(colours, rgb=True)).read().data
    assert data.dtype == np.uint8
    assert (data == expected).all()


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("transform", TRANSFORMS)
def test_vertices_agree_with_the_layer_and_outside_stays_outside(transform, world):
    points, faces, values = bumps(6)
    mesh = LayerMesh.of(Surface((points, faces, values), **transform), world)
    to_ras = LayerVolume.of(Image(np.ones((4, 4, 4)), **transform), world).place.affine
    read = mesh.read()
    assert_allclose(read.points, points @ to_ras[:3, :3].T + to_ras[:3, 3], atol=1e-9)
    above = (points + np.array([0, 0, 0.1])) @ to_ras[:3, :3].T + to_ras[:3, 3]
    a, b, c = read.points[read.faces].transpose(1, 0, 2)
    assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), above[read.faces[:, 0]] - a) > 0).all()
    assert mesh.origin["world_axes"] == world


def test_the_layer_keeps_the_hemisphere_and_space_of_its_file(tmp_path):
    """Maps then have their legend, and files of the other hemisphere are refused."""
    points, faces, _ = bumps(4)
    named = {"units": "mm", "metadata": {"surface_file": str(tmp_path / "rh.white")}}
    read = LayerMesh.of(Surface((points, faces), **named)).read()
    assert (read.structure, read.space.name) == ("CortexRight", "scanner")
    told = LayerMesh.of(Surface((points, faces), units="mm", metadata={"structure": "CortexLeft"})).read()
    assert told.structure == "CortexLeft"
    unknown = LayerMesh.of(Surface((points, faces), metadata={"structure": 7})).read()  # pixels
    assert (unknown.structure, unknown.space.name) == (None, "unknown")


def test_kept_are_vertices_with_a_value():
    points, faces, values = bumps(4)
    values[:] = 0
    refused("are 0 or NaN. Choose another part", LayerMesh.of(Surface((points, faces, values))).kept)
    values[:3] = (2, np.nan, -1)
    assert np.flatnonzero(LayerMesh.of(Surface((points, faces, values))).kept()).tolist() == [0, 2]


def test_seed_is_the_selected_point_or_the_last():
    layer = Labels(cap(), affine=AFFINE, units="mm")
    world = np.array([[3, 4, 5], [6, 7, 8]]) @ AFFINE[:3, :3].T + AFFINE[:3, 3]
    points = Points(world, units="mm")
    points.selected_data = set()
    assert seed_of(points, layer) == (6, 7, 8)
    points.selected_data = {0}
    assert seed_of(points, layer) == (3, 4, 5)
    assert seed_of(Points(world * 1000, units="micrometer"), layer) == (6, 7, 8)
    assert seed_of(Points(ndim=3), layer) is None
    layer = Labels(cap(24))
    assert voxel_at(layer, (23.4, 0, 0)) == (23, 0, 0)
    assert voxel_at(layer, (23.6, 0, 0)) is None


def test_ray_meets_the_first_voxel_of_the_foreground():
    data = np.zeros((9, 9, 9), dtype=np.uint8)
    data[4, 4, 3:6] = 2
    start, end = np.array([4.0, 4, -0.5]), np.array([4.0, 4, 8.5])
    for label, ends, voxel in ((2, (start, end), (4, 4, 3)), (2, (end, start), (4, 4, 5)), (1, (start, end), None)):
        assert first_voxel(Labels(data), *ends, lambda values, label=label: values == label) == voxel


def test_seed_of_a_mesh_is_the_nearest_vertex_in_use():
    points, faces, _ = bumps()
    points = np.vstack([points, [[10.0, 10, 50]]])  # no face has it
    layer = Surface((points, faces), affine=AFFINE, units="mm")
    world = points @ AFFINE[:3, :3].T + AFFINE[:3, 3]
    cursor = Points(world[[40, 300]] * 1000 + [100, -200, 50], units="micrometer")
    cursor.selected_data = {0}
    assert seed_of(cursor, layer) == 40
    cursor.selected_data = set()
    assert seed_of(cursor, layer) == 300
    assert describe(cursor, layer) == "vertex 300, 0.2 mm away"
    cursor.data = world[[300]] * 1000
    assert describe(cursor, layer) == "vertex 300"
    assert describe(Points(ndim=3), layer) == "no point within the layer"
    assert nearest_vertex(layer, world[-1]) != len(points) - 1
    assert seed_of(Points(ndim=3), layer) is None
    assert seed_of(Points(ndim=2), layer) is None


def test_ray_meets_the_first_triangle():
    points, faces, _ = bumps()
    both = Surface((np.vstack([points, points + np.array([0, 0, 30])]), np.vstack([faces, faces + len(points)])))
    from_above = np.array([[20.1, 16.2, 60.0], [20.1, 16.2, -60.0]])
    assert first_vertex(both, *from_above) == 10 * 25 + 8 + len(points)
    assert first_vertex(both, *from_above[::-1]) == 10 * 25 + 8
    assert first_vertex(both, np.array([-9.0, 0, 60]), np.array([-9.0, 0, -60])) is None


def test_click_on_a_mesh_sets_the_seed(open_widget, qtbot):
    points, faces, _ = bumps()
    viewer, widget = open_widget(Surface((points, faces), scale=(1, 2, 1), name="bumps"), show=True)
    assert viewer.dims.ndisplay == 2
    widget.form.seed.pick.click()
    assert viewer.dims.ndisplay == 3  # in a slice there is nothing to click on
    camera = getattr(viewer, "scene", viewer).camera
    camera.set_view_direction(view_direction=(0.1, 0.1, -1), up_direction=(0, -1, 0))
    camera.center = np.array(points[12 * 25 + 12]) * (1, 2, 1)
    wait_until_drawn(viewer, qtbot)
    click_middle(viewer.window._qt_viewer.canvas.native, qtbot)
    assert widget.form.seed.point == 12 * 25 + 12
    assert_allclose(viewer.layers["seed point"].data, points[[12 * 25 + 12]])
    viewer.layers["seed point"].data = points[[100]] + 0.3
    assert widget.form.seed.point == 100


@pytest.mark.parametrize("ndisplay", [2, 3])
def test_click_sets_the_seed(open_widget, qtbot, ndisplay):
    labels = np.zeros((20, 20, 20), dtype=np.uint8)
    labels[5:15] = 1
    viewer, widget = open_widget(Labels(labels, scale=(1, 2, 2)), show=True)
    layer = viewer.layers[0]
    viewer.dims.ndisplay = ndisplay
    viewer.dims.set_point(0, 7)
    viewer.reset_view()
    layer.mode = "paint"
    painted = labels.copy()
    wait_until_drawn(viewer, qtbot)
    widget.form.seed.pick.click()
    click_middle(viewer.window._qt_viewer.canvas.native, qtbot)
    i, j, k = widget.form.seed.point
    assert i in ((7,) if ndisplay == 2 else (5, 14))  # in 3D the surface
    assert abs(j - 9.5) <= 1
    assert abs(k - 9.5) <= 1
    assert not widget.form.seed.pick.isChecked()
    assert_array_equal(layer.data, painted)
    assert viewer.layers["seed point"].data.tolist() == [[i, j, k]]
    viewer.layers.remove("seed point")
    assert widget.form.seed.point is None


def test_values_of_the_other_hemisphere_are_not_shown_on_a_map():
    points, faces = voxflat.samples.hill().points, voxflat.samples.hill().faces
    left, right = (Mesh(points, faces, structure=side) for side in ("CortexLeft", "CortexRight"))
    layer = Surface((points, faces, points[:, 2]), units="mm", name="depth", metadata={"structure": "CortexRight"})
    values = overlay(layer, LayerMesh.of(layer))
    message = "Layer 'depth': belongs to the right hemisphere, but the map belongs to the left one"
    refused(message, values.image, voxflat.flatten(left), 1.0)
    assert np.isfinite(values.image(voxflat.flatten(right), 1.0).data).any()
