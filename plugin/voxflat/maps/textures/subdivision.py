"""Selective subdivision: triangles are split where colours at their corners cannot carry a texture.

Zigelman, Kimmel and Kiryati (2002), section IV, subdivide large triangles to avoid aliasing, and take the colours of
new vertices from the same subdivision in the plane of the texture. Here, a triangle is bisected at its longest side,
together with the triangle that shares that side (Rivara 1984), which avoids cracks and needle-shaped triangles.
"""

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import is_number, shown
from voxflat.errors import InputError
from voxflat.maps.textures.pictures import values_at

_MOST_FACES = 5_000_000  # about 1 GB while they are split
_LONGEST = 1024  # texels; triangles with a longer side are always split
_SAMPLES = 1_000_000  # samples at a time

_Floats = NDArray[np.float64]
_Ints = NDArray[np.int64]


def subdivide(
    points: _Floats, faces: _Ints, coordinates: _Floats, picture: NDArray[np.uint8], tolerance: float, *, repeat: bool
) -> tuple[_Floats, _Ints, _Floats]:
    """Split triangles until colours at their corners show the texture; see `TexturedSurface.subdivided`."""
    if not (is_number(tolerance) and 0 < tolerance < np.inf):
        raise InputError(f"tolerance is {shown(tolerance)}. Pass a positive number of grey levels, up to 255")
    size = np.array(picture.shape[1::-1], dtype=np.float64)
    open_ = np.ones(len(faces), dtype=np.bool_)  # triangles that still need checking
    while True:
        rough = open_.copy()
        rough[open_] = _deviation(coordinates[faces[open_]], picture, repeat) > tolerance
        if not rough.any():
            return points, faces, coordinates
        sides, faces, is_new = _bisect(faces, coordinates * size, rough)
        if len(faces) > _MOST_FACES:
            raise InputError(
                f"the picture's {picture.shape[1]} x {picture.shape[0]} texels need more than {_MOST_FACES} triangles. "
                "Increase the tolerance, pass a coarser picture, or save the surface with the picture itself, as .obj, "
                ".vtp or .glb"
            )
        points = np.concatenate([points, points[sides].mean(axis=1)])
        coordinates = np.concatenate([coordinates, coordinates[sides].mean(axis=1)])
        open_ = is_new


def _deviation(corners: _Floats, picture: NDArray[np.uint8], repeat: bool) -> _Floats:
    """Return the greatest error of linear interpolation of the texture in each triangle, sampled one texel apart."""
    size = np.array(picture.shape[1::-1], dtype=np.float64)
    sides = np.linalg.norm((corners - np.roll(corners, 1, axis=1)) * size, axis=2).max(axis=1)
    steps = 2 ** np.ceil(np.log2(np.maximum(sides, 1))).astype(np.int64)
    worst = np.where(steps > _LONGEST, np.inf, 0.0)
    for step in np.unique(steps[(steps > 1) & (steps <= _LONGEST)]).tolist():
        a, b = np.divmod(np.arange((step + 1) ** 2), step + 1)
        lattice = np.column_stack([a, b, step - a - b])[a + b <= step]
        weights = lattice / step  # barycentric coordinates of samples one texel apart, (P, 3)
        numbers, count = np.flatnonzero(steps == step), max(1, _SAMPLES // len(weights))
        for block in (numbers[first : first + count] for first in range(0, len(numbers), count)):
            ends = values_at(picture, corners[block], repeat)
            within = values_at(picture, weights @ corners[block], repeat)
            worst[block] = np.abs(within - weights @ ends).max(axis=(1, 2))
    return worst


def _bisect(faces: _Ints, places: _Floats, rough: NDArray[np.bool_]) -> tuple[_Ints, _Ints, NDArray[np.bool_]]:
    """Bisect triangles without cracks; return the sides split at new points, the triangles, and a mask of new ones."""
    pairs = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2)  # side k leads from corner k to k + 1
    low, high = pairs.min(axis=2), pairs.max(axis=2)
    keys, side_of = np.unique(low * len(places) + high, return_inverse=True)
    side_of = side_of.reshape(faces.shape)
    ends = np.column_stack(np.divmod(keys, len(places)))
    marked, longest = _marked(side_of, np.linalg.norm(places[ends[:, 0]] - places[ends[:, 1]], axis=1), rough)
    middle = np.full(len(keys), -1)
    middle[marked] = len(places) + np.arange(np.count_nonzero(marked))
    split = marked[side_of].any(axis=1)
    turn = (longest[split, None] + np.arange(3)) % 3  # the longest side comes first
    new = _pieces(np.take_along_axis(faces[split], turn, 1), middle[np.take_along_axis(side_of[split], turn, 1)])
    is_new = np.arange(np.count_nonzero(~split) + len(new)) >= np.count_nonzero(~split)
    return ends[marked], np.concatenate([faces[~split], new]), is_new


def _marked(side_of: _Ints, lengths: _Floats, rough: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], _Ints]:
    """Mark the longest sides of selected triangles, and of all triangles with a marked side."""
    rank = np.empty(len(lengths), dtype=np.int64)
    rank[np.argsort(lengths, kind="stable")] = np.arange(len(lengths))  # neighbours agree even if lengths are equal
    longest = rank[side_of].argmax(axis=1)
    longest_side = np.take_along_axis(side_of, longest[:, None], axis=1)[:, 0]
    marked = np.zeros(len(lengths), dtype=np.bool_)
    halved = longest_side[rough]
    while not marked[halved].all():
        marked[halved] = True
        halved = longest_side[marked[side_of].any(axis=1)]
    return marked, longest


def _pieces(corners: _Ints, middles: _Ints) -> _Ints:
    """Split triangles (a, b, c) at the middle of ab, and the halves at the middles of bc and ca unless these are −1."""
    (a, b, c), (ab, bc, ca) = corners.T, middles.T
    left, right = ca >= 0, bc >= 0
    halves = [(~left, (a, ab, c)), (~right, (ab, b, c))]
    quarters = [(left, (a, ab, ca)), (left, (ca, ab, c)), (right, (ab, b, bc)), (right, (ab, bc, c))]
    return np.concatenate([np.column_stack(parts)[chosen] for chosen, parts in (*halves, *quarters)])
