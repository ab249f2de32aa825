"""Sources: the points from which distances are measured, chosen or given."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat.arguments import Progress, checked_text, is_whole
from voxflat.errors import InputError
from voxflat.surfaces.surface import Surface
from voxflat.surfaces.voxel_graph import VoxelGraph

__all__ = ["choose_sources", "source_count"]


def choose_sources(
    part: Surface | VoxelGraph,
    sources: int | ArrayLike | None,
    sampling: str,
    seed: int,
    progress: Progress | None,
    *,
    fewest: int,
    usual: int | None = None,
) -> NDArray[np.uint32]:
    """Return the sources as numbers into a surface's points.

    Parameters
    ----------
    part : Surface or VoxelGraph
        What distances are measured over.
    sources, sampling, seed, progress
        As in `voxflat.flatten`.
    fewest : int
        As few as the caller can use.
    usual : int, optional
        How many where none are given.

    Returns
    -------
    ndarray of uint32, shape (m,)

    Raises
    ------
    InputError
        If they are too few or too many, given twice, or not on the surface.
    """
    count = source_count(part, sources, fewest=fewest, usual=usual)
    checked_text(sampling, "sampling")
    if count is not None:
        return part.core.choose_sources(sampling, count, seed, progress)
    assert sources is not None
    found = part.find(sources, "sources")
    unique, counts = np.unique(found, return_counts=True)
    if (counts > 1).any():
        again = part.ids[unique[counts > 1][0]].tolist()
        raise InputError(f"source {again} is given {counts.max()} times; give each once")
    return found


def source_count(
    part: Surface | VoxelGraph, sources: int | ArrayLike | None, *, fewest: int, usual: int | None = None
) -> int | None:
    """Return how many sources are to be chosen; None if they are given."""
    if sources is None and usual is not None:
        return min(usual, len(part))
    if not is_whole(sources):
        return None
    if sources < fewest:
        raise InputError(f"{sources} sources are too few; give at least {fewest}")
    if sources > len(part):
        raise InputError(
            f"{sources} sources are more than the {len(part)} points of the surface; give at most that many"
        )
    return int(sources)
