"""Create a surface from a mesh: validated, oriented outwards, and moved halfway to the pial surface if it is given."""

import hashlib
from typing import Any

import numpy as np

from voxflat import _core
from voxflat.io.meshes import Mesh
from voxflat.io.origin import MeshOrigin
from voxflat.io.reading import check_room
from voxflat.io.triangles import SEAMS
from voxflat.surfaces.correspondence import SAME, pial_of
from voxflat.surfaces.manifold import SurfaceT

_MENDED = ("incomplete", "missing", "dropped", "flipped", "duplicates", "crowded_edges", "split")
_SHOWN = 10  # maximum number of vertices or edges in a warning
_A_TRIANGLE, _A_POINT = 200, 100  # bytes to create a surface; measured: 160 to 190 per triangle and half a point


def of_mesh(
    mesh: Mesh, cls: type[SurfaceT], pial: object | None = None, *, mend: bool = True, unit: str | None = None
) -> SurfaceT:
    """Create a surface from a mesh; `mend` repairs defects as `voxflat.surface` describes."""
    measured_on = "the given surface"
    white, places, of_pial = None, None, list[str]()
    need = _A_TRIANGLE * len(mesh.faces) + _A_POINT * len(mesh.points)
    check_room(need, "use a part of the mesh, simplify it, or allow more memory")
    core, repairs = _core.Surface.from_triangles(mesh.points, mesh.faces, mend)
    if pial is not None:
        places, of_pial = pial_of(core, mesh, pial)
        white = np.asarray(mesh.points, dtype=np.float64)
        midway = (white + places) / 2
        if len(repairs["merged"]) or np.isnan(midway[core.ids]).any():  # halfway, positions may differ or be missing
            core, repairs = _core.Surface.from_triangles(midway, mesh.faces, mend)
        else:
            core = core.moved(midway[core.ids])
        if SAME not in of_pial:
            measured_on = "midthickness: halfway to the pial surface"
    of_file = [text for text in mesh.warnings if not text.startswith(SEAMS)]  # a surface has no texture
    warnings = [*of_file, *_warnings(repairs, len(mesh.faces), len(mesh.points)), *of_pial]
    digest = hashlib.sha256(np.ascontiguousarray(core.points).tobytes() + mesh.faces.tobytes())
    merged = repairs["merged"].astype(np.int64)
    origin = MeshOrigin(
        input=None if mesh.path is None else str(mesh.path),
        input_sha256=digest.hexdigest(),
        vertices=len(mesh.points),
        merged=merged,
        structure=mesh.structure,
        space=mesh.space,
        unit=mesh.unit if unit is None else unit,
        measured_on=measured_on,
        has_known_axes=not mesh._has_unknown_axes,
    )
    mesh_faces = mesh.faces
    mended: dict[str, Any] = {name: repairs[name] for name in _MENDED if repairs[name]}
    if len(merged):
        mended["merged"] = merged.tolist()
    if mended:
        mesh_faces = core.ids.astype(np.int64)[core.faces]
    details: dict[str, object] = {"mended": mended} if mended else {}
    return cls(core, None, origin, details, tuple(warnings), white, places, mesh_faces)


def _warnings(repairs: dict[str, Any], faces: int, points: int) -> list[str]:
    """Return warnings on the changes to a mesh."""
    warnings = []
    if repairs["missing"]:
        count, named = len(repairs["missing"]), _listed(repairs["missing"])
        warnings.append(
            f"{count} of {points} vertices have no finite position ({named}); "
            f"{repairs['incomplete']} of {faces} triangles there were removed"
        )
    if repairs["crowded_edges"]:
        edges = repairs["crowded_edges"]
        named = _listed([f"{a} and {b}" for a, b in edges])
        warnings.append(
            f"more than two triangles meet at {'an edge' if len(edges) == 1 else f'{len(edges)} edges'}, between the "
            f"vertices {named}; the surface was split there"
        )
    if repairs["turned"]:
        warnings.append(f"{repairs['turned']} of {faces} triangles were reversed, so that all of them face outwards")
    if repairs["unused"]:
        warnings.append(f"{repairs['unused']} of {points} vertices belong to no triangle and are excluded")
    if repairs["duplicates"]:
        warnings.append(f"{repairs['duplicates']} of {faces} triangles duplicate others and were removed")
    if repairs["dropped"] or repairs["flipped"]:
        flipped = f"; {repairs['flipped']} more were removed by flipping an edge" if repairs["flipped"] else ""
        warnings.append(f"{repairs['dropped']} of {faces} triangles have no area and were removed{flipped}")
    if len(repairs["merged"]):
        count = len(repairs["merged"])
        warnings.append(f"{count} of {points} vertices coincide with others and share their position in the map")
    if repairs["split"]:
        count, first = len(repairs["split"]), repairs["split"][0]
        where = f"vertex {first}" if count == 1 else f"{count} vertices (the first is {first})"
        warnings.append(f"parts of the surface touch at {where}; each has its own vertex there, with the same number")
    return warnings


def _listed(items: list[Any]) -> str:
    """Return items as text: all of a few, or the first ones."""
    return ", ".join(map(str, items[:_SHOWN])) + ", ..." * (len(items) > _SHOWN)
