"""A surface divided into flat pieces: the arrays that all atlases hold."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from voxflat import _core
from voxflat.distortion.triangles import isometric, quasi_conformal
from voxflat.io.origin import Origin
from voxflat.io.provenance import Record
from voxflat.io.spaces import Space
from voxflat.read_only import ReadOnly

FIGURES = {
    "isometric": "C: greatest factor by which lengths change",
    "quasi_conformal": "K: ratio of the two principal stretches",
    "areal": "area in the plane divided by area on the surface",
}
"""The figures of triangles that heat maps show, with their descriptions."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Piece(ReadOnly):
    """A part of a surface in the plane; `FlatPatch` documents the fields."""

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
class FlatPieces(ReadOnly):
    """A surface divided into flat pieces; every triangle lies in one piece. `Atlas` documents the arrays."""

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
    origin: Origin
    warnings: tuple[str, ...] = ()
    details: dict[str, object] = field(default_factory=dict)
    record: Record = field(default_factory=dict)

    def __len__(self) -> int:
        """Return the number of pieces."""
        return len(self.starts) - 1

    @property
    def space(self) -> Space:
        """The coordinate space of the points, as in `Surface.space`.

        `Space.to_scanner` converts points to the scanner space in which volumes lie.
        """
        return self.origin.space

    @property
    def metadata(self) -> dict[str, object]:
        """How the atlas was made, for people and files: written from the fields, and read by no operation."""
        record = {"provenance": self.record} if self.record else {}
        return {**self.origin._described(), **self.details, "warnings": list(self.warnings), **record}

    @property
    def provenance(self) -> Record:
        """The record of how the atlas was made: version, function, parameters and input files."""
        return self.record

    def _with_provenance(self: Own, record: Record) -> Own:
        """Return a copy with a record of how the atlas was made."""
        return replace(self, record=record)

    @cached_property
    def normals(self) -> NDArray[np.float64]:
        """The outward unit normals of the vertices, shape (N, 3).

        Each normal is the area-weighted mean over the adjacent triangles; NaN for a one-voxel-thick surface.
        """
        if self.origin.is_voxels and self.origin.voxels.is_sheet:
            return np.full(self.points.shape, np.nan)
        return _core.vertex_normals(self.points, self.faces.astype(np.uint32))

    @property
    def isometric(self) -> NDArray[np.float64]:
        """The measure C = max(σ1, 1/σ2) of each triangle, shape (F,).

        It is the largest factor by which lengths change.
        """
        return isometric(self.stretch)

    @property
    def quasi_conformal(self) -> NDArray[np.float64]:
        """The measure K = σ1/σ2 of each triangle, shape (F,). It is 1 if angles do not change."""
        return quasi_conformal(self.stretch)

    @property
    def areal(self) -> NDArray[np.float64]:
        """The change in area of each triangle, σ1 σ2, shape (F,).

        It is the area in the plane divided by the area on the surface.
        """
        return np.asarray(self.stretch.prod(axis=1))
