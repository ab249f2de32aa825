"""Find out whether the foreground of a volume may be two objects that touch."""

import numpy as np
import scipy

from voxflat.surfaces.foreground import PackedMask

_FINEST = 96  # voxels along the longest side of the grid on which depths are measured
_NARROW = 0.6  # a neck is narrower than this share of the widest place
_LEAST, _BOTH = 0.2, 0.9  # least share of the smaller part, and of both parts together


def parts_at_a_neck(foreground: PackedMask) -> tuple[float, float] | None:
    """Return the shares of the two parts of the largest component on both sides of a neck, or None if there is none.

    The parts are the cores that remain where the depth below the surface is large, with the voxels closest to each.
    """
    spacing = np.linalg.norm(foreground.origin.affine[:3, :3], axis=0)
    components, _ = scipy.ndimage.label(foreground.mask())
    largest = int(np.bincount(components.ravel())[1:].argmax()) + 1
    component = np.pad(components[scipy.ndimage.find_objects(components, largest)[largest - 1]] == largest, 1)
    step = -(-max(component.shape) // _FINEST)
    coarse = component[::step, ::step, ::step]
    if not coarse.any():
        return None
    depth = scipy.ndimage.distance_transform_edt(coarse, sampling=spacing)
    cores, count = scipy.ndimage.label(depth > _NARROW * depth.max())
    if count < 2:
        return None
    nearest = scipy.ndimage.distance_transform_edt(cores == 0, spacing, return_distances=False, return_indices=True)
    shares = np.sort(np.bincount(cores[tuple(nearest)][coarse])[1:] / coarse.sum())
    second, first = float(shares[-2]), float(shares[-1])
    return (first, second) if second >= _LEAST and first + second >= _BOTH else None
