"""A surface of a mesh: checked, turned to face outside, and midway to the pial surface where that is given."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any

import numpy as np

from voxflat import _core
from voxflat.errors import InputError
from voxflat.io.meshes import Mesh, is_mesh_name, read_mesh, suspicious_units
from voxflat.surfaces.partners import check_pial, in_space_of
from voxflat.surfaces.surface import Surface

__all__ = ["as_mesh", "of_mesh"]


def as_mesh(source: object) -> Mesh | None:
    """Take what is a mesh as a `Mesh`; None for everything else.

    Parameters
    ----------
    source : object
        A path, (points, faces), a Mesh or a pyvista.PolyData.

    Returns
    -------
    Mesh or None

    Raises
    ------
    InputError
        If it is a mesh, but a damaged one.
    """
    if isinstance(source, Mesh):
        return source
    if isinstance(source, str | os.PathLike):
        return read_mesh(source) if is_mesh_name(Path(source)) else None
    if isinstance(source, tuple) and len(source) == 2:
        points, faces = (np.asarray(part) for part in source)
        return Mesh(points, faces)
    if type(source).__name__ == "PolyData" and hasattr(source, "regular_faces"):
        return _of_polydata(source)
    return None


def _of_polydata(mesh: Any) -> Mesh:
    if mesh.n_lines:  # which triangulate() leaves where all faces are triangles already
        raise InputError(
            f"the PolyData has {mesh.n_lines} lines; triangulate it and remove them: mesh = mesh.triangulate(); "
            "mesh.SetLines(None)"
        )
    if not mesh.is_all_triangles:
        raise InputError("the PolyData has faces that are no triangles, or none; triangulate it: mesh.triangulate()")
    return Mesh(np.asarray(mesh.points), np.asarray(mesh.regular_faces))


def of_mesh(mesh: Mesh, pial: object | None = None) -> Surface:
    """Make a surface of a mesh.

    Parameters
    ----------
    mesh : Mesh
        Triangles, RAS+ mm.
    pial : path, Mesh, (points, faces) or pyvista.PolyData, optional
        As in `voxflat.surface`.

    Returns
    -------
    Surface

    Raises
    ------
    InputError
        If it is no manifold, or the pial surface does not correspond to it.
    """
    core, turned, unused = _core.Surface.from_triangles(mesh.points, mesh.faces)
    remarks = list(mesh.remarks)
    if turned:
        remarks.append(f"{turned} of {len(mesh.faces)} triangles were turned over, so that all face outside")
    if unused:
        remarks.append(f"{unused} of {len(mesh.points)} vertices belong to no triangle and are left out")
    suspicion = suspicious_units(mesh.points)
    if suspicion and suspicion not in remarks:
        remarks.append(f"the surface {suspicion}")
    measured_on = "the given surface"
    thickness = None
    if pial is not None:
        other = as_mesh(pial)
        if other is None:
            raise InputError(f"pial is {type(pial).__name__}; give a mesh: a path, (points, faces), or a PolyData")
        if len(other.points) != len(mesh.points):
            raise InputError(
                f"the pial surface has {len(other.points)} vertices, the given one {len(mesh.points)}; they must be of "
                "one subject and correspond vertex by vertex"
            )
        places = in_space_of(mesh, other)
        remarks += check_pial(core, mesh, other, places)
        thickness = np.linalg.norm(places - mesh.points, axis=1)
        core = core.moved((mesh.points[core.ids] + places[core.ids]) / 2)
        measured_on = "midthickness: halfway to the pial surface"
    digest = hashlib.sha256(np.ascontiguousarray(core.points).tobytes() + mesh.faces.tobytes())
    metadata = {
        "kind": "mesh",
        "input": None if mesh.path is None else str(mesh.path),
        "input_sha256": digest.hexdigest(),
        "vertices": len(mesh.points),
        "structure": mesh.structure,
        "space": mesh.space.described(),
        "measured_on": measured_on,
    }
    return Surface(core, None, metadata, tuple(remarks), thickness, mesh.faces)
