"""One flat map for a group of people, whose surfaces have the same triangles."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat import _core
from voxflat.arguments import Progress, log, numbers_of, shown
from voxflat.distortion.distortion import Distortion
from voxflat.errors import InputError
from voxflat.io.meshes import Mesh
from voxflat.io.partners import check_side, check_unit
from voxflat.io.provenance import recording
from voxflat.io.sources import as_mesh
from voxflat.maps.flat_map import FlatMap
from voxflat.methods.common import bands_of
from voxflat.methods.method import FlattenSettings
from voxflat.methods.voxflat import Voxflat, links_or_better
from voxflat.pipeline.flat_series import numbered
from voxflat.pipeline.surface import Surface, surface
from voxflat.surfaces.cutting import CutManifold
from voxflat.surfaces.manifold import Manifold, are_triangles

_MIRRORED = "it is a mirror image of the first surface. Pass surfaces of the same hemisphere"


@recording(surfaces=numbered)
def flatten_group(
    surfaces: Sequence[object],
    *,
    cuts: object | None = None,
    sphere: object | None = None,
    relax: float | bool | None = None,
    weights: ArrayLike | None = None,
    mirror: bool = False,
    seed: int = 0,
    threads: int | None = None,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> FlatMap:
    """Flatten the surfaces of several people with one map, which is as good as possible for all of them.

    The surfaces have the same triangles, as those of fs_LR, fsaverage or SUIT. For each pair of points and each
    triangle, the distances and shapes of all people are combined, after scaling all surfaces to the same area. The map
    has the least energy of the method "voxflat" for the combined distances and shapes. It does not depend on the order
    of the surfaces. Files are read one at a time, so the memory does not depend on their number.

    The points of the map are those of the mean surface. The distortion of the map is the mean of that of all people,
    each at their own best scale.

    Parameters
    ----------
    surfaces : sequence of path, Mesh, (points, faces), pyvista.PolyData or Surface
        One surface per person.
    cuts, sphere, relax : optional
        Where the surfaces are cut, as in `Surface.cut` of the mean surface.
    weights : array_like of float, shape (K,), optional
        Positive weights of the people; by default, all are equal.
    mirror, seed, threads, memory_limit, progress : optional
        As in `Surface.flatten`.

    Returns
    -------
    FlatMap
        The map. Its `people` lists the distortion for each person, and its `spread` tells how much the people differ at
        each point.

    Raises
    ------
    InputError
        If there are fewer than two surfaces, or if they do not have the same triangles, hemisphere and unit.
    Cancelled
        If `progress` returned False.

    See Also
    --------
    flatten : Flatten a single surface.
    measure : Measure how well a map fits another person.

    Examples
    --------
    >>> hill = voxflat.samples.hill()
    >>> people = [(hill.points * [1, 1, height], hill.faces) for height in (0.8, 1, 1.2)]
    >>> flat_map = voxflat.flatten_group(people)
    >>> len(flat_map.people)
    3
    """
    settings = FlattenSettings(mirror=mirror, seed=seed, memory_limit=memory_limit, threads=threads, progress=progress)
    group = _Group(surfaces, weights)
    limits: dict[str, Any] = {"threads": settings.threads, "progress": progress}
    mean = surface(group.mean(), **limits)
    cut = mean.cut(cuts, sphere=sphere, relax=relax, **limits)
    flat_map = Voxflat()._map(cut, settings, group=lambda chosen: group.combined(cut.surface, chosen, settings))
    return group.evaluated(flat_map, cut, settings)


@dataclass(frozen=True)
class _Member:
    """A person of the group."""

    number: int  # in the order of the surfaces
    source: object
    weight: float
    digest: str  # of the positions


class _Group:
    """The surfaces of a group, which are read again each time they are needed."""

    def __init__(self, surfaces: Sequence[object], weights: ArrayLike | None) -> None:
        if isinstance(surfaces, str | Surface) or not hasattr(surfaces, "__len__"):
            raise InputError(f"surfaces is {shown(surfaces)}. Pass a list of surfaces, one per person")
        if len(surfaces) < 2:
            raise InputError(f"the list has {len(surfaces)} surface(s). Pass at least two, or use flatten")
        known = np.ones(len(surfaces)) if weights is None else numbers_of(weights, "weights")
        if known.shape != (len(surfaces),) or not ((known > 0) & np.isfinite(known)).all():
            raise InputError(f"weights is {shown(weights)}. Pass one positive number for each of {len(surfaces)} surfaces")
        self.first = _mesh(surfaces[0], 1)
        self.used = np.unique(self.first.faces)
        members = []
        for number, (source, weight) in enumerate(zip(surfaces, known.tolist(), strict=True), 1):
            mesh = _mesh(source, number)
            self._check(mesh, number)
            digest = hashlib.sha256(np.ascontiguousarray(mesh.points[self.used])).hexdigest()
            members.append(_Member(number, source, weight, digest))
        self.members = sorted(members, key=lambda member: (member.digest, member.weight))

    def _check(self, mesh: Mesh, number: int) -> None:
        """Raise an error for a surface that does not match the first one."""
        name, first = _name(mesh, number), self.first
        if len(mesh.points) != len(first.points):
            counts = f"{name} has {len(mesh.points)} vertices, but {_name(first, 1)} has {len(first.points)}"
            raise InputError(f"{counts}. Pass surfaces with the same triangles, such as resampled ones (fs_LR)")
        check_side(name, mesh.structure, first.structure, "Pass surfaces of the same hemisphere", _name(first, 1))
        check_unit(name, mesh, first.declared_unit or "unknown")
        is_same = np.array_equal(mesh.faces, first.faces) or (
            len(mesh.faces) == len(first.faces) and are_triangles(mesh.faces, first.faces).all()
        )
        if not is_same:
            text = f"{name} does not have the triangles of {_name(first, 1)}"
            raise InputError(f"{text}. Pass surfaces with the same triangles, such as resampled ones (fs_LR)")
        if not np.isfinite(mesh.points[self.used]).all():
            raise InputError(f"{name} has vertices without a position. Repair the surface, or omit it")

    def points(self) -> Iterator[tuple[_Member, NDArray[np.float64]]]:
        """Read the positions of all people, in an order that does not depend on that of the surfaces."""
        for member in self.members:
            yield member, _mesh(member.source, member.number).points

    def mean(self) -> Mesh:
        """Return the mean surface: positions are centred, scaled and rotated onto those of one person, and averaged."""
        total, onto = np.zeros_like(self.first.points), np.zeros((0, 3))
        place, size, weight = np.zeros(3), 0.0, sum(member.weight for member in self.members)
        for member, points in self.points():
            centre = points[self.used].mean(axis=0)
            centred = points[self.used] - centre
            scale = float(np.sqrt((centred**2).mean()))
            if len(onto) == 0:
                onto = centred / scale
            turn, is_mirrored = _rotation(centred, onto)
            if is_mirrored:
                raise InputError(f"{_name(_mesh(member.source, member.number), member.number)}: {_MIRRORED}")
            total[self.used] += member.weight / weight * (centred / scale) @ turn
            place, size = place + member.weight / weight * centre, size + member.weight / weight * scale
        return replace(self.first, points=size * total + place, path=None, point_data={}, face_data={})

    def people(self, part: Manifold) -> Iterator[tuple[_Member, Manifold]]:
        """Yield the cut surface of each person."""
        for member, points in self.points():
            yield member, part._with_core(part.core.moved(points[part.vertices]))

    def combined(self, part: Manifold, chosen: NDArray[np.uint32], settings: FlattenSettings) -> _core.Group:
        """Return the combined distances and shapes of all people."""
        group = _core.Group(part.core, chosen, settings.progress)
        for member, person in self.people(part):
            solver, _, warnings = links_or_better(person, settings)
            for warning in warnings:
                log.warning("surface %d: %s", member.number, warning)
            group.add(person.core, member.weight, solver, settings.threads, settings.progress)
        return group

    def evaluated(self, flat_map: FlatMap, cut: CutManifold[Any], settings: FlattenSettings) -> FlatMap:
        """Return the map with its distortion for all people."""
        part, uv = cut.surface, flat_map.uv[: len(cut.surface)]
        sources = _core.reference_sources(len(part), _core.REFERENCE_SOURCES, settings.seed)
        sums = np.zeros((3, len(part)))
        measured, people = [], []
        weight = sum(member.weight for member in self.members)
        for member, person in self.people(part):
            bands = bands_of(person)
            options = (_core.KEPT_BYTES, settings.seed, bands, settings.threads, settings.progress)
            distances = person.core.judge([uv], sources, "graph", *options)[0]
            one = Distortion._of(distances, person.core.measure(uv, settings.progress), "graph", bands=bands)
            areal = one.triangles.areal - np.average(one.triangles.areal)
            sums += member.weight / weight * np.stack([one.per_point, areal, areal**2])
            measured.append((member.weight, one))
            people.append(member.number)
        return flat_map, sums, measured, people


def _rotation(points: NDArray[np.float64], onto: NDArray[np.float64]) -> tuple[NDArray[np.float64], bool]:
    """Return the rotation that brings points closest to others, and whether a mirror image would fit better."""
    left, values, right = np.linalg.svd(points.T @ onto)
    sign = float(np.sign(np.linalg.det(left @ right)))
    return left @ np.diag([1.0, 1.0, sign]) @ right, sign < 0 and bool(values[2] > 0.05 * values[0])


def _mesh(source: object, number: int) -> Mesh:
    """Read a surface."""
    if isinstance(source, Surface):
        points = np.full((source.count, 3), np.nan)
        points[source.vertices] = source.points
        return Mesh(points, source.vertices[source.faces], structure=source.origin.structure, space=source.space)
    try:
        mesh = as_mesh(source)
    except InputError as error:
        raise InputError(f"surface {number}: {error}") from error
    if mesh is None:
        raise InputError(f"surface {number} is {shown(source)}. Pass a mesh: a file, (points, faces) or a Surface")
    return mesh


def _name(mesh: Mesh, number: int) -> str:
    return f"surface {number}" if mesh.path is None else f"surface {number} ({mesh.path.name})"
