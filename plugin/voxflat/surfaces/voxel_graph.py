"""The surface voxels of a volume with their 26-neighbour graph: what `grossmann2002` and chain codes work on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat import _core
from voxflat.arguments import Progress, voxel_indices
from voxflat.errors import InputError
from voxflat.io.grid import voxel_size
from voxflat.surfaces.foreground import foreground_of, keep_mask
from voxflat.surfaces.seed import check_disk, found_seed, seed_voxel

__all__ = ["LINK_LENGTHS", "VoxelGraph", "voxel_graph"]

LINK_LENGTHS = "chain-code"
"""How links are measured where nothing else is asked for: the paper's unbiased estimator."""


@dataclass(frozen=True, eq=False)
class VoxelGraph:
    """Surface voxels linked to those of their 26 neighbours that are surface voxels, too.

    Parameters
    ----------
    core : _core.VoxelSurface
        The part that is worked on.
    whole : _core.VoxelSurface
        What it was cut out of.
    metadata : dict
        Where it came from and how it was made.
    remarks : tuple of str
        What the user should know of it.
    """

    core: _core.VoxelSurface
    whole: _core.VoxelSurface
    metadata: dict[str, Any]
    remarks: tuple[str, ...]

    def __len__(self) -> int:
        """Return the number of voxels of the part."""
        return len(self.core)

    @cached_property
    def ids(self) -> NDArray[np.int64]:
        """Their voxel indices, shape (N, 3)."""
        return self.core.voxels.astype(np.int64)

    @property
    def points(self) -> NDArray[np.float64]:
        """Their centres, RAS+ mm, shape (N, 3)."""
        return self.core.points

    @property
    def voxel_size(self) -> float:
        """Geometric mean of the voxels' three spacings, mm."""
        return voxel_size(self.metadata["affine"])

    def find(self, ids: ArrayLike, name: str = "the ids") -> NDArray[np.uint32]:
        """Find voxels of the part.

        Parameters
        ----------
        ids : array_like of int, shape (m, 3)
            Voxel indices.
        name : str
            What they are, for messages.

        Returns
        -------
        ndarray of uint32, shape (m,)
            Their numbers.

        Raises
        ------
        InputError
            If one of them is not on the surface, or not in the part.
        """
        voxels = voxel_indices(ids, name)
        on_surface = self.whole.find(voxels)  # names a voxel that is not on the surface at all
        try:
            return self.core.find(voxels)
        except InputError:
            inside = {tuple(voxel) for voxel in self.core.voxels.tolist()}
            outside = next(v for v in self.whole.voxels[on_surface].tolist() if tuple(v) not in inside)
            raise InputError(
                f"source {outside} is on the surface, but outside the patch or component that is used "
                f"({len(self)} of {len(self.whole)} surface voxels); choose sources inside it"
            ) from None


def voxel_graph(
    source: object,
    *,
    label: int | None = None,
    threshold: float | None = None,
    spacing: Sequence[float] | None = None,
    affine: ArrayLike | None = None,
    keep: object | None = None,
    seed_point: Sequence[int] | int | None = None,
    radius: float | None = None,
    link_lengths: str | None = None,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> VoxelGraph:
    """Find the surface voxels of a volume, link them, and cut out what is worked on.

    Parameters
    ----------
    source, label, threshold, spacing, affine, keep, seed_point, radius, link_lengths, memory_limit, progress
        As in `voxflat.flatten`.

    Returns
    -------
    VoxelGraph

    Raises
    ------
    InputError
        If the input is no volume, or the part is empty.
    """
    radius = check_disk(seed_point, radius)
    given = foreground_of(
        source, label=label, threshold=threshold, spacing=spacing, affine=affine, memory_limit=memory_limit
    )
    kept = None if keep is None else keep_mask(keep, given.volume)
    seed = None if seed_point is None else seed_voxel(seed_point)
    lengths = LINK_LENGTHS if link_lengths is None else link_lengths
    whole = _core.VoxelSurface.from_mask(given.mask, given.volume.affine.tolist(), lengths, progress)
    part = whole.cut_out(kept, seed, radius, progress)
    found, remarks = None, []
    if seed is not None:
        vertex, distance = whole.nearest(seed)
        found = [int(index) for index in whole.voxels[vertex]]
        remarks = found_seed(seed, found, distance, float(given.volume.spacing.max()))
    components = whole.component_sizes()
    metadata = {
        **given.metadata,
        "seed_point": seed,
        "seed_found": found,
        "radius": radius,
        "keep": kept is not None,
        "link_lengths": lengths,
        "surface_points": len(whole),
        "components": len(components),
        "largest_components": components[:10],
        "points": len(part),
    }
    return VoxelGraph(part, whole, metadata, tuple(remarks))
