"""Sample a volume at positions in space: in memory, or in chunks, each of which is read once."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from voxflat.arguments import checked_choice, checked_number
from voxflat.errors import InputError
from voxflat.io.chunks import PLACE_BYTES, Chunked, voxels_at
from voxflat.io.reading import check_room
from voxflat.io.volumes import Volume
from voxflat.maps.depth import ON_SURFACE, Depths
from voxflat.maps.missing import NAN_POLICIES, is_defined, mean_of_known

_Floats = NDArray[np.float64]

INTERPOLATIONS = ("linear", "nearest", "majority")  # interpolation between voxels or vertices
PROJECTIONS = ("mean", "max", "sum")  # of layers onto one image

_CORNERS = np.array(list(np.ndindex(2, 2, 2)), dtype=np.int32)
_BLOCK = 1 << 16  # positions whose weights are in memory at a time
_ROUNDING = 1e-3  # voxels, by which affines in single precision may misplace centres
_CANCELLED = 1e-6  # a mean of unit vectors shorter than this has no direction


@dataclass(frozen=True)
class Sampling:
    """How values are sampled: options of `FlatMap.images`, which are checked here."""

    depths: Depths = ON_SURFACE
    projection: str | None = None  # one of `PROJECTIONS`; None for one image per depth
    interpolation: str | None = None  # one of `INTERPOLATIONS`; None for the default of each channel
    period: float | None = None  # of phases
    nan_policy: str = "omit"  # one of `NAN_POLICIES`, for depths without a value
    default: Callable[[int], str | None] | None = None  # interpolation of a channel, if a series determines it

    def __post_init__(self) -> None:
        for name, choices in (("projection", PROJECTIONS), ("interpolation", INTERPOLATIONS)):
            if getattr(self, name) is not None:
                checked_choice(getattr(self, name), name, choices)
        checked_choice(self.nan_policy, "nan_policy", NAN_POLICIES)
        if self.period is not None:
            if not (math.isfinite(checked_number(self.period, "period")) and self.period > 0):
                raise InputError(f"period is {self.period:g}. Pass a positive number, such as 360 for degrees")
            if self.projection not in (None, "mean"):
                problem = f"projection is {self.projection!r}, but phases have only a mean over depths"
                raise InputError(f"{problem}. Pass 'mean'")
            if self.interpolation == "majority":
                raise InputError("interpolation is 'majority', which is for labels, not for phases. Pass 'linear'")
            object.__setattr__(self, "interpolation", self.interpolation or "linear")
        if len(self.depths) == 1:
            object.__setattr__(self, "projection", "mean")


def sample(volume: Volume, points: _Floats, interpolation: str | None = None) -> NDArray[Any]:
    """Sample a volume at positions (..., 3) in RAS+ mm; NaN (for colours, alpha 0) outside it. See `FlatMap.image`."""
    data, way = volume.data, way_of(volume.data, interpolation)
    order = int(way == "linear")
    index, inside = _indices(volume, points)
    index = index[inside]
    if data.ndim == 3:
        image = np.full(inside.shape, np.nan)
        by_voxels = isinstance(data, Chunked) or way == "majority"
        image[inside] = _by_voxels(data, index, way) if by_voxels else interpolated(data, index.T, order)
        return image
    rgba = np.zeros((*inside.shape, 4), dtype=np.uint8)
    rgba[inside, 3] = 255
    for c in range(data.shape[3]):
        rgba[inside, c] = np.round(np.nan_to_num(interpolated(data[..., c], index.T, order)))
    return rgba


def interpolated(values: NDArray[Any], index: Any, order: int = 1, mode: str = "nearest") -> _Floats:
    """Interpolate an array at indices, shape (axes, ...): linearly (order 1) or at the nearest element (order 0)."""
    if values.dtype.kind == "f" and values.dtype.itemsize not in (4, 8):  # SciPy does not support other types
        values = values.astype(np.float64)
    sampled: _Floats = scipy.ndimage.map_coordinates(values, index, output=np.float64, order=order, mode=mode)
    return sampled


def _indices(volume: Volume, points: _Floats) -> tuple[_Floats, NDArray[np.bool_]]:
    """Return voxel indices of positions, and whether they lie in the volume (up to half a voxel beyond centres)."""
    inverse = np.linalg.inv(volume.affine)
    where = points @ inverse[:3, :3].T + inverse[:3, 3]
    size = np.asarray(volume.data.shape[:3])
    return where, np.all((where >= -0.5 - 1e-6) & (where <= size - 0.5 + 1e-6), axis=-1)


def voxels_of(volume: Volume, points: _Floats) -> NDArray[np.int32]:
    """Return the indices (P, 3) of voxels beside positions, or of the nearest ones for positions outside."""
    where, _ = _indices(volume, points)
    return _lowest(where, volume.data)


def are_centres(volume: Volume, points: _Floats) -> bool:
    """Return whether positions (P, 3) are centres of voxels, where no interpolation is needed."""
    where, _ = _indices(volume, points)
    return bool((np.abs(where - np.rint(where)) < _ROUNDING).all())


def are_intensities(volume: Volume, points: _Floats) -> bool:
    """Return whether integers around positions (P, 3) are intensities rather than labels, which form areas.

    Most neighbouring voxels have the same label, whereas intensities differ. Pairs with a zero, which is background in
    both, do not count.
    """
    where, inside = _indices(volume, points)
    values = voxels_at(volume.data, _lowest(where[inside], volume.data), _CORNERS[[0, 1, 2, 4]])
    first, others = values[:, :1], values[:, 1:]
    counts = (first != 0) & (others != 0)
    return bool(2 * np.count_nonzero(counts & (first == others)) <= np.count_nonzero(counts))


def _by_voxels(data: Any, places: _Floats, interpolation: str) -> _Floats:
    """Sample from the voxels around each position, shape (P,)."""
    if interpolation == "nearest":
        near = np.maximum(np.floor(places + 0.5), 0).astype(np.int32)
        return voxels_at(data, near, _CORNERS[:1])[:, 0].astype(np.float64)
    if interpolation == "majority":
        return majority_at(data, places[:, None])
    values, low = _around(data, places)
    sampled = np.empty(len(places))
    for first in range(0, len(places), _BLOCK):
        part = slice(first, first + _BLOCK)
        sampled[part] = (values[part].astype(np.float64) * _weights(places[part], low[part], data)).sum(axis=1)
    return sampled


def majority_at(data: Any, places: _Floats, inside: NDArray[np.bool_] | None = None) -> _Floats:
    """Return the label with the greatest total weight around each set of K positions (P, K, 3) that are inside."""
    count = places.shape[1]
    values, low = _around(data, places.reshape(-1, 3))
    values = values.reshape(-1, 8 * count)
    _check_labels(values)
    sampled = values[:, 0].astype(np.float64)
    mixed = (values != values[:, :1]).any(axis=1)  # elsewhere all labels agree, and weights are not needed
    weights = _weights(places[mixed].reshape(-1, 3), low.reshape(-1, count, 3)[mixed].reshape(-1, 3), data)
    if inside is not None:
        weights *= inside[mixed].reshape(-1, 1)
    sampled[mixed] = majority(values[mixed], weights.reshape(-1, 8 * count))
    return sampled


def _around(data: Any, places: _Floats) -> tuple[NDArray[Any], NDArray[np.int32]]:
    """Return the values of the eight voxels around each position, shape (P, 8), and the indices of the lowest one."""
    low = _lowest(places, data)
    return voxels_at(data, low, _CORNERS), low


def _lowest(places: _Floats, data: Any) -> NDArray[np.int32]:
    """Return the lowest indices of the eight voxels around each position; the other indices are one greater."""
    return np.floor(np.clip(places, 0, np.asarray(data.shape[:3]) - 1)).astype(np.int32)


def _weights(places: _Floats, low: NDArray[np.int32], data: Any) -> _Floats:
    """Return the weights of the eight voxels; values are constant beyond the outermost centres."""
    beyond = np.clip(places, 0, np.asarray(data.shape[:3]) - 1) - low
    i, j, k = (np.stack([1 - part, part], axis=1) for part in beyond.T)
    return np.asarray((i[:, :, None, None] * j[:, None, :, None] * k[:, None, None, :]).reshape(-1, 8))


def majority(values: NDArray[Any], weights: NDArray[np.floating[Any]]) -> _Floats:
    """Return the label with the greatest weight in each row; for equal weights, the smallest label."""
    _check_labels(values)
    winners = values[:, 0].astype(np.float64)
    mixed = np.flatnonzero((values != values[:, :1]).any(axis=1))  # elsewhere all labels agree
    labels, which = np.unique(values[mixed], return_inverse=True)
    count = max(len(labels), 1)
    rows = np.repeat(np.arange(len(mixed), dtype=np.int64), values.shape[1])
    keys, item = np.unique(rows * count + which.ravel(), return_inverse=True)
    total = np.bincount(item.ravel(), weights[mixed].ravel())
    order = np.lexsort((keys, -np.round(total, 12), keys // count))
    first = np.flatnonzero(np.diff(keys[order] // count, prepend=-1))
    winners[mixed] = labels[keys[order][first] % count]
    return winners


def _check_labels(values: NDArray[Any]) -> None:
    if values.dtype.kind == "f" and not np.array_equal(values, np.round(values)):
        raise InputError("interpolation is 'majority', but the values are not labels (whole numbers). Pass 'linear'")


@dataclass
class Coverage:
    """Count the positions with values at any depth, and those with values at only some of the depths."""

    any: int = 0
    some: int = 0

    def add(self, has_value: NDArray[np.bool_]) -> None:
        """Count positions; the first axis is the depth."""
        is_any = has_value.any(axis=0)
        self.any += int(np.count_nonzero(is_any))
        self.some += int(np.count_nonzero(is_any & ~has_value.all(axis=0)))


def sample_depths(volume: Volume, places: Sequence[_Floats], sampling: Sampling, coverage: Coverage) -> NDArray[Any]:
    """Sample a volume at several depths, as `sample` does; return each depth (first axis), or their projection.

    The mean of labels is the majority. Positions without a value at any depth are NaN (or have alpha 0). A sum, or
    with the policy "propagate" any projection, is NaN if any depth has no value.
    """
    data, projection, way = volume.data, sampling.projection, way_of(volume.data, sampling.interpolation)
    if projection is not None:
        _check_projection(data, way, projection, len(places))
    if projection is not None and way == "majority":
        index, inside = _indices(volume, np.stack(places))
        coverage.add(inside)
        somewhere = is_defined(inside.sum(axis=0), len(inside), sampling.nan_policy)
        inside = inside[:, somewhere].T  # (P, depths)
        spots = np.where(inside[..., None], index[:, somewhere].swapaxes(0, 1), 0.0)
        image = np.full(somewhere.shape, np.nan)
        image[somewhere] = majority_at(data, spots, inside)
        return image
    if isinstance(data, Chunked):  # sampled all at once, so that each chunk is read once
        check_room(PLACE_BYTES * sum(points[..., 0].size for points in places))
        layers = sample(volume, np.stack(places), way)
    else:
        layers = np.stack([sample(volume, points, way) for points in places])
    if projection is None:
        return layers
    return np.asarray(layers[0]) if len(layers) == 1 else _projected(layers, sampling, coverage)


def _check_projection(data: Any, way: str, projection: str, depths: int) -> None:
    """Raise an error for a projection over depths that labels or colours do not have."""
    if depths > 1 and way == "nearest":
        raise InputError(
            f"values of type {data.dtype} may be labels, which have no {projection} over depths. Pass a single "
            "depth, interpolation='majority' for labels or 'linear' for other values, or use images for one image per "
            "depth"
        )
    if projection != "mean" and (way == "majority" or (depths > 1 and data.ndim == 4)):
        kind = "labels" if way == "majority" else "colours"
        raise InputError(f"projection is {projection!r}, but {kind} have only a mean over depths. Pass 'mean'")


def _projected(layers: NDArray[Any], sampling: Sampling, coverage: Coverage) -> NDArray[Any]:
    """Return a projection of values (depths, ...), or the mean of colours (depths, ..., 4), as `sample_depths`."""
    is_colour = layers.dtype == np.uint8
    has_value = layers[..., 3] > 0 if is_colour else np.isfinite(layers)
    coverage.add(has_value)
    if is_colour or sampling.projection == "mean":
        mean = mean_of_known(layers, has_value, sampling.nan_policy)
        return np.round(np.nan_to_num(mean)).astype(np.uint8) if is_colour else mean
    known = np.where(has_value, layers, np.nan)
    if sampling.projection == "sum" or sampling.nan_policy == "propagate":
        return np.asarray((np.max if sampling.projection == "max" else np.sum)(known, axis=0))
    return np.asarray(np.fmax.reduce(known, axis=0))


@dataclass(frozen=True, eq=False)
class Mixing:
    """Values at many places, each a weighted sum of a few other values; frames of a series share the weights."""

    inside: NDArray[np.bool_]  # positions with a value
    used: NDArray[np.int64]  # (U,), numbers of the values that are used
    matrix: Any  # sparse weights (P, U); zeros are kept, so that NaN values give NaN

    @classmethod
    def of(
        cls,
        inside: NDArray[np.bool_],
        total: int,
        count: int,
        block: Callable[[slice], tuple[NDArray[np.integer[Any]], NDArray[np.floating[Any]]]],
    ) -> "Mixing":
        """Compute weights block by block; `block` returns numbers and weights (p, count) for a slice of places."""
        places = int(np.count_nonzero(inside))
        check_room(36 * places * count + 9 * total)
        parts = []
        for first in range(0, max(places, 1), _BLOCK):
            numbers, weights = block(slice(first, min(first + _BLOCK, places)))
            starts = np.arange(0, numbers.size + 1, count)
            part = scipy.sparse.csr_array((weights.ravel(), numbers.ravel(), starts), shape=(len(numbers), total))
            part.sum_duplicates()
            parts.append(part)
        matrix = scipy.sparse.vstack(parts, format="csr")
        is_used = np.zeros(total, dtype=bool)
        is_used[matrix.indices] = True
        used = np.flatnonzero(is_used)
        column = np.cumsum(is_used, dtype=np.int64) - 1
        triple = (matrix.data, column[matrix.indices], matrix.indptr)
        return cls(inside, used, scipy.sparse.csr_array(triple, shape=(places, len(used))))

    def __call__(self, values: NDArray[Any]) -> _Floats:
        """Return the values at the places, in the shape of `inside`; NaN outside."""
        sampled = np.full(self.inside.shape, np.nan)
        with np.errstate(invalid="ignore"):  # signalling NaN in damaged files
            used = values[self.used].astype(np.float64)
        sampled[self.inside] = self.matrix @ used
        return sampled


class SharedWeights:
    """Sample volumes at the same places, at one or several depths, with weights that are computed once per grid.

    The values equal those of `sample_depths`: exactly for nearest voxels, and up to rounding errors otherwise. Colours,
    chunked volumes and majorities are sampled with that function.
    """

    def __init__(self, places: Sequence[_Floats]) -> None:
        self._places = places
        self._grid: tuple[object, ...] = ()
        self._mixings: list[Mixing] = []

    def sample(self, volume: Volume, sampling: Sampling, coverage: Coverage) -> NDArray[Any]:
        """Return each depth, or their projection, as `sample_depths` does."""
        places, projection, way = self._places, sampling.projection, way_of(volume.data, sampling.interpolation)
        is_several = len(places) > 1
        is_plain = volume.data.ndim == 3 and not isinstance(volume.data, Chunked)
        if not is_plain or way == "majority" or (projection is not None and is_several and way == "nearest"):
            return sample_depths(volume, places, sampling, coverage)
        is_mean = projection == "mean" and is_several
        grid = (way, volume.data.shape, volume.affine.tobytes())
        if grid != self._grid:
            self._grid, self._mixings = (), []  # so that memory holds the weights of one grid
            self._mixings = [_mixing(volume, each, way) for each in ([places] if is_mean else [[p] for p in places])]
            self._grid = grid
        values = volume.data.ravel(order="F")
        images = [mixing(values) for mixing in self._mixings]
        if projection is None:
            return np.stack(images)
        if is_several and not is_mean:
            return _projected(np.stack(images), sampling, coverage)
        if is_mean:
            missing = ~np.isfinite(images[0])
            coverage.add(~missing[None])
            images[0][missing] = sample_depths(volume, [points[missing] for points in places], sampling, coverage)
        return images[0]


def sample_phases(sample: Callable[[Any], NDArray[Any]], phases: Any, sampling: Sampling) -> _Floats:
    """Sample phases with circular means, given a function that samples values.

    The mean is the direction of the mean of unit vectors, from 0 to the period; NaN where they cancel out. Chunked
    volumes are read twice.
    """
    period = float(sampling.period or np.nan)

    def component(part: np.ufunc) -> NDArray[Any]:
        def of_phases(values: NDArray[Any]) -> Any:
            return part(values * (2 * np.pi / period))

        return sample(replace(phases, made_of=of_phases) if isinstance(phases, Chunked) else of_phases(phases))

    if sampling.interpolation == "nearest":
        means = np.asarray(sample(phases) % period)
    else:
        x, y = component(np.cos), component(np.sin)
        means = np.arctan2(y, x) * (period / (2 * np.pi)) % period
        means[np.hypot(x, y) < _CANCELLED] = np.nan
    means[means >= period] = 0.0  # rounded remainders
    return means


def _mixing(volume: Volume, places: Sequence[_Floats], way: str) -> Mixing:
    """Return the weights of voxels for the mean of a volume over several depths; voxels are in Fortran order."""
    shape = volume.data.shape
    indices = [_indices(volume, points) for points in places]
    inside = np.logical_and.reduce([covered for _, covered in indices])
    spots = [where[inside] for where, _ in indices]
    last, steps = np.asarray(shape) - 1, np.array([1, shape[0], shape[0] * shape[1]])
    corners = _CORNERS if way == "linear" else _CORNERS[:1]

    def block(part: slice) -> tuple[NDArray[np.int64], _Floats]:
        numbers, weights = [], []
        for each in (here[part] for here in spots):
            low = _lowest(each if way == "linear" else np.floor(each + 0.5), volume.data)
            numbers.append(np.minimum(low[:, None] + corners, last) @ steps)
            shares = _weights(each, low, volume.data) if way == "linear" else np.ones((len(each), 1))
            weights.append(shares / len(spots))
        return np.concatenate(numbers, axis=1), np.concatenate(weights, axis=1)

    return Mixing.of(inside, volume.data.size, len(spots) * len(corners), block)


def way_of(values: Any, interpolation: str | None) -> str:
    """Return the interpolation of values: by default nearest for integers, which may be labels."""
    is_colour = values.ndim == 4
    if interpolation is None:
        return "nearest" if values.dtype.kind in "biu" and not is_colour else "linear"
    if interpolation == "majority" and is_colour:
        raise InputError("interpolation is 'majority', which is for labels, but the volume has colours. Pass 'linear'")
    return interpolation
