"""The pixels of a range image, of which its surface was made."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from voxflat.errors import InputError
from voxflat.surfaces.manifold import Manifold


def pixels_of(part: Manifold) -> tuple[NDArray[np.uint32], list[float]]:
    """Find the pixels, row and column, that the vertices of a range image are, and the distances of these, mm."""
    grid = part.metadata.get("range_image")
    if grid is None:
        raise InputError(
            "sampling is 'grid', but the surface is no range image; make one by voxflat.range_image, or give "
            "sampling='decimation'"
        )
    ids = part.ids
    unique, counts = np.unique(ids, return_counts=True)
    if len(unique) < len(ids):
        row, column = (int(i) for i in np.unravel_index(unique[counts > 1][0], grid["shape"]))
        raise InputError(
            f"sampling is 'grid', but the surface is cut: pixel ({row}, {column}) lies on both sides, and a grid knows "
            "one; give sampling='decimation'"
        )
    return np.stack(np.unravel_index(ids, grid["shape"]), axis=1).astype(np.uint32), list(grid["spacing"])
