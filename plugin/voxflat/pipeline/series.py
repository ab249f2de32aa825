"""Movies of surfaces: one flat map for all frames, on which material points stay in place."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypedDict, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat.arguments import Progress, checked_threads, is_whole, log, shown
from voxflat.errors import Cancelled, InputError
from voxflat.io.grid import in_unit
from voxflat.io.provenance import recording
from voxflat.maps.flat_map import FlatMap
from voxflat.methods import Method, method_of
from voxflat.pipeline.cut_surface import CutSurface
from voxflat.pipeline.flat_series import FlatSeries, listed, numbered
from voxflat.pipeline.following import Follower
from voxflat.pipeline.landmarks import checked_landmarks
from voxflat.pipeline.shapes import Shape
from voxflat.pipeline.surface import Surface, surface
from voxflat.surfaces.parts import STRAY_SHARE, largest_piece
from voxflat.surfaces.smoothing import MOVED

if TYPE_CHECKING:
    from typing_extensions import Unpack

_SAME = 1e-5  # greatest distance between a surface and its own chart, relative to the size of the surface


class _Options(TypedDict, total=False):
    reference: int
    relax: float | bool | None
    mirror: bool
    seed: int
    threads: int | None
    memory_limit: int | None
    progress: Progress | None
    landmarks: ArrayLike | None


@overload
def flatten_series(  # type: ignore[overload-overlap]  # a tuple of charts is also an object
    surfaces: Sequence[object],
    method: str | Method = "voxflat",
    *,
    cuts: tuple[CutSurface[Surface], ...],
    **options: Unpack[_Options],
) -> tuple[FlatSeries, ...]: ...


@overload
def flatten_series(
    surfaces: Sequence[object],
    method: str | Method = "voxflat",
    *,
    cuts: object | None = None,
    **options: Unpack[_Options],
) -> FlatSeries: ...


@recording(method=method_of, surfaces=numbered)
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
    landmarks: ArrayLike | None = None,
) -> FlatSeries | tuple[FlatSeries, ...]:
    """Flatten the surfaces of all frames of a movie with one map, on which material points stay in place.

    The surface of the reference frame is flattened. Its mesh is then moved from frame to frame, as an elastic sheet
    that is at rest in the reference frame: onto the shape of each frame, with as little strain as possible. Growth by
    a constant factor causes no strain. Without `landmarks`, only the shape is used, so movements that do not change it
    cannot be seen.

    Parameters
    ----------
    surfaces : sequence
        The surfaces of the frames, in order: inputs of `voxflat.surface`. They need no common vertices, but the
        same number of handles and boundary loops. The boundary of each frame moves to that of the next one. Of several
        components, only the largest is used if the others have at most 5 % of the area.
    method : str or Method
        As in `Surface.flatten`.
    reference : int
        Number of the frame that is flattened.
    cuts, relax : optional
        Where the surface of the reference frame is cut, as in `Surface.cut`. ``cuts`` can also be a chart of that
        surface, or all its charts, from `Surface.charts`.
    mirror, seed, threads, memory_limit, progress : optional
        As in `Surface.flatten`.
    landmarks : array_like of float, shape (T, K, 3), optional
        Positions of K material points in each of the T frames, such as tracked nuclei, in the unit of the surfaces. NaN
        marks positions that are not known; in the reference frame, all must be known. The mesh is pulled to the points
        of the surfaces that are nearest to them.

    Returns
    -------
    FlatSeries or tuple of FlatSeries
        The map, with the positions of its points in each frame. A tuple, with one map per chart, if `cuts` is a list of
        charts.

    Raises
    ------
    InputError
        If there are fewer than two frames, if their topology or units differ, or if a landmark is far from its surface.
    Cancelled
        If `progress` returned False.

    See Also
    --------
    flatten : Flatten a single surface.

    Examples
    --------
    >>> ball = voxflat.samples.ball()
    >>> voxflat.flatten_series([ball, np.roll(ball, 1, axis=0)])
    <FlatSeries: 2 frames, 679 points>

    With one map for each of two charts:

    >>> surfaces = [voxflat.surface(labels) for labels in voxflat.samples.embryo().labels[:2]]
    >>> front, back = voxflat.flatten_series(surfaces, cuts=surfaces[0].charts(2))
    """
    limits: dict[str, Any] = {"threads": checked_threads(threads), "memory_limit": memory_limit, "progress": progress}
    frames = _frames(surfaces, limits)
    reference = checked_reference(reference, len(frames))
    _warn(frames, reference)
    marks = checked_landmarks(landmarks, frames, reference)
    first = frames[reference]
    common: dict[str, Any] = {"mirror": mirror, "seed": seed, **limits}
    charts = _charts(cuts)
    if charts is None:
        maps = [first.flatten(method, cuts=cuts, relax=relax, **common)]
    elif relax is not None:
        raise InputError("relax does not apply to a chart. Pass relax to Surface.charts instead")
    else:
        maps = [chart.flatten(method, **common) for chart in charts]
    done, count = 0, len(frames)

    def tick() -> None:
        if progress is not None and progress("following the surface", done, count - 1) is False:
            raise Cancelled("following the surface was cancelled")

    follower = Follower(first.core, None if marks is None else marks[reference], tick)
    rest = follower.reference
    if any(rest.nearest(flat.points)[2].max() > _SAME * rest.size for flat in maps):
        raise InputError(f"the chart belongs to another surface. Make it from the surface of frame {reference}")
    moved, gaps, folded = [rest] * count, np.zeros(count), np.zeros(count, dtype=np.int64)
    for order in (range(reference + 1, count), range(reference - 1, -1, -1)):
        places = rest.points
        for frame in order:
            target = Shape(frames[frame].points, np.ascontiguousarray(frames[frame].faces))
            places = follower.onto(places, target, None if marks is None else marks[frame])
            moved[frame] = Shape(places, follower.faces)
            gaps[frame] = np.percentile(Shape(places, follower.faces).nearest(target.points)[2], 95)
            folded[frame] = follower.folded(places, target).sum()
            done += 1
    series = tuple(FlatSeries(flat, *_places(flat, moved, reference), reference, gaps, folded) for flat in maps)
    for warning in series[0].warnings:
        log.warning("%s", warning)
    return series[0] if charts is None or isinstance(cuts, CutSurface) else series


def checked_reference(reference: object, count: int) -> int:
    """Return the number of the reference frame, counted from 0, after checking it."""
    if not is_whole(reference) or not -count <= reference < count:
        raise InputError(f"reference is {shown(reference)}. Pass a frame number from 0 to {count - 1}")
    return range(count)[reference]


def _charts(cuts: object) -> list[CutSurface[Surface]] | None:
    """Return the charts, if cuts are charts."""
    cut_surfaces = [cuts] if isinstance(cuts, CutSurface) else list(cuts) if isinstance(cuts, list | tuple) else []
    return cut_surfaces if cut_surfaces and all(isinstance(cut, CutSurface) for cut in cut_surfaces) else None


def _places(flat_map: FlatMap, moved: list[Shape], reference: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the positions and outward normals (T, N, 3) of the points of a map in all frames."""
    corners, weights, _ = moved[reference].nearest(flat_map.points)
    points = np.stack([shape.mixed(shape.points, corners, weights) for shape in moved])
    normals = np.stack([shape.mixed(shape.normals, corners, weights) for shape in moved])
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    points[reference], normals[reference] = flat_map.points, flat_map.normals
    return points, normals


def _frames(surfaces: Sequence[object], limits: dict[str, Any]) -> list[Surface]:
    """Return the surfaces of the frames, after checking that they can be frames of one movie."""
    if isinstance(surfaces, str | Surface) or not hasattr(surfaces, "__len__"):
        raise InputError(f"surfaces is {shown(surfaces)}. Pass a list of surfaces, one per frame")
    if len(surfaces) < 2:
        fault = "empty" if len(surfaces) == 0 else "a single frame"
        raise InputError(f"the list of surfaces is {fault}. Pass two or more frames, or use flatten for one surface")
    frames: list[Surface] = []
    for number, source in enumerate(surfaces):
        if source is None:
            raise InputError(f"frame {number} is missing (None). Remove it from the list, or pass its surface")
        try:
            frame = surface(source, **limits)
        except InputError as error:
            raise InputError(f"frame {number}: {error}") from error
        named = f"frame {number}{_file(frame)}"
        frame = _largest(frame, named)
        frames.append(frame)
        if (kind := _kind(frame)) != (first := _kind(frames[0])):
            raise InputError(
                f"{named} has {kind}, but frame 0 has {first}. Correct its surface, or split the movie there"
            )
        units = [one.origin.unit for one in (frames[0], frame)]
        if units[0] != units[1]:
            raise InputError(f"{named} is in {units[1]}, but frame 0 is in {units[0]}. Pass unit when reading them")
    return frames


def _largest(of: Surface, named: str) -> Surface:
    """Return the largest component of a surface, if the others are small."""
    areas = of.core.topology()["components"]["area"].tolist()
    if 1 - areas[0] / sum(areas) > STRAY_SHARE:
        sizes = ", ".join(f"{area:.4g}" for area in areas[:5]) + (", ..." if len(areas) > 5 else "")
        problem = in_unit(f"{named} has {len(areas)} components with areas of {sizes} mm²", of.origin.named_unit)
        raise InputError(f"{problem}. Select the label of one, or separate them in the segmentation")
    return largest_piece(of)


def _warn(frames: list[Surface], reference: int) -> None:
    """Log the warnings about the surfaces of all frames but the reference, which is flattened with its own."""
    groups: dict[str, list[tuple[int, str]]] = {}
    for number, frame in enumerate(frames):
        for warning in frame.warnings if number != reference else ():
            if not warning.startswith(MOVED):
                groups.setdefault(re.sub(r"[0-9][0-9.]*", "", warning), []).append((number, warning))
    for (number, warning), *further in groups.values():
        others = f" (and similarly in {listed([one for one, _ in further])})" if further else ""
        log.warning("frame %d%s: %s%s", number, _file(frames[number]), warning, others)


def _file(frame: Surface) -> str:
    """Return the name of the file of a surface in parentheses, if it is known."""
    name = frame.origin.input
    return f" ({os.path.basename(name)})" if name else ""


def _kind(frame: Surface) -> str:
    """Return the topology of a surface in words."""
    topology = frame.core.topology()
    parts, handles, loops = len(topology["components"]), topology["handles"], len(topology["loops"])
    counts = ((parts, "component"), (handles, "handle"), (loops, "boundary loop"))
    return ", ".join(f"{count} {name}{'s' * (count != 1)}" for count, name in counts)
