"""Compute the values of a flat image's pixels: a volume, an overlay or a texture at their positions on the surface."""

import math
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import array_of, checked_choice, checked_number, checked_text, log
from voxflat.errors import InputError
from voxflat.io.channels import Channels, Timing, series_of
from voxflat.io.chunks import Chunked, chunked_of, is_chunked, is_stack_path, is_zarr_path
from voxflat.io.files import REMEDY, naming
from voxflat.io.grid import is_incomplete, scaled, voxel_size
from voxflat.io.objects import values_of_object
from voxflat.io.origin import Origin
from voxflat.io.overlays import holds_volume, read_channels
from voxflat.io.partners import check_participant, check_partner
from voxflat.io.readers import has_place
from voxflat.io.sources import volume_of
from voxflat.io.spaces import Space
from voxflat.io.volumes import Volume
from voxflat.maps.depth import ON_SURFACE, Depths, equivolume, smooth_areas, uncrossed, vertex_areas
from voxflat.maps.raster import FlatImage, FlatStack, Raster, series_showing, show, some_pixels
from voxflat.maps.sampling import (
    INTERPOLATIONS,
    PROJECTIONS,
    Coverage,
    are_intensities,
    phases,
    sampled_at,
    series_sampling,
    voxels_of,
)
from voxflat.maps.textures.surface_texture import TEXTURE_ENDINGS, SurfaceTexture, are_colours, paint, read_texture
from voxflat.unique_rows import distinct

_BATCH = 1 << 21  # positions that are sampled at a time in a large volume or at many pixels
_RUNS, _JUDGED = 16, 8192  # runs of neighbouring pixels, and positions in them, that tell intensities from labels
_LONGEST_STEP = 100.0  # s; a warning reports longer time steps, which may be in ms
_CURVED = 0.15  # correlation with the mean curvature: on fsaverage5 curv has 0.9, sulc 0.65, the other hemisphere 0.05


def usual_spacing(origin: Origin, uv: NDArray[np.float64], faces: NDArray[Any]) -> float:
    """Return the typical distance between neighbours, in mm: the voxel spacing, or the median edge in the plane."""
    if origin.is_voxels:
        return voxel_size(origin.voxels.affine)
    sides = uv[faces] - uv[np.roll(faces, 1, axis=1)]
    return float(np.median(np.linalg.norm(sides, axis=2)))


@dataclass(frozen=True, eq=False)
class Sampler:
    """The points of a map on the surface, in the order of the corners of rasters."""

    points: NDArray[np.float64]  # (N, 3), RAS+ mm in `space`
    normals: NDArray[np.float64]  # outward unit vectors; NaN for a one-voxel-thick surface
    ids: NDArray[np.int64]  # voxel indices (N, 3), or vertex numbers in the mesh (N,)
    origin: Origin
    faces: NDArray[Any]
    white_points: NDArray[np.float64] | None = None  # (N, 3), on the white and pial surfaces, if both are known
    pial_points: NDArray[np.float64] | None = None
    of: str = "flattened volume"  # how messages refer to the volume whose affine volumes without one get
    usual: Callable[[int], str | None] | None = None  # default interpolation of a channel, if a series determines it

    @property
    def is_voxels(self) -> bool:
        """Whether the surface was made from a volume."""
        return self.origin.is_voxels

    @property
    def unit(self) -> str:
        """The unit of length of the points."""
        return self.origin.unit

    @property
    def space(self) -> Space:
        """The space of the points."""
        return self.origin.space

    @cached_property
    def affine(self) -> NDArray[np.float64]:
        """The affine of the flattened volume, from voxel indices to RAS+ mm, shape (4, 4)."""
        self.need_volume("has no affine")
        return self.origin.voxels.affine

    @property
    def volume_shape(self) -> tuple[int, int, int]:
        """The shape of the flattened volume."""
        self.need_volume("has no volume shape")
        return self.origin.voxels.shape

    def need_volume(self, what: str, remedy: str = "Pass a volume with an affine, or values at its vertices") -> None:
        """Raise an error unless the map was made from a volume."""
        if not self.is_voxels:
            raise InputError(f"a map of a mesh {what}. {remedy}")

    def images(
        self,
        raster: Raster,
        volume: object,
        *,
        channel: int | str | None = None,
        depths: Depths = ON_SURFACE,
        projection: str | None = None,
        interpolation: str | None = None,
        period: float | None = None,
        time_step: float | None = None,
        name: str = "",
        several: bool = True,
    ) -> FlatStack:
        """Sample channels of a volume, an overlay or a texture at pixels; if `several`, they share weights."""
        if projection is not None:
            checked_choice(projection, "projection", PROJECTIONS)
        if period is not None:
            interpolation = _of_phases(period, interpolation, projection)
        name = checked_text(name, "name")
        title = name or (Path(volume).name if isinstance(volume, str | os.PathLike) else "overlay")
        layers: tuple[str, ...] = ()
        heights: tuple[float, ...] = ()
        texture = None if self.is_voxels else self._surface_texture(volume)
        overlay = None if self.is_voxels or texture is not None else self._overlay(volume)
        if texture is not None:
            if depths != ON_SURFACE or interpolation is not None:
                raise InputError("depth, fraction, interpolation and period do not apply to textures. Omit them")
            colours = paint(texture, raster, self.ids)
            names = channels = Channels(("",), lambda _: colours)
        elif overlay is not None:
            if isinstance(volume, str | os.PathLike):
                check_partner(volume, self.origin)
                self._doubt(Path(volume), overlay.read(0))
            if depths != ON_SURFACE:
                raise InputError("an overlay has values only on the surface. Omit depth and fraction")
            series = series_showing(raster, self.ids, interpolation)
            several = several and len(overlay) > 1
            shown = series if several else lambda values: show(raster, values[self.ids], interpolation)
            names = channels = overlay.mapped(shown if period is None else phases(shown, period, interpolation))
        else:
            volumes, placed, path = self.volumes(volume)
            names = volumes
            check_participant(path, self.origin.input)
            title = name or (path.name if path else "volume")
            projection = "mean" if len(depths) == 1 else projection
            sampled = self._sampling(raster, depths, projection, title, several=several and len(volumes) > 1)

            is_checked = False

            def read(n: int) -> NDArray[Any]:
                nonlocal is_checked
                volume = placed(volumes.read(n))
                if not is_checked:  # all channels have the same place
                    self._check_place(volume, depths, title)
                    is_checked = True
                if period is None:
                    way = interpolation or (self.usual(n) if self.usual else self._default(raster, depths, volume))
                    return sampled(volume, way)
                if volume.data.ndim != 3:
                    raise InputError("period is given, but the volume has colours. Pass a volume of phases")
                of_phases = phases(lambda own: sampled(replace(volume, data=own), interpolation), period, interpolation)
                return of_phases(volume.data)

            layers = depths.names(self.unit) if projection is None else ()
            heights = self._heights(depths) if projection is None else ()
            channels = _one_by_one(replace(volumes, read=read), layers)
        channels = _timed(channels, time_step, title)
        how: dict[str, Any] = {"layers": layers, "heights": heights, "unit": raster.unit}
        stack = FlatStack(channels, raster.pixel_size, raster.origin, title, **how)
        return stack if channel is None else stack.of_channel(self._found(volume, names, channel))

    def _sampling(
        self, raster: Raster, depths: Depths, projection: str | None, title: str, *, several: bool
    ) -> Callable[[Volume, str | None], NDArray[Any]]:
        """Return a function that samples a volume at pixels; if `several`, volumes in memory share weights."""
        self._doubt_space()
        if depths.layering is not None:
            self._at_fractions(depths)
        elif any(depths.values):
            self._directions(depths)
        repeated: Callable[[Volume, str | None], NDArray[Any]] | None = None
        coverage = Coverage()

        def sampled(volume: Volume, interpolation: str | None) -> NDArray[Any]:
            nonlocal repeated
            is_chunked, is_told = isinstance(volume.data, Chunked), coverage.some > 0
            if not is_told:
                coverage.any = 0  # of this channel
            if volume.data.ndim == 3 and (is_chunked or len(depths) * math.prod(raster.shape) > _BATCH):
                found = self._in_batches(raster, depths, projection, volume, interpolation, coverage)
            elif several:
                repeated = repeated or series_sampling(self._in_world(raster, depths), projection, coverage)
                found = repeated(volume, interpolation)
            else:
                found = sampled_at(volume, self._in_world(raster, depths), interpolation, projection, coverage)
            if coverage.some and not is_told:  # once, for the first channel with such pixels
                left = "They have no sum" if projection == "sum" else "The other depths determine their values"
                told = "%s: %s of %s pixels have no value at some of the %d depths (NaN, or outside the volume). %s"
                log.warning(told, title, f"{coverage.some:,}", f"{coverage.any:,}", len(depths), left)
            return found

        return sampled

    def _in_batches(
        self,
        raster: Raster,
        depths: Depths,
        projection: str | None,
        volume: Volume,
        interpolation: str | None,
        coverage: Coverage,
    ) -> NDArray[np.float64]:
        """Sample a volume at pixels of a few chunks at a time, so that memory never holds all voxels or positions."""
        pixels = np.flatnonzero(raster.inside)
        if isinstance(volume.data, Chunked):
            near = self._in_world(some_pixels(raster, pixels), ON_SURFACE)[0][:, 0]
            pixels = pixels[np.argsort(volume.data.chunk_of(voxels_of(volume, near)), kind="stable")]
        found = np.full((*(() if projection else (len(depths),)), math.prod(raster.shape)), np.nan)
        for part in np.array_split(pixels, 1 + len(pixels) * len(depths) // _BATCH):
            places = self._in_world(some_pixels(raster, part), depths)
            found[..., part] = sampled_at(volume, places, interpolation, projection, coverage)[..., 0]
        return found.reshape(*found.shape[:-1], *raster.shape)

    def _default(self, raster: Raster, depths: Depths, volume: Volume) -> str | None:
        """Return the interpolation of a stack of integers, which may be intensities or labels; otherwise None."""
        is_stack = volume.path is not None and is_stack_path(volume.path)
        if not is_stack or volume.data.ndim != 3 or volume.data.dtype.kind not in "iu":
            return None
        pixels = np.flatnonzero(raster.inside)
        starts = np.linspace(0, len(pixels), _RUNS, endpoint=False, dtype=np.int64)
        run = starts[:, None] + np.arange(max(1, _JUDGED // (_RUNS * len(depths))))
        part = pixels[np.unique(np.minimum(run, len(pixels) - 1))]
        places = np.concatenate(self._in_world(some_pixels(raster, part), depths)).reshape(-1, 3)
        if are_intensities(volume, places):
            return "linear"
        if volume.path not in self._of_labels:
            self._of_labels.add(volume.path)
            told = "%s: the integers form areas, so they are sampled as labels. Use interpolation 'linear' otherwise"
            log.warning(told, Path(str(volume.path)).name)
        return "nearest"

    def default(self, raster: Raster, depths: Depths, volume: object, channel: int) -> str | None:
        """Return the default interpolation of a channel of a volume; None if its data type determines it."""
        volumes, placed, _ = self.volumes(volume)
        return self._default(raster, depths, placed(volumes.read(channel)))

    @cached_property
    def _of_labels(self) -> set[Path | None]:
        """The stacks that were taken for labels, each of which is reported once."""
        return set()

    @staticmethod
    def _found(volume: object, channels: Channels, channel: int | str | None) -> int:
        """Return the number of a channel; error messages name the volume."""
        with naming(volume if isinstance(volume, str | os.PathLike) else type(volume).__name__, REMEDY):
            return channels.find(channel)

    def image(
        self, raster: Raster, volume: object, *, channel: int | str | None = None, name: str = "", **how: Any
    ) -> FlatImage:
        """Sample one channel at pixels, as `FlatMap.image` does; `how` holds options of `images`."""
        how = {"projection": "mean", **how}
        stack = self.images(raster, volume, several=False, name=name, **how)
        shown = stack[self._found(volume, stack.channels, channel)]
        return replace(shown, name=name) if name else shown

    def volumes(self, volume: object) -> tuple[Channels, Callable[[NDArray[Any]], Volume], Path | None]:
        """Return voxels (one by one for several volumes), a function that makes a volume from them, and the file."""
        path = Path(volume) if isinstance(volume, str | os.PathLike) else None
        with naming(path or type(volume).__name__, REMEDY):
            chunks = chunked_of(volume.data if isinstance(volume, Volume) else volume)
        if chunks is not None:
            at, unit = (volume.affine, volume.unit) if isinstance(volume, Volume) else chunks[1:3]
            is_unknown = not volume.is_placed if isinstance(volume, Volume) else at is None or is_incomplete(at)
            shape = chunks[0].read(0).shape if is_unknown else ()
            place = self._own_place(shape) if at is None or is_unknown else self._here(at, unit)
            path = volume.path if isinstance(volume, Volume) else path
            return chunks[0], lambda voxels: Volume(voxels, place, path), path
        with naming(path or type(volume).__name__, REMEDY):
            series = series_of(path or volume)
        if series is not None:
            self._doubt_place(series[1], path)
            in_map = self._here(series[1], "mm")
            return series[0], lambda voxels: Volume(voxels, in_map, path), path
        if isinstance(volume, np.ndarray) and volume.ndim == 4 and volume.dtype != np.uint8 and volume.shape[3] > 1:
            return Channels(("",) * volume.shape[3], lambda n: volume[..., n]), self.placed, None
        placed = self.placed(volume)
        self._doubt_place(placed.affine, placed.path)
        return Channels(("",), lambda _: placed.data), lambda _: placed, placed.path

    def form(self, volume: object) -> tuple[tuple[int, ...], int]:
        """Return the shape of a volume, or of values at the mesh's vertices, and its number of channels."""
        overlay = None if self.is_voxels else self._overlay(volume)
        channels = self.volumes(volume)[0] if overlay is None else overlay
        return tuple(channels.read(0).shape[:3]), len(channels)

    def _surface_texture(self, volume: object) -> SurfaceTexture | NDArray[np.uint8] | None:
        """Return the texture of the mesh, or colours at its vertices; None if the input is neither."""
        count = self.origin.mesh.vertices
        if isinstance(volume, str | os.PathLike):
            path = Path(volume)
            if not path.name.lower().endswith(TEXTURE_ENDINGS):
                return None
            check_partner(path, self.origin)
            return read_texture(path, count)
        return array_of(volume, "colours") if are_colours(volume, count) else None

    def is_overlay(self, values: object) -> bool:
        """Return whether values lie at the mesh's vertices and therefore have no depth."""
        return not self.is_voxels and self._overlay(values) is not None

    def _overlay(self, volume: object) -> Channels | None:
        """Return values at the mesh's vertices; None if the input is something else."""
        count, structure = self.origin.mesh.vertices, self.origin.structure
        if is_chunked(volume):
            return None
        if isinstance(volume, str | os.PathLike):
            if is_zarr_path(volume) or holds_volume(volume):
                return None
            return read_channels(volume, count, structure=structure)
        is_array = isinstance(volume, list) or hasattr(volume, "__array__")  # includes a pandas Series
        is_array = is_array and not hasattr(volume, "dataobj")
        if is_array and (values := array_of(volume, "overlay's values", as_nan=True)).ndim in (1, 2):
            if len(values) != count:
                is_of_points = len(values) == len(self.points)  # such as distances in a part of the mesh
                each = ", one for each point of the map," if is_of_points else ","
                remedy = "Assign them to the map's ids first" if is_of_points else "Pass one value for each"
                raise InputError(
                    f"the overlay has {len(values)} values{each} but the mesh has {count} vertices. {remedy}"
                )
            return Channels.of_array(values)
        return values_of_object(volume, count, structure)

    def _doubt(self, path: Path, values: NDArray[Any]) -> None:
        """Warn if folds in a file match the curvature poorly, which suggests that it belongs to another surface."""
        if re.search(r"(^|[._-])(curv|sulc)([._]|$)", path.name) and values.ndim == 1:
            r = self._correlation_with_curvature(values)
            if abs(r) < _CURVED:
                told = (
                    "%s does not follow the folds of the surface: its correlation with the curvature is %.2f (usually "
                    "0.6 to 0.9). Check that it belongs to this surface"
                )
                log.warning(told, path.name, r)

    def _correlation_with_curvature(self, values: NDArray[Any]) -> float:
        """Return the correlation of values at the vertices with the mean curvature; NaN if either is constant."""
        ends = np.concatenate([self.faces, self.faces[:, ::-1]])[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        steps = self.points[ends[:, 1]] - self.points[ends[:, 0]]
        with np.errstate(all="ignore"):
            bend = (self.normals[ends[:, 0]] * steps).sum(axis=1) / (steps**2).sum(axis=1)
        vertices, is_known = self.ids[ends[:, 0]], np.isfinite(bend)
        count = np.bincount(vertices[is_known], minlength=len(values))
        seen = np.flatnonzero(count)
        curvature = (np.bincount(vertices[is_known], bend[is_known], len(values)) / np.maximum(count, 1))[seen]
        with np.errstate(all="ignore"):
            return float(np.corrcoef(curvature, values[seen].astype(np.float64))[0, 1])

    def _doubt_place(self, affine: NDArray[np.float64], path: Path | None) -> None:
        """Warn if a volume's file does not define its position, unless it has the affine of the flattened volume."""
        is_same = self.is_voxels and np.array_equal(affine, self.affine)
        if path is not None and not is_same and not has_place(path):
            log.warning(
                "%s does not define its position (no sform, qform or goodRASFlag), so its centre is taken as the "
                "origin. Copy the header of an image with the same grid into this file",
                path.name,
            )

    def _check_place(self, volume: Volume, depths: Depths, title: str) -> None:
        """Raise an error if the map lies outside a volume or within one voxel, mostly because their units differ."""
        inverse = np.linalg.inv(volume.affine)
        surfaces = [one for one in (self.points, self.white_points, self.pial_points) if one is not None]
        at = self.space.to_scanner(np.concatenate(surfaces)) @ inverse[:3, :3].T + inverse[:3, 3]
        low, high = at.min(axis=0), at.max(axis=0)
        beyond = 0.5 + (max(map(abs, depths.values)) / volume.spacing if depths.layering is None else 0)
        if (high < -beyond).any() or (low > np.array(volume.data.shape[:3]) - 1 + beyond).any():
            told = "does not overlap the map, so the image would be empty"
        elif (high - low).max() < 1:
            told = "has voxels that are larger than the map"
        else:
            self.doubt_extent(volume)
            return
        unit = "an unknown unit" if self.unit == "unknown" else self.unit
        found = _along_axes(volume.data.shape, volume.affine)
        own = _along_axes(self.volume_shape, self.affine) if self.is_voxels else found
        if own != found and sorted(own) == sorted(found):
            told += ". It has {} x {} x {} voxels along x, y and z, but the flattened volume has {} x {} x {}"
            raise InputError(f"{title} {told.format(*found, *own)}. Save it with the axes of the flattened volume")
        raise InputError(f"{title} {told}. Compare their positions and units; the map is in {unit}")

    def doubt_extent(self, volume: Volume) -> None:
        """Warn if a stack differs in extent from the flattened volume, and neither has a position."""
        if not (self.is_voxels and volume.path is not None and is_stack_path(volume.path)):
            return
        voxels = [(volume.affine, volume.data.shape[:3]), (self.affine, self.volume_shape)]
        if any(np.count_nonzero(affine - np.diag(affine.diagonal())) for affine, _ in voxels):
            return
        spacings = np.array([affine.diagonal()[:3] for affine, _ in voxels])
        extents = spacings * [shape for _, shape in voxels]
        if (np.abs(extents[0] - extents[1]) > spacings.max(axis=0) * (1 + 1e-6)).any():
            unit = "" if self.unit == "unknown" else f" {self.unit}"
            found, own = (" x ".join(f"{length:.6g}" for length in extent) + unit for extent in extents)
            told = (
                "%s measures %s along x, y and z, but the flattened volume %s. Neither defines its position, so both "
                "are assumed to start at the same corner. If they do not, crop, pad or resample the stack to the grid "
                "of the flattened volume"
            )
            log.warning(told, volume.path.name, found, own)

    def _doubt_space(self) -> None:
        """Warn if the space of the surface is not certain."""
        if self.space.doubt:
            log.warning(
                "the volume may be sampled at the wrong positions: %s. Use a surface file that defines its space (for "
                "example, a FreeSurfer lh.white with its footer), or the output of mris_convert --to-scanner (version "
                "7.4 or later)",
                self.space.doubt,
            )

    def _in_world(self, raster: Raster, depths: Depths) -> list[NDArray[np.float64]]:
        """Return the sampling positions of pixels in scanner RAS and mm, shape (H, W, 3) for each depth."""
        if depths.layering is not None:
            return [self.space.to_scanner(raster.interpolate(points)) for points in self.at(depths)]
        points = raster.interpolate(self.points)
        if not any(depths.values):
            return [self.space.to_scanner(points)] * len(depths)
        normals = raster.interpolate(self._directions(depths))
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        return [self.space.to_scanner(points + depth * normals if depth else points) for depth in depths.values]

    def _heights(self, depths: Depths) -> tuple[float, ...]:
        """Return the height of each depth in mm: a fraction of the median thickness, or the distance as given."""
        if depths.layering is None or self.white_points is None or self.pial_points is None:
            return depths.values
        thickness = _thickness(self.white_points, self.pial_points)
        return tuple(value * thickness for value in depths.values)

    def at(self, depths: Depths) -> list[NDArray[np.float64]]:
        """Return the points at each depth, shape (N, 3), in RAS+ mm in the space of the points."""
        if depths.layering is None:
            return [self.points + (depth * self._directions(depths) if depth else 0) for depth in depths.values]
        return self._at_fractions(depths)

    def _at_fractions(self, depths: Depths) -> list[NDArray[np.float64]]:
        """Return the points at fractions of the way from the white to the pial surface; the last result is kept."""
        if depths not in self._fractions:
            self._fractions.clear()
            self._fractions[depths] = self._between(depths)
        return self._fractions[depths]

    @cached_property
    def _fractions(self) -> dict[Depths, list[NDArray[np.float64]]]:
        return {}

    def _between(self, depths: Depths) -> list[NDArray[np.float64]]:
        """Return the points at fractions of the way from the white to the pial surface."""
        if self.white_points is None or self.pial_points is None:
            raise InputError(
                "fraction requires white and pial surfaces, but this map has no pial surface. Flatten the white "
                "surface with pial=, or pass depth= in mm"
            )
        way = self.pial_points - self.white_points
        if depths.layering == "equidistant":
            return [self.white_points + value * way for value in depths.values]
        if self.is_voxels:  # these surfaces are too rough for the areas around single points
            surfaces = (self.white_points, self.pial_points)
            inner, outer = smooth_areas(surfaces, self.points, self.faces, _thickness(*surfaces))
        else:
            inner, outer = self._areas(self.white_points), self._areas(self.pial_points)
        return [self.white_points + equivolume(value, inner, outer)[:, None] * way for value in depths.values]

    def _areas(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the area around each point, summed over the sides of a cut."""
        one = distinct(self.ids).which
        return np.asarray(np.bincount(one, vertex_areas(points, self.faces))[one], dtype=np.float64)

    def _directions(self, depths: Depths) -> NDArray[np.float64]:
        """Return unit vectors from the surface to all depths; layers along them do not cross, if that is possible."""
        low, high = min(depths.values), max(depths.values)
        if np.isnan(self.normals).all():
            depth = f"{high or low:g} mm"
            raise InputError(f"depth is {depth}, but a surface that is one voxel thick has no outside. Omit depth")
        if (low, high) not in self._uncrossed:
            self._uncrossed[low, high], share = uncrossed(self.points, self.normals, self.faces, low, high)
            if share:
                ends = Depths((low, high)).names(self.unit)
                where = ends[0] if low == high else " to ".join(ends)
                told = "layers at depths of %s cross at %.2g %% of the triangles, where the surface bends more tightly"
                log.warning(f"{told}. Use smaller depths, or smooth the surface", where, 100 * share)
        return self._uncrossed[low, high]

    @cached_property
    def _uncrossed(self) -> dict[tuple[float, float], NDArray[np.float64]]:
        return {}

    def placed(self, volume: object) -> Volume:
        """Return a volume with its affine or, if it has none, with the affine of the points' volume."""
        given = volume_of(volume)
        if not given.is_placed:
            return replace(given, affine=self._own_place(given.data.shape), unit=self.unit, is_placed=True)
        return given if self.unit == "unknown" else given.in_unit(self.unit)

    def _here(self, affine: NDArray[np.float64], unit: str) -> NDArray[np.float64]:
        """Return an affine in the unit of the map, if that is known."""
        return affine if self.unit == "unknown" else scaled(affine, unit, self.unit)

    def _own_place(self, shape: tuple[int, ...]) -> NDArray[np.float64]:
        """Return the affine of the points' volume for a volume of the same shape."""
        if not self.is_voxels:
            told = "the volume does not define the size and position of its voxels, nor does the map of a mesh"
            raise InputError(f"{told}. Pass a volume with an affine, or values at its vertices")
        if shape[:3] != self.volume_shape:
            raise InputError(
                f"the volume has shape {shape} and no affine, but the {self.of} has shape {self.volume_shape}. "
                "Pass a volume of that shape, or one with an affine"
            )
        return self.affine


def _along_axes(shape: Sequence[int], affine: NDArray[np.float64]) -> list[int]:
    """Return the numbers of voxels along the axes that are closest to x, y and z."""
    return [shape[axis] for axis in np.abs(affine[:3, :3]).argmax(axis=1)]


def _thickness(inner: NDArray[np.float64], outer: NDArray[np.float64]) -> float:
    """Return the median distance between two surfaces in mm."""
    return float(np.median(np.linalg.norm(outer - inner, axis=1)))


def _one_by_one(layers: Channels, names: Sequence[str]) -> Channels:
    """Return each depth of each channel as a separate channel; the last channel that was sampled is kept in memory."""
    held: dict[int, Any] = {}

    def read(n: int) -> NDArray[Any]:
        channel, layer = divmod(n, max(1, len(names)))
        if channel not in held:
            held.clear()
            held[channel] = layers.read(channel)
        image: NDArray[Any] = held[channel][layer] if names else held[channel]
        return image

    if not names:
        return replace(layers, read=read)
    titles = [", ".join(part for part in (own, layer) if part) for own in layers.names for layer in names]
    return Channels(tuple(titles), read, layers.timing)


def _of_phases(period: float, interpolation: str | None, projection: str | None) -> str:
    """Check the period of phases, and return their interpolation."""
    if not (math.isfinite(checked_number(period, "period")) and period > 0):
        raise InputError(f"period is {period:g}. Pass a positive number, such as 360 for degrees")
    if projection not in (None, "mean"):
        raise InputError(f"projection is {projection!r}, but phases have only a mean over depths. Pass 'mean'")
    if interpolation is not None and checked_choice(interpolation, "interpolation", INTERPOLATIONS) == "majority":
        raise InputError("interpolation is 'majority', which is for labels, not for phases. Pass 'linear'")
    return interpolation or "linear"


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
        told = "the header of %s gives a time step of %g s, which may be in milliseconds. Pass the time step in seconds"
        log.warning(told, name, channels.timing.step)
    return channels
