"""Check triangles, and split polygons and strips into triangles; the surface formats share these functions."""

from collections import Counter
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat.arguments import array_of, is_whole, shown
from voxflat.errors import InputError

Points: TypeAlias = NDArray[np.float64]  # (N, 3), or (N, 2) for texture coordinates
Faces: TypeAlias = NDArray[np.int64]  # (F, 3)

TRIANGULATE = "Triangulate it first, for example with PyVista or MeshLab"

SEAMS = "has points on texture seams"  # begins the warning on them
_MOST_CORNERS = 1000  # largest number of corners of a polygon to split


def triangulated(
    points: Points, corners: NDArray[np.int64], counts: NDArray[np.int64]
) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """Split polygons, given by all corners and the number of corners of each, into triangles with the same orientation.

    Quadrilaterals are split along the shorter interior diagonal, other polygons by ear clipping, which cuts along the
    shortest diagonal first. Return positions (T, 3) in `corners`, and warnings.
    """
    odd = np.flatnonzero((counts < 3) | (counts > _MOST_CORNERS))
    if len(odd):
        raise InputError(f"face {odd[0]} has {counts[odd[0]]} corners. {TRIANGULATE}")
    starts = np.cumsum(counts) - counts
    if (counts == 3).all():
        return starts[:, None] + np.arange(3), ()
    bad = np.flatnonzero((corners < 0) | (corners >= len(points)))
    if len(bad):
        face = int(np.searchsorted(starts, bad[0], side="right")) - 1
        corner = corners[bad[0]]
        raise InputError(f"face {face} refers to point {corner}, but the surface has points 0 to {len(points) - 1}")
    ends = np.cumsum(counts - 2)
    triangles = np.empty((ends[-1], 3), dtype=np.int64)
    three = counts == 3
    triangles[ends[three] - 1] = starts[three, None] + np.arange(3)
    four = np.flatnonzero(counts == 4)
    quads = starts[four, None] + np.arange(4)
    places = points[corners[quads]]
    first, second = _halves(places, 0), _halves(places, 1)
    other = (second[1] & ~first[1]) | ((first[1] == second[1]) & (second[0] < first[0]))
    for chosen, turn in ((~other, 0), (other, 1)):
        turned = np.roll(quads[chosen], -turn, axis=1)
        triangles[ends[four[chosen]] - 2], triangles[ends[four[chosen]] - 1] = turned[:, :3], turned[:, [0, 2, 3]]
    for face in np.flatnonzero(counts > 4).tolist():
        polygon = corners[starts[face] : starts[face] + counts[face]]
        triangles[ends[face] - counts[face] + 2 : ends[face]] = starts[face] + _ears(points[polygon])
    kinds = sorted(Counter(counts[counts > 3].tolist()).items())
    listing = ", ".join(f"{number} with {n} corners" for n, number in kinds[:5]) + ", ..." * (len(kinds) > 5)
    return triangles, (f"polygons were split into triangles ({listing})",)


def _halves(quads: NDArray[np.float64], turn: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the squared diagonal length of each quadrilateral (Q, 4, 3), and whether both halves face the same way."""
    a, b, c, d = np.moveaxis(np.roll(quads, -turn, axis=1), 1, 0)
    left, right = np.cross(b - a, c - a), np.cross(c - a, d - a)
    return ((c - a) ** 2).sum(axis=1), np.asarray((left * right).sum(axis=1) > 0)


def _ears(polygon: NDArray[np.float64]) -> NDArray[np.int64]:
    """Split one polygon (n, 3) into n − 2 triangles in its best-fitting plane."""
    ahead = np.roll(polygon, -1, axis=0)
    normal = np.cross(polygon, ahead).sum(axis=0)  # Newell's normal, twice the area long
    if not normal.any():
        normal = np.array([0.0, 0.0, 1.0])
    drop = int(np.abs(normal).argmax())
    axes = [(drop + 1) % 3, (drop + 2) % 3][:: 1 if normal[drop] > 0 else -1]
    plane = polygon[:, axes]
    left = list(range(len(polygon)))
    triangles = []
    while len(left) > 3:
        ring = np.array(left)
        before, after = np.roll(ring, 1), np.roll(ring, -1)
        a, b, c = plane[before], plane[ring], plane[after]
        turns = _cross(b - a, c - b)
        length = ((polygon[after] - polygon[before]) ** 2).sum(axis=1)
        order = np.lexsort((length, -np.sign(turns)))
        ears = (k for k in order if turns[k] > 0 and not _holds(plane[ring], a[k], b[k], c[k], k))
        best = int(next(ears, order[0]))  # a self-crossing polygon may have none
        triangles.append([before[best], ring[best], after[best]])
        del left[best]
    return np.array([*triangles, left], dtype=np.int64)


def _holds(corners: Points, a: Points, b: Points, c: Points, ear: int) -> bool:
    """Return whether the triangle of an ear contains another corner of the polygon."""
    inside = (_cross(b - a, corners - a) >= 0) & (_cross(c - b, corners - b) >= 0) & (_cross(a - c, corners - c) >= 0)
    inside[[ear - 1, ear, (ear + 1) % len(corners)]] = False
    same = (corners == a).all(axis=1) | (corners == b).all(axis=1) | (corners == c).all(axis=1)
    return bool((inside & ~same).any())


def _cross(p: NDArray[np.float64], q: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0])


def of_strips(strips: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Return the triangles (T, 3) of strips, in which every second triangle has the opposite orientation."""
    parts = [np.empty((0, 3), dtype=np.int64)]
    for strip in strips:
        rows = np.stack([strip[:-2], strip[1:-1], strip[2:]], axis=1)
        rows[1::2] = rows[1::2, [1, 0, 2]]
        parts.append(rows)
    return np.concatenate(parts).astype(np.int64)


def check_faces(faces: ArrayLike, n: int) -> NDArray[np.int64]:
    """Check that faces are triangles whose corners are among n points."""
    if not is_whole(n):
        raise InputError(f"the number of points is {shown(n)}. Pass a whole number")
    array = array_of(faces, "faces")
    if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in "iu":
        raise InputError(f"faces have data type {array.dtype} and shape {array.shape}. Pass an integer (F, 3) array")
    if len(array) == 0:
        raise InputError("has no faces. Pass a surface, not only points")
    bad = np.flatnonzero(((array < 0) | (array >= n)).any(axis=1))
    if len(bad):
        raise InputError(f"face {bad[0]} is {array[bad[0]].tolist()}, but the surface has points 0 to {n - 1}")
    return np.ascontiguousarray(array, dtype=np.int64)


def first_coordinates(coordinates: Points, faces: Faces, n: int) -> tuple[Points, tuple[str, ...]]:
    """Return the first texture coordinate of each of n points, and a warning if any has several.

    The coordinates of the corners of the faces have shape (F, 3, 2), and are NaN where there are none.
    """
    check_faces(faces, n)
    is_there = ~np.isnan(coordinates).any(axis=2)
    corners, places = faces[is_there], coordinates[is_there]
    texture = np.full((n, 2), np.nan)
    texture[corners[::-1]] = places[::-1]  # the last assignment is the first in the file
    seam = np.unique(corners[(texture[corners] != places).any(axis=1)])
    text = f"{SEAMS} ({len(seam)}); each keeps only its first texture coordinate"
    return texture, (text,) if len(seam) else ()


def as_float32(points: Points) -> NDArray[np.float32]:
    """Round to float32; raise an error for values that it cannot represent."""
    with np.errstate(over="ignore"):
        rounded = points.astype(np.float32)
    bad = np.flatnonzero(~np.isfinite(rounded).all(axis=1))
    if len(bad):
        raise InputError(f"point {bad[0]}, {points[bad[0]].tolist()}, exceeds the float32 range of this format")
    return rounded
