"""The figure of a flat map that one reads: folds, data over them, parcels, names and marks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from matplotlib import colormaps
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from voxflat.arguments import checked_number, log
from voxflat.errors import InputError
from voxflat.figures.layers import MAP
from voxflat.figures.marks import cut_names, directions, round_length, side
from voxflat.figures.names import place_names, text_size
from voxflat.maps.colours import WINDOW, label_colours, passing
from voxflat.maps.depth import ON_SURFACE, Depths
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.lines import outline
from voxflat.maps.parcels import Parcels, parcels_of
from voxflat.maps.raster import FlatImage, Raster
from voxflat.maps.sampler import Sampler

__all__ = ["UNDERLAYS", "flat_map", "folds", "painted"]

UNDERLAYS = ("curvature", "sulcal depth", "none")
"""What the folds may be shown by."""

Limits: TypeAlias = Sequence[float | str]

_INCH = 25.4  # mm
_MOST_PIXELS, _LEAST_DPI = 1700, 300
_EDGE, _STRIP, _TITLE = 1.5, 9.0, 5.0  # mm of paper: around everything, of the marks, of the title
_TALLEST = 1.4  # of the width
_LINE, _THIN = 0.5, 0.35  # points
_FONT, _LETTER = 6.5, 7.5  # points
_DARK, _LIGHT, _NO_FOLDS = 0.47, 0.75, 0.66  # greys of sulci, gyri, and where nothing is known
_EDGES = {"curvature": 0.02, "sulcal depth": 0.8}  # from where on it is all gyrus or sulcus, 1/mm, mm
_PARCELS_OPACITY = 0.75
_NAMES_PIXEL = 0.2  # mm of paper
_POINT = _INCH / 72
_MARKS = 30.0  # mm, that directions, side and scale bar take
_BEHIND = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.8, "gid": "marks"}  # a name over data


def flat_map(
    flat_map: FlatMap,
    overlay: object | None = None,
    *,
    channel: int | str | None = None,
    depth: float | Sequence[float] = 0.0,
    fraction: float | Sequence[float] | None = None,
    layering: str = "equivolume",
    interpolation: str | None = None,
    above: float | None = None,
    below: float | None = None,
    limits: Limits | None = None,
    colour_map: str | None = None,
    opacity: float | None = None,
    label: str | None = None,
    parcels: object | None = None,
    table: object | None = None,
    underlay: str = "curvature",
    title: str | None = None,
    width: float = 85.0,
) -> Figure:
    """Show a flat map: its folds in two greys, over them data and parcels, and marks to find one's way.

    Parameters
    ----------
    flat_map : FlatMap
        A flat map.
    overlay : path, ndarray, image object or Volume, optional
        Data over the folds: all that `FlatMap.image` takes.
    channel, interpolation
        As in `FlatMap.image`, of the overlay.
    depth, fraction, layering
        As in `FlatMap.image`, of overlay and parcels, as far as they are volumes.
    above, below : float, optional
        Data are shown only where they are greater than `above`, or less than `below`; with both where they are beyond
        either (``above=2.3, below=-2.3``), or between them (``above=1, below=3``).
    limits : sequence of 2 numbers or percentiles, optional
        The ends of the colours: ``(0, 5)``, or ``("2%", "98%")`` of the values on the map. By default the 1st and 99th
        percentile, and if these have different signs the larger of both either way.
    colour_map : str, optional
        Of matplotlib. By default "viridis", or "RdBu_r" where the limits have different signs.
    opacity : float, optional
        Of the overlay, from 0 to 1; by default 1. Without an overlay that of the parcels, by default 0.75.
    label : str, optional
        What the colour bar says: quantity and unit. By default the name of the overlay.
    parcels : path, ndarray, image object, Volume or Parcels, optional
        Labels, as in `parcels_of`: their borders and names, and without an overlay their colours, as the file has them.
    table : path, optional
        Names and colours of the parcels where their file has none.
    underlay : {"curvature", "sulcal depth", "none"}
        What the folds are shown by: gyri are light, sulci dark.
    title : str, optional
        Above the map.
    width : float
        Of the figure on paper, mm: 85 for one column, 170 for two. Fonts have 6 points or more at this size.

    Returns
    -------
    matplotlib.figure.Figure
        1,700 pixels wide or more in PNG. The directions of the body are those at the middle of the map, of a surface
        whose space is known. Names that have no room in their parcel are left out, and it is said how many.

    Raises
    ------
    InputError
        As in `FlatMap.image`; if a value is none of those above, or the overlay lies elsewhere than the map.
    """
    if underlay not in UNDERLAYS:
        raise InputError(f"underlay is {underlay!r}; give 'curvature', 'sulcal depth' or 'none'")
    of_overlay = (above, below, limits, colour_map, label, channel, interpolation)
    if overlay is None and any(value is not None for value in of_overlay):
        raise InputError("thresholds, limits, colour map, label, channel and interpolation are of an overlay; give one")
    if opacity is not None and not 0 <= checked_number(opacity, "opacity") <= 1:
        raise InputError(f"the opacity is {opacity!r}; give a number from 0 to 1")
    depths = Depths.of(depth, fraction, layering)
    sampler = flat_map._triangles.on_surface
    in_volume = {name for name, of in (("overlay", overlay), ("parcels", parcels)) if _is_volume(sampler, of)}
    if depths != ON_SURFACE and not in_volume:
        raise InputError("depth and fraction are for volumes: neither overlay nor parcels is one; leave them out")
    page = _Page.of(flat_map, width, title)
    raster = flat_map.raster(page.pixel_size)
    under = folds(flat_map, raster, underlay)
    page.image(under, raster, "curvature")
    look = under[..., :3].mean(axis=2)
    of_parcels = depths if "parcels" in in_volume else ON_SURFACE
    shown = None if parcels is None else _parcels(flat_map, parcels, table, of_parcels)
    if overlay is not None:
        where: dict[str, Any] = {"depths": depths if "overlay" in in_volume else ON_SURFACE}
        image = sampler.image(raster, overlay, channel=channel, interpolation=interpolation, **where)
        colours = _Colours.of(image, limits, colour_map, above, below, 1.0 if opacity is None else opacity)
        over = colours.paint(image.data)
        page.image(over, raster, "data")
        look = _over(over, look)
        if colours.has_bar:
            page.bar(colours, label if label is not None else "" if image.name == "volume" else image.name)
    if shown is not None:
        labels = shown.raster(raster)
        if overlay is None:
            filled = shown.coloured(labels)
            filled[..., 3] = np.round(255 * (_PARCELS_OPACITY if opacity is None else opacity) * (filled[..., 3] > 0))
            page.image(filled, raster, "parcels")
            look = _over(filled, look)
        page.lines(shown.borders, "parcels", _THIN, "black")
        page.names(shown, labels, raster, look)
    page.lines(outline(flat_map.uv, flat_map.faces[~flat_map.torn]), "marks", _LINE, "0.25")
    page.marks(flat_map)
    return page.figure


def folds(flat_map: FlatMap, raster: Raster, underlay: str = "curvature") -> NDArray[np.uint8]:
    """Return the grey picture of the folds: gyri light, sulci dark.

    Parameters
    ----------
    flat_map : FlatMap
        A flat map; one without curvature (of the method "grossmann2002") has an even grey.
    raster : Raster
        Its pixels.
    underlay : {"curvature", "sulcal depth", "none"}
        What they are told by.

    Returns
    -------
    ndarray of uint8, shape (H, W, 4)
        Opacity 0 outside the map.
    """
    values = {"curvature": flat_map.curvature, "sulcal depth": flat_map.sulcal_depth, "none": None}[underlay]
    grey = np.where(raster.inside, _NO_FOLDS, np.nan)
    if values is None and underlay != "none":
        log.info("the map has no %s, whose surface has no triangles: it is shown in an even grey", underlay)
    if values is not None:
        outwards = raster.interpolate(values if underlay == "curvature" else -values)
        level = np.clip(outwards / _EDGES[underlay], -1, 1)
        grey = np.where(np.isnan(level), grey, _DARK + (_LIGHT - _DARK) * (level + 1) / 2)
    pixels = np.zeros((*raster.shape, 4), dtype=np.uint8)
    pixels[..., :3] = np.round(255 * np.nan_to_num(grey))[..., None]
    pixels[..., 3] = 255 * raster.inside
    return pixels


def painted(
    data: NDArray[Any],
    colour_map: str,
    limits: tuple[float, float],
    *,
    above: float | None = None,
    below: float | None = None,
    opacity: float = 1.0,
) -> NDArray[np.uint8]:
    """Return values as colours, transparent where they do not pass the thresholds.

    Parameters
    ----------
    data : ndarray of float, shape (...)
        Values; NaN is transparent.
    colour_map : str
        Of matplotlib.
    limits : tuple of 2 floats
        The ends of the colours.
    above, below : float, optional
        As in `flat_map`.
    opacity : float
        From 0 to 1.

    Returns
    -------
    ndarray of uint8, shape (..., 4)

    Raises
    ------
    InputError
        If there is no such colour map.
    """
    if colour_map not in colormaps:
        raise InputError(f"matplotlib has no colour map {colour_map!r}")
    low, high = limits
    level = np.clip((np.nan_to_num(data) - low) / (high - low), 0, 1)
    pixels: NDArray[np.uint8] = colormaps[colour_map](level, bytes=True)
    pixels[..., 3] = np.where(passing(data, above, below), round(255 * opacity), 0)
    return pixels


# ------------------------------------------------------------------------------------------ colours


@dataclass(frozen=True)
class _Colours:
    """How an overlay's values become colours; None for labels and for what has colours already."""

    colour_map: str | None
    limits: tuple[float, float]
    above: float | None
    below: float | None
    opacity: float

    @classmethod
    def of(
        cls,
        image: FlatImage,
        limits: Limits | None,
        colour_map: str | None,
        above: float | None,
        below: float | None,
        opacity: float,
    ) -> _Colours:
        above, below = checked_number(above, "threshold above"), checked_number(below, "threshold below")
        inside = image.data[..., 3] > 0 if image.is_colour else np.isfinite(image.data)
        if not inside.any():
            raise InputError("the overlay has no value anywhere on the map; do their affines agree?")
        is_free = all(value is None for value in (colour_map, limits, above, below))
        if image.is_colour and not is_free:
            raise InputError("thresholds, limits and a colour map are for values, not for colours; leave them out")
        if image.is_colour or (image.is_labels and is_free):
            return cls(None, (0.0, 1.0), None, None, opacity)
        values = image.data[inside]
        if not passing(values, above, below).any():
            least, most = values.min(), values.max()
            log.warning("no value of the overlay passes the thresholds: they are from %.4g to %.4g", least, most)
        low, high = _limits(values, limits)
        chosen = colour_map if colour_map is not None else "RdBu_r" if low < 0 < high else "viridis"
        return cls(chosen, (low, high), above, below, opacity)

    @property
    def has_bar(self) -> bool:
        return self.colour_map is not None

    def paint(self, data: NDArray[Any]) -> NDArray[np.uint8]:
        """Return pixels (H, W, 4)."""
        if self.colour_map is not None:
            return painted(data, self.colour_map, self.limits, above=self.above, below=self.below, opacity=self.opacity)
        pixels = data.copy() if data.ndim == 3 else label_colours(data)
        pixels[..., 3] = np.round(pixels[..., 3] * self.opacity)
        return pixels


def _limits(values: NDArray[Any], limits: Limits | None) -> tuple[float, float]:
    """Return the ends of the colours."""
    if limits is None:
        low, high = np.percentile(values, WINDOW).tolist()
        if low < 0 < high:
            low, high = -max(-low, high), max(-low, high)
        return (low, high) if low < high else (low - 0.5, low + 0.5)
    if isinstance(limits, str) or len(limits) != 2:
        raise InputError(f"limits are {limits!r}; give two numbers, or percentiles such as ('2%', '98%')")
    low, high = (_limit(values, end) for end in limits)
    if not low < high:
        raise InputError(f"limits are {low:g} and {high:g}; give the lower one first, and another one")
    return low, high


def _limit(values: NDArray[Any], end: float | str) -> float:
    try:
        if isinstance(end, str) and end.strip().endswith("%"):
            return float(np.percentile(values, float(end.strip()[:-1])))
        number = float(end)
    except ValueError:
        number = np.nan
    if not np.isfinite(number):
        raise InputError(f"a limit is {end!r}; give a number, or a percentile from 0% to 100%")
    return number


def _over(pixels: NDArray[np.uint8], grey: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Return how light it is where pixels lie over a grey."""
    share = pixels[..., 3] / 255
    return np.asarray(share * (pixels[..., :3] @ np.array([0.3, 0.59, 0.11])) + (1 - share) * grey)


def _is_volume(sampler: Sampler, values: object) -> bool:
    return not (values is None or isinstance(values, Parcels) or sampler.is_overlay(values))


def _parcels(flat_map: FlatMap, parcels: object, table: object, depths: Depths) -> Parcels:
    if isinstance(parcels, Parcels):
        return parcels
    return parcels_of(flat_map, parcels, table=table, depths=depths)


# --------------------------------------------------------------------------------------------- page


class _Page:
    """A sheet of paper in mm: the map above, a strip of marks below."""

    def __init__(self, width: float, height: float, scale: float, box: tuple[float, float, float, float]) -> None:
        dpi = max(_LEAST_DPI, int(np.ceil(_MOST_PIXELS * _INCH / width)))
        self.width, self.height, self.scale = width, height, scale
        self.pixel_size = _INCH / dpi / scale
        self.figure = Figure(figsize=(width / _INCH, height / _INCH), dpi=dpi)
        self.paper = self.figure.add_axes((0, 0, 1, 1), zorder=2)
        self.paper.set(xlim=(0, width), ylim=(0, height))
        left, bottom, wide, high = box
        self.axes = self.figure.add_axes((left / width, bottom / height, wide * scale / width, high * scale / height))
        for axes in (self.paper, self.axes):
            axes.set_axis_off()
            axes.patch.set_visible(False)
        self.axes.set_label(MAP)
        self.box = box

    @classmethod
    def of(cls, flat_map: FlatMap, width: float, title: str | None) -> _Page:
        if not 30 <= checked_number(width, "width") <= 1000:
            raise InputError(f"the width is {width!r} mm; give 30 to 1000, such as 85 for a column")
        low = flat_map.uv.min(axis=0)
        wide, high = np.ptp(flat_map.uv, axis=0).tolist()
        top = _EDGE if not title else _TITLE + _EDGE
        room = width - 2 * _EDGE
        scale = min(room / wide, (_TALLEST * width - _STRIP - top) / high)
        height = _STRIP + _EDGE + high * scale + top
        page = cls(width, height, scale, ((width - wide * scale) / 2, _STRIP + _EDGE, wide, high))
        page.low = low
        page.axes.set(xlim=(low[0], low[0] + wide), ylim=(low[1], low[1] + high))
        if title:
            page.text(width / 2, height - _EDGE, title, "marks", va="top", size=_LETTER)
        return page

    low: NDArray[np.float64]

    def text(self, x: float, y: float, text: str, layer: str, **how: Any) -> None:
        """Write a text at a place on paper, mm."""
        style = {"ha": "center", "va": "center", "size": _FONT, "linespacing": 1.05, "gid": layer, **how}
        self.paper.text(x, y, text, **style)

    def image(self, pixels: NDArray[np.uint8], raster: Raster, layer: str) -> None:
        """Lay pixels where they lie on the map."""
        height, width = raster.shape
        step = raster.pixel_size
        left, top = raster.origin[0] - step / 2, raster.origin[1] + step / 2
        extent = (left, left + width * step, top - height * step, top)
        self.axes.imshow(
            pixels, extent=extent, origin="upper", interpolation="nearest", aspect="auto", gid=layer, clip_on=False
        )
        self.axes.set(xlim=(self.low[0], self.low[0] + self.box[2]), ylim=(self.low[1], self.low[1] + self.box[3]))

    def lines(self, lines: list[NDArray[np.float64]], layer: str, width: float, colour: str) -> None:
        """Draw lines in mm of the map."""
        drawn = LineCollection(
            lines, linewidths=width, colors=colour, capstyle="round", joinstyle="round", gid=layer, clip_on=False
        )
        self.axes.add_collection(drawn, autolim=False)

    def names(self, parcels: Parcels, labels: NDArray[np.int64], raster: Raster, look: NDArray[np.float64]) -> None:
        """Write the names of parcels that have room, black or white."""
        every = max(1, int(_NAMES_PIXEL / (raster.pixel_size * self.scale)))
        pixel = every * raster.pixel_size * self.scale
        placed, left_out = place_names(labels[every // 2 :: every, every // 2 :: every], parcels.names, pixel)
        for name in placed:
            row, column = (every // 2 + every * at for at in (name.row, name.column))
            rows, columns = (
                slice(int(at - every * of / 2), int(at + every * of / 2) + 1)
                for at, of in ((row, name.height), (column, name.width))
            )
            light = float(look[rows, columns].mean())
            x, y = self.at(raster.origin[0] + raster.pixel_size * column, raster.origin[1] - raster.pixel_size * row)
            turned = {"rotation": 90 if name.is_upright else 0, "color": "black" if light > 115 else "white"}
            self.text(x, y, name.text, "names", size=name.size, **turned)
        small = sum(name.size < 6 for name in placed)
        if small:
            log.info("%d of %d names are smaller than 6 points; a wider figure has more room", small, len(placed))
        if left_out:
            log.warning(
                "%d of %d names have no room in their parcels and are left out: %s; a wider figure has more",
                len(left_out),
                len(left_out) + len(placed),
                ", ".join(left_out),
            )

    def at(self, u: float, v: float) -> tuple[float, float]:
        """Return a place of the map on paper, mm."""
        left, bottom, *_ = self.box
        return left + (u - self.low[0]) * self.scale, bottom + (v - self.low[1]) * self.scale

    def bar(self, colours: _Colours, label: str) -> None:
        """Draw the colour bar, with what is beyond the thresholds in grey."""
        low, high = colours.limits
        wide, x = min(36.0, 0.42 * self.width), self.width - _EDGE - 2.5
        box = ((x - wide) / self.width, 4.1 / self.height, wide / self.width, 1.9 / self.height)
        axes = self.figure.add_axes(box, zorder=3)
        axes.set_gid("data")
        values = np.linspace(low, high, 512)[None]
        pixels = colours.paint(values)
        share = pixels[..., 3:] / 255
        mixed = np.round(share * pixels[..., :3] + (1 - share) * 255 * (_DARK + _LIGHT) / 2).astype(np.uint8)
        axes.imshow(mixed, extent=(low, high, 0, 1), aspect="auto", interpolation="nearest")
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.tick_params(axis="x", labelsize=6, length=1.5, width=0.4, pad=1)
        axes.set_yticks([])
        for spine in axes.spines.values():
            spine.set_linewidth(0.4)
        room = max(wide, x - _MARKS)
        while text_size(label, _FONT)[0] > room:
            label = label[:-2].rstrip() + "…"
        is_narrow = text_size(label, _FONT)[0] <= wide
        axes.set_title(label, fontsize=_FONT, pad=1.5, loc="center" if is_narrow else "right")

    def marks(self, flat_map: FlatMap) -> None:
        """Draw the scale bar, the directions of the body, the side, and the names of cuts."""
        x, middle = _EDGE + 4.0, _STRIP / 2
        found = directions(flat_map)
        if not found and flat_map.space.name == "unknown":
            log.info("the space of the surface is unknown: where anterior and superior are is not shown")
        if found:
            centre = np.array([x, middle]) - 1.0 * np.sum([(one.u, one.v) for one in found], axis=0)
            for one in found:
                towards = np.array([one.u, one.v])
                tip, letter = centre + 3.0 * towards, centre + 4.3 * towards
                style = "-|>,head_length=2.2,head_width=1.1"
                ends = ((float(x), float(y)) for x, y in (centre, tip))
                arrow = FancyArrowPatch(*ends, arrowstyle=style, linewidth=0.7, color="black", shrinkA=0, shrinkB=0)
                arrow.set_gid("marks")
                self.paper.add_patch(arrow)
                self.text(letter[0], letter[1], one.letter, "marks")
            x += 6.5
        which = side(flat_map)
        if which is not None:
            self.text(x, middle, which, "marks", size=9, weight="bold")
            x += 4.5
        else:
            x += 1.0
        length = round_length(0.22 * self.width / self.scale)
        end = x + length * self.scale
        self.paper.plot([x, end], [3.2, 3.2], color="black", linewidth=1.6, solid_capstyle="butt", gid="marks")
        self.text((x + end) / 2, 5.4, f"{length:g} mm", "marks")
        for name, u, v in cut_names(flat_map):
            x, y = self.at(u, v)
            self.text(x, y, name, "marks", style="italic", color="0.15", bbox=_BEHIND)
