"""From napari's layers to volumes in RAS+ mm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from voxflat._errors import InputError
from voxflat.io import Volume, check_affine

if TYPE_CHECKING:
    from napari.layers import Layer

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
class LayerVolume:
    """Where a layer's voxels are, and where they lie.

    It is made in the GUI's thread, and read in any other: a layer may change or be removed meanwhile.

    Parameters
    ----------
    data : array_like
        numpy, dask, zarr: whatever the layer holds; of a multiscale layer its finest level.
    affine : ndarray, shape (4, 4)
        From voxel indices to RAS+ mm.
    rgb : bool
        Whether the last axis holds colours.
    path : Path or None
        The file that the layer came from.
    origin : dict
        For the map's metadata: the layer's name, the world's axes, the unit of length.
    """

    data: Any = field(repr=False)
    affine: NDArray[np.float64]
    rgb: bool
    path: Path | None
    origin: dict[str, str]

    @classmethod
    def of(cls, layer: Layer, world: str = "RAS") -> LayerVolume:
        """Take an Image or Labels layer.

        Parameters
        ----------
        layer : Layer
            Of three dimensions.
        world : str
            One of `WORLDS`.

        Returns
        -------
        LayerVolume

        Raises
        ------
        InputError
            For a layer of other than three dimensions, or axes that are no lengths.
        """
        if layer.ndim != 3:
            raise InputError(
                f"layer '{layer.name}' has {layer.ndim} dimensions instead of 3"
                + (": split it (Layers > Layer Type > Split Stack) and choose a part" if layer.ndim > 3 else "")
            )
        factors, unit = _millimetres(layer)
        to_mm = np.diag([*factors, 1.0])
        path = getattr(layer.source, "path", None)
        return cls(
            data=finest(layer),
            affine=check_affine(_to_ras(world) @ to_mm @ data_to_world(layer)),
            rgb=getattr(layer, "rgb", False),  # Labels have none
            path=Path(path) if path else None,
            origin={"layer": layer.name, "world_axes": world, "unit": unit},
        )

    def read(self) -> Volume:
        """Fetch the voxels: long for dask and zarr.

        Returns
        -------
        Volume

        Raises
        ------
        InputError
            If the values are no volume.
        """
        data = np.asarray(self.data)
        return Volume(_bytes(data) if self.rgb else data, self.affine, self.path)


def finest(layer: Layer) -> Any:
    """Return a layer's voxels, of a multiscale layer those of its finest level.

    Parameters
    ----------
    layer : Layer
        Image or Labels.

    Returns
    -------
    array_like
        numpy, dask, zarr: whatever the layer holds.
    """
    return layer.data[0] if layer.multiscale else layer.data


def data_to_world(layer: Layer) -> NDArray[np.float64]:
    """Return a layer's affine, its scale, rotation, shear, translation and affine in one.

    Parameters
    ----------
    layer : Layer
        Of three dimensions.

    Returns
    -------
    ndarray, shape (4, 4)
        From voxel indices to the viewer's world, in the layer's units.
    """
    corner = np.asarray(layer.data_to_world((0, 0, 0)), dtype=np.float64)
    affine = np.eye(4)
    affine[:3, 3] = corner
    affine[:3, :3] = np.transpose([layer.data_to_world(step) - corner for step in np.eye(3)])
    return affine


def unit_ratio(units: Sequence[Any], target: Sequence[Any]) -> NDArray[np.float64]:
    """Return the factors from some units to others; as napari does, 1 where they cannot be compared (pixels).

    Parameters
    ----------
    units, target : sequence of pint.Unit
        One an axis.

    Returns
    -------
    ndarray, one an axis
    """
    return np.array(
        [
            float((1 * unit).to(other).magnitude) if unit.is_compatible_with(other) else 1.0
            for unit, other in zip(units, target, strict=True)
        ]
    )


def same_kind_of_unit(a: Layer, b: Layer) -> bool:
    """Whether two layers are both in lengths or both in pixels, so that they lie in one world.

    Parameters
    ----------
    a, b : Layer
        Of three dimensions.

    Returns
    -------
    bool
    """
    return all(x.is_compatible_with(y) for x, y in zip(a.units, b.units, strict=True))


def _millimetres(layer: Layer) -> tuple[NDArray[np.float64], str]:
    """Return the factors from a layer's units to mm, and the units in words."""
    units = layer.units
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


def _bytes(colours: NDArray[Any]) -> NDArray[np.uint8]:
    """Take colours of any type, which napari shows as it does uint8, as uint8."""
    if colours.dtype == np.uint8:
        return colours
    full = 1.0 if colours.dtype.kind == "f" else float(np.iinfo(colours.dtype).max)
    return np.round(np.clip(np.nan_to_num(colours / full), 0, 1) * 255).astype(np.uint8)
