"""Lay out the page of a flat-map figure: maps, and a strip below them with annotations and the colour bar."""

from bisect import bisect
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from voxflat.arguments import checked_instance, checked_number, checked_text, log, shown
from voxflat.errors import InputError
from voxflat.figures.layers import MAP
from voxflat.figures.marks import cut_names, directions, round_length, side
from voxflat.figures.names import place_names, plain, text_size
from voxflat.figures.overlays import OverlayColours
from voxflat.io.grid import in_unit
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.parcels import Parcels
from voxflat.maps.raster import FlatImage, Raster
from voxflat.maps.summary import summary_of

DARK, LIGHT = 0.47, 0.75  # greys of sulci and gyri
STRIP, WHEEL_STRIP = 9.0, 18.0  # height of the strip below a map, without and with a colour wheel, mm

_INCH = 25.4  # mm
_MOST_PIXELS, _LEAST_DPI = 1700, 300
_EDGE, _TITLE = 1.5, 5.0  # mm on paper: margin and height of the title
_WHEEL, _HOLE = 11.0, 0.45  # diameter of the colour wheel, mm; its hole, as a share of the radius
_WHEEL_PIXELS = 400
_TALLEST = 1.4  # greatest height, as a multiple of the width
_FONT, _LETTER, _TICK = 6.5, 7.5, 6.0  # points
_TITLE_PAD = 2.6  # of a colour bar, points: descenders stay above the frame
_BESIDE, _APART = 0.8, 0.8  # mm beside the name of a cut, and between the labels of ticks
_NAMES_PIXEL = 0.2  # mm of paper
_MARKS = 30.0  # room for directions, hemisphere and scale bar, mm
_SIDE = 14.0  # room for directions and hemisphere, mm
_GAP = 2.0  # mm between maps
_LISTED = 20  # most names of parcels in a warning
_BEHIND = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.8}  # background of names over data

Box: TypeAlias = tuple[float, float, float, float]  # left, bottom, right and top on paper, mm


class Panel:
    """One map on a page: its axes, in mm on the map, and their position on paper."""

    def __init__(self, axes: Any, flat_map: FlatMap, corner: tuple[float, float], scale: float) -> None:
        self.axes, self.flat_map, self.corner, self.scale = axes, flat_map, corner, scale
        self.low = flat_map.uv.min(axis=0)
        self.size = np.ptp(flat_map.uv, axis=0)
        axes.set_label(MAP)
        self._show_all()

    def _show_all(self) -> None:
        right, top = self.low + self.size
        self.axes.set(xlim=(self.low[0], right), ylim=(self.low[1], top))

    def at(self, u: float, v: float) -> tuple[float, float]:
        """Return the position of a map point on paper, in mm."""
        left, bottom = self.corner
        return left + (u - self.low[0]) * self.scale, bottom + (v - self.low[1]) * self.scale

    def image(self, pixels: NDArray[np.uint8], raster: Raster, layer: str) -> None:
        """Draw pixels at their position on the map."""
        extent = FlatImage(pixels, raster.pixel_size, raster.origin, layer).extent
        style = {"origin": "upper", "interpolation": "nearest", "aspect": "auto", "clip_on": False}
        self.axes.imshow(pixels, extent=extent, gid=layer, **style)
        self._show_all()

    def lines(self, lines: list[NDArray[np.float64]], layer: str, width: float, colour: str) -> None:
        """Draw lines that are given in map coordinates, in mm."""
        style: Any = {"capstyle": "round", "joinstyle": "round", "clip_on": False}
        drawn = LineCollection(lines, linewidths=width, colors=colour, gid=layer, **style)
        self.axes.add_collection(drawn, autolim=False)


class Page:
    """A page in mm, as a figure or in given axes: maps side by side at one scale, and a strip of annotations below."""

    def __init__(self, width: float, height: float, scale: float, pixels: int | None, axes: Axes | None = None) -> None:
        dpi = max(_LEAST_DPI, int(np.ceil(_MOST_PIXELS * _INCH / width))) if pixels is None else pixels * _INCH / width
        self.width, self.height, self.scale = width, height, scale
        self.pixel_size = _INCH / dpi / scale
        self.panels: list[Panel] = []
        self._names: list[Box] = []  # boxes of the names on the maps
        self._within = axes
        if axes is None:
            self.figure: Any = Figure(figsize=(width / _INCH, height / _INCH), dpi=dpi)
        else:
            self.figure = axes.figure
            axes.set_axis_off()
            axes.set(xlim=(0, width), ylim=(0, height), aspect="equal")
        self.paper = self._add_axes((0, 0, width, height), zorder=2)
        self.paper.set(xlim=(0, width), ylim=(0, height))
        self.paper.set_axis_off()
        self.paper.patch.set_visible(False)

    def _add_axes(self, box: tuple[float, float, float, float], zorder: float = 0) -> Any:
        """Add axes at a position on paper: left, bottom, width and height, in mm."""
        if self._within is not None:
            return self._within.inset_axes(box, transform=self._within.transData, zorder=5 + zorder)
        left, bottom, wide, high = box
        at = (left / self.width, bottom / self.height, wide / self.width, high / self.height)
        return self.figure.add_axes(at, zorder=zorder)

    @classmethod
    def of(
        cls,
        maps: Sequence[FlatMap],
        width: float,
        title: str | None,
        *,
        strip: float = STRIP,
        head: bool = False,
        pixels: int | None = None,
        axes: Axes | None = None,
    ) -> "Page":
        """Place maps side by side on a page; lengths are in mm, `head` adds space above, `pixels` is the page width."""
        tallest = _TALLEST * checked_number(width, "width")
        if axes is not None:
            checked_instance(axes, Axes, "ax", "Matplotlib axes")
            box = axes.get_window_extent()
            width, tallest = (side / axes.figure.dpi * _INCH for side in (box.width, box.height))
        elif not 30 <= width <= 1000:
            raise InputError(f"width is {shown(width)} mm. Pass a width of 30 to 1000 mm, such as 85 for one column")
        checked_text(title, "title")
        sizes = [np.ptp(flat_map.uv, axis=0).tolist() for flat_map in maps]
        wide, high = sum(size[0] for size in sizes), max(size[1] for size in sizes)
        top = _TITLE + _EDGE if title or head else _EDGE
        room = width - 2 * _EDGE - (len(maps) - 1) * _GAP
        scale = min(room / wide, (tallest - strip - top - (0 if axes is None else _EDGE)) / high)
        if scale <= 0:
            raise InputError("the axes are too small for a flat map. Make them at least 30 mm wide and high")
        height = strip + _EDGE + high * scale + top
        page = cls(width, height, scale, pixels, axes)
        left = (width - wide * scale - (len(maps) - 1) * _GAP) / 2
        for flat_map, (across, up) in zip(maps, sizes, strict=True):
            corner = (left, strip + _EDGE + (high - up) * scale / 2)
            drawn = page._add_axes((*corner, across * scale, up * scale))
            drawn.set_axis_off()
            drawn.patch.set_visible(False)
            page.panels.append(Panel(drawn, flat_map, corner, scale))
            left += across * scale + _GAP
        if title:
            title = _shortened(title, width - 2 * _EDGE, _LETTER)
            page.text(width / 2, height - _EDGE, title, "marks", va="top", size=_LETTER)
        return page

    def text(self, x: float, y: float, text: str, layer: str, **how: Any) -> None:
        """Write a text at a position on paper, in mm."""
        style = {"ha": "center", "va": "center", "size": _FONT, "linespacing": 1.05, "gid": layer, **how}
        self.paper.text(x, y, plain(text), **style)

    def names(
        self, panel: Panel, parcels: Parcels, labels: NDArray[np.int64], raster: Raster, look: NDArray[np.float64]
    ) -> None:
        """Write the names that fit into their parcels, in black or white."""
        every = max(1, int(_NAMES_PIXEL / (raster.pixel_size * self.scale)))
        pixel = every * raster.pixel_size * self.scale
        placed, left_out = place_names(labels[every // 2 :: every, every // 2 :: every], parcels.names, pixel)
        for name in placed:
            row, column = (every // 2 + every * place for place in (name.row, name.column))
            rows, columns = (
                slice(int(centre - every * length / 2), int(centre + every * length / 2) + 1)
                for centre, length in ((row, name.height), (column, name.width))
            )
            light = float(look[rows, columns].mean())
            step = raster.pixel_size
            x, y = panel.at(raster.origin[0] + step * column, raster.origin[1] - step * row)
            turned = {"rotation": 90 if name.is_upright else 0, "color": "black" if light > 115 else "white"}
            self.text(x, y, name.text, "names", size=name.size, **turned)
            self._names.append(_box(x, y, name.width * pixel, name.height * pixel))
        small = sum(name.size < 6 for name in placed)
        if small:
            log.info("%d of %d names are smaller than 6 points. Increase the width to enlarge them", small, len(placed))
        if left_out:
            count = f"{len(left_out)} of {len(left_out) + len(placed)}"
            text = "%s names do not fit into their parcels and are omitted: %s. Increase the width to show more names"
            shown_names = [plain(name, 80) for name in left_out[:_LISTED]]
            rest = [f"and {len(left_out) - _LISTED} more"] if len(left_out) > _LISTED else []
            log.warning(text, count, ", ".join([*shown_names, *rest]))

    def bar(self, colours: OverlayColours, label: str) -> None:
        """Draw the colour bar; values excluded by the thresholds are grey."""
        low, high = colours.limits
        wide, x = min(36.0, 0.42 * self.width), self.width - _EDGE - 2.5 - self._beside()
        axes = self._add_axes((x - wide, 4.1, wide, 1.9), zorder=3)
        axes.set_gid("data")
        values = np.linspace(low, high, 512)[None]
        pixels = colours.legend(values)
        share = pixels[..., 3:] / 255
        mixed = np.round(share * pixels[..., :3] + (1 - share) * 255 * (DARK + LIGHT) / 2).astype(np.uint8)
        axes.imshow(mixed, extent=(low, high, 0, 1), aspect="auto", interpolation="nearest")
        thresholds = [] if colours.is_by_strength else [colours.above, colours.below]
        marked = sorted({end for end in thresholds if end is not None and low < end < high})
        for end in marked:
            axes.axvline(end, color="black", linewidth=0.7)
        axes.set_xticks(*_ticks(low, high, marked, wide))
        axes.tick_params(axis="x", labelsize=_TICK, length=1.5, width=0.4, pad=1)
        axes.set_yticks([])
        for spine in axes.spines.values():
            spine.set_linewidth(0.4)
        label = _shortened(label, max(wide, x - _MARKS))
        is_narrow = text_size(label, _FONT)[0] <= wide
        axes.set_title(plain(label), fontsize=_FONT, pad=_TITLE_PAD, loc="center" if is_narrow else "right")

    def wheel(self, colours: OverlayColours, label: str, zero: str) -> None:
        """Draw the colour wheel of a cyclic colour map, with the phases at its quarters."""
        x, y = self.width - _EDGE - 5.5 - _WHEEL / 2 - self._beside(), WHEEL_STRIP / 2
        axes = self._add_axes((x - _WHEEL / 2, y - _WHEEL / 2, _WHEEL, _WHEEL), zorder=3)
        axes.set_gid("data")
        axes.set_axis_off()
        across = (np.arange(_WHEEL_PIXELS) + 0.5) / _WHEEL_PIXELS * 2 - 1
        right, up = np.meshgrid(across, -across)
        period, radius = colours.limits[1], np.hypot(right, up)
        turn = np.arctan2(up, right) if zero == "right" else np.arctan2(right, up)
        pixels = colours.legend(turn / (2 * np.pi) % 1 * period)
        pixels[..., 3] = np.where((radius <= 1) & (radius >= _HOLE), 255, 0)
        axes.imshow(pixels, extent=(-1, 1, -1, 1), aspect="auto")
        is_radians = bool(np.isclose(period, 2 * np.pi, rtol=1e-6))
        for quarter in range(4):
            angle = np.pi / 2 * (quarter if zero == "right" else 1 - quarter)
            ahead, above = np.cos(angle), np.sin(angle)
            sides = {"ha": ("center", "left", "right")[round(ahead)], "va": ("center", "bottom", "top")[round(above)]}
            at = 0.5 * _WHEEL + 0.6
            phase = ("0", "π/2", "π", "3π/2")[quarter] if is_radians else f"{quarter * period / 4:.4g}"
            self.text(x + at * ahead, y + at * above, phase, "data", size=6, **sides)
        right_end = x - _WHEEL / 2 - 6.5
        self.text(right_end, WHEEL_STRIP - 5, _shortened(label, right_end - _EDGE), "data", ha="right")

    def marks(self) -> None:
        """Draw the scale bar, and for each map the anatomical directions, the hemisphere, and the names of cuts."""
        x = _EDGE + 4.0
        for panel in self.panels:
            if panel is not self.panels[0]:  # the annotations of the last map end the strip
                x = max(x, self.width - _EDGE - self._beside() + 4.0)
            x = self._directions(panel.flat_map, x)
            if panel is self.panels[0]:
                length = round_length(0.22 * self.width / self.scale / len(self.panels))
                end = x + length * self.scale
                self.paper.plot([x, end], [3.2, 3.2], color="black", linewidth=1.6, solid_capstyle="butt", gid="marks")
                self.text((x + end) / 2, 5.4, in_unit(f"{length:g} mm", panel.flat_map.origin.named_unit), "marks")
                x = end
            for whole_name, places in cut_names(panel.flat_map):
                name = _shortened(whole_name, self.width / 2)
                place = self._free(name, [panel.at(u, v) for u, v in places.tolist()])
                self.text(*place, name, "marks", style="italic", color="0.15", bbox=_BEHIND)

    def _free(self, name: str, places: Sequence[tuple[float, float]]) -> tuple[float, float]:
        """Return the first place on the page where a name covers no other name, or the first place if there is none."""
        wide, high = (side + _BESIDE for side in text_size(name, _FONT))
        low, most = (wide / 2, high / 2), (self.width - wide / 2, self.height - high / 2)
        shifted = [(x, y + step * high) for step in (0, 1, -1, 2, -2) for x, y in places]
        within = [(max(low[0], min(x, most[0])), max(low[1], min(y, most[1]))) for x, y in shifted]
        boxes = [_box(x, y, wide, high) for x, y in within]
        free = (n for n, box in enumerate(boxes) if not any(_overlap(box, other) for other in self._names))
        best = next(free, 0)
        self._names.append(boxes[best])
        return within[best]

    def _beside(self) -> float:
        """Return the room in mm for the annotations of the second map: its directions, and its side or chart."""
        if len(self.panels) == 1:
            return 0.0
        chart = summary_of(self.panels[-1].flat_map).chart
        return _SIDE if chart is None else _SIDE + max(0.0, text_size(chart, _FONT)[0] - 4.0)

    def _directions(self, flat_map: FlatMap, x: float) -> float:
        """Draw the anatomical directions and the hemisphere, starting at `x`, and return where they end, in mm."""
        middle = STRIP / 2
        arrows = directions(flat_map)
        if not arrows and flat_map.space.name == "unknown":
            log.info("The space of the surface is unknown, so anatomical directions are not drawn")
        if arrows:
            centre = np.array([x, middle]) - 1.0 * np.sum([(direction.u, direction.v) for direction in arrows], axis=0)
            for direction in arrows:
                towards = np.array([direction.u, direction.v])
                tip, letter = centre + 3.0 * towards, centre + 4.3 * towards
                style = "-|>,head_length=2.2,head_width=1.1"
                ends = ((float(x), float(y)) for x, y in (centre, tip))
                arrow = FancyArrowPatch(*ends, arrowstyle=style, linewidth=0.7, color="black", shrinkA=0, shrinkB=0)
                arrow.set_gid("marks")
                self.paper.add_patch(arrow)
                self.text(letter[0], letter[1], direction.letter, "marks")
            x += 6.5
        which = side(flat_map)
        if which is not None:
            self.text(x, middle, which, "marks", size=9, weight="bold")
            return x + 4.5
        if (chart := summary_of(flat_map).chart) is not None:
            x += 1.5 if arrows else 0.0  # beside the letter of an arrow
            name = _shortened(chart, _MARKS)
            self.text(x - 3.0, middle, name, "marks", ha="left", va="center_baseline", weight="bold")
            return x + text_size(name, _FONT)[0]
        return x + 1.0


def pixels_of(figure: Figure) -> NDArray[np.uint8]:
    """Draw a figure as an image of shape (H, W, 4)."""
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    pixels: NDArray[np.uint8] = np.asarray(canvas.buffer_rgba()).copy()
    return pixels


def _box(x: float, y: float, wide: float, high: float) -> Box:
    return x - wide / 2, y - high / 2, x + wide / 2, y + high / 2


def _overlap(box: Box, other: Box) -> bool:
    return box[0] < other[2] and other[0] < box[2] and box[1] < other[3] and other[1] < box[3]


def _ticks(low: float, high: float, marked: Sequence[float], wide: float) -> tuple[list[float], list[str]]:
    """Return ticks of a colour bar and their labels: thresholds, ends, and round values where there is room."""
    largest = max(abs(low), abs(high))
    decimals = max(0, 2 - int(np.floor(np.log10(high - low)))) if 1e-3 <= largest < 1e6 else None
    ticks: dict[float, str] = {}
    for value in map(float, (*marked, low, high, *MaxNLocator(4).tick_values(low, high))):
        text = f"{value:.3g}" if decimals is None else f"{round(value, decimals) + 0.0:.{decimals}f}"
        if "." in text and "e" not in text:
            text = text.rstrip("0").rstrip(".")
        text = text.replace("-", "\N{MINUS SIGN}")
        half = text_size(text, _TICK)[0] / 2
        rooms = ((tick, half + text_size(other, _TICK)[0] / 2 + _APART) for tick, other in ticks.items())
        if low <= value <= high and all(abs(value - tick) / (high - low) * wide >= room for tick, room in rooms):
            ticks[value] = text
    return list(ticks), list(ticks.values())


def _shortened(label: str, room: float, size: float = _FONT) -> str:
    """Return a label; if it is wider than the room in mm, an ellipsis replaces a part near its start."""

    def cut(length: int) -> str:
        return label[: length // 3].rstrip() + "…" + label[len(label) - length + length // 3 :].lstrip()

    if text_size(label, size)[0] <= room:
        return label
    return cut(max(0, bisect(range(len(label)), room, key=lambda length: text_size(cut(length), size)[0]) - 1))
