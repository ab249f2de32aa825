"""The metric of a map: how lengths, areas and directions in the plane relate to those on the surface."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

_Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Metric:
    """The derivatives of the inverse map in each triangle; NaN where a triangle is torn or has no area."""

    to_surface: _Floats  # (F, 3, 2), the vectors on the surface of the unit vectors along u and v
    to_map: _Floats  # (F, 2, 3), the vectors on the map of vectors in space, whose parts along the normal vanish
    area: _Floats  # (F,), area on the surface of a unit of area on the map
    normals: _Floats  # (F, 3), unit normals

    @cached_property
    def inverse(self) -> _Floats:
        """The inverse metric tensors, shape (F, 2, 2)."""
        return np.asarray(self.to_map @ self.to_map.swapaxes(1, 2))

    @classmethod
    def of(cls, points: _Floats, uv: _Floats, faces: NDArray[np.uint32], torn: NDArray[np.bool_]) -> "Metric":
        """Return the metric of triangles in the plane, (N, 2), and on the surface, (N, 3)."""
        sides = [(places[faces[:, 1:]] - places[faces[:, :1]]).swapaxes(1, 2) for places in (points, uv)]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            to_surface = sides[0] @ _inverse(sides[1])
            to_surface[torn | ~np.isfinite(to_surface).all(axis=(1, 2))] = np.nan
            transposed = to_surface.swapaxes(1, 2)
            to_map = _inverse(transposed @ to_surface) @ transposed
            across = np.cross(to_surface[:, :, 0], to_surface[:, :, 1])
            area = np.linalg.norm(across, axis=1)
            is_known = np.isfinite(to_map).all(axis=(1, 2))
            normals = across / area[:, None]
        for part in (to_surface, to_map, area, normals):
            part[~is_known] = np.nan
        return cls(to_surface, to_map, area, normals)


def _inverse(matrices: _Floats) -> _Floats:
    """Return the inverses of matrices of shape (F, 2, 2); not finite for singular ones."""
    (a, b), (c, d) = matrices.transpose(1, 2, 0)
    return np.asarray((np.array([[d, -b], [-c, a]]) / (a * d - b * c)).transpose(2, 0, 1))
