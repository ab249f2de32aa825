"""Check whether a pial surface or regions belong to a surface; both sides of fsaverage have the same vertex count."""

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from voxflat import _core
from voxflat.errors import InputError
from voxflat.io.formats.freesurfer import read_label_points
from voxflat.io.meshes import Mesh
from voxflat.io.partners import check_participant, check_side, check_unit
from voxflat.io.sources import as_mesh
from voxflat.io.spaces import Space
from voxflat.surfaces.manifold import Manifold

_OUTWARD = (0.4, 0.7)  # outward share of the way to the pial surface: 0.94 on fsaverage; -0.3 to 0.3 for wrong surfaces
_BESIDE = 10.0  # mm from a label's points to the vertices; the pial surface is 3 mm from the white one
_SIDE = 5.0  # mm from the midline for a reliable side
SAME = "the pial surface equals the given surface: distances are measured on it, not halfway between the two"


def pial_of(core: _core.Surface, mesh: Mesh, pial: object) -> tuple[NDArray[np.float64], list[str]]:
    """Return the points of a pial surface in the space of the white one, shape (N, 3), and warnings.

    The pial surface must lie outside the white one. The test uses the outward share of the displacements from vertex to
    vertex: the sum of the components along the normals, divided by the sum of the lengths. It does not depend on units
    or on the thickness of the cortex.
    """
    other = as_mesh(pial)
    if other is None and isinstance(pial, str | os.PathLike):
        is_there = Path(pial).exists()
        raise InputError(f"{pial}: " + ("not a mesh. Pass a pial surface" if is_there else "the file does not exist"))
    if other is None:
        raise InputError(f"pial has type {type(pial).__name__}. Pass a path, a tuple (points, faces) or a PolyData")
    if len(other.points) != len(mesh.points):
        raise InputError(
            f"the pial surface has {len(other.points)} vertices, but the given surface has {len(mesh.points)}. "
            "Pass two surfaces of the same subject whose vertices correspond one to one"
        )
    check_unit("the pial surface", other, mesh.unit)
    places = _in_space_of(mesh, other)
    return places, _check_pial(core, mesh, other, places)


def _in_space_of(mesh: Mesh, other: Mesh) -> NDArray[np.float64]:
    """Return the points of another mesh in the space of a mesh; unchanged if either space is unknown."""
    is_same = mesh.space._described()["to_scanner"] == other.space._described()["to_scanner"]
    if is_same or not (mesh.space.is_known and other.space.is_known):
        return other.points
    return mesh.space.from_scanner(other.space.to_scanner(other.points))


def _check_pial(core: _core.Surface, mesh: Mesh, pial: Mesh, places: NDArray[np.float64]) -> list[str]:
    """Check that a pial surface lies outside a white one, whose triangles face outwards."""
    name = "the pial surface" if pial.path is None else pial.path
    check_side(name, pial.structure, mesh.structure, "Pass the pial surface of the same hemisphere")
    check_participant(pial.path, mesh.path)
    way = (places - mesh.points)[core.ids]
    there = np.isfinite(way).all(axis=1)
    way = way[there]
    lengths = np.linalg.norm(way, axis=1)
    if not lengths.any():
        return [SAME]
    normals = np.nan_to_num(_core.vertex_normals(core.points, core.faces))[there]
    outward = float((normals * way).sum() / lengths.sum())
    way_there = f"{100 * abs(outward):.0f} % of the way there leads {'inwards' if outward < 0 else 'outwards'}"
    apart = (
        f"the median distance to the pial surface is {np.median(lengths):.3g} mm, and on balance {way_there} "
        "(more than 90 % outwards is usual)"
    )
    is_closed = not core.topology()["loops"]
    if outward < -_OUTWARD[1] and is_closed:
        raise InputError(f"the pial surface lies inside the given surface: {apart}. Check whether the two are swapped")
    if abs(outward) < _OUTWARD[0]:
        raise InputError(
            f"the pial surface does not match the given surface: {apart}. Check that it is not inflated, and that it "
            "belongs to the same hemisphere, subject and space"
        )
    if outward < _OUTWARD[1]:
        return [f"the pial surface may not match the given surface: {apart}"]
    return []


def check_label(whole: Manifold, path: Path) -> list[str]:
    """Compare the points of a label file, unless all are 0, with its vertices; return a warning if they lie elsewhere.

    Many labels lie on the white surface.
    """
    if whole.is_voxels or not path.name.lower().endswith(".label"):
        return []
    vertices, points = read_label_points(path)
    place = np.full((whole.count, 3), np.nan)
    place[whole.vertices] = whole.points
    there = place[vertices]
    is_known = np.isfinite(there).all(axis=1) & np.isfinite(points).all(axis=1)
    there, points = there[is_known], points[is_known]
    if not points.any():
        return []
    space = whole.space
    if space.name == "scanner" and space.volume is not None:
        points = Space("tkRAS", space.volume).to_scanner(points)
    elif space.name != "tkRAS":
        points = points + (there.mean(axis=0) - points.mean(axis=0))  # c_ras is unknown
    far = float(np.median(np.linalg.norm(points - there, axis=1)))
    if far <= _BESIDE:
        return []
    sides = points[:, 0].mean(), there[:, 0].mean()
    if sides[0] * sides[1] < 0 and min(map(abs, sides)) > _SIDE:
        raise InputError(
            f"{path}: the points of the label and the vertices to which it refers lie on opposite sides of the brain "
            f"(mean x: {sides[0]:.0f} and {sides[1]:.0f} mm). Pass the label of this hemisphere"
        )
    return [
        f"the points of {path.name} are {far:.0f} mm (median) away from the vertices to which it refers. Check that it "
        "belongs to this surface, and that the surface is the white surface, the pial surface, or one between them"
    ]
