"""Read, find and check the registered sphere of a surface."""

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from voxflat.arguments import array_of
from voxflat.errors import InputError
from voxflat.io.meshes import Mesh, read_mesh
from voxflat.io.partners import check_side
from voxflat.io.sources import as_mesh
from voxflat.surfaces.manifold import Manifold, are_triangles
from voxflat.surfaces.standard.registration import Registration
from voxflat.surfaces.standard.template import SIDES, SPACES, standard_template

_FS_LR = re.compile(r"fs_?LR|reg_LR|MSM(All|Sulc)", re.IGNORECASE)
_FSAVERAGE = re.compile(r"to-fsaverage|space-fsaverage")  # such as the mesh of fs_LR in fsaverage space
OWN_REGISTRATION = "its own registration"  # in place of a file

_ROUND = 0.02  # largest relative deviation from the radius
_FOLDED = 0.01  # largest share of flipped triangles; FreeSurfer's spheres have 0 to a few hundred of 300,000
_SHARED = 0.9  # least share of common triangles
_FAR = (12.0, 20.0)  # mm, median distance from the template's brain: warning, error; 4 to 9 are usual
_NEAREST = 12  # nearest vertices whose triangles are tested


@dataclass(frozen=True, eq=False)
class Sphere:
    """Vertex positions on the sphere of fsaverage or fs_LR, and the distance of the brain from the template."""

    places: NDArray[np.float64]  # (V, 3), unit vectors, one for each vertex of the whole mesh
    space: str  # fsaverage or fs_LR
    side: str  # left or right
    name: str  # file name or description
    folded: int  # number of flipped triangles
    distance: float  # median distance of corresponding positions, mm

    def __repr__(self) -> str:
        return f"<Sphere {self.name}: {self.side}, {self.space}, {len(self.places)} vertices>"

    def _described(self) -> dict[str, Any]:
        """Return the sphere as metadata of a map."""
        content = {"input": self.name, "space": self.space, "side": self.side}
        return {**content, "folded": self.folded, "distance": round(self.distance, 2)}


def sphere_beside(whole: Manifold) -> Path | None:
    """Find the registered sphere that FreeSurfer writes next to a surface: ``lh.sphere.reg`` for ``lh.white``."""
    path = whole.origin.input
    return sphere_at(path) if path and not whole.is_voxels else None


def sphere_at(path: str | os.PathLike[str]) -> Path | None:
    """Find the registered sphere that FreeSurfer writes next to the surface file."""
    match = re.match(r"[lr]h(?=\.)", Path(path).name)
    beside = Path(path).with_name(f"{match[0]}.sphere.reg") if match else None
    return beside if beside is not None and beside.is_file() else None


def sphere_of(whole: Manifold, sphere: object) -> tuple[Sphere, list[str]]:
    """Return the given registered sphere of a surface, with one position per vertex of the mesh, and warnings.

    The sphere may have any radius around the origin. Its space is that of `named_space`. The two spaces are rotated by
    40° relative to each other, so the surface itself overrides the name if it clearly fits the other space.
    """
    mesh = _as_points(sphere)
    points, path = (mesh, None) if isinstance(mesh, np.ndarray) else (mesh.points, mesh.path)
    name = str(path or (OWN_REGISTRATION if isinstance(sphere, Registration) else "the sphere"))
    if len(points) != whole.count:
        raise InputError(
            f"{name} has {len(points)} vertices, but the surface has {whole.count}. Pass the sphere of this surface, "
            "with one position per vertex"
        )
    places = on_unit_sphere(points, whole.vertices, name)
    if isinstance(mesh, Mesh):
        corners = whole.vertices[whole.faces]
        shared = float(are_triangles(corners, whole._merged_in(mesh.faces)).mean())
        if shared < _SHARED:
            raise InputError(
                f"{name} shares only {100 * shared:.0f} % of the surface's triangles. Pass the sphere of the same "
                "subject and hemisphere"
            )
    folded = _folded(whole, places, name)
    space, side, distance, warnings = _placed(whole, places, _named_side(whole, mesh, name), name)
    if folded:
        warnings.append(f"{folded} of {len(whole.faces)} triangles are flipped on {Path(name).name}")
    return Sphere(places, space, side, name, folded, distance), warnings


def registered_sphere(registration: Registration) -> Sphere:
    """Return a surface's registration as its sphere; vertices without a triangle lie at the centre."""
    places = np.nan_to_num(registration.sphere)
    distance = _distances(registration.surface, places)["fsaverage", registration.side]
    return Sphere(places, "fsaverage", registration.side, OWN_REGISTRATION, 0, distance)


def on_unit_sphere(points: NDArray[Any], used: NDArray[Any], name: str) -> NDArray[np.float64]:
    """Return points of a sphere as unit vectors; raise an error if the used ones do not lie on a sphere."""
    radii = np.linalg.norm(points[used], axis=1)
    radius = float(np.median(radii))
    if not radius > 0 or np.abs(radii / radius - 1).max() > _ROUND:
        raise InputError(
            f"{name} is not a sphere around the origin: its radius ranges from {radii.min():.4g} to {radii.max():.4g}. "
            "Pass a registered sphere, such as lh.sphere.reg"
        )
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(points / np.linalg.norm(points, axis=1)[:, None], dtype=np.float64)


def named_space(name: str) -> str:
    """Return the space that the name of a sphere's file indicates: fs_LR if it matches `_FS_LR`, or fsaverage."""
    file = Path(name).name
    return "fs_LR" if _FS_LR.search(file) and not _FSAVERAGE.search(file) else "fsaverage"


def _as_points(sphere: object) -> Mesh | NDArray[np.float64]:
    if isinstance(sphere, str | os.PathLike):
        if not Path(sphere).is_file():
            raise InputError(f"{os.fspath(sphere)}: the file does not exist. Check the path of the sphere")
        return read_mesh(sphere)
    if isinstance(sphere, Registration):
        surface, structure = sphere.surface, SIDES[sphere.side]
        return Mesh(np.nan_to_num(sphere.sphere), surface.vertices[surface.faces], structure=structure)
    mesh = as_mesh(sphere)
    if mesh is not None:
        return mesh
    try:
        points = array_of(sphere, "points of the sphere")
    except ValueError:
        points = np.empty(0)
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind not in "iuf" or not np.isfinite(points).all():
        raise InputError(f"sphere has type {type(sphere).__name__}. Pass a file, or finite positions of shape (V, 3)")
    return points.astype(np.float64)


def _folded(whole: Manifold, places: NDArray[np.float64], name: str) -> int:
    """Return the number of flipped triangles; raise an error if there are many."""
    a, b, c = (places[whole.vertices[whole.faces[:, corner]]] for corner in range(3))
    folded = int((np.einsum("ij,ij->i", np.cross(a, b), c) < 0).sum())
    share = folded / len(whole.faces)
    if share > 1 - _FOLDED:
        raise InputError(f"{name} is mirrored: all of its triangles are flipped. Pass it in the FreeSurfer orientation")
    if share > _FOLDED:
        raise InputError(
            f"{100 * share:.1f} % of the surface's triangles are flipped on {name}. Check that it is the sphere of "
            "this surface and is not damaged"
        )
    return folded


def _named_side(whole: Manifold, mesh: Mesh | NDArray[np.float64], name: str) -> str | None:
    """Return the hemisphere that the surface and its sphere specify, if they do."""
    named = {structure: side for side, structure in SIDES.items()}
    of_surface, of_sphere = whole.origin.structure, mesh.structure if isinstance(mesh, Mesh) else None
    check_side(name, of_sphere, of_surface, "Pass its sphere")
    return named.get(of_surface or "") or named.get(of_sphere or "")


def in_triangles(
    places: NDArray[np.float64], faces: NDArray[Any], wanted: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.bool_]]:
    """Return corners and weights of the spherical triangles nearest to unit vectors, and whether they contain them."""
    used = np.flatnonzero(np.bincount(faces.ravel(), minlength=len(places)))
    _, nearest = scipy.spatial.KDTree(places[used]).query(wanted, k=min(_NEAREST, len(used)))
    near = used[nearest].reshape(len(wanted), -1)
    is_near = np.zeros(len(places), dtype=np.bool_)
    is_near[near] = True
    candidates = faces[is_near[faces].any(axis=1)].astype(np.int64)
    around: dict[int, list[int]] = {}
    for number, corners in enumerate(candidates.tolist()):
        for corner in corners:
            around.setdefault(corner, []).append(number)
    abc = places[candidates]
    normals = [np.cross(abc[:, (k + 1) % 3], abc[:, (k + 2) % 3]) for k in range(3)]  # of planes through edges
    hits = np.zeros((len(wanted), 3), dtype=np.int64)
    weights = np.zeros((len(wanted), 3))
    is_inside = np.zeros(len(wanted), dtype=np.bool_)
    for row, (place, vertices) in enumerate(zip(wanted, near.tolist(), strict=True)):
        rows = sorted({number for vertex in vertices for number in around.get(vertex, ())})
        volumes = np.stack([normal[rows] @ place for normal in normals], axis=1)
        total = volumes.sum(axis=1)
        shares = np.where(total[:, None] > 0, volumes / np.where(total > 0, total, 1)[:, None], -np.inf)
        best = int(shares.min(axis=1).argmax())
        is_inside[row] = shares[best].min() > -1e-6
        hits[row] = candidates[rows[best]]
        bounded = np.maximum(shares[best], 0)
        weights[row] = bounded / bounded.sum() if bounded.sum() > 0 else np.full(3, 1 / 3)
    return hits, weights, is_inside


def interpolated(
    places: NDArray[np.float64], faces: NDArray[Any], values: NDArray[np.float64], wanted: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the values of vertices at unit vectors of a sphere, and whether its triangles contain them."""
    corners, weights, is_inside = in_triangles(places, faces, wanted)
    return np.einsum("ij,ijk->ik", weights, values[corners]), is_inside


def _placed(
    whole: Manifold, places: NDArray[np.float64], named: str | None, name: str
) -> tuple[str, str, float, list[str]]:
    """Return the space, the hemisphere, the distance from the template's brain at the same points, and warnings."""
    told_space = named_space(name)
    distances = _distances(whole, places)
    if any(np.isnan(distance) for distance in distances.values()):  # a patch
        if named is None:
            raise InputError("the hemisphere is unknown. Include lh., rh., hemi-L or hemi-R in the file name")
        return told_space, named, float("nan"), []
    best = min(distances, key=lambda key: distances[key])
    place = told_space, named or min(SIDES, key=lambda side: distances[told_space, side])
    warnings = []
    if distances[place] > _FAR[0] and distances[best] < distances[place] / 2:
        if named is not None and best[1] != named:
            raise InputError(
                f"according to {name}, the surface is the {best[1]} hemisphere, but the files specify the {named} one. "
                "Rename the files, or pass the matching sphere"
            )
        warnings.append(
            f"{name} is assumed to be in {best[0]} space, where corresponding points are {distances[best]:.0f} mm "
            f"apart (in {told_space} space: {distances[place]:.0f} mm)"
        )
        place = best
    distance = distances[place]
    text = f"according to {name}, the aligned surface is {distance:.0f} mm (median) away from the template's brain"
    if distance > _FAR[1]:
        raise InputError(f"{text}, so it is not registered to fsaverage or fs_LR. Pass lh.sphere.reg, not lh.sphere")
    if distance > _FAR[0]:
        warnings.append(f"{text}; 4 to 9 mm is usual. Check that the sphere is registered")
    return *place, distance, warnings


def _distances(whole: Manifold, places: NDArray[np.float64]) -> dict[tuple[str, str], float]:
    """Return the distance from the template's brain by space and hemisphere; NaN for a patch."""
    templates = [standard_template(space, side) for space in SPACES for side in SIDES]
    anchors = [template.anchors for template in templates if template.anchors is not None]
    points = np.concatenate([anchor.sphere for anchor in anchors])
    located, is_inside = interpolated(places[whole.vertices], whole.faces, whole.points, points)
    medians, start = {}, 0
    for template, part in zip(templates, anchors, strict=True):
        rows = np.arange(start, start + len(part.sphere))
        start += len(rows)
        there = is_inside[rows]
        distance = _apart(located[rows[there]], part.white[there]) if there.sum() > len(there) / 2 else float("nan")
        medians[template.space, template.side] = distance
    return medians


def _apart(points: NDArray[np.float64], onto: NDArray[np.float64]) -> float:
    """Return the median distance between two sets of points after the best similarity transform (Umeyama 1991)."""
    a, b = points - points.mean(axis=0), onto - onto.mean(axis=0)
    u, s, vt = np.linalg.svd(b.T @ a)
    sign = np.sign(np.linalg.det(u @ vt))
    turn = u @ np.diag([1, 1, sign]) @ vt
    scale = (s * [1, 1, sign]).sum() / (a**2).sum()
    return float(np.median(np.linalg.norm(b - scale * a @ turn.T, axis=1)))
