"""VTK's own formats: ``.vtk`` and ``.vtp``.

VTK reads them, but trusts their headers: on some damaged files it ends the process, of others it returns what it has.
So sizes and counts are taken here first.
"""

from __future__ import annotations

import base64
import importlib
import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.errors import InputError
from voxflat.io import gifti
from voxflat.io.files import require
from voxflat.io.reading import allowed_memory
from voxflat.io.triangles import of_strips, triangulated


def read_vtk(path: Path, data: bytes) -> dict[str, Any]:
    """Read VTK's older format; of a file cut short VTK returns what it has, so the counts are taken here."""
    head = re.match(rb"# vtk DataFile Version (\d+)\.\d+\s*?\n.*\r?\n(ASCII|BINARY)\s+DATASET\s+(\w+)", data, re.I)
    if head is None:
        raise InputError("has a damaged header: copy or download it again")
    if head[3].upper() != b"POLYDATA":
        raise InputError(f"holds {head[3].decode('latin1')}: extract its surface, and write it as POLYDATA")
    _check_fields(data, head.end())
    points = _POINTS.search(data, head.end())
    if points and int(points[1]) < 0:
        raise InputError(f"has {int(points[1])} points by its header, which is damaged: copy it again")
    has_offsets, faces, strips = int(head[1]) >= 5, 0, 0  # from 5.1 on: offsets, one more than there are faces
    for cells in _CELLS.finditer(data, head.end()):
        if cells[2].startswith(b"-") or cells[3].startswith(b"-") or max(int(cells[2]), int(cells[3])) > len(data):
            raise InputError(f"has {int(cells[2])} cells of {int(cells[3])} numbers by its header: copy it again")
        if cells[5]:  # an array of such a name
            continue
        number = int(cells[2]) - has_offsets
        if bool(cells[4]) != has_offsets:
            raise InputError("has cells of another version than its header says: copy or download it again")
        if not has_offsets:
            _check_cells(
                data[cells.end(3) + (1 if head[2].upper() == b"BINARY" else 0) :],
                number,
                int(cells[3]),
                head[2].upper() == b"BINARY",
            )
        faces += number if cells[1].upper() == b"POLYGONS" else 0
        strips += number if cells[1].upper() == b"TRIANGLE_STRIPS" else 0
    counts = int(points[1]) if points else 0, faces, strips
    return _read_polydata(path, "vtkmodules.vtkIOLegacy", "vtkPolyDataReader", *counts)


# VTK takes words wherever they stand; what follows counts is told apart: offsets, or the type of an array of that name
_TYPES = rb"(?:unsigned_|vtk)?(?:bit|char|short|int|long|idtype|typeint64|float|double|string|stdstring|variant)\b"
_CELLS = re.compile(
    rb"(?i)(?<!\S)(LINES|TRIANGLE_STRIPS|POLYGONS|VERTICES)\s+([-+]?\d{1,18})\s+([-+]?\d{1,18})(?!\S)"
    rb"(?:[ \t\r]*\n?(OFF)|\s+(" + _TYPES + rb"))?"
)
_POINTS = re.compile(rb"(?i)(?<!\S)POINTS\s+([-+]?\d+)")
_FIELD = re.compile(rb"(?i)(?<!\S)([-+]?\d+)\s+([-+]?\d+)\s+" + _TYPES)


def _check_fields(data: bytes, start: int) -> None:
    """Check the sizes of arrays of fields, for which VTK reserves memory unseen."""
    field = re.compile(rb"(?i)(?<!\S)FIELD\s").search(data, start)
    for array in _FIELD.finditer(data, field.end()) if field else ():
        width, number = int(array[1]), int(array[2])
        if min(width, number) < 0 or width * number > 8 * len(data):  # of bits eight lie in a byte
            raise InputError(f"has an array of {number} times {width} values by its header: copy it again")


def _check_cells(data: bytes, number: int, size: int, is_binary: bool) -> None:
    """Walk from cell to cell (number of corners, corners) as VTK does, which ends the process if one is damaged."""
    cells = np.frombuffer(data[: 4 * size], ">i4") if is_binary else np.array(data.split(None, size)[:size], np.int64)
    place = 0
    if len(cells) == size == 4 * number and (cells[::4] == 3).all():
        return
    for _ in range(number):
        place += max(int(cells[place]), 0) + 1 if place < len(cells) else 1
    if place != size or len(cells) < size:
        raise InputError(f"has {number} cells of {size} numbers by its header, and not by their own: copy it again")


_VTP_COUNTS = (b"NumberOfPoints", b"NumberOfPolys", b"NumberOfVerts", b"NumberOfLines", b"NumberOfStrips")
_COUNTS = re.compile(rb"(" + b"|".join(_VTP_COUNTS) + rb""")\s*=\s*(?:"([^"<>]*)"|'([^'<>]*)')""")
_ATTRIBUTE = re.compile(rb"""(\w+)\s*=\s*(?:"([^"]*)"|'([^']*)')""")


def _attributes(tag: bytes) -> dict[bytes, bytes]:
    """Return the attributes within a tag."""
    return {name: double or single for name, double, single in _ATTRIBUTE.findall(tag)}


def read_vtp(path: Path, data: bytes) -> dict[str, Any]:
    """Read VTK's XML format."""
    _check_blocks(data)
    named = [(name, int(double or single)) for name, double, single in _COUNTS.findall(data)]
    counts = {name: [count for found, count in named if found == name] for name in _VTP_COUNTS}
    if min(min(numbers, default=0) for numbers in counts.values()) < 0:
        raise InputError("has a negative number of points or cells by its header: copy or download it again")
    sums = (sum(counts[name]) for name in (b"NumberOfPoints", b"NumberOfPolys", b"NumberOfStrips"))
    return _read_polydata(path, "vtkmodules.vtkIOXML", "vtkXMLPolyDataReader", *sums)


def _check_blocks(data: bytes) -> None:
    """Check the sizes in a file's data: VTK reserves memory for them unseen, and ends the process if there is none."""
    _, head = gifti.xml_root(data)
    order = ">" if head.get("byte_order") == "BigEndian" else "<"
    size = np.dtype(order + ("u8" if head.get("header_type") == "UInt64" else "u4"))
    appended = re.search(rb"<AppendedData\b([^<>]*)>\s*_", data)
    encoding = _attributes(appended[1]).get(b"encoding") if appended else None
    for array in re.finditer(rb"<(?:Data)?Array\b([^<>]*)>\s*", data):
        told = _attributes(array[1])
        sizes = [int(told.get(name, b"1")) for name in (b"NumberOfComponents", b"NumberOfTuples")]
        if min(sizes) < 0 or max(sizes) > 8 * len(data):
            raise InputError(f"has an array of {sizes[1]} times {sizes[0]} values by its header: copy it again")
        if appended and b"offset" in told:
            stored, is_raw = data[appended.end() + int(told[b"offset"]) :], encoding == b"raw"
        elif told.get(b"format") == b"binary":
            stored, is_raw = data[array.end() :], False
        else:
            continue
        if "compressor" in head:  # number of blocks, size of one, of the last, and of each when packed
            number = int(_numbers(stored, is_raw, size, 1)[0])
            packed = _numbers(stored, is_raw, size, 3 + min(number, len(stored))).tolist()
            total = number * packed[1] if number else 0
            is_bad = number and (
                len(packed) < 3 + number or not 0 < packed[1] >= packed[2] or max(packed[3:]) > len(data)
            )
        else:
            total = int(_numbers(stored, is_raw, size, 1)[0])
            is_bad = total > len(data)
            if told.get(b"Name") == b"offsets" and not is_bad:
                kind = np.dtype(order + ("i8" if told.get(b"type") == b"Int64" else "i4"))
                corners = _numbers(stored, is_raw, kind, total // kind.itemsize, start=size.itemsize)
                is_bad = max(corners.tolist(), default=0) > len(data)
        if is_bad or total > allowed_memory() // 4:
            raise InputError(f"has an array of {total} bytes by its header, which is damaged: copy it again")


def _numbers(stored: bytes, is_raw: bool, kind: np.dtype[Any], count: int, start: int = 0) -> NDArray[Any]:
    """Return the first numbers, or as many as there are, of data that may be in base64."""
    end = start + count * kind.itemsize
    found = (stored[:end] if is_raw else base64.b64decode(stored[: 4 * -(-end // 3)]))[start:end]
    return np.frombuffer(found, kind, len(found) // kind.itemsize)


def _read_polydata(path: Path, module: str, reader: str, points: int, faces: int, strips: int) -> dict[str, Any]:
    """Read by a class of VTK; what it would print becomes an error."""
    if 24 * (points + faces + strips) > allowed_memory() // 4:  # VTK would end the process
        raise InputError(f"has {points} points and {faces} faces by its header, more than memory may hold")
    pv = require("pyvista")
    messages: list[str] = []

    def listen(_source: object, event: str, message: str) -> None:
        messages.append(message if event == "WarningEvent" else f"error: {message}")

    listen.CallDataType = "string0"  # type: ignore[attr-defined]
    with pv.vtk_verbosity("off"), pv.VtkErrorCatcher(send_to_logging=False) as printed, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # PyVista's, on what is refused below
        source = getattr(importlib.import_module(module), reader)()
        source.AddObserver("ErrorEvent", listen)
        source.AddObserver("WarningEvent", listen)
        source.SetFileName(str(path))
        source.Update()
        mesh = pv.wrap(source.GetOutput())
    messages += [event.alert for event in printed.events]
    if errors := [message for message in messages if "error" in message.lower()]:
        raise InputError(f"VTK says: {errors[0].strip().splitlines()[-1]}: copy or download it again")
    return _polydata_parts(mesh, points, faces, strips)


def polydata_triangles(mesh: Any) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """Return the triangles of a mesh of PyVista, and what was cut to make them: its polygons first, then its strips."""
    if mesh.n_lines:
        raise InputError(f"has {mesh.n_lines} lines beside its faces: remove them, mesh.SetLines(None)")
    if mesh.n_strips == 0 and mesh.GetPolys().GetNumberOfCells() and mesh.is_all_triangles:
        return np.asarray(mesh.regular_faces, dtype=np.int64).reshape(-1, 3), ()
    offsets, corners = (
        np.asarray(importlib.import_module("vtkmodules.util.numpy_support").vtk_to_numpy(array)).astype(np.int64)
        for array in (mesh.GetPolys().GetOffsetsArray(), mesh.GetPolys().GetConnectivityArray())
    )
    places, remarks = triangulated(np.asarray(mesh.points, dtype=np.float64), corners, np.diff(offsets))
    strips, at = [], 0
    while at < len(mesh.strips):
        strips.append(np.asarray(mesh.strips[at + 1 : at + 1 + mesh.strips[at]], dtype=np.int64))
        at += 1 + len(strips[-1])
    of_all = of_strips(strips)
    if strips:
        remarks = (*remarks, f"{len(strips)} strips were cut into {len(of_all)} triangles")
    return np.concatenate([corners[places], of_all]), remarks


def _polydata_parts(mesh: Any, points: int, faces: int, strips: int) -> dict[str, Any]:
    """Return what a mesh of PyVista holds, after a check against its file's header."""
    for found, named, what in (
        (mesh.n_points, points, "points"),
        (mesh.GetPolys().GetNumberOfCells(), faces, "faces"),
        (mesh.n_strips, strips, "strips"),
    ):
        if found != named:
            raise InputError(f"has {found} {what}, by its header {named}: copy or download it again")
    triangles, remarks = polydata_triangles(mesh)
    texture = mesh.active_texture_coordinates
    point_data = {name: np.asarray(array) for name, array in mesh.point_data.items()}
    return {
        "points": np.array(mesh.points),
        "faces": triangles,
        "remarks": remarks,
        "point_data": {name: array for name, array in point_data.items() if array.dtype.kind in "biuf"},
        "texture_coordinates": None if texture is None else np.array(texture),
    }


def write_vtp(
    path: Path,
    points: NDArray[np.float64],
    faces: NDArray[np.int64],
    texture: NDArray[np.float64] | None,
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
        writer.WriteToOutputStringOn()  # VTK 9.7 ends the process where a file cannot be written to its end
        writer.Write()
    path.write_bytes(writer.GetOutputString().encode())
