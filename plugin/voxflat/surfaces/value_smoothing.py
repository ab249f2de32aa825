"""Smooth values along a surface with a Gaussian kernel of a given width."""

import math
import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import Progress, array_of, checked_threads, is_number, shown
from voxflat.errors import InputError
from voxflat.io.objects import values_of_object
from voxflat.io.overlays import read_channels
from voxflat.surfaces.manifold import Manifold
from voxflat.unique_rows import distinct

_WIDTH = 2 * math.sqrt(2 * math.log(2))  # the full width at half maximum of a Gaussian in standard deviations


def smooth_values(
    surface: Manifold, values: object, fwhm: float, threads: int | None = None, progress: Progress | None = None
) -> NDArray[np.float64]:
    """Smooth values at the vertices of the complete surface; see `voxflat.Surface.smooth_values`."""
    if not (is_number(fwhm) and 0 < fwhm < np.inf):
        raise InputError(f"fwhm is {shown(fwhm)}. Pass the full width at half maximum of the kernel, in mm")
    given = _values(surface, values)
    threads, columns = checked_threads(threads), given.reshape(len(given), -1)[surface.vertices]
    smooth = np.full((surface.count, columns.shape[1]), np.nan)
    core = surface.core.with_ids(np.arange(len(surface), dtype=np.uint32))
    known = distinct(np.isfinite(columns).T.astype(np.int64))  # columns without values at the same vertices go together
    for pattern, mask in enumerate(known.rows.astype(bool)):
        which = np.flatnonzero(known.which == pattern)
        result = np.where(mask[:, None], columns[:, which], np.nan)
        if (part := core if mask.all() else core.part(mask)) is not None and len(part):
            result[part.ids] = part.smooth_values(
                np.ascontiguousarray(result[part.ids]), fwhm / _WIDTH, threads, progress
            )
        smooth[np.ix_(surface.vertices, which)] = result
    smooth[surface.merged[:, 0]] = smooth[surface.merged[:, 1]]
    return smooth.reshape(given.shape)


def _values(surface: Manifold, values: object) -> NDArray[np.float64]:
    """Return values in a file, an object or an array, of shape (V,) or (V, K)."""
    count, structure = surface.count, None if surface.is_voxels else surface.origin.structure
    if isinstance(values, str | os.PathLike):
        channels: Any = read_channels(values, count, structure=structure)
    else:
        channels = values_of_object(values, count, structure)
    if channels is not None:
        read = [channels.read(n) for n in range(len(channels))]
        return np.asarray(read[0] if len(read) == 1 else np.stack(read, axis=1), dtype=np.float64)
    array = array_of(values, "values", as_nan=True)
    if array.dtype.kind not in "biuf" or array.ndim not in (1, 2) or len(array) != count:
        problem = f"values have shape {array.shape} and data type {array.dtype}, but the mesh has {count} vertices"
        raise InputError(f"{problem}. Pass one number, or one row of numbers, for each")
    return array.astype(np.float64)
