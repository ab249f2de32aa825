"""A surface in flat pieces: what all atlases hold, whoever made the pieces."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from voxflat import _core
from voxflat.distortion.triangles import isometric, quasi_conformal
from voxflat.io.provenance import Record
from voxflat.io.spaces import Space

FIGURES = {
    "isometric": "C: greatest factor by which lengths change",
    "quasi_conformal": "K: ratio of the stretches along and across",
    "areal": "area in the plane divided by area on the surface",
}
"""The figures of a triangle that a heat map shows, and what they mean."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Piece:
    """A part of a surface in the plane.

    Parameters
    ----------
    face_ids : ndarray of int64, shape (G,)
        Its triangles, as rows of the atlas's `faces`.
    vertex_ids : ndarray of int64, shape (P,)
        What each row of `uv` is, as a row of the atlas's `points`; twice where it lies on both sides of a cut.
    uv : ndarray, shape (P, 2)
        Places in the plane, mm.
    faces : ndarray of int64, shape (G, 3)
        Its triangles, by rows of `uv`; counterclockwise.
    area : float
        On the surface, mm².
    isometric, quasi_conformal : float
        The greatest max(σ1, 1/σ2) and σ1/σ2 of its triangles, measured in the plane.
    """

    face_ids: NDArray[np.int64]
    vertex_ids: NDArray[np.int64]
    uv: NDArray[np.float64]
    faces: NDArray[np.int64]
    area: float
    isometric: float
    quasi_conformal: float

    def __repr__(self) -> str:
        name = type(self).__name__
        return f"<{name}: {len(self.faces)} triangles, area {self.area:.4g}, C = {self.isometric:.4f}>"


Own = TypeVar("Own", bound="FlatPieces")


@dataclass(frozen=True, eq=False, kw_only=True)
class FlatPieces:
    """A surface as flat pieces: every triangle lies in one of them. `Atlas` says what its arrays are."""

    points: NDArray[np.float64]
    faces: NDArray[np.int64]
    ids: NDArray[np.int64]
    piece_ids: NDArray[np.int64]
    patch_ids: NDArray[np.int64]
    stretch: NDArray[np.float64]
    starts: NDArray[np.int64]
    vertex_ids: NDArray[np.int64]
    uv: NDArray[np.float64]
    uv_faces: NDArray[np.int64]
    metadata: dict[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        """Return the number of pieces."""
        return len(self.starts) - 1

    @property
    def space(self) -> Space:
        """The space of its points, as `Surface.space`."""
        return Space._of(self.metadata)

    @property
    def provenance(self) -> Record:
        """What made it: version, function, parameters, and the files that were read."""
        return dict(self.metadata.get("provenance", {}))

    def _with_provenance(self: Own, record: Record) -> Own:
        """Return the same with a record of what made it."""
        return replace(self, metadata={**self.metadata, "provenance": record})

    @cached_property
    def normals(self) -> NDArray[np.float64]:
        """Outward unit normals of the vertices, weighted by areas, shape (N, 3); NaN for a sheet."""
        if self.metadata.get("sheet"):
            return np.full(self.points.shape, np.nan)
        return _core.vertex_normals(self.points, self.faces.astype(np.uint32))

    @property
    def isometric(self) -> NDArray[np.float64]:
        """C of each triangle, max(σ1, 1/σ2): by what factor lengths change at most, shape (F,)."""
        return isometric(self.stretch)

    @property
    def quasi_conformal(self) -> NDArray[np.float64]:
        """K of each triangle, σ1/σ2, shape (F,)."""
        return quasi_conformal(self.stretch)

    @property
    def areal(self) -> NDArray[np.float64]:
        """Area in the plane by area on the surface of each triangle, σ1 σ2, shape (F,)."""
        return np.asarray(self.stretch.prod(axis=1))
