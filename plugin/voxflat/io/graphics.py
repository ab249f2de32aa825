"""The formats of computer graphics: PLY, STL, OBJ.

They are parsed here: on damaged PLY files VTK 9.7 ends the process, the points of OBJ files with texture coordinates it
numbers anew, and files of all three that are cut short it may take as whole.
"""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from voxflat.errors import InputError
from voxflat.io import freesurfer
from voxflat.io.readers import REMEDY

TRIANGULATE = "triangulate first, e.g. mesh.triangulate() of PyVista"


def refuse_corners(counts: Counter[int]) -> None:
    """Refuse faces that are no triangles, naming what they are."""
    others = [(corners, number) for corners, number in sorted(counts.items()) if corners != 3]
    if others:
        found = ", ".join(f"{n} face{'s have' if n > 1 else ' has'} {corners} corners" for corners, n in others)
        raise InputError(f"{found}; {TRIANGULATE}")


_PLY_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
_PLY_TYPES |= {"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"}
_PLY_TYPES |= {"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"}
_PLY_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_PLY_COLOURS = ("red", "green", "blue", "alpha")
_PLY_TEXTURES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))


def read_ply(path: Path, data: bytes) -> dict[str, Any]:
    """Read a PLY file of triangles."""
    header = re.match(rb"(?s)ply(\r?\n|\r)(.*?)\1end_header\1", data)
    if header is None:
        raise InputError("has no header from 'ply' to 'end_header': is it a PLY file?")
    form, elements = _ply_header(header[2].decode("latin1"))
    body, order = data[header.end() :], _PLY_ORDERS[form]
    if form == "ascii":  # as if it were binary, of doubles alone
        body = np.fromiter(map(float, body.split()), np.float64).tobytes()
    tables: dict[str, NDArray[Any]] = {}
    at = 0
    for name, count, properties in elements:
        tables[name] = _ply_table(body, at, name, count, properties, order, form == "ascii")
        at += tables[name].nbytes
        if {"vertex", "face"} <= set(tables):
            break  # what follows does not matter
    vertices, faces = tables.get("vertex", np.empty(0)), tables.get("face", np.empty(0))
    names = vertices.dtype.names or ()
    key = next((key for key in ("vertex_indices", "vertex_index") if key in (faces.dtype.names or ())), None)
    if not {"x", "y", "z"} <= set(names) or key is None:
        raise InputError(f"has no vertices with x, y, z, or no faces with vertex_indices: {REMEDY}")
    refuse_corners(Counter({faces[key].shape[1]: len(faces)}))
    texture = next((pair for pair in _PLY_TEXTURES if set(pair) <= set(names)), ())
    return {
        "points": np.column_stack([vertices[axis] for axis in "xyz"]).astype(np.float64),
        "faces": _whole(faces[key]),
        "texture_coordinates": np.column_stack([vertices[key] for key in texture]) if texture else None,
        "point_data": {
            key: vertices[key].astype(vertices[key].dtype.newbyteorder("="))
            for key in names
            if vertices[key].ndim == 1 and key not in ("x", "y", "z", *texture) and not key.endswith(" length")
        },
    }


_Properties: TypeAlias = list[tuple[str, str, str]]
"""Of each property: name, type, and the type of a list's length, or ''."""


def _ply_header(text: str) -> tuple[str, list[tuple[str, int, _Properties]]]:
    """Return the format, and of each element name, number and properties."""
    form = ""
    elements: list[tuple[str, int, _Properties]] = []
    for line in text.splitlines():
        words = line.split()
        if words[:1] == ["format"] and len(words) == 3:
            form = words[1]
        elif words[:1] == ["element"] and len(words) == 3 and words[2].isdigit():
            elements.append((words[1], int(words[2]), []))
        elif words[:2] == ["property", "list"] and len(words) == 5 and elements:
            elements[-1][2].append((words[4], _PLY_TYPES[words[3]], _PLY_TYPES[words[2]]))
        elif words[:1] == ["property"] and len(words) == 3 and elements:
            elements[-1][2].append((words[2], _PLY_TYPES[words[1]], ""))
        elif words and words[0] not in ("comment", "obj_info"):
            raise InputError(f"its header has the line {line!r}, which no PLY file has")
    if form not in _PLY_ORDERS:
        raise InputError(f"its format is {form!r}: write it as one of {', '.join(_PLY_ORDERS)}")
    return form, elements


def _ply_table(
    body: bytes, at: int, name: str, count: int, properties: _Properties, order: str, is_ascii: bool
) -> NDArray[Any]:
    """Return an element's rows; its lists must all be as long as in the first row."""
    layout: list[Any] = []
    if count == 0 or not properties:
        return np.empty(0)
    for key, kind, length_kind in properties:
        value_type, length_type = (np.dtype("f8" if is_ascii else order + (one or kind)) for one in (kind, length_kind))
        if length_kind:
            place = at + np.dtype(layout).itemsize
            length = int(np.frombuffer(body[place : place + length_type.itemsize], length_type)[0])
            layout += [(f"{key} length", length_type), (key, value_type, (length,))]
        else:
            layout.append((key, value_type))
    dtype = np.dtype(layout)
    rows = np.frombuffer(body, dtype, min(count, (len(body) - at) // dtype.itemsize), at)
    for key in (key for key in dtype.names or () if key.endswith(" length")):
        other = np.flatnonzero(rows[key] != rows[key][:1])
        if len(other):
            here, first = (int(rows[key][row]) for row in (other[0], 0))
            raise InputError(f"{name} {other[0]} has {here} corners, {name} 0 has {first}; {TRIANGULATE}")
    if len(rows) < count:
        raise InputError(f"ends in {name} {len(rows)} of {count}: copy or download it again")
    return rows


def _whole(numbers: NDArray[Any]) -> NDArray[np.int64]:
    """Take numbers of points that were read as floating-point ones."""
    bad = np.flatnonzero((numbers % 1 != 0).any(axis=1))
    if len(bad):
        raise InputError(f"face {bad[0]} is {numbers[bad[0]].tolist()}: corners must be whole numbers")
    return np.asarray(numbers.astype(np.int64))


_STL_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def is_binary_stl(data: bytes) -> bool:
    """Tell whether a file is as long as its header would have it if it were binary STL."""
    return len(data) >= 84 and len(data) == 84 + 50 * int.from_bytes(data[80:84], "little")


def read_stl(path: Path, data: bytes) -> dict[str, Any]:
    """Read an STL file; equal corners become one point."""
    if data.lstrip()[:5].lower() == b"solid" and not is_binary_stl(data):
        text = data.lower()
        found = re.findall(rb"(?m)^\s*vertex\s+(\S+)\s+(\S+)\s+(\S+)\s*$", text)
        number = len(re.findall(rb"(?m)^\s*facet\b", text))
        if len(found) != 3 * number or b"endsolid" not in text[-200:]:
            raise InputError(f"has {len(found)} corners in {number} facets, or no end: copy or download it again")
        corners = np.array(found, dtype=np.float64).reshape(-1, 3)
    else:
        number = int.from_bytes(data[80:84], "little")
        if len(data) < 84 + _STL_FACET.itemsize * number:
            raise InputError(f"has {number} faces by its header, but ends after {len(data)} bytes: copy it again")
        corners = np.frombuffer(data, _STL_FACET, number, 84)["corners"].reshape(-1, 3).astype(np.float64)
    rows = np.ascontiguousarray(corners + 0.0).view("V24").ravel()  # + 0.0, so that −0 is 0
    _, first, place = np.unique(rows, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))
    points, faces = corners[np.sort(first)], rank[place].reshape(-1, 3)
    remark = f"STL knows no points: {len(corners)} corners with {len(points)} different places became as many points"
    return {"points": points, "faces": faces, "remarks": (remark,)}


def read_obj(path: Path, data: bytes) -> dict[str, Any]:
    """Read an OBJ file with its own numbers of points.

    A point may have several texture coordinates there, where a seam of the texture passes; it keeps the first.
    """
    rows, faces, used = _obj_tables(data)
    points = np.array([row[:3] for row in rows["v"]], dtype=np.float64)
    texture = None
    remarks: tuple[str, ...] = () if data.endswith(b"\n") else ("does not end with a whole line: is it complete?",)
    if (used != -1).any():
        texture, seam = _obj_texture(_obj_places(rows["vt"], used), used, faces, len(points))
        remarks += seam
    return {"points": points, "faces": faces, "texture_coordinates": texture, "remarks": remarks}


def read_obj_texture(data: bytes) -> tuple[NDArray[np.int64], NDArray[np.float64], dict[str, set[str]]]:
    """Read the texture coordinates of each corner of an OBJ file's faces.

    Returns
    -------
    faces : ndarray, shape (F, 3)
    coordinates : ndarray, shape (F, 3, 2)
        NaN where there are none.
    names : dict
        Of each of mtllib and usemtl what follows it.
    """
    rows, faces, used = _obj_tables(data)
    freesurfer.check_faces(faces, len(rows["v"]))
    places = np.concatenate([_obj_places(rows["vt"], used), [[np.nan, np.nan]]])  # to which −1 leads
    text = data.decode("utf-8", "replace")
    names = {key: set(re.findall(rf"(?m)^\s*{key}\s+(.*?)\s*$", text)) for key in ("mtllib", "usemtl")}
    return faces, places[used], names


def _obj_tables(data: bytes) -> tuple[dict[str, list[list[str]]], NDArray[np.int64], NDArray[np.int64]]:
    """Return an OBJ file's lines, and of each corner of its faces the numbers of point and texture coordinate."""
    rows: dict[str, list[list[str]]] = {"v": [], "vt": [], "f": [], "l": []}
    before = []
    for line in data.decode("utf-8", "replace").replace("\\\n", " ").splitlines():
        words = line.partition("#")[0].split()
        if words and words[0] in rows:
            rows[words[0]].append(words[1:])
            if words[0] == "f":
                before.append((len(rows["v"]), len(rows["vt"])))
    if not rows["v"]:
        raise InputError("has no line that begins with 'v': is it an OBJ file of a surface?")
    if rows["l"]:
        raise InputError(f"has {len(rows['l'])} lines beside its faces: remove them")
    refuse_corners(Counter(map(len, rows["f"])))
    corners, lines = _obj_corners(rows["f"]), np.array(before, dtype=np.int64).reshape(-1, 2)
    faces, used = (_obj_numbers(corners[:, :, part], lines[:, part, None]) for part in (0, 1))
    return rows, faces, used


def _obj_corners(faces: list[list[str]]) -> NDArray[np.int64]:
    """Return numbers of point and texture coordinate of each corner, 0 for none, shape (F, 3, 2)."""
    corners = [corner for face in faces for corner in face]
    if not corners:
        raise InputError("has no line that begins with 'f': is it an OBJ file of a surface?")
    if len({corner.count("/") for corner in corners}) > 1:
        corners = ["/".join([*corner.split("/"), ""][:2]) for corner in corners]
    parts = "/".join(corners).replace("//", "/0/").replace("//", "/0/").split("/")  # much faster than one by one
    numbers = np.fromiter((int(part or 0) for part in parts), np.int64, len(parts)).reshape(len(faces), 3, -1)
    return numbers[:, :, :2] if numbers.shape[2] > 1 else np.concatenate([numbers, np.zeros_like(numbers)], axis=2)


def _obj_numbers(numbers: NDArray[np.int64], before: NDArray[np.int64]) -> NDArray[np.int64]:
    """Count from 0: OBJ counts from 1, and backwards from the last line before if negative; 0, for none, becomes −1."""
    return np.where(numbers < 0, numbers + before, numbers - 1)


def _obj_places(lines: list[list[str]], used: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the texture coordinates of a file, all of whose corners must use one that is there, or none (−1)."""
    places = np.array([line[:2] for line in lines], dtype=np.float64).reshape(-1, 2)
    bad = np.flatnonzero((used.ravel() >= len(places)) | (used.ravel() < -1))
    if len(bad):
        raise InputError(f"face {bad[0] // 3} names texture coordinate {used.ravel()[bad[0]] + 1} of {len(places)}")
    return places


def _obj_texture(
    places: NDArray[np.float64], used: NDArray[np.int64], faces: NDArray[np.int64], n: int
) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """Return the first texture coordinate of each point, and a remark if there are others."""
    freesurfer.check_faces(faces, n)
    corners, used = faces[used >= 0], used[used >= 0]
    texture = np.full((n, 2), np.nan)
    texture[corners[::-1]] = places[used[::-1]]  # the last that is written is the first of the file
    seam = np.unique(corners[(texture[corners] != places[used]).any(axis=1)])
    text = f"{len(seam)} points lie on a seam of the texture: each keeps the first of its texture coordinates"
    return texture, (text,) if len(seam) else ()


def write_ply(
    path: Path,
    points: NDArray[np.float64],
    faces: NDArray[np.int64],
    texture: NDArray[np.float64] | None,
    colours: NDArray[np.uint8] | None = None,
) -> None:
    """Write a PLY file, little-endian; colours of the points are red, green, blue and perhaps alpha."""
    columns: dict[str, NDArray[Any]] = dict(zip("xyz", points.T, strict=True))
    if texture is not None:
        columns |= dict(zip("st", texture.T, strict=True))
    if colours is not None:
        columns |= dict(zip(_PLY_COLOURS, colours.T, strict=False))
    kinds = {name: "uchar" if name in _PLY_COLOURS else "double" for name in columns}
    dtype = [(name, "<" + _PLY_TYPES[kind]) for name, kind in kinds.items()]
    vertices = np.rec.fromarrays(list(columns.values()), dtype=dtype)
    rows = np.empty(len(faces), [("length", "u1"), ("corners", "<i4", 3)])
    rows["length"], rows["corners"] = 3, faces
    lines = ["ply", "format binary_little_endian 1.0", "comment voxflat", f"element vertex {len(vertices)}"]
    lines += [f"property {kind} {name}" for name, kind in kinds.items()]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    path.write_bytes("\n".join(lines).encode() + vertices.tobytes() + rows.tobytes())


def write_obj(
    path: Path,
    points: NDArray[np.float64],
    faces: NDArray[np.int64],
    texture: NDArray[np.float64] | None,
    library: str | None = None,
    texture_faces: NDArray[np.int64] | None = None,
) -> None:
    """Write an OBJ file.

    A library is the name of the file beside it that holds the material `texture`. Texture faces are the triangles'
    corners as rows of the texture, where that has seams; without, they are `faces`.
    """
    with path.open("w", encoding="utf-8", newline="\n") as file:
        if library is not None:
            file.write(f"mtllib {library}\nusemtl texture\n")
        np.savetxt(file, points, "v %.9g %.9g %.9g")
        if texture is None:
            np.savetxt(file, faces + 1, "f %d %d %d")
            return
        bad = np.flatnonzero(~np.isfinite(texture).all(axis=1))
        if len(bad):
            raise InputError(f"point {bad[0]} has no texture coordinate, which OBJ needs: give all, or none")
        np.savetxt(file, texture, "vt %.9g %.9g")
        corners = np.stack([faces, faces if texture_faces is None else texture_faces], axis=2) + 1
        np.savetxt(file, corners.reshape(-1, 6), "f %d/%d %d/%d %d/%d")
