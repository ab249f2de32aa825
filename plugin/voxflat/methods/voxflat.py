"""The method "voxflat": the map of least stress whose triangles keep their shape, from coarse to fine."""

from __future__ import annotations

from typing import Any

from voxflat.arguments import is_number
from voxflat.distances.geodesic import SOLVERS
from voxflat.distances.rows import open_rows
from voxflat.distances.sources import choose_sources
from voxflat.distances.store import prepare_store
from voxflat.errors import InputError
from voxflat.maps.flat_map import FlatMap
from voxflat.methods.common import How, map_over_triangles
from voxflat.methods.options import default
from voxflat.surfaces.region import Cutout

__all__ = ["checked", "flatten"]

_SPOTS = 2  # sources from which distances along links are compared with exact ones
_MUCH_TOO_LONG = 0.01  # 0.1 % is usual


def checked(geodesic: str, weighting: float) -> dict[str, Any]:
    """Return what measures distances, and the weighting, if they can be used."""
    if geodesic not in SOLVERS:
        raise InputError(f"geodesic is {geodesic!r}; give 'graph', 'marching' or 'exact'")
    if not (is_number(weighting) and 0 <= weighting <= 1):
        raise InputError(f"weighting is {weighting!r}; give a number from 0, local, to 1, global")
    return {"geodesic": geodesic, "weighting": float(weighting)}


def flatten(cut: Cutout, how: How, *, geodesic: str, weighting: float) -> FlatMap:
    """Flatten a disk of triangles."""
    part = cut.part
    chosen = choose_sources(
        part, how.sources, how.sampling, how.seed, how.progress, fewest=3, usual=default("sources", "voxflat")
    )
    kept = "stored" if how.store is not None else "kept" if how.keep_rows else "dropped"
    need = how.check_memory(part.core.memory_need(len(chosen), how.workers, kept))
    store = None
    if how.store is not None:
        store = prepare_store(how.store, part.core, part.ids, chosen, geodesic=geodesic, progress=how.progress)
    key = None if store is None else store.key
    result = part.core.voxflat(chosen, how.seed, geodesic, weighting, how.keep_rows, how.threads, how.progress, key)
    if store is not None:
        store.tell(result["found"])
    told: dict[str, Any] = {"geodesic": geodesic, "weighting": weighting}
    rows = result["rows"]
    if store is not None:
        told["store"], rows = str(store.path), open_rows(store.path).rows
    energies, converged = result["convergence"]
    told["descent"] = {"converged": converged, "energies": energies}
    doubts = []
    if geodesic == "graph":
        told["distance_error"] = error = part.core.error_of_links(chosen[:_SPOTS], how.threads, how.progress)
        if error > _MUCH_TOO_LONG:
            doubts = [
                f"distances along links are {100 * error:.1f} % too long here, which thin triangles can cause; "
                "geodesic='exact' measures them exactly"
            ]
    return map_over_triangles("voxflat", cut, how, result, need, rows, told, doubts)
