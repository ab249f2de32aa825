"""Link the surface voxels of a volume into a graph of 26-neighbours, for `grossmann2002` and chain codes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat import _core
from voxflat.arguments import Progress, array_of, checked_choice, voxel_indices
from voxflat.errors import InputError
from voxflat.io.grid import in_unit, rounded, voxel_size
from voxflat.io.origin import VoxelOrigin
from voxflat.surfaces.manifold import Manifold

LINK_LENGTHS = ("chain-code", "euclidean")  # measures of links; the first is the paper's unbiased estimator

_FAR = 2.0  # most voxels between a seed point and the surface without a warning


@dataclass(frozen=True, eq=False)
class VoxelGraph:
    """Surface voxels, linked to those of their 26 neighbours that are surface voxels."""

    core: _core.VoxelSurface  # part in use
    whole: _core.VoxelSurface  # complete surface
    origin: VoxelOrigin
    link_lengths: str
    is_chosen: bool  # whether the user chose the part
    details: dict[str, Any]
    warnings: tuple[str, ...]

    def __len__(self) -> int:
        """Return the number of voxels of the part."""
        return len(self.core)

    @cached_property
    def ids(self) -> NDArray[np.int64]:
        """Voxel indices, shape (N, 3)."""
        return self.core.voxels.astype(np.int64)

    @property
    def points(self) -> NDArray[np.float64]:
        """Centres of the voxels, in RAS+ mm, shape (N, 3)."""
        return self.core.points

    @property
    def voxel_size(self) -> float:
        """Geometric mean of the three voxel spacings, in mm."""
        return voxel_size(self.origin.affine)

    def find(self, ids: ArrayLike, name: str = "the ids") -> NDArray[np.uint32]:
        """Return the numbers of the given voxels in the part."""
        voxels = voxel_indices(ids, name)
        on_surface = self.whole.find(voxels)  # reports voxels that are not on the surface at all
        try:
            return self.core.find(voxels)
        except InputError:
            inside = {tuple(voxel) for voxel in self.core.voxels.tolist()}
            outside = next(v for v in self.whole.voxels[on_surface].tolist() if tuple(v) not in inside)
            raise InputError(
                f"source {outside} is on the surface, but outside the patch or component in use ({len(self)} of "
                f"{len(self.whole)} surface voxels). Choose sources inside it"
            ) from None


def voxel_graph(surface: Manifold, link_lengths: str | None = None, progress: Progress | None = None) -> VoxelGraph:
    """Link the surface voxels of a volume, which is repaired only on request, and select the part of the surface."""
    links = LINK_LENGTHS[0] if link_lengths is None else checked_choice(link_lengths, "link_lengths", LINK_LENGTHS)
    if surface.foreground is None:
        raise InputError("chain codes require surface voxels, but this surface has none. Pass a surface from a volume")
    affine = surface.foreground.origin.affine
    size = float(np.linalg.norm(affine[:3, :3], axis=0).max())
    whole = _core.VoxelSurface.from_mask(surface.foreground.mask(), affine.tolist(), links, progress)
    part, mask, warnings = whole, None, []
    seed, nearest, radius = None, None, None
    for step in surface.steps:
        if step.verb == "disk":
            seed, radius = seed_voxel(step.seed_point, surface.origin.voxels.shape), step.radius
            vertex, distance = whole.nearest(seed)
            nearest = [int(index) for index in whole.voxels[vertex]]
            warnings += [in_unit(text, surface.origin.named_unit) for text in found_seed(seed, nearest, distance, size)]
            part, mask = part.cut_out(mask, seed, radius, progress), None
        elif step.mask is not None:
            mask = step.mask if mask is None else mask & step.mask
        else:
            raise InputError(f"chain codes do not support a part selected by {step.verb}. Use keep, drop or disk")
    if mask is not None or seed is None:
        part = part.cut_out(mask, None, None, progress)
    components = whole.component_sizes()
    origin = replace(surface.foreground.origin, unit=surface.origin.unit)
    is_masked = any(step.mask is not None for step in surface.steps)
    details = {
        "seed_point": seed,
        "seed_found": nearest,
        "radius": radius,
        "keep": is_masked,
        "link_lengths": links,
        "surface_points": len(whole),
        "components": len(components),
        "largest_components": components[:10],
        "points": len(part),
    }
    return VoxelGraph(part, whole, origin, links, is_masked or seed is not None, details, tuple(warnings))


def seed_voxel(seed_point: object, shape: Sequence[int], name: str = "seed point") -> list[int]:
    """Return a seed point as voxel indices of a volume."""
    place = array_of(seed_point, f"indices of the {name}")
    if place.shape != (3,) or place.dtype.kind not in "ui":
        raise InputError(
            f"the {name} must be three voxel indices (whole numbers), but has data type {place.dtype} and shape "
            f"{place.shape}"
        )
    indices = [int(index) for index in place]
    if any(not 0 <= index < length for index, length in zip(indices, shape, strict=True)):
        problem = f"the {name} {indices} is outside the volume of {' x '.join(map(str, shape))} voxels"
        raise InputError(f"{problem}. Choose the {name} on the surface, with indices in the order x, y, z")
    return indices


def found_seed(
    seed_point: list[int], voxel: Any, distance: float, voxel_size: float, name: str = "seed point"
) -> list[str]:
    """Return a warning if the surface voxel nearest to a seed point is more than two voxels away."""
    if distance <= _FAR * voxel_size:
        return []
    problem = f"the {name} {seed_point} is {rounded(distance, 1)} mm away from the surface"
    return [f"{problem}; the nearest surface voxel {voxel} is used instead"]
