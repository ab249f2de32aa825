"""From flat maps to napari's layers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from voxflat._napari.layers.sampled import Overlay, Shown
from voxflat._napari.results.flat_layers import (
    FlatLayers,
    LayerData,
    description,
    limits,
    placement,
    shown_image,
    units,
)
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
    """Draw a flat map.

    Parameters
    ----------
    flat_map : FlatMap
        The map.
    name : str
        Name of what was flattened.
    shown : Sampled or Overlay, optional
        What the map is to show.
    values : Overlay, optional
        A mesh's own values.
    pixel_size : float, optional
        Side of a pixel, mm.

    Returns
    -------
    FlatLayers

    Raises
    ------
    InputError
        If the pixel size or what is to be shown does not fit.
    """
    heat = _heat(flat_map)
    layers = [_distortion_image(flat_map, name, heat, pixel_size)]
    if shown is not None:
        layers.insert(0, shown_image(flat_map, shown, pixel_size))
    if not flat_map.is_voxels:
        layers.insert(0, _flat_surface(flat_map, f"{name} flat distortion", heat, HEAT_MEANING))
        if values is not None:
            carried = replace(values, values=values.values[flat_map.ids])
            layers.insert(0, _flat_surface(flat_map, f"{name} flat", carried, values.meaning))
    return FlatLayers(flat_map, layers)


def _heat(flat_map: FlatMap) -> Overlay:
    """Return the distortion of the map's points, and how it looks."""
    errors = flat_map.distortion.per_point
    return Overlay("distortion", errors, {"colormap": "inferno", "contrast_limits": (0.0, _heat_limit(errors))})


def _distortion_image(flat_map: FlatMap, name: str, heat: Overlay, pixel_size: float | None) -> LayerData:
    image = flat_map.heat_map(pixel_size)
    keywords = {
        "name": f"{name} distortion",
        **heat.display,
        **placement(flat_map, image),
        **description(flat_map, HEAT_MEANING),
    }
    return image.data, keywords, "image"


def _flat_surface(flat_map: FlatMap, name: str, values: Overlay, meaning: str) -> LayerData:
    """Return the map's triangles in the plane, with values at its points."""
    keywords = {
        "name": name,
        "visible": False,
        "shading": "none",
        "contrast_limits": limits(values.values),
        **values.display,
        "features": {"vertex": flat_map.ids, "distortion": flat_map.distortion.per_point},
        "units": units(flat_map),
        **description(flat_map, meaning),
    }
    vertices = np.column_stack([-flat_map.uv[:, 1], flat_map.uv[:, 0]])
    return (vertices, flat_map.faces, values.values), keywords, "surface"


def _heat_limit(errors: NDArray[np.float64]) -> float:
    """Return a round number that few of the errors exceed, so that maps can be compared by eye."""
    most = np.nanpercentile(errors, 99) if np.isfinite(errors).any() else 1.0
    return next((limit for limit in _HEAT_LIMITS if most <= limit), _HEAT_LIMITS[-1])
