import gzip
import os
import shutil
import struct
import subprocess
import sys
import warnings
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from mesh_files import FLOAT32, FORMATS, fast, fsaverage5, gifti, grid, needs_workbench, nib, pv, refuses, same, sphere

from voxflat.errors import InputError
from voxflat.io import gifti as _gifti
from voxflat.io.meshes import Mesh, holds_mesh, read_mesh, suspicious_units, write_mesh
from voxflat.io.overlays import read_overlay, read_region


@st.composite
def meshes(draw):
    n = draw(st.integers(3, 12))
    points = draw(npst.arrays(np.float64, (n, 3), elements=st.floats(-1e4, 1e4)))
    shape = (draw(st.integers(1, 9)), 3)
    faces = draw(npst.arrays(np.int64, shape, elements=st.integers(0, n - 1)))
    texture = draw(st.none() | npst.arrays(np.float64, (n, 2), elements=st.floats(0, 1)))
    return Mesh(points, faces, texture_coordinates=texture)


# -------------------------------------------------------------------------------------- round trips


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
    mesh = Mesh(grid().points.astype(">f4"), grid().faces.astype(dtype))
    write_mesh(tmp_path / name, mesh)
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
    for name, given_one, read in [
        ("s.surf.gii", "CortexRight", "CortexRight"),
        ("lh.s.surf.gii", "CortexRight", "CortexRight"),
        ("lh.s.surf.gii", None, "CortexLeft"),
        ("rh.pial", None, "CortexRight"),
        ("s.surf.gii", None, None),
    ]:
        write_mesh(tmp_path / name, sphere(structure=given_one))
        assert read_mesh(tmp_path / name).structure == read


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


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("s.stl", "ending '.stl' is unknown; .surf.gii, .vtp, .ply, .obj can be written"),
        ("s.vtk", "unknown"),
        ("s.gii", "unknown"),
        ("lh.white.stl", "unknown"),
        ("lh.cortex.patch.flat", "use write_patch"),
    ],
)
def test_what_cannot_be_written(tmp_path, name, message):
    with pytest.raises(InputError, match=message):
        write_mesh(tmp_path / name, sphere())
    with pytest.raises(FileNotFoundError, match=r"s\.ply"):
        write_mesh(tmp_path / "missing" / "s.ply", sphere())
    assert not any(tmp_path.iterdir())


def test_values_that_a_format_cannot_hold(tmp_path):
    far = Mesh(np.array([[0, 0, 0], [1, 0, 0], [0, 1e39, 0]]), [[0, 1, 2]])
    for name in FLOAT32:
        refuses(tmp_path / name, "point 2 lies at .*too far", write_mesh, far)
    half = Mesh(grid().points, grid().faces, texture_coordinates=np.where(np.eye(16, 2) > 0, np.nan, 0))
    refuses(tmp_path / "s.obj", "point 0 has no texture coordinate", write_mesh, half)
    assert not any(tmp_path.iterdir())


def test_a_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    for name in FORMATS:
        write_mesh(tmp_path / name, grid())
    monkeypatch.setattr(pv.PolyData, "save", lambda *_: 1 / 0)
    monkeypatch.setattr(nib.freesurfer, "write_geometry", lambda *_, **__: 1 / 0)
    monkeypatch.setattr(_gifti, "surface_bytes", lambda *_: 1 / 0)
    monkeypatch.setattr(np, "savetxt", lambda *_: 1 / 0)
    monkeypatch.setattr(np, "empty", lambda *_: 1 / 0)
    for name in FORMATS:
        refuses(tmp_path / name, "division by zero: can this format hold it", write_mesh, sphere())
    monkeypatch.undo()
    for name in FORMATS:
        same(read_mesh(tmp_path / name), grid())
    assert len(list(tmp_path.iterdir())) == len(FORMATS)


# -------------------------------------------------------------------------------------------- Mesh


@pytest.mark.parametrize(
    ("points", "faces", "message"),
    [
        (np.zeros((0, 3)), np.zeros((0, 3), int), "no points"),
        (np.zeros((3, 3)), np.zeros((0, 3), int), "no faces"),
        (np.zeros((3, 2)), [[0, 1, 2]], r"points are float64 of shape \(3, 2\)"),
        (np.zeros((3, 3), complex), [[0, 1, 2]], "points are complex128"),
        (np.zeros((3, 3)), [[0, 1, 2, 0]], r"shape \(1, 4\)"),
        (np.zeros((3, 3)), [[0.0, 1, 2]], "faces are float64"),
        (np.zeros((3, 3)), [[0, 1, 2], [0, 1, 3]], r"face 1 is \[0, 1, 3\]; the surface has the points 0 to 2"),
        (np.zeros((3, 3)), [[0, 1, -1]], r"face 0 is \[0, 1, -1\]"),
        (np.zeros((3, 3)), np.array([[0, 1, 2**64 - 1]], np.uint64), "face 0 is"),
        ([[0, 0, 0], [0, np.nan, 0], [0, 0, np.inf]], [[0, 1, 2]], r"point 1 lies at \[0.0, nan, 0.0\]"),
        ([[0, 0, 0], [0, 0, 0], [0, 0, -np.inf]], [[0, 1, 2]], "point 2 lies at"),
    ],
)
def test_bad_arrays(points, faces, message):
    with pytest.raises(InputError, match=message):
        Mesh(points, faces)


def test_bad_data():
    with pytest.raises(InputError, match=r"texture coordinates have shape \(3, 2\): give \(16, 2\)"):
        Mesh(grid().points, grid().faces, texture_coordinates=np.zeros((3, 2)))
    with pytest.raises(InputError, match="point data 'curv' has 3 values; the surface has 16 points"):
        Mesh(grid().points, grid().faces, point_data={"curv": np.zeros(3)})


def test_suspicious_units(tmp_path):
    assert suspicious_units(sphere().points) is None
    remark = "is 0.17 units across; coordinates are taken as mm: are they metres? multiply by 1000"
    assert suspicious_units(sphere().points * 0.0017) == remark
    write_mesh(tmp_path / "s.ply", Mesh(sphere().points * 0.0017, sphere().faces))
    assert read_mesh(tmp_path / "s.ply").remarks == (remark,)


def test_packages_are_imported_late(tmp_path):
    code = "import sys, voxflat.io; print({'nibabel', 'pyvista', 'vtkmodules'} & set(sys.modules))"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "set()"


def test_missing_packages_are_named(tmp_path, monkeypatch):
    for name in ("s.vtp", "s.surf.gii", "lh.white"):
        write_mesh(tmp_path / name, sphere())
    monkeypatch.setitem(sys.modules, "nibabel", None)
    monkeypatch.setitem(sys.modules, "pyvista", None)
    for name, package in [("s.vtp", "pyvista"), ("s.surf.gii", "nibabel"), ("lh.white", "nibabel")]:
        refuses(tmp_path / name, rf"pip install 'voxflat\[{package}\]'")
        refuses(tmp_path / name, rf"pip install 'voxflat\[{package}\]'", write_mesh, sphere())


# --------------------------------------------------------------------------------------- real data


def test_fsaverage5(tmp_path):
    white, pial, flat = (read_mesh(fsaverage5(name)) for name in ("white_left", "pial_left", "flat_left"))
    points, faces = (array.data for array in nib.load(fsaverage5("white_left")).darrays)
    np.testing.assert_array_equal(white.points, points)
    np.testing.assert_array_equal(white.faces, faces)
    assert (white.structure, pial.structure, flat.structure) == ("CortexLeft", "CortexLeft", None)
    assert white.remarks == ()
    sulc = read_overlay(fsaverage5("sulc_left"), len(white.points))
    assert sulc.shape == (10242,)
    assert holds_mesh(fsaverage5("white_left"))
    assert not holds_mesh(fsaverage5("sulc_left"))
    region = read_region(fsaverage5("flat_left"), len(white.points))
    assert region.sum() == 9465  # the flat map leaves out the medial wall, but its file has all points
    assert read_region(fsaverage5("white_left"), len(white.points)).all()
    for name in FORMATS:
        write_mesh(tmp_path / name, white)
        same(read_mesh(tmp_path / name), white, 5e-9 if name == "s.obj" else 0)


@needs_workbench
def test_workbench_takes_flat_maps(tmp_path):
    white, flat = read_mesh(fsaverage5("white_left")), read_mesh(fsaverage5("flat_left"))
    plane = np.column_stack([flat.points[:, :2], np.zeros(len(flat.points))])
    for name, points, faces in [("flat", plane, flat.faces), ("cut", white.points, flat.faces)]:
        write_mesh(tmp_path / f"{name}.surf.gii", Mesh(points, faces, structure="CortexLeft"))

    def workbench(*arguments):
        return subprocess.run(["wb_command", *arguments], cwd=tmp_path, check=True, capture_output=True, text=True)

    lines = workbench("-file-information", "flat.surf.gii").stdout.splitlines()
    told = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
    assert told["Structure"] == "CortexLeft"
    assert told["Surface Type (Primary)"] == "Flat"
    assert (told["Number of Vertices"], told["Number of Triangles"]) == ("10242", str(len(flat.faces)))
    workbench("-surface-distortion", "cut.surf.gii", "flat.surf.gii", "areal.func.gii")
    areal = read_overlay(tmp_path / "areal.func.gii", 10242)[np.unique(flat.faces)]
    assert np.isfinite(areal).all()
    assert areal.std() > 0


# -------------------------------------------------------------------------- files of other programs


@pytest.mark.parametrize("ending", [".ply", ".vtp", ".vtk", ".stl"])
@pytest.mark.parametrize("binary", [True, False])
def test_files_of_vtk(tmp_path, ending, binary):
    ball = pv.Icosphere(radius=50.0, nsub=1)
    ball.point_data["curv"] = np.arange(42.0)
    ball.active_texture_coordinates = ball.points[:, :2].astype(np.float32)
    path = tmp_path / f"s{ending}"
    ball.save(path, binary=binary)
    read = read_mesh(path)
    if ending == ".stl":
        assert read.remarks == ("STL knows no points: 240 corners with 42 different places became as many points",)
        np.testing.assert_allclose(read.points[read.faces], ball.points[ball.regular_faces], rtol=1e-5)
        return
    same(read, sphere(), 1e-5)
    if ending != ".ply":
        np.testing.assert_array_equal(read.point_data["curv"], np.arange(42.0))
        np.testing.assert_allclose(read.texture_coordinates, ball.points[:, :2], rtol=1e-5)


@pytest.mark.parametrize("mode", ["ascii", "binary", "raw", "base64"])
@pytest.mark.parametrize("compressor", ["None", "ZLib", "LZ4", "LZMA"])
@pytest.mark.parametrize("header", ["32", "64"])
@pytest.mark.parametrize("order", ["Little", "Big"])
def test_vtp_of_all_kinds(tmp_path, mode, compressor, header, order):
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter

    writer = vtkXMLPolyDataWriter()
    writer.SetInputData(pv.PolyData.from_regular_faces(sphere().points, sphere().faces))
    writer.SetFileName(str(tmp_path / "s.vtp"))
    writer.SetDataMode({"ascii": 0, "binary": 1}.get(mode, 2))
    writer.SetEncodeAppendedData(mode == "base64")
    getattr(writer, f"SetCompressorTypeTo{compressor}")()
    getattr(writer, f"SetHeaderTypeToUInt{header}")()
    getattr(writer, f"SetByteOrderTo{order}Endian")()
    writer.SetBlockSize(256)
    writer.Write()
    same(read_mesh(tmp_path / "s.vtp"), sphere(), 1e-9)  # ASCII has 11 digits


@pytest.mark.parametrize("binary", [True, False])
def test_older_vtk(tmp_path, binary):
    from vtkmodules.vtkIOLegacy import vtkPolyDataWriter

    writer = vtkPolyDataWriter()
    writer.SetInputData(pv.PolyData.from_regular_faces(sphere().points, sphere().faces))
    writer.SetFileName(str(tmp_path / "s.vtk"))
    writer.SetFileVersion(42)
    (writer.SetFileTypeToBinary if binary else writer.SetFileTypeToASCII)()
    writer.Write()
    same(read_mesh(tmp_path / "s.vtk"), sphere(), 1e-9)


def test_vtk_with_single_points(tmp_path):
    ball = pv.PolyData.from_regular_faces(sphere().points, sphere().faces)
    ball.verts = [1, 0, 1, 5]
    for name in ("s.vtk", "s.vtp"):
        ball.save(tmp_path / name)
        same(read_mesh(tmp_path / name), sphere())


PLY = """ply
format {} 1.0
comment höhe
element material 1
property uchar red
element vertex 4
property float x
property double y
property short z
property uchar quality
property float texture_u
property float texture_v
element face 2
property uchar flags
property list uchar uint vertex_index
property list uchar float texcoord
element edge 7
property int vertex1
end_header
"""
POINTS = [(0, 0, 0, 7, 0, 0), (30, 0, 0, 8, 1, 0), (0, 0.1, 50, 9, 0, 1), (1, 2, 3, 10, 1, 1)]
FACES = [(0, 1, 2), (1, 3, 2)]


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_ply_with_other_elements(tmp_path, form, newline):
    if form == "ascii":
        rows = ["255", *(" ".join(map(str, row)) for row in POINTS), *(f"1 3 {a} {b} {c} 2 .5 .5" for a, b, c in FACES)]
        body = "".join(row + newline for row in rows).encode()
    else:
        order = "<" if "little" in form else ">"
        body = b"\xff" + b"".join(struct.pack(order + "fdhBff", *row) for row in POINTS)
        body += b"".join(struct.pack(order + "BB3IB2f", 1, 3, *face, 2, 0.5, 0.5) for face in FACES)
    (tmp_path / "s.ply").write_bytes(PLY.format(form).replace("\n", newline).encode() + body)
    read = read_mesh(tmp_path / "s.ply")
    same(read, Mesh(np.array(POINTS)[:, :3], FACES))
    np.testing.assert_array_equal(read.texture_coordinates, np.array(POINTS)[:, 4:])
    assert {name: values.tolist() for name, values in read.point_data.items()} == {"quality": [7, 8, 9, 10]}


def test_obj_keeps_the_numbers_of_points(tmp_path):
    """Where a seam passes a point has two texture coordinates; VTK makes two points of it and sorts all anew."""
    text = """# a comment
mtllib s.mtl
o square
v 9 9 9 1.0
v 30 0 0 1 0 0
v 0 0 0
v 0 30 0 # corner
v 30 30 0
v 0 0 0
vt 0 0
vt 1 0 0
vt 0 1
vt .5 .5
vn 0 0 1
s off
f 3/1/1 2/2/1 \\
4/3/1
f -5/4/1 -2/2/-1 -3/3
"""
    (tmp_path / "s.obj").write_text(text)
    read = read_mesh(tmp_path / "s.obj")
    points = [(9, 9, 9), (30, 0, 0), (0, 0, 0), (0, 30, 0), (30, 30, 0), (0, 0, 0)]
    same(read, Mesh(np.array(points), [(2, 1, 3), (1, 4, 3)]))
    nan = [np.nan, np.nan]
    np.testing.assert_array_equal(read.texture_coordinates, [nan, (1, 0), (0, 0), (0, 1), (1, 0), nan])
    assert read.remarks == ("1 points lie on a seam of the texture: each keeps the first of its texture coordinates",)
    (tmp_path / "s.obj").write_text("v 0 0 0\nv 0 90 0\nv 90 0 0\nf 1// 2//1 3")
    assert read_mesh(tmp_path / "s.obj").remarks == ("does not end with a whole line: is it complete?",)


def quads(new):
    points, faces = grid().points, [(0, 4, 5, 1), (1, 5, 6, 2)]
    magic, values = (b"\xff\xff\xfd", points.astype(">f4")) if new else (b"\xff\xff\xff", (100 * points).astype(">i2"))
    threes = b"".join(number.to_bytes(3, "big") for number in (16, 2))
    corners = b"".join(number.to_bytes(3, "big") for face in faces for number in face)
    return magic + threes + values.tobytes() + corners


@pytest.mark.parametrize("new", [True, False])
def test_freesurfer_quadrangles(tmp_path, new):
    (tmp_path / "lh.orig").write_bytes(quads(new))
    read = read_mesh(tmp_path / "lh.orig")
    np.testing.assert_array_equal(read.points, grid().points)
    assert len(read.faces) == 4
    assert read.remarks == ("2 quadrangles were split into triangles",)
    (tmp_path / "lh.orig").write_bytes(quads(new)[:-1])
    refuses(tmp_path / "lh.orig", "has 16 points and 2 quadrangles by its header, but ends after")


def test_freesurfer_offset_is_told(tmp_path):
    volume = {"head": [2, 0, 20], "valid": "1  # valid", "filename": "x.mgz", "volume": [256] * 3, "voxelsize": [1] * 3}
    volume |= {"xras": [-1, 0, 0], "yras": [0, 0, -1], "zras": [0, 1, 0], "cras": [5.5, -18, 3.25]}
    path = tmp_path / "lh.white"
    nib.freesurfer.write_geometry(path, sphere().points, sphere().faces, "me", volume)
    same(read_mesh(path), sphere(), 1e-6)
    remark = "coordinates are FreeSurfer's (tkRAS), as stored: add c_ras (5.5, -18, 3.25) mm for scanner RAS"
    assert read_mesh(path).remarks == (remark,)
    path.write_bytes(path.read_bytes()[:-40])
    refuses(path, "Error parsing volume info|could not convert|complete")


# ------------------------------------------------------------------------------------------- GIFTI


@pytest.mark.parametrize("encoding", ["GIFTI_ENCODING_ASCII", "GIFTI_ENCODING_B64BIN", "GIFTI_ENCODING_B64GZ"])
@pytest.mark.parametrize("packed", [True, False])
def test_gifti_encodings(tmp_path, encoding, packed):
    path = gifti(tmp_path / "s.gii", encoding=encoding)
    if packed:
        path = path.rename(tmp_path / "s.gii.gz")
        path.write_bytes(gzip.compress(path.read_bytes()))
    same(read_mesh(path), sphere(), 1e-4 if "ASCII" in encoding else 1e-6)


def test_gifti_transforms_are_not_applied(tmp_path):
    """As Workbench 1.5 and nilearn 0.14 do."""

    def change(image):
        image.darrays[0].coordsys.xform[:3, 3] = [1, 2.5, -3]
        image.darrays[0].coordsys.xformspace = 1
        image.darrays[0].meta["VolGeomC_R"] = "5.5"
        image.darrays[0].meta["VolGeomC_A"] = "0"

    read = read_mesh(gifti(tmp_path / "s.gii", change=change))
    same(read, sphere(), 1e-6)
    assert read.remarks == (
        "has a transform to NIFTI_XFORM_SCANNER_ANAT (shift 1, 2.5, -3 mm), which is not applied: coordinates are as "
        "stored",
        "coordinates are FreeSurfer's (tkRAS), as stored: add c_ras (5.5, 0, 0) mm for scanner RAS",
    )


POINT, TRIANGLE = (np.zeros((4, 3), "f4"), "pointset"), (np.zeros((1, 3), "i4"), "triangle")


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ([POINT, POINT, TRIANGLE], "has 2 point sets"),
        ([POINT, TRIANGLE, TRIANGLE], "has 2 set of triangles|has 2 sets of triangles"),
        ([POINT], r"has no set of triangles \(its arrays: NIFTI_INTENT_POINTSET\)"),
        ([(np.zeros(4, "f4"), "shape")], r"has no point set \(its arrays: NIFTI_INTENT_SHAPE\)"),
        ([(np.zeros((0, 3), "f4"), "pointset"), TRIANGLE], "no points"),
        ([POINT, (np.zeros((0, 3), "i4"), "triangle")], "no faces"),
        ([POINT, (np.array([[0, 1, 4]], "i4"), "triangle")], r"face 0 is \[0, 1, 4\]"),
        ([(np.full((4, 3), np.nan, "f4"), "pointset"), TRIANGLE], "point 0 lies at"),
        ([POINT, (np.zeros((1, 4), "i4"), "triangle")], r"faces are int32 of shape \(1, 4\)"),
    ],
)
def test_gifti_that_is_no_surface(tmp_path, arrays, message):
    refuses(gifti(tmp_path / "s.surf.gii", arrays), message)


def test_gifti_with_attacks(tmp_path, monkeypatch):
    path = gifti(tmp_path / "s.surf.gii")
    text = path.read_text()
    lines = [f"<!ENTITY {new} '{10 * ('&' + old + ';')}'>" for old, new in zip("abcdefghi", "bcdefghij", strict=True)]
    laughs = "".join(['<!DOCTYPE GIFTI [<!ENTITY a "ha">', *lines])
    doctype = text[text.index("<!DOCTYPE") : text.index(">", text.index("<!DOCTYPE")) + 1]
    for entity in (
        laughs,
        '<!DOCTYPE GIFTI [<!ENTITY a SYSTEM "file:///etc/passwd">',
        "<!DOCTYPE a [<!ENTITY % a 'b'>",
    ):
        bad = text.replace(doctype, f"<!--{' ' * 70000}-->{entity}]>").replace(
            "<MetaData />", "<MetaData>&j;</MetaData>"
        )
        for encoded in (bad.encode(), bad.replace("UTF-8", "UTF-16").encode("utf-16")):
            path.write_bytes(encoded)
            refuses(path, "defines the XML entity")
    outside = text.replace('Encoding="GZipBase64Binary"', 'Encoding="ExternalFileBinary"')
    path.write_text(outside.replace('ExternalFileName=""', 'ExternalFileName="/etc/passwd"'))
    refuses(path, "keeps data in another file, '/etc/passwd'")
    gifti(path, [(np.zeros((2_000_000, 3), "f4"), "pointset"), TRIANGLE])
    path.write_text(path.read_text().replace('"2000000"', '"4"'))
    refuses(path, "array 1 goes on after 48 bytes")
    path.write_text(path.read_text().replace('Dim0="4"', 'Dim0="400000000000"'))
    refuses(path, "array 1 has the dimensions .* more than memory may hold")


def test_what_memory_may_not_hold(tmp_path, monkeypatch):
    monkeypatch.setattr(_gifti.psutil, "virtual_memory", lambda: SimpleNamespace(available=4 << 20))
    path = tmp_path / "s.surf.gii"
    path.write_bytes(gzip.compress(bytes(8 << 20)))
    refuses(path, r"unpacks 7\.99\d KiB to more than 1 MiB, a quarter of the free memory|unpacks .* more than 1 MiB")
    path.write_bytes(bytes(2 << 20))
    refuses(path, "holds more than 1 MiB")


def test_gifti_with_wrong_counts(tmp_path):
    path = gifti(tmp_path / "s.surf.gii")
    text = path.read_text()
    path.write_text(text.replace('NumberOfDataArrays="2"', 'NumberOfDataArrays="3"'))
    refuses(path, "has 2 arrays, by its header 3")
    path.write_text(text.replace('Dim0="42"', 'Dim0="43"'))
    refuses(path, "array 1 ends after 504 of 516 bytes")
    path.write_text(text.replace('Encoding="GZipBase64Binary"', 'Encoding="Rot13"'))
    refuses(path, "Rot13")


# ------------------------------------------------------------------------------------------ damage


def written(folder, name):
    """Write a sphere in a format, also one that only others write."""
    path = folder / name
    if name.startswith("old"):
        from vtkmodules.vtkIOLegacy import vtkPolyDataWriter

        writer = vtkPolyDataWriter()
        writer.SetInputData(pv.PolyData.from_regular_faces(sphere().points, sphere().faces))
        writer.SetFileName(str(path))
        writer.SetFileVersion(42)
        writer.SetFileTypeToBinary()
        writer.Write()
    elif name.startswith("text") or path.suffix in (".stl", ".vtk"):
        pv.PolyData.from_regular_faces(sphere().points, sphere().faces).save(path, binary=not name.startswith("text"))
    elif name.endswith(".gz"):
        path.write_bytes(gzip.compress(written(folder, "s.surf.gii").read_bytes(), mtime=0))
    else:
        write_mesh(path, sphere())
    return path


def mesh_or_error(path):
    """Return a mesh, or None where there is an error of one line that names the file."""
    try:
        return read_mesh(path)
    except InputError as caught:
        error = str(caught)
    assert error.startswith(str(path))
    assert "\n" not in error
    return None


COUNTED = ["s.surf.gii", "s.gii.gz", "lh.white", "s.vtp", "text.vtp", "s.vtk", "old.vtk", "text.vtk", "s.ply"]
COUNTED += ["text.ply", "s.stl", "text.stl"]


@pytest.mark.parametrize("name", COUNTED)
def test_files_cut_short(tmp_path, name, capfd):
    """A file cut anywhere is refused, except where nothing but white space is lost."""
    path = written(tmp_path, name)
    whole, mesh = path.read_bytes(), read_mesh(path)
    for length in {*np.linspace(1, len(whole) - 1, 25).astype(int).tolist(), len(whole) - 1, len(whole) - 2}:
        path.write_bytes(whole[:length])
        read = mesh_or_error(path)
        if read is not None:
            assert len(whole) - length < 60
            same(read, mesh, 1e-6)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", [*COUNTED, "s.obj"])
@settings(fast, max_examples=25, derandomize=True)
@given(data=st.data())
def test_damaged_files(tmp_path, name, data):
    """Whatever is damaged, there is a mesh or an `InputError` of one line."""
    path = tmp_path / name
    if not path.exists():
        written(tmp_path, name)
    whole = path.read_bytes()
    damaged = bytearray(whole)
    for place in data.draw(st.lists(st.integers(0, len(whole) - 1), min_size=1, max_size=4)):
        damaged[place] = data.draw(st.sampled_from(b"\x00\xff 0129-\n<>") | st.integers(0, 255))
    try:
        path.write_bytes(damaged)
        mesh_or_error(path)
    finally:
        path.write_bytes(whole)


HOSTILE = {
    "empty.ply": (b"", "is empty"),
    "text.ply": (b"hello world\n" * 9, "has no header from 'ply'"),
    "text.obj": (b"hello world\n" * 9, "no line that begins with 'v'"),
    "text.stl": (b"hello world\n" * 9, "faces by its header, but ends"),
    "text.vtk": (b"hello world\n" * 9, "damaged header"),
    "text.vtp": (b"hello world\n" * 9, "syntax error"),
    "text.surf.gii": (b"hello world\n" * 9, "syntax error"),
    "text": (b"hello world\n" * 9, "is no surface, but of unknown content: .gii, "),
    "html.surf.gii": (b"<html><body>404</body></html>", "ending of GIFTI, but the content of XML <html>"),
    "cut.surf.gii": (b"<?xml version='1.0'?>", "no element found"),
    "cut.gii.gz": (gzip.compress(b"<GIFTI/>" * 99)[:-9], "[Cc]ompressed file ended"),
    "bad.gii.gz": (b"\x1f\x8bgarbage" * 9, "method|gzip"),
    "quads.ply": (
        b"ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
        b"element face 2\nproperty list uchar int vertex_indices\nend_header\n"
        b"0 0 0\n9 0 0\n9 9 0\n0 9 0\n4 0 1 2 3\n4 0 1 2 3\n",
        "2 faces have 4 corners; triangulate first",
    ),
    "mixed.ply": (
        b"ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
        b"element face 2\nproperty list uchar int vertex_indices\nend_header\n"
        b"0 0 0\n9 0 0\n9 9 0\n0 9 0\n3 0 1 2\n4 0 1 2 3\n",
        "face 1 has 4 corners, face 0 has 3; triangulate first",
    ),
    "half.ply": (
        b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        b"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n9 0 0\n9 9 0\n3 0 1 1.5\n",
        "face 0 is .*whole numbers",
    ),
    "points.ply": (
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
        b"end_header\n0 0 0\n",
        "no faces with vertex_indices",
    ),
    "format.ply": (b"ply\nformat morse 1.0\nend_header\n", "format is 'morse'"),
    "line.ply": (b"ply\nelemnt vertex 3\nend_header\n", "line 'elemnt vertex 3'"),
    "quads.obj": (b"v 0 0 0\nv 9 0 0\nv 9 9 0\nv 0 9 0\nf 1 2 3\nf 1 2 3 4\n", "1 face has 4 corners; triangulate"),
    "points.obj": (b"v 0 0 0\nv 9 0 0\n", "no line that begins with 'f'"),
    "lines.obj": (b"v 0 0 0\nv 9 0 0\nv 9 9 0\nl 1 2\nf 1 2 3\n", "has 1 lines beside its faces"),
    "zero.obj": (b"v 0 0 0\nv 9 0 0\nv 9 9 0\nf 0 1 2\n", r"face 0 is \[-1, 0, 1\]"),
    "range.obj": (b"v 0 0 0\nv 9 0 0\nv 9 9 0\nf 1 2 3\nf 1 2 4\n", r"face 1 is \[0, 1, 3\]"),
    "texture.obj": (b"v 0 0 0\nv 9 0 0\nv 9 9 0\nvt 0 0\nf 1/1 2/1 3/2\n", "face 0 names texture coordinate 2 of 1"),
    "word.obj": (b"v 0 0 zero\nf 1 1 1\n", "could not convert string to float: 'zero'"),
    "nan.obj": (b"v 0 0 nan\nv 0 0 0\nv 9 9 9\nf 1 2 3\n", "point 0 lies at"),
    "lh.patch": (struct.pack(">2i", -1, 0), "is no surface, but FreeSurfer patch: read_patch reads it"),
    "lh.curv": (b"\xff\xff\xff" + struct.pack(">3if", 1, 1, 1, 0.5), "FreeSurfer file of values: read_overlay"),
    "lh.cut": (b"\xff\xff\xfecreated by me\n\n\0\0\0\x09", "-1 faces by its header, which is damaged"),
    "lh.big": (b"\xff\xff\xfecreated by me\n\n" + struct.pack(">2i", 2**31 - 1, 9), "but ends after"),
    "grid.vtk": (b"# vtk DataFile Version 3.0\n\nASCII\nDATASET STRUCTURED_GRID\n", "holds STRUCTURED_GRID: extract"),
    "huge.vtk": (
        b"# vtk DataFile Version 3.0\n\nASCII\nDATASET POLYDATA\nPOINTS 99999999999999 float\n0 0 0\n",
        "more than memory may hold",
    ),
    "strip.vtk": (
        b"# vtk DataFile Version 3.0\n\nASCII\nDATASET POLYDATA\nPOINTS 4 float\n0 0 0 9 0 0 9 9 0 0 9 0\n"
        b"POLYGONS 1 4\n3 0 1 2\nTRIANGLE_STRIPS 1 5\n4 0 1 2 3\nLINES 1 3\n2 0 1\n",
        "has 1 lines and 1 triangle strips",
    ),
    "quads.vtk": (
        b"# vtk DataFile Version 3.0\n\nASCII\nDATASET POLYDATA\nPOINTS 4 float\n0 0 0 9 0 0 9 9 0 0 9 0\n"
        b"POLYGONS 2 9\n3 0 1 2\n4 0 1 2 3\n",
        "1 face has 4 corners",
    ),
    "bomb.vtp": (b'<!DOCTYPE a [<!ENTITY a "a">]><VTKFile type="PolyData"/>', "defines the XML entity 'a'"),
    "grid.vtp": (b'<VTKFile type="UnstructuredGrid"><UnstructuredGrid/></VTKFile>', "VTK says|no points"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files(tmp_path, name, capfd):
    content, message = HOSTILE[name]
    (tmp_path / name).write_bytes(content)
    refuses(tmp_path / name, message)
    assert capfd.readouterr() == ("", "")


def test_wrong_endings(tmp_path):
    nib.save(nib.Nifti1Image(np.zeros((9, 9, 9), np.uint8), np.eye(4)), tmp_path / "v.nii.gz")
    (tmp_path / "v.nii.gz").rename(tmp_path / "v.surf.gii")
    refuses(tmp_path / "v.surf.gii", "has the ending of GIFTI, but the content of a NIfTI volume: rename it")
    for name in ("s.stl", "text.stl"):
        written(tmp_path, name).rename(tmp_path / "s.obj")
        refuses(tmp_path / "s.obj", "has the ending of OBJ, but the content of STL")
    for name, ending, content in [
        ("s.ply", "s.stl", "PLY"),
        ("s.vtp", "s.gii", "VTP"),
        ("s.surf.gii", "s.vtp", "GIFTI"),
    ]:
        written(tmp_path, name).rename(tmp_path / ending)
        refuses(tmp_path / ending, f"but the content of {content}")
        shutil.copy(tmp_path / ending, tmp_path / "no ending")
        assert len(read_mesh(tmp_path / "no ending").points) == 42


def test_what_is_no_file(tmp_path):
    refuses(tmp_path, "is a directory")
    with pytest.raises(FileNotFoundError, match=r"missing\.ply"):
        read_mesh(tmp_path / "missing.ply")
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.ply")
        refuses(tmp_path / "pipe.ply", "is no regular file")


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="this user may read everything")
def test_no_permission(tmp_path):
    written(tmp_path, "s.ply").chmod(0)
    with pytest.raises(PermissionError, match=r"s\.ply"):
        read_mesh(tmp_path / "s.ply")


def test_reading_warns_of_nothing(tmp_path, recwarn):
    warnings.simplefilter("always")
    for name in COUNTED:
        read_mesh(written(tmp_path, name))
    assert [str(warning.message) for warning in recwarn if "voxflat" in Path(warning.filename).parts] == []
