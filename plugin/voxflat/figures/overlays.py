"""How an overlay's values become colours over the folds: limits, thresholds, colour maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, TypeAlias

import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray

from voxflat.arguments import checked_choice, is_number, log, optional_number, shown
from voxflat.errors import InputError
from voxflat.io.provenance import described
from voxflat.maps.colours import WINDOW, label_colours, passing
from voxflat.maps.raster import FlatImage

Limits: TypeAlias = Sequence[float | str]


@dataclass(frozen=True, eq=False)
class Overlay:
    """Data over the folds of a figure, and how they are shown.

    Parameters
    ----------
    values : path, ndarray, image object or Volume
        The data: everything that `FlatMap.image` takes; of movies a series, as `FlatMap.images` takes it.
    channel : int or str, optional
        Which map of the data, where there are several: its name, or its number from 0. Not for movies.
    interpolation : str, optional
        Between voxels, as in `FlatMap.image`.
    threshold : float, or (above, below), optional
        Show data only where their magnitude is greater than this, as nilearn does: 2.3 shows values above 2.3 and below
        -2.3. A pair names each side, None for neither: ``(2.3, None)`` shows values above 2.3, ``(None, -2.3)`` those
        below -2.3, ``(3, -2)`` both, and ``(1, 3)``, whose second number is greater, those between.
    strength : path, ndarray, image object, Volume or Overlay, optional
        Apply the threshold to this map instead of the data, for example t, R² or coherence.
        ``Overlay(values, channel=2)`` where it has several maps. Not for movies.
    period : float, optional
        The values are phases with this period (360, 2π, seconds): sampled the short way round, in a cyclic colour map,
        whose wheel takes the place of the colour bar. Not for movies.
    zero : {"right", "top"}
        Where the wheel has phase 0: at the right, counterclockwise as angles are drawn, or at the top, clockwise.
    limits : sequence of 2 numbers or percentiles, optional
        The ends of the colours: ``(0, 5)``, or ``("2%", "98%")`` of the values on the map. By default the 1st and 99th
        percentile, and if these have different signs the larger of both either way.
    colour_map : str, optional
        A colour map of matplotlib. By default "viridis", "RdBu_r" where the limits have different signs, or of phases
        "hsv".
    label : str, optional
        The text at the colour bar: quantity and unit. By default the name of the data.
    time_step : float, optional
        From each frame of a series to the next, s, for movies. By default the file says it.

    Examples
    --------
    >>> from voxflat.figures import Overlay
    >>> Overlay("zstat.nii.gz", threshold=2.3, limits=(-6, 6)).label is None
    True
    """

    values: object
    channel: int | str | None = None
    interpolation: str | None = None
    threshold: float | Sequence[float | None] | None = None
    strength: object | None = None
    period: float | None = None
    zero: str = "right"
    limits: Limits | None = None
    colour_map: str | None = None
    label: str | None = None
    time_step: float | None = None

    def __post_init__(self) -> None:
        """Check what does not depend on a map."""
        if self.values is None:
            raise InputError("an overlay shows values, and none are given; give data, or leave its options out")
        checked_choice(self.zero, "zero", ("right", "top"))
        if self.strength is not None and self.thresholds == (None, None):
            raise InputError("strength is compared with the threshold, and none is given: give threshold")

    @property
    def thresholds(self) -> tuple[float | None, float | None]:
        """Above which value data are shown, and below which."""
        if self.threshold is None:
            return None, None
        if is_number(self.threshold):
            size = float(self.threshold)
            if not 0 <= size < np.inf:
                raise InputError(f"the threshold is {size:g}: give 0 or more, or a pair (above, below)")
            return size, -size
        pair = self.threshold
        if not isinstance(pair, list | tuple) or len(pair) != 2:
            raise InputError(f"the threshold is {shown(pair)}; give a number, or a pair (above, below)")
        return optional_number(pair[0], "threshold above"), optional_number(pair[1], "threshold below")

    @classmethod
    def _of(cls, overlay: object, maps: int = 1) -> Overlay:
        """Return an overlay, of data alone with defaults; of two maps each may have an `Overlay` of its values."""
        if maps > 1 and isinstance(overlay, list | tuple) and any(isinstance(one, Overlay) for one in overlay):
            raise InputError("give one Overlay of both maps: Overlay((left, right), ...)")
        return overlay if isinstance(overlay, Overlay) else cls(overlay)

    @property
    def provenance(self) -> dict[str, Any]:
        """What is shown and how, for records."""
        return {one.name: described(getattr(self, one.name)) for one in fields(self)}


_ALIKE = 0.2  # of a colour's range: hsv ends 0.1 before its beginning


def painted(
    data: NDArray[Any],
    colour_map: str,
    limits: tuple[float, float],
    *,
    above: float | None = None,
    below: float | None = None,
    by: NDArray[Any] | None = None,
    opacity: float = 1.0,
) -> NDArray[np.uint8]:
    """Return values as RGBA, transparent where they are NaN, or they, or `by` instead, do not pass the thresholds."""
    if not isinstance(colour_map, str) or colour_map not in colormaps:
        raise InputError(f"matplotlib has no colour map {shown(colour_map)}")
    low, high = limits
    level = np.clip((np.nan_to_num(data) - low) / (high - low), 0, 1)
    pixels: NDArray[np.uint8] = colormaps[colour_map](level, bytes=True)
    is_shown = np.isfinite(data) & passing(data if by is None else by, above, below)
    pixels[..., 3] = np.where(is_shown, round(255 * opacity), 0)
    return pixels


@dataclass(frozen=True)
class OverlayColours:
    """How an overlay's values become colours."""

    colour_map: str | None  # of matplotlib; None for labels and for what has colours already
    limits: tuple[float, float]  # the ends of the colours
    above: float | None = None  # thresholds, as in `Overlay`
    below: float | None = None
    opacity: float = 1.0
    is_cyclic: bool = False  # of phases: what is beyond an end comes in again at the other
    is_by_strength: bool = False  # other values than the overlay's have to pass the thresholds

    @classmethod
    def of(cls, image: FlatImage, strength: FlatImage | None, overlay: Overlay, opacity: float = 1.0) -> OverlayColours:
        """Choose what is not given, by what an image, and its strength, show on the map."""
        above, below = overlay.thresholds
        limits, colour_map, period = overlay.limits, overlay.colour_map, overlay.period
        inside = image.data[..., 3] > 0 if image.is_colour else np.isfinite(image.data)
        if not inside.any():
            raise InputError("the overlay has no value anywhere on the map; do their affines agree?")
        is_free = all(value is None for value in (colour_map, limits, above, below))
        if image.is_colour and not is_free:
            raise InputError("thresholds, limits and a colour map are for values, not for colours; leave them out")
        if image.is_colour or (image.is_labels and is_free and period is None):
            return cls(None, (0.0, 1.0), opacity=opacity)
        values = image.data[inside]
        judged = values if strength is None else strength.data[inside]
        if not passing(judged, above, below).any():
            what, known = "the overlay" if strength is None else "its strength", judged[np.isfinite(judged)]
            if len(known) == 0:
                raise InputError(f"{what} has no value anywhere on the map; do their affines agree?")
            least, most = known.min(), known.max()
            log.warning("no value of %s passes the thresholds: they are from %.4g to %.4g", what, least, most)
        told: dict[str, Any] = {"above": above, "below": below, "opacity": opacity}
        told["is_by_strength"] = strength is not None
        if period is not None:
            if limits is not None:
                raise InputError("limits are for values; phases have all colours from 0 to the period: leave them out")
            return cls(_cyclic(colour_map), (0.0, period), is_cyclic=True, **told)
        low, high = _limits(values, limits)
        chosen = colour_map if colour_map is not None else "RdBu_r" if low < 0 < high else "viridis"
        return cls(chosen, (low, high), **told)

    def paint(self, data: NDArray[Any], by: NDArray[Any] | None = None) -> NDArray[np.uint8]:
        """Return pixels, RGBA, of values (H, W) or colours; their strength (`by`) has to pass the thresholds."""
        if self.colour_map is not None:
            shown = data % self.limits[1] if self.is_cyclic else data
            thresholds: dict[str, Any] = {"above": self.above, "below": self.below, "by": by}
            return painted(shown, self.colour_map, self.limits, **thresholds, opacity=self.opacity)
        pixels = data.copy() if data.ndim == 3 else label_colours(data)
        pixels[..., 3] = np.round(pixels[..., 3] * self.opacity)
        return pixels

    def legend(self, values: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Return the colours of values in a colour bar, transparent where the overlay is for their sake."""
        return replace(self, above=None, below=None).paint(values) if self.is_by_strength else self.paint(values)


def _cyclic(colour_map: str | None) -> str:
    """Return a colour map whose ends are alike."""
    name = "hsv" if colour_map is None else colour_map
    if not isinstance(name, str) or name not in colormaps:
        raise InputError(f"matplotlib has no colour map {shown(name)}")
    ends = np.array([colormaps[name](end)[:3] for end in (0.0, 1.0)])
    if np.abs(ends[0] - ends[1]).max() > _ALIKE:
        raise InputError(
            f"the colour map {name!r} has different ends, and phases none: give 'hsv', 'twilight' or 'hsv_r'"
        )
    return name


def _limits(values: NDArray[Any], limits: Limits | None) -> tuple[float, float]:
    """Return the ends of the colours."""
    if limits is None:
        low, high = np.percentile(values, WINDOW).tolist()
        if low < 0 < high:
            low, high = -max(-low, high), max(-low, high)
        return (low, high) if low < high else (low - 0.5, low + 0.5)
    if isinstance(limits, str) or np.shape(np.asarray(limits, dtype=object)) != (2,):
        raise InputError(f"limits are {shown(limits)}; give two numbers, or percentiles such as ('2%', '98%')")
    low, high = (_limit(values, end) for end in limits)
    if not low < high:
        raise InputError(f"limits are {low:g} and {high:g}; give the lower one first, and another one")
    return low, high


def _limit(values: NDArray[Any], end: float | str) -> float:
    try:
        if isinstance(end, str) and end.strip().endswith("%"):
            return float(np.percentile(values, float(end.strip()[:-1])))
        number = float(end)
    except (TypeError, ValueError):
        number = np.nan
    if not np.isfinite(number):
        raise InputError(f"a limit is {shown(end)}; give a number, or a percentile from 0% to 100%")
    return number
