"""Define the colours that several figures share, for errors, areas, other measures, and patches."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from voxflat.atlases.pieces import FlatPieces
from voxflat.maps.colours import label_colours
from voxflat.maps.flat_map import FlatMap

ERRORS = "inferno"  # the colour map of distortion, in the plane and in space

ERROR_LABEL = "mean relative error of distances (%)"

AREAS = "RdBu_r"  # the colour map of area changes, from shrunk to grown

AREA_LABEL = "area, log2(flat / surface)"


def patch_colours(atlas: FlatPieces) -> NDArray[np.uint8]:
    """Return the colour of each triangle's patch, shape (F, 3); image files and page textures use the same colours."""
    return label_colours(atlas.patch_ids[:, None] + 1.0)[:, 0, :3]


def top_error(flat_map: FlatMap) -> float:
    """Return the error at the upper end of the colour scale, in %."""
    return 100 * float(np.nanpercentile(flat_map.distortion.per_point, 99)) or 1.0


def top(values: NDArray[np.float64]) -> float:
    """Return the 99th percentile of the defined values, as the upper end of a colour scale; it is never 0."""
    defined = values[np.isfinite(values)]
    return float(np.percentile(defined, 99)) or 1.0 if len(defined) else 1.0


@dataclass(frozen=True)
class Look:
    """The appearance of values."""

    label: str  # label of the colour bar, with the unit
    cmap: str  # the colour map's name
    factor: float = 1.0  # multiplies the values before they are shown: 100 for %
    least: float | None = 0.0  # lower end of the colour scale; None for a scale that is symmetric about 0

    def limits(self, values: NDArray[np.float64]) -> tuple[float, float]:
        """Return the values at both ends of the colour scale; the upper end is the 99th percentile, ignoring NaN."""
        if self.least is None:
            most = top(np.abs(values))
            return -most, most
        return self.least, max(top(values), self.least + 1e-4)


LOOKS = {
    "distance_error": Look(ERROR_LABEL, ERRORS, factor=100.0),
    "areal": Look(AREA_LABEL, AREAS, least=None),
    "angle": Look("mean change of angles (°)", "viridis"),
    "isometric": Look("C, greatest factor by which lengths change", ERRORS, least=1.0),
    "quasi_conformal": Look("K, ratio of the principal stretches", "viridis", least=1.0),
}
"""The appearance of each measure, keyed by its name in `voxflat.distortion.triangles`."""

HEATS = {"distances": LOOKS["distance_error"], "spread": Look("spread between people, log2(area)", "viridis")}
"""The appearance of the values of `FlatMap.heat_map`."""
