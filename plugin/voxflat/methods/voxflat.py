"""The method "voxflat": the map of least stress whose triangles keep their shape, from coarse to fine."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from voxflat.arguments import checked_choice, is_number, log, shown
from voxflat.distances.geodesic import SOLVERS
from voxflat.distances.rows import open_rows
from voxflat.distances.sources import source_choice
from voxflat.distances.store import prepare_store
from voxflat.errors import AreaBoundError, InputError
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.matching import Matched
from voxflat.maps.worst_places import area_changes, worst_places
from voxflat.methods.common import MUCH, How, error_of_distances, map_over_triangles
from voxflat.methods.options import default
from voxflat.methods.start import places_of
from voxflat.surfaces.region import Cutout
from voxflat.surfaces.surface import Surface

__all__ = ["SCALES", "checked", "flatten"]

SCALES = ("distances", "areas")
"""What a map's mm may be right for."""

_WITHIN = 0.99
"""The power of a bound on areas that descent aims at: holes that were closed belong to what it counts as the whole."""


def checked(geodesic: str | None, weighting: float, scale: str, max_area: float | None) -> dict[str, Any]:
    """Return what measures distances, None for what is usual, weighting, scale and bound, if they can be used."""
    if geodesic is not None:
        checked_choice(geodesic, "geodesic", SOLVERS)
    if not (is_number(weighting) and 0 <= weighting <= 1):
        raise InputError(f"weighting is {shown(weighting)}; give a number from 0, local, to 1, global")
    checked_choice(scale, "scale", SCALES)
    if max_area is not None:
        if not (is_number(max_area) and 1 < max_area < np.inf):
            raise InputError(f"max_area is {shown(max_area)}; give a factor greater than 1, such as 2")
        max_area = float(max_area)
    return {"geodesic": geodesic, "weighting": float(weighting), "scale": scale, "max_area": max_area}


def flatten(
    cut: Cutout,
    how: How,
    *,
    geodesic: str | None,
    weighting: float,
    scale: str,
    max_area: float | None,
    start: Matched | None = None,
) -> FlatMap:
    """Flatten a disk of triangles, from nothing or from a map."""
    part = cut.part
    places = None if start is None else places_of(cut, start)
    choice = source_choice(part, how.sources, how.sampling, how.seed, fewest=3, usual=default("sources", "voxflat"))
    kept = "stored" if how.store is not None else "kept" if how.keep_rows else "dropped"
    need = how.check_memory(part.core.memory_need(choice.count, how.workers, kept))
    chosen = choice.made(how.progress)
    links_error = error_of_distances(part, "graph", how)
    solver, error, doubts = _solver(part, geodesic, links_error, how)
    store = None
    if how.store is not None:
        store = prepare_store(how.store, part.core, part.ids, chosen, geodesic=solver, progress=how.progress)
    key = None if store is None else store.key
    result = part.core.voxflat(
        chosen,
        how.seed,
        solver,
        weighting,
        scale,
        how.keep_rows,
        how.threads,
        how.progress,
        key,
        places,
        max_area=None if max_area is None else max_area**_WITHIN,
    )
    if store is not None:
        store.tell(result["found"])
    told: dict[str, Any] = {"geodesic": solver, "distance_error": error, "weighting": weighting, "scale": scale}
    if start is not None:
        told["start"] = True
    rows = result["rows"]
    if store is not None:
        told["store"], rows = str(store.path), open_rows(store.path).rows
    energies, converged = result["convergence"]
    told["descent"] = {"converged": converged, "energies": energies}
    flat = map_over_triangles("voxflat", cut, how, result, need, rows, told, doubts, links_error)
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


def _solver(part: Surface, asked: str | None, links_error: float, how: How) -> tuple[str, float, list[str]]:
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
