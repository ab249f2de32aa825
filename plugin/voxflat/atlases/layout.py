"""Place flat pieces side by side on a page, without overlap: in rows of boxes, or packed by shape with xatlas."""

import numpy as np
import scipy
from numpy.typing import NDArray

from voxflat.errors import InputError
from voxflat.io.files import installing

_Floats = NDArray[np.float64]
_Ints = NDArray[np.int64]

PACKINGS = ("boxes", "shapes")  # packing methods

_GAP = 0.05  # share of the side of a square with the mean area of the pieces' boxes
_WIDTH = 1.05  # share of the side of a square with the area of all boxes
_TEXELS = 4  # texels of xatlas per gap; more texels are slow and do not make the page smaller


def usual_gap(uv: _Floats, starts: _Ints) -> float:
    """Return the default gap, in mm, which is proportional to the typical size of the pieces."""
    sizes = np.maximum.reduceat(_turned(uv, starts), starts[:-1], axis=0)
    return _GAP * float(np.sqrt(sizes.prod(axis=1).mean()))


def lay_out(uv: _Floats, starts: _Ints, faces: _Ints, gap: float, packing: str) -> _Floats:
    """Place pieces on a page; return the position of each row of `uv`, in mm, with the lowest corner at (0, 0).

    Each piece has consecutive rows of `uv`, shape (P, 2), which begin at `starts`. Pieces are rotated and moved, not
    mirrored. "boxes" places their smallest bounding rectangles in rows, from the highest to the lowest, separated by
    the gap; "shapes" fits the pieces together with xatlas.
    """
    if not (np.isfinite(gap) and gap >= 0) or (gap == 0 and packing == "shapes"):
        raise InputError(f"gap is {gap} mm. Pass a positive number")
    placed = _turned(uv, starts)
    sizes = np.maximum.reduceat(placed, starts[:-1], axis=0)
    placed += np.repeat(_in_rows(sizes, gap), np.diff(starts), axis=0)
    if packing == "shapes":
        placed = _by_shape(placed, starts, faces, gap)
    return np.asarray(placed - placed.min(axis=0))


def _turned(uv: _Floats, starts: _Ints) -> _Floats:
    """Rotate each piece to fit its smallest rectangle, with the longer side along u and a corner at (0, 0)."""
    parts = []
    for part in np.split(uv, starts[1:-1]):
        axis = _axis(part)
        part = part @ np.array([axis, [-axis[1], axis[0]]]).T
        parts.append(part - part.min(axis=0))
    return np.concatenate(parts)


def _axis(places: _Floats) -> _Floats:
    """Return the direction of the longer side of the smallest bounding rectangle; one side lies along a hull edge."""
    try:
        hull = places if len(places) == 3 else places[scipy.spatial.ConvexHull(places).vertices]
    except scipy.spatial.QhullError:  # degenerate to a line
        hull = places
    sides = np.roll(hull, -1, axis=0) - hull
    lengths = np.linalg.norm(sides, axis=1)
    sides = sides[lengths > 0] / lengths[lengths > 0, None]
    along, across = (np.ptp(hull @ way.T, axis=0) for way in (sides, sides @ [[0, 1], [-1, 0]]))
    best = int(np.argmin(along * across))
    axis = sides[best]
    return axis if along[best] >= across[best] else np.array([-axis[1], axis[0]])


def _in_rows(sizes: _Floats, gap: float) -> _Floats:
    """Return the lowest corner of each box, in rows from the highest to the lowest; the page is nearly square."""
    width = max(float(sizes[:, 0].max()), _WIDTH * float(np.sqrt((sizes + gap).prod(axis=1).sum())))
    corners = np.zeros_like(sizes)
    x = y = row = 0.0
    for n in np.lexsort((np.arange(len(sizes)), -sizes[:, 1])):
        if x > 0 and x + sizes[n, 0] > width:
            x, y, row = 0.0, y - row - gap, 0.0
        row = max(row, sizes[n, 1])
        corners[n] = x, y - sizes[n, 1]
        x += sizes[n, 0] + gap
    return corners


def _by_shape(apart: _Floats, starts: _Ints, faces: _Ints, gap: float) -> _Floats:
    """Pack pieces, which do not overlap, with xatlas; its single-precision positions are converted to rigid motions."""
    try:
        import xatlas
    except ImportError as error:
        raise InputError(f"packing='shapes' requires xatlas. Run {installing('xatlas')}, or pass 'boxes'") from error
    atlas = xatlas.Atlas()
    pieces = (np.searchsorted(starts, faces[:, 0], side="right") - 1).astype(np.uint32)
    atlas.add_uv_mesh(apart.astype(np.float32), faces.astype(np.uint32), pieces[:, None])
    options = xatlas.PackOptions()
    options.padding, options.bilinear, options.texels_per_unit = _TEXELS, True, _TEXELS / gap
    atlas.generate(pack_options=options)
    if atlas.atlas_count != 1 or atlas.chart_count < len(starts) - 1:
        raise InputError("xatlas cannot pack these pieces. Pass packing='boxes' or a larger gap")
    rows, _, places = atlas.get_mesh(0)
    target = np.full_like(apart, np.nan)
    target[rows] = places.astype(np.float64) * [atlas.width, atlas.height] * gap / _TEXELS
    return _moved(apart, target, starts)


def _moved(places: _Floats, targets: _Floats, starts: _Ints) -> _Floats:
    """Move each piece rigidly to its target; rotate it by 180 degrees if the target is mirrored."""
    parts = []
    for part, target in zip(np.split(places, starts[1:-1]), np.split(targets, starts[1:-1]), strict=True):
        is_known = np.isfinite(target[:, 0])
        middle, goal = part[is_known].mean(axis=0), target[is_known].mean(axis=0)
        u, _, v = np.linalg.svd((part[is_known] - middle).T @ (target[is_known] - goal))
        turn = u @ np.diag([1.0, np.linalg.det(u @ v)]) @ v
        parts.append((part - middle) @ turn + goal)
    return np.concatenate(parts)
