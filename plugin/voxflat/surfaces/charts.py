"""Divide a closed surface or a tube into charts: seams from end to end, and the alignment of the maps."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from voxflat.arguments import Progress, checked_number, is_whole, shown
from voxflat.errors import InputError
from voxflat.io.grid import in_unit, rounded
from voxflat.surfaces.cuts import check_relax
from voxflat.surfaces.cutting import Chart, CutManifold, Tube, cut_out_as, opened_to_disk
from voxflat.surfaces.manifold import Manifold, SurfaceT
from voxflat.surfaces.parts import largest_piece, vertex_at
from voxflat.surfaces.smoothing import cotangents

MOST_CHARTS = 64
"""The largest number of charts of a surface."""

_SWEEPS = 4  # searches for the farthest vertex; more do not make the axis longer
_STRAYING = 10.0  # how many times longer a seam's edge counts for each radian away from the back
_NEAR_SEAM = 0.9 * np.pi  # longitudes beyond this lie on either side of a single chart
CYLINDER = "cylinder"
CAPS = ("anterior", "posterior")
_CAP = 0.6  # circumference at which the ends of a closed surface are cut off, as a share of the largest one
_BANDS = 50  # bands from end to end whose circumferences are compared
_LEAST = 0.05  # share of the surface that each chart leaves to the others

_Floats = NDArray[np.float64]
_Ints = NDArray[np.int64]


@dataclass(frozen=True)
class _Frame:
    """Longitudes around an axis from end to end, seen with the anterior end on the left."""

    ends: tuple[_Ints, _Ints]  # anterior and posterior: a vertex, or the vertices of a boundary loop
    longitudes: _Floats  # of the vertices, from -π to π, 0 at the front, rising upwards; NaN at ends that are vertices
    along: _Floats  # position of the vertices from end to end
    radius: float  # mean radius


def charted(
    part: SurfaceT,
    count: int | str,
    axis: Sequence[Any] | None,
    front: Any,
    overlap: float,
    relax: float | bool | None,
    threads: int | None,
    progress: Progress | None,
) -> list[CutManifold[SurfaceT]]:
    """Divide a surface into charts; see `voxflat.Surface.charts`."""
    is_cylinder = isinstance(count, str) and count == CYLINDER
    if not is_cylinder and not (is_whole(count) and 1 <= int(count) <= MOST_CHARTS):
        raise InputError(f"count is {shown(count)}. Pass a number of charts from 1 to {MOST_CHARTS}, or 'cylinder'")
    sectors = 1 if is_cylinder else int(count)
    check_relax(relax)
    if is_cylinder and relax:
        raise InputError("relax does not apply to a cylinder. Omit it, or choose a number of charts")
    overlap = checked_number(overlap, "overlap")
    if not (np.isfinite(overlap) and overlap >= 0):
        raise InputError(f"overlap is {overlap:g}. Pass the width of the overlap, or 0 for none")
    if overlap and count == 1:
        raise InputError("overlap does not apply to a single chart. Omit it, or choose two or more charts")
    part = largest_piece(part)
    kind = _checked_topology(part)
    if overlap and is_cylinder and kind != "closed":
        raise InputError("overlap does not apply to a tube, which becomes a single cylinder. Omit it")
    graph = _edge_graph(part)
    warnings: list[str] = []
    ends = _ends(part, graph, axis, warnings)
    at_front = None
    if front is not None:
        at_front, of_front = vertex_at(part, front, "front")
        warnings += of_front
    frame = _frame(part, graph, ends, at_front, sectors)
    about = {"count": count, "overlap": overlap, "front": None if at_front is None else part.ids[at_front].tolist()}
    about["axis"] = [part.ids[end[0]].tolist() for end in ends]
    whole = part._complete
    if is_cylinder:
        return _cylinder(whole, part, frame, kind, about, warnings, threads, progress)
    if count == 1:
        seam = _opposite(graph, frame.longitudes, ends)
        length = float(np.linalg.norm(np.diff(part.points[seam], axis=0), axis=1).sum())
        warnings.append(f"the surface is {kind}, so it was cut along a seam from end to end ({rounded(length)} mm)")
        parts = [(part, [seam])]
    else:
        warnings.append(f"the surface is {kind}, so it was divided into {count} charts that reach from end to end")
        parts = [
            (part._with_core(part.core.part_of_faces(faces)), [])
            for faces in _sectors(part, graph, frame, sectors, overlap)
        ]
    charts = []
    for number, (chart, cuts) in enumerate(parts):
        described = {**about, "name": names_of(sectors)[number]}
        onto = _targets(part, frame, 2 * np.pi * number / sectors)
        cut = _chart(whole, chart, cuts, Chart(described, onto), warnings)
        charts.append(opened_to_disk(cut, bool(relax) and relax, threads, progress))
    return charts


def _chart(whole: SurfaceT, part: SurfaceT, cuts: list[_Ints], chart: Chart, texts: list[str]) -> CutManifold[SurfaceT]:
    """Return a chart with its description, its warnings, and where it belongs."""
    cut = cut_out_as(whole, part, cuts, "charts")
    warnings = (*cut.warnings, *(in_unit(text, part.origin.named_unit) for text in texts))
    return replace(cut, chart=chart, warnings=warnings)


def names_of(count: int | str) -> tuple[str, ...]:
    """Return the names of the charts: "front" and "back" for two, and otherwise their numbers from 1."""
    if isinstance(count, str):
        return (CYLINDER, *CAPS)
    return ("front", "back") if count == 2 else tuple(f"chart{number + 1}" for number in range(count))


def _cylinder(
    whole: SurfaceT,
    part: SurfaceT,
    frame: _Frame,
    kind: str,
    about: dict[str, Any],
    warnings: list[str],
    threads: int | None,
    progress: Progress | None,
) -> list[CutManifold[SurfaceT]]:
    """Return a tube, cut open along a seam, and the two caps of a closed surface."""
    is_cap = np.zeros((2, len(part.faces)), dtype=np.bool_)
    if kind == "closed":
        is_cap = _caps(part, frame, 0.0)
        warnings = [*warnings, "the surface is closed, so its ends were cut off as separate charts"]
    tube = part._with_core(part.core.part_of_faces(~(is_cap[0] | is_cap[1])))
    loops = [np.array(loop["vertices"]) for loop in tube.core.topology()["loops"]]
    if len(loops) != 2:
        raise InputError("the ends of the surface cannot be cut off. Pass other ends of the axis, or a finer surface")
    number = np.empty(part.count, dtype=np.int64)
    number[part.vertices] = np.arange(len(part))
    rows = number[tube.vertices]
    left, right = sorted(loops, key=lambda loop: float(frame.along[rows[loop]].mean()))
    seam = _opposite(_edge_graph(tube), frame.longitudes[rows], (left, right))
    onto = _targets(part, frame, 0.0)
    chart = Chart({**about, "name": CYLINDER}, onto, Tube(tube, seam))
    charts = [_chart(whole, tube, [seam], chart, warnings)]
    if kind == "closed":
        for name, faces, sign in zip(CAPS, _caps(part, frame, about["overlap"]), (1, -1), strict=True):
            cap = part._with_core(part.core.part_of_faces(faces))
            chart = Chart({**about, "name": name}, _polar_targets(part, frame, sign))
            cut = _chart(whole, cap, [], chart, warnings)
            charts.append(opened_to_disk(cut, False, threads, progress))
    return charts


def _caps(part: Manifold, frame: _Frame, overlap: float) -> NDArray[np.bool_]:
    """Return the triangles of both ends, up to where the circumference is a share of the largest one."""
    faces, areas = part.faces.astype(np.int64), _areas(part)
    beside = _neighbours(faces)
    poles = np.concatenate(frame.ends).astype(np.uint32)
    apart = part.core.rows(poles)[:, faces].mean(axis=2)
    along = (apart[0] - apart[1]) / 2
    low, high = along.min(), along.max()
    sums, edges = np.histogram(along, _BANDS, (low, high), weights=areas)  # proportional to circumferences
    wide = np.flatnonzero(sums >= _CAP * sums.max())
    reaches = (edges[wide[0]] - low, high - edges[wide[-1] + 1])
    return np.array([~_largest(d > reach + overlap, beside, areas) for d, reach in zip(apart, reaches, strict=True)])


def _checked_topology(part: Manifold) -> str:
    """Return "closed" or "a tube"; raise an error for other surfaces."""
    topology = part.core.topology()
    loops, handles = len(topology["loops"]), topology["handles"]
    if handles:
        raise InputError(
            f"the surface has {handles} handle(s), but charts require a surface without handles. Make the surface with "
            "repair='voxels', or remove the handles from the segmentation"
        )
    if loops not in (0, 2):
        state = "is a disk" if loops == 1 else f"has {loops} boundary loops"
        remedy = "Flatten it without charts" if loops == 1 else "Close the holes, or flatten it without charts"
        raise InputError(f"charts require a closed surface, or a tube with two ends, but this one {state}. {remedy}")
    return "a tube" if loops else "closed"


def _edge_graph(part: Manifold) -> Any:
    """Return the lengths of the edges as a sparse matrix."""
    faces = part.faces.astype(np.int64)
    edges = np.unique(np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    lengths = np.linalg.norm(np.diff(part.points[edges], axis=1)[:, 0], axis=1)
    ends = np.concatenate([edges, edges[:, ::-1]]).T
    return scipy.sparse.csr_array((np.concatenate([lengths, lengths]), tuple(ends)), shape=(len(part), len(part)))


def _path(graph: Any, sources: _Ints, targets: _Ints) -> _Ints:
    """Return the shortest path along edges from any source to any target."""
    lengths, before, _ = scipy.sparse.csgraph.dijkstra(graph, indices=sources, min_only=True, return_predecessors=True)
    path = [int(targets[lengths[targets].argmin()])]
    while before[path[-1]] >= 0:
        path.append(int(before[path[-1]]))
    return np.array(path[::-1])


def _ends(part: Manifold, graph: Any, axis: Sequence[Any] | None, warnings: list[str]) -> tuple[_Ints, _Ints]:
    """Return the anterior and the posterior end: a vertex each, or the boundary loops of a tube."""
    ends = None
    if axis is not None:
        if isinstance(axis, str) or not hasattr(axis, "__len__") or len(axis) != 2:
            raise InputError(f"the axis is {shown(axis)}. Pass two points: the anterior and the posterior end")
        placed = [
            vertex_at(part, point, f"{end} end of the axis")
            for end, point in zip(("anterior", "posterior"), axis, strict=True)
        ]
        ends = [vertex for vertex, _ in placed]
        warnings += [text for _, texts in placed for text in texts]
        if ends[0] == ends[1]:
            raise InputError("the two ends of the axis are the same point. Pass two different points")
    loops = [np.array(loop["vertices"]) for loop in part.core.topology()["loops"]]
    if not loops:
        return (
            _in_order(part, *(np.array([vertex]) for vertex in _poles(part)))
            if ends is None
            else (np.array(ends[:1]), np.array(ends[1:]))
        )
    if ends is None:
        return _in_order(part, *loops)
    apart = [scipy.sparse.csgraph.dijkstra(graph, indices=loop, min_only=True)[ends] for loop in loops]
    nearest = np.argmin(apart, axis=0)
    if nearest[0] == nearest[1]:
        raise InputError("both points of the axis are nearest to the same end of the tube. Pass one point at each end")
    return loops[nearest[0]], loops[nearest[1]]


def _poles(part: Manifold) -> tuple[int, int]:
    """Return two vertices that are as far from each other as possible along the surface."""
    centred, ways = _principal_axes(part)
    first, other, longest = int((centred @ ways[0]).argmax()), 0, 0.0
    for _ in range(_SWEEPS):
        row = part.core.rows(np.array([first], dtype=np.uint32))[0]
        farthest = int(row.argmax())
        if row[farthest] <= longest:
            break
        longest, first, other = float(row[farthest]), farthest, first
    return first, other


def _principal_axes(part: Manifold) -> tuple[_Floats, _Floats]:
    """Return the points without their mean, and their principal axes as rows, which point to higher coordinates."""
    centred = part.points - part.points.mean(axis=0)
    _, _, ways = np.linalg.svd(centred.T @ centred)
    largest = np.abs(ways).argmax(axis=1)
    return centred, ways * np.sign(ways[np.arange(3), largest])[:, None]


def _in_order(part: Manifold, first: _Ints, second: _Ints) -> tuple[_Ints, _Ints]:
    """Return two ends, starting with the one that is lower along the coordinate in which they differ most."""
    apart = part.points[second].mean(axis=0) - part.points[first].mean(axis=0)
    return (first, second) if apart[np.abs(apart).argmax()] > 0 else (second, first)


def _frame(part: Manifold, graph: Any, ends: tuple[_Ints, _Ints], front: int | None, count: int) -> _Frame:
    """Measure longitudes from the front."""
    if front is not None and any(front in end for end in ends):
        raise InputError("the front lies at an end of the axis. Pass a point on the side, or another axis")
    path = _path(graph, *ends)
    longitudes = _harmonic_longitudes(part, path)
    if front is not None:
        start = float(longitudes[front])
    elif count == 1:  # the seam is opposite the shortest path, on the convex side of a bent organ
        start = float(np.angle(np.exp(1j * longitudes[path[1:-1]]).sum()))
    else:  # a broad side
        centred, ways = _principal_axes(part)
        start = float(np.angle(np.exp(1j * longitudes) @ (centred @ ways[2])))
    longitudes = _wrapped(longitudes - start)
    for end in ends:
        if len(end) == 1:
            longitudes[end] = np.nan
    before, after = (scipy.sparse.csgraph.dijkstra(graph, indices=end, min_only=True) for end in ends)
    length = float(before[ends[1]].min())
    return _Frame(ends, longitudes, (before - after) / 2, float(_areas(part).sum()) / (2 * np.pi * length))


def _areas(part: Manifold) -> _Floats:
    """Return the areas of the triangles."""
    a, b, c = (part.points[part.faces[:, corner]] for corner in range(3))
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)


def _harmonic_longitudes(part: Manifold, path: _Ints) -> _Floats:
    """Return the harmonic angles around the axis, which do not depend on the path between the ends but for a constant.

    The angles rise by 2π around the axis. Below the path, its vertices count as 2π higher than above it.
    """
    opened = part.core.cut([path.astype(np.uint32)])
    faces, count = opened.faces.astype(np.int64), len(opened)
    rows = np.empty(count, dtype=np.int64)
    rows[faces.ravel()] = part.faces.ravel()
    order = np.full(len(part), -2 * len(path))
    order[path] = np.arange(len(path))
    edges = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    is_border = ~np.isin(edges @ [count, 1], edges @ [1, count])
    steps = np.diff(order[rows[edges]], axis=1)[:, 0]
    below = np.setdiff1d(edges[is_border & (steps == -1)], edges[is_border & (steps == 1)])
    if not len(below):
        raise InputError("the ends of the axis are neighbours on the surface. Pass points that are farther apart")
    higher = np.zeros(count)
    higher[below] = 2 * np.pi
    matrix, _ = cotangents(opened.points, faces)
    join = scipy.sparse.coo_array((np.ones(count), (np.arange(count), rows)), shape=(count, len(part))).tocsr()
    system, rest = (join.T @ (matrix @ join)).tocsc(), -(join.T @ (matrix @ higher))
    angles = np.zeros(len(part))  # the angle of the first vertex is arbitrary
    angles[1:] = scipy.sparse.linalg.spsolve(system[1:, 1:], rest[1:], permc_spec="MMD_AT_PLUS_A")
    return angles


def _opposite(graph: Any, longitudes: _Floats, ends: tuple[_Ints, _Ints]) -> _Ints:
    """Return a path between the ends that stays close to the longitude π."""
    edges = graph.tocoo()
    off = np.nan_to_num(np.abs(_wrapped(longitudes - np.pi)))
    for end in ends:
        off[end] = 0.0
    factors = 1 + _STRAYING * np.maximum(off[edges.coords[0]], off[edges.coords[1]])
    return _path(scipy.sparse.coo_array((edges.data * factors, edges.coords), shape=graph.shape).tocsr(), *ends)


def _wrapped(angles: _Floats) -> _Floats:
    """Return angles from -π to π."""
    return np.asarray((angles + np.pi) % (2 * np.pi) - np.pi)


def _sectors(part: Manifold, graph: Any, frame: _Frame, count: int, overlap: float) -> list[NDArray[np.bool_]]:
    """Return the triangles of each chart: equal sectors of longitude, grown by half of the overlap."""
    faces, areas = part.faces.astype(np.int64), _areas(part)
    ways = np.nan_to_num(np.exp(1j * frame.longitudes))
    angles = np.angle(ways[faces].sum(axis=1))
    sectors = np.round(angles * count / (2 * np.pi)).astype(np.int64) % count
    beside = _neighbours(faces)
    for sector in range(count):
        if not (inside := sectors == sector).any():
            raise InputError(f"the surface has too few triangles for {count} charts. Choose fewer charts")
        sectors[inside & ~_largest(inside, beside, areas)] = -1
    while (sectors < 0).any():  # strays join their neighbours
        a, b = beside[(sectors[beside] >= 0).sum(axis=1) == 1].T
        lost = np.where(sectors[a] < 0, a, b)
        sectors[lost] = sectors[np.where(sectors[a] < 0, b, a)]
    charts = [sectors == sector for sector in range(count)]
    if overlap:
        charts = [_grown(chart, faces, beside, areas, graph, overlap / 2) for chart in charts]
    return charts


def _neighbours(faces: _Ints) -> _Ints:
    """Return the pairs of triangles that share an edge."""
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    order = np.lexsort(edges.T)
    same = (edges[order][1:] == edges[order][:-1]).all(axis=1)
    return np.column_stack([order[:-1][same], order[1:][same]]) // 3


def _largest(inside: NDArray[np.bool_], beside: _Ints, areas: _Floats) -> NDArray[np.bool_]:
    """Return the connected piece of some triangles that has the largest area."""
    links = beside[inside[beside].all(axis=1)].T
    graph = scipy.sparse.coo_array((np.ones(links.shape[1]), tuple(links)), shape=(len(inside), len(inside)))
    _, pieces = scipy.sparse.csgraph.connected_components(graph, directed=False)
    return np.asarray(inside & (pieces == np.bincount(pieces, areas * inside).argmax()))


def _grown(
    chart: NDArray[np.bool_], faces: _Ints, beside: _Ints, areas: _Floats, graph: Any, width: float
) -> NDArray[np.bool_]:
    """Return a chart with the triangles up to a distance from it, without holes."""
    inside = np.unique(faces[chart])
    apart = scipy.sparse.csgraph.dijkstra(graph, indices=inside, min_only=True, limit=width)
    grown = np.isfinite(apart)[faces].any(axis=1)
    if areas[~grown].sum() < _LEAST * areas.sum():
        raise InputError(f"overlap is {2 * width:g}, so that a chart would cover the surface. Pass a smaller overlap")
    return ~_largest(~grown, beside, areas)


def _polar_targets(part: Manifold, frame: _Frame, sign: int) -> _Floats:
    """Return where the points of a cap would lie beside a cylinder, on its left (1) or right (-1) side."""
    reach = sign * frame.along
    ways = np.stack([sign * np.cos(frame.longitudes), np.sin(frame.longitudes)], axis=1)
    onto = np.full((part.count, 2), np.nan)
    onto[part.vertices] = (reach - np.nanmin(reach))[:, None] * ways
    return onto


def _targets(part: Manifold, frame: _Frame, middle: float) -> _Floats:
    """Return where the points of a chart would lie on a cylinder, by vertex of the complete surface; NaN if unknown."""
    around = _wrapped(frame.longitudes - middle)
    around[np.abs(around) > _NEAR_SEAM] = np.nan
    onto = np.full((part.count, 2), np.nan)
    onto[part.vertices] = np.column_stack([frame.along, frame.radius * around])
    return onto
