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
    *counted, parts = read_in_subprocess(_read_polydata, "vtkmodules", path, module, reader)
    names = ("points", "faces", "corners of faces", "strips", "corners of strips")
    for there, specified, name in zip(counted, counts, names, strict=True):
        if specified is not None and there != specified:
            raise InputError(f"has {there} {name}, but its header specifies {specified}. {AGAIN}")
    return {**parts, "warnings": tuple(parts["warnings"])}


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
    cells = [(c.GetNumberOfCells(), c.GetNumberOfConnectivityIds()) for c in (mesh.GetPolys(), mesh.GetStrips())]
    parts, _ = dataset_parts(mesh)
    return mesh.GetNumberOfPoints(), *cells[0], *cells[1], parts


def as_numpy(array: Any) -> NDArray[Any]:
    """Return a numeric VTK array as a NumPy array."""
    return np.asarray(importlib.import_module("vtkmodules.util.numpy_support").vtk_to_numpy(array))


_POINT, _CELL = "voxflat_point", "voxflat_cell"


def dataset_parts(dataset: Any) -> tuple[dict[str, Any], NDArray[np.int64]]:
    """Return the outer surface of a vtkDataSet, with its own points and data, as parts of a `Mesh`.

    Also return the cell of each triangle. Lines and points without faces are left out.
    """
    if not dataset.GetNumberOfPoints():
        raise InputError("has no points. Pass a surface mesh")
    points = as_numpy(dataset.GetPoints().GetData()).astype(np.float64, copy=False)
    if hasattr(dataset, "GetStrips"):
        faces, cells, warnings = _polydata_triangles(dataset, points)
    else:
        surface = _outside(dataset)
        places = as_numpy(surface.GetPoints().GetData()) if surface.GetNumberOfPolys() else points[:0]
        faces, cells, warnings = _polydata_triangles(surface, places)
    if not len(faces):
        raise InputError(
            f"has no faces, only {dataset.GetNumberOfCells()} cells without area. Pass a dataset with a surface"
        )
    if not hasattr(dataset, "GetStrips"):
        faces = as_numpy(surface.GetPointData().GetArray(_POINT)).astype(np.int64)[faces]
        cells = as_numpy(surface.GetCellData().GetArray(_CELL)).astype(np.int64)[cells]
    texture = dataset.GetPointData().GetTCoords()
    parts: dict[str, Any] = {"points": points, "faces": faces, "warnings": warnings}
    parts["point_data"] = _arrays(dataset.GetPointData(), texture)
    parts["face_data"] = {name: array[cells] for name, array in _arrays(dataset.GetCellData()).items()}
    parts["texture_coordinates"] = None if texture is None else as_numpy(texture)[:, :2].astype(np.float64)
    return parts, cells


def _arrays(data: Any, texture: Any = None) -> dict[str, NDArray[Any]]:
    """Return the numeric arrays of the points or cells of a dataset that have names."""
    arrays = [data.GetArray(number) for number in range(data.GetNumberOfArrays())]  # None for text arrays
    return {array.GetName(): as_numpy(array) for array in arrays if array and array is not texture and array.GetName()}


def _outside(dataset: Any) -> Any:
    """Return the outer surface of a dataset, whose arrays hold the numbers of the points and cells of the dataset."""
    support = importlib.import_module("vtkmodules.util.numpy_support")
    numbered = dataset.NewInstance()
    numbered.CopyStructure(dataset)
    of_points, of_cells = (numbered.GetPointData(), _POINT), (numbered.GetCellData(), _CELL)
    counts = dataset.GetNumberOfPoints(), dataset.GetNumberOfCells()
    for (data, name), count in zip((of_points, of_cells), counts, strict=True):
        array = support.numpy_to_vtk(np.arange(count), deep=True)
        array.SetName(name)
        data.AddArray(array)
    if numbered.GetClassName() == "vtkExplicitStructuredGrid":  # the filter below does not set its cell data
        filters = importlib.import_module("vtkmodules.vtkFiltersCore")
        as_cells = filters.vtkExplicitStructuredGridToUnstructuredGrid()
        as_cells.SetInputData(numbered)
        as_cells.Update()
        numbered = as_cells.GetOutput()
    outside = importlib.import_module("vtkmodules.vtkFiltersGeometry").vtkDataSetSurfaceFilter()
    outside.SetInputData(numbered)
    outside.Update()
    return outside.GetOutput()


def _polydata_triangles(mesh: Any, points: Points) -> tuple[Faces, NDArray[np.int64], tuple[str, ...]]:
    """Return the triangles of a vtkPolyData, polygons before strips, the cell of each, and warnings."""
    others = mesh.GetNumberOfVerts() + mesh.GetNumberOfLines()  # these cells come first
    polygons, strips = mesh.GetPolys(), mesh.GetStrips()
    none = np.empty((0, 3), dtype=np.int64)
    faces, cells, warnings = [none], [none[:, 0]], list[str]()
    if polygons.GetNumberOfCells():
        offsets, corners = (
            as_numpy(array).astype(np.int64) for array in (polygons.GetOffsetsArray(), polygons.GetConnectivityArray())
        )
        places, of_polygons = triangulated(points, corners, np.diff(offsets))
        faces.append(corners[places])
        cells.append(np.searchsorted(offsets, places[:, 0], side="right") - 1 + others)
        warnings += of_polygons
    if strips.GetNumberOfCells():
        offsets, corners = (
            as_numpy(array).astype(np.int64) for array in (strips.GetOffsetsArray(), strips.GetConnectivityArray())
        )
        faces.append(of_strips(np.split(corners, offsets[1:-1])))
        first = others + polygons.GetNumberOfCells()
        cells.append(np.repeat(first + np.arange(len(offsets) - 1), np.maximum(np.diff(offsets) - 2, 0)))
        warnings.append(f"{len(offsets) - 1} strips were split into {len(faces[-1])} triangles")
    if others and len(cells) > 1:
        warnings.append(f"{others} lines and points beside its faces were left out")
    return np.concatenate(faces), np.concatenate(cells), tuple(warnings)


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
