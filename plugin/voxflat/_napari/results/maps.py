"""From flat maps to napari's layers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from voxflat._napari.layers.sampled import Overlay, Shown
from voxflat.atlases.atlas import Atlas
from voxflat.maps.flat_map import FlatMap, load
from voxflat.maps.raster import FlatImage

LayerData: TypeAlias = tuple[Any, dict[str, Any], str]
"""The layer's data, its keywords and its type, as napari takes them."""

HEAT_MEANING = "mean relative error of the geodesic distances from each place, as a fraction (0.1 is 10 %)"
"""What the colours of a heat map mean."""

_HEAT_LIMITS = (0.05, 0.1, 0.2, 0.3, 0.5, 1.0)


@dataclass(frozen=True, eq=False)
class FlatLayers:
    """A flat map or an atlas, and its layers.

    Parameters
    ----------
    flat_map : FlatMap, FlatAtlas or GluedAtlas
        The map, or the atlas.
    layers : list of LayerData
        Images: what the map shows, if anything, and the distortion. Before them, of a mesh, its flat surface with its
        own values, if it has some, and with the distortion, both hidden.
    in_space : list of LayerData
        Of an atlas the surface, coloured by patch.
    """

    flat_map: FlatMap | Atlas
    layers: list[LayerData]
    in_space: list[LayerData] = field(default_factory=list)

    @classmethod
    def of(
        cls,
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
        return cls(flat_map, layers)


def flat_map_reader(path: str | list[str]) -> Callable[[str], list[LayerData]] | None:
    """Offer to read an .npz file, if it is a flat map or an atlas of voxflat.

    Parameters
    ----------
    path : str or list of str
        The file, or files to be stacked, which flat maps are not.

    Returns
    -------
    callable or None
        Takes the path, and returns layers.
    """
    if not isinstance(path, str):
        return None
    try:
        with np.load(path, allow_pickle=False) as file:
            names = set(file.files)
    except (OSError, ValueError):
        return None
    if {"uv", "ids", "metadata"} <= names:
        return lambda path: FlatLayers.of(load(path), Path(path).stem).layers
    if {"uv", "uv_faces", "piece_ids", "text"} <= names:
        from voxflat._napari.results.pages import atlas_reader  # which builds on this module

        return atlas_reader
    return None


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


def shown_image(flat_map: FlatMap | Atlas, shown: Shown, pixel_size: float | None) -> LayerData:
    """Return the layer of what a map or page shows."""
    image = shown.image(flat_map, pixel_size)
    data: NDArray[Any] = image.data
    keywords = {
        "name": f"{shown.name} flattened",
        **shown.display,
        **placement(flat_map, image),
        **description(flat_map, shown.meaning),
    }
    if shown.kind == "labels":
        data = np.nan_to_num(data).astype(np.int64)  # 0 is no label: transparent, as NaN is in an image
    elif image.is_colour:
        keywords["rgb"] = True
    else:
        keywords.setdefault("contrast_limits", _limits(data))
    return data, keywords, shown.kind


def _flat_surface(flat_map: FlatMap, name: str, values: Overlay, meaning: str) -> LayerData:
    """Return the map's triangles in the plane, with values at its points."""
    keywords = {
        "name": name,
        "visible": False,
        "shading": "none",
        "contrast_limits": _limits(values.values),
        **values.display,
        "features": {"vertex": flat_map.ids, "distortion": flat_map.distortion.per_point},
        "units": units(flat_map),
        **description(flat_map, meaning),
    }
    vertices = np.column_stack([-flat_map.uv[:, 1], flat_map.uv[:, 0]])
    return (vertices, flat_map.faces, values.values), keywords, "surface"


def placement(flat_map: FlatMap | Atlas, image: FlatImage) -> dict[str, Any]:
    """Return the keywords for where a flat image lies.

    napari's rows grow downwards and the map's v upwards, so the world's axes are −v and u.
    """
    u, v = image.origin
    scale = (image.pixel_size, image.pixel_size)
    return {"scale": scale, "translate": (-v, u), "units": units(flat_map)}


def units(flat_map: FlatMap | Atlas) -> tuple[str, str] | None:
    """Return the units of the surface's layer: napari cannot show pixels beside millimetres."""
    in_pixels = flat_map.metadata.get("napari", {}).get("unit", "").startswith("pixel")
    return None if in_pixels else ("mm", "mm")


def description(flat_map: FlatMap | Atlas, meaning: str) -> dict[str, Any]:
    """Return the keywords for what a layer is."""
    return {
        "metadata": {
            "voxflat": flat_map,
            "parameters": flat_map.metadata,
            "distortion": (flat_map.distortion if isinstance(flat_map, FlatMap) else flat_map).figures(),
            "colours": meaning,
            "axes": "rows: −v, columns: u, mm",
        }
    }


def _limits(values: NDArray[Any]) -> tuple[float, float]:
    """Return contrast limits that show most values apart; napari's own would be NaN."""
    values = values.astype(np.float64)  # of a mesh they may be bool
    if not np.isfinite(values).any():
        return 0.0, 1.0
    low, high = (float(limit) for limit in np.nanpercentile(values, (1, 99)))
    return (low, high) if low < high else (low - 0.5, low + 0.5)


def _heat_limit(errors: NDArray[np.float64]) -> float:
    """Return a round number that few of the errors exceed, so that maps can be compared by eye."""
    most = np.nanpercentile(errors, 99) if np.isfinite(errors).any() else 1.0
    return next((limit for limit in _HEAT_LIMITS if most <= limit), _HEAT_LIMITS[-1])
