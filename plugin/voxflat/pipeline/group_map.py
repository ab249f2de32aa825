"""One flat map for a group of people, whose surfaces have the same triangles, or are resampled to the same ones."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat import _core
from voxflat.arguments import Progress, log, numbers_of, shown
from voxflat.distortion.distortion import Distortion
from voxflat.distortion.figures import json_ready
from voxflat.errors import Cancelled, InputError
from voxflat.io.meshes import Mesh
from voxflat.io.partners import check_side, check_unit
from voxflat.io.provenance import recording
from voxflat.io.sources import as_mesh
from voxflat.maps.flat_map import FlatMap
from voxflat.methods.common import bands_of
from voxflat.methods.method import FlattenSettings
from voxflat.methods.voxflat import Voxflat, usual_solver
from voxflat.pipeline.flat_series import numbered
from voxflat.pipeline.surface import Surface, surface
from voxflat.surfaces.manifold import Manifold, are_triangles
from voxflat.surfaces.standard.sphere import interpolated, named_space, on_unit_sphere, sphere_of
from voxflat.surfaces.standard.template import SIDES

ERRORS = ("relative_error", "relative_error_30mm", "relative_error_10mm")  # of the table
_SAME = "Pass surfaces with the same triangles, such as resampled ones (fs_LR), or pass spheres to resample them"
_TURNS = 4  # rounds of rotation onto the mean of a group
_COVERED = 0.99  # least share of the common mesh that a person's sphere covers
_ALIKE = 0.5  # correlation across the thinnest direction above which a mirror image is recognised


@recording(surfaces=numbered, spheres=numbered)
def flatten_group(
    surfaces: Sequence[object],
    *,
    cuts: object | None = None,
    relax: float | bool | None = None,
    sphere: object | None = None,
    spheres: str | Sequence[object] | None = None,
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

    Surfaces with other triangles are resampled: with `spheres`, each one is brought to the mesh of `sphere` by
    barycentric interpolation on its registered sphere. Only the resampled positions are kept in memory.

    The points of the map are those of the mean surface. The distortion of the map is the mean of that of all people,
    each at their own best scale.

    Parameters
    ----------
    surfaces : sequence of path, Mesh, (points, faces), pyvista.PolyData or Surface
        One surface per person.
    cuts, relax : optional
        Where the surfaces are cut, as in `Surface.cut` of the mean surface.
    sphere : path or mesh, optional
        Registered sphere of the mesh that all surfaces have, as in `Surface.cut` of the mean surface.
    spheres : str or sequence of path, Mesh, array or Registration, optional
        Registered spheres of the people, if their surfaces must be resampled to the mesh of `sphere`: one per surface,
        or the name or pattern of the file next to each surface, such as "lh.sphere.reg" or
        "*_hemi-L_space-fsLR_desc-reg_sphere.surf.gii". All spheres must be registered to the same space.
        `Surface.register` registers a surface to fsaverage.
    weights : array_like of float, shape (K,), optional
        Positive weights of the people; by default, all are equal.
    mirror, seed, threads, memory_limit, progress : optional
        As in `Surface.flatten`.

    Returns
    -------
    FlatMap
        The map. ``metadata["people"]`` lists the distortion for each person, and `FlatMap.spread` tells how much people
        differ at each point.

    Raises
    ------
    InputError
        If there are fewer than two surfaces, or if they do not have the same triangles, hemisphere and unit, or if
        their spheres are not registered to the same space.
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
    >>> len(flat_map.metadata["people"])
    3
    """
    settings = FlattenSettings(mirror=mirror, seed=seed, memory_limit=memory_limit, threads=threads, progress=progress)
    limits: dict[str, Any] = {"threads": settings.threads, "progress": progress}
    _check_count(surfaces)
    people = _People(surfaces if spheres is None else resampled(surfaces, spheres, sphere, limits), weights)
    cut = surface(people.mean(), **limits).cut(cuts, sphere=sphere, relax=relax, **limits)
    group = _CutGroup(people, cut.surface, settings)
    flat_map = Voxflat()._map(cut, settings, group)
    rows = np.concatenate([np.arange(len(cut.surface)), cut.surface._also_merged()[1]])
    return replace(flat_map, spread=group.spread[rows], details={**flat_map.details, "people": group.table})


def _check_count(surfaces: object) -> None:
    if isinstance(surfaces, str | Surface) or not hasattr(surfaces, "__len__"):
        raise InputError(f"surfaces is {shown(surfaces)}. Pass a list of surfaces, one per person")
    if len(surfaces) < 2:
        raise InputError(f"the list has {len(surfaces)} surface(s). Pass at least two, or use flatten")


def resampled(
    surfaces: Sequence[object], spheres: str | Sequence[object], sphere: object | None, limits: dict[str, Any]
) -> list[Mesh]:
    """Return the surfaces on the mesh of a sphere, interpolated through their own registered spheres."""
    common = None if sphere is None else as_mesh(sphere)
    if common is None:
        raise InputError("spheres needs a common mesh. Pass the registered sphere of that mesh as sphere")
    called = "the sphere" if common.path is None else common.path.name
    wanted = on_unit_sphere(common.points, np.unique(common.faces), called)
    if isinstance(spheres, str):
        spheres = [_sphere_beside(source, spheres, number) for number, source in enumerate(surfaces, 1)]
    if not hasattr(spheres, "__len__") or len(spheres) != len(surfaces):
        raise InputError(f"spheres is {shown(spheres)}. Pass one sphere for each of {len(surfaces)} surfaces")
    space = None if common.path is None else named_space(called)
    people, progress = [], limits["progress"]
    for number, (source, own) in enumerate(zip(surfaces, spheres, strict=True), 1):
        if progress is not None and progress("resampling the surfaces", number - 1, len(surfaces)) is False:
            raise Cancelled("resampling the surfaces was cancelled")
        try:
            whole = source if isinstance(source, Surface) else surface(source, **limits)
            placed, warnings = sphere_of(whole, own)
        except InputError as error:
            raise InputError(f"surface {number}: {error}") from error
        path = None if whole.origin.input is None else Path(whole.origin.input)
        unit = whole.origin.unit
        blank = Mesh(wanted, common.faces, path, SIDES[placed.side], space=whole.space, declared_unit=unit)
        name, space = _name(blank, number), space or placed.space
        for warning in warnings:
            log.warning("%s: %s", name, warning)
        if placed.space != space:
            text = f"{placed.name} is registered to {placed.space}, but {called} is in {space} space"
            raise InputError(f"{name}: {text}. Pass spheres that are registered to the same space")
        check_side(name, SIDES[placed.side], common.structure, "Pass the sphere of the same hemisphere", called)
        points, is_inside = interpolated(placed.places[whole.vertices], whole.faces, whole.points, wanted)
        if is_inside.mean() < _COVERED:
            share = f"{placed.name} covers only {100 * is_inside.mean():.0f} % of the points of {called}"
            raise InputError(f"{name}: {share}. Pass a complete hemisphere")
        people.append(replace(blank, points=points))
    return people


def _sphere_beside(source: object, pattern: str, number: int) -> Path:
    """Return the file next to a surface that matches a pattern."""
    if not isinstance(source, str | os.PathLike):
        raise InputError(f"spheres is {pattern!r}, but surface {number} is not a file. Pass one sphere per surface")
    folder = Path(source).parent
    try:
        found = sorted(folder.glob(pattern))
    except (ValueError, NotImplementedError):  # an empty or absolute pattern
        found = []
    if len(found) != 1:
        text = "Pass the name of the registered sphere next to each surface, or a pattern that matches only this file"
        raise InputError(f"spheres is {pattern!r}, but {folder} contains {len(found)} such files. {text}")
    return found[0]


@dataclass(frozen=True)
class _Member:
    """A person of the group."""

    number: int  # in the order of the surfaces
    source: object
    weight: float
    digest: str  # of the positions


class _People:
    """The surfaces of a group, which are read again each time they are needed."""

    def __init__(self, surfaces: Sequence[object], weights: ArrayLike | None) -> None:
        known = np.ones(len(surfaces)) if weights is None else numbers_of(weights, "weights")
        if known.shape != (len(surfaces),) or not ((known > 0) & np.isfinite(known)).all():
            raise InputError(
                f"weights is {shown(weights)}. Pass one positive number for each of {len(surfaces)} surfaces"
            )
        self.first = _mesh(surfaces[0], 1)
        self.used = np.unique(self.first.faces)
        members = []
        for number, (source, weight) in enumerate(zip(surfaces, known.tolist(), strict=True), 1):
            mesh = _mesh(source, number)
            self._check(mesh, number)
            digest = hashlib.sha256(mesh.points[self.used].tobytes()).hexdigest()
            members.append(_Member(number, source, weight, digest))
        self.members = sorted(members, key=lambda member: (member.digest, member.weight))

    def _check(self, mesh: Mesh, number: int) -> None:
        """Raise an error for a surface that does not match the first one."""
        name, first = _name(mesh, number), self.first
        if len(mesh.points) != len(first.points):
            counts = f"{name} has {len(mesh.points)} vertices, but {_name(first, 1)} has {len(first.points)}"
            raise InputError(f"{counts}. {_SAME}")
        check_side(name, mesh.structure, first.structure, "Pass surfaces of the same hemisphere", _name(first, 1))
        check_unit(name, mesh, first.declared_unit or "unknown")
        is_same = np.array_equal(mesh.faces, first.faces) or (
            len(mesh.faces) == len(first.faces) and are_triangles(mesh.faces, first.faces).all()
        )
        if not is_same:
            text = f"{name} does not have the triangles of {_name(first, 1)}"
            raise InputError(f"{text}. {_SAME}")
        if not np.isfinite(mesh.points[self.used]).all():
            raise InputError(f"{name} has vertices without a position. Repair the surface, or omit it")

    def points(self) -> Iterator[tuple[_Member, NDArray[np.float64]]]:
        """Read the positions of all people, in an order that does not depend on that of the surfaces."""
        for member in self.members:
            yield member, _mesh(member.source, member.number).points

    def mean(self) -> Mesh:
        """Return the mean surface by generalized Procrustes analysis (Gower 1975), in the mean pose of the people.

        Positions are centred, scaled, rotated onto the mean of the round before, and averaged. The first round rotates
        them onto one person, of whom hardly anything is left after the others.
        """
        onto, pose = np.zeros((0, 3)), np.zeros((len(self.used), 3))
        place, size, weight = np.zeros(3), 0.0, sum(member.weight for member in self.members)
        for turns in range(_TURNS):
            total = np.zeros_like(pose)
            for member, points in self.points():
                centre, share = points[self.used].mean(axis=0), member.weight / weight
                centred = points[self.used] - centre
                scale = float(np.sqrt((centred**2).mean()))
                turn, is_mirrored = _rotation(centred, onto if len(onto) else centred)
                onto = onto if len(onto) else centred / scale
                if is_mirrored and turns == 0:
                    numbers = sorted([self.members[0].number, member.number])
                    text = f"surface {numbers[1]} is a mirror image of surface {numbers[0]}"
                    raise InputError(f"{text}. Pass surfaces of the same hemisphere")
                total += share * (centred / scale) @ turn
                if turns == 0:
                    pose += share * centred / scale
                    place, size = place + share * centre, size + share * scale
            onto = total
        points = np.zeros_like(self.first.points)
        points[self.used] = size * onto @ _rotation(onto, pose)[0] + place
        return replace(self.first, points=points, path=None, point_data={}, face_data={})


class _CutGroup:
    """The surfaces of a group, cut open as the mean surface."""

    def __init__(self, people: _People, part: Manifold, settings: FlattenSettings) -> None:
        self.people, self.part, self.settings = people, part, settings
        self.table: list[dict[str, object]] = []  # the distortion for each person, in the order of the surfaces
        self.spread = np.zeros(len(part))

    def _surfaces(self) -> Iterator[tuple[_Member, Manifold]]:
        for member, points in self.people.points():
            yield member, self.part._with_core(self.part.core.moved(points[self.part.vertices]))

    def combined(self, chosen: NDArray[np.uint32]) -> _core.Group:
        """Return the combined distances and shapes of all people."""
        threads, progress = self.settings.threads, self.settings.progress
        group = _core.Group(self.part.core, chosen, progress)
        for member, person in self._surfaces():
            solver, _, warnings = usual_solver(person, self.settings)
            for warning in warnings:
                log.warning("surface %d: %s", member.number, warning)
            group.add(person.core, member.weight, solver, threads, progress)
        return group

    def distortion(self, uv: NDArray[np.float64]) -> Distortion:
        """Return the mean distortion of a map for all people, and keep the table and the spread."""
        threads, progress, seed = self.settings.threads, self.settings.progress, self.settings.seed
        sources = _core.reference_sources(len(uv), _core.REFERENCE_SOURCES, seed)
        bands, sums, measured, table = None, np.zeros((4, len(uv))), [], {}
        weights = np.array([member.weight for member in self.people.members])
        weights /= weights.sum()
        for (member, person), weight in zip(self._surfaces(), weights, strict=True):
            bands = bands or bands_of(person)
            distances = person.core.judge([uv], sources, "graph", _core.KEPT_BYTES, seed, bands, threads, progress)[0]
            one = Distortion._of(distances, person.core.measure(uv, progress), "graph", bands=bands)
            assert one.triangles is not None
            change = one.triangles.areal + 2 * np.log2(one.triangles.equal_area_scale)
            sums += weight * np.stack([one.per_point, one.triangles.areal, change, change**2])
            table[member.number] = self._row(member, one)
            thinned = replace(one.triangles, areal=np.zeros(0))
            scatter = one.scatter[:: len(weights)].copy()  # a view would keep all of it
            measured.append(replace(one, per_point=np.zeros(0), scatter=scatter, triangles=thinned))
        per_point, areal, change, square = sums
        self.spread = np.sqrt(np.maximum(square - change**2, 0))
        self.table = [table[number] for number in sorted(table)]
        mean: Distortion = _mean(measured, weights)
        assert mean.triangles is not None
        return replace(
            mean,
            per_point=per_point,
            scatter=np.concatenate([one.scatter for one in measured]),
            pairs=sum(one.pairs for one in measured),
            triangles=replace(mean.triangles, areal=areal),
        )

    def _row(self, member: _Member, distortion: Distortion) -> dict[str, object]:
        """Return the row of a person in the table."""
        assert distortion.triangles is not None
        best = distortion.best_scale
        errors = {name: getattr(best, name) for name in ERRORS}
        beyond = {"area_beyond_1_5": distortion.triangles.area_beyond_1_5}
        name = _name(_mesh(member.source, member.number), member.number)
        row = {"surface": name, "weight": member.weight, "scale": best.scale, **errors, **beyond}
        return dict(json_ready(row))


def _mean(values: Sequence[Any], weights: NDArray[np.float64]) -> Any:
    """Return the mean of all numbers of similar objects; others are those of the first."""
    first = values[0]
    if is_dataclass(first) and not isinstance(first, type):
        each = {field.name: [getattr(value, field.name) for value in values] for field in fields(first)}
        return replace(first, **{name: _mean(all_, weights) for name, all_ in each.items()})
    return float(np.dot(weights, values)) if isinstance(first, float) else first


def _rotation(points: NDArray[np.float64], onto: NDArray[np.float64]) -> tuple[NDArray[np.float64], bool]:
    """Return the rotation that brings points closest to others, and whether a mirror image would fit better."""
    left, values, right = np.linalg.svd(points.T @ onto)
    sign = float(np.sign(np.linalg.det(left @ right)))
    alike = values[2] > _ALIKE * np.linalg.norm(points @ left[:, 2]) * np.linalg.norm(onto @ right[2])
    return left @ np.diag([1.0, 1.0, sign]) @ right, sign < 0 and bool(alike)


def _mesh(source: object, number: int) -> Mesh:
    """Read a surface."""
    if isinstance(source, Surface):
        points = np.full((source.count, 3), np.nan)
        points[source.vertices] = source.points
        origin, faces = source.origin, source.vertices[source.faces]
        return Mesh(points, faces, structure=origin.structure, space=source.space, declared_unit=origin.unit)
    try:
        mesh = as_mesh(source)
    except InputError as error:
        raise InputError(f"surface {number}: {error}") from error
    if mesh is None:
        raise InputError(f"surface {number} is {shown(source)}. Pass a mesh: a file, (points, faces) or a Surface")
    return mesh


def _name(mesh: Mesh, number: int) -> str:
    return f"surface {number}" if mesh.path is None else f"surface {number} ({mesh.path.name})"
