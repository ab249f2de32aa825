"""Damaged and hostile mesh files, and files in other formats."""

import gzip
import os
import re
import shutil
import struct
import subprocess
import sys

import numpy as np
import psutil
import pytest
from mesh_files import glb, nib, pv, refuses, same, sphere, write_old_vtk

from voxflat.io.meshes import read_mesh, write_mesh


def written(folder, name):
    """Write a sphere in a format, including formats that voxflat does not write."""
    path, is_text = folder / name, name.startswith("text")
    polydata = pv.PolyData.from_regular_faces(sphere().points, sphere().faces)
    if name.startswith("old"):
        write_old_vtk(path, polydata)
    elif is_text or path.suffix in (".stl", ".vtk"):
        polydata.save(path, binary=not is_text)
    elif name.endswith(".gz"):
        path.write_bytes(gzip.compress(written(folder, "s.surf.gii").read_bytes(), mtime=0))
    else:
        write_mesh(path, sphere())
    return path


COUNTED = ["s.surf.gii", "s.gii.gz", "lh.white", "s.vtp", "text.vtp", "s.vtk", "old.vtk", "text.vtk", "s.ply"]
COUNTED += ["text.ply", "s.stl", "text.stl"]


@pytest.mark.parametrize("name", COUNTED)
def test_files_cut_short(tmp_path, name, capfd):
    """A file that is cut short is refused, unless only white space is missing."""
    path = written(tmp_path, name)
    whole, mesh = path.read_bytes(), read_mesh(path)
    for length in {*np.linspace(1, len(whole) - 1, 25).astype(int).tolist(), len(whole) - 1, len(whole) - 2}:
        path.write_bytes(whole[:length])
        if len(whole) - length >= 60 or whole[length:].strip():
            refuses(path, "")
        else:
            same(read_mesh(path), mesh, 1e-6)
    assert capfd.readouterr() == ("", "")


HELLO = b"hello world\n" * 9
PLY = (
    b"ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    b"element face 2\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n9 0 0\n9 9 0\n0 9 0\n"
)
HEAD = b"# vtk DataFile Version 3.0\n\nASCII\nDATASET "
VTK = HEAD + b"POLYDATA\nPOINTS 4 float\n0 0 0 9 0 0 9 9 0 0 9 0\n"
STRIP = VTK + b"POLYGONS 1 4\n3 0 1 2\nTRIANGLE_STRIPS 1 5\n4 0 1 2 3\nLINES 1 3\n2 0 1\n"
POINTS = PLY[: PLY.index(b"element face")] + b"end_header\n0 0 0\n9 0 0\n9 9 0\n0 9 0\n"
OBJ = b"v 0 0 0\nv 9 0 0\nv 9 9 0\n"
VALUES = {"componentType": 5126, "count": 10**10, "type": "VEC3", "bufferView": 0}
VIEW = {"buffer": 0, "byteLength": 36}


def scene(values=VALUES, view=VIEW, body=bytes(36), **changes):
    """Return a GLB file of one triangle, which may announce more."""
    described = {"scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "accessors": [values]}
    described |= {"meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}]}
    return glb({**described, "bufferViews": [view], "buffers": [{"byteLength": len(body)}], **changes}, body)


def gifti(first, encoding, data):
    attributes = f'Intent="NIFTI_INTENT_POINTSET" DataType="NIFTI_TYPE_FLOAT32" Dimensionality="2" Dim0="{first}" '
    attributes += f'Dim1="3" Encoding="{encoding}" Endian="LittleEndian" ExternalFileName="/dev/zero"'
    return f"<GIFTI><DataArray {attributes}><Data>{data}</Data></DataArray></GIFTI>".encode()


BINARY = PLY.replace(b"ascii", b"binary_little_endian")[: PLY.index(b"0 0 0") + 15]
ONE = {**VALUES, "count": 3}
HOSTILE = {
    "count.glb": (scene(), "its header specifies 10000000000 values, but the file contains 36 bytes"),
    "sparse.glb": (scene({**ONE, "sparse": {"count": 1}}), "stores values 0 in a compressed form. Export the surface"),
    "absent.glb": (scene({**VALUES, "bufferView": 7}), "refers to entry 7 of its bufferViews, which does not exist"),
    "draco.glb": (
        scene({"componentType": 5126, "count": 10**10, "type": "VEC3"}),
        "stores values 0 in a compressed form. Export the surface again as one .glb file, without compression",
    ),
    "required.glb": (
        scene(extensionsRequired=["KHR_draco_mesh_compression"]),
        "extension 'KHR_draco_mesh_compression'",
    ),
    "stride.glb": (scene(ONE, {**VIEW, "byteStride": 1 << 40}), "its header specifies 3 values, but the file contains"),
    "overlap.glb": (scene(ONE, {**VIEW, "byteStride": 4}), "its header is damaged: the size of values 0 is"),
    "negative.glb": (scene({**VALUES, "count": -3}), "its header is damaged: the size of values 0 is"),
    "pairs.glb": (scene({**ONE, "type": "VEC2"}), "stores values 0 as 'VEC2'"),
    "other.glb": (scene(ONE, buffers=[{"byteLength": 36, "uri": "a.bin"}]), "stores values 0 outside the file"),
    "cycle.glb": (scene(nodes=[{"children": [0]}]), "places node 0 of its scene twice"),
    "many.glb": (
        scene(
            {**VALUES, "count": 300_000},
            {"buffer": 0, "byteLength": 3_600_000},
            bytes(3_600_000),
            nodes=[{"mesh": 0}] * 20_000,
            scenes=[{"nodes": list(range(20_000))}],
        ),
        "of memory is needed",
    ),
    "list.glb": (glb([]), "does not describe its surfaces"),
    "null.glb": (scene(nodes=None), r"has invalid content \(TypeError\)"),
    "first.glb": (glb({})[:4] + b"\1" + glb({})[5:], "is not a GLB file of version 2"),
    "count.off": (b"OFF\n9999999999 9999999999 0\n0 0 0\n", "has 1 lines of points and faces instead of"),
    "corner.off": (b"OFF\n3 1 0\n0 0 0\n9 0 0\n0 9 0\n3 0 1 " + b"9" * 20, "has invalid content"),
    "digits.off": (b"OFF\n" + b"9" * 5000 + b" 1 0\n", "has invalid content"),
    "count.ply": (
        BINARY.replace(b"vertex 4", b"vertex " + b"9" * 15) + bytes(99),
        "ends at vertex 8 of 999999999999999",
    ),
    "faces.ply": (BINARY.replace(b"face 2", b"face " + b"9" * 15) + bytes(999), "ends at face 951 of 999999999999999"),
    "list.ply": (
        BINARY.replace(b"list uchar", b"list uint") + bytes(48) + b"\xff" * 99,
        "ends at face 0 of 2",
    ),
    "kind.ply": (BINARY.replace(b"float z", b"quad z"), "has invalid content .'quad', which is missing or unknown"),
    "count.stl": (bytes(80) + b"\xff\xff\xff\xff" + bytes(500), "its header specifies 4294967295 faces"),
    "pair.obj": (b"v 0 0\nv 9 0 0\nv 9 9 0\nf 1 2 3\n", "its line 0 that begins with 'v' has 2 of 3 numbers"),
    "count.asc": (b"#!ascii\n9999999999 9\n0 0 0 0\n", r"its header specifies 1e\+10 points and 9 faces"),
    "none.asc": (b"#!ascii\n", "has 0 numbers"),
    "count.gii": (gifti(10**10, "Base64Binary", "AAAA"), "does not fit into memory"),
    "text.gii": (gifti(10**10, "ASCII", "0 0 0"), r"has invalid content \(ValueError\)"),
    "odd.gii": (gifti("1e9", "Base64Binary", "AAAA"), r"has invalid content \(ValueError\)"),
    "external.gii": (gifti(10**9, "ExternalFileBinary", ""), "refers to another file, '/dev/zero'. Embed its data"),
    "lh.line": (b"\xff\xff\xfecreated by me", r"has invalid content \(ValueError\)"),
    "empty.ply": (b"", "is empty"),
    "text.ply": (HELLO, "has no header from 'ply'"),
    "text.obj": (HELLO, "no line that begins with 'v'"),
    "text.stl": (HELLO, "its header specifies .* faces, but the file ends"),
    "text.vtk": (HELLO, "damaged header"),
    "text.vtp": (HELLO, "syntax error"),
    "text.surf.gii": (HELLO, "syntax error"),
    "text": (HELLO, "is not a surface: its content is unknown. Pass a .gii, "),
    "html.surf.gii": (b"<html><body>404</body></html>", "its ending indicates GIFTI, but its content is XML <html>"),
    "cut.surf.gii": (b"<?xml version='1.0'?>", "no element found"),
    "cut.gii.gz": (gzip.compress(b"<GIFTI/>" * 99)[:-9], "[Cc]ompressed file ended"),
    "bad.gii.gz": (b"\x1f\x8bgarbage" * 9, "method|gzip"),
    "pairs.ply": (PLY + b"2 0 1\n2 1 2\n", "face 0 has 2 corners. Triangulate it first"),
    "mixed.ply": (PLY + b"3 0 1 2\n4 0 1 2\n", "ends at face 1 of 2"),
    "range.ply": (PLY + b"3 0 1 2\n4 0 1 2 4\n", "face 1 refers to point 4, but the surface has points 0 to 3"),
    "half.ply": (PLY + b"3 0 1 1.5\n3 0 1 2\n", "face 0 has the corners .*whole numbers"),
    "points.ply": (POINTS, "no faces with vertex_indices"),
    "format.ply": (b"ply\nformat morse 1.0\nend_header\n", "format is 'morse'"),
    "line.ply": (b"ply\nelemnt vertex 3\nend_header\n", "line 'elemnt vertex 3'"),
    "pairs.obj": (OBJ + b"v 0 9 0\nf 1 2 3\nf 1 2\n", "face 1 has 2 corners. Triangulate"),
    "points.obj": (b"v 0 0 0\nv 9 0 0\n", "no line that begins with 'f'"),
    "zero.obj": (OBJ + b"f 0 1 2\n", r"face 0 is \[-1, 0, 1\]"),
    "range.obj": (OBJ + b"f 1 2 3\nf 1 2 4\n", r"face 1 is \[0, 1, 3\]"),
    "texture.obj": (OBJ + b"vt 0 0\nf 1/1 2/1 3/2\n", "face 0 refers to texture coordinate 2, but the file has 1"),
    "word.obj": (b"v 0 0 zero\nf 1 1 1\n", "could not convert string to float: 'zero'"),
    "nan.obj": (b"v 0 0 inf\nv 0 0 0\nv 9 9 9\nf 1 2 3\n", "point 0.* lies beyond"),
    "lh.patch": (struct.pack(">2i", -1, 0), "is not a surface: its content is FreeSurfer patch. Pass the patch as"),
    "lh.curv": (
        b"\xff\xff\xff" + struct.pack(">3if", 1, 1, 1, 0.5),
        "FreeSurfer file of values. Pass the values as an overlay",
    ),
    "lh.cut": (b"\xff\xff\xfecreated by me\n\n\0\0\0\x09", "its header is damaged: it specifies .* -1 faces"),
    "lh.big": (b"\xff\xff\xfecreated by me\n\n" + struct.pack(">2i", 2**31 - 1, 9), "but the file ends after"),
    "grid.vtk": (HEAD + b"STRUCTURED_GRID\n", "has dataset type STRUCTURED_GRID"),
    "huge.vtk": (HEAD + b"POLYDATA\nPOINTS 99999999999999 float\n0 0 0\n", "Unable to allocate|ended while it read"),
    "quads.vtk": (VTK + b"POLYGONS 2 9\n3 0 1 2\n4 0 1 2 9\n", "face 1 refers to point 9|VTK reports"),
    "bomb.vtp": (b'<!DOCTYPE a [<!ENTITY a "a">]><VTKFile type="PolyData"/>', "defines the XML entity 'a'"),
    "grid.vtp": (b'<VTKFile type="UnstructuredGrid"><UnstructuredGrid/></VTKFile>', "VTK reports|no points"),
}


@pytest.mark.medium
@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files(tmp_path, name, capfd):
    content, message = HOSTILE[name]
    (tmp_path / name).write_bytes(content)
    refuses(tmp_path / name, message)
    assert capfd.readouterr() == ("", "")


LIMITED = """
import resource, sys
from pathlib import Path
import psutil
from voxflat.io import read_mesh
allowed = psutil.Process().memory_info().vms + (1 << 29)
resource.setrlimit(resource.RLIMIT_AS, (allowed, allowed))
for path in sorted(Path(sys.argv[1]).iterdir()):
    try:
        print(read_mesh(path))
    except Exception as error:
        print(type(error).__name__, error)
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(psutil, "RLIMIT_AS"), reason="this system limits no memory of a process")
def test_hostile_files_take_no_memory_of_the_user(tmp_path):
    """Within 512 MiB, all are refused as they are with more: no count of a header is believed."""
    small = [name for name in HOSTILE if not name.endswith((".vtk", ".vtp"))]  # read in a process of their own
    for name in small:
        (tmp_path / name).write_bytes(HOSTILE[name][0])
    told = subprocess.run([sys.executable, "-c", LIMITED, tmp_path], check=True, capture_output=True, text=True)
    for name, line in zip(sorted(small), told.stdout.splitlines(), strict=True):
        assert line.startswith(f"InputError {tmp_path / name}: ")
        assert re.search(HOSTILE[name][1], line), line


def test_wrong_endings(tmp_path):
    nib.save(nib.Nifti1Image(np.zeros((9, 9, 9), np.uint8), np.eye(4)), tmp_path / "v.nii.gz")
    (tmp_path / "v.nii.gz").rename(tmp_path / "v.surf.gii")
    refuses(tmp_path / "v.surf.gii", "ending indicates GIFTI, but its content is a NIfTI volume. Rename")
    wrong = [("s.stl", "s.obj", "STL"), ("text.stl", "t.obj", "STL"), ("s.ply", "s.stl", "PLY")]
    for name, ending, content in [*wrong, ("s.vtp", "s.gii", "VTP"), ("s.surf.gii", "s.vtp", "GIFTI")]:
        written(tmp_path, name).rename(tmp_path / ending)
        refuses(tmp_path / ending, f"but its content is {content}")
        shutil.copy(tmp_path / ending, tmp_path / "no ending")
        assert len(read_mesh(tmp_path / "no ending").faces) == 80


def test_what_is_no_file(tmp_path):
    refuses(tmp_path, "is a directory")
    with pytest.raises(FileNotFoundError, match=r"missing\.ply"):
        read_mesh(tmp_path / "missing.ply")
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.ply")
        refuses(tmp_path / "pipe.ply", "is not a regular file")


@pytest.mark.skipif(getattr(os, "geteuid", int)() == 0, reason="this user may read everything")
def test_no_permission(tmp_path):
    written(tmp_path, "s.ply").chmod(0)
    with pytest.raises(PermissionError, match=r"s\.ply"):
        read_mesh(tmp_path / "s.ply")
