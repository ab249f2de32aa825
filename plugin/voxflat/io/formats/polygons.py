"""Surfaces as text: OFF, and FreeSurfer's ASCII format; and GLB, read by trimesh."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from voxflat.errors import InputError
from voxflat.io.files import AGAIN, require
from voxflat.io.spaces import Space
from voxflat.io.triangles import triangulated


def read_off(path: Path, data: bytes) -> dict[str, Any]:
    """Read an OFF file; colours and normals are left out."""
    lines = [line for line in (raw.split("#")[0].strip() for raw in data.decode("latin1").splitlines()) if line]
    if not lines or not lines[0].upper().endswith("OFF") or "BINARY" in lines[0].upper():
        raise InputError("does not begin with OFF: is it an ASCII OFF file?")
    counts = [int(word) for word in lines[1].split()]
    if len(counts) < 2 or min(counts[:2]) < 0 or len(lines) < 2 + counts[0] + counts[1]:
        raise InputError(f"has {len(lines) - 2} lines of points and faces, by its header {sum(counts[:2])}: {AGAIN}")
    points = np.array([line.split()[:3] for line in lines[2 : 2 + counts[0]]], dtype=np.float64)
    faces = [line.split() for line in lines[2 + counts[0] : 2 + counts[0] + counts[1]]]
    lengths = np.array([int(face[0]) for face in faces], dtype=np.int64)
    if any(len(face) <= length for face, length in zip(faces, lengths.tolist(), strict=True)):
        raise InputError(f"has a face of fewer corners than it says: {AGAIN}")
    corners = np.array([corner for face in faces for corner in face[1 : int(face[0]) + 1]], dtype=np.int64)
    places, remarks = triangulated(points.reshape(-1, 3), corners, lengths)
    return {"points": points.reshape(-1, 3), "faces": corners[places], "remarks": remarks}


def read_asc(path: Path, data: bytes) -> dict[str, Any]:
    """Read a FreeSurfer surface in ASCII, as mris_convert writes it: tkRAS without a volume."""
    header, _, rest = data.partition(b"\n")
    if not header.startswith(b"#!ascii"):
        raise InputError("does not begin with #!ascii: is it a surface that mris_convert wrote?")
    numbers = np.loadtxt(io.BytesIO(rest.replace(b"\n", b" ")), ndmin=1)
    points, faces = (int(count) for count in numbers[:2])
    if points < 0 or faces < 0 or len(numbers) != 2 + 4 * (points + faces):
        raise InputError(f"has {len(numbers)} numbers, by its header {2 + 4 * (points + faces)}: {AGAIN}")
    rows = numbers[2:].reshape(-1, 4)
    doubt = "it has FreeSurfer's coordinates (tkRAS), and its file does not say where their volume lies (c_ras)"
    return {
        "points": rows[:points, :3],
        "faces": rows[points:, :3].astype(np.int64),
        "space": Space("tkRAS", None, doubt),
    }


def read_glb(path: Path, data: bytes) -> dict[str, Any]:
    """Read the surfaces of a GLB file, all of its scene in one, by trimesh."""
    scene = require("trimesh").load_scene(io.BytesIO(data), file_type="glb", skip_materials=True)
    mesh = scene.to_mesh()
    if not len(mesh.faces):
        raise InputError("holds no triangles: export its surface")
    return {"points": np.asarray(mesh.vertices), "faces": np.asarray(mesh.faces, dtype=np.int64)}
