"""Directions in which points are moved away from a surface, so that the layers above and below it do not cross."""

import numpy as np
import scipy
from numpy.typing import NDArray

from voxflat.unique_rows import distinct

_RINGS = 3  # neighbours around a crossing whose directions are averaged
_MOST_ROUNDS = 100
_PATIENCE = 10  # rounds in which the number of crossings has to fall

_Floats = NDArray[np.float64]


def uncrossed(
    points: _Floats, normals: _Floats, faces: NDArray[np.integer], low: float, high: float
) -> tuple[_Floats, float]:
    """Return unit vectors (N, 3) along which layers from `low` to `high` do not cross, and the share that still does.

    They are the normals, except that they are averaged with their neighbours where a triangle would be turned over
    on its way to one of the two ends. The share is that of the triangles.
    """
    merged = distinct(points)  # both sides of a cut move together
    corners = merged.which[faces]
    places, directions = points[merged.first], normals[merged.first].copy()
    starts, ends = corners.ravel(), np.roll(corners, 1, axis=1).ravel()
    pairs = (np.concatenate([starts, ends]), np.concatenate([ends, starts]))
    near = scipy.sparse.csr_array((np.ones(len(pairs[0])), pairs), shape=(len(places),) * 2)
    near.data[:] = 1.0
    near = (near + scipy.sparse.eye_array(len(places))).tocsr()
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
    points: _Floats, directions: _Floats, faces: NDArray[np.integer], low: float, high: float
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
    least = np.min([constant + at * (linear + at * square) for at in (low, high, lowest)], axis=0)
    return np.asarray(least <= 0)
