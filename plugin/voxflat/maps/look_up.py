"""The inverse look-up: from places in the plane to triangles, barycentric coordinates, and places in space."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat.errors import InputError

__all__ = ["Places", "TriangleFinder"]

_SLACK = 1e-9  # of a triangle, by which rounding may put a place on a side that two share beside both
_PAIRS = 1 << 20  # of places and triangles that are compared at once


@dataclass(frozen=True, eq=False)
class Places:
    """Places in the plane, looked up on the surface.

    Parameters
    ----------
    face_ids : ndarray of int64, shape (...)
        The triangle that lies there, a row of `faces`; −1 for none.
    weights : ndarray of float64, shape (..., 3)
        Barycentric coordinates there, by the triangle's corners; NaN for none.
    points : ndarray of float64, shape (..., 3)
        The place in space, RAS+ mm; NaN for none.
    piece_ids : ndarray of int64, shape (...)
        The piece of an atlas; 0 on a map, which has one; −1 for none.
    """

    face_ids: NDArray[np.int64]
    weights: NDArray[np.float64]
    points: NDArray[np.float64]
    piece_ids: NDArray[np.int64]

    def __repr__(self) -> str:
        found = int(np.count_nonzero(self.face_ids >= 0))
        return f"<Places: {found} of {self.face_ids.size} on a triangle>"


@dataclass(frozen=True, eq=False)
class TriangleFinder:
    """Finds the triangles that lie at places in the plane, by a grid of cells.

    Parameters
    ----------
    corners : ndarray of float64, shape (F, 3, 2)
        The triangles' corners, mm.
    """

    corners: NDArray[np.float64]

    @cached_property
    def _grid(self) -> tuple[NDArray[np.float64], NDArray[np.int64], float]:
        """Lowest corner, number of cells along u and v, and the cells' side: about as many cells as triangles."""
        low, high = self.corners.min(axis=(0, 1)), self.corners.max(axis=(0, 1))
        side = float(np.sqrt((high - low).prod() / len(self.corners))) or float((high - low).max()) or 1.0
        side = max(side, float((high - low).max()) / (4 * len(self.corners)))  # a long thin map has no more cells, too
        return low, np.floor((high - low) / side).astype(np.int64) + 1, side

    @cached_property
    def _cells(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Where each cell's triangles begin, and the triangles whose boxes reach into each cell, ascending."""
        low, shape, side = self._grid
        first, last = (
            np.floor((corner - low) / side).astype(np.int64).clip(0, shape - 1)
            for corner in (self.corners.min(axis=1), self.corners.max(axis=1))
        )
        columns, rows = (last - first + 1).T
        triangles, place = _expanded(columns * rows)
        u = first[triangles, 0] + place % columns[triangles]
        v = first[triangles, 1] + place // columns[triangles]
        cells = v * shape[0] + u
        order = np.argsort(cells, kind="stable")
        return np.searchsorted(cells[order], np.arange(shape.prod() + 1)), triangles[order]

    def look_up(
        self,
        places: ArrayLike,
        points: NDArray[np.float64],
        *,
        torn: NDArray[np.bool_] | None = None,
        piece_ids: NDArray[np.int64] | None = None,
    ) -> Places:
        """Look up places.

        Parameters
        ----------
        places : array_like, shape (..., 2)
            (u, v), mm.
        points : ndarray, shape (F, 3, 3)
            The corners in space.
        torn : ndarray of bool, shape (F,), optional
            Triangles that stand for their nearest corner.
        piece_ids : ndarray of int64, shape (F,), optional
            The piece of each triangle.

        Returns
        -------
        Places

        Raises
        ------
        InputError
            If the places have another shape.
        """
        wanted = np.asarray(places, dtype=np.float64)
        if wanted.ndim == 0 or wanted.shape[-1] != 2:
            raise InputError(f"places have shape {wanted.shape}; give (u, v) in mm, shape (..., 2)")
        triangles, weights = self.find(wanted.reshape(-1, 2))
        if torn is not None and (at := (triangles >= 0) & torn[triangles]).any():
            apart = np.linalg.norm(self.corners[triangles[at]] - wanted.reshape(-1, 1, 2)[at], axis=2)
            weights[at] = np.eye(3)[apart.argmin(axis=1)]
        found = np.einsum("pc,pcx->px", weights, points[triangles])  # NaN where there is none
        pieces = np.where(triangles < 0, -1, 0 if piece_ids is None else piece_ids[triangles])
        shape = wanted.shape[:-1]
        return Places(
            triangles.reshape(shape), weights.reshape(*shape, 3), found.reshape(*shape, 3), pieces.reshape(shape)
        )

    def find(self, places: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Find the triangle at each place.

        Parameters
        ----------
        places : ndarray, shape (P, 2)
            (u, v), mm; those that are not finite lie nowhere.

        Returns
        -------
        triangles : ndarray of int64, shape (P,)
            The first that holds the place; −1 for none.
        weights : ndarray, shape (P, 3)
            NaN for none.
        """
        triangles = np.full(len(places), -1, dtype=np.int64)
        weights = np.full((len(places), 3), np.nan)
        low, shape, side = self._grid
        starts, inside = self._cells
        with np.errstate(invalid="ignore"):
            cell = np.floor((places - low) / side)
            cell = np.where(cell == shape, shape - 1, cell)  # the upper border
            known = np.flatnonzero(((cell >= 0) & (cell < shape)).all(axis=1))
        number = cell[known].astype(np.int64) @ [1, shape[0]]
        counts = starts[number + 1] - starts[number]
        for part in np.split(np.arange(len(known)), np.searchsorted(np.cumsum(counts), _steps(counts))):
            which, place = _expanded(counts[part])
            candidates = inside[starts[number[part]][which] + place]
            at = known[part][which]
            found = _barycentric(self.corners[candidates], places[at])
            hit = np.flatnonzero((found >= -_SLACK).all(axis=1))
            at, first = np.unique(at[hit], return_index=True)
            triangles[at], weights[at] = candidates[hit[first]], found[hit[first]]
        return triangles, weights


def _expanded(counts: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return each number as often as it counts, and which time it is, from 0."""
    owner = np.repeat(np.arange(len(counts)), counts)
    return owner, np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)


def _steps(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return where to split work that counts so much."""
    return np.arange(_PAIRS, int(counts.sum()), _PAIRS)


def _barycentric(corners: NDArray[np.float64], places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return barycentric coordinates; NaN in triangles without area."""
    a, b, c = (corners[:, k] - places for k in range(3))
    parts = np.stack([_cross(b, c), _cross(c, a), _cross(a, b)], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(parts / _cross(b - a, c - a)[:, None])


def _cross(one: NDArray[np.float64], two: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0])
