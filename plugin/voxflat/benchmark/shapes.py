"""Surfaces that are defined by a formula, whose best flat map is known.

A cylinder or a cone that is divided along its rulings can be flattened without any change. The distances on a spherical
cap of half-angle α change by a factor of at least α / sin α (Milnor 1969). The catenoid and the helicoid are isometric,
so any method should make the same map of both. Lengths are in mm.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

_Arrays = tuple[NDArray[np.float64], NDArray[np.int64]]

_JITTER = 0.25  # largest random displacement of an inner vertex, in cells
_CAP_RADIUS, _CAP_ANGLE = 50.0, np.pi / 3
_BUMPS = 2.5  # height of the bumps of the scroll


def sphere_cap() -> _Arrays:
    """Return a spherical cap of 60 degrees around its pole, with a radius of 50 mm."""
    rings = 40
    points, first = [np.zeros((1, 2))], [0]
    for ring in range(1, rings + 1):
        turn = 2 * np.pi * (np.arange(6 * ring) / (6 * ring))
        first.append(first[-1] + len(points[-1]))
        points.append(np.column_stack([np.full(len(turn), _CAP_ANGLE * ring / rings), turn]))
    faces = [triangle for ring in range(1, rings + 1) for triangle in _ring(ring, first[ring - 1], first[ring])]
    polar, turn = np.concatenate(points).T
    unit = np.column_stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)])
    return _CAP_RADIUS * unit, np.array(faces)


def _ring(ring: int, inner: int, outer: int) -> list[tuple[int, int, int]]:
    """Return the triangles between two rings of 6 (ring - 1) and 6 ring points."""
    count, faces = 6 * (ring - 1), []
    for sector in range(6):
        for step in range(ring):
            a = outer + sector * ring + step
            b = outer + (sector * ring + step + 1) % (6 * ring)
            c = inner + (sector * (ring - 1) + step) % max(count, 1)
            faces.append((a, b, c))
            if step < ring - 1:
                faces.append((b, inner + (sector * (ring - 1) + step + 1) % count, c))
    return faces


def rolled_square() -> _Arrays:
    """Return a square of 60 mm, rolled once around a cylinder and a little further."""
    x, y, faces = _grid(60, 60)
    return np.column_stack([_wound(60 * x, lambda s: 8 + 0.25 * s), 60 * y]), faces


def cone() -> _Arrays:
    """Return a cone that is cut open along a line: a sector of 160 degrees with a radius of 50 mm, and its apex."""
    angle = np.radians(160)
    x, y, faces = _grid(60, 50)
    radius, turn = 50 * (1 - y), angle * x
    share = angle / 6.0  # of a full turn that the sector covers when it is bent
    points = np.column_stack(
        [
            radius * share * np.cos(turn / share),
            radius * share * np.sin(turn / share),
            -radius * np.sqrt(1 - share**2),
        ]
    )
    is_apex = y == 1
    numbers = np.where(is_apex, np.flatnonzero(is_apex)[0], np.arange(len(y)))[faces]
    numbers = numbers[(numbers != np.roll(numbers, 1, axis=1)).all(axis=1)]
    used, compact = np.unique(numbers, return_inverse=True)
    return points[used], compact.reshape(-1, 3)


def u_shape() -> _Arrays:
    """Return a U with arms of 20 mm, cut out of a square of 60 mm that is bent around a cylinder."""
    x, y, faces = _grid(60, 60)
    centre_x, centre_y = x[faces].mean(axis=1), y[faces].mean(axis=1)
    faces = faces[(np.abs(centre_x - 0.5) > 1 / 6) | (centre_y < 0.25)]
    used, compact = np.unique(faces, return_inverse=True)
    points = np.column_stack([_wound(60 * x, lambda s: 25 + 0 * s), 60 * y])
    return points[used], compact.reshape(-1, 3)


def catenoid() -> _Arrays:
    """Return a patch of the catenoid with a waist of 20 mm, which is isometric to `helicoid`."""
    u, v, faces = _minimal()
    return np.column_stack([20 * np.cosh(v) * np.cos(u), 20 * np.cosh(v) * np.sin(u), 20 * v]), faces


def helicoid() -> _Arrays:
    """Return a patch of the helicoid with a pitch of 2π · 20 mm, which is isometric to `catenoid`."""
    u, v, faces = _minimal()
    return np.column_stack([20 * np.sinh(v) * np.cos(u), 20 * np.sinh(v) * np.sin(u), 20 * u]), faces


def scroll() -> _Arrays:
    """Return a sheet of 400 x 120 mm with bumps, wound in five turns like a scroll."""
    x, y, faces = _grid(250, 75)
    along, across = 400 * x, 120 * y
    height = _BUMPS * (np.sin(along / 7 + np.sin(across / 11)) + np.sin(across / 9 + along / 31))
    path = _wound(along, lambda s: 8 + 0.03 * s)
    normal = _normals(along, lambda s: 8 + 0.03 * s)
    return np.column_stack([path + 0.5 * height[:, None] * normal, across]), faces


SHAPES: dict[str, Callable[[], _Arrays]] = {
    shape.__name__: shape for shape in (sphere_cap, rolled_square, cone, u_shape, catenoid, helicoid, scroll)
}
"""The formulas by name; each returns points (N, 3) and triangles (F, 3)."""


def _minimal() -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    x, y, faces = _grid(60, 50)
    return 3.0 * x, 2.4 * y - 1.2, faces


def _wound(along: NDArray[np.float64], radius: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> NDArray[Any]:
    """Return a planar curve through the distinct values of `along`, with chords of exactly these lengths."""
    knots, which = np.unique(along, return_inverse=True)
    lengths = np.diff(knots)
    turn = np.cumsum(lengths / radius(knots[1:]))
    steps = lengths[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])[which]


def _normals(along: NDArray[np.float64], radius: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> NDArray[Any]:
    knots, which = np.unique(along, return_inverse=True)
    turn = np.concatenate([[0.0], np.cumsum(np.diff(knots) / radius(knots[1:]))])
    return np.column_stack([np.sin(turn), -np.cos(turn)])[which]


def _grid(columns: int, rows: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Return a unit square, divided by random diagonals; inner vertices are moved along their columns at random."""
    rng = np.random.default_rng(67)
    i, j = (axis.ravel() for axis in np.meshgrid(np.arange(columns + 1), np.arange(rows + 1), indexing="ij"))
    is_inner = (i > 0) & (i < columns) & (j > 0) & (j < rows)
    y = (j + is_inner * rng.uniform(-_JITTER, _JITTER, len(j))) / rows
    number = np.arange(len(i)).reshape(columns + 1, rows + 1)
    a, b, c, d = (part.ravel() for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    is_other = rng.random(len(a)) < 0.5
    first = np.column_stack([a, b, np.where(is_other, d, c)])
    return i / columns, y, np.concatenate([first, np.column_stack([np.where(is_other, b, a), c, d])])
