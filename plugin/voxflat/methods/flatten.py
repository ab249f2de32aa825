"""A surface goes in, a flat map comes out."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat import _core
from voxflat.arguments import (
    Prepared,
    Progress,
    amount,
    check_memory,
    checked_seed,
    checked_threads,
    choose_sources,
    log,
    prepare,
    source_count,
    sources_on,
)
from voxflat.distances.geodesic import LANDMARKS, SOLVERS, refuse, stored_rows
from voxflat.distances.rows import open_rows
from voxflat.distances.store import prepare_store
from voxflat.distortion.figures import Distortion
from voxflat.errors import InputError
from voxflat.maps.flat_map import FlatMap
from voxflat.methods.saucan2006 import checked_bound, glued_whole
from voxflat.methods.schwartz1989 import Mapmaker, doubts
from voxflat.surfaces.range_image import pixels_of
from voxflat.surfaces.region import Cutout, cut_out
from voxflat.surfaces.surface import Surface
from voxflat.surfaces.surface import surface as _surface

_TORN_WARNING = 0.05  # share of a map
_SAMPLES = 625  # 25 x 25, as in the paper
_LONG_RANGE = 50  # fewer leave more starts in a fold, more change little
_REFERENCES = 200  # random points from which a map is judged, as the core does
_METHODS = ("voxflat", "grossmann2002", "zigelman2002", "schwartz1989", "saucan2006")
_SAMPLINGS = ("decimation", "farthest", "curvature", "random", "grid")
_SPOTS = 2  # sources from which distances along links are compared with exact ones
_MUCH_TOO_LONG = 0.01  # 0.1 % is usual
_NO_GOOD_MAP = 0.25  # 0.05 to 0.15 is usual on a cortex

__all__ = ["flatten"]


def flatten(
    surface: object,
    *,
    method: str = "voxflat",
    label: int | None = None,
    threshold: float | None = None,
    spacing: Sequence[float] | None = None,
    affine: ArrayLike | None = None,
    keep: object | None = None,
    drop: object | None = None,
    seed_point: Sequence[int] | int | None = None,
    radius: float | None = None,
    polygon: ArrayLike | None = None,
    cuts: object | None = None,
    relax: float | bool | None = None,
    sources: int | ArrayLike | None = None,
    sampling: str | None = None,
    geodesic: str | None = None,
    weighting: float | None = None,
    link_lengths: str | None = None,
    neighbourhood: int | str | None = None,
    starts: int | None = None,
    bound: float | None = None,
    seed: int = 0,
    keep_rows: bool = False,
    store: str | os.PathLike[str] | None = None,
    threads: int | None = None,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> FlatMap:
    """Flatten a surface into the plane, keeping geodesic distances.

    Parameters
    ----------
    surface : ndarray, path, image object, Volume, (points, faces), Mesh, pyvista.PolyData or Surface
        A label volume or an intensity volume (I, J, K) of any bool, integer or floating-point type and any strides, or
        a mesh of triangles in RAS+ mm; `voxflat.surface` makes a `Surface` of either, with more choices.
    method : {"voxflat", "grossmann2002", "zigelman2002", "schwartz1989", "saucan2006"}
        "voxflat" works on triangles: straight links over the surface, then the map of least stress whose triangles keep
        their shape; none is turned over. "grossmann2002" works on the 26-neighbour graph of a volume's surface voxels:
        chain-code geodesics, classical scaling, radial functions (Grossmann, Kiryati, Kimmel 2002). "zigelman2002"
        works on triangles: fast marching, classical scaling of what decimation leaves, and the rest re-inserted in
        reverse order (Zigelman, Kimmel, Kiryati 2002). "schwartz1989" works on triangles: exact distances within
        neighbourhoods and from some sources, and from random starts Newton steps to the least of Sammon's stress; every
        point takes part (Schwartz, Shaw, Wolfson 1989). "saucan2006" measures no distances: patches within 10° of their
        planes (Appleboim, Saucan, Zeevi 2006) are glued, and cut further where no triangle could keep `bound`.
    label : int, optional
        Foreground is this label.
    threshold : float, optional
        Foreground is what is greater. Without label and threshold the volume must have a single label.
    spacing : sequence of 3 floats, optional
        Voxel size, mm, for volumes without an affine.
    affine : array_like, shape (4, 4), optional
        From voxel indices to RAS+ mm, for volumes without an affine.
    keep : mask, path or vertex numbers, optional
        What to flatten. For volumes a mask of the volume's shape (array, path, image object or Volume); for meshes a
        mask of shape (V,), vertex numbers, or a file: FreeSurfer label or patch, GIFTI label or shape, or a GIFTI
        surface whose triangles are the patch.
    drop : as `keep`, optional
        What not to flatten, such as the medial wall; ``"medial wall"`` finds it where white and pial surface touch.
    seed_point : sequence of 3 ints, or int, optional
        Voxel indices, or for meshes the number of a vertex; the surface within `radius` of it is flattened.
    radius : float, optional
        Radius of the geodesic disk around `seed_point`, mm along the surface.
    polygon : array_like of voxel indices (k, 3) or vertex numbers (k,), optional
        Corners; what is flattened is the smaller side of the closed path along edges that is shortest from each to the
        next.
    cuts : list of paths, or path of a file, optional
        Paths of neighbouring vertices (voxel indices (k, 3), or vertex numbers (k,)) along which the surface is cut
        before; `voxflat.path` finds them. Or a file of cuts, as `voxflat.cut` saves it. What is still no disk is cut
        open automatically, and that is said; ``[]`` forbids it.
    relax : bool or float, optional
        Cut the disk further, from its boundary inwards, where that relieves the map most: as long as it pays (True), or
        up to a length in mm, of which yours (`cuts`) are part; or not at all (False). By default what was closed like a
        sphere is cut as long as it pays, and nothing else.
    sources : int or array_like, optional
        How many points distances are measured from, or which: voxel indices (m, 3), or vertex numbers (m,). By default
        400, "grossmann2002": 1000, "zigelman2002": 625, "schwartz1989": 50, or all points if there are fewer. To
        "schwartz1989" they are a sampling of long distances beside the neighbourhoods (Wolfson, Schwartz 1989); with 0
        most starts end in a fold.
    sampling : {"farthest", "curvature", "random", "decimation", "grid"}, optional
        How sources are chosen: evenly, each farthest from the others along the surface (the default); up to four times
        as close where the surface bends ("curvature"; not for "grossmann2002"); or at random.
        "zigelman2002" only: what decimation leaves (its default; vertices that cannot go without harm to the surface
        are sources, too); or the pixels on a grid over a `range_image`, between which the rest is placed by bilinear
        functions.
    geodesic : {"graph", "marching", "exact"}, optional
        "voxflat" only. What measures the distances that the map keeps, as in `voxflat.geodesic`; by default "graph".
    weighting : float, optional
        "voxflat" only. From 0, local, where near distances and the shape of triangles count ten times as much as usual,
        to 1, global, where they count a tenth and far distances rule; by default 0.5.
    link_lengths : {"chain-code", "euclidean"}, optional
        "grossmann2002" only. Lengths of the links between neighbouring voxels: the paper's unbiased estimator (0.9016,
        1.289, 1.615 voxels, or its generalisation to anisotropic voxels; the default), or 1, √2, √3 for comparison.
    neighbourhood : int or "all", optional
        "schwartz1989" only. Distances from each point are kept to those that so many edges lead to, or to all. By
        default as far as a tenth of the points, which the paper found to be enough, and a hundred if there are so many.
    starts : int, optional
        "schwartz1989" only. Random starts, of which the map of least stress is kept; by default 3, as in the paper.
        ``metadata["starts"]`` is the stress of each.
    bound : float, optional
        "saucan2006" only. The greatest factor by which lengths may change: max(σ1, 1/σ2) ≤ C for every triangle. By
        default 1.5. Where patches cannot be glued to one piece that is an error; `voxflat.patches` keeps pieces.
    seed : int
        Seed of every random choice. The same seed gives the same map, bit by bit, for any number of threads.
    keep_rows : bool
        Keep the distances from all sources to all points in `FlatMap.rows`.
    store : path, optional
        A directory to keep them in, on disk instead of in memory; `FlatMap.rows` is then a memory map. If the work is
        interrupted, the same call goes on where it was. `voxflat.open_rows` opens it.
    threads : int, optional
        By default one a core.
    memory_limit : int, optional
        Bytes that may be used; by default what is free. The need is computed before the start.
    progress : callable, optional
        Called as ``progress(stage, done, total)`` about every 20 ms; if it returns False the work is cancelled.

    Returns
    -------
    FlatMap
        What the user should know of it is logged (logger ``voxflat``) and stands in ``metadata["warnings"]``.

    Raises
    ------
    InputError
        For anything wrong with the input; the message names the value and the remedy.
    Cancelled
        If `progress` returned False.
    """
    if method not in _METHODS:
        raise InputError(f"method is {method!r}; give {', '.join(map(repr, _METHODS[:-1]))} or {_METHODS[-1]!r}")
    seed, threads = checked_seed(seed), checked_threads(threads)
    given_sampling, sampling = sampling, sampling or ("decimation" if method == "zigelman2002" else "farthest")
    how = _How(sources, sampling, seed, keep_rows, store, threads, memory_limit, progress)
    place: dict[str, Any] = {"label": label, "threshold": threshold, "spacing": spacing, "affine": affine}
    patch: dict[str, Any] = {"keep": keep, "seed_point": seed_point, "radius": radius}
    if method != "voxflat":
        refuse(method, geodesic=geodesic, weighting=weighting)
    if method != "schwartz1989":
        refuse(method, neighbourhood=neighbourhood, starts=starts)
    if method != "saucan2006":
        refuse(method, bound=bound)
    else:
        refuse(method, sources=sources, keep_rows=keep_rows or None, sampling=given_sampling)
        relax = False if relax is None else relax  # gluing cuts where it must
    if method == "grossmann2002":
        refuse(method, drop=drop, polygon=polygon, cuts=cuts, relax=relax or None)
        prepared = prepare(
            surface,
            **place,
            **patch,
            link_lengths=link_lengths or "chain-code",
            memory_limit=memory_limit,
            progress=progress,
        )
        return _grossmann2002(prepared, how)
    refuse(method, link_lengths=link_lengths)
    if method != "voxflat":
        refuse(method, store=store)
    solver, weighting = _checked_voxflat(geodesic, weighting)
    mapmaker, bound = Mapmaker.checked(neighbourhood, starts), checked_bound(bound)
    whole = _surface(surface, **place, memory_limit=memory_limit, threads=how.threads, progress=progress)
    patch |= {"drop": drop, "polygon": polygon, "cuts": cuts, "relax": relax}
    cut = cut_out(whole, **patch, threads=how.threads, progress=progress)
    if method == "schwartz1989":
        return _schwartz1989(cut, how, mapmaker)
    if method == "zigelman2002":
        return _zigelman2002(cut, how)
    if method == "saucan2006":
        return _saucan2006(cut, how, bound)
    return _voxflat(cut, how, solver, weighting)


@dataclass(frozen=True)
class _How:
    """How to flatten, whatever the method."""

    sources: int | ArrayLike | None
    sampling: str
    seed: int
    keep_rows: bool
    store: str | os.PathLike[str] | None
    threads: int | None
    memory_limit: int | None
    progress: Progress | None

    def check_memory(
        self, need: int, sources: int, points: int, remedy: str = "take a smaller patch or fewer sources"
    ) -> int:
        """Return the memory needed in all, if it is there."""
        if self.store is not None:
            need += _core.store_memory_need(points, sources, self.threads or os.cpu_count() or 1)
        elif self.keep_rows:
            need += 4 * sources * points
        check_memory(need, self.memory_limit, remedy)
        log.info("up to %s of memory are needed", amount(need))
        return need


def _checked_voxflat(geodesic: str | None, weighting: float | None) -> tuple[str, float]:
    """Return what only the method "voxflat" knows, or its defaults."""
    solver = "graph" if geodesic is None else geodesic
    if solver not in SOLVERS:
        raise InputError(f"geodesic is {geodesic!r}; give 'graph', 'marching' or 'exact'")
    weighting = 0.5 if weighting is None else weighting
    if not (isinstance(weighting, Real) and 0 <= weighting <= 1):
        raise InputError(f"weighting is {weighting!r}; give a number from 0, local, to 1, global")
    return solver, float(weighting)


def _voxflat(cut: Cutout, how: _How, solver: str, weighting: float) -> FlatMap:
    part = cut.part
    chosen = sources_on(part, how.sources, how.sampling, how.seed, how.progress, fewest=3, usual=LANDMARKS)
    threads = how.threads or os.cpu_count() or 1
    need = how.check_memory(part.core.memory_need(len(chosen), threads, how.store is not None), 0, 0)
    store = None
    if how.store is not None:
        store = prepare_store(how.store, part.core, part.ids, chosen, geodesic=solver, progress=how.progress)
    key = None if store is None else store.key
    result = part.core.voxflat(chosen, how.seed, solver, weighting, how.threads, how.progress, key)
    if store is not None:
        store.tell(result["found"])
    told: dict[str, Any] = {"geodesic": solver, "weighting": weighting}
    rows = None
    if store is not None:
        told["store"], rows = str(store.path), open_rows(store.path).rows
    elif how.keep_rows:
        rows = part.core.rows(chosen, solver, how.threads, how.progress)
    energies, converged = result["convergence"]
    told["descent"] = {"converged": converged, "energies": energies}
    doubts = []
    if solver == "graph":
        told["distance_error"] = error = _error_of_links(part, chosen[:_SPOTS], how)
        if error > _MUCH_TOO_LONG:
            doubts = [
                f"distances along links are {100 * error:.1f} % too long here, which thin triangles can cause; "
                "geodesic='exact' measures them exactly"
            ]
    return _over_triangles("voxflat", cut, how, result, need, rows, told, doubts)


def _error_of_links(part: Surface, sources: NDArray[np.uint32], how: _How) -> float:
    """Return by which part of themselves distances along links from some sources are longer than exact ones."""
    found, exact = (
        np.asarray(part.core.rows(sources, solver, how.threads, how.progress), dtype=np.float64)
        for solver in ("graph", "exact")
    )
    apart = exact > 0
    return float((found[apart] / exact[apart] - 1).mean())


def _zigelman2002(cut: Cutout, how: _How) -> FlatMap:
    part = cut.part
    if how.sampling not in _SAMPLINGS:
        raise InputError(f"sampling is {how.sampling!r}; give {', '.join(map(repr, _SAMPLINGS[:-1]))} or 'grid'")
    count = source_count(part, how.sources, fewest=3, usual=_SAMPLES)
    grid = vertices = None
    if how.sampling == "grid":
        if count is None:
            raise InputError("sampling is 'grid', which chooses the sources itself; give their number, or leave it out")
        grid = pixels_of(part)
    elif count is None or how.sampling != "decimation":
        vertices = sources_on(part, how.sources, how.sampling, how.seed, how.progress, fewest=3, usual=_SAMPLES)
        count = len(vertices)
    threads = how.threads or os.cpu_count() or 1
    need = how.check_memory(part.core.zigelman2002_memory_need(count, threads), count, len(part))
    result = part.core.zigelman2002(count, how.seed, vertices, grid, "circle", how.threads, how.progress)
    rows = None
    if how.keep_rows:
        rows = part.core.rows(result["sources"], "marching", how.threads, how.progress)
    placed_by = "re-insertion" if grid is None else "bilinear functions between a grid's pixels"
    return _over_triangles("zigelman2002", cut, how, result, need, rows, {"placed_by": placed_by})


def _schwartz1989(cut: Cutout, how: _How, mapmaker: Mapmaker) -> FlatMap:
    part = cut.part
    if isinstance(how.sources, int | np.integer) and how.sources == 0:
        if how.keep_rows:
            raise InputError("sources is 0, so there are no rows to keep; give sources, or leave out keep_rows")
        chosen = np.empty(0, dtype=np.uint32)
    else:
        chosen = sources_on(part, how.sources, how.sampling, how.seed, how.progress, fewest=3, usual=_LONG_RANGE)
    rings = mapmaker.rings(part, how.progress)
    threads = how.threads or os.cpu_count() or 1
    need = part.core.schwartz1989_memory_need(rings, len(chosen), threads, how.progress)
    kept = "among all" if rings is None else f"within {rings} rings of each"
    remedy = "give a smaller neighbourhood or patch, or take the method 'voxflat'"
    need = how.check_memory(need, len(chosen), len(part), f"distances {kept} of {len(part)} points are kept: {remedy}")
    result = part.core.schwartz1989(rings, chosen, mapmaker.starts, how.seed, how.threads, how.progress)
    if np.isnan(result["planarity"]):
        result["planarity"] = None  # there were no sources
    rows = part.core.rows(chosen, "exact", how.threads, how.progress) if how.keep_rows else None
    energies, converged = result["convergence"]
    told: dict[str, Any] = {
        "neighbourhood": rings or "all",
        "pairs": result["pairs"],
        "starts": result["stresses"],
        "descent": {"converged": converged, "energies": energies},
    }
    return _over_triangles("schwartz1989", cut, how, result, need, rows, told, doubts(result["stresses"]))


def _saucan2006(cut: Cutout, how: _How, bound: float) -> FlatMap:
    part, uv, told = glued_whole(cut.part, bound, how.threads, how.progress)
    referred = _core.reference_sources(len(part), _REFERENCES, how.seed)
    judged = part.core.judge([uv], referred, "graph", 4 * _REFERENCES * len(part), how.seed, how.threads, how.progress)
    result = {
        "uv": uv,
        "normals": part.core.normals,
        "sources": np.empty(0, dtype=np.uint32),
        "eigenvalues": np.empty(0),
        "planarity": None,
        "distortion": judged[0],
    }
    faces = part.faces[: len(cut.faces)]  # holes that were closed come last
    cut = replace(cut, part=part, faces=faces, metadata={**cut.metadata, "points": len(np.unique(part.vertices))})
    seams = told["seams"]
    doubts = [f"{seams['cuts']:.0f} mm of seams between patches stay cut"] if seams["cuts"] > 0 else []
    return _over_triangles("saucan2006", cut, how, result, 0, None, {"bound": bound, **told}, doubts)


def _over_triangles(
    method: str,
    cut: Cutout,
    how: _How,
    result: dict[str, Any],
    need: int,
    rows: NDArray[np.float32] | None,
    told: dict[str, Any],
    doubts: Sequence[str] = (),
) -> FlatMap:
    """Return the map of a surface of triangles, with what the user should know of it."""
    part, chosen = cut.part, result["sources"]
    warnings = [*cut.remarks, *doubts]
    of_triangles = part.core.measure(result["uv"], how.progress)
    distortion = Distortion.of(result["distortion"], of_triangles, "graph", voxel_size=part.voxel_size)
    if not told.get("descent", {"converged": True})["converged"]:
        steps = len(told["descent"]["energies"])
        warnings.append(f"descent ended after {steps} steps, before it converged: a better map may exist")
    error = distortion.best_scale.relative_error
    if error > _NO_GOOD_MAP:
        warnings.append(
            f"distances in the map are {100 * error:.0f} % wrong on average, at any scale: as it is, this surface has "
            "no good map; relax=True cuts it where that helps, or give cuts, or a smaller patch"
        )
    if distortion.triangles is not None and distortion.triangles.crossings:
        warnings.append(f"the map lies on itself: its boundary crosses itself {distortion.triangles.crossings} times")
    elif distortion.triangles is not None and distortion.triangles.covering and not distortion.triangles.flipped:
        warnings.append(f"the map lies on itself: {distortion.triangles.covering} triangles cover another one")
    if distortion.triangles is not None and distortion.triangles.flipped:
        warnings.append(
            f"triangles turned over in the map, where it folds: {distortion.triangles.flipped} of {len(part.faces)}"
        )
    return FlatMap(
        uv=result["uv"],
        points=part.points,
        normals=result["normals"],
        ids=part.ids,
        faces=cut.faces,
        torn=np.zeros(len(cut.faces), dtype=np.bool_),
        sources=chosen.astype(np.int64),
        eigenvalues=result["eigenvalues"],
        distortion=distortion,
        metadata={"method": method, **cut.metadata, **_told(how, chosen, result, need, warnings), **told},
        rows=rows,
    )


def _grossmann2002(prepared: Prepared, how: _How) -> FlatMap:
    part = prepared.part
    part.check_flattenable(how.progress)  # the first reason to refuse is the one that matters
    chosen = choose_sources(prepared, how.sources, how.sampling, how.seed, how.progress, fewest=3)
    need = how.check_memory(part.memory_need(len(chosen), how.threads or os.cpu_count() or 1), len(chosen), len(part))
    ids = part.voxels.astype(np.int64)
    store = None
    if how.store is not None:
        lengths = prepared.metadata["link_lengths"]
        store = prepare_store(
            how.store, part, ids, chosen, geodesic="chain", link_lengths=lengths, progress=how.progress
        )
    result = part.grossmann2002(chosen, how.seed, how.threads, how.progress)
    topology = part.topology(how.progress)
    faces, torn = part.map_faces(result["uv"], how.progress)
    warnings = _grossmann2002_warnings(prepared, topology, float(torn.mean()))
    metadata = {
        "method": "grossmann2002",
        **prepared.metadata,
        **_told(how, chosen, result, need, warnings),
        "topology": topology,
        "torn_faces": float(torn.mean()),
    }
    rows = None
    if store is not None:
        metadata["store"], rows = str(store.path), stored_rows(store, part, chosen, how.threads, how.progress).rows
    elif how.keep_rows:
        rows = part.rows(chosen, how.threads, how.progress)
    return FlatMap(
        uv=result["uv"],
        points=part.points,
        normals=result["normals"],
        ids=ids,
        faces=faces,
        torn=torn,
        sources=chosen.astype(np.int64),
        eigenvalues=result["eigenvalues"],
        distortion=Distortion.of(result["distortion"], None, "chain", voxel_size=_voxel_size(prepared)),
        metadata=metadata,
        rows=rows,
    )


def _voxel_size(prepared: Prepared) -> float:
    return float(np.cbrt(abs(np.linalg.det(np.asarray(prepared.metadata["affine"])[:3, :3]))))


def _told(how: _How, chosen: NDArray[Any], result: dict[str, Any], need: int, warnings: list[str]) -> dict[str, Any]:
    """Log what the user should know of a map, and return what its metadata say of how it was made."""
    for warning in warnings:
        log.warning(warning)
    return {
        "seed": how.seed,
        "sources": len(chosen),
        "sampling": how.sampling if how.sources is None or isinstance(how.sources, int | np.integer) else "given",
        "planarity": result["planarity"],
        "warnings": warnings,
        "memory_need_bytes": need,
        "versions": {
            "voxflat": _core.__version__,
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
    }


def _grossmann2002_warnings(prepared: Prepared, topology: dict[str, Any], torn: float) -> list[str]:
    """Return what the user should know of a map over the 26-neighbour graph."""
    sizes, used = prepared.whole.component_sizes(), len(prepared.part)
    warnings = list(prepared.remarks)
    if len(sizes) > 1 and not (prepared.metadata["keep"] or prepared.metadata["seed_point"] is not None):
        warnings.append(f"{len(sizes)} components: the largest, {used} of {sum(sizes)} surface voxels, is used")
    if topology["euler_characteristic"] != 1:
        warnings.append(
            f"Euler characteristic {topology['euler_characteristic']} instead of a disk's 1: the patch has holes, "
            "handles, or banks that touch, across which distances jump. The method 'voxflat' keeps such banks apart"
        )
    if torn > _TORN_WARNING:
        warnings.append(
            f"{100 * torn:.1f} % of the map is torn: neighbours there are none on the surface; "
            "see the heat map, and take a smaller patch"
        )
    return warnings
