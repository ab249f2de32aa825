"""Depth: the distance along the normals, or as a fraction of the way from the white to the pial surface."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from voxflat.arguments import checked_choice, is_number, is_whole, shown
from voxflat.errors import InputError
from voxflat.io.grid import in_unit
from voxflat.unique_rows import distinct

LAYERINGS = ("equivolume", "equidistant")
"""Whether a fraction of cortical depth refers to the local volume of the cortex or to its thickness."""

_MOST_LAYERS = 1000
_RINGS = 3  # neighbours around a crossing whose directions are averaged
_MOST_ROUNDS = 100
_PATIENCE = 10  # rounds in which the number of crossings has to fall
_SMOOTHED = 0.5  # width of the smoothing of areas, relative to the thickness


@dataclass(frozen=True)
class Depths:
    """One or several depths at which to sample."""

    values: tuple[float, ...]  # distances outside the surface, or fractions from 0 (white surface) to 1 (pial surface)
    layering: str | None = None  # one of `LAYERINGS`, for fractions

    @classmethod
    def of(
        cls,
        depth: float | Sequence[float] = 0.0,
        fraction: float | Sequence[float] | None = None,
        layering: str = "equivolume",
        count: int | None = None,
    ) -> "Depths":
        """Return the depths for the arguments of `FlatMap.images`, after checking them; `count` is its `depths`."""
        checked_choice(layering, "layering", LAYERINGS)
        if count is not None:
            if fraction is not None:
                raise InputError("fraction and depths (a number of layers) cannot be combined. Pass only one of them")
            count = checked_layers(count, "depths")
            fraction = tuple((layer + 0.5) / count for layer in range(count))  # at the centres of layers
        if fraction is None:
            return cls(_numbers(depth, "depth"))
        if not isinstance(depth, int | float) or depth != 0:
            other = "fraction (white to pial)" if count is None else "depths (a number of layers)"
            raise InputError(f"depth (in mm) and {other} cannot be combined. Pass only one of them")
        values = _numbers(fraction, "fraction")
        for value in values:
            if not 0 <= value <= 1:
                raise InputError(
                    f"fraction is {value:g}. Pass numbers from 0 (white surface) to 1 (pial surface), or use depth (in "
                    "mm) for positions outside the cortex"
                )
        return cls(values, layering)

    def __len__(self) -> int:
        """Return the number of depths."""
        return len(self.values)

    def names(self, unit: str = "mm") -> tuple[str, ...]:
        """Return the name of each depth, given the unit of distances from the surface."""
        if self.layering is None:
            return tuple(in_unit(f"{value:g} mm", unit) for value in self.values)
        return tuple(f"{self.layering} {value:g}" for value in self.values)


ON_SURFACE = Depths((0.0,))  # the surface itself


def checked_layers(count: object, name: str) -> int:
    """Check a number of layers."""
    if not is_whole(count) or not 1 <= count <= _MOST_LAYERS:
        raise InputError(f"{name} is {shown(count)}. Pass a whole number of layers from 1 to {_MOST_LAYERS}")
    return int(count)


def _numbers(given: float | Sequence[float], name: str) -> tuple[float, ...]:
    """Return one or several finite numbers as a tuple."""
    is_several = isinstance(given, Sequence) and not isinstance(given, str)
    is_several |= isinstance(given, np.ndarray) and given.ndim > 0
    values: list[Any] = list(given) if is_several else [given]  # type: ignore[arg-type]
    if len(values) == 0:
        raise InputError(f"{name} is empty. Pass one or more numbers")
    for value in values:
        if not is_number(value):
            raise InputError(f"{name} is {shown(value)}. Pass a number")
        if not math.isfinite(value):
            raise InputError(f"{name} is {value}. Pass a finite number")
    return tuple(map(float, values))


def vertex_areas(
    points: NDArray[np.float64], faces: NDArray[np.integer], weights: NDArray[np.float64] | float = 1.0
) -> NDArray[np.float64]:
    """Return the area around each vertex in mm²: a third of the total area of its triangles, which may have weights."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    areas = weights * np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6
    return np.asarray(np.bincount(faces.ravel(), np.repeat(areas, 3), len(points)), dtype=np.float64)


def smooth_areas(
    surfaces: Sequence[NDArray[np.float64]],
    along: NDArray[np.float64],
    faces: NDArray[np.integer],
    thickness: float,
    weights: NDArray[np.float64] | float = 1.0,
) -> list[NDArray[np.float64]]:
    """Return the areas around each vertex on several surfaces, smoothed along one of them over half the thickness.

    `weights` are those of the triangles.
    """
    edge = float(np.median(np.linalg.norm(along[faces] - along[np.roll(faces, 1, axis=1)], axis=2)))
    near = _neighbourhoods(faces, len(along))
    average = scipy.sparse.diags_array(1 / near.sum(axis=1)) @ near
    areas = np.stack([vertex_areas(points, faces, weights) for points in surfaces], axis=1)
    for _ in range(min(100, round((_SMOOTHED * thickness / edge) ** 2) + 1)):
        areas = average @ areas
    return list(areas.T)


def _neighbourhoods(faces: NDArray[np.integer], count: int) -> Any:
    """Return a sparse matrix with ones for each vertex and its neighbours."""
    starts, ends = faces.ravel(), np.roll(faces, 1, axis=1).ravel()
    pairs = (np.concatenate([starts, ends]), np.concatenate([ends, starts]))
    near = scipy.sparse.csr_array((np.ones(len(pairs[0])), pairs), shape=(count, count))
    near.data[:] = 1.0
    return (near + scipy.sparse.eye_array(count)).tocsr()


def equivolume(fraction: float, inner: ArrayLike, outer: ArrayLike) -> NDArray[np.float64]:
    """Return the equivolume depth: the fraction of the distance below which a fraction of the volume lies.

    This is equation 10 of Waehnert et al. 2014, *Anatomically motivated modeling of cortical laminae*, where areas grow
    linearly from one surface to the other: ρ = (√(α A₁² + (1 − α) A₀²) − A₀) / (A₁ − A₀). The equivalent form α (A₁ +
    A₀) / (√(α A₁² + (1 − α) A₀²) + A₀) is used, which also holds for equal areas. The result is α where both areas are
    0.
    """
    inner, outer = np.asarray(inner, dtype=np.float64), np.asarray(outer, dtype=np.float64)
    below = np.sqrt(fraction * outer**2 + (1 - fraction) * inner**2) + inner
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(below > 0, fraction * (inner + outer) / below, fraction)


def uncrossed(
    points: NDArray[np.float64], normals: NDArray[np.float64], faces: NDArray[np.integer], low: float, high: float
) -> tuple[NDArray[np.float64], float]:
    """Return unit vectors (N, 3) along which layers from `low` to `high` do not cross, and the share that still does.

    They are the normals, except that they are averaged with their neighbours where a triangle would be turned over
    on its way to one of the two ends. The share is that of the triangles.
    """
    merged = distinct(points)  # both sides of a cut move together
    corners = merged.which[faces]
    places, directions = points[merged.first], normals[merged.first].copy()
    near = _neighbourhoods(corners, len(places))
    is_known = np.isfinite(directions).all(axis=1)
    is_turned = _turned(places, directions, corners, low, high)
    fewest, since = len(corners) + 1, 0
    for _ in range(_MOST_ROUNDS):
        count = int(np.count_nonzero(is_turned))
        fewest, since = (count, 0) if count < fewest else (fewest, since + 1)
        if count == 0 or since == _PATIENCE:
            break
        is_moved = np.zeros(len(places), dtype=bool)
        is_moved[corners[is_turned]] = True
        for _ in range(_RINGS):
            is_moved = (near @ is_moved) > 0
        rows = np.flatnonzero(is_moved & is_known)
        mean = near[rows] @ np.nan_to_num(directions)
        length = np.linalg.norm(mean, axis=1, keepdims=True)
        directions[rows] = np.divide(mean, length, out=directions[rows], where=length > 0)
        touched = np.flatnonzero(is_moved[corners].any(axis=1))
        is_turned[touched] = _turned(places, directions, corners[touched], low, high)
    share = float(np.count_nonzero(is_turned)) / max(1, len(corners))
    return directions[merged.which], share


def _turned(
    points: NDArray[np.float64], directions: NDArray[np.float64], faces: NDArray[np.integer], low: float, high: float
) -> NDArray[np.bool_]:
    """Return which triangles turn over when their corners move from 0 to `low` or to `high`."""
    a, b, c = (faces[:, k] for k in range(3))
    sides = points[b] - points[a], points[c] - points[a]
    moves = directions[b] - directions[a], directions[c] - directions[a]
    normal = np.cross(*sides)
    # the component of the moved triangle's normal along its first one is a quadratic function of the distance
    constant = (normal * normal).sum(axis=1)
    linear = (normal * (np.cross(sides[0], moves[1]) + np.cross(moves[0], sides[1]))).sum(axis=1)
    square = (normal * np.cross(*moves)).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        lowest = np.clip(np.nan_to_num(-linear / (2 * square)), min(low, 0.0), max(high, 0.0))
    least = np.min([constant + height * (linear + height * square) for height in (low, high, lowest)], axis=0)
    return np.asarray(least <= 0)
