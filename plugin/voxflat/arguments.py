"""From whatever the user gives to the part of a surface that is worked on; every input is checked here."""

from __future__ import annotations

import hashlib
import logging
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any

import numpy as np
import psutil
from numpy.typing import ArrayLike, NDArray

from voxflat import _core
from voxflat.errors import InputError
from voxflat.io.volumes import Volume, as_volume
from voxflat.surfaces.foreground import foreground

if TYPE_CHECKING:
    from voxflat.surfaces.surface import Surface

Progress = Callable[[str, int, int], bool | None]
"""Called as ``progress(stage, done, total)``; returning False cancels."""

_DEFAULT_SOURCES = 1000  # "say 1,000", Grossmann et al. 2002, section 4
BYTES_PER_VOXEL = 12  # mask, its copy, and the grids of vertices and of cavities
_MOST_THREADS = 256  # far more than cores only take turns, and starting them takes minutes

log = logging.getLogger("voxflat")
"""Says what memory is needed, and warns of what the user should know of a map."""


@dataclass(frozen=True)
class Prepared:
    """A volume's surface, the part of it that is worked on, and how they came about."""

    whole: _core.VoxelSurface
    part: _core.VoxelSurface
    foreground: int
    metadata: dict[str, Any]
    remarks: list[str]


def prepare(
    surface: object,
    label: int | None,
    threshold: float | None,
    spacing: Sequence[float] | None,
    affine: ArrayLike | None,
    keep: object | None = None,
    seed_point: Any = None,
    radius: float | None = None,
    *,
    link_lengths: str,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> Prepared:
    """Check the arguments of the voxel methods that say what to flatten, and cut it out."""
    if (seed_point is None) != (radius is None):
        given, missing = ("a seed point", "a radius in mm") if radius is None else ("a radius", "a seed point")
        raise InputError(f"{given} is given without {missing}; give both or neither")
    for name, value in (("threshold", threshold), ("radius", radius), ("memory limit", memory_limit)):
        if value is not None and not isinstance(value, Real):
            raise InputError(f"the {name} is {value!r}; give a number")
    if label is not None and not isinstance(label, Integral):
        raise InputError(f"the label is {label!r}; give a whole number, or a threshold for intensities")
    volume = as_volume(surface, spacing=spacing, affine=affine)
    check_scalar(volume)
    shape = volume.data.shape
    check_memory(BYTES_PER_VOXEL * volume.data.size, memory_limit, "crop or downsample the volume")
    mask = foreground(volume.data, label=label, threshold=threshold)
    kept = None if keep is None else keep_mask(keep, volume)
    seed = None if seed_point is None else voxel_indices([seed_point], "the seed point")[0].tolist()
    whole = _core.VoxelSurface.from_mask(mask, volume.affine.tolist(), link_lengths, progress)
    part = whole.cut_out(kept, seed, None if radius is None else float(radius), progress)
    seed_voxel, remarks = (None, []) if seed is None else _seed_voxel(whole, seed, volume.spacing.max())
    components = whole.component_sizes()
    metadata = {
        "kind": "voxels",
        "input": None if volume.path is None else str(volume.path),
        "input_sha256": hashlib.sha256(np.packbits(mask).tobytes() + str(shape).encode()).hexdigest(),
        "shape": [int(n) for n in shape],
        "affine": volume.affine.tolist(),
        "label": None if label is None else int(label),
        "threshold": None if threshold is None else float(threshold),
        "seed_point": seed,
        "seed_found": seed_voxel,
        "radius": None if radius is None else float(radius),
        "keep": kept is not None,
        "link_lengths": link_lengths,
        "surface_points": len(whole),
        "components": len(components),
        "largest_components": components[:10],
        "points": len(part),
    }
    return Prepared(whole, part, int(np.count_nonzero(mask)), metadata, remarks)


def _seed_voxel(whole: _core.VoxelSurface, seed: list[int], voxel_size: float) -> tuple[list[int], list[str]]:
    """Return the surface voxel that a seed point stands for, and a remark if it lies elsewhere."""
    vertex, distance = whole.nearest(seed)
    voxel = [int(index) for index in whole.voxels[vertex]]
    if distance <= 2 * voxel_size:
        return voxel, []
    return voxel, [
        f"the seed point {seed} is {distance:.1f} mm away from the surface; its nearest voxel {voxel} is taken"
    ]


def check_scalar(volume: Volume) -> None:
    """Refuse what has not one value a voxel."""
    if volume.data.ndim != 3:
        raise InputError(f"the volume has shape {volume.data.shape}: colours have no label; give one value a voxel")
    if volume.data.size == 0:
        raise InputError(f"the volume has shape {volume.data.shape}: it holds no voxel")


def keep_mask(keep: object, volume: Volume) -> NDArray[np.bool_]:
    """Return a mask of what to keep that lies on a volume's grid."""
    mask = as_volume(keep)
    if mask.data.shape != volume.data.shape:
        raise InputError(
            f"the mask to keep has shape {mask.data.shape}, the volume {volume.data.shape}; they must agree"
        )
    if mask.is_placed and not np.allclose(mask.affine, volume.affine, atol=1e-3 * volume.spacing.min()):
        raise InputError("the mask to keep lies elsewhere than the volume (their affines differ); resample it first")
    if np.isnan(mask.data).any():
        raise InputError("the mask to keep has NaN; write 0 where nothing is kept and 1 elsewhere")
    if not mask.data.any():
        raise InputError("the mask to keep is empty: every voxel is 0")
    return np.asarray(mask.data != 0)


def choose_sources(
    prepared: Prepared,
    sources: int | ArrayLike | None,
    sampling: str,
    seed: int,
    progress: Progress | None,
    *,
    fewest: int,
) -> NDArray[np.uint32]:
    """Return the sources as numbers into the part's points."""
    part = prepared.part
    if sources is None:
        sources = min(_DEFAULT_SOURCES, len(part))
    if isinstance(sources, int | np.integer):
        if sources < fewest:
            raise InputError(f"{sources} sources are too few; give at least {fewest}")
        if sources > len(part):
            raise InputError(
                f"{sources} sources are more than the {len(part)} voxels of the surface; give at most that many"
            )
        return part.choose_sources(sampling, int(sources), seed, progress)
    voxels = voxel_indices(sources, "sources")
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


def sources_on(
    part: Surface,
    sources: int | ArrayLike | None,
    sampling: str,
    seed: int,
    progress: Progress | None,
    *,
    fewest: int,
    usual: int,
) -> NDArray[np.uint32]:
    """Return the sources as numbers into a surface's vertices."""
    count = source_count(part, sources, fewest=fewest, usual=usual)
    if count is not None:
        return part.core.choose_sources(sampling, count, seed, progress)
    assert sources is not None
    found = part.find(sources, "sources")
    unique, counts = np.unique(found, return_counts=True)
    if (counts > 1).any():
        again = part.ids[unique[counts > 1][0]].tolist()
        raise InputError(f"source {again} is given {counts.max()} times; give each once")
    return found


def source_count(part: Surface, sources: int | ArrayLike | None, *, fewest: int, usual: int) -> int | None:
    """Return how many sources are to be chosen; None if they are given."""
    if sources is None:
        return min(usual, len(part))
    if not isinstance(sources, int | np.integer):
        return None
    if sources < fewest:
        raise InputError(f"{sources} sources are too few; give at least {fewest}")
    if sources > len(part):
        raise InputError(
            f"{sources} sources are more than the {len(part)} points of the surface; give at most that many"
        )
    return int(sources)


def voxel_indices(values: ArrayLike, name: str) -> NDArray[np.int64]:
    """Return voxel indices of shape (m, 3)."""
    array = np.asarray(values)
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(f"{name} must be voxel indices of shape (m, 3), not {array.shape}")
    if array.dtype.kind not in "ui":
        raise InputError(f"{name} must be whole voxel indices, not {array.dtype}")
    return np.ascontiguousarray(array, dtype=np.int64)


def check_memory(need: int, limit: int | None, remedy: str) -> None:
    """Refuse to start where there is not enough memory."""
    allowed = psutil.virtual_memory().available if limit is None else limit
    if need > allowed:
        kind = "are free" if limit is None else "is the limit"
        raise InputError(f"{amount(need)} of memory are needed, {amount(allowed)} {kind}; {remedy}")


def amount(size: float) -> str:
    """Return an amount of memory as text."""
    for unit in ("bytes", "KiB", "MiB"):
        if size < 1024:
            return f"{size:.4g} {unit}"
        size /= 1024
    return f"{size:.2f} GiB"


def checked_seed(seed: int) -> int:
    """Return a seed that the core takes."""
    if not isinstance(seed, Integral) or not 0 <= seed < 2**64:
        raise InputError(f"the seed is {seed!r}; give a whole number from 0 to 2**64 - 1")
    return int(seed)


def checked_threads(threads: int | None) -> int | None:
    """Return a number of threads that can be started."""
    most = max(_MOST_THREADS, os.cpu_count() or 1)
    if threads is not None and not (isinstance(threads, Integral) and 1 <= threads <= most):
        raise InputError(f"threads is {threads!r}; give at least 1, at most {most}, or nothing for one a core")
    return threads
