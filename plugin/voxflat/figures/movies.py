"""Movies of a series on the flat map: folds, data over them, one scale of colours, and the time."""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, overload

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.font_manager import findfont
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from voxflat.arguments import Progress, checked_choice, checked_switch, is_number, is_whole, log, shown
from voxflat.errors import InputError
from voxflat.figures.flat_maps import UNDERLAYS, folds, maps_of
from voxflat.figures.overlays import Overlay, OverlayColours
from voxflat.figures.paper import Page, Panel
from voxflat.maps.depth import Depths
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.lines import outline
from voxflat.maps.raster import FlatImage, FlatStack

_WIDTH = 120.0  # mm of paper that the pictures stand for: fonts of 6.5 points are 24 of 1,280 pixels
_SIZES = (320, 3840)
_LINE = 0.5  # points
_LOOKED_AT = 16  # frames by which colours are chosen
_VALUES = 1 << 20  # values of them
_TIME, _CORNER = 3.2, 1.8  # mm of paper: height of the letters, and where they begin


class Movie(Sequence[NDArray[np.uint8]]):
    """Pictures of the frames of a series, each drawn when it is asked for: ``movie[3]`` is (H, W, 3), uint8.

    Parameters
    ----------
    stacks : sequence of FlatStack
        The frames, of each map that is shown.
    colours : OverlayColours
        Of all of them.
    page : Page
        What lies around them.
    layers : tuple of two ndarrays of uint8, shape (H, W, 4)
        What is below the data and above.
    rate : float
        Frames a second.

    Examples
    --------
    >>> flat_map = voxflat.samples.hill().flatten()
    >>> voxflat.figures.movie(flat_map, np.ones((441, 3)), size=320)
    <Movie: overlay, 3 frames of 320 x 358 pixels, 10 a second>
    """

    def __init__(
        self,
        stacks: Sequence[FlatStack],
        colours: OverlayColours,
        page: Page,
        layers: tuple[NDArray[np.uint8], NDArray[np.uint8]],
        rate: float,
    ) -> None:
        self.stacks, self.stack, self.colours, self.rate = tuple(stacks), stacks[0], colours, rate
        self._below, self._above = (Image.fromarray(layer) for layer in layers)
        panels = zip(page.panels, stacks, strict=True)
        self._places = [_places(page, panel, stack, self.size) for panel, stack in panels]
        self._font = _font(round(_TIME * self._below.width / page.width))
        self._corner = round(_CORNER * self._below.width / page.width)

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.stack)

    def __repr__(self) -> str:
        height, width = self.size
        return f"<Movie: {self.stack.name}, {len(self)} frames of {width} x {height} pixels, {self.rate:g} a second>"

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of each picture, pixels; both are even."""
        return (self._below.height, self._below.width)

    def _told(self, n: int) -> str:
        """Return what is written above a frame: its time, else its name, else its number from 0."""
        times = self.stack.times
        if times is None:
            return self.stack.names[n] or f"frame {n}"
        return f"{times[n]:.{_decimals(self.stack)}f} s"

    @overload
    def __getitem__(self, n: int) -> NDArray[np.uint8]: ...

    @overload
    def __getitem__(self, n: slice) -> list[NDArray[np.uint8]]: ...

    def __getitem__(self, n: int | slice) -> NDArray[np.uint8] | list[NDArray[np.uint8]]:
        """Draw a frame."""
        if isinstance(n, slice):
            return [self[at] for at in range(*n.indices(len(self)))]
        if not -len(self) <= n < len(self):
            raise IndexError(n)
        n %= len(self)
        drawn = self._below.copy()
        for stack, ((top, rows), (left, columns)) in zip(self.stacks, self._places, strict=True):
            data = self.colours.paint(stack[n].data)
            drawn.alpha_composite(Image.fromarray(data[rows][:, columns]), (left, top))
        drawn.alpha_composite(self._above)
        ImageDraw.Draw(drawn).text((self._corner, self._corner), self._told(n), (0, 0, 0), self._font)
        return np.asarray(drawn.convert("RGB"))


def movie(
    flat_map: FlatMap | Sequence[FlatMap],
    overlay: object,
    *,
    depth: float | Sequence[float] = 0.0,
    fraction: float | Sequence[float] | None = None,
    layering: str = "equivolume",
    change: bool = False,
    opacity: float = 1.0,
    underlay: str = "curvature",
    title: str | None = None,
    rate: float = 10.0,
    size: int = 1280,
    progress: Progress | None = None,
) -> Movie:
    """Show a series on a flat map frame by frame: folds, data over them in one scale of colours, and the time.

    Parameters
    ----------
    flat_map : FlatMap, or sequence of two
        A flat map, or those of both hemispheres, as in `figures.flat_map`.
    overlay : Overlay, path, ndarray, image object
        A series: everything that `FlatMap.images` takes, or an `Overlay` that says how it is shown. Values are sampled
        linearly between voxels unless it says otherwise: series are hardly ever of labels. Limits that are not given,
        and percentiles, are those of up to 16 frames, spread evenly.
    depth, fraction, layering
        As in `FlatMap.images`; of several depths the mean is shown.
    change : bool
        Show the change from each place's mean, %, as `FlatStack.percent_change`: raw signals show little but anatomy.
    opacity : float
        Of the data, from 0 to 1.
    underlay, title
        As in `flat_map`.
    rate : float
        Frames a second.
    size : int
        Width of the pictures, pixels.
    progress : callable, optional
        As in `FlatStack.percent_change`.

    Returns
    -------
    Movie
        A sequence of pictures, for `save_movie`.

    Raises
    ------
    InputError
        As `flat_map`; if there is one frame only, or a number is out of bounds.

    Examples
    --------
    >>> flat_map = voxflat.samples.hill().flatten()
    >>> movie = voxflat.figures.movie(flat_map, np.random.default_rng(0).random((441, 3)), size=320)
    >>> len(movie)
    3
    """
    maps = maps_of(flat_map)
    of = Overlay._of(overlay, len(maps))
    if of.channel is not None or of.strength is not None or of.period is not None:
        raise InputError("channel, strength and period are for figures: a movie shows the values of all frames")
    checked_choice(underlay, "underlay", UNDERLAYS)
    checked_switch(change, "change")
    if not (is_number(rate) and 0.1 <= rate <= 120):
        raise InputError(f"the rate is {shown(rate)}; give 0.1 to 120 frames a second")
    if not (is_whole(size) and _SIZES[0] <= size <= _SIZES[1]):
        raise InputError(f"the size is {shown(size)}; give the pictures' width, {_SIZES[0]} to {_SIZES[1]} pixels")
    if not (is_number(opacity) and 0 <= opacity <= 1):
        raise InputError(f"the opacity is {shown(opacity)}; give a number from 0 to 1")
    page = Page.of(maps, _WIDTH, title, head=True, pixels=int(size))
    depths = Depths.of(depth, fraction, layering)
    how: dict[str, Any] = {"interpolation": of.interpolation or "linear", "time_step": of.time_step, "average": True}
    values = of.values if len(maps) > 1 and isinstance(of.values, list | tuple) else [of.values] * len(maps)
    stacks = []
    for own, panel in zip(values, page.panels, strict=True):
        raster = panel.flat_map.raster(page.pixel_size)
        stack = panel.flat_map._triangles.on_surface.images(raster, own, depths=depths, **how)
        _check_series(stack)
        panel.image(folds(panel.flat_map, raster, underlay), raster, "curvature")
        stacks.append(stack.percent_change(progress) if change else stack)
    if len({len(stack) for stack in stacks}) > 1:
        raise InputError(f"the series have {' and '.join(str(len(one)) for one in stacks)} frames: give equally many")
    colours = OverlayColours.of(_look(stacks), None, of, opacity)
    beneath = _pixels(page)
    for panel in page.panels:
        for artist in panel.axes.images:
            artist.set_visible(False)
        panel.lines(outline(panel.flat_map.uv, panel.flat_map.faces[~panel.flat_map.torn]), "marks", _LINE, "0.25")
    page.figure.patch.set_alpha(0)
    page.marks()
    page.bar(colours, stacks[0].name if of.label is None else of.label)
    return Movie(stacks, colours, page, (beneath, _pixels(page)), rate)


def _check_series(stack: FlatStack) -> None:
    if len(stack) < 2:
        raise InputError(f"{stack.name} has one frame: voxflat figure shows it (figures.flat_map)")
    if stack[0].is_colour:
        raise InputError("colours are no series: give values")
    if stack.timing is None and not any(stack.names):
        log.info("%s does not say how far apart its frames are: they are numbered; the time step says it", stack.name)


def _look(stacks: Sequence[FlatStack]) -> FlatImage:
    """Return values of frames spread over the series, in one image, for the choice of colours."""
    first, count = stacks[0], len(stacks[0])
    frames = np.unique(np.linspace(0, count - 1, min(_LOOKED_AT, count)).round().astype(int)).tolist()
    every = max(1, len(frames) * sum(stack[0].data.size for stack in stacks) // _VALUES)
    values = [
        stack[n].data.ravel()[n % every :: every][: stack[0].data.size // every] for stack in stacks for n in frames
    ]
    if len(frames) < count:
        log.info("colours are chosen by %d of %d frames", len(frames), count)
    return FlatImage(np.concatenate(values)[None], first.pixel_size, first.origin, first.name, labels=False)


def _pixels(page: Page) -> NDArray[np.uint8]:
    """Draw what is on a page, (H, W, 4); height and width are even, as H.264 wants them."""
    canvas: Any = FigureCanvasAgg(page.figure)
    canvas.draw()
    drawn = np.asarray(canvas.buffer_rgba()).copy()
    odd = [(0, side % 2) for side in drawn.shape[:2]]
    return np.pad(drawn, (*odd, (0, 0)), mode="edge")


def _places(page: Page, panel: Panel, stack: FlatStack, shape: tuple[int, ...]) -> list[tuple[int, NDArray[np.int64]]]:
    """Return of rows, and of columns, the first of a picture that shows the map, and which pixels these show."""
    per_mm = page.figure.dpi / 25.4
    left, bottom = (per_mm * at for at in panel.at(*stack.origin))  # of pixel (0, 0), from the lower left corner
    step = per_mm * page.scale * stack.pixel_size
    down = np.arange(shape[0]) + 0.5 - (page.figure.bbox.height - bottom)
    right = np.arange(shape[1]) + 0.5 - left
    found = []
    for away, count in zip((down, right), stack[0].data.shape, strict=True):
        numbers = np.round(away / step).astype(np.int64)
        covered = np.flatnonzero((numbers >= 0) & (numbers < count))
        found.append((int(covered[0]), numbers[covered]))
    return found


def _decimals(stack: FlatStack) -> int:
    """Return how many decimals the times of a series need, at most 3."""
    assert stack.timing is not None
    told = (stack.timing.step, stack.timing.start)
    return next(n for n in range(4) if n == 3 or all(abs(round(value, n) - value) < 1e-6 for value in told))


@lru_cache
def _font(size: int) -> Any:
    return ImageFont.truetype(str(Path(findfont("DejaVu Sans"))), size)
