"""Meshes are the same after writing and reading them; checks of `Mesh`; files with real data."""

import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from mesh_files import FLOAT32, FORMATS, fast, fsaverage5, grid, nib, refuses, same, sphere
from refusals import refused

from voxflat.io.meshes import Mesh, holds_mesh, read_mesh, write_mesh
from voxflat.io.overlays import read_overlay, read_region


@st.composite
def meshes(draw):
    n = draw(st.integers(3, 12))
    points = draw(npst.arrays(np.float64, (n, 3), elements=st.floats(-1e4, 1e4)))
    faces = draw(npst.arrays(np.int64, (draw(st.integers(1, 9)), 3), elements=st.integers(0, n - 1)))
    texture = draw(st.none() | npst.arrays(np.float64, (n, 2), elements=st.floats(0, 1)))
    return Mesh(points, faces, texture_coordinates=texture)


@pytest.mark.parametrize("name", FORMATS)
@fast
@given(mesh=meshes())
def test_round_trip(tmp_path, name, mesh):
    path = tmp_path / name
    write_mesh(path, mesh)
    read = read_mesh(path)
    expected = Mesh(mesh.points.astype(np.float32), mesh.faces) if name in FLOAT32 else mesh
    same(read, expected, 5e-9 if name == "s.obj" else 0)
    assert read.path == path
    if name not in FLOAT32 and mesh.texture_coordinates is not None:
        used = np.unique(mesh.faces) if name == "s.obj" else np.arange(len(mesh.points))
        np.testing.assert_allclose(read.texture_coordinates[used], mesh.texture_coordinates[used], rtol=5e-9)
    assert [file.name for file in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("dtype", ["u1", "u4", ">i4", "i8", "u8"])
def test_types_of_faces(tmp_path, name, dtype):
    write_mesh(tmp_path / name, Mesh(grid().points.astype(">f4"), grid().faces.astype(dtype)))
    same(read_mesh(tmp_path / name), grid())


def test_vtp_keeps_values(tmp_path):
    data = {"thickness": np.arange(42.0), "is wall": np.arange(42) % 2 == 0, "rgb": np.ones((42, 3), np.uint8)}
    write_mesh(tmp_path / "s.vtp", sphere(point_data=data))
    read = read_mesh(tmp_path / "s.vtp")
    assert set(read.point_data) == set(data)
    for name, values in data.items():
        np.testing.assert_array_equal(read.point_data[name], values)


@pytest.mark.parametrize("folder", ["with spaces", "größe 脳 %20 #1", "-o"])
@pytest.mark.parametrize("name", FORMATS)
def test_odd_names(tmp_path, folder, name):
    (tmp_path / folder).mkdir()
    path = tmp_path / folder / name
    write_mesh(path, sphere())
    same(read_mesh(str(path)), read_mesh(path))


def test_structures(tmp_path):
    def again(name, structure=None):
        write_mesh(tmp_path / name, sphere(structure=structure))
        return read_mesh(tmp_path / name).structure

    assert again("s.surf.gii", "CortexRight") == again("lh.s.surf.gii", "CortexRight") == "CortexRight"
    assert (again("lh.s.surf.gii"), again("rh.pial"), again("s.surf.gii")) == ("CortexLeft", "CortexRight", None)


@pytest.mark.parametrize(
    ("mesh", "geometry", "topology"),
    [(sphere(), "Anatomical", "Closed"), (grid(), "Flat", "Cut"), (grid(z=1.0), "Anatomical", "Open")],
)
def test_gifti_says_what_it_holds(tmp_path, mesh, geometry, topology):
    write_mesh(tmp_path / "s.surf.gii", mesh)
    points, triangles = nib.load(tmp_path / "s.surf.gii").darrays
    assert points.meta["GeometricType"] == geometry
    assert triangles.meta["TopologicalType"] == topology
    assert (points.data.dtype, triangles.data.dtype) == (np.float32, np.int32)


def test_what_cannot_be_written(tmp_path):
    stl = "ending '.stl'. Use one of .surf.gii, .vtp, .ply, .obj, or a FreeSurfer name"
    told = {"s.stl": stl, "s.vtk": "unknown", "s.gii": "unknown", "lh.white.stl": "unknown"}
    for name, message in {**told, "lh.cortex.patch.flat": "has the name of a patch"}.items():
        refused(message, write_mesh, tmp_path / name, sphere())
    with pytest.raises(FileNotFoundError, match=r"s\.ply"):
        write_mesh(tmp_path / "missing" / "s.ply", sphere())
    half = Mesh(grid().points, grid().faces, texture_coordinates=np.where(np.eye(16, 2) > 0, np.nan, 0))
    refuses(tmp_path / "s.obj", "point 0 has no texture coordinate", write_mesh, half)
    assert not any(tmp_path.iterdir())


def test_bad_arrays():
    zeros, face = np.zeros((3, 3)), [[0, 1, 2]]
    refused("no points", Mesh, np.zeros((0, 3)), np.zeros((0, 3), int))
    refused("no faces", Mesh, zeros, np.zeros((0, 3), int))
    refused(r"points have type float64 and shape \(3, 2\)", Mesh, np.zeros((3, 2)), face)
    refused("points have type complex128", Mesh, zeros.astype(complex), face)
    refused(r"shape \(1, 4\)", Mesh, zeros, [[0, 1, 2, 0]])
    refused("faces have data type float64", Mesh, zeros, [[0.0, 1, 2]])
    refused(r"face 1 is \[0, 1, 3\], but the surface has points 0 to 2", Mesh, zeros, [[0, 1, 2], [0, 1, 3]])
    refused(r"face 0 is \[0, 1, -1\]", Mesh, zeros, [[0, 1, -1]])
    refused("face 0 is", Mesh, zeros, np.array([[0, 1, 2**64 - 1]], np.uint64))
    refused(r"point 2, \[0.0, 0.0, inf\], lies beyond", Mesh, [[0, 0, 0], [0, np.nan, 0], [0, 0, np.inf]], face)
    refused("point 2, .* lies beyond", Mesh, [[0, 0, 0], [0, 0, 0], [0, 0, -np.inf]], face)
    arrays, three = (grid().points, grid().faces), np.zeros((3, 2))
    refused(r"have shape \(3, 2\) instead of \(16, 2\)", Mesh, *arrays, texture_coordinates=three)
    refused("point data 'curv' has 3 values, but the surface has 16 points", Mesh, *arrays, point_data={"curv": three})


def test_the_content_of_a_file_defines_its_unit(tmp_path):
    write_mesh(tmp_path / "a.ply", sphere())
    (tmp_path / "a.ply").rename(tmp_path / "scan.dat")
    assert read_mesh(tmp_path / "scan.dat").unit == "unknown"
    write_mesh(tmp_path / "a.surf.gii", sphere())
    (tmp_path / "a.surf.gii").rename(tmp_path / "scan.dat")
    assert read_mesh(tmp_path / "scan.dat").unit == "mm"


def test_suspicious_units(tmp_path):
    assert Mesh(sphere().points, sphere().faces).unit_warning is None
    warning = "is 0.17 units across; coordinates are assumed to be in mm. If they are in metres, multiply them by 1000"
    assert Mesh(sphere().points * 0.0017, sphere().faces).unit_warning == warning
    write_mesh(tmp_path / "s.ply", Mesh(sphere().points * 0.0017, sphere().faces))
    assert read_mesh(tmp_path / "s.ply").warnings == (warning,)


def test_missing_packages_are_named(tmp_path, monkeypatch):
    write_mesh(tmp_path / "s.vtp", sphere())
    for package in ("pyvista", "vtkmodules"):
        monkeypatch.setitem(sys.modules, package, None)
    refuses(tmp_path / "s.vtp", r"pip install 'voxflat\[pyvista\]'")
    refuses(tmp_path / "s.vtp", r"pip install 'voxflat\[pyvista\]'", write_mesh, sphere())


@pytest.mark.slow
def test_fsaverage5():
    white, pial, flat = (read_mesh(fsaverage5(name)) for name in ("white_left", "pial_left", "flat_left"))
    points, faces = (array.data for array in nib.load(fsaverage5("white_left")).darrays)
    np.testing.assert_array_equal(white.points, points)
    np.testing.assert_array_equal(white.faces, faces)
    assert (white.structure, pial.structure, flat.structure) == ("CortexLeft",) * 3
    assert white.warnings == ()
    assert read_overlay(fsaverage5("sulc_left"), len(points)).shape == (10242,)
    assert [holds_mesh(fsaverage5(name)) for name in ("white_left", "sulc_left")] == [True, False]
    # the flat map excludes the medial wall, but its file contains all points
    assert [read_region(fsaverage5(name), len(points)).sum() for name in ("white_left", "flat_left")] == [10242, 9465]
