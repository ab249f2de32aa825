"""Checks of triangles and points that the formats of surfaces share."""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat.errors import InputError

TRIANGULATE = "triangulate first, e.g. mesh.triangulate() of PyVista"


def refuse_corners(counts: Counter[int]) -> None:
    """Refuse faces that are no triangles, naming what they are."""
    others = [(corners, number) for corners, number in sorted(counts.items()) if corners != 3]
    if others:
        found = ", ".join(f"{n} face{'s have' if n > 1 else ' has'} {corners} corners" for corners, n in others)
        raise InputError(f"{found}; {TRIANGULATE}")


def check_faces(faces: ArrayLike, n: int) -> NDArray[np.int64]:
    """Check that faces are triangles of n points."""
    array = np.asarray(faces)
    if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in "iu":
        raise InputError(f"faces are {array.dtype} of shape {array.shape}: give whole numbers of shape (F, 3)")
    if len(array) == 0:
        raise InputError("has no faces: is it a surface, not points alone?")
    bad = np.flatnonzero(((array < 0) | (array >= n)).any(axis=1))
    if len(bad):
        raise InputError(f"face {bad[0]} is {array[bad[0]].tolist()}; the surface has the points 0 to {n - 1}")
    return np.ascontiguousarray(array, dtype=np.int64)


def as_float32(points: NDArray[np.float64]) -> NDArray[np.float32]:
    """Round to float32; what that cannot hold is refused."""
    with np.errstate(over="ignore"):
        rounded = points.astype(np.float32)
    bad = np.flatnonzero(~np.isfinite(rounded).all(axis=1))
    if len(bad):
        raise InputError(f"point {bad[0]} lies at {points[bad[0]].tolist()}, too far for the format's float32")
    return rounded
