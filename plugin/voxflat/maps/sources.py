"""The data that a map shows: a volume, values at the vertices or a texture, sampled at the pixels of a raster."""

import math
import os
import re
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import array_of, checked_number, checked_text, log, shown
from voxflat.errors import InputError
from voxflat.io.channels import Channels, LastKept, Timing, series_of
from voxflat.io.chunks import Chunked, chunked_of, is_chunked, is_stack_path, is_zarr_path
from voxflat.io.files import REMEDY, naming
from voxflat.io.grid import Affine, is_incomplete
from voxflat.io.objects import values_of_object
from voxflat.io.overlays import holds_volume, read_channels
from voxflat.io.partners import check_participant, check_partner
from voxflat.io.volumes import Volume
from voxflat.maps.depth import ON_SURFACE, Depths
from voxflat.maps.raster import FlatImage, FlatStack, Raster, some_pixels
from voxflat.maps.sampling import (
    Coverage,
    Mixing,
    Sampling,
    SharedWeights,
    are_intensities,
    majority,
    sample_depths,
    sample_phases,
    voxels_of,
    way_of,
)
from voxflat.maps.surface_points import SurfacePoints
from voxflat.maps.textures.surface_texture import TEXTURE_ENDINGS, SurfaceTexture, are_colours, paint, read_texture
from voxflat.maps.volume_place import check_overlap, in_map_unit, own_affine, placed, warn_of_position, warn_of_space

_Sampler: TypeAlias = Callable[[int], NDArray[Any]]  # of a channel, from its number

_BATCH = 1 << 21  # positions that are sampled at a time in a large volume or at many pixels
_RUNS, _JUDGED = 16, 8192  # runs of neighbouring pixels, and positions in them, that tell intensities from labels
_LONGEST_STEP = 100.0  # s; a warning reports longer time steps, which may be in ms
_CURVED = 0.15  # correlation with the mean curvature: on fsaverage5 curv has 0.9, sulc 0.65, the other hemisphere 0.05


@dataclass(frozen=True, eq=False)
class Source(ABC):
    """Data that a map can show, as one or several channels."""

    surface: SurfacePoints
    channels: Channels
    path: Path | None  # of the file
    called: str | Path  # in messages
    _untitled: ClassVar[str] = "overlay"  # title of images of other data than files

    @abstractmethod
    def _sampler(self, raster: Raster, sampling: Sampling, title: str, *, is_series: bool) -> _Sampler:
        """Return a function that samples a channel at pixels: one image, or several depths along the first axis."""

    def number(self, channel: int | str | None) -> int:
        """Return the number of a channel."""
        with naming(self.called, REMEDY):
            return self.channels.find(channel)

    def image(
        self, raster: Raster, sampling: Sampling, *, channel: int | str | None = None, name: str = ""
    ) -> FlatImage:
        """Return one channel at the pixels of a raster, as `FlatMap.image` does."""
        image = self.stack(raster, sampling, name=name, shares_weights=False)[self.number(channel)]
        return replace(image, name=name) if name else image

    def stack(
        self,
        raster: Raster,
        sampling: Sampling,
        *,
        channel: int | str | None = None,
        name: str = "",
        time_step: float | None = None,
        shares_weights: bool = True,
    ) -> FlatStack:
        """Return all channels, or one of them, as `FlatMap.images` does; shared weights are faster and round more."""
        details: dict[str, Any] = {"unit": raster.unit}
        title = checked_text(name, "name") or (self.path.name if self.path else self._untitled)
        is_series = shares_weights and len(self.channels) > 1
        sample = LastKept(self._sampler(raster, sampling, title, is_series=is_series))
        channels = replace(self.channels, read=sample)
        if sampling.projection is None:
            layers = sampling.depths.names(self.surface.origin.named_unit)
            names = [", ".join(filter(None, (name, layer))) for name in self.channels.names for layer in layers]
            channels = Channels(tuple(names), lambda n: sample(n // len(layers))[n % len(layers)], channels.timing)
            details |= {"layers": layers, "heights": self.surface.heights(sampling.depths)}
        if time_step is not None and (channel is not None or len(self.channels) == 1):
            raise InputError(f"time_step is {shown(time_step)}, but there is only one image. Omit it")
        stack = FlatStack(_timed(channels, time_step, title), raster.pixel_size, raster.origin, title, **details)
        return stack if channel is None else stack.of_channel(self.number(channel))


@dataclass(frozen=True, eq=False)
class Texture(Source):
    """The texture of a mesh, or colours at its vertices."""

    texture: SurfaceTexture | NDArray[np.uint8]

    def _sampler(self, raster: Raster, sampling: Sampling, title: str, *, is_series: bool) -> _Sampler:
        if sampling.depths != ON_SURFACE or sampling.interpolation is not None:
            raise InputError("depth, fraction, interpolation and period do not apply to textures. Omit them")
        colours = paint(self.texture, raster, self.surface.ids)
        return lambda _: colours


@dataclass(frozen=True, eq=False)
class VertexValues(Source):
    """Values at the vertices of a mesh."""

    def _sampler(self, raster: Raster, sampling: Sampling, title: str, *, is_series: bool) -> _Sampler:
        if self.path is not None:
            check_partner(self.path, self.surface.origin)
            if self.surface.is_known:
                self._check_folds(self.path)
        if sampling.depths != ON_SURFACE:
            raise InputError("an overlay has values only on the surface. Omit depth and fraction")
        ids = self.surface.ids
        mixing = cache(partial(_mixing, raster, ids, self.surface.origin.mesh.vertices))

        def at_pixels(values: NDArray[Any]) -> NDArray[Any]:
            way = way_of(values, sampling.interpolation)
            return mixing(way)(values) if is_series and way != "majority" else _shown(raster, values[ids], way)

        def sample(n: int) -> NDArray[Any]:
            values = self.channels.read(n)
            return at_pixels(values) if sampling.period is None else sample_phases(at_pixels, values, sampling)

        return sample

    def _check_folds(self, path: Path) -> None:
        """Warn if folds in a file match the curvature poorly, which suggests that it belongs to another surface."""
        if not re.search(r"(^|[._-])(curv|sulc)([._]|$)", path.name) or (values := self.channels.read(0)).ndim != 1:
            return
        if abs(correlation := self._correlation_with_curvature(values)) < _CURVED:
            log.warning(
                "%s does not follow the folds of the surface: its correlation with the curvature is %.2f (usually "
                "0.6 to 0.9). Check that it belongs to this surface",
                path.name,
                correlation,
            )

    def _correlation_with_curvature(self, values: NDArray[Any]) -> float:
        """Return the correlation of values at the vertices with the mean curvature; NaN if either is constant."""
        points, normals, ids, faces = (getattr(self.surface, name) for name in ("points", "normals", "ids", "faces"))
        ends = np.concatenate([faces, faces[:, ::-1]])[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        steps = points[ends[:, 1]] - points[ends[:, 0]]
        with np.errstate(all="ignore"):
            bend = (normals[ends[:, 0]] * steps).sum(axis=1) / (steps**2).sum(axis=1)
        vertices, is_known = ids[ends[:, 0]], np.isfinite(bend)
        count = np.bincount(vertices[is_known], minlength=len(values))
        seen = np.flatnonzero(count)
        curvature = (np.bincount(vertices[is_known], bend[is_known], len(values)) / np.maximum(count, 1))[seen]
        with np.errstate(all="ignore"):
            return float(np.corrcoef(curvature, values[seen].astype(np.float64))[0, 1])


def _shown(raster: Raster, values: NDArray[Any], way: str) -> NDArray[np.float64]:
    """Return values at the points of a map at its pixels."""
    if way == "linear":
        return raster.interpolate(values)
    if way == "majority":
        inside, image = raster.inside, np.full(raster.shape, np.nan)
        image[inside] = majority(values[raster.corners[inside]], raster.weights[inside])
        return image
    nearest = raster.nearest
    return np.where(nearest >= 0, values[nearest], np.nan)


def _mixing(raster: Raster, ids: NDArray[np.int64], count: int, way: str) -> Mixing:
    """Return the weights of values at the vertices for each pixel; `ids` are the vertices of the map's points."""
    inside = raster.inside
    if way == "linear":
        numbers, weights = ids[raster.corners[inside]], raster.weights[inside].astype(np.float64)
    else:
        numbers = ids[raster.nearest[inside]][:, None]
        weights = np.ones(numbers.shape)
    return Mixing.of(inside, count, weights.shape[1], lambda part: (numbers[part], weights[part]))


@dataclass(frozen=True, eq=False)
class VolumeSource(Source):
    """A volume, or several volumes on the same grid, such as the frames of a series."""

    affine: Affine | None = None  # of all channels, in the unit of the map; None for an array, which has none
    single: Volume | None = None  # the only channel of a volume in memory
    _untitled = "volume"

    @classmethod
    def of(cls, surface: SurfacePoints, data: object) -> "VolumeSource":
        """Return a file, an array or an object with voxels as a source; channels are read on demand."""
        path, called = _named(data)
        affine: Affine | None = None
        single: Volume | None = None
        with naming(called, REMEDY):
            chunks = chunked_of(data.data if isinstance(data, Volume) else data)
            series = series_of(path or data) if chunks is None else None
        if chunks is not None:
            channels, affine, unit = chunks
            if isinstance(data, Volume):
                affine, unit, path = data.affine if data.is_placed else None, data.unit, data.path
            if affine is None or is_incomplete(affine):
                affine = own_affine(surface, channels.read(0).shape)
            else:
                affine = in_map_unit(surface, affine, unit)
        elif series is not None:
            channels, affine = series
            warn_of_position(surface, affine, path)
            affine = in_map_unit(surface, affine, "mm")
        elif isinstance(data, np.ndarray) and data.ndim == 4 and data.dtype != np.uint8 and data.shape[3] > 1:
            channels = Channels(("",) * data.shape[3], lambda n: data[..., n])
        else:
            whole = single = placed(surface, data)
            if whole.is_vectors:
                raise InputError("the volume holds vectors, which have no image. Pass one of their components")
            channels, path = Channels(("",), lambda _: whole.data), whole.path
            warn_of_position(surface, whole.affine, path)
        return cls(surface, channels, path, called, affine, single)

    def volume(self, n: int) -> Volume:
        """Return a channel with its affine, in the unit of the map."""
        if self.single is not None:
            return self.single
        voxels = self.channels.read(n)
        return placed(self.surface, voxels) if self.affine is None else Volume(voxels, self.affine, self.path)

    def default_interpolation(self, raster: Raster, depths: Depths, n: int) -> str | None:
        """Return the interpolation of a channel of integers, which may be intensities or labels; otherwise None."""
        volume = self.volume(n)
        if not is_stack_path(volume.path) or volume.data.ndim != 3 or volume.data.dtype.kind not in "iu":
            return None
        pixels = np.flatnonzero(raster.inside)
        starts = np.linspace(0, len(pixels), _RUNS, endpoint=False, dtype=np.int64)
        run = starts[:, None] + np.arange(max(1, _JUDGED // (_RUNS * len(depths))))
        part = pixels[np.unique(np.minimum(run, len(pixels) - 1))]
        places = np.concatenate(self.surface.in_scanner(some_pixels(raster, part), depths)).reshape(-1, 3)
        if are_intensities(volume, places):
            return "linear"
        channel = f" of channel {name}" if (name := self.channels.names[n]) else ""
        if (volume.path, channel) not in self.surface.label_channels:
            self.surface.label_channels.add((volume.path, channel))
            text = f"{Path(str(volume.path)).name}: the integers{channel} form areas, so they are sampled as labels"
            log.warning("%s. Use interpolation 'linear' otherwise", text)
        return "nearest"

    def _sampler(self, raster: Raster, sampling: Sampling, title: str, *, is_series: bool) -> _Sampler:
        check_participant(self.path, self.surface.origin.input)
        warn_of_space(self.surface)
        if sampling.depths.layering is not None:
            self.surface.at(sampling.depths)
        elif any(sampling.depths.values):
            self.surface.directions(sampling.depths)
        return _VolumeSampler(self, raster, sampling, title, is_series)


@dataclass(eq=False)
class _VolumeSampler:
    """Sample channels of a volume at pixels; the first channel is checked, and determines warnings."""

    source: VolumeSource
    raster: Raster
    sampling: Sampling
    title: str
    is_series: bool
    is_checked: bool = False
    has_warned: bool = False

    def __call__(self, n: int) -> NDArray[Any]:
        volume, raster, sampling = self.source.volume(n), self.raster, self.sampling
        if not self.is_checked:  # all channels have the same place
            check_overlap(self.source.surface, volume, sampling.depths, self.title)
            self.is_checked = True
        if sampling.interpolation is None:
            default = sampling.default or (lambda n: self.source.default_interpolation(raster, sampling.depths, n))
            sampling = replace(sampling, interpolation=default(n))
        if sampling.period is None:
            return self._sampled(volume, sampling)
        if volume.data.ndim != 3:
            raise InputError("period is given, but the volume has colours. Pass a volume of phases")
        return sample_phases(lambda data: self._sampled(replace(volume, data=data), sampling), volume.data, sampling)

    @cached_property
    def _shared(self) -> SharedWeights:
        return SharedWeights(self.source.surface.in_scanner(self.raster, self.sampling.depths))

    def _sampled(self, volume: Volume, sampling: Sampling) -> NDArray[Any]:
        """Sample a volume at all pixels, and warn of those without a value at some of the depths."""
        coverage, count = Coverage(), len(sampling.depths)
        is_large = isinstance(volume.data, Chunked) or count * math.prod(self.raster.shape) > _BATCH
        if is_large and volume.data.ndim == 3:
            image = self._in_batches(volume, sampling, coverage)
        elif self.is_series:
            image = self._shared.sample(volume, sampling, coverage)
        else:
            places = self.source.surface.in_scanner(self.raster, sampling.depths)
            image = sample_depths(volume, places, sampling, coverage)
        if coverage.some and not self.has_warned:
            is_strict = sampling.projection == "sum" or sampling.nan_policy == "propagate"
            left = f"They have no {sampling.projection}" if is_strict else "The other depths determine their values"
            message = (
                "%s: %s of %s pixels have no value at some of the %d depths (NaN, infinite, or outside the volume). %s"
            )
            log.warning(message, self.title, f"{coverage.some:,}", f"{coverage.any:,}", count, left)
            self.has_warned = True
        return image

    def _in_batches(self, volume: Volume, sampling: Sampling, coverage: Coverage) -> NDArray[np.float64]:
        """Sample a volume at pixels of a few chunks at a time, so that memory never holds all voxels or positions."""
        raster, depths, in_scanner = self.raster, sampling.depths, self.source.surface.in_scanner
        pixels = np.flatnonzero(raster.inside)
        if isinstance(volume.data, Chunked):
            near = in_scanner(some_pixels(raster, pixels), ON_SURFACE)[0][:, 0]
            pixels = pixels[np.argsort(volume.data.chunk_of(voxels_of(volume, near)), kind="stable")]
        image = np.full((*(() if sampling.projection else (len(depths),)), math.prod(raster.shape)), np.nan)
        for part in np.array_split(pixels, 1 + len(pixels) * len(depths) // _BATCH):
            places = in_scanner(some_pixels(raster, part), depths)
            image[..., part] = sample_depths(volume, places, sampling, coverage)[..., 0]
        return image.reshape(*image.shape[:-1], *raster.shape)


def source_of(surface: SurfacePoints, data: object) -> Source:
    """Return a file, an array or an object as a source of values for a map."""
    path, called = _named(data)
    if not surface.origin.is_voxels:
        count, texture = surface.origin.mesh.vertices, None
        if path is not None and path.name.lower().endswith(TEXTURE_ENDINGS):
            check_partner(path, surface.origin)
            texture = read_texture(path, count)
        elif are_colours(data, count):
            texture = array_of(data, "colours")
        if texture is not None:
            colours = texture if isinstance(texture, np.ndarray) else texture.picture
            return Texture(surface, Channels(("",), lambda _: colours), path, called, texture)
        if (channels := vertex_channels(surface, data)) is not None:
            return VertexValues(surface, channels, path, called)
    return VolumeSource.of(surface, data)


def _named(data: object) -> tuple[Path | None, str | Path]:
    """Return the path of a file, and what messages call the data."""
    path = Path(data) if isinstance(data, str | os.PathLike) else None
    return path, path or type(data).__name__


def vertex_channels(surface: SurfacePoints, data: object) -> Channels | None:
    """Return values at the vertices of a mesh, which have no depth; None if the data are something else."""
    if surface.origin.is_voxels or is_chunked(data):
        return None
    count, structure = surface.origin.mesh.vertices, surface.origin.structure
    if isinstance(data, str | os.PathLike):
        if is_zarr_path(data) or holds_volume(data):
            return None
        return read_channels(data, count, structure=structure)
    is_array = isinstance(data, list) or hasattr(data, "__array__")  # includes a pandas Series
    is_array = is_array and not hasattr(data, "dataobj")
    if is_array and (values := array_of(data, "overlay's values", as_nan=True)).ndim in (1, 2):
        if len(values) != count:
            is_of_points = len(values) == len(surface.ids)  # such as distances in a part of the mesh
            each = ", one for each point of the map," if is_of_points else ","
            remedy = "Assign them to the map's ids first" if is_of_points else "Pass one value for each"
            raise InputError(f"the overlay has {len(values)} values{each} but the mesh has {count} vertices. {remedy}")
        return Channels.of_array(values)
    return values_of_object(data, count, structure)


def timing_of(step: float) -> Timing:
    """Return the times of frames with the given time step."""
    timing = Timing.told(checked_number(step, "time step"))
    if timing is None:
        raise InputError(f"time_step is {step:g}. Pass the time between frames, in seconds")
    return timing


def _timed(channels: Channels, step: float | None, name: str) -> Channels:
    """Return channels with the given time step, or with the time step of their file."""
    if step is not None:
        return replace(channels, timing=timing_of(step))
    if channels.timing is not None and channels.timing.step > _LONGEST_STEP:
        message = (
            "the header of %s gives a time step of %g s, which may be in milliseconds. Pass the time step in seconds"
        )
        log.warning(message, name, channels.timing.step)
    return channels
