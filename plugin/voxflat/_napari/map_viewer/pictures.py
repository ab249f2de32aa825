"""Pictures of a map, consisting of pixels, values and a colour scale."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.maps.raster import FlatImage


@dataclass(frozen=True, eq=False)
class ColourScale:
    """A colour map with a title and limits."""

    title: str
    colours: NDArray[np.uint8]  # (256, 4), from the lower to the upper limit
    limits: tuple[float, float]

    def paint(self, data: NDArray[np.floating]) -> NDArray[np.uint8]:
        """Convert values of shape (H, W) to colours of shape (H, W, 4); NaN is transparent."""
        low, high = self.limits
        is_known = np.isfinite(data)
        level = np.clip((np.where(is_known, data, low) - low) * (255 / ((high - low) or 1.0)), 0, 255)
        pixels = self.colours[np.round(level).astype(np.uint8)]
        pixels[..., 3] *= is_known
        return pixels


@dataclass(frozen=True, eq=False)
class Picture:
    pixels: NDArray[np.uint8]  # (H, W, 4); row 0 is at the top
    origin: tuple[float, float]  # (u, v) of the centre of pixel (0, 0), mm
    pixel_size: float  # mm
    data: NDArray[np.floating] | None = None
    scale: ColourScale | None = None  # None if there is no colour bar

    @classmethod
    def of(cls, image: FlatImage, scale: ColourScale) -> "Picture":
        data: Any = image.data
        return cls(scale.paint(data), image.origin, image.pixel_size, data.astype(np.float32), scale)

    def value(self, u: float, v: float) -> float | None:
        """Return the value at (u, v), in mm, or None if there is no value."""
        if self.data is None:
            return None
        row = round((self.origin[1] - v) / self.pixel_size)
        column = round((u - self.origin[0]) / self.pixel_size)
        if not (0 <= row < self.data.shape[0] and 0 <= column < self.data.shape[1]):
            return None
        value = float(self.data[row, column])
        return value if np.isfinite(value) else None
