"""Read ``.vtk`` and ``.vtp`` in the child process. VTK accepts incomplete files, so this module checks the counts."""

import importlib
import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.errors import InputError
from voxflat.io.files import AGAIN, require
from voxflat.io.subprocess_reader import read_in_subprocess
from voxflat.io.triangles import Faces, Points, of_strips, triangulated


def read_vtk(path: Path, data: bytes) -> dict[str, Any]:
    """Read a file in the legacy VTK format."""
    head = re.match(rb"# vtk DataFile Version (\d+)\.\d+\s*?\n.*\r?\n(?:ASCII|BINARY)\s+DATASET\s+(\w+)", data, re.I)
    if head is None:
        raise InputError(f"has a damaged header. {AGAIN}")
    if head[2].upper() != b"POLYDATA":
        raise InputError(f"has dataset type {head[2].decode('latin1')}. Extract its surface, and save it as POLYDATA")
    points = _POINTS.search(data, head.end())
    has_offsets, faces, strips = int(head[1]) >= 5, [0, 0], [0, 0]  # version 5.1 or later: one more offset than faces
    for name, number, size, offsets, array in _CELLS.findall(data, head.end()):
        if array:  # an array with this name
            continue
        if bool(offsets) != has_offsets:
            raise InputError(f"the version of its cells differs from the version in its header. {AGAIN}")
        cells = int(number) - has_offsets
        corners = int(size) - (0 if has_offsets else cells)
        found = faces if name.upper() == b"POLYGONS" else strips
        found[:] = found[0] + cells, found[1] + corners
    return _by_vtk(path, "vtkIOLegacy", "vtkPolyDataReader", [int(points[1]) if points else 0, *faces, *strips])


# VTK accepts keywords anywhere; counts are followed by offsets, or by the type of an array with that name
_TYPES = rb"(?:unsigned_|vtk)?(?:bit|char|short|int|long|idtype|typeint64|float|double)\b"
_CELLS = re.compile(
    rb"(?i)(?<!\S)(TRIANGLE_STRIPS|POLYGONS)\s+([-+]?\d{1,18})\s+([-+]?\d{1,18})(?!\S)"
    rb"(?:[ \t\r]*\n?(OFF)|\s+(" + _TYPES + rb"))?"
)
_POINTS = re.compile(rb"(?i)(?<!\S)POINTS\s+([-+]?\d{1,18})")

_COUNTS = re.compile(rb"""\bNumberOf(Points|Polys|Strips)\s*=\s*["'](\d{1,18})["']""")


def read_vtp(path: Path, data: bytes) -> dict[str, Any]:
    """Read a file in the XML-based VTK format."""
    totals = Counter[bytes]()
    for name, count in _COUNTS.findall(data):
        totals[name] += int(count)
    points, faces, strips = (totals[name] for name in (b"Points", b"Polys", b"Strips"))
    return _by_vtk(path, "vtkIOXML", "vtkXMLPolyDataReader", [points, faces, None, strips, None])


def _by_vtk(path: Path, module: str, reader: str, counts: list[int | None]) -> dict[str, Any]:
    """Read a file with a VTK class, and compare the numbers of points, faces, strips and corners with the header."""
    *found, parts = read_in_subprocess(_read_polydata, "vtkmodules", path, module, reader)
    names = ("points", "faces", "corners of faces", "strips", "corners of strips")
    for there, told, name in zip(found, counts, names, strict=True):
        if told is not None and there != told:
            raise InputError(f"has {there} {name}, but its header specifies {told}. {AGAIN}")
    return {**parts, "remarks": tuple(parts["remarks"])}


def _read_polydata(path: Path, module: str, reader: str) -> tuple[Any, ...]:
    """Read a file in the child process; return the counts for `_by_vtk` and the parts of a `Mesh`."""
    core = importlib.import_module("vtkmodules.vtkCommonCore")
    window = core.vtkStringOutputWindow()
    core.vtkOutputWindow.SetInstance(window)
    source = getattr(importlib.import_module(f"vtkmodules.{module}"), reader)()
    source.SetFileName(str(path))
    source.Update()
    printed = re.split(r"\n\s*\n", window.GetOutput().strip())
    if errors := [message for message in printed if "error" in message.lower()]:
        said = re.sub(r"^\w+ \(0x\w+\): ", "", errors[0].splitlines()[-1].strip())
        raise InputError(f"VTK reports: {said}. {AGAIN}")
    mesh = source.GetOutput()
    cells = [(of.GetNumberOfCells(), of.GetNumberOfConnectivityIds()) for of in (mesh.GetPolys(), mesh.GetStrips())]
    triangles, remarks = polydata_triangles(mesh)
    data, texture = mesh.GetPointData(), mesh.GetPointData().GetTCoords()
    arrays = [data.GetArray(number) for number in range(data.GetNumberOfArrays())]  # None for text arrays
    parts = {"points": _as_numpy(mesh.GetPoints().GetData()), "faces": triangles, "remarks": remarks}
    parts["point_data"] = {array.GetName(): _as_numpy(array) for array in arrays if array and array is not texture}
    parts["texture_coordinates"] = None if texture is None else _as_numpy(texture)
    return mesh.GetNumberOfPoints(), *cells[0], *cells[1], parts


def _as_numpy(array: Any) -> NDArray[Any]:
    """Return a numeric VTK array as a NumPy array."""
    return np.asarray(importlib.import_module("vtkmodules.util.numpy_support").vtk_to_numpy(array))


def polydata_triangles(mesh: Any) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """Return the triangles of a vtkPolyData, polygons before strips, and remarks on polygons that were split."""
    if mesh.GetNumberOfLines():
        raise InputError(f"has lines ({mesh.GetNumberOfLines()}) in addition to its faces. Remove the lines")
    if not mesh.GetNumberOfPoints():
        raise InputError("has no points. Pass a surface mesh")
    arrays = [(of.GetOffsetsArray(), of.GetConnectivityArray()) for of in (mesh.GetPolys(), mesh.GetStrips())]
    (offsets, corners), (starts, strip_corners) = [[_as_numpy(one).astype(np.int64) for one in of] for of in arrays]
    places, remarks = triangulated(polydata_points(mesh), corners, np.diff(offsets))
    if not len(strip_corners):
        return corners[places], remarks
    strips = np.split(strip_corners, starts[1:-1])
    of_all = of_strips(strips)
    remarks = (*remarks, f"{len(strips)} strips were split into {len(of_all)} triangles")
    return np.concatenate([corners[places], of_all]), remarks


def grid_triangles(grid: Any) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """Return the triangles of the outer surface of a vtkPointSet, as numbers of its own points, and remarks."""
    if not grid.GetNumberOfPoints():
        raise InputError("has no points. Pass a surface mesh")
    outside = importlib.import_module("vtkmodules.vtkFiltersGeometry").vtkDataSetSurfaceFilter()
    outside.PassThroughPointIdsOn()
    outside.SetInputData(grid)
    outside.Update()
    surface = outside.GetOutput()
    if not surface.GetNumberOfPolys() + surface.GetNumberOfStrips():
        raise InputError(
            f"has no faces, only {grid.GetNumberOfCells()} cells without area. Pass a dataset with a surface"
        )
    faces, remarks = polydata_triangles(surface)
    numbers = _as_numpy(surface.GetPointData().GetArray(outside.GetOriginalPointIdsName()))
    return numbers.astype(np.int64)[faces], remarks


def polydata_points(mesh: Any) -> NDArray[np.float64]:
    """Return the points of a vtkPolyData or another vtkPointSet."""
    return _as_numpy(mesh.GetPoints().GetData()).astype(np.float64, copy=False)


def polydata_texture(mesh: Any) -> NDArray[np.float64] | None:
    """Return the texture coordinates of the points of a vtkPolyData, or None if there are none."""
    texture = mesh.GetPointData().GetTCoords()
    return None if texture is None else _as_numpy(texture)[:, :2].astype(np.float64)


def write_vtp(
    path: Path,
    points: Points,
    faces: Faces,
    texture: Points | None,
    point_data: Mapping[str, NDArray[Any]],
    face_data: Mapping[str, NDArray[Any]],
) -> None:
    """Write a ``.vtp`` file."""
    pv = require("pyvista")
    with pv.VtkErrorCatcher(raise_errors=True, send_to_logging=False):
        polydata = pv.PolyData.from_regular_faces(points, faces)
        for name, array in point_data.items():
            polydata.point_data[name] = array
        for name, array in face_data.items():
            polydata.cell_data[name] = array
        if texture is not None:
            polydata.active_texture_coordinates = texture
        writer = importlib.import_module("vtkmodules.vtkIOXML").vtkXMLPolyDataWriter()
        writer.SetInputData(polydata)
        writer.SetDataModeToBinary()
        writer.SetCompressorTypeToZLib()
        writer.WriteToOutputStringOn()  # VTK 9.7 crashes if a file cannot be written completely
        writer.Write()
    path.write_bytes(writer.GetOutputString().encode())
