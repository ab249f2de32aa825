"""Colours that several figures share: of errors, of areas, of patches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from voxflat.atlases.pieces import FlatPieces
from voxflat.maps.colours import label_colours
from voxflat.maps.flat_map import FlatMap

__all__ = ["AREAS", "AREA_LABEL", "ERRORS", "ERROR_LABEL", "patch_colours", "top", "top_error"]

ERRORS = "inferno"
"""The colour map of distortion, in the plane and in space."""

ERROR_LABEL = "mean relative error of distances (%)"

AREAS = "RdBu_r"
"""The colour map of areas, from shrunk to grown."""

AREA_LABEL = "area, log2(flat / surface)"


def patch_colours(atlas: FlatPieces) -> NDArray[np.uint8]:
    """Return the colour of each triangle's patch, shape (F, 3), as files and textures of a page have it."""
    return label_colours(atlas.patch_ids[:, None] + 1.0)[:, 0, :3]


def top_error(flat_map: FlatMap) -> float:
    """Return the error, in %, at the upper end of the colours."""
    return 100 * float(np.nanpercentile(flat_map.distortion.per_point, 99)) or 1.0


def top(values: NDArray[np.float64]) -> float:
    """Return the 99th percentile of the values that are defined, for the upper end of colours; it is not 0."""
    defined = values[np.isfinite(values)]
    return float(np.percentile(defined, 99)) or 1.0 if len(defined) else 1.0
