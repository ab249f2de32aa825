"""Measure the distortion of flat maps, made by voxflat or any other tool."""

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat import _core
from voxflat.arguments import (
    Progress,
    amount,
    check_memory,
    checked_choice,
    checked_instance,
    checked_seed,
    checked_switch,
    checked_threads,
    free_memory,
    is_whole,
    log,
    shown,
    workers,
)
from voxflat.distortion.bands import Bands, checked_bands, usual_bands
from voxflat.distortion.distortion import Distortion, table_of_several
from voxflat.errors import InputError
from voxflat.evaluation.charts import charts_of, total
from voxflat.evaluation.sides import other_side
from voxflat.io.provenance import Record, Recorded, recording
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.matching import Matched, loaded, match, vertices_of
from voxflat.pipeline.cut_surface import CutSurface
from voxflat.pipeline.surface import surface as _surface
from voxflat.read_only import ReadOnly
from voxflat.surfaces.manifold import Manifold

_SAME = 1e-3  # tolerance for edge lengths, relative to their median, because files hold float32
_MOST_SOURCES = 2**31  # more than the points of any surface: use all

_USUAL_SOURCES = 300
_FEWEST_SOURCES = 6
_USUAL_WORK = 4e8  # sum of points ** 1.5 over all sources: half a minute on two cores for a bumpy surface

_KEPT_SHARE = 4  # kept rows may use a quarter of the free memory


@dataclass(frozen=True, eq=False)
class MeasuredMap(ReadOnly):
    """A flat map with the part of the surface on which it was measured.

    A `Comparison` contains one for each map.

    Parameters
    ----------
    uv : ndarray of float64, shape (N, 2)
        Positions in the plane, in mm.
    vertex_ids : ndarray of int64, shape (N,)
        Vertex number of each position in the input; for a surface of voxels, the vertex number in the surface.
    faces : ndarray of uint32, shape (F, 3)
        Triangles.
    distortion : Distortion
        Distortion of the map.

    See Also
    --------
    compare : Measure several maps of a surface.

    Examples
    --------
    >>> surface = voxflat.samples.hill()
    >>> voxflat.measure(surface, surface.points[:, :2])
    <Distortion: relative error 3.9 % of interior pairs, 3.9 % of all pairs at the best scale, 300 sources, ...>
    """

    uv: NDArray[np.float64]
    vertex_ids: NDArray[np.int64]
    faces: NDArray[np.uint32]
    distortion: Distortion

    def __repr__(self) -> str:
        size, error = f"{len(self.uv)} points, {len(self.faces)} triangles", self.distortion._summary()
        return f"<MeasuredMap: {size}, relative error {error}>"


@dataclass(frozen=True, eq=False)
class Comparison(ReadOnly, Recorded):
    """Several flat maps of one surface, measured from the same sources.

    `voxflat.compare` returns it.

    Parameters
    ----------
    maps : dict of str to MeasuredMap
        The maps, keyed by name.
    provenance : dict
        Record of how the maps were measured.

    See Also
    --------
    compare : Measure several maps of a surface.

    Examples
    --------
    >>> surface = voxflat.samples.hill()
    >>> voxflat.compare(surface, {"seen from above": surface.points[:, :2]})
    <Comparison of 1 maps: seen from above>
    """

    maps: dict[str, MeasuredMap]
    provenance: Record = field(default_factory=dict)

    def __repr__(self) -> str:
        names = textwrap.shorten(", ".join(self.maps), 200, placeholder=" ...")
        return f"<Comparison of {len(self.maps)} maps: {names}>"

    def __getitem__(self, name: str) -> Distortion:
        """Return the distortion of a map."""
        return self.maps[name].distortion

    def figures(self) -> dict[str, object]:
        """Return the measures of each map, ready for JSON.

        Undefined measures are None.

        Returns
        -------
        dict
            The results of `Distortion.figures`, keyed by map name.
        """
        return {name: measured.distortion.figures() for name, measured in self.maps.items()}

    def table(self) -> str:
        """Return a table of the measures as text.

        There is one column per map.

        Returns
        -------
        str
            The table.
        """
        return table_of_several({name: measured.distortion for name, measured in self.maps.items()})


def measure(
    surface: object,
    flat: object,
    *,
    sources: int | None = None,
    reference: str | None = None,
    bands: Sequence[float] | None = None,
    on_surface: bool = False,
    lower_bound: bool = False,
    seed: int = 0,
    threads: int | None = None,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> Distortion:
    """Measure the distortion of a flat map that was made with any tool.

    Distances are measured on the surface as cut for the map: over the triangles of the map, and not across its seams.
    For a map in several charts, distances are measured within each chart, each at its own best scale, and averaged over
    all pairs; `compare` also returns each chart. For a voxflat map with a `FlatMap.period`, distances are measured
    across its seam, and to the nearest copy on the map.

    Parameters
    ----------
    surface : Surface, CutSurface, or any input of `voxflat.surface`
        The surface.
    flat : path, FlatMap, Mesh, (places, faces), (places, faces, vertices), or array_like of shape (V, 2) or (V, 3)
        The map: a FreeSurfer patch (``lh.cortex.patch.flat``); GIFTI or another mesh file with the surface's vertices
        in the same order; a voxflat map (.npz); the texture coordinates of an .obj, .ply, .glb or .vtp; or positions
        (``places``) in the plane, in mm. The triangles of the map are measured or, if it has none, the triangles of the
        surface whose corners all have a position. A third coordinate must be constant. ``vertices`` gives the vertex of
        the surface for each position, so that cuts may duplicate vertices. The surface is cut
        where a vertex has several texture coordinates; points that a file has split there are found by their position.
    sources : int, optional
        Number of random points from which distances are measured. By default 300, or fewer if exact distances on a
        large surface would take more than half a minute on two cores: 69 for 32,000 points, 6 for 160,000 points or
        more, and fewer if maps with different cuts are compared. With few sources, the standard errors and the errors
        of single points in a heat map are imprecise; use 300 for published figures.
    reference : {"exact", "graph"}, optional
        How distances are measured, as in `Surface.geodesic`. By default "exact" for meshes of any size, and "graph" for
        surfaces of voxels, whose triangles are themselves an estimate.
    bands : sequence of four float, optional
        Upper ends of the distance bands for which errors are also given, ascending, in the unit of the surface. By
        default 5, 10, 15 and 30 mm for surfaces of the size of a human hemisphere, and for others lengths that are
        about the same share of the square root of the area. `Distortion.bands` contains them.
    on_surface : bool
        Measure distances on the given surface. By default, a voxflat map is measured on the geometry on which it was
        made: a map made midway between the white and pial surfaces is not measured on the white surface. A warning
        reports this.
    lower_bound : bool
        Also compute a lower bound for the relative error, over all pairs, of any map with the same cuts. The bound
        holds with 99 % confidence, and with certainty for maps of up to 50 points. It takes about 4 minutes of CPU time
        for 10,000 points. It is not defined (NaN) for a map with a period, and for several charts together.
    seed : int
        Seed of the random choice of sources.
    threads, memory_limit, progress : optional
        As in `Surface.flatten`.

    Returns
    -------
    Distortion
        The distortion of the map.

    Raises
    ------
    InputError, Cancelled
        If the map does not belong to the surface or is not flat, or if `progress` returned False.

    See Also
    --------
    compare : Measure several maps of a surface.

    Examples
    --------
    >>> surface = voxflat.samples.hill()
    >>> flat_map = surface.flatten()
    >>> round(voxflat.measure(surface, flat_map).raw.relative_error, 3)
    0.036
    """
    options: dict[str, Any] = {"sources": sources, "reference": reference, "bands": bands}
    options |= {"on_surface": on_surface, "lower_bound": lower_bound, "seed": seed}
    limits: dict[str, Any] = {"threads": threads, "memory_limit": memory_limit, "progress": progress}
    return compare(surface, {"": flat}, **options, **limits)[""]


@recording()
def compare(
    surface: object,
    maps: Mapping[str, object],
    *,
    sources: int | None = None,
    reference: str | None = None,
    bands: Sequence[float] | None = None,
    on_surface: bool = False,
    lower_bound: bool = False,
    seed: int = 0,
    threads: int | None = None,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Measure the distortion of several flat maps of a surface from the same sources.

    The sources are random vertices that all maps contain. Distances are measured only once for maps with the same
    triangles and cuts.

    Parameters
    ----------
    surface : Surface, CutSurface, or any input of `voxflat.surface`
        The surface. All maps are measured on the same geometry.
    maps : dict of str to map
        The maps, keyed by name; each as in `measure`.
    sources, reference, bands, on_surface, lower_bound, seed, threads, memory_limit, progress : optional
        As in `measure`.

    Returns
    -------
    Comparison
        The distortion of each map. For a map in several charts, the entries "NAME, chart 1", "NAME, chart 2" and so on,
        largest first, come before the entry of the whole map. Charts have their own sources.

    Raises
    ------
    InputError
        As in `measure`; also if the maps have no vertex in common, or were made on different geometries.
    Cancelled
        If `progress` returned False.

    See Also
    --------
    measure : Measure a single map.

    Examples
    --------
    >>> surface = voxflat.samples.hill()
    >>> maps = {"default": surface.flatten(), "seen from above": surface.points[:, :2]}
    >>> print(voxflat.compare(surface, maps).table().splitlines()[0])
    from 300 random sources, ± standard error; exact distances over the triangles
    """
    threads, seed = checked_threads(threads), checked_seed(seed)
    if sources is not None and (not is_whole(sources) or sources < 1):
        raise InputError(f"sources is {shown(sources)}. Pass a whole number, at least 1")
    if reference is not None:
        checked_choice(reference, "reference", ("exact", "graph"))
    ends = None if bands is None else checked_bands(bands)
    checked_switch(lower_bound, "lower_bound")
    checked_instance(maps, Mapping, "collection of maps", "a dict of maps, keyed by name")
    if not maps:
        raise InputError("maps is empty. Pass at least one map to measure")
    if isinstance(surface, CutSurface):  # distances are measured along the cuts of the map
        surface = surface.whole
    whole = _surface(surface, threads=threads, memory_limit=memory_limit, progress=progress)
    reference = reference or ("graph" if whole.is_voxels else "exact")
    maps = {name: loaded(flat) for name, flat in maps.items()}
    geometry = Geometry(whole) if checked_switch(on_surface, "on_surface") else geometry_of(whole, maps)
    matched = {name: match(geometry.surface, flat) for name, flat in maps.items()}
    for name, flat_map in matched.items():
        geometry.check(name, flat_map)
        if text := other_side(whole, flat_map):
            log.warning(f"{name}: {text}" if name else text)
    more: dict[str, Any] = {"threads": threads, "memory_limit": memory_limit, "progress": progress}
    more |= {"lower_bound": lower_bound, "seed": seed}
    return Comparison(measured_maps(whole, matched, sources, reference, ends, **more))


def measured_maps(
    whole: Manifold,
    matched: Mapping[str, Matched],
    sources: int | None,
    reference: str,
    ends: Bands | None = None,
    *,
    lower_bound: bool = False,
    seed: int,
    threads: int | None,
    memory_limit: int | None,
    progress: Progress | None,
) -> dict[str, MeasuredMap]:
    """Measure maps that are matched with a surface, and the charts of each."""
    charts = {name: charts_of(flat) for name, flat in matched.items()}
    joined = {id(flat): flat.joined() for parts in charts.values() for flat, _ in parts}
    groups = _grouped([flat for flat, _ in joined.values()])
    if sources is None:
        sources = _usual_sources([len(group[0][0].uv) for group in groups], reference)
    shares = {
        id(joined[id(part)][0]): len(rows) / len(matched[name].uv)
        for name, parts in charts.items()
        for part, rows in parts
    }
    ends = ends or usual_bands(max(flat.core.area for flat in matched.values()), whole.origin.unit)
    if lower_bound:
        need = max(group[0][0].core.lower_bound_memory_need(workers(threads)) for group in groups)
        check_memory(need, memory_limit, "use fewer threads, or do not request the lower bound")
        log.info("up to %s of memory will be used for the lower bound", amount(need))
    # rows beyond this limit are computed twice
    cache = int(max(_core.KEPT_BYTES, (free_memory() if memory_limit is None else memory_limit) // _KEPT_SHARE))
    distances: dict[int, dict[str, Any]] = {}
    for group, chosen in zip(groups, _sources(groups, shares, int(min(sources, _MOST_SOURCES)), seed), strict=True):
        first = group[0][0]
        places = [flat.uv[order] for flat, order in group]
        results = first.core.judge(places, chosen, reference, cache, seed, ends, threads, progress, period=first.period)
        bound = {}
        if lower_bound and first.period is None:
            bound = {"lower_bound": first.core.lower_bound(reference, seed, threads, progress)}
        for (flat_map, order), of_map in zip(group, results, strict=True):
            per_point = np.empty_like(of_map["per_point"])
            per_point[order] = of_map["per_point"]
            distances[id(flat_map)] = of_map | {"per_point": per_point} | bound
    measured: dict[str, MeasuredMap] = {}
    for name, parts in charts.items():
        of_charts = []
        for number, (flat_map, _) in enumerate(parts, 1):
            topology = _topology(flat_map)
            more = {"topology": topology, "voxel_size": whole.voxel_size, "unit": whole.origin.unit, "bands": ends}
            triangles = flat_map.core.measure(flat_map.uv, progress)
            closed, copies = joined[id(flat_map)]
            of_distances = distances[id(closed)] | {"per_point": distances[id(closed)]["per_point"][copies]}
            of_charts.append(Distortion._of(of_distances, triangles, reference, **more))
            called = name if len(parts) == 1 else f"{name}, chart {number}".removeprefix(", ")
            measured[called] = MeasuredMap(flat_map.uv, flat_map.vertices, flat_map.core.faces, of_charts[-1])
        if len(parts) > 1:
            flat_map = matched[name]
            distortion = total(of_charts, [rows for _, rows in parts], flat_map.core.measure(flat_map.uv, progress))
            measured[name] = MeasuredMap(flat_map.uv, flat_map.vertices, flat_map.core.faces, distortion)
    return measured


def _grouped(matched: list[Matched]) -> list[list[tuple[Matched, NDArray[np.int64]]]]:
    """Group maps with the same triangles and cuts, each with the order of its vertices in the group's first map."""
    groups: list[list[tuple[Matched, NDArray[np.int64]]]] = []
    for flat in matched:
        for group in groups:
            order = group[0][0].correspondence(flat)
            if order is not None and group[0][0].period == flat.period:
                group.append((flat, order))
                break
        else:
            groups.append([(flat, np.arange(len(flat.uv)))])
    return groups


def _sources(
    groups: list[list[tuple[Matched, NDArray[np.int64]]]], shares: Mapping[int, float], count: int, seed: int
) -> list[NDArray[np.uint32]]:
    """Choose sources as vertices of the surface of each group: the same ones for all maps in one chart.

    Charts of a map, which have no vertices in common, have their own sources, in proportion to their vertices.
    """
    firsts = [group[0][0] for group in groups]
    numbers = [max(_FEWEST_SOURCES, round(count * shares[id(first)])) for first in firsts]
    sources = [
        _core.reference_sources(len(first.uv), min(number, count), seed)
        for first, number in zip(firsts, numbers, strict=True)
    ]
    whole = [n for n, first in enumerate(firsts) if shares[id(first)] == 1]
    if len(whole) > 1:
        uniques = [np.unique(firsts[n].vertices, return_index=True) for n in whole]
        common = uniques[0][0]
        for vertices, _ in uniques[1:]:
            common = np.intersect1d(common, vertices)
        if len(common) == 0:
            raise InputError("the maps have no vertex in common. Measure the maps one by one")
        chosen = common[_core.reference_sources(len(common), count, seed)]
        for n, (vertices, first) in zip(whole, uniques, strict=True):
            sources[n] = first[np.searchsorted(vertices, chosen)].astype(np.uint32)
    return sources


def _usual_sources(points: list[int], reference: str) -> int:
    """Return the default number of sources; `points` contains the number of points of each group of maps."""
    if reference == "graph":
        return _USUAL_SOURCES
    return min(_USUAL_SOURCES, max(_FEWEST_SOURCES, int(_USUAL_WORK / sum(count**1.5 for count in points))))


def _topology(flat: Matched) -> dict[str, int]:
    """Return the topology of the surface as cut by the map; the surface is known to be a manifold."""
    topology = flat.core.topology()
    counts = {"components": len(topology["components"]), **{key: topology[key] for key in ("euler", "handles")}}
    return counts | {"loops": len(topology["loops"])}


@dataclass(frozen=True, eq=False)
class Geometry:
    """A surface with the vertex positions that the maps use."""

    surface: Manifold  # the given surface, with vertices at the maps' positions
    known: NDArray[np.bool_] | None = None  # vertices of the whole surface in the maps; None for the given geometry
    said_by: str = ""  # name of the map that defines the geometry

    def check(self, name: str, matched: Matched) -> None:
        """Raise an error for a map that has vertices with unknown positions."""
        if self.known is None:
            return
        unknown = matched.vertices[~self.known[matched.vertices]]
        if len(unknown):
            raise InputError(
                f"{_called(self.said_by)} was made on a geometry that differs from that of the given surface, and does "
                f"not define the positions of {len(np.unique(unknown))} vertices of {_called(name)}. Pass the surface "
                "on which the map was made (with its pial surface), or pass on_surface to use the given one"
            )


def geometry_of(whole: Manifold, maps: Mapping[str, object]) -> Geometry:
    """Return the surface on which maps are measured: the given one, or the one on which voxflat maps were made.

    Maps of groups do not count, because their mean surface is nobody's, nor do maps without a surface.
    """
    known = {name: flat for name, flat in maps.items() if isinstance(flat, FlatMap) and flat.has_surface}
    made = {name: flat for name, flat in known.items() if flat.spread is None}
    ours = {name: flat for name, flat in made.items() if not flat.is_voxels}
    places = {name: vertices_of(whole, flat) for name, flat in ours.items()}
    moved = [name for name, flat in ours.items() if not _agree(flat, flat.points, whole.points[places[name]])]
    if not moved or whole.is_voxels:
        return Geometry(whole)
    first = moved[0]
    points, is_known = whole.points.copy(), np.zeros(whole.count, dtype=np.bool_)
    for name in [first, *(name for name in ours if name != first)]:
        flat, other = ours[name], places[name]
        if name != first:
            both = is_known[whole.vertices[other]]
            expected = np.where(both[:, None], points[other], flat.points)
            if name not in moved or not _agree(flat, flat.points, expected):
                raise InputError(
                    f"{_called(first)} was made on {_made_on(ours[first])}, but {_called(name)} was made on "
                    f"{_made_on(flat)}, whose geometry differs. Measure the maps one by one, or pass on_surface to use "
                    "the given surface for both"
                )
        points[other] = flat.points
        is_known[whole.vertices[other]] = True
    log.warning(
        "%s was made on a geometry (%s) other than that of the given surface. All measures refer to the geometry of "
        "the map. Pass on_surface to use the given surface",
        _called(first),
        _made_on(ours[first]),
    )
    return Geometry(whole._with_core(whole.core.moved(points)), is_known, first)


def _agree(flat: FlatMap, places: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    """Return whether a map's triangles have the same edge lengths for both sets of positions."""
    ends = flat.faces, np.roll(flat.faces, 1, axis=1)
    lengths = [np.linalg.norm(points[ends[0]] - points[ends[1]], axis=2) for points in (places, other)]
    return bool(np.abs(lengths[0] - lengths[1]).max() <= _SAME * np.median(lengths[0]))


def _made_on(flat: FlatMap) -> str:
    path = flat.origin.input
    return (flat.origin.measured_on or "another surface") + (f", {path}" if path else "")


def _called(name: str) -> str:
    return name or "the map"
