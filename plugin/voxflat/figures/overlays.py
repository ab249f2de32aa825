"""Overlays of figures: limits, thresholds and colour maps that turn values into colours."""

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

_ALIKE = 0.2  # greatest difference between the ends of a cyclic colour map; that of hsv is 0.1


@dataclass(frozen=True, eq=False)
class Overlay:
    """Data drawn over the folds of a figure, with display options.

    `flat_map` and `movie` accept plain data, or an overlay that sets thresholds, colours and labels.

    Parameters
    ----------
    values : path, ndarray, image object or Volume
        The data: any input that `FlatMap.image` accepts. For movies, a series that `FlatMap.images` accepts.
    channel : int or str, optional
        Name or number (from 0) of the map to show, for data with several maps. Not for movies.
    interpolation : str, optional
        Interpolation between voxels, as in `FlatMap.image`.
    threshold : float, or (above, below), optional
        Show data only where their magnitude is greater than this, as in nilearn: 2.3 shows values above 2.3 and below
        -2.3. A pair sets the two thresholds separately, and None disables one of them: ``(2.3, None)`` shows values
        above 2.3, ``(None, -2.3)`` shows values below -2.3, and ``(3, -2)`` shows values above 3 and below -2. If the
        second number is greater than the first, as in ``(1, 3)``, values between the two are shown.
    strength : path, ndarray, image object, Volume or Overlay, optional
        Apply the threshold to this map instead of the data, for example t, R² or coherence. If it has several maps,
        pass ``Overlay(values, channel=2)``. Not for movies.
    period : float, optional
        Period of values that are phases (for example, 360, 2π, or a duration in seconds). Phases are interpolated along
        the shorter arc and shown with a cyclic colour map and a colour wheel. Not for movies.
    zero : {"right", "top"}
        Position of phase 0 on the colour wheel. Phases increase counterclockwise from "right" and clockwise from "top".
    limits : sequence of 2 numbers or percentiles, optional
        The values at the ends of the colour scale: numbers such as ``(0, 5)``, or percentiles of the values on the map
        such as ``("2%", "98%")``. The defaults are the 1st and 99th percentiles. If these have different signs, the
        range is symmetric about 0.
    colour_map : str, optional
        A Matplotlib colour map. The default is "viridis", "RdBu_r" if the limits have different signs, or "hsv" for
        phases.
    label : str, optional
        Label of the colour bar, such as the quantity and its unit. The default is the name of the data.
    time_step : float, optional
        Time between the frames of a series, in seconds, for movies. The default is the time step of the file.

    See Also
    --------
    flat_map : Draw an overlay on a flat map.

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
        """Check the options that do not depend on a map."""
        if self.values is None:
            raise InputError("the overlay has no values. Pass data, or omit the overlay options")
        checked_choice(self.zero, "zero", ("right", "top"))
        if self.strength is not None and self.thresholds == (None, None):
            raise InputError("strength is given without threshold. Pass threshold as well")

    @property
    def thresholds(self) -> tuple[float | None, float | None]:
        """The values above which, and below which, data are shown. None means that the side has no threshold."""
        if self.threshold is None:
            return None, None
        if is_number(self.threshold):
            size = float(self.threshold)
            if not 0 <= size < np.inf:
                raise InputError(f"threshold is {size:g}. Pass a number of at least 0, or a pair (above, below)")
            return size, -size
        pair = self.threshold
        if not isinstance(pair, list | tuple) or len(pair) != 2:
            raise InputError(f"threshold is {shown(pair)}. Pass a number, or a pair (above, below)")
        return optional_number(pair[0], "threshold above"), optional_number(pair[1], "threshold below")

    @classmethod
    def _of(cls, overlay: object, maps: int = 1) -> Overlay:
        """Return the overlay, or the data as an overlay with default options."""
        if maps > 1 and isinstance(overlay, list | tuple) and any(isinstance(layer, Overlay) for layer in overlay):
            raise InputError("got several overlays. Pass one Overlay for both maps: Overlay((left, right), ...)")
        return overlay if isinstance(overlay, Overlay) else cls(overlay)

    @property
    def provenance(self) -> dict[str, object]:
        """The values and options, for records. Long arrays are recorded as their SHA-256 checksum."""
        return {option.name: described(getattr(self, option.name)) for option in fields(self)}


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
    """Return values as RGBA. NaN and values that do not pass the thresholds (tested on `by`) are transparent."""
    _check_name(colour_map, "'viridis' or 'RdBu_r'")
    low, high = limits
    level = np.clip((np.nan_to_num(data) - low) / (high - low), 0, 1)
    pixels: NDArray[np.uint8] = colormaps[colour_map](level, bytes=True)
    is_shown = np.isfinite(data) & passing(data if by is None else by, above, below)
    pixels[..., 3] = np.where(is_shown, round(255 * opacity), 0)
    return pixels


@dataclass(frozen=True)
class OverlayColours:
    """The colours of an overlay's values."""

    colour_map: str | None  # a Matplotlib name; None for labels and for data that are colours
    limits: tuple[float, float]  # values at the ends of the colours
    above: float | None = None  # thresholds, as in `Overlay`
    below: float | None = None
    opacity: float = 1.0
    is_cyclic: bool = False  # for phases, values beyond one end continue at the other
    is_by_strength: bool = False  # the thresholds apply to values other than the overlay's

    @classmethod
    def of(cls, image: FlatImage, strength: FlatImage | None, overlay: Overlay, opacity: float = 1.0) -> OverlayColours:
        """Choose the unspecified options from the values on the map."""
        above, below = overlay.thresholds
        limits, colour_map, period = overlay.limits, overlay.colour_map, overlay.period
        inside = image.data[..., 3] > 0 if image.is_colour else np.isfinite(image.data)
        if not inside.any():
            raise InputError("the overlay has no values on the map. Check that the affine of the overlay is correct")
        is_free = all(value is None for value in (colour_map, limits, above, below))
        if image.is_colour and not is_free:
            raise InputError("the overlay contains colours, not values. Omit threshold, limits and colour_map")
        if image.is_colour or (image.is_labels and is_free and period is None):
            return cls(None, (0.0, 1.0), opacity=opacity)
        values = image.data[inside]
        tested = values if strength is None else strength.data[inside]
        if not passing(tested, above, below).any():
            name, finite = "the overlay" if strength is None else "the strength", tested[np.isfinite(tested)]
            if len(finite) == 0:
                raise InputError(f"{name} has no values on the map. Check that its affine is correct")
            least, most = finite.min(), finite.max()
            log.warning("No value of %s passes the thresholds. The values range from %.4g to %.4g", name, least, most)
        options: dict[str, Any] = {"above": above, "below": below, "opacity": opacity}
        options["is_by_strength"] = strength is not None
        if period is not None:
            if limits is not None:
                raise InputError("limits do not apply to phases: their colours range from 0 to the period. Omit limits")
            return cls(_cyclic(colour_map), (0.0, period), is_cyclic=True, **options)
        low, high = _limits(values, limits)
        chosen = colour_map if colour_map is not None else "RdBu_r" if low < 0 < high else "viridis"
        return cls(chosen, (low, high), **options)

    def paint(self, data: NDArray[Any], by: NDArray[Any] | None = None) -> NDArray[np.uint8]:
        """Return RGBA pixels of values (H, W) or colours; the thresholds apply to `by` if it is given."""
        if self.colour_map is not None:
            values = data % self.limits[1] if self.is_cyclic else data
            thresholds: dict[str, Any] = {"above": self.above, "below": self.below, "by": by}
            return painted(values, self.colour_map, self.limits, **thresholds, opacity=self.opacity)
        pixels = data.copy() if data.ndim == 3 else label_colours(data)
        pixels[..., 3] = np.round(pixels[..., 3] * self.opacity)
        return pixels

    def legend(self, values: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Return the colours of values in a colour bar; values excluded by the thresholds are transparent."""
        return replace(self, above=None, below=None).paint(values) if self.is_by_strength else self.paint(values)


def _check_name(colour_map: object, such_as: str) -> None:
    if not isinstance(colour_map, str) or colour_map not in colormaps:
        raise InputError(f"Matplotlib has no colour map {shown(colour_map)}. Pass a name such as {such_as}")


def _cyclic(colour_map: str | None) -> str:
    """Return a cyclic colour map, or raise an InputError."""
    name = "hsv" if colour_map is None else colour_map
    _check_name(name, "'hsv' or 'twilight'")
    ends = np.array([colormaps[name](end)[:3] for end in (0.0, 1.0)])
    if np.abs(ends[0] - ends[1]).max() > _ALIKE:
        raise InputError(f"the colour map {name!r} is not cyclic. For phases, pass 'hsv', 'hsv_r' or 'twilight'")
    return name


def _limits(values: NDArray[Any], limits: Limits | None) -> tuple[float, float]:
    """Return the values at the ends of the colours."""
    if limits is None:
        low, high = np.percentile(values, WINDOW).tolist()
        if low < 0 < high:
            low, high = -max(-low, high), max(-low, high)
        return (low, high) if low < high else (low - 0.5, low + 0.5)
    if isinstance(limits, str) or np.shape(np.asarray(limits, dtype=object)) != (2,):
        raise InputError(f"limits is {shown(limits)}. Pass two numbers, or percentiles such as ('2%', '98%')")
    low, high = (_limit(values, end) for end in limits)
    if not low < high:
        raise InputError(f"limits is ({low:g}, {high:g}). Pass the lower limit first")
    return low, high


def _limit(values: NDArray[Any], end: float | str) -> float:
    try:
        if isinstance(end, str) and end.strip().endswith("%"):
            return float(np.percentile(values, float(end.strip()[:-1])))
        number = float(end)
    except (TypeError, ValueError):
        number = np.nan
    if not np.isfinite(number):
        raise InputError(f"a limit is {shown(end)}. Pass a number, or a percentile from 0% to 100%")
    return number
