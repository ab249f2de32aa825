"""Mesh files written by other programs, and variants of GIFTI."""

import gzip
import struct
from types import SimpleNamespace

import numpy as np
import pytest
from brain_spaces import footer, header
from mesh_files import gifti, grid, nib, pv, refuses, same, sphere, write_old_vtk

from voxflat.io.meshes import Mesh, read_mesh


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
        assert read.warnings == ("STL does not store shared points: 240 corners were merged into 42 points",)
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


def test_older_vtk_and_single_points(tmp_path):
    ball = pv.PolyData.from_regular_faces(sphere().points, sphere().faces)
    for binary in (True, False):
        write_old_vtk(tmp_path / "s.vtk", ball, binary)
        same(read_mesh(tmp_path / "s.vtk"), sphere(), 1e-9)
    ball.verts = [1, 0, 1, 5]
    for name in ("s.vtk", "s.vtp"):
        ball.save(tmp_path / name)
        same(read_mesh(tmp_path / name), sphere())


PLY = ["ply", "format {} 1.0", "comment höhe", "element material 1", "property uchar red", "element vertex 4"]
PLY += ["property float x", "property double y", "property short z", "property uchar quality"]
PLY += ["property float texture_u", "property float texture_v", "element face 2", "property uchar flags"]
PLY += ["property list uchar uint vertex_index", "property list uchar float texcoord"]
PLY += ["element edge 7", "property int vertex1", "end_header", ""]
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
    (tmp_path / "s.ply").write_bytes(newline.join(PLY).format(form).encode() + body)
    read = read_mesh(tmp_path / "s.ply")
    same(read, Mesh(np.array(POINTS)[:, :3], FACES))
    np.testing.assert_array_equal(read.texture_coordinates, np.array(POINTS)[:, 4:])
    assert {name: values.tolist() for name, values in read.point_data.items()} == {"quality": [7, 8, 9, 10]}


def test_obj_keeps_the_numbers_of_points(tmp_path):
    """A point on a seam has two texture coordinates; VTK would split it into two points and renumber all points."""
    lines = ["# a comment", "mtllib s.mtl", "o square", "v 9 9 9 1.0", "v 30 0 0 1 0 0", "v 0 0 0", "v 0 30 0 # corner"]
    lines += ["v 30 30 0", "v 0 0 0", "vt 0 0", "vt 1 0 0", "vt 0 1", "vt .5 .5", "vn 0 0 1", "s off"]
    lines += ["f 3/1/1 2/2/1 \\", "4/3/1", "f -5/4/1 -2/2/-1 -3/3", ""]
    (tmp_path / "s.obj").write_text("\n".join(lines))
    read = read_mesh(tmp_path / "s.obj")
    points = [(9, 9, 9), (30, 0, 0), (0, 0, 0), (0, 30, 0), (30, 30, 0), (0, 0, 0)]
    same(read, Mesh(np.array(points), [(2, 1, 3), (1, 4, 3)]))
    nan = [np.nan, np.nan]
    np.testing.assert_array_equal(read.texture_coordinates, [nan, (1, 0), (0, 0), (0, 1), (1, 0), nan])
    assert read.warnings == ("has points on texture seams (1); each keeps only its first texture coordinate",)
    (tmp_path / "s.obj").write_text("v 0 0 0\nv 0 90 0\nv 90 0 0\nf 1// 2//1 3")
    (warning,) = read_mesh(tmp_path / "s.obj").warnings
    assert warning == "does not end with a complete line. Check that the file is complete"


def quads(new):
    points, faces = grid().points, [(0, 4, 5, 1), (1, 5, 6, 2)]
    magic, values = (b"\xff\xff\xfd", points.astype(">f4")) if new else (b"\xff\xff\xff", (100 * points).astype(">i2"))
    threes = [b"".join(int(number).to_bytes(3, "big") for number in numbers) for numbers in ((16, 2), np.ravel(faces))]
    return magic + threes[0] + values.tobytes() + threes[1]


@pytest.mark.parametrize("new", [True, False])
def test_freesurfer_quadrangles(tmp_path, new):
    (tmp_path / "lh.orig").write_bytes(quads(new))
    read = read_mesh(tmp_path / "lh.orig")
    np.testing.assert_array_equal(read.points, grid().points)
    assert len(read.faces) == 4
    assert read.warnings == ("2 quadrangles were split into triangles",)
    (tmp_path / "lh.orig").write_bytes(quads(new)[:-1])
    refuses(tmp_path / "lh.orig", "its header specifies 16 points and 2 quadrangles, but the file ends after")


def test_a_footer_cut_short_is_refused(tmp_path):
    path = tmp_path / "lh.white"
    nib.freesurfer.write_geometry(path, sphere().points, sphere().faces, "me", footer(header()))
    same(read_mesh(path), sphere(), 1e-6)
    path.write_bytes(path.read_bytes()[:-40])
    refuses(path, "Error parsing volume info|could not convert|complete")


@pytest.mark.parametrize("encoding", ["GIFTI_ENCODING_ASCII", "GIFTI_ENCODING_B64BIN", "GIFTI_ENCODING_B64GZ"])
@pytest.mark.parametrize("packed", [True, False])
def test_gifti_encodings(tmp_path, encoding, packed):
    path = gifti(tmp_path / "s.gii", encoding=encoding)
    if packed:
        path = path.rename(tmp_path / "s.gii.gz")
        path.write_bytes(gzip.compress(path.read_bytes()))
    same(read_mesh(path), sphere(), 1e-4 if "ASCII" in encoding else 1e-6)


def test_gifti_transforms_to_a_template_are_not_applied(tmp_path):
    """Workbench 1.5 and nilearn 0.14 do the same."""

    def change(image):
        image.darrays[0].coordsys.xform[:3, 3] = [1, 2.5, -3]
        image.darrays[0].coordsys.xformspace = 3

    read = read_mesh(gifti(tmp_path / "s.gii", change=change))
    same(read, sphere(), 1e-6)
    (warning,) = read.warnings
    assert warning.startswith(
        "has a transformation to NIFTI_XFORM_TALAIRACH (shift 1, 2.5, -3 mm), but its coordinates"
    )
    assert read.space.name == "unknown"


POINT, TRIANGLE = (np.zeros((4, 3), "f4"), "pointset"), (np.zeros((1, 3), "i4"), "triangle")


def test_gifti_that_is_no_surface(tmp_path):
    path, no_points, no_faces = tmp_path / "s.surf.gii", np.zeros((0, 3), "f4"), np.zeros((0, 3), "i4")
    refuses(gifti(path, [POINT, POINT, TRIANGLE]), "has 2 point sets")
    refuses(gifti(path, [POINT, TRIANGLE, TRIANGLE]), "has 2 triangle sets instead of one")
    refuses(gifti(path, [POINT]), r"has no triangle set \(its arrays are NIFTI_INTENT_POINTSET\)")
    refuses(gifti(path, [(np.zeros(4, "f4"), "shape")]), r"has no point set \(its arrays are NIFTI_INTENT_SHAPE\)")
    refuses(gifti(path, [(no_points, "pointset"), TRIANGLE]), "no points")
    refuses(gifti(path, [POINT, (no_faces, "triangle")]), "no faces")
    refuses(gifti(path, [POINT, (np.array([[0, 1, 4]], "i4"), "triangle")]), r"face 0 is \[0, 1, 4\]")
    refuses(gifti(path, [(POINT[0] + np.inf, "pointset"), TRIANGLE]), "point 0.* lies beyond")
    refuses(
        gifti(path, [POINT, (np.zeros((1, 4), "i4"), "triangle")]), r"faces have data type int32 and shape \(1, 4\)"
    )


def test_gifti_with_attacks(tmp_path):
    path = gifti(tmp_path / "s.surf.gii")
    text = path.read_text()
    lines = [f"<!ENTITY {new} '{10 * ('&' + old + ';')}'>" for old, new in zip("abcdefghi", "bcdefghij", strict=True)]
    laughs = "".join(['<!DOCTYPE GIFTI [<!ENTITY a "ha">', *lines])
    doctype = text[text.index("<!DOCTYPE") : text.index(">", text.index("<!DOCTYPE")) + 1]
    outside = '<!DOCTYPE GIFTI [<!ENTITY a SYSTEM "file:///etc/passwd">'
    for entity in (laughs, outside, "<!DOCTYPE a [<!ENTITY % a 'b'>"):
        bad = text.replace(doctype, f"<!--{' ' * 70000}-->{entity}]>")
        bad = bad.replace("<MetaData />", "<MetaData>&j;</MetaData>")
        for encoded in (bad.encode(), bad.replace("UTF-8", "UTF-16").encode("utf-16")):
            path.write_bytes(encoded)
            refuses(path, "defines the XML entity")
    outside = text.replace('Encoding="GZipBase64Binary"', 'Encoding="ExternalFileBinary"')
    path.write_text(outside.replace('ExternalFileName=""', 'ExternalFileName="/etc/passwd"'))
    refuses(path, "refers to another file, '/etc/passwd'")
    gifti(path, [(np.zeros((2_000_000, 3), "f4"), "pointset"), TRIANGLE])
    longer, too_large = "array 1 is longer than the 48 bytes", "array 1 with dimensions .* does not fit into memory"
    for old, new, told in (("2000000", "4", longer), ("4", "400000000000", too_large)):
        path.write_text(path.read_text().replace(f'Dim0="{old}"', f'Dim0="{new}"'))
        refuses(path, told)


def test_what_memory_may_not_hold(tmp_path, monkeypatch):
    monkeypatch.setattr("psutil.virtual_memory", lambda: SimpleNamespace(available=4 << 20))
    path = tmp_path / "s.surf.gii"
    path.write_bytes(gzip.compress(bytes(8 << 20)))
    refuses(path, r"expands from .* KiB to more than 1 MiB, a quarter of the memory")
    path.write_bytes(bytes(2 << 20))
    refuses(path, "contains more than 1 MiB")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('NumberOfDataArrays="2"', 'NumberOfDataArrays="3"', "has 2 arrays, but its header specifies 3"),
        ('Dim0="42"', 'Dim0="43"', "array 1 ends after 504 of the 516 bytes"),
        ('Encoding="GZipBase64Binary"', 'Encoding="Rot13"', "Rot13"),
    ],
)
def test_gifti_with_wrong_headers(tmp_path, old, new, message):
    path = gifti(tmp_path / "s.surf.gii")
    path.write_text(path.read_text().replace(old, new))
    refuses(path, message)
