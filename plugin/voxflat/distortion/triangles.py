"""Distortion of each triangle and point: arrays behind the figures, which have the same names in all interfaces.

| name | of | meaning |
|---|---|---|
| `distance_error` | points | mean of |d − δ|/δ over the pairs of the point, a fraction |
| `areal` | points | log2(A_flat / A_surface) |
| `angle` | points | mean change of the angles around it, degrees |
| `isometric` | triangles | max(σ1, 1/σ2): the greatest factor by which lengths change |
| `quasi_conformal` | triangles | σ1/σ2: the ratio of the stretches in the two principal directions |
| `flipped` | triangles | whether it is flipped |
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.distortion.distortion import Distortion

_WEIGHTED = np.spacing(1.0)  # lower bound for areas of degenerate triangles


def measure_arrays(
    distortion: Distortion, points: NDArray[np.float64], faces: NDArray[Any], uv: NDArray[np.float64]
) -> tuple[dict[str, NDArray[Any]], dict[str, NDArray[Any]]]:
    """Return measures of points and triangles; only `distance_error` if the map has no triangles of the surface."""
    of_points = {"distance_error": distortion.per_point}
    if distortion.triangles is None:
        return of_points, {}
    stretch = stretches(points, faces, uv)
    of_points |= {"areal": distortion.triangles.areal, "angle": angle_changes(points, faces, uv)}
    return of_points, {
        "isometric": isometric(stretch),
        "quasi_conformal": quasi_conformal(stretch),
        "flipped": distortion.triangles.is_flipped,
    }


def stretches(points: NDArray[np.float64], faces: NDArray[Any], uv: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the stretches σ1 ≥ σ2 ≥ 0 of each triangle, shape (F, 2); NaN if its area on the surface is zero."""
    a, b = (points[faces[:, corner]] - points[faces[:, 0]] for corner in (1, 2))
    base = np.linalg.norm(a, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        along = np.einsum("fx,fx->f", a, b) / base
        height = np.linalg.norm(np.cross(a, b), axis=1) / base
        flat_a, flat_b = (uv[faces[:, corner]] - uv[faces[:, 0]] for corner in (1, 2))
        first = flat_a / base[:, None]  # the map's Jacobian, column by column, in a frame along the first side
        second = (flat_b - along[:, None] * first) / height[:, None]
        squares = np.einsum("fx,fx->f", first, first) + np.einsum("fx,fx->f", second, second)
        area = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
        most = (np.sqrt(squares + 2 * area) + np.sqrt(np.maximum(squares - 2 * area, 0))) / 2
        stretch = np.column_stack([most, np.where(most > 0, area / most, 0)])
    stretch[~np.isfinite(stretch).all(axis=1)] = np.nan
    return stretch


def isometric(stretch: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return max(σ1, 1/σ2) for each triangle."""
    most, least = stretch.T
    with np.errstate(divide="ignore", over="ignore"):
        return np.asarray(np.maximum(most, 1 / least))


def quasi_conformal(stretch: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return σ1/σ2 of triangles."""
    most, least = stretch.T
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return np.asarray(most / least)


def angle_changes(points: NDArray[np.float64], faces: NDArray[Any], uv: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean change of the angles around each point, in degrees; NaN for points without triangles."""
    corners = faces.astype(np.int64)
    change = np.abs(_corner_angles(uv[corners]) - _corner_angles(points[corners]))
    count = np.bincount(corners.ravel(), minlength=len(uv))
    with np.errstate(invalid="ignore"):
        return np.asarray(np.bincount(corners.ravel(), np.degrees(change).ravel(), len(uv)) / count)


def _corner_angles(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the angles, in radians and of shape (F, 3), of triangles of shape (F, 3, 2) or (F, 3, 3)."""
    to_next, to_last = (np.roll(corners, step, axis=1) - corners for step in (-1, 1))
    lengths = np.linalg.norm(to_next, axis=2) * np.linalg.norm(to_last, axis=2)
    cosines = np.einsum("fcx,fcx->fc", to_next, to_last) / np.maximum(lengths, _WEIGHTED)
    return np.asarray(np.arccos(np.clip(cosines, -1, 1)))
