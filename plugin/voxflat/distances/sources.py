"""Sources, the points from which distances are measured; they are chosen or given."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat.arguments import Progress, is_whole
from voxflat.errors import InputError
from voxflat.surfaces.manifold import Manifold
from voxflat.surfaces.voxel_graph import VoxelGraph

SAMPLINGS = ("farthest", "curvature", "random")  # ways to choose sources on any surface


@dataclass(frozen=True)
class SourceChoice:
    """Describe how sources will be chosen; their number is known before choosing them requires any memory."""

    part: Manifold | VoxelGraph
    count: int
    given: NDArray[np.uint32] | None  # (count,), row numbers of the surface's points; None if they are to be chosen
    sampling: str
    seed: int
    rule: str  # `sampling`, or "given" if sources were passed

    def made(self, progress: Progress | None) -> NDArray[np.uint32]:
        """Return the sources as row numbers of the surface points, of shape (count,)."""
        if self.given is not None:
            return self.given
        return self.part.core.choose_sources(self.sampling, self.count, self.seed, progress)


def source_choice(
    part: Manifold | VoxelGraph,
    sources: int | ArrayLike,
    sampling: str,
    seed: int,
    *,
    fewest: int,
    at_most_all: bool = False,
) -> SourceChoice:
    """Return how sources will be chosen; more sources than points raise an error unless `at_most_all` is True."""
    if is_whole(sources):
        if sources < fewest:
            raise InputError(f"{sources} sources are too few. Pass at least {fewest}")
        if sources > len(part) and not at_most_all:
            raise InputError(f"{sources} sources exceed the number of points. Pass at most {len(part)}")
        return SourceChoice(part, min(int(sources), len(part)), None, sampling, seed, sampling)
    if sources is None:
        raise InputError("no sources are given. Pass the number of sources, or points of the surface")
    points = part.find(sources, "sources")
    unique, counts = np.unique(points, return_counts=True)
    if (counts > 1).any():
        again = part.ids[unique[counts > 1][0]].tolist()
        raise InputError(f"source {again} is given {counts.max()} times. Pass each source once")
    return SourceChoice(part, len(points), points, sampling, seed, "given")
