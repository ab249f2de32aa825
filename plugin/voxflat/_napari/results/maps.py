"""From flat maps to napari's layers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from voxflat._napari.layers.sampled import Overlay, Shown
from voxflat._napari.results.flat_layers import FlatLayers, LayerData, description, placement, shown_image
from voxflat.maps.flat_map import FlatMap

HEAT_MEANING = "mean relative error of the geodesic distances from each place, as a fraction (0.1 is 10 %)"
"""What the colours of a heat map mean."""

_HEAT_LIMITS = (0.05, 0.1, 0.2, 0.3, 0.5, 1.0)


def map_layers(
    flat_map: FlatMap,
    name: str,
    shown: Shown | None = None,
    values: Overlay | None = None,
    pixel_size: float | None = None,
) -> FlatLayers:
    """Draw a flat map with what it is to show, else the mesh's own values; raises InputError if one does not fit."""
    image = flat_map.heat_map(pixel_size)
    heat = {
        "name": f"{name} distortion",
        "colormap": "inferno",
        "contrast_limits": (0.0, _heat_limit(flat_map.distortion.per_point)),
        **placement(flat_map, image),
        **description(flat_map, HEAT_MEANING),
    }
    layers: list[LayerData] = [(image.data, heat, "image")]
    shown = values if shown is None else shown
    if shown is not None:
        layers.insert(0, shown_image(flat_map, shown, pixel_size))
    return FlatLayers(flat_map, layers, shown=shown)


def _heat_limit(errors: NDArray[np.float64]) -> float:
    """Return a round number that few of the errors exceed, so that maps can be compared by eye."""
    most = np.nanpercentile(errors, 99) if np.isfinite(errors).any() else 1.0
    return next((limit for limit in _HEAT_LIMITS if most <= limit), _HEAT_LIMITS[-1])
