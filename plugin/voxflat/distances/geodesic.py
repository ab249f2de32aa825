"""Measure distances from many sources, in memory or in a store."""

import os
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat import _core
from voxflat.arguments import (
    Progress,
    amount,
    check_memory,
    checked_choice,
    checked_seed,
    checked_threads,
    is_whole,
    log,
    refuse,
    workers,
)
from voxflat.distances.parts import rows_by_workers
from voxflat.distances.rows import DistanceRows, open_rows
from voxflat.distances.sources import SAMPLINGS, source_choice
from voxflat.distances.store import Store, prepare_store
from voxflat.errors import InputError
from voxflat.surfaces.manifold import Manifold
from voxflat.surfaces.parts import largest_piece, piece_of
from voxflat.surfaces.voxel_graph import VoxelGraph, voxel_graph

SOLVERS = ("graph", "marching", "exact")


def geodesic(
    surface: Manifold,
    sources: int | ArrayLike,
    *,
    geodesic: str,
    sampling: str,
    link_lengths: str | None,
    seed: int,
    store: str | os.PathLike[str] | None,
    dask: str | None,
    threads: int | None,
    memory_limit: int | None,
    progress: Progress | None,
) -> DistanceRows:
    """Measure distances over a surface; see `voxflat.Surface.geodesic`."""
    if dask is not None and store is None:
        raise InputError("dask requires a store to which the workers can write. Also pass store")
    seed, threads = checked_seed(seed), checked_threads(threads)
    checked_choice(geodesic, "geodesic", (*SOLVERS, "chain"))
    checked_choice(sampling, "sampling", SAMPLINGS)
    part: Manifold | VoxelGraph
    settings = {"geodesic": geodesic}
    if geodesic == "chain":
        refuse(geodesic, dask=dask)
        part = voxel_graph(surface, link_lengths, progress)
        settings["link_lengths"] = part.link_lengths
    else:
        refuse(geodesic, link_lengths=link_lengths)
        of_all = sources is None or is_whole(sources)
        part = largest_piece(surface) if of_all else piece_of(surface, surface.find(sources, "sources"))
    common: dict[str, Any] = {"threads": threads, "memory_limit": memory_limit, "progress": progress}
    choice = source_choice(part, sources, sampling, seed, fewest=1)
    if dask is not None and store is not None and isinstance(part, Manifold):
        return rows_by_workers(part, choice, store, dask, geodesic=geodesic, **common)
    core, few = part.core, "use fewer sources or a smaller patch"
    if store is None:
        check_memory(4 * choice.count * len(core), memory_limit, few + ", or pass store")
        chosen = choice.made(progress)
        named = {} if isinstance(core, _core.VoxelSurface) else {"geodesic": settings["geodesic"]}
        rows = core.rows(chosen, **named, threads=threads, progress=progress)
        return DistanceRows(rows, part.ids, part.points, chosen.astype(np.int64))
    need = _core.store_memory_need(len(core), choice.count, workers(threads))
    check_memory(need, memory_limit, "use fewer threads")
    log.info("up to %s of memory will be used for the rows being computed", amount(need))
    chosen = choice.made(progress)
    prepared = prepare_store(store, core, part.ids, chosen, **settings, progress=progress)
    return stored_rows(prepared, core, chosen, threads, progress)


def stored_rows(
    store: Store,
    core: _core.Surface | _core.VoxelSurface,
    chosen: NDArray[np.uint32],
    threads: int | None,
    progress: Progress | None,
) -> DistanceRows:
    """Compute the missing rows of a store, and open the store."""
    named = {} if isinstance(core, _core.VoxelSurface) else {"geodesic": store.geodesic}
    store.tell(core.store_rows(*store.key, chosen, **named, threads=threads, progress=progress))
    return open_rows(store.path)
