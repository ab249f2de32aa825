"""Movies of surfaces: one flat map for all frames, on which material points stay in place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat import _core
from voxflat.arguments import Progress, checked_threads, is_whole, log, shown
from voxflat.errors import Cancelled, InputError
from voxflat.io.grid import in_unit
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.raster import FlatStack
from voxflat.methods import Method
from voxflat.pipeline.following import Follower, Shape
from voxflat.pipeline.surface import Surface, surface

_FAR = 0.02  # distance from a frame, relative to the size of the surface, that is reported


def _unmeasured(figures: Any) -> Any:
    """Return figures of the same structure that are all NaN."""
    if is_dataclass(figures) and not isinstance(figures, type):
        return replace(figures, **{one.name: _unmeasured(getattr(figures, one.name)) for one in fields(figures)})
    if isinstance(figures, np.ndarray):
        return np.full_like(figures, np.nan) if figures.dtype.kind == "f" else figures
    return float("nan") if isinstance(figures, float) else figures


@dataclass(frozen=True, eq=False)
class FlatSeries(Sequence[FlatMap]):
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

    See Also
    --------
    flatten_series : Make a series.

    Examples
    --------
    >>> hill = voxflat.samples.hill()
    >>> series = voxflat.flatten_series([hill, (1.1 * hill.points, hill.faces)])
    >>> series
    <FlatSeries: 2 frames, 441 points>
    >>> series.points.shape
    (2, 441, 3)
    """

    flat_map: FlatMap
    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    reference: int
    gaps: NDArray[np.float64]
    folded: NDArray[np.int64]

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.points)

    def __repr__(self) -> str:
        return f"<FlatSeries: {len(self)} frames, {len(self.flat_map)} points>"

    def __getitem__(self, frame: Any) -> Any:
        """Return the map with the positions of a frame; the `distortion` of other frames than the reference is NaN."""
        if isinstance(frame, slice):
            return [self[number] for number in range(*frame.indices(len(self)))]
        frame = range(len(self))[self._number(frame)]
        if frame == self.reference:
            return self.flat_map
        own: dict[str, Any] = {"points": self.points[frame], "normals": self.normals[frame]}
        own["distortion"] = _unmeasured(self.flat_map.distortion)
        own |= dict.fromkeys(("rows", "curvature", "sulcal_depth", "white_points", "pial_points"))
        return replace(self.flat_map, **own, metadata={**self.flat_map.metadata, "series_frame": frame})

    def images(
        self, volumes: Sequence[object], pixel_size: float | None = None, **options: Any
    ) -> tuple[FlatStack, ...]:
        """Show one volume per frame on the map, each on the surface of its frame.

        Images are sampled on demand. All frames have the same pixels.

        Parameters
        ----------
        volumes : sequence of path, ndarray, image object or Volume
            One volume per frame, with one or several channels.
        pixel_size : float, optional
            Side length of a pixel, in mm (or the unit of the surfaces).
        **options
            Options of `FlatMap.images`, such as ``depth=[-2, 0, 2]``.

        Returns
        -------
        tuple of FlatStack
            One stack per frame. ``np.stack([stack.data for stack in stacks])`` has the axes (frame, channel, depth,
            row, column), without those for channels or depths if there is only one.

        Raises
        ------
        InputError
            If the number of volumes is not the number of frames, or as in `FlatMap.images`.

        See Also
        --------
        FlatMap.images : Show the channels and depths of one frame.

        Examples
        --------
        >>> ball = voxflat.samples.ball()
        >>> series = voxflat.flatten_series([ball, np.roll(ball, 1, axis=0)])
        >>> frames = series.images([ball, np.roll(ball, 1, axis=0)], depth=[-1.0, 1.0])
        >>> np.stack([stack.data for stack in frames]).shape[:2]
        (2, 2)
        """
        if isinstance(volumes, str) or not hasattr(volumes, "__len__") or len(volumes) != len(self):
            count = len(volumes) if hasattr(volumes, "__len__") and not isinstance(volumes, str) else "no list of"
            raise InputError(f"got {count} volumes for {len(self)} frames. Pass a list of one volume per frame")
        return tuple(own.images(volume, pixel_size, **options) for own, volume in zip(self, volumes, strict=True))

    def stretches(self, frame: int, since: int | None = None) -> NDArray[np.float64]:
        """Return the two principal stretches at each point: of the map to a frame, or from one frame to another.

        Their product is the factor by which areas change. To show values at the points on the map, use
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
        InputError
            If a frame does not exist.

        See Also
        --------
        FlatMap.distortion : Changes of areas and angles of the reference frame.

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
        of = self.flat_map
        faces = of.faces[~of.torn].astype(np.int64)
        flat = np.stack([of.uv[faces[:, side]] - of.uv[faces[:, 0]] for side in (1, 2)], axis=2)
        area = np.linalg.det(flat)
        is_valid = np.abs(area) > 0
        faces, flat, area = faces[is_valid], flat[is_valid], np.abs(area[is_valid])
        places = self.points[frame]
        sides = np.stack([places[faces[:, side]] - places[faces[:, 0]] for side in (1, 2)], axis=2)
        stretch = sides @ np.linalg.inv(flat)
        metric = np.swapaxes(stretch, 1, 2) @ stretch
        total = np.bincount(faces.ravel(), np.repeat(area, 3), len(of))
        weighted = (area[:, None, None] * metric).reshape(-1, 4)
        sums = [np.bincount(faces.ravel(), np.repeat(column, 3), len(of)) for column in weighted.T]
        with np.errstate(invalid="ignore", divide="ignore"):
            found: NDArray[np.float64] = (np.stack(sums, axis=1) / total[:, None]).reshape(-1, 2, 2)
        found[total == 0] = np.eye(2) * np.nan
        return found

    def _number(self, frame: object) -> int:
        """Check the number of a frame."""
        if not is_whole(frame):
            raise InputError(f"the frame is {shown(frame)}. Pass a whole number")
        if not -len(self) <= frame < len(self):
            raise IndexError(f"frame {frame} does not exist: frames are numbered from 0 to {len(self) - 1}")
        return int(frame)


def flatten_series(
    surfaces: Sequence[object],
    method: str | Method = "voxflat",
    *,
    reference: int = 0,
    cuts: object | None = None,
    relax: float | bool | None = None,
    mirror: bool = False,
    seed: int = 0,
    threads: int | None = None,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> FlatSeries:
    """Flatten the surfaces of all frames of a movie with one map, on which material points stay in place.

    The surface of the reference frame is flattened. Its mesh is then moved from frame to frame, as an elastic sheet
    that is at rest in the reference frame: onto the shape of each frame, with as little strain as possible. Growth by
    a constant factor causes no strain. Only the shape is used, so movements that do not change it cannot be seen.

    Parameters
    ----------
    surfaces : sequence
        The surfaces of the frames, in order: inputs of `voxflat.surface`. They need no common vertices, but one
        component and the same number of handles and boundary loops. The boundary of each frame moves to that of the
        next one.
    method : str or Method
        As in `Surface.flatten`.
    reference : int
        Number of the frame that is flattened.
    cuts, relax : optional
        Where the surface of the reference frame is cut, as in `Surface.cut`.
    mirror, seed, threads, memory_limit, progress : optional
        As in `Surface.flatten`.

    Returns
    -------
    FlatSeries
        The map, with the positions of its points in each frame.

    Raises
    ------
    InputError
        If there are fewer than two frames, or if their topology or units differ.
    Cancelled
        If `progress` returned False.

    See Also
    --------
    flatten : Flatten a single surface.

    Examples
    --------
    >>> ball = voxflat.samples.ball()
    >>> voxflat.flatten_series([ball, np.roll(ball, 1, axis=0)])
    <FlatSeries: 2 frames, 678 points>
    """
    limits: dict[str, Any] = {"threads": checked_threads(threads), "memory_limit": memory_limit, "progress": progress}
    frames = _frames(surfaces, limits)
    if not is_whole(reference) or not -len(frames) <= reference < len(frames):
        raise InputError(f"reference is {shown(reference)}. Pass a frame number from 0 to {len(frames) - 1}")
    reference = range(len(frames))[reference]
    first = frames[reference]
    flat_map = first.flatten(method, cuts=cuts, relax=relax, mirror=mirror, seed=seed, **limits)
    follower = Follower(first.core)
    corners, weights, _ = follower.reference.nearest(flat_map.points)
    count = len(frames)
    points = np.empty((count, len(flat_map), 3))
    normals, gaps, folded = points.copy(), np.zeros(count), np.zeros(count, dtype=np.int64)
    points[reference], normals[reference] = flat_map.points, flat_map.normals
    done = 0
    for order in (range(reference + 1, count), range(reference - 1, -1, -1)):
        places = follower.reference.points
        for frame in order:
            if progress is not None and progress("following the surface", done, count - 1) is False:
                raise Cancelled("following the surface was cancelled")
            target = Shape(frames[frame].points, np.ascontiguousarray(frames[frame].faces))
            places = follower.onto(places, target)
            moved = Shape(places, follower.faces)
            points[frame] = moved.mixed(places, corners, weights)
            outward = moved.mixed(_core.vertex_normals(places, follower.faces), corners, weights)
            normals[frame] = outward / np.linalg.norm(outward, axis=1, keepdims=True)
            gaps[frame] = np.percentile(moved.nearest(target.points)[2], 95)
            folded[frame] = follower.folded(places, target).sum()
            done += 1
    made = FlatSeries(flat_map, points, normals, reference, gaps, folded)
    _warn(made, follower)
    return made


def _frames(surfaces: Sequence[object], limits: dict[str, Any]) -> list[Surface]:
    """Return the surfaces of the frames, after checking that they can be frames of one movie."""
    if isinstance(surfaces, str | Surface) or not hasattr(surfaces, "__len__"):
        raise InputError(f"surfaces is {shown(surfaces)}. Pass a list of surfaces, one per frame")
    if len(surfaces) < 2:
        what = "empty" if len(surfaces) == 0 else "a single frame"
        raise InputError(f"the list of surfaces is {what}. Pass two or more frames, or use flatten for one surface")
    frames: list[Surface] = []
    for number, given in enumerate(surfaces):
        if given is None:
            raise InputError(f"frame {number} is missing (None). Remove it from the list, or pass its surface")
        try:
            own = surface(given, **limits)
        except InputError as error:
            raise InputError(f"frame {number}: {error}") from error
        frames.append(own)
        if (kind := _kind(own)) != (known := _kind(frames[0])):
            raise InputError(
                f"frame {number} has {kind}, but frame 0 has {known}. Correct its surface, or split the movie there"
            )
        units = [one.metadata.get("unit", "mm") for one in (frames[0], own)]
        if units[0] != units[1]:
            raise InputError(f"frame {number} is in {units[1]}, but frame 0 is in {units[0]}. Pass unit= when reading")
    if (parts := len(frames[0].core.topology()["components"])) > 1:
        raise InputError(f"the surfaces have {parts} components. Select one with keep, or smooth the segmentation")
    return frames


def _kind(of: Surface) -> str:
    """Return the topology of a surface in words."""
    found = of.core.topology()
    parts, handles, loops = len(found["components"]), found["handles"], len(found["loops"])
    counts = ((parts, "component"), (handles, "handle"), (loops, "boundary loop"))
    return ", ".join(f"{count} {name}{'s' * (count != 1)}" for count, name in counts)


def _warn(made: FlatSeries, follower: Follower) -> None:
    """Report frames that the mesh does not fit."""
    usual = float(np.median(made.gaps))
    worst = int(made.gaps.argmax())
    if made.gaps[worst] > max(_FAR * follower.reference.size, 3 * usual):
        text = f"frame {worst} is up to {made.gaps[worst]:.3g} mm away from the moved surface (95th percentile)"
        log.warning("%s. Check this frame", in_unit(text, made.flat_map.metadata))
    if made.folded.any():
        frames, worst = np.count_nonzero(made.folded), int(made.folded.argmax())
        text = (
            f"the moved surface is folded in {frames} frames (at most {made.folded[worst]} triangles, in frame {worst})"
        )
        log.warning("%s. Check the surfaces there", text)
