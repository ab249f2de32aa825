"""Flat maps as images: pixels in mm, their values, and their positions on the surface."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, overload

import numpy as np
import scipy
from numpy.typing import NDArray

from voxflat.arguments import Progress, checked_choice, checked_number, is_whole, log, numbers_of, shown
from voxflat.errors import Cancelled, InputError
from voxflat.io.channels import Channels, Timing
from voxflat.io.provenance import Record
from voxflat.io.saved import Saved
from voxflat.maps.colours import are_labels, coloured
from voxflat.maps.image_files import IMAGE_ENDINGS, Pages, SavedPages, write_image
from voxflat.maps.missing import NAN_POLICIES, is_defined
from voxflat.read_only import ReadOnly

_OUTSIDE = np.uint32(2**32 - 1)
_WHOLE = 1e-6  # relative tolerance within which a period is a whole number of pixels


@dataclass(frozen=True, eq=False)
class Raster(ReadOnly):
    """The pixels of a flat map, with their positions on the surface.

    Row 0 is at the top of the map (largest v), column 0 at its left (smallest u).

    Parameters
    ----------
    corners : ndarray of uint32, shape (H, W, 3)
        Points of the map at the corners of the triangle that covers each pixel's centre; 2³² − 1 outside the map.
    weights : ndarray of float32, shape (H, W, 3)
        Barycentric coordinates in that triangle; NaN outside the map.
    origin : tuple of 2 floats
        Position (u, v) of the centre of pixel (0, 0), in mm.
    pixel_size : float
        Side length of a pixel, in mm.
    unit : str
        Unit of length, as in `Surface.metadata`.

    See Also
    --------
    FlatMap.raster : Return the pixels of a map.

    Examples
    --------
    >>> voxflat.samples.hill().flatten().raster(pixel_size=1.0)
    <Raster: 43 x 43 pixels of 1>
    """

    corners: NDArray[np.uint32]
    weights: NDArray[np.float32]
    origin: tuple[float, float]
    pixel_size: float
    unit: str = "mm"

    def __repr__(self) -> str:
        height, width = self.shape
        return f"<Raster: {width} x {height} pixels of {self.pixel_size:g}>"

    @property
    def shape(self) -> tuple[int, int]:
        """The number of rows and columns."""
        return (self.corners.shape[0], self.corners.shape[1])

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Mask of the pixels that lie on the map, shape (H, W).

        A pixel lies on the map if a triangle covers its centre.
        """
        return np.asarray(self.corners[..., 0] != _OUTSIDE)

    @property
    def nearest(self) -> NDArray[np.int64]:
        """The nearest of the map's points for each pixel, shape (H, W). Pixels outside the map have the value −1."""
        best = np.nan_to_num(self.weights, nan=-1.0).argmax(axis=2)
        nearest = np.take_along_axis(self.corners, best[..., None], axis=2)[..., 0].astype(np.int64)
        return np.where(self.inside, nearest, -1)

    def interpolate(self, values: NDArray[np.number]) -> NDArray[np.float64]:
        """Interpolate the values of the points at the pixels.

        Interpolation is linear within triangles.

        Parameters
        ----------
        values : ndarray, shape (N,) or (N, C)
            Values at the points.

        Returns
        -------
        ndarray of float64, shape (H, W) or (H, W, C)
            Values at the pixels; NaN outside the map.
        """
        values = numbers_of(values, "values", as_nan=True)
        image = np.zeros((*self.shape, *values.shape[1:]))
        each = (...,) + (None,) * (values.ndim - 1)
        for corner in (0, 2, 1) if values.size == len(values) else (0, 1, 2):  # the order (and bits) of np.einsum
            weights = self.weights[..., corner].astype(np.float64)[each]
            image += weights * values.take(self.corners[..., corner], axis=0, mode="clip")  # NaN outside the map
        return image


@dataclass(frozen=True, eq=False)
class FlatImage(ReadOnly, Saved):
    """An image on the flat map.

    `affine` and `extent` give its position on the map.

    Parameters
    ----------
    data : ndarray, shape (H, W), or (H, W, 4) uint8 for colours
        Values, with NaN outside the map; colours have alpha 0 there. Row 0 is at the top.
    pixel_size : float
        Side length of a pixel, in mm.
    origin : tuple of 2 floats
        Position (u, v) of the centre of pixel (0, 0), in mm.
    name : str
        Title, with the unit of the values.
    labels : bool or None
        Whether the values are labels, each with its own colour. If None, whole numbers that form areas are treated as
        labels.
    provenance : dict
        Record of how the image was made: the volume, the sampling, and the record of the map or atlas.
    unit : str
        Unit of length on the map; "unknown" if it is not defined. NIfTI files are in mm.

    See Also
    --------
    FlatMap.image : Show data on the map.

    Examples
    --------
    >>> flat_map = voxflat.samples.hill().flatten()
    >>> image = flat_map.image(flat_map.points[:, 2], pixel_size=1.0)
    >>> image
    <FlatImage: overlay, 43 x 43 pixels of 1>
    >>> image.data.shape
    (43, 43)
    """

    _kind = "an image"
    _endings = IMAGE_ENDINGS
    _formats = """
    ``.png`` is for viewing. It shows scalars in grey levels from the 1st to the 99th percentile, each label in its own
    colour, and colours unchanged; pixels outside the map are transparent. ``.tif``, ``.tiff``, ``.nii`` and
    ``.nii.gz`` are for measurements. They hold float32 values, with NaN outside the map, and the pixel size in mm.
    ``.npy`` holds the array. All formats except ``.npy`` include `provenance`.
    """

    data: NDArray[np.number]
    pixel_size: float
    origin: tuple[float, float]
    name: str
    labels: bool | None = None
    provenance: Record = field(default_factory=dict)
    unit: str = "mm"

    _used = ("pixel_size",)

    def __repr__(self) -> str:
        height, width = self.data.shape[:2]
        return f"<FlatImage: {self.name or 'no name'}, {width} x {height} pixels of {self.pixel_size:g}>"

    @property
    def is_colour(self) -> bool:
        """Whether the data are colours. Colours are red, green, blue and opacity."""
        return self.data.ndim == 3

    @property
    def is_labels(self) -> bool:
        """Whether the values are labels. If `labels` is None, whole numbers that form areas count as labels."""
        return are_labels(self.data) if self.labels is None else self.labels

    def colours(self, colour_map: str | None = None, limits: Sequence[float] | None = None) -> NDArray[np.uint8]:
        """Return the pixels as colours, as in a PNG.

        Pixels outside the map are transparent.

        Parameters
        ----------
        colour_map : str, optional
            A matplotlib colour map. By default, values are shown in grey levels, and each label has its own colour.
        limits : sequence of 2 floats, optional
            The values at the ends of the colour map; by default the 1st and 99th percentiles.

        Returns
        -------
        ndarray of uint8, shape (H, W, 4)
            Red, green, blue and opacity.

        Raises
        ------
        InputError
            If the colour map does not exist.
        """
        return coloured(self.data, colour_map, limits, labels=self.is_labels)

    @property
    def affine(self) -> NDArray[np.float64]:
        """The affine from (row, column, 0, 1) to (u, v, 0, 1) in mm, shape (4, 4).

        NIfTI files of the image contain it.
        """
        step = self.pixel_size
        u, v = self.origin
        return np.array([[0, step, 0, u], [-step, 0, 0, v], [0, 0, step, 0], [0, 0, 0, 1]], dtype=np.float64)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """The left, right, bottom and top edges in mm. They are in the order that matplotlib's imshow expects."""
        height, width = self.data.shape[:2]
        left, top = self.origin[0] - self.pixel_size / 2, self.origin[1] + self.pixel_size / 2
        return (left, left + width * self.pixel_size, top - height * self.pixel_size, top)

    def one_period(self, period: float | None) -> "FlatImage":
        """Return one period of the image of a periodic map, centred on v = 0.

        Copies of the result that are stacked vertically fit together without a seam. `FlatMap.regions` accepts label
        images that were drawn on it.

        Parameters
        ----------
        period : float
            The period of the map, from `FlatMap.period`. It must be a whole number of pixels, as it is by default.

        Returns
        -------
        FlatImage
            The image, with ``period / pixel_size`` rows. Pixels beyond the ends of the tube are outside the map.

        Raises
        ------
        InputError
            If the map is not periodic, or the period is not a whole number of pixels.

        Examples
        --------
        >>> tube = voxflat.surface(voxflat.samples.ball()).charts("cylinder")[0].flatten()
        >>> image = tube.image(voxflat.samples.ball()).one_period(tube.period)
        >>> len(image.data) == round(tube.period / image.pixel_size)
        True
        """
        if period is None:
            raise InputError("the map is not periodic. Use the chart 'cylinder' of Surface.charts")
        period = checked_number(period, "period")
        rows = rows_in(period, self.pixel_size)
        if not rows:
            problem = f"the period is {period / self.pixel_size:.6g} pixels, not a whole number"
            raise InputError(f"{problem}. Pass a pixel size of which it is a multiple, such as the default")
        blank, kind = (0, self.data.dtype) if self.is_colour else (np.nan, np.result_type(self.data, np.float32))
        whole = np.full((rows, *self.data.shape[1:]), blank, dtype=kind)
        for row, pixels in zip(rows_of_period(self, rows), self.data, strict=True):
            inside = pixels[:, 3] > 0 if self.is_colour else ~np.isnan(pixels)
            whole[row][inside] = pixels[inside]
        return replace(self, data=whole, origin=(self.origin[0], rows // 2 * self.pixel_size))

    def _write(self, path: Path) -> None:
        write_image(path, self, self.provenance)


def rows_in(period: float, pixel_size: float) -> int:
    """Return the number of pixels in a period, or 0 if it is not whole."""
    count = period / pixel_size
    return round(count) if math.isfinite(count) and abs(count - round(count)) <= _WHOLE * count else 0


def rows_of_period(image: FlatImage | Raster, rows: int) -> NDArray[np.int64]:
    """Return the row of a single period, with so many rows and its middle at v = 0, for each row of an image."""
    height = (image.data if isinstance(image, FlatImage) else image.corners).shape[0]
    first = round(image.origin[1] / image.pixel_size)
    return np.asarray((rows // 2 - first + np.arange(height)) % rows)


@dataclass(frozen=True, eq=False)
class FlatStack(Sequence[FlatImage], ReadOnly, SavedPages):
    """Images with the same pixels on a flat map, one for each channel or frame.

    Each image is sampled on demand.

    Parameters
    ----------
    channels : Channels
        Arrays as in `FlatImage.data`.
    pixel_size : float
        Side length of a pixel, in mm.
    origin : tuple of 2 floats
        Position (u, v) of the centre of pixel (0, 0), in mm.
    name : str
        Title.
    provenance : dict
        As in `FlatImage`.
    layers : tuple of str
        Names of the depths, if each channel is shown at several depths. All depths of the first channel come first.
    unit : str
        As in `FlatImage`.
    heights : tuple of float
        Height of each depth in mm, as given, or a fraction of the median thickness of the cortex. NIfTI files store
        the distance between evenly spaced depths.

    See Also
    --------
    FlatMap.images : Show several depths, maps or frames.

    Examples
    --------
    >>> frames = voxflat.samples.hill().flatten().images(np.arange(1764.0).reshape(441, 4), pixel_size=1.0)
    >>> len(frames)
    4
    """

    channels: Channels
    pixel_size: float
    origin: tuple[float, float]
    name: str
    provenance: Record = field(default_factory=dict)
    layers: tuple[str, ...] = ()
    unit: str = "mm"
    heights: tuple[float, ...] = ()

    _used = ("pixel_size",)

    def __len__(self) -> int:
        """Return the number of images."""
        return len(self.channels)

    def __repr__(self) -> str:
        images = f"{len(self)} image{'s' * (len(self) != 1)}"
        return f"<FlatStack: {self.name or 'no name'}, {images} ({self.channels.listed()})>"

    @property
    def names(self) -> tuple[str, ...]:
        """The name of each channel; empty if the channel has none. Images can be selected by name."""
        return self.channels.names

    @property
    def channel_names(self) -> tuple[str, ...]:
        """The name of each channel, without its depths. The names are empty if the channels have none."""
        if not self.layers:
            return self.names
        first = self.layers[0]
        return tuple(name.removesuffix(first).removesuffix(", ") for name in self.names[:: len(self.layers)])

    @property
    def timing(self) -> Timing | None:
        """The timing of the frames of a series. None if it is unknown, or if the images are not a series."""
        return self.channels.timing

    @property
    def times(self) -> NDArray[np.float64] | None:
        """The time of each frame of a series, in seconds. None if it is unknown, or if the images are not a series."""
        timing = self.timing
        if timing is None:
            return None
        count = len(self) // max(1, len(self.layers))
        return timing.start + timing.step * np.arange(count, dtype=np.float64)

    @property
    def data(self) -> NDArray[np.number]:
        """All images as one array.

        The axes are (depth, row, column), (channel, row, column) or (channel, depth, row, column). Colours have an
        additional last axis.
        """
        images = np.stack([self.channels.read(n) for n in range(len(self))])
        several = 0 < len(self.layers) < len(self)
        return images.reshape(-1, len(self.layers), *images.shape[1:]) if several else images

    def of_channel(self, channel: int) -> "FlatStack":
        """Return the images of one channel.

        Parameters
        ----------
        channel : int
            Number of the channel, from 0.

        Returns
        -------
        FlatStack
            The images of the channel.
        """
        if not is_whole(channel) or not 0 <= channel < len(self.channels) // max(1, len(self.layers)):
            raise InputError(f"channel is {shown(channel)}. Pass the number of a channel, counted from 0")
        each, all_names = max(1, len(self.layers)), self.channels
        first = channel * each
        names = all_names.names[first : first + each]
        return replace(self, channels=Channels(names, lambda n: all_names.read(first + n)))

    def percent_change(self, progress: Progress | None = None, *, nan_policy: str = "omit") -> "FlatStack":
        """Return the percent change of each pixel from its mean over the frames.

        All images are sampled once to compute the means.

        Parameters
        ----------
        progress : callable, optional
            Called as ``progress(stage, done, total)`` after each image. If it returns False, the work is cancelled.
        nan_policy : {"omit", "propagate"}
            What to do at pixels where some frames have no value: "omit" computes the mean of the other frames, and
            "propagate" makes these pixels NaN in all frames. In both cases, a warning counts them.

        Returns
        -------
        FlatStack
            The changes in percent; NaN where the mean is not positive, or the frame has no value.

        Raises
        ------
        InputError
            If the images are colours.
        Cancelled
            If `progress` returned False.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> len(flat_map.images(np.arange(1764.0).reshape(441, 4), pixel_size=1.0).percent_change())
        4
        """
        each, read = max(1, len(self.layers)), self.channels.read
        checked_choice(nan_policy, "nan_policy", NAN_POLICIES)
        total, count = np.zeros((2, each, *read(0).shape[:2]))
        for n in range(len(self)):
            data = read(n)
            if data.ndim != 2:
                raise InputError("cannot compute the percent change of colours. Pass images of values")
            known = np.isfinite(data)
            total[n % each][known] += data[known]
            count[n % each] += known
            if progress is not None and progress("averaging", n + 1, len(self)) is False:
                raise Cancelled("cancelled while averaging")
        frames = len(self) // each
        if some := int(np.count_nonzero(((count > 0) & (count < frames)).any(axis=0))):
            left = "The other frames determine their mean" if nan_policy == "omit" else "They have no mean"
            log.warning(
                "%s: %s pixels have no value in some of the %d frames. %s", self.name, f"{some:,}", frames, left
            )
        there = is_defined(count, frames, nan_policy) & (total > 0)
        means = np.divide(total, count, out=np.full(total.shape, np.nan), where=there)

        def change(n: int) -> NDArray[np.float64]:
            data = read(n)
            return np.asarray(100 * (np.where(np.isfinite(data), data, np.nan) / means[n % each] - 1))

        changes = replace(self.channels, read=change)
        return replace(self, channels=changes, name=f"{self.name}, change (%)")

    @overload
    def __getitem__(self, channel: int | str) -> FlatImage: ...

    @overload
    def __getitem__(self, channel: slice) -> list[FlatImage]: ...

    def __getitem__(self, channel: int | str | slice) -> FlatImage | list[FlatImage]:
        """Sample a channel, selected by number or name; raise an error if it does not exist."""
        if isinstance(channel, slice):
            return [self[n] for n in range(*channel.indices(len(self)))]
        if isinstance(channel, int) and channel >= len(self):
            raise IndexError(channel)
        n = self.channels.find(channel)
        name = ", ".join(part for part in (self.name, self.names[n]) if part)
        record = self.provenance
        if record:
            of, layer = divmod(n, len(self.layers)) if self.layers else (n, None)
            place = {"channel": of} if layer is None else {"channel": of, "layer": self.layers[layer]}
            recorded: Any = record["parameters"]
            record = {**record, "parameters": {**recorded, **place}}
        return FlatImage(self.channels.read(n), self.pixel_size, self.origin, name, provenance=record, unit=self.unit)

    @property
    def _pages(self) -> Pages:
        """The images and their axes, as files describe them."""
        is_series = self.timing is not None
        channels, frames = (("",), len(self) // max(1, len(self.layers))) if is_series else (self.channel_names, None)
        return Pages(self, self.names, channels, self.layers, self.heights, frames, self.timing, self.name)


def nearest_inside(raster: Raster) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the distance from each pixel to the nearest one on the map, in pixels, and its row and column, (2, H, W).

    The outline of the map cuts through pixels, so that places on the map can lie in pixels outside it.
    """
    away, nearest = scipy.ndimage.distance_transform_edt(~raster.inside, return_indices=True)
    return away, nearest


def some_pixels(raster: Raster, pixels: NDArray[np.int64]) -> Raster:
    """Return a raster of shape (P, 1) with some pixels of another, given by their numbers in row-major order."""
    corners = raster.corners.reshape(-1, 1, 3)[pixels]
    return replace(raster, corners=corners, weights=raster.weights.reshape(-1, 1, 3)[pixels])


def at_points(count: int) -> Raster:
    """Return a raster with one pixel at each point of a map, shape (N, 1)."""
    corners = np.repeat(np.arange(count, dtype=np.uint32), 3).reshape(-1, 1, 3)
    weights = np.broadcast_to(np.array([1, 0, 0], dtype=np.float32), corners.shape)
    return Raster(corners, weights, (0.0, 0.0), 1.0)
