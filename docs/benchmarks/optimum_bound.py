"""A lower bound: how much any places in the plane get the distances between some points wrong.

Four points in the plane have five distances that are free; the sixth is one of two numbers. On a curved surface it is
neither. So each four points cost something, whatever the map; fours that share no pair add up. The derivation stands
in docs/decisions/0032-optimum.md. Nothing is assumed of the map: it may fold, and have any scale.
"""

from itertools import combinations

import numpy as np

HALVINGS = 12
"""Of the radius within which the sixth distance is followed, a half at first."""

PAIRS = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))
CHUNK = 1 << 16


def of_fours(distances):
    """Bound from below Σ |d/δ − 1| over the six pairs of four points, for any four places d apart in the plane.

    Parameters
    ----------
    distances : ndarray of float64, shape (K, 4, 4)
        Between the points of each four, δ; positive off the diagonal.

    Returns
    -------
    ndarray of float64, shape (K,)
    """
    best = np.zeros(len(distances))
    for a, b in PAIRS:  # the sixth distance is that of the other two points
        c, d = (n for n in range(4) if n not in (a, b))
        best = np.maximum(best, _by_sixth(distances[:, [[a], [b], [c], [d]], [a, b, c, d]]))
    return best


def _by_sixth(apart):
    """Bound it by what the distance of points 2 and 3 would have to be, given the others."""
    base, sixth = apart[:, 0, 1], apart[:, 2, 3]
    with np.errstate(invalid="ignore", divide="ignore"):
        x = (base[:, None] ** 2 + apart[:, 0, 2:] ** 2 - apart[:, 1, 2:] ** 2) / (2 * base[:, None])
        y = np.sqrt(np.maximum(apart[:, 0, 2:] ** 2 - x**2, 0))
        same, other = (np.hypot(x[:, 1] - x[:, 0], y[:, 1] + sign * y[:, 0]) for sign in (-1, 1))
        gap = np.minimum(np.abs(same / sixth - 1), np.abs(other / sixth - 1))
        found, low, high = np.zeros(len(apart)), np.zeros(len(apart)), np.full(len(apart), 0.5)
        for _ in range(HALVINGS):  # what is found holds at any radius; it is greatest where both terms are equal
            radius = 0.5 * (low + high)
            reached = np.nan_to_num(gap / np.maximum(_swiftest(apart, radius), 1))
            found = np.maximum(found, np.minimum(radius, reached))
            low, high = np.where(reached > radius, radius, low), np.where(reached > radius, high, radius)
    return found


def _swiftest(apart, radius):
    """Bound how fast the sixth distance changes by the relative error of one of the five, within a radius of errors."""
    base, sixth = apart[:, 0, 1], apart[:, 2, 3]
    swiftest = np.zeros(len(apart))
    from_first, from_second = apart[:, 0, 2:], apart[:, 1, 2:]
    doubled = 2 * np.stack([_least_area(base, from_first[:, n], from_second[:, n], radius) for n in (0, 1)], 1)
    # how far the first and the second point lie from the line through the others, at most
    far = [(1 + radius) * of.min(axis=1) for of in (from_first, from_second)]
    longer = 1 + radius
    for n in (0, 1):
        swiftest = np.maximum(swiftest, far[0] * longer * from_second[:, n] ** 2 / (doubled[:, n] * sixth))
        swiftest = np.maximum(swiftest, far[1] * longer * from_first[:, n] ** 2 / (doubled[:, n] * sixth))
    along = [far[k] * longer * (of / doubled).sum(axis=1) for k, of in ((0, from_second), (1, from_first))]
    return np.maximum(swiftest, base * np.minimum(*along) / sixth)


def _least_area(a, b, c, radius):
    """Return the least area of triangles whose sides are off by no more than a share; 0 if one of them has none.

    16 A² is concave in the square of each side, so that it is least at a corner of the box.
    """
    least = np.full(len(a), np.inf)
    for signs in np.ndindex(2, 2, 2):
        p, q, r = (((1 + (2 * sign - 1) * radius) * side) ** 2 for sign, side in zip(signs, (a, b, c), strict=True))
        least = np.minimum(least, 2 * (p * q + q * r + r * p) - p**2 - q**2 - r**2)
    return np.sqrt(np.maximum(least, 0)) / 4


def least_error(distances):
    """Bound from below the mean relative error of the distances between points, of any places in the plane.

    Parameters
    ----------
    distances : ndarray of float64, shape (n, n)
        On the surface, symmetric.

    Returns
    -------
    float
        No map, at no scale, has a mean of |d/δ − 1| over all pairs that is less.
    """
    count = len(distances)
    fours = np.array(list(combinations(range(count), 4)), dtype=np.int32)
    costs = np.concatenate(
        [
            of_fours(distances[part[:, :, None], part[:, None, :]])
            for part in np.array_split(fours, 1 + len(fours) // CHUNK)
        ]
    )
    is_free = np.ones((count, count), dtype=bool)
    total = 0.0
    order = np.argsort(-costs, kind="stable")
    for part in np.array_split(order, 1 + len(order) // 4096):
        chosen = fours[part]
        may = np.all([is_free[chosen[:, a], chosen[:, b]] for a, b in PAIRS], axis=0)
        for number in part[may]:
            four = fours[number]
            if is_free[np.ix_(four, four)].sum() == 16:
                total += costs[number]
                for a, b in PAIRS:
                    is_free[four[a], four[b]] = is_free[four[b], four[a]] = False
    return 2 * total / (count * (count - 1))
