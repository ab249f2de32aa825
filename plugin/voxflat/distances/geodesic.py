"""Distances from many sources, in memory or in a store."""

from __future__ import annotations

import os
from collections.abc import Sequence
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
    log,
    refuse,
    workers,
)
from voxflat.distances.parts import rows_by_workers
from voxflat.distances.rows import DistanceRows, open_rows
from voxflat.distances.sources import SourceChoice, source_choice
from voxflat.distances.store import Store, prepare_store
from voxflat.errors import InputError
from voxflat.io.provenance import telling
from voxflat.surfaces.making import surface as _surface
from voxflat.surfaces.region import cut_out
from voxflat.surfaces.surface import Surface
from voxflat.surfaces.voxel_graph import VoxelGraph, voxel_graph

SOLVERS = ("graph", "marching", "exact")

__all__ = ["geodesic"]


@telling
def geodesic(
    surface: object,
    sources: int | ArrayLike,
    *,
    geodesic: str = "graph",
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
    sampling: str = "farthest",
    link_lengths: str | None = None,
    seed: int = 0,
    store: str | os.PathLike[str] | None = None,
    dask: str | None = None,
    threads: int | None = None,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> DistanceRows:
    """Measure geodesic distances from sources to all points of a surface.

    Parameters
    ----------
    surface, label, threshold, spacing, affine, keep, drop, seed_point, radius, polygon, cuts, sampling, link_lengths, \
seed, threads, memory_limit, progress
        As in `flatten`. Without a patch the surface is the largest component; it may be closed.
    sources : int or array_like
        How many sources to choose, or which: voxel indices (m, 3), or vertex numbers (m,).
    geodesic : {"graph", "marching", "exact", "chain"}
        "graph": paths of straight links over the triangles of the surface, a fraction of a per cent too long, and by
        far the fastest for many sources. "marching": fast marching (Kimmel, Sethian 1998), with fronts taken for
        circles. "exact": the exact distances on the triangles (Mitchell, Mount, Papadimitriou 1987), slow. "chain":
        chain-code lengths over the 26-neighbour graph of a volume's surface voxels.
    store : path, optional
        A directory to keep the rows in, on disk instead of in memory. If the work is interrupted, by whatever, the same
        call goes on where it was.
    dask : str, optional
        Let the workers of a Dask cluster compute a store's rows, the same bits: the scheduler's address, its file, or
        "local" for workers on this machine. They must see the store's directory. Threads are those of each worker.

    Returns
    -------
    DistanceRows
        Of a store as `voxflat.open_rows` opens it.

    Raises
    ------
    InputError, Cancelled
        As in `flatten`.
    """
    if dask is not None and store is None:
        raise InputError("dask is given, but no store for workers to write into; give a store")
    seed, threads = checked_seed(seed), checked_threads(threads)
    place: dict[str, Any] = {"label": label, "threshold": threshold, "spacing": spacing, "affine": affine}
    patch: dict[str, Any] = {"keep": keep, "seed_point": seed_point, "radius": radius}
    over_triangles: dict[str, Any] = {"drop": drop, "polygon": polygon, "cuts": cuts}
    part: Surface | VoxelGraph
    checked_choice(geodesic, "geodesic", (*SOLVERS, "chain"))
    if geodesic == "chain":
        refuse(geodesic, **over_triangles, dask=dask)
        part = voxel_graph(
            surface, **place, **patch, link_lengths=link_lengths, memory_limit=memory_limit, progress=progress
        )
        what = {"geodesic": geodesic, "link_lengths": part.metadata["link_lengths"]}
    else:
        refuse(geodesic, link_lengths=link_lengths)
        whole = _surface(surface, **place, memory_limit=memory_limit, threads=threads, progress=progress)
        how: dict[str, Any] = {"threads": threads, "progress": progress, "to_disk": False, "with_usual_cuts": False}
        part = cut_out(whole, **patch, **over_triangles, **how).part
        what = {"geodesic": geodesic}
    common: dict[str, Any] = {"threads": threads, "memory_limit": memory_limit, "progress": progress}
    choice = source_choice(part, sources, sampling, seed, fewest=1)
    if dask is not None and store is not None and isinstance(part, Surface):
        return rows_by_workers(part, choice, store, dask, geodesic=geodesic, **common)
    return _rows(choice, what, store, **common)


def _rows(
    choice: SourceChoice,
    what: dict[str, Any],
    store: str | os.PathLike[str] | None,
    threads: int | None,
    memory_limit: int | None,
    progress: Progress | None,
) -> DistanceRows:
    """Compute rows in memory, or in a store."""
    part, core, few = choice.part, choice.part.core, "take fewer sources or a smaller patch"
    if store is None:
        check_memory(4 * choice.count * len(core), memory_limit, few + ", or give a store")
        chosen = choice.made(progress)
        named = {} if isinstance(core, _core.VoxelSurface) else {"geodesic": what["geodesic"]}
        rows = core.rows(chosen, **named, threads=threads, progress=progress)
        return DistanceRows(rows, part.ids, part.points, chosen.astype(np.int64))
    need = _core.store_memory_need(len(core), choice.count, workers(threads))
    check_memory(need, memory_limit, "take fewer threads")
    log.info("up to %s of memory are needed for rows in the making", amount(need))
    chosen = choice.made(progress)
    prepared = prepare_store(store, core, part.ids, chosen, **what, progress=progress)
    return stored_rows(prepared, core, chosen, threads, progress)


def stored_rows(
    store: Store,
    core: _core.Surface | _core.VoxelSurface,
    chosen: NDArray[np.uint32],
    threads: int | None,
    progress: Progress | None,
) -> DistanceRows:
    """Compute what a store lacks, and open it."""
    named = {} if isinstance(core, _core.VoxelSurface) else {"geodesic": store.geodesic}
    store.tell(core.store_rows(*store.key, chosen, **named, threads=threads, progress=progress))
    return open_rows(store.path)
