"""Maps of all frames of a movie: the class `FlatSeries`, which `flatten_series` returns, and `load_series`."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import NDArray

from voxflat import _core
from voxflat.arguments import Progress, checked_switch, checked_threads, is_whole, shown
from voxflat.distortion.distortion import Distortion
from voxflat.errors import InputError
from voxflat.io.channels import Channels
from voxflat.io.files import SAVED_ENDINGS
from voxflat.io.grid import in_unit
from voxflat.io.provenance import Record, recording
from voxflat.io.saved import Saved
from voxflat.maps.depth import Depths, vertex_areas
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.map_files import read_map, write_map
from voxflat.maps.matching import Matched
from voxflat.maps.plane import FlatTriangles
from voxflat.maps.raster import FlatStack, Raster
from voxflat.maps.sources import VolumeSource, source_of, timing_of
from voxflat.pipeline.flat_movie import FlatMovie, joined
from voxflat.read_only import ReadOnly
from voxflat.unique_rows import distinct

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from voxflat.maps.option_types import ImagesOptions

_ARRAYS = ("points", "normals", "gaps", "folded")  # fields that are saved as arrays
_FAR = 0.02  # gap, relative to the size of the surface, that is reported
_METRIC = ("area factor", "largest stretch", "smallest stretch")  # names of the channels


def numbered(values: Any) -> Any:
    """Return a list as a dict, whose files records keep, however long it is."""
    return {str(n): value for n, value in enumerate(values)} if isinstance(values, list | tuple) else values


def listed(numbers: Sequence[int] | NDArray[np.int64]) -> str:
    """Return numbers of frames as text, at most six of them."""
    if len(numbers) > 6:
        return f"{len(numbers)} frames"
    return f"frame{'s' * (len(numbers) > 1)} {', '.join(map(str, numbers))}"


def _unmeasured(figures: Any) -> Any:
    """Return figures of the same structure that are all NaN."""
    if is_dataclass(figures) and not isinstance(figures, type):
        return replace(figures, **{entry.name: _unmeasured(getattr(figures, entry.name)) for entry in fields(figures)})
    if isinstance(figures, np.ndarray):
        return np.full_like(figures, np.nan) if figures.dtype.kind == "f" else figures
    return float("nan") if isinstance(figures, float) else figures


@dataclass(frozen=True, eq=False)
class FlatSeries(Sequence[FlatMap], ReadOnly, Saved):
    """One flat map for all frames of a movie.

    ``series[t]`` is the map with the positions of frame t. All frames have the same positions in the plane, and
    therefore the same pixels.

    Parameters
    ----------
    flat_map : FlatMap
        The map of the reference frame.
    points : ndarray of float64, shape (T, N, 3)
        Positions of the map's points in each frame, in RAS+ mm (or the unit of the surfaces).
    normals : ndarray of float64, shape (T, N, 3)
        Outward unit normals of the points in each frame.
    reference : int
        Number of the reference frame.
    gaps : ndarray of float64, shape (T,)
        The 95th percentile of the distance from the vertices of each frame to the moved surface of the reference frame.
    folded : ndarray of int64, shape (T,)
        Number of triangles of the moved surface that face inwards.
    provenance : dict
        Record of how the series was made, with the surfaces of all frames.

    See Also
    --------
    flatten_series : Make a series.
    load_series : Load a saved series.

    Examples
    --------
    >>> hill = voxflat.samples.hill()
    >>> series = voxflat.flatten_series([hill, (1.1 * hill.points, hill.faces)])
    >>> series
    <FlatSeries: 2 frames, 441 points>
    >>> series.points.shape
    (2, 441, 3)
    """

    _kind = "a series"
    _endings = SAVED_ENDINGS
    _formats = """
    ``.npz`` and ``.voxflat`` hold the map, the positions in all frames and `provenance`, for `load_series`.
    """

    flat_map: FlatMap
    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    reference: int
    gaps: NDArray[np.float64]
    folded: NDArray[np.int64]
    provenance: Record = field(default_factory=dict)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about frames that the moved surface does not fit.

        They are derived from `gaps` and `folded`. The tuple is empty if the surface fits all frames.
        """
        warnings = []
        advice = "Check the surfaces there, or split the movie"
        size = float(np.sqrt(vertex_areas(self.flat_map.points, self.flat_map.faces).sum() / (4 * np.pi)))
        is_far = self.gaps > max(_FAR * size, 3 * float(np.median(self.gaps)))
        if is_far.any():
            worst = f"{self.gaps.max():.3g} mm in frame {self.gaps.argmax()}"
            text = (
                f"the moved surface does not fit {listed(np.flatnonzero(is_far))} (95th percentile of the gap: {worst})"
            )
            warnings.append(f"{in_unit(text, self.flat_map.origin.named_unit)}. {advice}")
        if self.folded.any():
            worst = f"{self.folded.max()} triangles in frame {self.folded.argmax()}"
            warnings.append(
                f"the moved surface is folded in {listed(np.flatnonzero(self.folded))} (at most {worst}). {advice}"
            )
        return tuple(warnings)

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.points)

    def __repr__(self) -> str:
        return f"<FlatSeries: {len(self)} frames, {len(self.flat_map)} points>"

    @overload
    def __getitem__(self, frame: int) -> FlatMap: ...

    @overload
    def __getitem__(self, frame: slice) -> list[FlatMap]: ...

    def __getitem__(self, frame: int | slice) -> FlatMap | list[FlatMap]:
        """Return the map of a frame; the `distortion` of other frames than the reference is NaN (see `measure`)."""
        if isinstance(frame, slice):
            return [self[number] for number in range(*frame.indices(len(self)))]
        frame = range(len(self))[self._number(frame)]
        if frame == self.reference:
            return self.flat_map
        replaced: dict[str, Any] = {"points": self.points[frame], "normals": self.normals[frame]}
        replaced["distortion"] = _unmeasured(self.flat_map.distortion)
        replaced["origin"] = replace(self.flat_map.origin, frame=frame)
        replaced |= dict.fromkeys(("rows", "curvature", "sulcal_depth", "spread", "white_points", "pial_points"))
        if self.provenance:
            recorded: Any = self.provenance["parameters"]
            replaced["record"] = {**self.provenance, "parameters": {**recorded, "frame": frame}}
        flat_map = replace(self.flat_map, **replaced)
        vars(flat_map)["_rasters"] = self.flat_map._rasters  # all frames have the same pixels
        return flat_map

    @recording(volumes=numbered)
    def images(
        self,
        volumes: Sequence[object] | None = None,
        pixel_size: float | None = None,
        *,
        metric: bool = False,
        time_step: float | None = None,
        **options: Unpack[ImagesOptions],
    ) -> FlatMovie:
        """Show one volume per frame on the map, each on the surface of its frame.

        Images are sampled on demand. All frames have the same pixels.

        Parameters
        ----------
        volumes : sequence of path, ndarray, image object or Volume, optional
            One volume per frame, with one or several channels.
        pixel_size : float, optional
            Side length of a pixel, in mm (or the unit of the surfaces).
        metric : bool
            Add three channels that describe the surface of each frame: the factor from areas on the map to areas on the
            surface, and the two factors of lengths, as in `stretches`. They are the same at all depths.
        time_step : float, optional
            Time between frames, in seconds.
        **options
            Further options of `FlatMap.images`, such as ``depth=[-2, 0, 2]``.

        Returns
        -------
        FlatMovie
            A sequence of one `FlatStack` per frame. `FlatMovie.data` is the array (frame, channel, depth, row, column),
            and `FlatMovie.save` writes all images.

        Raises
        ------
        InputError
            If the number of volumes is not the number of frames, if the volumes differ in shape or number of channels,
            or as in `FlatMap.images`.

        Examples
        --------
        >>> ball = voxflat.samples.ball()
        >>> series = voxflat.flatten_series([ball, np.roll(ball, 1, axis=0)])
        >>> movie = series.images([ball, np.roll(ball, 1, axis=0)], depth=[-1.0, 1.0])
        >>> movie.data.shape[:2]
        (2, 2)
        """
        checked_switch(metric, "metric")
        if volumes is None and not metric:
            raise InputError("volumes is missing. Pass a list of one volume per frame, or metric=True")
        if volumes is None and options:
            raise InputError(f"{next(iter(options))} does not apply without volumes. Pass one volume per frame")
        if volumes is not None and (isinstance(volumes, str) or not hasattr(volumes, "__len__")):
            raise InputError(f"volumes is {shown(volumes)}. Pass a list of one volume per frame")
        if volumes is not None and len(volumes) != len(self):
            raise InputError(f"got {len(volumes)} volumes for {len(self)} frames. Pass one volume per frame, in order")
        timing = None if time_step is None else timing_of(time_step)
        images = None if volumes is None else list(volumes)
        frames = _Frames(self, images, self.flat_map.raster(pixel_size), metric, options)
        first = frames.read(0)
        axes: dict[str, Any] = {"layers": first.layers, "heights": first.heights, "timing": timing}
        look = (first.pixel_size, frames.title, first.channel_names)
        return FlatMovie(len(self), frames.read, frames.check, *look, **axes)

    def measure(self, frame: int, *, threads: int | None = None, progress: Progress | None = None) -> Distortion:
        """Measure the distortion of the map for the surface of a frame.

        Distances, areas and angles of the map are compared with those on the surface of the frame, in the same way and
        from as many points as in `FlatMap.distortion` of the reference frame.

        Parameters
        ----------
        frame : int
            The frame.
        threads, progress : optional
            As in `Surface.flatten`.

        Returns
        -------
        Distortion
            The distortion.

        Raises
        ------
        InputError, IndexError, Cancelled
            If the frame does not exist, the map has no triangles, or `progress` returned False.

        See Also
        --------
        FlatMap.distortion : The distortion of the reference frame.

        Examples
        --------
        >>> hill = voxflat.samples.hill()
        >>> series = voxflat.flatten_series([hill, (1.1 * hill.points, hill.faces)])
        >>> round(series.measure(1).best_scale.relative_error, 3)
        0.036
        """
        flat = self.flat_map
        frame = range(len(self))[self._number(frame)]
        before, seed, threads = flat.distortion, flat.seed, checked_threads(threads)
        if before.triangles is None:
            raise InputError(
                f"a map of the method {flat.method} has no triangles on the surface. Flatten with another method"
            )
        core, _ = _core.Surface.from_triangles(self.points[frame], flat.faces[~flat.torn].astype(np.int64))
        uv = np.ascontiguousarray(flat.uv[core.ids])
        vertices = distinct(flat.ids).which[core.ids].astype(np.uint32)
        closed, rows = Matched(core.with_ids(vertices), uv, flat.period).joined()
        sources = _core.reference_sources(len(closed.uv), before.sources, seed)
        judge, cache = closed.core.judge, _core.KEPT_BYTES
        result = judge(
            [closed.uv], sources, before.reference, cache, seed, before.bands, threads, progress, period=flat.period
        )[0]
        result["per_point"] = result["per_point"][rows]
        triangles = core.measure(uv, progress)
        for figures, name in ((result, "per_point"), (triangles, "areal")):
            values = np.full(len(flat), np.nan)
            values[core.ids] = figures[name]
            figures[name] = values
        more = {
            "bands": before.bands,
            "topology": before.topology,
            "voxel_size": before.voxel_size,
            "unit": before.unit,
        }
        return Distortion._of(result, triangles, before.reference, **more)

    def _write(self, path: Path) -> None:
        arrays = {**self.flat_map._arrays(), **{f"series_{name}": getattr(self, name) for name in _ARRAYS}}
        content = {"series": {"reference": self.reference, "provenance": self.provenance}}
        write_map(path, arrays, {**self.flat_map._described(), **content})

    def stretches(self, frame: int, since: int | None = None) -> NDArray[np.float64]:
        """Return the two principal stretches at each point: of the map to a frame, or from one frame to another.

        Their product is the factor by which areas change. To show values on the map, use
        ``flat_map.raster().interpolate(values)``.

        Parameters
        ----------
        frame : int
            The frame.
        since : int, optional
            An earlier frame, to measure how the surface stretches from that frame to `frame`. By default, lengths on
            the surface are divided by lengths on the map.

        Returns
        -------
        ndarray of float64, shape (N, 2)
            The largest and the smallest factor of length in any direction; NaN for points without triangles.

        Raises
        ------
        InputError, IndexError
            If a frame is not a whole number, or does not exist.

        Examples
        --------
        >>> hill = voxflat.samples.hill()
        >>> series = voxflat.flatten_series([hill, (1.1 * hill.points, hill.faces)])
        >>> np.median(series.stretches(1, since=0), axis=0).round(2)
        array([1.1, 1.1])
        """
        metric = self._metric(self._number(frame))
        if since is not None:
            values, axes = np.linalg.eigh(self._metric(self._number(since)))
            back = np.einsum("nab,nb,ncb->nac", axes, 1 / np.sqrt(values), axes)
            metric = back @ metric @ back
        squares = np.linalg.eigvalsh(metric)[:, ::-1]
        return np.asarray(np.sqrt(np.maximum(squares, 0)), dtype=np.float64)

    def _metric(self, frame: int) -> NDArray[np.float64]:
        """Return the metric tensor (N, 2, 2) of a frame in the coordinates of the map, averaged over triangles."""
        flat_map = self.flat_map
        faces = flat_map.faces[~flat_map.torn].astype(np.int64)
        flat = np.stack([flat_map.uv[faces[:, side]] - flat_map.uv[faces[:, 0]] for side in (1, 2)], axis=2)
        area = np.linalg.det(flat)
        is_valid = np.abs(area) > 0
        faces, flat, area = faces[is_valid], flat[is_valid], np.abs(area[is_valid])
        places = self.points[frame]
        sides = np.stack([places[faces[:, side]] - places[faces[:, 0]] for side in (1, 2)], axis=2)
        stretch = sides @ np.linalg.inv(flat)
        metric = np.swapaxes(stretch, 1, 2) @ stretch
        total = np.bincount(faces.ravel(), np.repeat(area, 3), len(flat_map))
        weighted = (area[:, None, None] * metric).reshape(-1, 4)
        sums = [np.bincount(faces.ravel(), np.repeat(column, 3), len(flat_map)) for column in weighted.T]
        with np.errstate(invalid="ignore", divide="ignore"):
            mean: NDArray[np.float64] = (np.stack(sums, axis=1) / total[:, None]).reshape(-1, 2, 2)
        mean[total == 0] = np.eye(2) * np.nan
        return mean

    def _number(self, frame: object) -> int:
        """Check the number of a frame."""
        if not is_whole(frame):
            raise InputError(f"the frame is {shown(frame)}. Pass a whole number")
        if not -len(self) <= frame < len(self):
            raise IndexError(f"frame {frame} does not exist: frames are numbered from 0 to {len(self) - 1}")
        return int(frame)


@dataclass(frozen=True, eq=False)
class _Frames:
    """The images of a series: each frame is read and sampled on demand."""

    series: FlatSeries
    volumes: list[object] | None
    raster: Raster
    metric: bool
    options: ImagesOptions
    shared: dict[int, FlatTriangles] = field(default_factory=dict)  # of each frame, with the directions of depths

    @property
    def title(self) -> str:
        """The title of the movie."""
        return str(self.options.get("name") or "movie")

    def read(self, frame: int) -> FlatStack:
        """Return the channels and depths of a frame."""
        stack = None if self.volumes is None else self._sampled(frame, self.volumes[frame])
        if stack is not None and not self.metric:
            return stack
        raster, stretches = self.raster, self.series.stretches(frame)
        values = np.column_stack([stretches.prod(axis=1), stretches])
        channels = Channels(_METRIC, lambda n: raster.interpolate(values[:, n]))
        look: dict[str, Any] = {"unit": raster.unit, "provenance": self.series[frame].provenance}
        measured = FlatStack(channels, raster.pixel_size, raster.origin, self.title, **look)
        return measured if stack is None else joined(stack, measured)

    def check(self, frame: int) -> None:
        """Raise an error if the volume of a frame differs in form from that of the first frame."""
        form, first = self._form(frame), self._first_form
        if form != first:
            both = [f"{' x '.join(map(str, shape))} voxels and {count} channels" for shape, count in (form, first)]
            volume = self.volumes[frame] if self.volumes is not None else None
            file = f" ({Path(volume).name})" if isinstance(volume, str | os.PathLike) else ""
            problem = f"the volume of frame {frame}{file} has {both[0]}, but that of frame 0 has {both[1]}"
            raise InputError(f"{problem}. Pass volumes of the same size")

    def _sampled(self, frame: int, volume: object) -> FlatStack:
        """Return the images of a volume on the surface of a frame."""
        flat_map = replace(self.series[frame])
        triangles = self.shared.setdefault(frame, flat_map._triangles)
        vars(flat_map).update(_rasters=self.series.flat_map._rasters, _triangles=triangles)
        vars(flat_map).update(_default_interpolation=self._interpolation)
        with _naming(frame):
            stack: FlatStack = flat_map.images(volume, self.raster.pixel_size, **self.options)
            return stack

    def _interpolation(self, channel: int) -> str | None:
        """Return the default for all frames, so that integers are labels in all of them or in none."""
        if channel not in self._usual and self.volumes is not None:
            options, source = self.options, VolumeSource.of(self.shared[0].on_surface, self.volumes[0])
            where = (options.get("depth", 0.0), options.get("fraction"), options.get("layering", "equivolume"))
            depths = Depths.of(*where, options.get("depths"))
            self._usual[channel] = source.default_interpolation(self.raster, depths, channel)
        return self._usual[channel]

    @cached_property
    def _usual(self) -> dict[int, str | None]:
        return {}

    def _form(self, frame: int) -> tuple[tuple[int, ...], int]:
        """Return the shape and the number of channels of the volume of a frame."""
        if self.volumes is None:
            return (), 0
        with _naming(frame):
            channels = source_of(self.series.flat_map._triangles.on_surface, self.volumes[frame]).channels
            return tuple(channels.read(0).shape[:3]), len(channels)

    @cached_property
    def _first_form(self) -> tuple[tuple[int, ...], int]:
        return self._form(0)


@contextmanager
def _naming(frame: int) -> Iterator[None]:
    """Name the frame in the errors of its volume."""
    try:
        yield
    except InputError as error:
        raise InputError(f"frame {frame}: {error}") from error


def load_series(path: str | os.PathLike[str]) -> FlatSeries:
    """Load a series that was saved with `FlatSeries.save`.

    Files of single maps are loaded with `load`.

    Parameters
    ----------
    path : path
        An .npz or .voxflat file.

    Returns
    -------
    FlatSeries
        The series.

    Raises
    ------
    InputError
        If the file is damaged or does not hold a series.
    FileNotFoundError
        If the file does not exist.

    See Also
    --------
    FlatSeries.save : Save a series.

    Examples
    --------
    >>> hill = voxflat.samples.hill()
    >>> voxflat.flatten_series([hill, (1.1 * hill.points, hill.faces)]).save("growth.npz")
    >>> voxflat.load_series("growth.npz")
    <FlatSeries: 2 frames, 441 points>
    """
    fields = read_map(path, series=True)
    more = fields["details"].pop("series")
    arrays = {name: fields.pop(f"series_{name}") for name in _ARRAYS}
    return FlatSeries(FlatMap(**fields), **arrays, **more)
