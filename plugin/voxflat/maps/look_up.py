"""The inverse look-up: from places in the plane to triangles, barycentric coordinates, and places in space."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat import _core
from voxflat.arguments import numbers_of
from voxflat.errors import InputError


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
        The place on the surface, RAS+ mm in its `space`; NaN for none.
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
    """Finds the triangles that lie at places in the plane, by their corners (F, 3, 2), mm."""

    corners: NDArray[np.float64]

    @cached_property
    def _core(self) -> _core.TriangleFinder:
        return _core.TriangleFinder(np.ascontiguousarray(self.corners, dtype=np.float64))

    def look_up(
        self,
        places: ArrayLike,
        points: NDArray[np.float64],
        faces: NDArray[Any],
        *,
        torn: NDArray[np.bool_] | None = None,
        piece_ids: NDArray[np.int64] | None = None,
    ) -> Places:
        """Look up places (u, v), mm; torn triangles stand for their nearest corner."""
        wanted = numbers_of(places, "places")
        if wanted.ndim == 0 or wanted.shape[-1] != 2:
            raise InputError(f"places have shape {wanted.shape}; give (u, v) in mm, shape (..., 2)")
        triangles, weights = self.find(wanted.reshape(-1, 2))
        if torn is not None and (at := (triangles >= 0) & torn[triangles]).any():
            apart = np.linalg.norm(self.corners[triangles[at]] - wanted.reshape(-1, 1, 2)[at], axis=2)
            weights[at] = np.eye(3)[apart.argmin(axis=1)]
        found = np.einsum("pc,pcx->px", weights, points[faces[triangles]])  # NaN where there is none
        pieces = np.where(triangles < 0, -1, 0 if piece_ids is None else piece_ids[triangles])
        shape = wanted.shape[:-1]
        return Places(
            triangles.reshape(shape), weights.reshape(*shape, 3), found.reshape(*shape, 3), pieces.reshape(shape)
        )

    def find(self, places: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Find the first triangle that holds each place, −1 for none, and its weights there, (P, 3), NaN for none."""
        return self._core.find(np.ascontiguousarray(places, dtype=np.float64))
