"""The stages as functions: a volume goes in, a flat map comes out."""

from __future__ import annotations

import hashlib
import os
import platform
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import psutil
from numpy.typing import ArrayLike, NDArray

from voxflat import _core
from voxflat._errors import InputError
from voxflat._foreground import foreground, labels_in
from voxflat.flatmap import Distortion, Figures, FlatMap
from voxflat.io import Volume, as_volume

__all__ = ["Check", "DistanceRows", "Path", "check", "flatten", "geodesic", "path"]

Progress = Callable[[str, int, int], bool | None]
"""Called as ``progress(stage, done, total)``; returning False cancels."""

_DEFAULT_SOURCES = 1000  # "say 1,000", Grossmann et al. 2002, section 4
_BYTES_PER_VOXEL = 12  # mask, its copy, and the grids of vertices and of cavities
_GIB = 2**30


def flatten(
    surface: object,
    *,
    method: str = "grossmann2002",
    label: int | None = None,
    threshold: float | None = None,
    spacing: Sequence[float] | None = None,
    affine: ArrayLike | None = None,
    keep: object | None = None,
    seed_point: Sequence[int] | None = None,
    radius: float | None = None,
    sources: int | ArrayLike | None = None,
    sampling: str = "farthest",
    link_lengths: str = "chain-code",
    seed: int = 0,
    keep_rows: bool = False,
    threads: int | None = None,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> FlatMap:
    """Flatten a surface into the plane, keeping geodesic distances.

    Parameters
    ----------
    surface : ndarray, path, image object or Volume
        A label volume or an intensity volume (I, J, K): any bool, integer or floating-point type, any strides. The
        surface is made of the foreground voxels with a background voxel (or the volume's border) among their six
        neighbours.
    method : {"grossmann2002"}
        Chain-code geodesics over the 26-neighbour graph of surface voxels, classical scaling of the sources, radial
        functions for the rest (Grossmann, Kiryati, Kimmel 2002).
    label : int, optional
        Foreground is this label.
    threshold : float, optional
        Foreground is what is greater. Without label and threshold the volume must have a single label.
    spacing : sequence of 3 floats, optional
        Voxel size, mm, for volumes without an affine.
    affine : array_like, shape (4, 4), optional
        From voxel indices to RAS+ mm, for volumes without an affine.
    keep : ndarray, path, image object or Volume, optional
        A mask of the volume's shape: only the surface voxels where it is not 0 are flattened.
    seed_point : sequence of 3 ints, optional
        Voxel indices; the surface within `radius` of the nearest surface voxel is flattened.
    radius : float, optional
        Radius of the geodesic disk around `seed_point`, mm along the surface.
    sources : int or array_like of shape (m, 3), optional
        How many points distances are measured from (at most, and by default, 1000 or all points), or their voxel
        indices.
    sampling : {"farthest", "random"}
        How sources are chosen: evenly, each farthest from the others along the surface, or at random.
    link_lengths : {"chain-code", "euclidean"}
        Lengths of the links between neighbouring voxels: the paper's unbiased estimator (0.9016, 1.289, 1.615 voxels,
        or its generalisation to anisotropic voxels), or 1, √2, √3 for comparison.
    seed : int
        Seed of every random choice. The same seed gives the same map, bit by bit, for any number of threads.
    keep_rows : bool
        Keep the distances from all sources to all points in `FlatMap.rows`.
    threads : int, optional
        By default one a core.
    memory_limit : int, optional
        Bytes that may be used; by default what is free. The need is computed before the start.
    progress : callable, optional
        Called as ``progress(stage, done, total)`` about every 20 ms; if it returns False the work is cancelled.

    Returns
    -------
    FlatMap

    Raises
    ------
    InputError
        For anything wrong with the input; the message names the value and the remedy.
    Cancelled
        If `progress` returned False.
    """
    if method != "grossmann2002":
        raise InputError(f"method is {method!r}; give 'grossmann2002'")
    seed = _checked_seed(seed)
    threads = _checked_threads(threads)
    prepared = _prepare(
        surface,
        label,
        threshold,
        spacing,
        affine,
        keep,
        seed_point,
        radius,
        link_lengths,
        memory_limit,
        progress,
    )
    part = prepared.part
    part.check_flattenable(progress)  # the first reason to refuse is the one that matters
    chosen = _choose_sources(prepared, sources, sampling, seed, progress)
    rows_need = 4 * len(chosen) * len(part) if keep_rows else 0
    need = part.memory_need(len(chosen), threads or os.cpu_count() or 1) + rows_need
    _check_memory(need, memory_limit, "take a smaller patch or fewer sources")
    result = part.grossmann2002(chosen, seed, threads, progress)
    faces, torn = part.map_faces(result["uv"], progress)
    figures = result["distortion"]
    distortion = Distortion(
        raw=Figures(**figures.pop("raw")), best_scale=Figures(**figures.pop("best_scale")), **figures
    )
    metadata = {
        "method": method,
        **prepared.metadata,
        "seed": seed,
        "sources": len(chosen),
        "sampling": sampling if sources is None or isinstance(sources, int | np.integer) else "given",
        "planarity": result["planarity"],
        "topology": result["topology"],
        "torn_faces": float(torn.mean()),
        "memory_need_bytes": need,
        "versions": {
            "voxflat": _core.__version__,
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
    }
    return FlatMap(
        uv=result["uv"],
        points=part.points,
        ids=part.voxels.astype(np.int64),
        faces=faces,
        torn=torn,
        sources=chosen.astype(np.int64),
        eigenvalues=result["eigenvalues"],
        distortion=distortion,
        metadata=metadata,
        rows=part.rows(chosen, threads, progress) if keep_rows else None,
    )


@dataclass(frozen=True, eq=False)
class DistanceRows:
    """Geodesic distances from sources to all points of a surface; converts to an array.

    Parameters
    ----------
    rows : ndarray of float32, shape (m, N)
        Distances, mm.
    ids : ndarray of int64, shape (N, 3)
        Voxel indices of the points.
    points : ndarray of float64, shape (N, 3)
        The points, RAS+ mm.
    sources : ndarray of int64, shape (m,)
        The sources, as numbers into the points.
    """

    rows: NDArray[np.float32]
    ids: NDArray[np.int64]
    points: NDArray[np.float64]
    sources: NDArray[np.int64]

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of sources and of points."""
        return (self.rows.shape[0], self.rows.shape[1])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.rows, dtype=dtype) if copy else np.asarray(self.rows, dtype=dtype)

    def __getitem__(self, index: Any) -> Any:
        return self.rows[index]

    def __len__(self) -> int:
        """Return the number of sources."""
        return len(self.rows)


def geodesic(
    surface: object,
    sources: int | ArrayLike,
    *,
    geodesic: str = "chain",
    label: int | None = None,
    threshold: float | None = None,
    spacing: Sequence[float] | None = None,
    affine: ArrayLike | None = None,
    keep: object | None = None,
    seed_point: Sequence[int] | None = None,
    radius: float | None = None,
    sampling: str = "farthest",
    link_lengths: str = "chain-code",
    seed: int = 0,
    threads: int | None = None,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> DistanceRows:
    """Measure geodesic distances from sources to all points of a surface.

    Parameters
    ----------
    surface, label, threshold, spacing, affine, keep, seed_point, radius, sampling, link_lengths, seed, threads, \
memory_limit, progress
        As in `flatten`. Without a patch the surface is the largest component; it may be closed.
    sources : int or array_like of shape (m, 3)
        How many sources to choose, or their voxel indices.
    geodesic : {"chain"}
        Chain-code lengths over the 26-neighbour graph.

    Returns
    -------
    DistanceRows

    Raises
    ------
    InputError, Cancelled
        As in `flatten`.
    """
    if geodesic != "chain":
        raise InputError(f"geodesic is {geodesic!r}; give 'chain'")
    threads = _checked_threads(threads)
    prepared = _prepare(
        surface,
        label,
        threshold,
        spacing,
        affine,
        keep,
        seed_point,
        radius,
        link_lengths,
        memory_limit,
        progress,
    )
    part = prepared.part
    chosen = _choose_sources(prepared, sources, sampling, _checked_seed(seed), progress)
    _check_memory(4 * len(chosen) * len(part), memory_limit, "take fewer sources or a smaller patch")
    rows = part.rows(chosen, threads, progress)
    return DistanceRows(rows, part.voxels.astype(np.int64), part.points, chosen.astype(np.int64))


@dataclass(frozen=True, eq=False)
class Path:
    """A shortest path over a surface.

    Parameters
    ----------
    ids : ndarray of int64, shape (k, 3)
        The voxels it passes, both ends included.
    points : ndarray of float64, shape (k, 3)
        Their centres, RAS+ mm.
    length : float
        mm.
    """

    ids: NDArray[np.int64]
    points: NDArray[np.float64]
    length: float


def path(
    surface: object,
    a: Sequence[int],
    b: Sequence[int],
    *,
    label: int | None = None,
    threshold: float | None = None,
    spacing: Sequence[float] | None = None,
    affine: ArrayLike | None = None,
    link_lengths: str = "chain-code",
    memory_limit: int | None = None,
) -> Path:
    """Find a shortest path between two surface voxels (Grossmann et al. 2002, figure 3).

    Parameters
    ----------
    surface, label, threshold, spacing, affine, link_lengths, memory_limit
        As in `flatten`.
    a, b : sequence of 3 ints
        Voxel indices of the ends.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        If an end is not on the surface, or the ends lie in different components.
    """
    prepared = _prepare(surface, label, threshold, spacing, affine, None, None, None, link_lengths, memory_limit, None)
    whole = prepared.whole
    start, end = (int(vertex) for vertex in whole.find(_voxel_indices([a, b], "the ends")))
    vertices, length = whole.path(start, end)
    return Path(whole.voxels[vertices].astype(np.int64), whole.points[vertices], float(length))


@dataclass(frozen=True)
class Check:
    """What was read, and whether its surface can be flattened.

    Parameters
    ----------
    path : str or None
        The file.
    shape : tuple of 3 ints
        Voxels along each axis.
    dtype : str
        Type of the values.
    spacing : tuple of 3 floats
        Voxel size, mm.
    orientation : str
        Directions of the axes, such as "RAS".
    affine : list of 4 lists of 4 floats
        From voxel indices to RAS+ mm.
    labels : dict of int to int, or None
        Labels and their numbers of voxels; None for intensities.
    range : tuple of 2 floats
        Smallest and largest value.
    foreground : int or None
        Number of foreground voxels; None if label or threshold are still to be chosen.
    surface_voxels : int or None
        Number of surface voxels.
    components : tuple of int
        Numbers of surface voxels of the components, largest first; the first one (or the patch) is used.
    used : int or None
        Number of surface voxels that would be flattened.
    euler_characteristic : int or None
        χ of what would be flattened: 1 is a disk, 2 a closed sphere; every handle, hole and touching bank takes one
        away.
    cavities : int or None
        Enclosed cavities of what would be flattened.
    closed : bool or None
        Whether it is a closed surface.
    can_flatten : bool
        The verdict.
    advice : tuple of str
        What to do.
    """

    path: str | None
    shape: tuple[int, ...]
    dtype: str
    spacing: tuple[float, ...]
    orientation: str
    affine: list[list[float]]
    labels: dict[int, int] | None
    range: tuple[float, float]
    foreground: int | None
    surface_voxels: int | None
    components: tuple[int, ...]
    used: int | None
    euler_characteristic: int | None
    cavities: int | None
    closed: bool | None
    can_flatten: bool
    advice: tuple[str, ...]

    def table(self) -> str:
        """Return the findings as a table of text."""
        labels = "intensities" if self.labels is None else _shortened([f"{k} ({n})" for k, n in self.labels.items()])
        rows = [
            ("input", self.path or "array"),
            ("shape", " x ".join(str(n) for n in self.shape) + f", {self.dtype}"),
            ("spacing", " x ".join(f"{h:g}" for h in self.spacing) + " mm"),
            ("orientation", self.orientation),
            ("values", f"{self.range[0]:g} to {self.range[1]:g}"),
            ("labels (voxels)", labels),
        ]
        if self.foreground is not None:
            rows += [
                ("foreground", f"{self.foreground} voxels"),
                ("surface", f"{self.surface_voxels} voxels"),
                ("components", f"{len(self.components)}: {_shortened([str(n) for n in self.components], 5)}"),
                ("used", f"{self.used} voxels"),
                ("Euler characteristic", f"{self.euler_characteristic} (disk: 1, closed sphere: 2)"),
                ("closed", "yes" if self.closed else "no"),
            ]
        rows.append(("can be flattened", "yes" if self.can_flatten else "no"))
        text = [f"{name:22}{value}" for name, value in rows]
        return "\n".join(text + [f"- {advice}" for advice in self.advice])


def check(
    surface: object,
    *,
    label: int | None = None,
    threshold: float | None = None,
    spacing: Sequence[float] | None = None,
    affine: ArrayLike | None = None,
    keep: object | None = None,
    seed_point: Sequence[int] | None = None,
    radius: float | None = None,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> Check:
    """Say what a volume holds and whether its surface can be flattened.

    Parameters
    ----------
    surface, label, threshold, spacing, affine, keep, seed_point, radius, memory_limit, progress
        As in `flatten`.

    Returns
    -------
    Check

    Raises
    ------
    InputError
        If the volume cannot be read, or a label, threshold or patch was given that does not fit.
    """
    volume = as_volume(surface, spacing=spacing, affine=affine)
    _check_scalar(volume)
    what_is_there: dict[str, Any] = {
        "path": None if volume.path is None else str(volume.path),
        "shape": volume.data.shape,
        "dtype": str(volume.data.dtype),
        "spacing": tuple(float(h) for h in volume.spacing),
        "orientation": volume.orientation,
        "affine": volume.affine.tolist(),
        "labels": labels_in(volume.data),
        "range": (float(volume.data.min()), float(volume.data.max())),
    }
    nothing: dict[str, Any] = dict.fromkeys(
        ("foreground", "surface_voxels", "used", "euler_characteristic", "cavities", "closed")
    )
    if label is None and threshold is None:
        try:
            foreground(volume.data)
        except InputError as error:
            return Check(**what_is_there, **nothing, components=(), can_flatten=False, advice=(str(error),))
    prepared = _prepare(
        volume, label, threshold, None, None, keep, seed_point, radius, "chain-code", memory_limit, progress
    )
    sizes = tuple(prepared.whole.component_sizes())
    topology = prepared.part.topology(progress)
    has_patch = keep is not None or seed_point is not None
    return Check(
        **what_is_there,
        foreground=prepared.foreground,
        surface_voxels=len(prepared.whole),
        components=sizes,
        used=len(prepared.part),
        **topology,
        can_flatten=not topology["closed"] and len(prepared.part) >= 3,
        advice=tuple(_advice(sizes, topology, len(prepared.part), has_patch)),
    )


def _advice(sizes: tuple[int, ...], topology: dict[str, Any], used: int, has_patch: bool) -> list[str]:
    advice = []
    if len(sizes) > 1 and not has_patch:
        advice.append(f"{len(sizes)} components: the largest, {used} of {sum(sizes)} surface voxels, is used")
    if used < 3:
        advice.append(f"only {used} surface voxels: take a larger label or patch")
    if topology["closed"]:
        advice.append(
            "closed surface: cut out a patch with a seed point and a radius in mm, or with a mask of what to keep"
        )
    elif topology["euler_characteristic"] != 1:
        advice.append(
            f"Euler characteristic {topology['euler_characteristic']} instead of a disk's 1: the patch has holes, "
            "handles, or banks that touch; distances jump across touching banks. A smaller patch or a finer volume helps"
        )
    return advice


@dataclass(frozen=True)
class _Prepared:
    """A volume's surface, the part of it that is worked on, and how they came about."""

    whole: _core.VoxelSurface
    part: _core.VoxelSurface
    foreground: int
    metadata: dict[str, Any]


def _prepare(
    surface: object,
    label: int | None,
    threshold: float | None,
    spacing: Sequence[float] | None,
    affine: ArrayLike | None,
    keep: object | None,
    seed_point: Sequence[int] | None,
    radius: float | None,
    link_lengths: str,
    memory_limit: int | None,
    progress: Progress | None,
) -> _Prepared:
    if (seed_point is None) != (radius is None):
        given, missing = ("a seed point", "a radius in mm") if radius is None else ("a radius", "a seed point")
        raise InputError(f"{given} is given without {missing}; give both or neither")
    volume = as_volume(surface, spacing=spacing, affine=affine)
    _check_scalar(volume)
    shape = volume.data.shape
    _check_memory(_BYTES_PER_VOXEL * volume.data.size, memory_limit, "crop or downsample the volume")
    mask = foreground(volume.data, label=label, threshold=threshold)
    kept = None if keep is None else _keep_mask(keep, volume)
    seed = None if seed_point is None else _voxel_indices([seed_point], "the seed point")[0].tolist()
    whole = _core.VoxelSurface.from_mask(mask, volume.affine.tolist(), link_lengths, progress)
    part = whole.cut_out(kept, seed, None if radius is None else float(radius), progress)
    metadata = {
        "input": None if volume.path is None else str(volume.path),
        "input_sha256": hashlib.sha256(np.packbits(mask).tobytes() + str(shape).encode()).hexdigest(),
        "shape": [int(n) for n in shape],
        "affine": volume.affine.tolist(),
        "label": None if label is None else int(label),
        "threshold": None if threshold is None else float(threshold),
        "seed_point": seed,
        "radius": None if radius is None else float(radius),
        "keep": kept is not None,
        "link_lengths": link_lengths,
        "surface_voxels": len(whole),
        "components": whole.component_sizes()[:100],
        "points": len(part),
    }
    return _Prepared(whole, part, int(np.count_nonzero(mask)), metadata)


def _check_scalar(volume: Volume) -> None:
    if volume.data.ndim != 3:
        raise InputError(f"the volume has shape {volume.data.shape}: colours have no label; give one value a voxel")
    if volume.data.size == 0:
        raise InputError(f"the volume has shape {volume.data.shape}: it holds no voxel")


def _keep_mask(keep: object, volume: Volume) -> NDArray[np.bool_]:
    mask = as_volume(keep)
    if mask.data.shape != volume.data.shape:
        raise InputError(
            f"the mask to keep has shape {mask.data.shape}, the volume {volume.data.shape}; they must agree"
        )
    placed = mask.path is not None or not isinstance(keep, np.ndarray)
    if placed and not np.allclose(mask.affine, volume.affine, atol=1e-3 * volume.spacing.min()):
        raise InputError("the mask to keep lies elsewhere than the volume (their affines differ); resample it first")
    if not mask.data.any():
        raise InputError("the mask to keep is empty: every voxel is 0")
    return np.asarray(mask.data != 0)


def _choose_sources(
    prepared: _Prepared,
    sources: int | ArrayLike | None,
    sampling: str,
    seed: int,
    progress: Progress | None,
) -> NDArray[np.uint32]:
    part = prepared.part
    if sources is None:
        sources = min(_DEFAULT_SOURCES, len(part))
    if isinstance(sources, int | np.integer):
        if sources < 3:
            raise InputError(f"{sources} sources are too few; give at least 3")
        if sources > len(part):
            raise InputError(
                f"{sources} sources are more than the {len(part)} voxels of the surface; give at most that many"
            )
        return part.choose_sources(sampling, int(sources), seed, progress)
    voxels = _voxel_indices(sources, "sources")
    unique, counts = np.unique(voxels, axis=0, return_counts=True)
    if (counts > 1).any():
        raise InputError(f"source {unique[counts > 1][0].tolist()} is given {counts.max()} times; give each once")
    on_surface = prepared.whole.find(voxels)  # names a voxel that is not on the surface at all
    try:
        return part.find(voxels)
    except InputError:
        inside = {tuple(voxel) for voxel in part.voxels.tolist()}
        outside = next(v for v in prepared.whole.voxels[on_surface].tolist() if tuple(v) not in inside)
        raise InputError(
            f"source {outside} is on the surface, but outside the patch or component that is used "
            f"({len(part)} of {len(prepared.whole)} surface voxels); choose sources inside it"
        ) from None


def _voxel_indices(values: ArrayLike, name: str) -> NDArray[np.int64]:
    array = np.asarray(values)
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(f"{name} must be voxel indices of shape (m, 3), not {array.shape}")
    if array.dtype.kind not in "ui":
        raise InputError(f"{name} must be whole voxel indices, not {array.dtype}")
    return np.ascontiguousarray(array, dtype=np.int64)


def _check_memory(need: int, limit: int | None, remedy: str) -> None:
    allowed = psutil.virtual_memory().available if limit is None else limit
    if need > allowed:
        kind = "are free" if limit is None else "is the limit"
        raise InputError(f"{need / _GIB:.2f} GiB of memory are needed, {allowed / _GIB:.2f} GiB {kind}; {remedy}")


def _checked_seed(seed: int) -> int:
    if not 0 <= seed < 2**64:
        raise InputError(f"the seed is {seed}; give a whole number from 0 to 2**64 - 1")
    return int(seed)


def _checked_threads(threads: int | None) -> int | None:
    if threads is not None and threads < 1:
        raise InputError(f"threads is {threads}; give at least 1, or nothing for one a core")
    return threads


def _shortened(items: list[str], most: int = 12) -> str:
    return ", ".join(items[:most]) + (f" and {len(items) - most} more" if len(items) > most else "")
