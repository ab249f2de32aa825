"""From flat maps to napari's layers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from voxflat._flatimage import FlatImage
from voxflat._napari.volumes import LayerVolume
from voxflat.flatmap import FlatMap, load

LayerData: TypeAlias = tuple[Any, dict[str, Any], str]
"""The layer's data, its keywords and its type, as napari takes them."""

HEAT_MEANING = "mean relative error of the geodesic distances from each place, as a fraction (0.1 is 10 %)"
"""What the colours of a heat map mean."""

_HEAT_LIMITS = (0.05, 0.1, 0.2, 0.3, 0.5, 1.0)


@dataclass(frozen=True, eq=False)
class Sampled:
    """A layer whose values the map is to show.

    Parameters
    ----------
    volume : LayerVolume
        The values, and where they lie.
    depth : float
        How far outside the surface to sample, mm.
    kind : {"image", "labels"}
        The layer's type.
    display : mapping
        Keywords that make the map look as the layer does: colormap, contrast limits, gamma.
    """

    volume: LayerVolume
    depth: float = 0.0
    kind: str = "image"
    display: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class FlatLayers:
    """A flat map and its layers.

    Parameters
    ----------
    flat_map : FlatMap
        The map.
    layers : list of LayerData
        The sampled layer, if there is one, and the distortion.
    """

    flat_map: FlatMap
    layers: list[LayerData]

    @classmethod
    def of(
        cls, flat_map: FlatMap, name: str, sampled: Sampled | None = None, pixel_size: float | None = None
    ) -> FlatLayers:
        """Draw a flat map.

        Parameters
        ----------
        flat_map : FlatMap
            The map.
        name : str
            Name of what was flattened.
        sampled : Sampled, optional
            What the map is to show.
        pixel_size : float, optional
            Side of a pixel, mm.

        Returns
        -------
        FlatLayers

        Raises
        ------
        InputError
            If the pixel size or the sampled volume does not fit.
        """
        shown = [] if sampled is None else [_sampled_layer(flat_map, sampled, pixel_size)]
        return cls(flat_map, [*shown, _distortion_layer(flat_map, name, pixel_size)])


def flat_map_reader(path: str | list[str]) -> Callable[[str], list[LayerData]] | None:
    """Offer to read an .npz file, if it is a flat map of voxflat.

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
            ours = {"uv", "ids", "metadata"} <= set(file.files)
    except (OSError, ValueError):
        return None
    return (lambda path: FlatLayers.of(load(path), Path(path).stem).layers) if ours else None


def figures(flat_map: FlatMap) -> list[tuple[str, str]]:
    """Return what tells how good a flat map is, as names and values.

    Parameters
    ----------
    flat_map : FlatMap
        The map.

    Returns
    -------
    list of tuple of 2 str
    """
    raw = flat_map.distortion.raw
    width, height = np.ptp(flat_map.uv, axis=0)
    euler = flat_map.metadata["topology"]["euler_characteristic"]
    return [
        ("relative error", f"{100 * raw.relative_error:.1f} %"),
        ("   pairs up to 10 mm", f"{100 * raw.relative_error_10mm:.1f} %"),
        ("   pairs up to 30 mm", f"{100 * raw.relative_error_30mm:.1f} %"),
        ("absolute error", f"{raw.absolute_error:.2f} mm"),
        ("stress-1", f"{raw.stress_1:.4f}"),
        ("correlation", f"{flat_map.distortion.pearson_r:.4f}"),
        ("map", f"{width:.0f} × {height:.0f} mm"),
        ("torn faces", f"{100 * flat_map.metadata['torn_faces']:.1f} %"),
        ("Euler characteristic (disk: 1)", f"{euler}"),
    ]


def remarks(flat_map: FlatMap) -> str:
    """Return what the colours mean, and what may be wrong with a flat map.

    Parameters
    ----------
    flat_map : FlatMap
        The map.

    Returns
    -------
    str
    """
    return ". ".join([f"Colours of the distortion: {HEAT_MEANING}", *flat_map.metadata["warnings"]]) + "."


def _distortion_layer(flat_map: FlatMap, name: str, pixel_size: float | None) -> LayerData:
    heat = flat_map.heat_map(pixel_size)
    keywords = {
        "name": f"{name} distortion",
        "colormap": "inferno",
        "contrast_limits": (0.0, _heat_limit(flat_map.distortion.per_point)),
        **_placement(flat_map, heat, HEAT_MEANING),
    }
    return heat.data, keywords, "image"


def _sampled_layer(flat_map: FlatMap, sampled: Sampled, pixel_size: float | None) -> LayerData:
    name = sampled.volume.origin["layer"]
    interpolation = "nearest" if sampled.kind == "labels" else "linear"
    volume = sampled.volume.read()
    image = flat_map.image(volume, pixel_size, depth=sampled.depth, interpolation=interpolation)
    place = f"{sampled.depth:g} mm outside the surface" if sampled.depth else "at the surface"
    data: NDArray[Any] = image.data
    keywords = {
        "name": f"{name} flattened",
        **sampled.display,
        **_placement(flat_map, image, f"'{name}', as sampled {place}"),
    }
    if sampled.kind == "labels":
        data = np.nan_to_num(data).astype(np.int64)  # 0 is no label: transparent, as NaN is in an image
    elif image.is_colour:
        keywords["rgb"] = True
    else:
        keywords.setdefault("contrast_limits", _limits(data))
    return data, keywords, sampled.kind


def _placement(flat_map: FlatMap, image: FlatImage, meaning: str) -> dict[str, Any]:
    """Return the keywords for where a flat image lies, and what it is.

    napari's rows grow downwards and the map's v upwards, so the world's axes are −v and u.
    """
    u, v = image.origin
    in_pixels = flat_map.metadata.get("napari", {}).get("unit", "").startswith("pixel")
    return {
        "scale": (image.pixel_size, image.pixel_size),
        "translate": (-v, u),
        # as the surface: napari cannot show pixels beside millimetres
        "units": None if in_pixels else ("mm", "mm"),
        "metadata": {
            "voxflat": flat_map,
            "parameters": flat_map.metadata,
            "distortion": flat_map.distortion.figures(),
            "colours": meaning,
            "axes": "rows: −v, columns: u, mm",
        },
    }


def _limits(values: NDArray[np.float64]) -> tuple[float, float]:
    """Return contrast limits that show most values apart; napari's own would be NaN."""
    if not np.isfinite(values).any():
        return 0.0, 1.0
    low, high = (float(limit) for limit in np.nanpercentile(values, (1, 99)))
    return (low, high) if low < high else (low - 0.5, low + 0.5)


def _heat_limit(errors: NDArray[np.float64]) -> float:
    """Return a round number that few of the errors exceed, so that maps can be compared by eye."""
    most = np.nanpercentile(errors, 99) if np.isfinite(errors).any() else 1.0
    return next((limit for limit in _HEAT_LIMITS if most <= limit), _HEAT_LIMITS[-1])
