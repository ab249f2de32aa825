"""Read and write PLY files without VTK, because damaged files crash VTK 9.7."""

import re
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from voxflat.errors import InputError
from voxflat.io.files import AGAIN, REMEDY
from voxflat.io.triangles import TRIANGULATE, Faces, Points, first_coordinates, of_strips, triangulated

_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
_TYPES |= {"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"}
_TYPES |= {"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"}
_TEXT = "="  # byte order of ASCII files, whose numbers are read as native doubles
_ORDERS = {"ascii": _TEXT, "binary_little_endian": "<", "binary_big_endian": ">"}
_COLOURS = ("red", "green", "blue", "alpha")
_OF_CORNERS = "texcoord"  # of faces, as MeshLab writes them
_TEXTURES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))


def read_ply(path: Path, data: bytes) -> dict[str, Any]:
    """Read a PLY file of polygons or triangle strips; a point on a seam keeps its first texture coordinate."""
    return _read(data)[0]


def read_ply_texture(data: bytes) -> tuple[NDArray[np.int64], NDArray[np.float64]] | None:
    """Read the faces and their corners' texture coordinates (F, 3, 2), or None if those are stored at the points."""
    read, coordinates = _read(data)
    return None if coordinates is None else (read["faces"], coordinates)


def _read(data: bytes) -> tuple[dict[str, Any], NDArray[np.float64] | None]:
    """Return the parts of a mesh, and the texture coordinates of the corners of its faces, if the faces have them."""
    header = re.match(rb"(?s)ply(\r?\n|\r)(.*?)\1end_header\1", data)
    if header is None:
        raise InputError("has no header from 'ply' to 'end_header'. Check that it is a PLY file")
    form, elements = _header(header[2].decode("latin1"))
    body, order = data[header.end() :], _ORDERS[form]
    if order == _TEXT:
        body = np.fromiter(map(float, body.split()), np.float64).tobytes()
    vertices: NDArray[Any] = np.empty(0)
    lists, offset = None, 0
    for element in elements:
        name, count, _ = element
        if name in ("face", "tristrips") and (count or name == "tristrips"):
            lists, offset = _lists(body, offset, element, order)
        else:
            table = _table(body, offset, element, order)
            offset += table.nbytes
            vertices = table if name == "vertex" else vertices
        if len(vertices) and lists is not None:
            break  # other elements are ignored
    names = vertices.dtype.names or ()
    if not {"x", "y", "z"} <= set(names) or lists is None:
        raise InputError(f"has no vertices with x, y and z, or no faces with vertex_indices. {REMEDY}")
    points = np.column_stack([vertices[axis] for axis in "xyz"]).astype(np.float64)
    corners, counts, of_corners = lists
    stored: NDArray[np.float64] | None = None
    if any(name == "tristrips" for name, _, _ in elements):
        rows = np.split(corners, np.cumsum(counts)[:-1])  # strips may share a list, with −1 between them
        split = [strip[strip >= 0] for row in rows for strip in np.split(row, np.flatnonzero(row == -1))]
        strips = [strip for strip in split if len(strip)]
        faces = of_strips(strips)
        warnings: tuple[str, ...] = (f"{len(strips)} strips were split into {len(faces)} triangles",)
    else:
        places, warnings = triangulated(points, corners, counts)
        faces = corners[places]
        stored = None if of_corners is None else of_corners[places]
    texture = next((pair for pair in _TEXTURES if set(pair) <= set(names)), ())
    coordinates = np.column_stack([vertices[key] for key in texture]) if texture else None
    if coordinates is None and stored is not None:
        coordinates, seam = first_coordinates(stored, faces, len(points))
        warnings += seam
    others = [key for key in names if key not in ("x", "y", "z", *texture) and not key.endswith(" length")]
    values = {x: vertices[x].astype(vertices[x].dtype.newbyteorder("=")) for x in others if vertices[x].ndim == 1}
    more = {"warnings": warnings, "texture_coordinates": coordinates, "point_data": values}
    return {"points": points, "faces": faces, **more}, stored


_Element: TypeAlias = tuple[str, int, list[tuple[str, str, str]]]
"""Name, count, and the name, type and type of the list length ('' if it is not a list) of each property."""

_Lists: TypeAlias = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64] | None]
"""The concatenated corners of all faces, the number of corners of each face, and texture coordinates (C, 2) or None."""


def _header(text: str) -> tuple[str, list[_Element]]:
    """Return the format and the elements."""
    form = ""
    elements: list[_Element] = []
    for line in text.splitlines():
        words = line.split()
        if words[:1] == ["format"] and len(words) == 3:
            form = words[1]
        elif words[:1] == ["element"] and len(words) == 3 and words[2].isdigit():
            elements.append((words[1], int(words[2]), []))
        elif words[:2] == ["property", "list"] and len(words) == 5 and elements:
            elements[-1][2].append((words[4], _TYPES[words[3]], _TYPES[words[2]]))
        elif words[:1] == ["property"] and len(words) == 3 and elements:
            elements[-1][2].append((words[2], _TYPES[words[1]], ""))
        elif words and words[0] not in ("comment", "obj_info"):
            raise InputError(f"its header has the line {line!r}, which is not part of the PLY format. Remove it")
    if form not in _ORDERS:
        raise InputError(f"its format is {form!r}. Save it in one of the formats {', '.join(_ORDERS)}")
    return form, elements


def _stored(kind: str, order: str) -> np.dtype[Any]:
    return np.dtype("f8" if order == _TEXT else order + kind)


def _table(body: bytes, offset: int, element: _Element, order: str) -> NDArray[Any]:
    """Return the rows of an element; all its lists must have the same lengths as those in the first row."""
    layout: list[Any] = []
    name, count, properties = element
    if count == 0 or not properties:
        return np.empty(0)
    for key, kind, length_kind in properties:
        value_type, length_type = (_stored(code or kind, order) for code in (kind, length_kind))
        if length_kind:
            place = offset + np.dtype(layout).itemsize
            length = int(np.frombuffer(body[place : place + length_type.itemsize], length_type)[0])
            if not 0 <= length <= len(body):
                raise InputError(f"{name} 0 has {length} corners, more than the file contains. {AGAIN}")
            layout += [(f"{key} length", length_type), (key, value_type, (length,))]
        else:
            layout.append((key, value_type))
    dtype = np.dtype(layout)
    rows = np.frombuffer(body, dtype, min(count, (len(body) - offset) // dtype.itemsize), offset)
    for key in (key for key in dtype.names or () if key.endswith(" length")):
        other = np.flatnonzero(rows[key] != rows[key][:1])
        if len(other):
            here, first = (int(rows[key][row]) for row in (other[0], 0))
            raise InputError(f"{name} {other[0]} has {here} corners, but {name} 0 has {first}. {TRIANGULATE}")
    if len(rows) < count:
        raise InputError(f"ends at {name} {len(rows)} of {count}. {AGAIN}")
    return rows


def _lists(body: bytes, offset: int, element: _Element, order: str) -> tuple[_Lists | None, int]:
    """Return the corners of all faces, if the element has any, and the next element's offset."""
    names = [key for key, _, is_list in element[2] if is_list and key in ("vertex_indices", "vertex_index")]
    if not names:
        return None, offset + _table(body, offset, element, order).nbytes
    try:
        table = _table(body, offset, element, order)
    except InputError:  # its lists have different lengths, or the file is incomplete
        return _uneven(body, offset, element, order, names[0])
    rows = table[names[0]] if element[1] else np.empty((0, 3))
    counts = np.full(len(rows), rows.shape[1], dtype=np.int64)
    stored = table[_OF_CORNERS] if _OF_CORNERS in (table.dtype.names or ()) else None
    return (_whole(rows.ravel(), counts), counts, _of_corners(stored, counts)), offset + table.nbytes


def _uneven(body: bytes, offset: int, element: _Element, order: str, key: str) -> tuple[_Lists, int]:
    """Read an element whose lists have different lengths, row by row."""
    name, count, properties = element
    kinds = [(key_, _stored(code, order), _stored(size or code, order), size) for key_, code, size in properties]
    rows, stored = [], []
    for row in range(count):
        for list_name, kind, length_kind, is_list in kinds:
            length = 1
            if is_list and offset + length_kind.itemsize <= len(body):
                number = float(np.frombuffer(body, length_kind, 1, offset)[0])
                length = int(number) if number >= 0 and number % 1 == 0 else len(body)
                offset += length_kind.itemsize
            if offset + length * kind.itemsize > len(body):
                raise InputError(f"ends at {name} {row} of {count}. {AGAIN}")
            if list_name == key:
                rows.append(np.frombuffer(body, kind, length, offset))
            elif list_name == _OF_CORNERS:
                stored.append(np.frombuffer(body, kind, length, offset))
            offset += length * kind.itemsize
    counts = np.array([len(line) for line in rows], dtype=np.int64)
    return (_whole(np.concatenate(rows), counts), counts, _of_corners(stored or None, counts)), offset


def _of_corners(
    stored: list[NDArray[Any]] | NDArray[Any] | None, counts: NDArray[np.int64]
) -> NDArray[np.float64] | None:
    """Return the texture coordinates of corners, (C, 2); NaN for faces without two numbers for each corner."""
    if stored is None:
        return None
    fits = np.array([len(row) for row in stored], dtype=np.int64) == 2 * counts
    places = np.full((int(counts.sum()), 2), np.nan)
    if fits.any():
        places[np.repeat(fits, counts)] = np.concatenate([stored[n] for n in np.flatnonzero(fits)]).reshape(-1, 2)
    return places if fits.any() else None


def _whole(numbers: NDArray[Any], counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Convert point numbers that were read as floating-point values."""
    bad = np.flatnonzero(numbers % 1 != 0)
    if len(bad):
        face = int(np.searchsorted(np.cumsum(counts), bad[0], side="right"))
        start = int(counts[:face].sum())
        corners = numbers[start : start + counts[face]].tolist()
        raise InputError(f"face {face} has the corners {corners}. Write corners as whole numbers")
    return np.asarray(numbers.astype(np.int64))


def write_ply(
    path: Path, points: Points, faces: Faces, texture: Points | None, colours: NDArray[np.uint8] | None = None
) -> None:
    """Write a little-endian PLY file; point colours consist of red, green, blue and optionally alpha."""
    columns: dict[str, NDArray[Any]] = dict(zip("xyz", points.T, strict=True))
    if texture is not None:
        columns |= dict(zip("st", texture.T, strict=True))
    if colours is not None:
        columns |= dict(zip(_COLOURS, colours.T, strict=False))
    kinds = {name: "uchar" if name in _COLOURS else "double" for name in columns}
    dtype = [(name, "<" + _TYPES[kind]) for name, kind in kinds.items()]
    vertices = np.rec.fromarrays(list(columns.values()), dtype=dtype)
    rows = np.empty(len(faces), [("length", "u1"), ("corners", "<i4", 3)])
    rows["length"], rows["corners"] = 3, faces
    lines = ["ply", "format binary_little_endian 1.0", "comment voxflat", f"element vertex {len(vertices)}"]
    lines += [f"property {kind} {name}" for name, kind in kinds.items()]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    path.write_bytes("\n".join(lines).encode() + vertices.tobytes() + rows.tobytes())
