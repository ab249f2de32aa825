"""The judge: what flat maps, ours or other tools', do to a surface."""

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat import _core
from voxflat.arguments import (
    Progress,
    checked_choice,
    checked_kind,
    checked_seed,
    checked_switch,
    checked_threads,
    free_memory,
    is_whole,
    log,
    shown,
)
from voxflat.distortion.distortion import Distortion, table_of_several
from voxflat.errors import InputError
from voxflat.io.provenance import Record, Recorded, telling
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.matching import Matched, loaded, match, vertices_of
from voxflat.pipeline.surface import surface as _surface
from voxflat.surfaces.manifold import Manifold

_SAME = 1e-3  # lengths of edges that agree so far, with their usual length: files hold float32
_MOST_SOURCES = 2**31  # more than any surface has points: all of them

_USUAL_SOURCES = 300
_FEWEST_SOURCES = 6
_USUAL_WORK = 4e8
"""Exact distances from one source take time in proportion to the number of points to the power of 1.5. This much work
took 60 s of CPU time on a bumpy sheet, half a minute on two cores, and less on a cortex."""

_KEPT_SHARE = 4  # a quarter of the free memory


@dataclass(frozen=True, eq=False)
class JudgedMap:
    """A flat map beside the surface that it was judged on.

    Parameters
    ----------
    uv : ndarray of float64, shape (N, 2)
        Places in the plane, mm.
    vertex_ids : ndarray of int64, shape (N,)
        The vertex of the surface's input that each one is; for voxels the vertex of the surface.
    faces : ndarray of uint32, shape (F, 3)
        Triangles.
    distortion : Distortion
        What the map does to the surface.

    Examples
    --------
    >>> surface = voxflat.samples.hill()
    >>> voxflat.measure(surface, surface.points[:, :2])
    <Distortion: relative error 4.92 ± 0.07 %, 300 sources, 132000 pairs, exact distances>
    """

    uv: NDArray[np.float64]
    vertex_ids: NDArray[np.int64]
    faces: NDArray[np.uint32]
    distortion: Distortion

    def __repr__(self) -> str:
        error = 100 * self.distortion.raw.relative_error
        return f"<JudgedMap: {len(self.uv)} points, {len(self.faces)} triangles, relative error {error:.1f} %>"


@dataclass(frozen=True, eq=False)
class Comparison(Recorded):
    """Several flat maps of one surface, judged from the same sources.

    Parameters
    ----------
    maps : dict of str to JudgedMap
        By the names that they were given.
    provenance : dict
        What made it.

    Examples
    --------
    >>> surface = voxflat.samples.hill()
    >>> voxflat.compare(surface, {"seen from above": surface.points[:, :2]})
    <Comparison of 1 maps: seen from above>
    """

    maps: dict[str, JudgedMap]
    provenance: Record = field(default_factory=dict)

    def __repr__(self) -> str:
        names = textwrap.shorten(", ".join(self.maps), 200, placeholder=" ...")
        return f"<Comparison of {len(self.maps)} maps: {names}>"

    def __getitem__(self, name: str) -> Distortion:
        """Return what a map does to the surface."""
        return self.maps[name].distortion

    def figures(self) -> dict[str, Any]:
        """Return the figures of each map by its name, ready for JSON: undefined ones are None.

        Examples
        --------
        >>> surface = voxflat.samples.hill()
        >>> comparison = voxflat.compare(surface, {"seen from above": surface.points[:, :2]})
        >>> list(comparison.figures())[:2]
        ['seen from above']
        """
        return {name: judged.distortion.figures() for name, judged in self.maps.items()}

    def table(self) -> str:
        """Return the figures as a table of text, a map a column.

        Examples
        --------
        >>> surface = voxflat.samples.hill()
        >>> comparison = voxflat.compare(surface, {"seen from above": surface.points[:, :2]})
        >>> print(comparison.table().splitlines()[0])
        from 300 random sources, ± standard error; exact distances over the triangles
        """
        return table_of_several({name: judged.distortion for name, judged in self.maps.items()})


def measure(
    surface: object,
    flat: object,
    *,
    sources: int | None = None,
    reference: str | None = None,
    on_surface: bool = False,
    seed: int = 0,
    threads: int | None = None,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> Distortion:
    """Measure a flat map of a surface, whoever made it.

    Distances are measured on the surface as it was cut for the map: over the map's triangles, and not across its seams.

    Parameters
    ----------
    surface : Surface, or anything that `voxflat.surface` takes
        The surface.
    flat : path, FlatMap, Mesh, (places, faces), (places, faces, vertices), or array_like of shape (V, 2) or (V, 3)
        The map: a FreeSurfer patch (``lh.cortex.patch.flat``), GIFTI or another mesh file of the surface's vertices in
        the same order, a map of voxflat (.npz), the texture coordinates of an .obj, .ply or .vtp, or places in the
        plane, mm. Its triangles, or those of the surface with a place for all corners, are judged; a third coordinate
        must be constant. With ``vertices``, which vertex of the surface each place is, a cut may have doubled some.
        Where an .obj has several texture coordinates at a vertex the surface is cut.
    sources : int, optional
        How many random points distances are measured from. By default 300, or fewer where exact distances on a large
        surface would take more than half a minute on two cores: 69 at 32,000 points, 6 from 160,000 points on, and
        fewer where maps with different cuts are compared. From few sources the standard errors are rough estimates,
        and so are the errors of single points in a heat map: give 300 for a figure that you publish.
    reference : {"exact", "graph"}, optional
        How distances are measured, as in `geodesic`. By default "exact" for meshes, whatever their size, and "graph"
        for surfaces of voxels, whose triangles are an estimate themselves.
    on_surface : bool
        Judge on the given surface as it is. By default a map of voxflat is judged on the geometry that it was made on,
        which it knows: one made midway to the pial surface is not measured on the white one. That is logged.
    seed : int
        Of the choice of sources.
    threads : int, optional
        How many threads work; by default one for each core.
    memory_limit : int, optional
        Bytes that may be used; by default what is free.
    progress : callable, optional
        As in `voxflat.flatten`.

    Returns
    -------
    Distortion

    Raises
    ------
    InputError
        If the map does not belong to the surface, or is not flat.
    Cancelled
        If `progress` returned False.

    Examples
    --------
    >>> surface = voxflat.samples.hill()
    >>> flat_map = surface.flatten()
    >>> round(voxflat.measure(surface, flat_map).raw.relative_error, 3)
    0.036
    """
    how: dict[str, Any] = {"sources": sources, "reference": reference, "on_surface": on_surface, "seed": seed}
    limits: dict[str, Any] = {"threads": threads, "memory_limit": memory_limit, "progress": progress}
    return compare(surface, {"": flat}, **how, **limits)[""]


@telling()
def compare(
    surface: object,
    maps: Mapping[str, object],
    *,
    sources: int | None = None,
    reference: str | None = None,
    on_surface: bool = False,
    seed: int = 0,
    threads: int | None = None,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Measure several flat maps of a surface from the same sources.

    The sources are random vertices that all maps have. Maps of the same triangles with the same cuts share their
    distances, which are measured once.

    Parameters
    ----------
    maps : dict of str to map
        The maps, each as in `measure`, by their names.
    surface, sources, reference, on_surface, seed, threads, memory_limit, progress
        As in `measure`. All maps are judged on one geometry.

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        As in `measure`, or if no vertex is in all maps, or maps were made on different geometries.
    Cancelled
        If `progress` returned False.

    Examples
    --------
    >>> surface = voxflat.samples.hill()
    >>> maps = {"default": surface.flatten(), "seen from above": surface.points[:, :2]}
    >>> print(voxflat.compare(surface, maps).table().splitlines()[0])
    from 300 random sources, ± standard error; exact distances over the triangles
    """
    threads, seed = checked_threads(threads), checked_seed(seed)
    if sources is not None and (not is_whole(sources) or sources < 1):
        raise InputError(f"sources is {shown(sources)}. Pass a whole number, at least 1.")
    if reference is not None:
        checked_choice(reference, "reference", ("exact", "graph"))
    checked_kind(maps, "collection of maps", "items", "maps by their names")
    if not maps:
        raise InputError("maps is empty. Pass at least one map to measure.")
    whole = _surface(surface, threads=threads, memory_limit=memory_limit, progress=progress)
    reference = reference or ("graph" if whole.is_voxels else "exact")
    maps = {name: loaded(flat) for name, flat in maps.items()}
    geometry = Geometry(whole) if checked_switch(on_surface, "on_surface") else geometry_of(whole, maps)
    matched = {name: match(geometry.surface, flat) for name, flat in maps.items()}
    for name, one in matched.items():
        geometry.check(name, one)
    topologies = {name: _topology(name, one) for name, one in matched.items()}
    groups = _grouped(list(matched.values()))
    if sources is None:
        sources = _usual_sources([len(group[0][0].uv) for group in groups], reference)
    # others are computed twice
    kept = int(max(_core.KEPT_BYTES, (free_memory() if memory_limit is None else memory_limit) // _KEPT_SHARE))
    distances: dict[int, dict[str, Any]] = {}
    for group, chosen in zip(groups, _sources(groups, int(min(sources, _MOST_SOURCES)), seed), strict=True):
        first = group[0][0]
        places = [one.uv[order] for one, order in group]
        found = first.core.judge(places, chosen, reference, kept, seed, threads, progress)
        for (one, order), measured in zip(group, found, strict=True):
            per_point = np.empty_like(measured["per_point"])
            per_point[order] = measured["per_point"]
            distances[id(one)] = measured | {"per_point": per_point}
    judged = {}
    for name, one in matched.items():
        more = {"topology": topologies[name], "voxel_size": whole.voxel_size, "unit": whole.metadata.get("unit", "mm")}
        distortion = Distortion._of(distances[id(one)], one.core.measure(one.uv, progress), reference, **more)
        judged[name] = JudgedMap(one.uv, one.vertices, one.core.faces, distortion)
    return Comparison(judged)


def _grouped(matched: list[Matched]) -> list[list[tuple[Matched, NDArray[np.int64]]]]:
    """Put maps of the same triangles and cuts together, each with which of its vertices the first map's are."""
    groups: list[list[tuple[Matched, NDArray[np.int64]]]] = []
    for one in matched:
        for group in groups:
            order = group[0][0].correspondence(one)
            if order is not None:
                group.append((one, order))
                break
        else:
            groups.append([(one, np.arange(len(one.uv)))])
    return groups


def _sources(groups: list[list[tuple[Matched, NDArray[np.int64]]]], count: int, seed: int) -> list[NDArray[np.uint32]]:
    """Choose sources that all maps have, as vertices of each group's surface."""
    firsts = [group[0][0] for group in groups]
    if len(firsts) == 1:
        return [_core.reference_sources(len(firsts[0].uv), count, seed)]
    known = [np.unique(one.vertices, return_index=True) for one in firsts]
    common = known[0][0]
    for vertices, _ in known[1:]:
        common = np.intersect1d(common, vertices)
    if len(common) == 0:
        raise InputError("The maps have no vertex in common. Measure them one by one.")
    chosen = common[_core.reference_sources(len(common), count, seed)]
    return [first[np.searchsorted(vertices, chosen)].astype(np.uint32) for vertices, first in known]


def _usual_sources(points: list[int], reference: str) -> int:
    """Return from how many sources maps are measured by default; `points` has the size of each group of maps."""
    if reference == "graph":
        return _USUAL_SOURCES
    return min(_USUAL_SOURCES, max(_FEWEST_SOURCES, int(_USUAL_WORK / sum(count**1.5 for count in points))))


def _topology(name: str, one: Matched) -> dict[str, int]:
    """Return what the surface is like as the map cuts it; it is a manifold, or would have been refused."""
    found = one.core.topology()
    components = len(found["components"])
    if components > 1:
        called = f"The map {name}" if name else "The map"
        raise InputError(f"{called} has {components} pieces, between which distances are not defined. Pass one piece.")
    return {
        "components": components,
        "euler": found["euler"],
        "loops": len(found["loops"]),
        "handles": found["handles"],
    }


@dataclass(frozen=True, eq=False)
class Geometry:
    """A surface where maps say that it lies."""

    surface: Manifold  # the given one, its vertices moved to where the maps have them
    known: NDArray[np.bool_] | None = None  # vertices of the whole that the maps have; None: of the given geometry
    said_by: str = ""  # the name of the map that says so

    def check(self, name: str, matched: Matched) -> None:
        """Refuse a map with vertices of which it is not known where they lie."""
        if self.known is None:
            return
        unknown = matched.vertices[~self.known[matched.vertices]]
        if len(unknown):
            raise InputError(
                f"{_called(self.said_by)} was made on another geometry than that of the given surface, and "
                f"{_called(name)} has {len(np.unique(unknown))} vertices of unknown position there. Pass the surface "
                "that the map was made on (with its pial surface), or pass on_surface to use the given one."
            )


def geometry_of(whole: Manifold, maps: Mapping[str, object]) -> Geometry:
    """Return the surface on which maps are judged: the given one, unless ours were made on another geometry."""
    ours = {name: flat for name, flat in maps.items() if isinstance(flat, FlatMap) and not flat.is_voxels}
    places = {name: vertices_of(whole, flat) for name, flat in ours.items()}
    moved = [name for name, flat in ours.items() if not _agree(flat, flat.points, whole.points[places[name]])]
    if not moved or whole.is_voxels:
        return Geometry(whole)
    first = moved[0]
    points, known = whole.points.copy(), np.zeros(whole.count, dtype=np.bool_)
    for name in [first, *(name for name in ours if name != first)]:
        flat, at = ours[name], places[name]
        if name != first:
            both = known[whole.vertices[at]]
            expected = np.where(both[:, None], points[at], flat.points)
            if name not in moved or not _agree(flat, flat.points, expected):
                raise InputError(
                    f"{_called(first)} was made on {_made_on(ours[first])}, but {_called(name)} on {_made_on(flat)}, a "
                    "different geometry. Measure them one by one, or pass on_surface to use the given surface for both."
                )
        points[at] = flat.points
        known[whole.vertices[at]] = True
    log.warning(
        "%s was made on another geometry than that of the given surface (%s). All figures refer to the geometry of the "
        "map. Pass on_surface to use the given surface.",
        _called(first),
        _made_on(ours[first]),
    )
    return Geometry(whole._with_core(whole.core.moved(points)), known, first)


def _agree(flat: FlatMap, one: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    """Tell whether a map's triangles have the same edges in both places, wherever these lie."""
    ends = flat.faces, np.roll(flat.faces, 1, axis=1)
    lengths = [np.linalg.norm(points[ends[0]] - points[ends[1]], axis=2) for points in (one, other)]
    return bool(np.abs(lengths[0] - lengths[1]).max() <= _SAME * np.median(lengths[0]))


def _made_on(flat: FlatMap) -> str:
    of = flat.metadata.get("input")
    return f"{flat.metadata.get('measured_on', 'another surface')}" + (f", {of}" if of else "")


def _called(name: str) -> str:
    return name or "The map"
