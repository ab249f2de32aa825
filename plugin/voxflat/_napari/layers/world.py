"""Determine the position of a layer in the world of the viewer, and convert it to RAS+ positions in mm, µm or nm."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from napari.layers import Layer
from numpy.typing import NDArray

from voxflat.errors import InputError
from voxflat.io.grid import LONG_NAMES, check_affine

WORLDS = {
    "RAS": "RAS: x, y, z (nibabel)",
    "SPL": "SPL: z, y, x of LPS (ITK, SimpleITK)",
    "SAR": "SAR: z, y, x of RAS",
    "LPS": "LPS: x, y, z (DICOM)",
}
"""The possible axes of the world, which a layer does not record: their directions, and the readers that use them."""

ASSUMED_UNIT = "The layer does not have a unit of length; its coordinates are assumed to be in {}."

MADE_FROM = "voxflat_made_from"
"""Key of the metadata of layers that the user rarely flattens, because voxflat made them from another layer."""

WORLD = "voxflat_world_axes"
"""Key of the metadata of volumes that voxflat read or made: their world axes, such as those chosen for their source."""


@dataclass(frozen=True, eq=False)
class LayerPlace:
    """The position of a layer, and the origin metadata."""

    affine: NDArray[np.float64]  # from the layer's data coordinates to RAS+ positions in `unit`
    path: Path | None  # path of the surface file, for a layer of values
    origin: dict[str, str]  # for the metadata of the map: layer, world_axes, unit
    unit: str  # mm, µm or nm

    @classmethod
    def of(cls, layer: Layer, world: str = "RAS", leading: int = 0, unit: str | None = None) -> "LayerPlace":
        """Read the position of a layer; raises InputError unless it has three length axes after the leading axes.

        The default unit is that of `unit_of`.
        """
        if layer.ndim - leading != 3:
            raise InputError(f"Layer '{layer.name}' has {layer.ndim} dimensions instead of 3. Choose a 3D layer")
        units = layer.units[-3:]
        named, factors = ", ".join(dict.fromkeys(map(str, units))), np.ones(3)
        unit = unit or unit_of(layer)
        if named == "pixel":
            named = f"pixel, taken as {unit}"
        elif all(own.is_compatible_with("mm") for own in units):
            factors = unit_ratio(units, [unit] * 3)
        else:
            raise InputError(f"The units of layer '{layer.name}' are {named}. Set them to units of length, such as mm")
        to_unit = np.diag([*factors, 1.0])
        path = layer.metadata.get("surface_file", layer.source.path)  # the former for a layer of values
        affine = check_affine(_to_ras(world) @ to_unit @ data_to_world(layer))
        origin = {"layer": layer.name, "world_axes": world, "unit": named}
        return cls(affine, Path(path) if path else None, origin, unit)


def unit_of(layer: Layer) -> str:
    """Return the unit of the map of a layer: µm or nm if all three space axes have this unit, otherwise mm."""
    named = {str(unit) for unit in layer.units[-3:]}
    return next((unit for unit in ("µm", "nm") if named == {LONG_NAMES[unit]}), "mm")


def data_to_world(layer: Layer) -> NDArray[np.float64]:
    """Return the affine of the last three layer axes from data to world coordinates, in the units of the layer."""
    steps = np.zeros((4, layer.ndim))
    steps[1:, -3:] = np.eye(3)
    corner, *ends = (np.asarray(layer.data_to_world(step), dtype=np.float64)[-3:] for step in steps)
    affine = np.eye(4)
    affine[:3, 3] = corner
    affine[:3, :3] = np.transpose([end - corner for end in ends])
    return affine


def moved(points: NDArray[Any], affine: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.asarray(points, dtype=np.float64) @ affine[:3, :3].T + affine[:3, 3])


def from_ras(points: NDArray[Any], world: str) -> NDArray[np.float64]:
    """Convert points from RAS+ mm to the world of a viewer, in mm along its axes."""
    return moved(points, _to_ras(world).T)  # a permutation of axes, some of them reversed


def to_ras(points: NDArray[Any], world: str) -> NDArray[np.float64]:
    """Convert points from the world of a viewer to RAS+ mm, the inverse of `from_ras`."""
    return moved(points, _to_ras(world))


def unit_ratio(units: Sequence[Any], target: Sequence[Any]) -> NDArray[np.float64]:
    """Return the conversion factors between units, or 1 for units that cannot be compared (pixels), as in napari."""
    pairs = zip(units, target, strict=True)
    return np.array([float((1 * a).to(b).magnitude) if a.is_compatible_with(b) else 1.0 for a, b in pairs])


def in_units_of(layer: Layer, position: Sequence[float], units: Sequence[Any] | None) -> NDArray[np.float64]:
    """Convert the coordinates of a position along the axes of a layer from the viewer's units, if any, to its units."""
    place = np.asarray(position, dtype=np.float64)[-layer.ndim :]
    count = len(place)  # smaller while the layer is being removed
    return place if units is None else place * unit_ratio(tuple(units)[-count:], layer.units[-count:])


def same_kind_of_unit(a: Layer, b: Layer) -> bool:
    """Return whether the units of two layers are all lengths or all pixels, so that their positions are comparable."""
    return all(x.is_compatible_with(y) for x, y in zip(a.units, b.units, strict=True))


def _to_ras(world: str) -> NDArray[np.float64]:
    """Return the matrix to RAS+ from a world whose axes increase towards the directions R/L, A/P and S/I."""
    matrix = np.zeros((4, 4))
    matrix[3, 3] = 1
    for axis, letter in enumerate(world):
        row = "RASLPI".index(letter)
        matrix[row % 3, axis] = 1 if row < 3 else -1
    return matrix
