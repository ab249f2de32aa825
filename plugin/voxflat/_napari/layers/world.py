"""The viewer's world: where a layer lies in it, and where that is in RAS+ mm."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from napari.layers import Layer
from numpy.typing import NDArray

from voxflat.errors import InputError
from voxflat.io.grid import check_affine

WORLDS = {
    "RAS": "RAS: x, y, z (nibabel)",
    "SPL": "SPL: z, y, x of LPS (ITK, SimpleITK)",
    "SAR": "SAR: z, y, x of RAS",
    "LPS": "LPS: x, y, z (DICOM)",
}
"""What the axes of the viewer's world may be: where each one grows to, and how readers of files come to it.

Nothing in a layer says which one it is, and a wrong one shows the map from inside, as its mirror image.
"""


@dataclass(frozen=True, eq=False)
class LayerPlace:
    """Where a layer lies, and where it came from."""

    affine: NDArray[np.float64]  # from the layer's data coordinates to RAS+ mm
    path: Path | None  # of values their surface's
    origin: dict[str, str]  # for the map's metadata: layer, world_axes, unit

    @classmethod
    def of(cls, layer: Layer, world: str = "RAS", leading: int = 0) -> "LayerPlace":
        """Read it off a layer, without its leading axes; raises InputError if others are not three, or no lengths."""
        if layer.ndim - leading != 3:
            raise InputError(f"layer '{layer.name}' has {layer.ndim} dimensions instead of 3")
        factors, unit = _millimetres(layer)
        to_mm = np.diag([*factors, 1.0])
        path = layer.metadata.get("surface_file") or layer.source.path  # of values the former
        return cls(
            affine=check_affine(_to_ras(world) @ to_mm @ data_to_world(layer)),
            path=Path(path) if path else None,
            origin={"layer": layer.name, "world_axes": world, "unit": unit},
        )

    @property
    def is_in_pixels(self) -> bool:
        """Whether its unit is no length, and taken as mm."""
        return self.origin["unit"].startswith("pixel")


def data_to_world(layer: Layer) -> NDArray[np.float64]:
    """Return the affine of a layer's last three axes, from data coordinates to the world, in the layer's units."""
    steps = np.zeros((4, layer.ndim))
    steps[1:, -3:] = np.eye(3)
    corner, *ends = (np.asarray(layer.data_to_world(step), dtype=np.float64)[-3:] for step in steps)
    affine = np.eye(4)
    affine[:3, 3] = corner
    affine[:3, :3] = np.transpose([end - corner for end in ends])
    return affine


def moved(points: NDArray[Any], affine: NDArray[np.float64]) -> NDArray[np.float64]:
    """Carry points (N, 3) over by an affine."""
    moved: NDArray[np.float64] = np.asarray(points, dtype=np.float64) @ affine[:3, :3].T + affine[:3, 3]
    return moved


def from_ras(points: NDArray[Any], world: str) -> NDArray[np.float64]:
    """Carry points from RAS+ mm to a viewer's world, mm along its axes."""
    return moved(points, _to_ras(world).T)  # a permutation of axes, some of them turned


def to_ras(points: NDArray[Any], world: str) -> NDArray[np.float64]:
    """Carry points from a viewer's world to RAS+ mm: `from_ras` the other way."""
    return moved(points, _to_ras(world))


def unit_ratio(units: Sequence[Any], target: Sequence[Any]) -> NDArray[np.float64]:
    """Return the factors from some units to others; as napari does, 1 where they cannot be compared (pixels)."""
    return np.array(
        [
            float((1 * unit).to(other).magnitude) if unit.is_compatible_with(other) else 1.0
            for unit, other in zip(units, target, strict=True)
        ]
    )


def in_units_of(layer: Layer, position: Sequence[float], units: Sequence[Any] | None) -> NDArray[np.float64]:
    """Convert a place in the viewer, its last three numbers, to a layer's units; without units nothing is converted."""
    place = np.asarray(position, dtype=np.float64)[-3:]
    return place if units is None else place * unit_ratio(tuple(units)[-3:], layer.units)


def same_kind_of_unit(a: Layer, b: Layer) -> bool:
    """Whether two layers are both in lengths or both in pixels, so that they lie in one world."""
    return all(x.is_compatible_with(y) for x, y in zip(a.units, b.units, strict=True))


def _millimetres(layer: Layer) -> tuple[NDArray[np.float64], str]:
    """Return the factors from a layer's units to mm, and the units in words."""
    units = layer.units[-3:]
    names = ", ".join(dict.fromkeys(str(unit) for unit in units))
    if all(str(unit) == "pixel" for unit in units):
        return np.ones(3), "pixel, taken as mm"
    if not all(unit.is_compatible_with("mm") for unit in units):
        raise InputError(f"the axes of layer '{layer.name}' are in {names}: set its units to lengths, such as mm")
    return unit_ratio(units, ["mm"] * 3), names


def _to_ras(world: str) -> NDArray[np.float64]:
    """Return the matrix from a world whose axes grow towards some letters of R/L, A/P, S/I to RAS+."""
    matrix = np.zeros((4, 4))
    matrix[3, 3] = 1
    for axis, letter in enumerate(world):
        row = "RASLPI".index(letter)
        matrix[row % 3, axis] = 1 if row < 3 else -1
    return matrix
