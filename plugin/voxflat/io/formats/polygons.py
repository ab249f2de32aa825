"""Read OFF, FreeSurfer's ASCII format and STL without VTK, which accepts incomplete files; and scenes of trimesh."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from voxflat.errors import InputError
from voxflat.io.files import AGAIN
from voxflat.io.formats.freesurfer import UNPLACED
from voxflat.io.spaces import Space
from voxflat.io.triangles import triangulated


def read_off(path: Path, data: bytes) -> dict[str, Any]:
    """Read an OFF file, whose faces may continue on the next line; colours and normals are ignored."""
    lines = [line for line in (raw.split("#")[0].strip() for raw in data.decode("latin1").splitlines()) if line]
    header = re.fullmatch(r"(?:ST)?C?N?OFF\b(.*)", lines[0] if lines else "", re.IGNORECASE)
    if header is None or "BINARY" in header[1].upper():
        raise InputError("does not begin with OFF. Check that it is an ASCII OFF file")
    counts, *rows = [line.split() for line in (header[1].strip(), *lines[1:]) if line] or [[]]
    numbers = [int(word) for word in counts[:2]]
    if len(numbers) < 2 or min(numbers) < 0 or len(rows) < sum(numbers):
        raise InputError(f"has {len(rows)} lines of points and faces instead of {sum(numbers)}. {AGAIN}")
    points = np.array([row[:3] for row in rows[: numbers[0]]], dtype=np.float64).reshape(-1, 3)
    faces: list[list[str]] = []
    for row in rows[numbers[0] :]:
        if faces and len(faces[-1]) <= int(faces[-1][0]):
            faces[-1] += row
        else:
            faces.append(row)
    lengths = np.array([int(face[0]) for face in faces], dtype=np.int64)
    is_cut = bool(faces) and len(faces[-1]) <= lengths[-1]
    if len(faces) != numbers[1] or is_cut:
        count = "an incomplete one" if is_cut else str(len(faces))
        raise InputError(f"its header specifies {numbers[1]} faces, but the file lists {count}. {AGAIN}")
    corners = np.array([corner for face in faces for corner in face[1 : int(face[0]) + 1]], dtype=np.int64)
    places, warnings = triangulated(points, corners, lengths)
    return {"points": points, "faces": corners[places], "warnings": warnings}


def read_asc(path: Path, data: bytes) -> dict[str, Any]:
    """Read an ASCII surface written by mris_convert of FreeSurfer, in tkRAS without a volume geometry."""
    header, _, rest = data.partition(b"\n")
    if not header.startswith(b"#!ascii"):
        raise InputError("does not begin with #!ascii. Check that it is a surface written by mris_convert")
    numbers = np.fromiter(map(float, rest.split()), np.float64)
    points, faces = numbers[:2] if len(numbers) > 1 else (np.nan, np.nan)
    if not (points >= 0 and faces >= 0 and len(numbers) == 2 + 4 * (points + faces)):
        raise InputError(
            f"has {len(numbers)} numbers, but its header specifies {points:g} points and {faces:g} faces. {AGAIN}"
        )
    points, faces = int(points), int(faces)
    rows = numbers[2:].reshape(-1, 4)
    faces_of = rows[points:, :3].astype(np.int64)
    return {"points": rows[:points, :3], "faces": faces_of, "space": Space("tkRAS", None, UNPLACED)}


def of_scene(scene: Any) -> dict[str, Any]:
    """Return the surfaces of a trimesh scene as one, and their texture coordinates."""
    points, faces, texture = [np.empty((0, 3))], [np.empty((0, 3), dtype=np.int64)], [np.empty((0, 2))]
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        mesh = scene.geometry[name]
        if not len(getattr(mesh, "faces", ())):
            continue  # points or lines
        placed = np.asarray(mesh.vertices) @ transform[:3, :3].T + transform[:3, 3]
        coordinates = getattr(mesh.visual, "uv", None)
        turn = -1 if np.linalg.det(transform[:3, :3]) < 0 else 1  # a mirrored surface keeps its outside
        faces.append(np.asarray(mesh.faces, dtype=np.int64)[:, ::turn] + sum(map(len, points)))
        points.append(placed)
        texture.append(np.full((len(placed), 2), np.nan) if coordinates is None else np.asarray(coordinates))
    if len(faces) == 1:
        raise InputError("has no triangles. Export the surface as triangles")
    places = np.concatenate(texture)
    is_textured = bool(np.isfinite(places).any())
    read = {"points": np.concatenate(points), "faces": np.concatenate(faces)}
    return {**read, "texture_coordinates": places if is_textured else None}


_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def is_binary_stl(data: bytes) -> bool:
    """Return whether a file has the length that its header specifies if interpreted as binary STL."""
    return len(data) >= 84 and len(data) == 84 + 50 * int.from_bytes(data[80:84], "little")


def read_stl(path: Path, data: bytes) -> dict[str, Any]:
    """Read an STL file; corners with equal coordinates become one point."""
    if data.lstrip()[:5].lower() == b"solid" and not is_binary_stl(data):
        text = data.lower()
        texts = re.findall(rb"(?m)^[ \t\r]*vertex[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)[ \t\r]*$", text)
        number = len(re.findall(rb"(?m)^[ \t\r]*facet\b", text))
        if len(texts) != 3 * number or b"endsolid" not in text[-200:]:
            raise InputError(f"has {len(texts)} corners in {number} facets, or does not end with endsolid. {AGAIN}")
        corners = np.array(texts, dtype=np.float64).reshape(-1, 3)
    else:
        number = int.from_bytes(data[80:84], "little")
        if len(data) < 84 + _FACET.itemsize * number:
            raise InputError(f"its header specifies {number} faces, but the file ends after {len(data)} bytes. {AGAIN}")
        corners = np.frombuffer(data, _FACET, number, 84)["corners"].reshape(-1, 3).astype(np.float64)
    rows = np.ascontiguousarray(corners + 0.0).view("V24").ravel()  # + 0.0 turns −0 into 0
    _, first, place = np.unique(rows, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))
    points, faces = corners[np.sort(first)], rank[place].reshape(-1, 3)
    warning = f"STL does not store shared points: {len(corners)} corners were merged into {len(points)} points"
    return {"points": points, "faces": faces, "warnings": (warning,)}
