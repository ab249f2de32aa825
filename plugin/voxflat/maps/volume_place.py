"""Where volumes lie relative to a map: their affine and unit, and warnings if these do not fit the map."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import log
from voxflat.errors import InputError
from voxflat.io.chunks import is_stack_path
from voxflat.io.grid import Affine, scaled
from voxflat.io.readers import has_place
from voxflat.io.sources import volume_of
from voxflat.io.volumes import Volume
from voxflat.maps.depth import Depths
from voxflat.maps.surface_points import SurfacePoints


def placed(surface: SurfacePoints, volume: object) -> Volume:
    """Return a volume with its affine or, if it has none, with the affine of the flattened volume."""
    image, unit = volume_of(volume), surface.origin.unit
    if not image.is_placed:
        return replace(image, affine=own_affine(surface, image.data.shape), unit=unit, is_placed=True)
    return image if unit == "unknown" else image.in_unit(unit)


def in_map_unit(surface: SurfacePoints, affine: Affine, unit: str) -> Affine:
    """Return an affine in the unit of the map, if that is known."""
    return affine if surface.origin.unit == "unknown" else scaled(affine, unit, surface.origin.unit)


def own_affine(surface: SurfacePoints, shape: tuple[int, ...]) -> Affine:
    """Return the affine of the flattened volume for a volume of the same shape."""
    if not surface.origin.is_voxels:
        problem = "the volume does not define the size and position of its voxels, nor does the map of a mesh"
        raise InputError(f"{problem}. Pass a volume with an affine, or values at its vertices")
    if shape[:3] != surface.volume_shape:
        raise InputError(
            f"the volume has shape {shape} and no affine, but the {surface.called} has shape {surface.volume_shape}. "
            "Pass a volume of that shape, or one with an affine"
        )
    return surface.affine


def warn_of_position(surface: SurfacePoints, affine: Affine, path: Path | None) -> None:
    """Warn if a volume's file does not define its position, unless it has the affine of the flattened volume."""
    is_same = surface.origin.is_voxels and np.array_equal(affine, surface.affine)
    if path is not None and not is_same and not has_place(path):
        log.warning(
            "%s does not define its position (no sform, qform or goodRASFlag), so its centre is taken as the "
            "origin. Copy the header of an image with the same grid into this file",
            path.name,
        )


def warn_of_space(surface: SurfacePoints) -> None:
    """Warn if the space of the surface is not certain."""
    if warning := surface.origin.space.warning:
        log.warning(
            "the volume may be sampled at the wrong positions: %s. Use a surface file that defines its space (for "
            "example, a FreeSurfer lh.white with its footer), or the output of mris_convert --to-scanner (version "
            "7.4 or later)",
            warning,
        )


def check_overlap(surface: SurfacePoints, volume: Volume, depths: Depths, title: str) -> None:
    """Raise an error if the map lies outside a volume or within one voxel, mostly because their units differ."""
    inverse = np.linalg.inv(volume.affine)
    surfaces = [surface.points, surface.white_points, surface.pial_points]
    points = surface.origin.space.to_scanner(np.concatenate([side for side in surfaces if side is not None]))
    index = points @ inverse[:3, :3].T + inverse[:3, 3]
    low, high = index.min(axis=0), index.max(axis=0)
    beyond = 0.5 + (max(map(abs, depths.values)) / volume.spacing if depths.layering is None else 0)
    if (high < -beyond).any() or (low > np.array(volume.data.shape[:3]) - 1 + beyond).any():
        fault = "does not overlap the map, so the image would be empty"
    elif (high - low).max() < 1:
        fault = "has voxels that are larger than the map"
    else:
        warn_of_extent(surface, volume)
        return
    counts = _along_axes(volume.data.shape, volume.affine)
    shape = _along_axes(surface.volume_shape, surface.affine) if surface.origin.is_voxels else counts
    if shape != counts and sorted(shape) == sorted(counts):
        fault += ". It has {} x {} x {} voxels along x, y and z, but the flattened volume has {} x {} x {}"
        raise InputError(f"{title} {fault.format(*counts, *shape)}. Save it with the axes of the flattened volume")
    unit = "an unknown unit" if surface.origin.unit == "unknown" else surface.origin.unit
    raise InputError(f"{title} {fault}. Compare their positions and units; the map is in {unit}")


def warn_of_extent(surface: SurfacePoints, volume: Volume) -> None:
    """Warn if a stack differs in extent from the flattened volume, and neither has a position."""
    if not (surface.origin.is_voxels and volume.path is not None and is_stack_path(volume.path)):
        return
    grids = [(volume.affine, volume.data.shape[:3]), (surface.affine, surface.volume_shape)]
    if any(np.count_nonzero(affine - np.diag(affine.diagonal())) for affine, _ in grids):
        return
    spacings = np.array([affine.diagonal()[:3] for affine, _ in grids])
    extents = spacings * [shape for _, shape in grids]
    if (np.abs(extents[0] - extents[1]) > spacings.max(axis=0) * (1 + 1e-6)).any():
        unit = "" if surface.origin.unit == "unknown" else f" {surface.origin.unit}"
        sizes = [" x ".join(f"{length:.6g}" for length in extent) + unit for extent in extents]
        log.warning(
            "%s measures %s along x, y and z, but the flattened volume %s. Neither defines its position, so both "
            "are assumed to start at the same corner. If they do not, crop, pad or resample the stack to the grid "
            "of the flattened volume",
            volume.path.name,
            *sizes,
        )


def _along_axes(shape: Sequence[int], affine: NDArray[np.float64]) -> list[int]:
    """Return the numbers of voxels along the axes that are closest to x, y and z."""
    return [shape[axis] for axis in np.abs(affine[:3, :3]).argmax(axis=1)]
