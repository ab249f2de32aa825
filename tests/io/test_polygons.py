"""Polygons and strips become triangles with the same corners that cover the same area, as VTK computes it."""

import numpy as np
import pytest
from mesh_files import pv

from voxflat.errors import InputError
from voxflat.io.meshes import read_mesh
from voxflat.io.triangles import triangulated

_SHAPES = {
    "dart": [(0, 0), (4, -3), (1, 0), (4, 3)],
    "arrow": [(4, 3), (0, 0), (4, -3), (1, 0)],
    "kite": [(0, 0), (1, -1), (9, 0), (1, 1)],
    "comb": [(0, 0), (9, 0), (9, 5), (7, 5), (7, 1), (5, 1), (5, 5), (3, 5), (3, 1), (1, 1), (1, 5), (0, 5)],
    "star": [((2 + 3 * (k % 2)) * np.cos(k * np.pi / 7), (2 + 3 * (k % 2)) * np.sin(k * np.pi / 7)) for k in range(14)],
    "with a corner on a side": [(0, 0), (2, 0), (4, 0), (4, 4), (0, 4)],
}
XYZ = "".join(f"property float {axis}\n" for axis in "xyz")


@pytest.mark.parametrize("name", _SHAPES)
def test_no_triangle_lies_outside_its_polygon(name):
    shape = np.asarray(_SHAPES[name], dtype=float)
    (x, y), (u, v) = shape.T, np.roll(shape, -1, axis=0).T
    area = 0.5 * abs(np.sum(x * v - y * u))
    for turn in range(len(shape)):
        for way in (1, -1):
            flat = np.roll(shape, turn, axis=0)[::way]
            tilt = np.linalg.qr(np.random.default_rng(turn).normal(size=(3, 3)))[0]
            tilt *= np.sign(np.linalg.det(tilt))
            points = np.column_stack([flat, np.zeros(len(flat))]) @ tilt.T
            triangles, warnings = triangulated(points, np.arange(len(points)), np.array([len(points)]))
            assert len(triangles) == len(points) - 2
            assert warnings == (f"polygons were split into triangles (1 with {len(points)} corners)",)
            a, b, c = np.moveaxis(points[triangles], 1, 0)
            signed = 0.5 * np.cross(b - a, c - a) @ tilt[:, 2] * way
            assert (signed > -1e-12).all()
            assert signed.sum() == pytest.approx(area)


def test_the_shorter_diagonal_is_taken_and_the_same_whichever_corner_is_first():
    kite = np.array([(0, 0, 0), (1, -1, 0), (9, 0, 0), (1, 1, 0)], dtype=float)
    for turn in range(4):
        points = np.roll(kite, turn, axis=0)
        triangles, _ = triangulated(points, np.arange(4), np.array([4]))
        assert np.ptp(points[sorted(set(triangles[0]) & set(triangles[1])), 0]) == 0
    with pytest.raises(InputError, match=r"face 1 has 1001 corners\. Triangulate it first"):
        triangulated(kite, np.zeros(1004, dtype=int), np.array([3, 1001]))


@pytest.mark.parametrize("ending", ["obj", "ply", "vtp", "vtk"])
def test_files_of_polygons(ending, tmp_path):
    solid = pv.Cylinder(resolution=6, height=4.0, radius=3.0).clean()  # quadrilaterals and hexagons around a volume
    path, faces = tmp_path / f"s.{ending}", solid.irregular_faces
    if ending == "ply":
        head = f"ply\nformat binary_big_endian 1.0\nelement vertex {solid.n_points}\n{XYZ}element face {len(faces)}\n"
        head += "property uchar flag\nproperty list uchar int vertex_indices\nend_header\n"
        rows = b"".join(b"\1" + bytes([len(face)]) + np.asarray(face, ">i4").tobytes() for face in faces)
        path.write_bytes(head.encode() + np.asarray(solid.points, ">f4").tobytes() + rows)
    elif ending == "obj":
        lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in solid.points.astype(float).tolist()]
        path.write_text("\n".join([*lines, *(f"f {' '.join(str(v + 1) for v in face)}" for face in faces), ""]))
    else:
        solid.save(path)
    read = read_mesh(path)
    np.testing.assert_allclose(read.points, solid.points, atol=1e-6)
    assert len(read.faces) == sum(len(face) - 2 for face in faces)
    assert read.warnings == ("polygons were split into triangles (6 with 4 corners, 2 with 6 corners)",)
    # VTK's own triangles have the same area and volume
    ours, theirs = pv.PolyData.from_regular_faces(read.points, read.faces), solid.triangulate()
    assert (ours.area, ours.volume) == pytest.approx((theirs.area, theirs.volume))
    assert ours.n_open_edges == 0


@pytest.mark.parametrize("ending", ["ply", "vtp", "vtk"])
def test_files_of_strips(ending, tmp_path):
    strips = pv.Sphere(theta_resolution=12, phi_resolution=9).strip()
    path = tmp_path / f"s.{ending}"
    if ending == "ply":
        numbers, at = [], 0
        while at < len(strips.strips):
            numbers += [*strips.strips[at + 1 : at + 1 + strips.strips[at]].tolist(), -1]
            at += 1 + strips.strips[at]
        head = f"ply\nformat ascii 1.0\nelement vertex {strips.n_points}\n{XYZ}element tristrips 1\n"
        rows = [" ".join(map(repr, row)) for row in [*strips.points.astype(float).tolist(), [len(numbers), *numbers]]]
        path.write_text("\n".join([f"{head}property list int int vertex_indices\nend_header", *rows, ""]))
    else:
        strips.save(path)
    read = read_mesh(path)
    triangles = strips.triangulate()
    ours = pv.PolyData.from_regular_faces(read.points, read.faces)
    assert len(read.faces) == triangles.n_cells
    assert f"were split into {len(read.faces)} triangles" in read.warnings[-1]
    assert ours.volume == pytest.approx(triangles.volume)
    assert ours.n_open_edges == triangles.n_open_edges == 0


def test_texture_coordinates_of_polygons_stay_with_their_corners(tmp_path):
    path = tmp_path / "s.obj"
    path.write_text("v 0 0 0\nv 9 0 0\nv 9 9 0\nv 0 9 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf -4/1 -3/2 -2/3 -1/4\n")
    read = read_mesh(path)
    assert len(read.faces) == 2
    np.testing.assert_array_equal(read.texture_coordinates, read.points[:, :2] / 9)
