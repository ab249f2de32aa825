"""Sizes that are too large, too small or too uneven are refused in every interface; others give valid maps."""

import hard_shapes
import meshio
import numpy as np
import pytest
from command_line import run
from refusals import refused

import voxflat
from voxflat import io
from voxflat.methods import Grossmann2002, Voxflat

SHEET = np.ones((9, 9, 1), np.uint8)
BEYOND = [1e19, 1e107, 1e-30, 1e-12]


def mesh(size=1.0):
    points, faces = hard_shapes.sheet(lambda u, v: (u, v, np.sin(u) * np.cos(v)), (6, 5), (7, 6))
    return size * points, faces


INTERFACES = {
    "mesh": lambda size, path: voxflat.flatten(mesh(size), method=Voxflat(sources=9)),
    "spacing": lambda size, path: voxflat.surface(SHEET, spacing=(size,) * 3).flatten(Voxflat(sources=9)),
    "affine": lambda size, path: voxflat.surface(SHEET, affine=np.diag([size] * 3 + [1])).flatten(Voxflat(sources=9)),
    "the paper's": lambda size, path: voxflat.surface(SHEET, spacing=(size,) * 3).flatten(Grossmann2002(sources=9)),
    "range image": lambda size, path: voxflat.range_image(np.zeros((5, 5)), size),
    "rows": lambda size, path: voxflat.surface(mesh(size)).geodesic(3),
    "patches": lambda size, path: voxflat.surface(mesh(size)).patches(bound=1.5),
    "path": lambda size, path: voxflat.surface(mesh(size)).path(0, 9),
    "pial": lambda size, path: voxflat.surface(mesh(), pial=mesh(size)),
    "ply": lambda size, path: voxflat.surface(ply(path, size)),
}


def ply(path, size):
    points, faces = mesh(size)
    meshio.Mesh(points, [("triangle", faces.astype("i4"))]).write(path / "m.ply")
    return path / "m.ply"


@pytest.mark.parametrize(
    ("door", "size"),
    # the midway surface of a pial surface of size 0 is half of the white surface
    [(door, size) for door in INTERFACES for size in BEYOND if door != "pial" or size > 1],
)
def test_what_is_beyond_the_range_is_refused_at_every_door(tmp_path, door, size):
    refused("mm", INTERFACES[door], size, tmp_path)


@pytest.mark.parametrize("door", ["mesh", "spacing", "the paper's"])
@pytest.mark.parametrize("size", [1e-9, 1e-6, 1e7, 1e10])
def test_within_the_range_maps_are_maps(tmp_path, door, size):
    found = INTERFACES[door](size, tmp_path)
    assert np.isfinite(found.uv).all()
    assert found.distortion.raw.relative_error < 0.3
    assert np.ptp(found.uv) == pytest.approx(size * np.ptp(INTERFACES[door](1.0, tmp_path).uv), rel=0.1)


def test_a_globe_of_the_size_of_pyvistas_is_mapped_and_keeps_its_texture_coordinates_apart():
    pv = pytest.importorskip("pyvista")
    globe = pv.Sphere(radius=6.371e9, theta_resolution=20, phi_resolution=20, end_phi=120)
    globe.active_texture_coordinates = globe.points[:, :2] / 1.3e10 + 0.5
    globe.point_data["Texture Coordinates"] = globe.active_texture_coordinates
    globe.point_data.active_texture_coordinates_name = "Texture Coordinates"
    flat = globe.voxflat()
    assert flat.GetPointData().GetTCoords().GetName() == "mesh_Texture Coordinates"
    assert "Texture Coordinates" in flat.point_data  # those of the map


def test_a_volume_whose_far_corner_lies_beyond_is_refused():
    with pytest.raises(
        voxflat.InputError, match=r"voxel \[8, 0, 0\] of the volume is at .* more than 1e11 mm from the origin"
    ):
        voxflat.surface(SHEET, spacing=(2e10, 1e10, 1e10)).flatten(Voxflat(sources=9))


def test_the_edges_that_are_too_short_are_named():
    points, faces = mesh()
    points[8] = points[7] + [1e-12, 1e-13, 2e-13]
    with pytest.raises(voxflat.InputError, match=r"the edge between vertices 7 and 8 is 1\.\d+e-12 mm long"):
        voxflat.surface((points, faces), repair="none")


def test_json_holds_numbers_or_is_refused(tmp_path):
    io.write_volume(tmp_path / "v.nii.gz", SHEET, np.diag([1e-8, 1e-8, 1e-8, 1]))
    done = run("check", tmp_path / "v.nii.gz", "--label", "1", "--json")
    assert "NaN" not in done.output
    assert "Infinity" not in done.output
