"""Planar and developable surfaces in space, which have a flat map without distortion.

Each shape is a lattice of planar quadrilaterals in the plane, the same lattice folded in space, and a mesh of irregular
triangles on both. The mesh in space has exactly the edge lengths of the flat one. Lengths are in mm.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation


class Developable(NamedTuple):
    points: np.ndarray  # in space
    faces: np.ndarray
    flat: np.ndarray  # in the plane


# ------------------------------------------------------------------------------------------------------------- shapes
# `finer` divides the edges, which are 2 mm long where it is 1.


def square(finer=1):
    return plate(finer)


def u_shape(finer=1):
    return plate(finer, lambda x, y: (np.abs(x - 30) > 10) | (y < 15))


def u_scroll(finer=1):
    """A U rolled up, more than once around."""
    return plate(finer, lambda x, y: (np.abs(x - 30) > 10) | (y < 15), turn=7.0)


def slit(finer=1):
    return plate(finer, lambda x, y: (np.abs(x - 29) > 1) | (y < 8))


def comb(finer=1):
    return plate(finer, lambda x, y: (y < 8) | (x % 12 < 6))


def keyhole(finer=1):
    return plate(finer, lambda x, y: (np.hypot(x - 30, y - 30) > 14) & ((np.abs(x - 30) > 2) | (y < 30)))


def annulus(finer=1):
    return plate(finer, lambda x, y: (np.hypot(x - 30, y - 30) > 12) & (np.hypot(x - 30, y - 30) < 30))


def plate_with_hole(finer=1):
    return plate(finer, lambda x, y: (np.abs(x - 30) > 10) | (np.abs(y - 30) > 10))


def spiral(finer=1):
    """Two turns of a planar spiral, 6 mm apart, wound on a cone."""
    angle = np.linspace(0, 4 * np.pi, 61)
    inner = (8 + 8 * angle / np.pi)[:, None] * direction(angle)
    return mesh(*rolled(inner, inner + 10 * direction(angle), turn=3.0), (3 * finer, 5 * finer))


def cone(finer=1, inner=6.0):
    """A sector of 200° of an annulus, as a truncated cone that is cut open."""
    ray = direction(np.radians(np.linspace(0, 200, 41)))
    return mesh(*rolled(inner * ray, 46 * ray, turn=4.6), (2 * finer, 20 * finer))


def cone_with_apex(finer=1):
    return cone(finer, inner=0.0)


def tangent_developable(finer=1):
    """Tangents of a helix, from 6 to 34 mm beyond the points where they touch it."""
    angle = np.linspace(0, 1.5 * np.pi, 41)
    helix, tangent = 20 * direction(angle), direction(angle + np.pi / 2)
    return mesh(*rolled(helix + 6 * tangent, helix + 34 * tangent, turn=2.5), (2 * finer, 14 * finer))


def miura_ori(finer=1):
    """A sheet folded along zigzag lines, with parallelograms of 10 mm with angles of 60°."""
    column, row = np.indices((7, 7))
    shear, fold = np.pi / 3, 0.7
    flat = np.stack([10 * np.sin(shear) * column, 10 * row + 10 * np.cos(shear) * (column % 2)], axis=-1)
    height = np.sin(fold) * np.sin(shear)
    spread = np.hypot(1, np.cos(fold) * np.tan(shear))
    x = 10 * column * np.cos(fold) * np.tan(shear) / spread
    y = 10 * row * np.sqrt(1 - height**2) + 10 * (column % 2) / spread
    return mesh(flat, np.stack([x, y, 10 * height * (row % 2)], axis=-1), (5 * finer, 5 * finer))


def cube_net(finer=1):
    """A cube of 20 mm, cut along seven of its edges."""
    flat = 20.0 * np.moveaxis(np.indices((4, 5)), 0, -1)
    around = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]])
    space = np.zeros((4, 5, 3))
    space[1:3, :, 1:], space[2, :, 0] = around, 1
    space[0, 1:3, 2], space[3, 1:3, 0], space[3, 1:3, 2] = [0, 1], 1, [0, 1]
    return mesh(flat, 20 * space, (10 * finer, 10 * finer), lambda x, y: (np.abs(x - 30) < 10) | (np.abs(y - 30) < 10))


def closed_cube(finer=1):
    """Return points and faces of the cube of `cube_net` without its cuts."""
    points, faces, _ = cube_net(finer)
    _, kept, same = np.unique(np.round(points, 6), axis=0, return_index=True, return_inverse=True)
    return points[kept], same.reshape(-1)[faces]


SHAPES = (
    *(square, u_shape, u_scroll, slit, comb, keyhole, annulus, plate_with_hole, spiral, cone, cone_with_apex),
    *(tangent_developable, miura_ori, cube_net),
)


# ------------------------------------------------------------------------------------------------------------- measures


def edge_ratios(points, faces, uv):
    """Return the lengths of the edges of a map, divided by those in space."""
    ends = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    flat, curved = (np.linalg.norm(places[ends[:, 0]] - places[ends[:, 1]], axis=1) for places in (uv, points))
    return flat / curved


def angle_changes(points, faces, uv):
    """Return the changes of the angles of triangles in a map, in degrees."""
    flat, curved = (np.degrees(corner_angles(places[faces])) for places in (uv, points))
    return np.abs(flat - curved)


def corner_angles(corners):
    following, preceding = (np.roll(corners, step, axis=1) - corners for step in (-1, 1))
    sides = (side / np.linalg.norm(side, axis=2, keepdims=True) for side in (following, preceding))
    return np.arccos(np.clip(np.sum(np.multiply(*sides), axis=2), -1, 1))


# ------------------------------------------------------------------------------------------------------------- lattices


def direction(angle):
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def plate(finer, keep=None, turn=1.3):
    """Return the part of a square of 60 mm where keep(x, y), bent in 14 folds that are parallel to the y axis."""
    start, end = (np.stack(np.broadcast_arrays(np.linspace(0, 60, 16), y), axis=-1) for y in (0.0, 60.0))
    return mesh(*rolled(start, end, turn), (2 * finer, 30 * finer), keep)


def rolled(start, end, turn):
    """Return a strip of quadrilaterals between rulings in the plane, and folded about all of them, by `turn` in all."""
    flat = np.stack([start, end], axis=1)
    space = np.pad(flat, ((0, 0), (0, 0), (0, 1)))
    for n in range(1, len(space) - 1):
        hinge = space[n, 1] - space[n, 0]
        fold = Rotation.from_rotvec(turn / (len(space) - 2) * hinge / np.linalg.norm(hinge))
        following = space[n + 1 :] - space[n, 0]
        space[n + 1 :] = space[n, 0] + fold.apply(following.reshape(-1, 3)).reshape(following.shape)
    return flat, space


def mesh(flat, space, cells, keep=None):
    """Divide each quadrilateral of a lattice into cells, and these into triangles, in a random pose in space.

    Cells whose centre in the plane is not at keep(x, y) are omitted. Vertices are moved at random, except on the
    boundary; those on a fold stay on it.
    """
    rng = np.random.default_rng(1)
    counts = np.multiply(np.subtract(flat.shape[:2], 1), cells)
    number = np.arange(np.prod(counts + 1)).reshape(counts + 1)
    centres = on_lattice(flat, (np.indices(counts).reshape(2, -1).T + 0.5) / cells)
    kept = np.ones(counts, dtype=bool) if keep is None else keep(*centres.T).reshape(counts)
    full = np.pad(kept, 1)
    inside = full[1:, 1:] & full[1:, :-1] & full[:-1, 1:] & full[:-1, :-1]
    index = np.indices(counts + 1)
    moved = rng.uniform(-0.25, 0.25, index.shape) * inside * (index % np.reshape(cells, (2, 1, 1)) > 0)
    places = (index + moved).reshape(2, -1).T / cells
    a, b, c, d = (part[kept] for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    other = rng.random(len(a)) < 0.5
    first = np.stack([a, b, np.where(other, d, c)], axis=1)
    faces = np.concatenate([first, np.stack([np.where(other, b, a), c, d], axis=1)])
    # vertices at the apex of a cone are one
    _, used, same = np.unique(np.round(on_lattice(flat, places), 9), axis=0, return_index=True, return_inverse=True)
    faces = same.reshape(-1)[faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    corners, faces = np.unique(faces, return_inverse=True)
    places = places[used[corners]]
    points = Rotation.random(None, rng).apply(on_lattice(space, places)) + rng.uniform(-50, 50, 3)
    return Developable(points, faces.reshape(-1, 3), on_lattice(flat, places))


def on_lattice(lattice, places):
    """Return the positions at fractional indices of a lattice, bilinearly."""
    corner = np.minimum(places.astype(int), np.subtract(lattice.shape[:2], 2))
    (i, j), (s, t) = corner.T, (places - corner).T[..., None]
    low, high = ((1 - s) * lattice[i, n] + s * lattice[i + 1, n] for n in (j, j + 1))
    return (1 - t) * low + t * high
