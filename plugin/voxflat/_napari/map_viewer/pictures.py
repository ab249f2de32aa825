"""Pictures of a map: their pixels, the values behind them, and what their colours mean."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from voxflat.maps.raster import FlatImage


@dataclass(frozen=True, eq=False)
class ColourScale:
    """What colours mean.

    Parameters
    ----------
    title : str
        Quantity and unit.
    colours : ndarray of uint8, shape (256, 4)
        From the lowest to the highest value.
    limits : tuple of 2 floats
        These values.
    """

    title: str
    colours: NDArray[np.uint8]
    limits: tuple[float, float]

    def paint(self, data: NDArray[np.floating]) -> NDArray[np.uint8]:
        """Return values as colours.

        `data` (H, W): values, NaN where there is none. Returns: uint8 (H, W, 4).
        """
        low, high = self.limits
        known = np.isfinite(data)
        level = np.clip((np.where(known, data, low) - low) * (255 / ((high - low) or 1.0)), 0, 255)
        pixels = self.colours[np.round(level).astype(np.uint8)]
        pixels[..., 3] *= known
        return pixels


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture of the map.

    Parameters
    ----------
    pixels : ndarray of uint8, shape (H, W, 4)
        Row 0 is at the top.
    origin : tuple of 2 floats
        (u, v) of the centre of pixel (0, 0), mm.
    pixel_size : float
        mm.
    data : ndarray, shape (H, W), or None
        The values.
    scale : ColourScale or None
        What the colours mean, where a bar can tell.
    """

    pixels: NDArray[np.uint8]
    origin: tuple[float, float]
    pixel_size: float
    data: NDArray[np.floating] | None = None
    scale: ColourScale | None = None

    @classmethod
    def of(cls, image: FlatImage, scale: ColourScale) -> Picture:
        """Paint an image of values.

        `image`: the values. `scale`: their colours.
        """
        return cls(scale.paint(image.data), image.origin, image.pixel_size, image.data.astype(np.float32), scale)

    def value(self, u: float, v: float) -> float | None:
        """Return the value at a place, None where there is none.

        `u`, `v`: mm.
        """
        if self.data is None:
            return None
        row = round((self.origin[1] - v) / self.pixel_size)
        column = round((u - self.origin[0]) / self.pixel_size)
        if not (0 <= row < self.data.shape[0] and 0 <= column < self.data.shape[1]):
            return None
        value = float(self.data[row, column])
        return value if np.isfinite(value) else None
