"""Floater's shape-preserving map (CAGD 14, 1997): each inner vertex is a convex combination of its neighbours.

With its neighbours around it unrolled by the geodesic polar map, every vertex is a mean over triangles of three of them
that contain it. A border that is convex makes the map one-to-one, whatever the surface; of a plane surface whose border
stays it is the identity.
"""

import numpy as np
from scipy.sparse import csr_array, eye_array
from scipy.sparse.linalg import spsolve

TURN = 2 * np.pi
THIN = 1e-12
"""A triangle of less area, by products of its corners' distances, counts as a line."""


def shape_preserving(points, faces, loop, border):
    """Map a disk into a convex polygon.

    Parameters
    ----------
    points : ndarray, shape (N, 3)
    faces : ndarray of int, shape (F, 3)
    loop : ndarray of int
        The border's vertices.
    border : ndarray, shape (len(loop), 2)
        Where they lie in the map.

    Returns
    -------
    ndarray, shape (N, 2)
    """
    places = np.empty((len(points), 2))
    places[loop] = border
    inner = np.setdiff1d(np.arange(len(points)), loop)
    rows = weights(points, faces, inner)
    system = (eye_array(len(inner), format="csr") - rows[:, inner]).tocsc()
    places[inner] = spsolve(system, rows[:, loop] @ border).reshape(-1, 2)
    return places


def weights(points, faces, inner):
    """Return how much of each neighbour an inner vertex is: a row each, none negative, of sum 1."""
    rings = neighbours_in_turn(faces, inner, len(points))
    counts = (rings >= 0).sum(axis=1)
    ring = unrolled(points, inner, rings, counts)
    found = ring_weights(*ring, counts)
    there = rings >= 0
    rows = np.broadcast_to(np.arange(len(inner))[:, None], rings.shape)[there]
    return csr_array((found[there], (rows, rings[there])), shape=(len(inner), len(points)))


def neighbours_in_turn(faces, inner, count):
    """Return the neighbours of inner vertices in cyclic order, shape (M, most neighbours); -1 where there are no more.

    Raises
    ------
    ValueError
        If the triangles around a vertex do not close to one ring.
    """
    faces = faces.astype(np.int64)
    centre, here, after = (np.concatenate([faces[:, (k + turn) % 3] for k in range(3)]) for turn in range(3))
    keys = centre * count + here
    order = np.argsort(keys)
    keys, after = keys[order], after[order]
    first = np.minimum(np.searchsorted(keys, inner * count), len(keys) - 1)
    degrees = np.bincount(centre, minlength=count)[inner]
    start = keys[first] - inner * count
    rings = np.full((len(inner), degrees.max(initial=0)), -1)
    now = start
    for step in range(rings.shape[1]):
        going = step < degrees
        rings[going, step] = now[going]
        key = inner * count + now
        at = np.minimum(np.searchsorted(keys, key), len(keys) - 1)
        if (going & ((keys[at] != key) | ((step > 0) & (now == start)))).any():
            raise ValueError("triangles around an inner vertex do not close to one ring")
        now = np.where(going, after[at], now)
    if (now != start).any():
        raise ValueError("triangles around an inner vertex do not close to one ring")
    return rings


def unrolled(points, inner, rings, counts):
    """Return the geodesic polar map of rings: lengths are kept, angles scaled to sum to a turn.

    Returns
    -------
    lengths, directions : ndarray, shape (M, most neighbours)
        0 and infinite where there are no more; directions ascend from 0.
    """
    there = rings >= 0
    step = np.arange(rings.shape[1])
    spokes = np.where(there[..., None], points[rings] - points[inner][:, None], 0.0)
    following = np.where(step + 1 < counts[:, None], step + 1, 0)
    after = np.take_along_axis(spokes, following[..., None], axis=1)
    angles = np.arctan2(np.linalg.norm(np.cross(spokes, after), axis=2), np.einsum("mki,mki->mk", spokes, after))
    angles = np.where(there, angles, 0.0)
    angles = np.where(there & (angles.sum(axis=1, keepdims=True) == 0), 1.0, angles)  # a needle: all alike
    angles *= TURN / angles.sum(axis=1, keepdims=True)
    directions = np.where(there, np.cumsum(angles, axis=1) - angles, np.inf)
    return np.linalg.norm(spokes, axis=2), directions


def ring_weights(lengths, directions, counts):
    """Return the weights of the neighbours of unrolled rings.

    Each neighbour has a triangle with the side of the ring that lies opposite, across the centre. What the centre is of
    its corners is averaged over these triangles, of which there are as many as neighbours. Where one is but a line, the
    centre lies between its neighbour and the corner that is more nearly opposite.

    Parameters
    ----------
    lengths, directions : ndarray, shape (M, most neighbours)
        As of `unrolled`.
    counts : ndarray of int, shape (M,)
        Neighbours of each centre.

    Returns
    -------
    ndarray, shape (M, most neighbours)
    """
    total = np.zeros_like(lengths)
    for a in range(lengths.shape[1]):
        there = np.flatnonzero(a < counts)
        b, c, is_b_nearer = side_across(directions[there], counts[there], a)
        corners = (np.full_like(b, a), b, c)
        reach = [lengths[there, corner] for corner in corners]
        angles = [directions[there, corner] for corner in corners]
        shares = shares_in_triangle(*(r[:, None] * unit(t) for r, t in zip(reach, angles, strict=True)))
        on_line = shares_on_line(*reach, is_b_nearer)
        shares = np.where(np.isfinite(shares).all(axis=1, keepdims=True), shares, on_line)
        for corner, share in zip(corners, shares.T, strict=True):
            total[there, corner] += share / counts[there]
    return total


def side_across(directions, counts, a):
    """Return the ends of the side of rings that lies opposite their a-th neighbour, and whether the first is nearer."""
    rows = np.arange(len(counts))
    opposite = (directions[:, a] + np.pi) % TURN
    b = (directions <= opposite[:, None]).sum(axis=1) - 1
    c = (b + 1) % counts
    end = np.where(c == 0, TURN, directions[rows, c])
    return b, c, opposite - directions[rows, b] <= end - opposite


def shares_in_triangle(a, b, c):
    """Return the barycentric coordinates of the origin in triangles, shape (M, 3); NaN where one is but a line."""
    areas = np.maximum(np.stack([cross(b, c), cross(c, a), cross(a, b)], axis=1), 0.0)
    area = areas.sum(axis=1)
    p, q, r = (np.linalg.norm(corner, axis=1) for corner in (a, b, c))
    return areas / np.where(area > THIN * (p * q + q * r + r * p), area, np.nan)[:, None]


def shares_on_line(a, b, c, is_b_nearer):
    """Return the weights of three corners at such distances, where the origin lies between the first and another."""
    other = np.where(is_b_nearer, b, c)
    lever = a + other
    of_other = np.where(lever > 0, a / np.where(lever > 0, lever, 1.0), 0.5)
    return np.stack([1 - of_other, of_other * is_b_nearer, of_other * ~is_b_nearer], axis=1)


def unit(angles):
    """Return unit vectors in these directions, shape (M, 2)."""
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def cross(a, b):
    """Return the cross products of vectors in the plane."""
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
