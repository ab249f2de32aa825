"""The method "voxflat": the map of least stress whose triangles keep their shape, from coarse to fine."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from voxflat.arguments import checked_choice, is_number, log, shown
from voxflat.distances.geodesic import SOLVERS
from voxflat.distances.rows import open_rows
from voxflat.distances.sources import SAMPLINGS, source_choice
from voxflat.distances.store import prepare_store
from voxflat.errors import AreaBoundError, InputError
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.matching import match
from voxflat.maps.worst_places import area_changes
from voxflat.maps.worst_search import worst_places
from voxflat.methods.common import MUCH, error_of_distances, map_over_triangles
from voxflat.methods.method import How, OverTriangles
from voxflat.methods.start import cut_as, places_of
from voxflat.surfaces.cutting import Cutout, Where
from voxflat.surfaces.manifold import Manifold

SCALES = ("distances", "areas")  # what a map's mm may be right for

_WITHIN = 0.99
"""The power of a bound on areas that descent aims at: holes that were closed belong to what it counts as the whole."""


@dataclass(frozen=True, kw_only=True)
class Voxflat(OverTriangles):
    """Flatten by the least energy of distances and triangles; the default.

    Among the maps that turn no triangle over, the one of least energy

        Σ_b a_b · mean over the pairs of band b of ρ((d - δ)/δ)  +  β · mean over the surface of ψ(J)

    is found by descent from coarse to fine, with d the distances in the map, δ those along the surface, J the map's
    Jacobian on a triangle, and ρ, ψ as in docs/concepts.md. No triangle is turned over, and none covers another.

    Parameters
    ----------
    sources : int or array_like of int
        How many points distances are measured from; all, if there are fewer. Or which: voxel indices (m, 3), or vertex
        numbers (m,). More than 400 changed no map that was measured.
    sampling : {"farthest", "curvature", "random"}
        How sources are chosen: evenly, each farthest from the others along the surface; up to four times as close where
        the surface bends; or at random.
    geodesic : {"graph", "marching", "exact"}, optional
        What measures the distances that the map keeps, as in `Surface.geodesic`. By default "graph", but where that is
        more than 1 % off exact distances from a sample of sources, which thin triangles can cause, "marching", and
        "exact" where that is, too.
    weighting : float
        From 0, local, where near distances and the shape of triangles count ten times as much as usual, to 1, global,
        where they count a tenth and far distances rule.
    scale : {"distances", "areas"}
        What the map's mm are right for. A surface that is not flat has no map in which both are: one whose area is that
        of the surface has distances that are too long. With "distances" their mean relative error is the least of any
        scale; with "areas" the map has the surface's area. ``distortion.triangles.equal_area_scale`` is the factor from
        a map to the one with the surface's area, ``distortion.best_scale.scale`` to the one with the best distances.
    max_area : float, optional
        The greatest factor, above 1, by which any triangle may change its area. At the scale that keeps the area of the
        whole; `voxflat.worst_places` says where a map changes areas most. From the usual map descent goes on with a
        price on everything beyond, which grows until nothing is. ``metadata["area_change"]`` is the factor that is
        reached. If no such map is found, that is an `AreaBoundError`, with the best map and the cuts that would help.
    start : map, optional
        A flat map of the surface, of whatever tool, to go on from. As `voxflat.measure` takes it: descent ends in the
        map of least energy near it, which lies as the start does. It may lie anywhere,
        at any scale, mirrored or not; the map is turned as it lies, and not mirrored. If no part of the surface is
        chosen and nothing says where to cut, the map is of everything that the start covers, cut as the start is.
        Otherwise the start needs a place for every triangle, and may lack cuts, whose lips are drawn apart. A few folds
        are mended; a start that cannot be mended is refused.

    Examples
    --------
    >>> import numpy as np
    >>> import voxflat
    >>> from voxflat.methods import Voxflat
    >>> depth = voxflat.range_image(np.zeros((9, 9)), 1.0)
    >>> flat_map = depth.flatten(Voxflat(sources=20, scale="areas"))
    >>> flat_map.metadata["scale"]
    'areas'
    """

    name: ClassVar[str] = "voxflat"
    summary: ClassVar[str] = "over the triangles of a surface"
    takes_store: ClassVar[bool] = True

    sources: int | ArrayLike = 400
    sampling: str = "farthest"
    geodesic: str | None = None
    weighting: float = 0.5
    scale: str = "distances"
    max_area: float | None = None
    start: object | None = None

    def __post_init__(self) -> None:
        """Check the options."""
        checked_choice(self.sampling, "sampling", SAMPLINGS)
        if self.geodesic is not None:
            checked_choice(self.geodesic, "geodesic", SOLVERS)
        if not (is_number(self.weighting) and 0 <= self.weighting <= 1):
            raise InputError(f"weighting is {shown(self.weighting)}; give a number from 0, local, to 1, global")
        checked_choice(self.scale, "scale", SCALES)
        if self.max_area is not None and not (is_number(self.max_area) and 1 < self.max_area < np.inf):
            raise InputError(f"max_area is {shown(self.max_area)}; give a factor greater than 1, such as 2")

    def _cut(self, surface: Manifold, where: Where, how: How) -> Cutout:
        """Cut a surface open to a disk: as the start is, where nothing else says where."""
        if self.start is None or where.is_given or surface.steps:
            return super()._cut(surface, where, how)
        return cut_as(surface, match(surface, self.start), how.threads, how.progress)

    def _map(self, cut: Cutout, how: How) -> FlatMap:
        """Flatten a disk of triangles, from nothing or from a map."""
        part, weighting = cut.part, float(self.weighting)
        max_area = None if self.max_area is None else float(self.max_area)
        places = None if self.start is None else places_of(cut, match(cut.whole, self.start))
        choice = source_choice(part, self.sources, self.sampling, how.seed, fewest=3, at_most_all=True)
        kept = "stored" if how.store is not None else "kept" if how.keep_rows else "dropped"
        need = how.check_memory(part.core.memory_need(choice.count, how.workers, kept))
        chosen = choice.made(how.progress)
        links_error = error_of_distances(part, "graph", how)
        solver, error, doubts = _solver(part, self.geodesic, links_error, how)
        store = None
        if how.store is not None:
            store = prepare_store(how.store, part.core, part.ids, chosen, geodesic=solver, progress=how.progress)
        wanted = (chosen, how.seed, solver, weighting, self.scale, how.keep_rows, how.threads, how.progress)
        bound, key = None if max_area is None else max_area**_WITHIN, None if store is None else store.key
        result = part.core.voxflat(*wanted, key, places, max_area=bound)
        if store is not None:
            store.tell(result["found"])
        told: dict[str, Any] = {
            "geodesic": solver,
            "distance_error": error,
            "weighting": weighting,
            "scale": self.scale,
        }
        if self.start is not None:
            told["start"] = True
        rows = result["rows"]
        if store is not None:
            told["store"], rows = str(store.path), open_rows(store.path).rows
        energies, converged = result["convergence"]
        told["descent"] = {"converged": converged, "energies": energies}
        more: dict[str, Any] = {"sampling": choice.rule, "links_error": links_error}
        flat = map_over_triangles(self.name, cut, how, result, need, rows, told, doubts, **more)
        return flat if max_area is None else _within(flat, max_area, how)


def _within(flat: FlatMap, max_area: float, how: How) -> FlatMap:
    """Return a map that keeps a bound on areas; refuse another one."""
    areas, logs = area_changes(flat)
    areas, logs = areas[np.isfinite(logs)], logs[np.isfinite(logs)]  # those that have an area on the surface
    reached = float(np.exp2(np.abs(logs).max()))
    flat = replace(flat, metadata={**flat.metadata, "max_area": max_area, "area_change": reached})
    if reached <= max_area:
        return flat
    is_beyond = np.abs(logs) > np.log2(max_area)
    share = float(areas[is_beyond].sum() / areas.sum())
    places = worst_places(flat, 3, beyond=max_area, threads=how.threads, progress=how.progress)
    lengths = [f"{place.cut.length:.0f}" for place in places.places if place.cut is not None]
    cuts = f"cut it where voxflat.worst_places says ({' + '.join(lengths)} mm), " if lengths else ""
    raise AreaBoundError(
        "no map was found in which no triangle changes its area by more than a factor of "
        f"{max_area:g}: the best changes one by {reached:.3g}, and {int(is_beyond.sum())} of {len(logs)} "
        f"({100 * share:.2g} % of the area) by more than {max_area:g}; {cuts}take relax=True or a smaller patch, or "
        "give a larger max_area",
        flat,
        places,
    )


def _solver(part: Manifold, asked: str | None, links_error: float, how: How) -> tuple[str, float, list[str]]:
    """Return what measures the distances that are kept, how far it is off, and what the user should know of it."""
    if asked == "exact":
        return asked, 0.0, []
    solver = "graph" if asked is None else asked
    error = links_error if solver == "graph" else error_of_distances(part, solver, how)
    if not error > MUCH:
        return solver, error, []
    told = f"distances by {_NAMES[solver]} are {100 * error:.1f} % off here, which thin triangles can cause"
    if asked is not None:
        return solver, error, [f"{told}; leave geodesic out, or give 'exact'"]
    solver, error = "marching", error_of_distances(part, "marching", how)
    if error > MUCH:
        solver, error = "exact", 0.0
        log.info("distances are measured exactly, which takes its time")
    return solver, error, [f"{told}; they are measured by {_NAMES[solver]} instead"]


_NAMES = {"graph": "links", "marching": "fast marching", "exact": "exact geodesics"}
