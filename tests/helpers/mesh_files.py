"""Small surfaces, and checks shared by the tests of files."""

import importlib.util
import json
import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from voxflat.errors import InputError
from voxflat.io.meshes import Mesh, read_mesh

nib = pytest.importorskip("nibabel")
pv = pytest.importorskip("pyvista")

FORMATS = ["s.surf.gii", "lh.white", "s", "s.vtp", "s.ply", "s.obj"]
FLOAT32 = ("s.surf.gii", "lh.white", "s")
needs_workbench = pytest.mark.skipif(
    shutil.which("wb_command") is None, reason="wb_command (Debian: connectome-workbench) is missing"
)
fast = settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])


def sphere(**options):
    ball = pv.Icosphere(radius=50.0, nsub=1)
    return Mesh(np.asarray(ball.points, dtype=np.float64), np.asarray(ball.regular_faces), **options)


def grid(rows=4, z=0.0, step=10.0, columns=None):
    """Return a flat rectangle of rows by columns of points, by default a square; z is one value or one per point."""
    columns = columns or rows
    i, j = np.indices((rows, columns))
    points = np.column_stack([step * i.ravel(), step * j.ravel(), np.broadcast_to(z, i.size)])
    corner = (i[:-1, :-1] * columns + j[:-1, :-1]).ravel()
    faces = np.concatenate([corner[:, None] + half for half in ([0, columns, 1], [1, columns, columns + 1])])
    return Mesh(points, faces)


def fsaverage5(name):
    """Return a file of nilearn's fsaverage5 without importing nilearn, which takes seconds."""
    package = importlib.util.find_spec("nilearn")
    if package is None:
        pytest.skip("nilearn, whose package has fsaverage5, is missing")
    return Path(package.origin).parent / "datasets" / "data" / "fsaverage5" / f"{name}.gii.gz"


def same(read, mesh, tolerance=0.0):
    np.testing.assert_array_equal(read.faces, mesh.faces)
    np.testing.assert_allclose(read.points, mesh.points, rtol=tolerance, atol=0)
    assert read.points.dtype == np.float64
    assert read.faces.dtype == np.int64


def patch(path, changes):
    """Overwrite bytes of a file at given positions."""
    data = bytearray(path.read_bytes())
    for at, new in changes.items():
        data[at : at + len(new)] = new
    path.write_bytes(data)


def refuses(path, message, read=read_mesh, *arguments):
    with pytest.raises(InputError, match=message) as caught:
        read(path, *arguments)
    assert str(caught.value).startswith(str(path))
    assert str(caught.value).count(str(path)) == 1
    assert "\n" not in str(caught.value)


def glb(content, body=b""):
    """Return a GLB file with a description and binary data."""
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(body), b"BIN\0") + body
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def icosphere(radius, nsub=4):
    """Return points and triangles of a sphere, with points exactly on it up to rounding."""
    ball = pv.Icosphere(radius=1.0, nsub=nsub)
    points = np.asarray(ball.points, dtype=np.float64)
    return radius * points / np.linalg.norm(points, axis=1)[:, None], np.asarray(ball.regular_faces)


def workbench(*words, folder=None):
    """Run `wb_command` and return its output."""
    command = ["wb_command", *map(str, words)]
    return subprocess.run(command, check=True, capture_output=True, text=True, cwd=folder).stdout


def write_old_vtk(path, polydata, is_binary=True):
    """Write a legacy file of version 4.2, like VTK before version 9."""
    from vtkmodules.vtkIOLegacy import vtkPolyDataWriter

    writer = vtkPolyDataWriter()
    writer.SetInputData(polydata)
    writer.SetFileName(str(path))
    writer.SetFileVersion(42)
    (writer.SetFileTypeToBinary if is_binary else writer.SetFileTypeToASCII)()
    writer.Write()


def gifti(path, arrays=None, change=lambda image: None, **options):
    if arrays is None:
        arrays = [(sphere().points.astype("f4"), "pointset"), (sphere().faces.astype("i4"), "triangle")]
    image = nib.gifti.GiftiImage()
    for data, intent in arrays:
        code = f"NIFTI_INTENT_{intent.upper()}"
        image.add_gifti_data_array(nib.gifti.GiftiDataArray(data, code, datatype=data.dtype, **options))
    change(image)
    path.write_bytes(image.to_bytes())
    return path


def write_obj(path, points, faces, places):
    """Write an OBJ file with separate texture coordinates for each corner, like programs that unwrap meshes."""
    lines = [f"v {x:.12g} {y:.12g} {z:.12g}" for x, y, z in points]
    lines += [f"vt {u:.12g} {v:.12g}" for u, v in places.reshape(-1, 2)]
    lines += [f"f {a}/{3 * n + 1} {b}/{3 * n + 2} {c}/{3 * n + 3}" for n, (a, b, c) in enumerate(faces + 1)]
    path.write_text("\n".join(lines) + "\n")
