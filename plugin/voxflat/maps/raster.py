"""The flat map as an image: pixels in mm, what they show, and where they come from."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from voxflat import _core
from voxflat.arguments import Progress, checked_choice, is_whole, numbers_of, shown
from voxflat.errors import Cancelled, InputError
from voxflat.io.channels import Channels, Timing
from voxflat.io.provenance import Record, Recorded, saving
from voxflat.maps.colours import are_labels, coloured
from voxflat.maps.image_files import write_image, write_stack
from voxflat.maps.sampling import INTERPOLATIONS, Mixing, majority

_OUTSIDE = np.uint32(2**32 - 1)


@dataclass(frozen=True, eq=False)
class Raster:
    """The pixels of a flat map and the inverse look-up: pixel → surface voxel → RAS+ mm.

    Row 0 is at the top of the map (largest v), column 0 at its left (smallest u).

    Examples
    --------
    >>> flat_map = voxflat.samples.hill().flatten()
    >>> flat_map.raster(pixel_size=1.0)
    <Raster: 43 x 43 pixels of 1>
    """

    corners: NDArray[np.uint32]  # (H, W, 3), the map's points whose triangle covers the pixel's centre; 2³² − 1 outside
    weights: NDArray[np.float32]  # (H, W, 3), barycentric coordinates in it; NaN outside the map
    origin: tuple[float, float]  # (u, v) of the centre of pixel (0, 0), mm
    pixel_size: float  # mm
    unit: str = "mm"  # of lengths, as `Surface.metadata` has it

    def __repr__(self) -> str:
        height, width = self.shape
        return f"<Raster: {width} x {height} pixels of {self.pixel_size:g}>"

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns."""
        return (self.corners.shape[0], self.corners.shape[1])

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Pixels that lie on the map, shape (H, W)."""
        return np.asarray(self.corners[..., 0] != _OUTSIDE)

    @property
    def nearest(self) -> NDArray[np.int64]:
        """For each pixel the number of the map's point nearest to it, shape (H, W); −1 outside the map."""
        best = np.nan_to_num(self.weights, nan=-1.0).argmax(axis=2)
        nearest = np.take_along_axis(self.corners, best[..., None], axis=2)[..., 0].astype(np.int64)
        return np.where(self.inside, nearest, -1)

    def interpolate(self, values: NDArray[Any]) -> NDArray[np.float64]:
        """Carry values of the points, (N,) or (N, C), to the pixels, linearly within triangles; NaN outside the map.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> flat_map.raster(pixel_size=1.0).interpolate(flat_map.points[:, 2]).shape
        (43, 43)
        """
        values = numbers_of(values, "values")
        image = np.zeros((*self.shape, *values.shape[1:]))
        each = (...,) + (None,) * (values.ndim - 1)
        for corner in (0, 2, 1) if values.size == len(values) else (0, 1, 2):  # np.einsum's order, and so its bits
            weights = self.weights[..., corner].astype(np.float64)[each]
            image += weights * values.take(self.corners[..., corner], axis=0, mode="clip")  # outside weights are NaN
        return image


@dataclass(frozen=True, eq=False)
class FlatImage(Recorded):
    """An image on the flat map.

    Parameters
    ----------
    data : ndarray, shape (H, W), or (H, W, 4) uint8 for colours
        Values, NaN outside the map; colours have alpha 0 there. Row 0 is at the top.
    pixel_size : float
        Side of a pixel, mm.
    origin : tuple of 2 floats
        (u, v) of the centre of pixel (0, 0), mm.
    name : str
        What it shows, with its unit.
    labels : bool or None
        Whether the values are labels, each with a colour of its own; None: where they look so, as whole numbers that
        form areas.
    provenance : dict
        What made it: the volume and how it was sampled, and the record of the map or atlas.
    unit : str
        Of lengths on the map: that of the surface, "unknown" if nothing tells. Files have mm, or no unit.

    Examples
    --------
    >>> flat_map = voxflat.samples.hill().flatten()
    >>> image = flat_map.image(flat_map.points[:, 2], pixel_size=1.0)
    >>> image
    <FlatImage: overlay, 43 x 43 pixels of 1>
    >>> image.data.shape
    (43, 43)
    """

    data: NDArray[Any]
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
        """Whether the data are colours."""
        return self.data.ndim == 3

    @property
    def is_labels(self) -> bool:
        """Whether the values are labels, or look so."""
        return are_labels(self.data) if self.labels is None else self.labels

    def colours(self, colour_map: str | None = None, limits: Sequence[float] | None = None) -> NDArray[np.uint8]:
        """Return the pixels as colours, as in a PNG.

        Parameters
        ----------
        colour_map : str, optional
            A colour map of matplotlib for values; by default grey, and for labels a colour each.
        limits : sequence of 2 floats, optional
            The values at the ends of the colour map; by default the 1st and 99th percentile.

        Returns
        -------
        ndarray of uint8, shape (H, W, 4)
            Opacity 0 outside the map.

        Raises
        ------
        InputError
            If there is no such colour map.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> image = flat_map.image(flat_map.points[:, 2], pixel_size=1.0)
        >>> image.colours().dtype
        dtype('uint8')
        """
        return coloured(self.data, colour_map, limits, labels=self.is_labels)

    @property
    def affine(self) -> NDArray[np.float64]:
        """From (row, column, 0, 1) to (u, v, 0, 1) in mm, shape (4, 4)."""
        step = self.pixel_size
        u, v = self.origin
        return np.array([[0, step, 0, u], [-step, 0, 0, v], [0, 0, step, 0], [0, 0, 0, 1]], dtype=np.float64)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top edge in mm, as matplotlib's imshow takes them."""
        height, width = self.data.shape[:2]
        left, top = self.origin[0] - self.pixel_size / 2, self.origin[1] + self.pixel_size / 2
        return (left, left + width * self.pixel_size, top - height * self.pixel_size, top)

    def save(self, path: str | os.PathLike[str], *, sidecar: bool = False, overwrite: bool = False) -> None:
        """Save the image, all of it or nothing.

        Parameters
        ----------
        path : path
            ``.png`` to look at: scalars in grey from the 1st to the 99th percentile, labels each in its own colour,
            colours as they are, transparent outside the map. ``.tif``, ``.tiff``, ``.nii`` or ``.nii.gz`` to measure:
            the values as float32, NaN outside the map, with the pixel size in mm. ``.npy``: the array as it is.
            All but ``.npy`` hold `provenance`.
        sidecar : bool
            Write `provenance` to ``<path>.json``, too.
        overwrite : bool
            Replace a file of that name that voxflat did not write.

        Raises
        ------
        InputError
            If the ending is another, the values do not fit, or it is a file that was read.
        OSError
            If the file cannot be written.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> image = flat_map.image(flat_map.points[:, 2], pixel_size=1.0)
        >>> image.save("heights.tif")
        """
        with saving(path, self.provenance, sidecar=sidecar, overwrite=overwrite):
            write_image(
                path, self.data, self.affine, self.name, labels=self.is_labels, record=self.provenance, unit=self.unit
            )


@dataclass(frozen=True, eq=False)
class FlatStack(Sequence[FlatImage], Recorded):
    """Images on the same pixels of a flat map, one a channel or frame: each is sampled when it is asked for.

    Parameters
    ----------
    channels : Channels
        Arrays as in `FlatImage.data`.
    pixel_size : float
        Side of a pixel, mm.
    origin : tuple of 2 floats
        (u, v) of the centre of pixel (0, 0), mm.
    name : str
        What they show.
    provenance : dict
        As of `FlatImage`.
    layers : tuple of str
        The names of the depths, where each channel is shown at several: all those of the first channel come first.
    unit : str
        As of `FlatImage`.

    Examples
    --------
    >>> flat_map = voxflat.samples.hill().flatten()
    >>> frames = flat_map.images(np.arange(1764.0).reshape(441, 4), pixel_size=1.0)
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

    _used = ("pixel_size",)

    def __len__(self) -> int:
        """Return the number of images."""
        return len(self.channels)

    def __repr__(self) -> str:
        return f"<FlatStack: {self.name or 'no name'}, {len(self)} images ({self.channels.listed()})>"

    @property
    def names(self) -> tuple[str, ...]:
        """The name of each channel, empty where it has none."""
        return self.channels.names

    @property
    def timing(self) -> Timing | None:
        """When the frames of a series were; None where that is not known, or they are no series."""
        return self.channels.timing

    @property
    def times(self) -> NDArray[np.float64] | None:
        """When each frame of a series was, s; None where that is not known, or they are no series."""
        timing = self.timing
        if timing is None:
            return None
        count = len(self) // max(1, len(self.layers))
        return timing.start + timing.step * np.arange(count, dtype=np.float64)

    @property
    def data(self) -> NDArray[Any]:
        """All images as one array: (depth, row, column), (channel, row, column), or (channel, depth, row, column).

        Colours have one more axis, the last.
        """
        images = np.stack([self.channels.read(n) for n in range(len(self))])
        several = 0 < len(self.layers) < len(self)
        return images.reshape(-1, len(self.layers), *images.shape[1:]) if several else images

    def of_channel(self, channel: int) -> "FlatStack":
        """Return the images of one channel: one, or one a depth.

        Parameters
        ----------
        channel : int
            Its number, from 0.

        Returns
        -------
        FlatStack

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> frames = flat_map.images(np.arange(1764.0).reshape(441, 4), pixel_size=1.0)
        >>> frames.of_channel(2)
        <FlatStack: overlay, 1 images (0 to 0)>
        """
        if not is_whole(channel) or not 0 <= channel < len(self.channels) // max(1, len(self.layers)):
            raise InputError(f"channel is {shown(channel)}. Pass the number of a channel, counted from 0.")
        each, all_names = max(1, len(self.layers)), self.channels
        first = channel * each
        names = all_names.names[first : first + each]
        return replace(self, channels=Channels(names, lambda n: all_names.read(first + n)))

    def percent_change(self, progress: Progress | None = None) -> "FlatStack":
        """Return how far each pixel is from its mean over the frames, in % of that mean: of raw signals what changes.

        Parameters
        ----------
        progress : callable, optional
            Called as ``progress(stage, done, total)`` after each image, for all are sampled once to find the means; if
            it returns False the work is cancelled.

        Returns
        -------
        FlatStack
            NaN where the mean is not positive, or a frame has no value.

        Raises
        ------
        InputError
            If these are colours.
        Cancelled
            If `progress` returned False.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> frames = flat_map.images(np.arange(1764.0).reshape(441, 4), pixel_size=1.0)
        >>> len(frames.percent_change())
        4
        """
        each = max(1, len(self.layers))
        total: list[Any] = [0.0] * each
        for n in range(len(self)):
            data = self.channels.read(n)
            if data.ndim != 2:
                raise InputError("Cannot compute the percent change of colours. Pass images of values.")
            total[n % each] = total[n % each] + data
            if progress is not None and progress("averaging", n + 1, len(self)) is False:
                raise Cancelled("Cancelled while averaging.")
        means = [np.where(of > 0, of * (each / len(self)), np.nan) for of in total]
        read = self.channels.read
        changes = replace(self.channels, read=lambda n: 100 * (read(n) / means[n % each] - 1))
        return replace(self, channels=changes, name=f"{self.name}, change (%)")

    @overload
    def __getitem__(self, channel: int | str) -> FlatImage: ...

    @overload
    def __getitem__(self, channel: slice) -> list[FlatImage]: ...

    def __getitem__(self, channel: int | str | slice) -> FlatImage | list[FlatImage]:
        """Sample a channel, by its number or its name; `InputError`, which ends a loop, if there is none such."""
        if isinstance(channel, slice):
            return [self[n] for n in range(*channel.indices(len(self)))]
        if isinstance(channel, int) and channel >= len(self):
            raise IndexError(channel)
        n = self.channels.find(channel)
        name = ", ".join(part for part in (self.name, self.names[n]) if part)
        record = self.provenance
        if record:
            of, layer = divmod(n, len(self.layers)) if self.layers else (n, None)
            own = {"channel": of} if layer is None else {"channel": of, "layer": self.layers[layer]}
            record = {**record, "parameters": {**record["parameters"], **own}}
        return FlatImage(self.channels.read(n), self.pixel_size, self.origin, name, provenance=record, unit=self.unit)

    def save(
        self,
        path: str | os.PathLike[str],
        *,
        sidecar: bool = False,
        overwrite: bool = False,
        progress: Progress | None = None,
    ) -> None:
        """Save all images to one file, one after the other, all of it or nothing.

        Parameters
        ----------
        path : path
            ``.tif``, ``.tiff``: a page each, described as OME-TIFF. ``.nii``, ``.nii.gz``: (H, W, D, K) of K channels
            at D depths, the names in a header extension (JSON). ``.zarr``: OME-Zarr 0.4, a new directory with a chunk
            for each image, y = −v and x = u. All of these have the pixel size in mm and, of a series, the time from
            frame to frame in s. ``.npy``: (K, H, W), (D, H, W) or (K, D, H, W), without names. The values are float32,
            NaN outside the map. All but ``.npy`` hold `provenance`. Images are sampled and written one by one.
        sidecar, overwrite
            As of `FlatImage.save`; a directory is never replaced.
        progress : callable, optional
            Called as ``progress(stage, done, total)`` after each image; if it returns False nothing is written.

        Raises
        ------
        InputError
            If the ending is another, as of ``.png``, which holds one image; the values do not fit; or it is a file that
            was read.
        Cancelled
            If `progress` returned False.
        OSError
            If the file cannot be written.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> frames = flat_map.images(np.arange(1764.0).reshape(441, 4), pixel_size=1.0)
        >>> frames.save("frames.nii.gz")
        """
        with saving(path, self.provenance, sidecar=sidecar, overwrite=overwrite):
            write_stack(path, self, self.provenance, progress)


def show(raster: Raster, values: NDArray[Any], interpolation: str | None) -> NDArray[np.float64]:
    """Carry an overlay's values to the pixels: whole numbers, which may be labels, usually from the nearest point."""
    way = _way(values, interpolation)
    if way == "linear":
        return raster.interpolate(values)
    if way == "majority":
        inside, found = raster.inside, np.full(raster.shape, np.nan)
        found[inside] = majority(values[raster.corners[inside]], raster.weights[inside])
        return found
    nearest = raster.nearest
    return np.where(nearest >= 0, values[nearest], np.nan)


def series_showing(
    raster: Raster, ids: NDArray[np.int64], interpolation: str | None
) -> Callable[[NDArray[Any]], NDArray[np.float64]]:
    """Return `show` for overlays that follow each other, with weights found once; `ids` are the points' vertices."""
    held: dict[str, Mixing] = {}

    def shown(values: NDArray[Any]) -> NDArray[np.float64]:
        way = _way(values, interpolation)
        if way == "majority":
            return show(raster, values[ids], way)
        if way not in held:
            inside = raster.inside
            if way == "linear":
                numbers, weights = ids[raster.corners[inside]], raster.weights[inside].astype(np.float64)
            else:
                numbers = ids[raster.nearest[inside]][:, None]
                weights = np.ones(numbers.shape)
            held[way] = Mixing.of(inside, len(values), weights.shape[1], lambda part: (numbers[part], weights[part]))
        return held[way](values)

    return shown


def _way(values: NDArray[Any], interpolation: str | None) -> str:
    """Return how values at points come to the pixels."""
    if interpolation is None:
        return "nearest" if values.dtype.kind in "biu" else "linear"
    return checked_choice(interpolation, "interpolation", INTERPOLATIONS)


def draw(uv: NDArray[np.float64], faces: NDArray[np.uint32], torn: NDArray[np.bool_], pixel_size: float) -> Raster:
    """Draw a flat map's faces; pixels of torn ones, without a surface in between, show the nearest corner."""
    corners, weights, origin = _core.draw(uv, faces, torn, float(pixel_size))
    return Raster(corners, weights, (origin[0], origin[1]), float(pixel_size))
