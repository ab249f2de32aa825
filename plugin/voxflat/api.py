"""The stages as functions: a volume goes in, a flat map comes out."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat import _core
from voxflat._check import advise
from voxflat._errors import InputError
from voxflat._prepare import (
    Prepared,
    Progress,
    amount,
    check_memory,
    checked_seed,
    checked_threads,
    choose_sources,
    log,
    prepare,
    voxel_indices,
)
from voxflat.flatmap import Distortion, Figures, FlatMap

_TORN_WARNING = 0.05  # share of a map

__all__ = ["DistanceRows", "Path", "flatten", "geodesic", "path"]


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
        What the user should know of it is logged (logger ``voxflat``) and stands in ``metadata["warnings"]``.

    Raises
    ------
    InputError
        For anything wrong with the input; the message names the value and the remedy.
    Cancelled
        If `progress` returned False.
    """
    if method != "grossmann2002":
        raise InputError(f"method is {method!r}; give 'grossmann2002'")
    seed = checked_seed(seed)
    threads = checked_threads(threads)
    prepared = prepare(
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
    chosen = choose_sources(prepared, sources, sampling, seed, progress, fewest=3)
    rows_need = 4 * len(chosen) * len(part) if keep_rows else 0
    need = part.memory_need(len(chosen), threads or os.cpu_count() or 1) + rows_need
    check_memory(need, memory_limit, "take a smaller patch or fewer sources")
    log.info("up to %s of memory are needed", amount(need))
    result = part.grossmann2002(chosen, seed, threads, progress)
    faces, torn = part.map_faces(result["uv"], progress)
    warnings = _warn(prepared, result["topology"], float(torn.mean()))
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
        "warnings": warnings,
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
        normals=result["normals"],
        ids=part.voxels.astype(np.int64),
        faces=faces,
        torn=torn,
        sources=chosen.astype(np.int64),
        eigenvalues=result["eigenvalues"],
        distortion=distortion,
        metadata=metadata,
        rows=part.rows(chosen, threads, progress) if keep_rows else None,
    )


def _warn(prepared: Prepared, topology: dict[str, Any], torn: float) -> list[str]:
    """Log and return what the user should know of a map."""
    has_patch = prepared.metadata["keep"] or prepared.metadata["seed_point"] is not None
    warnings = prepared.remarks + advise(
        tuple(prepared.whole.component_sizes()), topology, len(prepared.part), has_patch
    )
    if torn > _TORN_WARNING:
        warnings.append(
            f"{100 * torn:.1f} % of the map is torn: neighbours there are none on the surface; "
            "see the heat map, and take a smaller patch"
        )
    for warning in warnings:
        log.warning(warning)
    return warnings


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
    threads = checked_threads(threads)
    prepared = prepare(
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
    chosen = choose_sources(prepared, sources, sampling, checked_seed(seed), progress, fewest=1)
    check_memory(4 * len(chosen) * len(part), memory_limit, "take fewer sources or a smaller patch")
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
    prepared = prepare(surface, label, threshold, spacing, affine, None, None, None, link_lengths, memory_limit, None)
    whole = prepared.whole
    start, end = (int(vertex) for vertex in whole.find(voxel_indices([a, b], "the ends")))
    try:
        vertices, length = whole.path(start, end)
    except InputError:
        raise InputError(
            f"no path leads from voxel {tuple(map(int, a))} to {tuple(map(int, b))}: they lie in different components "
            "of the surface; choose both ends in one"
        ) from None
    return Path(whole.voxels[vertices].astype(np.int64), whole.points[vertices], float(length))
