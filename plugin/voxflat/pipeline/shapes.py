"""The surface of one frame of a movie, and the nearest points on it and on its boundary."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from voxflat import _core
from voxflat.maps.depth import vertex_areas

_Floats = NDArray[np.float64]
_Faces = NDArray[np.uint32]

ALIKE = 0.3  # least cosine of the angle between the normals of corresponding places
_TURN = 0.1  # distance that weighs as much as a difference of normals of 1, relative to the size of the surface


@dataclass(frozen=True, eq=False)
class Shape:
    """Store the surface of one frame, and find the nearest points on it."""

    points: _Floats
    faces: _Faces

    @cached_property
    def normals(self) -> _Floats:
        """The outward unit normals of the vertices."""
        return _core.vertex_normals(self.points, self.faces)

    @cached_property
    def areas(self) -> _Floats:
        """The area around each vertex."""
        return vertex_areas(self.points, self.faces)

    @cached_property
    def size(self) -> float:
        """The radius of the sphere with the same area."""
        return float(np.sqrt(self.areas.sum() / (4 * np.pi)))

    @property
    def centre(self) -> _Floats:
        """The centre of gravity of the area."""
        return np.asarray(np.einsum("n,nx->x", self.areas, self.points) / self.areas.sum())

    @cached_property
    def finder(self) -> _core.NearestFinder:
        """The finder of nearest points."""
        return _core.NearestFinder(self.points, self.faces)

    @cached_property
    def border(self) -> Border | None:
        """The boundary, if there is one."""
        edges = boundary_edges(self.faces)
        return Border(self, edges) if len(edges) else None

    def nearest(self, places: _Floats) -> tuple[_Faces, _Floats, _Floats]:
        """Return the corners (P, 3) of the nearest triangles, barycentric coordinates (P, 3) and distances (P,)."""
        triangles, weights, far = self.finder.find(np.ascontiguousarray(places), np.inf)
        return self.faces[triangles], weights, far

    @cached_property
    def _oriented(self) -> Any:
        """A search tree of the positions and normals of the vertices."""
        return scipy.spatial.cKDTree(np.nan_to_num(np.hstack([self.points, _TURN * self.size * self.normals])))

    def facing(self, places: _Floats, normals: _Floats) -> tuple[_Faces, _Floats, NDArray[np.bool_]]:
        """Return the corners (P, 3) and weights (P, 3) of near places with similar normals, and where there are any.

        They are the nearest places, or where their normals differ, as on the other wall of a furrow, a vertex that is
        near in position and direction.
        """
        corners, weights, _ = self.nearest(places)
        alike = (self.mixed(self.normals, corners, weights) * normals).sum(axis=1) > ALIKE
        other = np.flatnonzero(~alike & np.isfinite(normals).all(axis=1))
        if len(other):
            oriented = np.hstack([places[other], _TURN * self.size * normals[other]])
            nearest = self._oriented.query(oriented)[1]
            corners[other], weights[other] = nearest[:, None], [1.0, 0.0, 0.0]
            alike[other] = (self.normals[nearest] * normals[other]).sum(axis=1) > ALIKE
        return corners, weights, alike

    def mixed(self, values: _Floats, corners: _Faces, weights: _Floats) -> _Floats:
        """Interpolate values (N, 3) of vertices."""
        return np.asarray(np.einsum("pc,pcx->px", weights, values[corners]))


@dataclass(frozen=True, eq=False)
class Border:
    """The boundary of a surface."""

    of: Shape
    edges: NDArray[np.int64]

    @cached_property
    def vertices(self) -> NDArray[np.int64]:
        """The vertices on the boundary."""
        return np.unique(self.edges)

    def nearest(self, places: _Floats) -> tuple[_Floats, _Floats]:
        """Return the nearest points on the boundary, and the unit directions of the boundary there."""
        starts, ends = (self.of.points[self.edges[:, side]] for side in (0, 1))
        tree = scipy.spatial.cKDTree((starts + ends) / 2)
        _, close = tree.query(places, k=min(8, len(self.edges)))
        close = close.reshape(len(places), -1)
        start, along = starts[close], (ends - starts)[close]
        length = (along**2).sum(axis=2)
        share = np.clip(((places[:, None] - start) * along).sum(axis=2) / length, 0, 1)
        feet = start + share[..., None] * along
        best = np.linalg.norm(feet - places[:, None], axis=2).argmin(axis=1)
        rows = np.arange(len(places))
        return feet[rows, best], along[rows, best] / np.sqrt(length[rows, best])[:, None]


def boundary_edges(faces: NDArray[Any]) -> NDArray[np.int64]:
    """Return the edges with only one triangle, shape (B, 2)."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64), axis=1)
    once, times = np.unique(edges, axis=0, return_counts=True)
    return np.asarray(once[times == 1])
