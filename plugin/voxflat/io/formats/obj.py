"""Read and write OBJ files without VTK, which renumbers the points of files with texture coordinates."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.errors import InputError
from voxflat.io.files import AGAIN
from voxflat.io.triangles import Faces, Points, check_faces, first_coordinates, triangulated


def read_obj(path: Path, data: bytes) -> dict[str, Any]:
    """Read an OBJ file; a point on a seam, which has several texture coordinates, keeps the first one."""
    rows, faces, used, cut = _tables(data)
    points = _numbers(rows["v"], 3, "v")
    texture = None
    incomplete = "does not end with a complete line. Check that the file is complete"
    warnings = cut if data.endswith(b"\n") else (incomplete, *cut)
    if (used != -1).any():
        texture, seam = first_coordinates(_coordinates(rows["vt"], used), faces, len(points))
        warnings += seam
    return {"points": points, "faces": faces, "texture_coordinates": texture, "warnings": warnings}


def read_obj_texture(data: bytes) -> tuple[NDArray[np.int64], NDArray[np.float64], dict[str, set[str]]]:
    """Read the faces, their corners' texture coordinates (F, 3, 2; NaN if absent), and the mtllib and usemtl names."""
    rows, faces, used, _ = _tables(data)
    check_faces(faces, len(rows["v"]))
    coordinates = _coordinates(rows["vt"], used)
    names: dict[str, set[str]] = {"mtllib": set(), "usemtl": set()}
    for line in data.decode("utf-8", "replace").splitlines():
        key, *rest = line.split(None, 1)[:2] or [""]
        if key in names and rest:
            names[key].add(rest[0].strip())
    return faces, coordinates, names


def _tables(data: bytes) -> tuple[dict[str, list[list[str]]], NDArray[np.int64], NDArray[np.int64], tuple[str, ...]]:
    """Return a file's lines, the numbers of each triangle's corner points and texture coordinates, and warnings."""
    rows: dict[str, list[list[str]]] = {"v": [], "vt": [], "f": [], "l": []}
    before = []
    for line in data.decode("utf-8", "replace").replace("\\\n", " ").splitlines():
        words = line.partition("#")[0].split()
        if words and words[0] in rows:
            rows[words[0]].append(words[1:])
            if words[0] == "f":
                before.append((len(rows["v"]), len(rows["vt"])))
    if not rows["v"]:
        raise InputError("has no line that begins with 'v'. Check that it is an OBJ file of a surface")
    counts = np.array([len(face) for face in rows["f"]], dtype=np.int64)
    corners, lines = _corners(rows["f"]), np.repeat(np.array(before, dtype=np.int64).reshape(-1, 2), counts, axis=0)
    # numbers count from 1 or, if negative, from the end; 0 (absent) becomes −1
    of_points, of_texture = np.where(corners < 0, corners + lines, corners - 1).T
    points = _numbers(rows["v"], 3, "v") if (counts > 3).any() else np.empty((0, 3))
    triangles, warnings = triangulated(points, of_points, counts)
    if rows["l"]:  # Blender writes edges without faces as lines
        warnings = (*warnings, f"has lines ({len(rows['l'])}) in addition to its faces, which are ignored")
    return rows, of_points[triangles], of_texture[triangles], warnings


def _corners(faces: list[list[str]]) -> NDArray[np.int64]:
    """Return the point and texture coordinate numbers of each corner (0 if absent), of shape (C, 2)."""
    corners = [corner for face in faces for corner in face]
    if not corners:
        raise InputError("has no line that begins with 'f'. Check that it is an OBJ file of a surface")
    if len({corner.count("/") for corner in corners}) > 1:
        corners = ["/".join([*corner.split("/"), ""][:2]) for corner in corners]
    parts = "/".join(corners).replace("//", "/0/").replace("//", "/0/").split("/")  # much faster than line by line
    numbers = np.fromiter((int(part or 0) for part in parts), np.int64, len(parts)).reshape(len(corners), -1)
    return numbers[:, :2] if numbers.shape[1] > 1 else np.concatenate([numbers, np.zeros_like(numbers)], axis=1)


def _numbers(lines: list[list[str]], count: int, key: str) -> NDArray[np.float64]:
    """Return the first numbers of each line that begins with a key."""
    short = next((n for n, line in enumerate(lines) if len(line) < count), None)
    if short is not None:
        raise InputError(
            f"its line {short} that begins with {key!r} has {len(lines[short])} of {count} numbers. {AGAIN}"
        )
    return np.array([line[:count] for line in lines], dtype=np.float64).reshape(-1, count)


def _coordinates(lines: list[list[str]], used: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the texture coordinates of corners, each of which refers to an existing line, or to none (−1)."""
    places = _numbers(lines, 2, "vt")
    bad = np.flatnonzero((used.ravel() >= len(places)) | (used.ravel() < -1))
    if len(bad):
        number = used.ravel()[bad[0]] + 1
        raise InputError(f"face {bad[0] // 3} refers to texture coordinate {number}, but the file has {len(places)}")
    return np.concatenate([places, [[np.nan, np.nan]]])[used]  # index −1 refers to the last row


def write_obj(
    path: Path,
    points: Points,
    faces: Faces,
    texture: Points | None,
    library: str | None = None,
    texture_faces: Faces | None = None,
) -> None:
    """Write an OBJ file; `library` is the name of the file in the same directory that defines the material `texture`.

    If the texture has seams, `texture_faces` lists the corners of each triangle as rows of the texture coordinates.
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
            raise InputError(f"point {bad[0]} has no texture coordinate. Define them for all points or for none")
        np.savetxt(file, texture, "vt %.9g %.9g")
        corners = np.stack([faces, faces if texture_faces is None else texture_faces], axis=2) + 1
        np.savetxt(file, corners.reshape(-1, 6), "f %d/%d %d/%d %d/%d")
