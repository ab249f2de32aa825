"""Movies of a series on the flat map: folds, data over them, a fixed colour scale, and the time."""

from collections.abc import Sequence
from typing import overload

import numpy as np
from matplotlib.font_manager import findfont
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from voxflat.arguments import Progress, checked_choice, checked_switch, is_number, is_whole, log, shown
from voxflat.errors import InputError
from voxflat.figures.flat_maps import UNDERLAYS, check_differ, folds, maps_of
from voxflat.figures.overlays import Overlay, OverlayColours
from voxflat.figures.page import Page, Panel, pixels_of
from voxflat.maps.depth import Depths
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.lines import outline
from voxflat.maps.raster import FlatImage, FlatStack
from voxflat.maps.sampling import Sampling
from voxflat.maps.sources import source_of

_WIDTH = 120.0  # width of a frame on paper, mm: fonts of 6.5 points are 24 pixels high in a frame of 1,280 pixels
_SIZES = (320, 3840)
_LINE = 0.5  # points
_LOOKED_AT = 16  # number of frames from which colours are chosen
_VALUES = 1 << 20  # number of values from these frames
_TIME, _CORNER = 3.2, 1.8  # mm of paper: height of the letters, and their distance from the corner


class Movie(Sequence[NDArray[np.uint8]]):
    """A sequence of images, one per frame of a series.

    `movie` creates such sequences. Frames are drawn on request: ``movie[3]`` is a uint8 array of shape (H, W, 3).

    Parameters
    ----------
    stacks : sequence of FlatStack
        The frames of each map.
    colours : OverlayColours
        The colours of all frames.
    page : Page
        The layout.
    layers : tuple of two ndarrays of uint8, shape (H, W, 4)
        The images below and above the data.
    rate : float
        Frames per second.

    See Also
    --------
    movie : Make a movie of a series.
    save_movie : Write a movie to a file.

    Examples
    --------
    >>> flat_map = voxflat.samples.hill().flatten()
    >>> voxflat.figures.movie(flat_map, np.ones((441, 3)), size=320)
    <Movie: overlay, 3 frames of 320 x 358 pixels, 10 per second>
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
        self._font = ImageFont.truetype(findfont("DejaVu Sans"), round(_TIME * self._below.width / page.width))
        self._corner = round(_CORNER * self._below.width / page.width)

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.stack)

    def __repr__(self) -> str:
        height, width = self.size
        return f"<Movie: {self.stack.name}, {len(self)} frames of {width} x {height} pixels, {self.rate:g} per second>"

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of each frame in pixels. Both are even, as H.264 requires."""
        return (self._below.height, self._below.width)

    def _caption(self, n: int) -> str:
        """Return the text above a frame: its time, its name, or its number (from 0)."""
        times, timing = self.stack.times, self.stack.timing
        if times is None or timing is None:
            return self.stack.names[n] or f"frame {n}"
        both = np.array([timing.step, timing.start])
        decimals = next((n for n in range(3) if (np.abs(np.round(both, n) - both) < 1e-6).all()), 3)
        return f"{times[n]:.{decimals}f} s"

    @overload
    def __getitem__(self, n: int) -> NDArray[np.uint8]: ...

    @overload
    def __getitem__(self, n: slice) -> list[NDArray[np.uint8]]: ...

    def __getitem__(self, n: int | slice) -> NDArray[np.uint8] | list[NDArray[np.uint8]]:
        """Draw a frame."""
        if isinstance(n, slice):
            return [self[number] for number in range(*n.indices(len(self)))]
        if not -len(self) <= n < len(self):
            raise IndexError(n)
        n %= len(self)
        drawn = self._below.copy()
        for stack, ((top, rows), (left, columns)) in zip(self.stacks, self._places, strict=True):
            data = self.colours.paint(stack[n].data)
            drawn.alpha_composite(Image.fromarray(data[rows][:, columns]), (left, top))
        drawn.alpha_composite(self._above)
        ImageDraw.Draw(drawn).text((self._corner, self._corner), self._caption(n), (0, 0, 0), self._font)
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
    """Draw a series on a flat map, frame by frame.

    Each frame shows the folds, the data over them, and the time. All frames have the same colour scale, whose default
    limits and percentiles are computed from up to 16 evenly spaced frames.

    Parameters
    ----------
    flat_map : FlatMap, or sequence of two
        A flat map, or the maps of both hemispheres, as in `flat_map`.
    overlay : Overlay, path, ndarray or image object
        A series: any input that `FlatMap.images` accepts, or an `Overlay` with display options. By default, values are
        interpolated linearly between voxels.
    depth, fraction : float or sequence of float, optional
        Where to sample volumes, as in `FlatMap.images`. With several depths, the mean is shown.
    layering : str
        The meaning of `fraction`, as in `FlatMap.images`.
    change : bool
        Show the change from the mean of each point in %, as computed by `FlatStack.percent_change`, instead of raw
        signals, which mostly show anatomy.
    opacity : float
        Opacity of the data, from 0 to 1.
    underlay : {"curvature", "sulcal depth", "none"}
        The measure that shows the folds.
    title : str, optional
        Text above the map.
    rate : float
        Frames per second.
    size : int
        Width of the frames in pixels.
    progress : callable, optional
        Progress callback, as in `FlatStack.percent_change`.

    Returns
    -------
    Movie
        A sequence of images.

    Raises
    ------
    InputError
        If an argument is invalid, or if the series has only one frame.

    See Also
    --------
    save_movie : Write the movie to a file.
    flat_map : Draw one map of values.

    Examples
    --------
    >>> flat_map = voxflat.samples.hill().flatten()
    >>> movie = voxflat.figures.movie(flat_map, np.random.default_rng(0).random((441, 3)), size=320)
    >>> len(movie)
    3
    """
    maps = maps_of(flat_map)
    look = Overlay._of(overlay, len(maps))
    check_differ(maps, look.values)
    if look.channel is not None or look.strength is not None or look.period is not None:
        raise InputError("channel, strength and period do not apply to movies. Omit them")
    checked_choice(underlay, "underlay", UNDERLAYS)
    checked_switch(change, "change")
    if not (is_number(rate) and 0.1 <= rate <= 120):
        raise InputError(f"rate is {shown(rate)}. Pass a rate of 0.1 to 120 frames per second")
    if not (is_whole(size) and _SIZES[0] <= size <= _SIZES[1]):
        raise InputError(f"size is {shown(size)}. Pass a width of {_SIZES[0]} to {_SIZES[1]} pixels")
    if not (is_number(opacity) and 0 <= opacity <= 1):
        raise InputError(f"opacity is {shown(opacity)}. Pass a number from 0 to 1")
    page = Page.of(maps, _WIDTH, title, head=True, pixels=int(size))
    depths = Depths.of(depth, fraction, layering)
    sampling = Sampling(depths, "mean", look.interpolation or "linear")
    values = look.values if len(maps) > 1 and isinstance(look.values, list | tuple) else [look.values] * len(maps)
    stacks = []
    for data, panel in zip(values, page.panels, strict=True):
        raster = panel.flat_map.raster(page.pixel_size)
        source = source_of(panel.flat_map._triangles.on_surface, data)
        stack = source.stack(raster, sampling, time_step=look.time_step)
        _check_series(stack)
        panel.image(folds(panel.flat_map, raster, underlay), raster, "curvature")
        stacks.append(stack.percent_change(progress) if change else stack)
    if len({len(stack) for stack in stacks}) > 1:
        counts = " and ".join(str(len(stack)) for stack in stacks)
        raise InputError(f"the series have {counts} frames. Pass series with equal numbers of frames")
    colours = OverlayColours.of(_look(stacks), None, look, opacity)
    beneath = _pixels(page)
    for panel in page.panels:
        for artist in panel.axes.images:
            artist.set_visible(False)
        panel.lines(outline(panel.flat_map.uv, panel.flat_map.faces[~panel.flat_map.torn]), "marks", _LINE, "0.25")
    page.figure.patch.set_alpha(0)
    page.marks()
    page.bar(colours, stacks[0].name if look.label is None else look.label)
    return Movie(stacks, colours, page, (beneath, _pixels(page)), rate)


def _check_series(stack: FlatStack) -> None:
    if len(stack) < 2:
        raise InputError(f"{stack.name} has only one frame. Draw it as a figure instead of a movie")
    if stack[0].is_colour:
        raise InputError(f"{stack.name} contains colours, not values. Pass a series of values")
    if stack.timing is None and not any(stack.names):
        log.info("%s has no time step, so its frames are numbered. Pass time_step to show times", stack.name)


def _look(stacks: Sequence[FlatStack]) -> FlatImage:
    """Return the values of evenly spaced frames as one image, from which colours are chosen."""
    first, count = stacks[0], len(stacks[0])
    frames = np.unique(np.linspace(0, count - 1, min(_LOOKED_AT, count)).round().astype(int)).tolist()
    every = max(1, len(frames) * sum(stack[0].data.size for stack in stacks) // _VALUES)
    values = [
        stack[n].data.ravel()[n % every :: every][: stack[0].data.size // every] for stack in stacks for n in frames
    ]
    if len(frames) < count:
        log.info("The colour limits are computed from %d of %d frames", len(frames), count)
    return FlatImage(np.concatenate(values)[None], first.pixel_size, first.origin, first.name, labels=False)


def _pixels(page: Page) -> NDArray[np.uint8]:
    """Draw a page as an image (H, W, 4) with an even height and width, as H.264 requires."""
    drawn = pixels_of(page.figure)
    odd = [(0, side % 2) for side in drawn.shape[:2]]
    return np.pad(drawn, (*odd, (0, 0)), mode="edge")


def _places(page: Page, panel: Panel, stack: FlatStack, shape: tuple[int, ...]) -> list[tuple[int, NDArray[np.int64]]]:
    """Return the first row and the first column that show the map, each with the map pixels from there on."""
    per_mm = page.figure.dpi / 25.4
    left, bottom = (per_mm * place for place in panel.at(*stack.origin))  # pixel (0, 0) from the lower left corner
    step = per_mm * page.scale * stack.pixel_size
    down = np.arange(shape[0]) + 0.5 - (page.figure.bbox.height - bottom)
    right = np.arange(shape[1]) + 0.5 - left
    covering = []
    for away, count in zip((down, right), stack[0].data.shape, strict=True):
        numbers = np.round(away / step).astype(np.int64)
        covered = np.flatnonzero((numbers >= 0) & (numbers < count))
        covering.append((int(covered[0]), numbers[covered]))
    return covering
