"""Follow a surface from frame to frame of a movie: move a mesh onto the next frame with as little strain as possible.

The shape of the next frame determines how the mesh moves along its normals. In the other directions, the mesh moves so
that the integral of the squared Green strain of its triangles is smallest, as for an elastic sheet that is at rest in
the reference frame, scaled to the area of the next frame. The movement is a sum of smooth functions, from a few
(affine) to many (one per cell of a division of the surface).
"""

from __future__ import annotations

from collections.abc import Callable
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

_CELLS = (30, 150, 600)  # functions of each level after the affine one
_SAMPLES = 24  # points per function at which positions and strains are compared
_FEWEST_SAMPLES = 1500
_STEPS = (15, 8, 6, 4)  # Gauss-Newton steps of each level
_STILL = 2e-4  # change of a step, relative to the size of the surface, at which a level ends
_REACH = 0.1  # deviation that weighs as much as a strain of 1, relative to the size of the surface
_ALIKE = 0.3  # least cosine of the angle between the normals of corresponding places
_RIDGE = 1e-9  # relative; decides where neither shape nor strain do, such as turns of a sphere
_UNFOLDINGS = 30  # most attempts
_SMOOTHINGS = (12, 4)  # averaging steps of the movements that close the last gaps


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
        return np.asarray(self.areas @ self.points / self.areas.sum())

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


class Follower:
    """Moves the mesh of a reference frame onto frame after frame."""

    def __init__(self, core: _core.Surface, tick: Callable[[], None] = lambda: None) -> None:
        self._tick = tick  # called often; it may raise an error to stop the work
        self.reference = Shape(core.points, np.ascontiguousarray(core.faces))
        self.faces, self.count = self.reference.faces, len(core)
        starts, ends = self.faces.ravel(), np.roll(self.faces, 1, axis=1).ravel()
        pairs = np.concatenate([starts, ends]), np.concatenate([ends, starts])
        near = scipy.sparse.csr_array((np.ones(len(pairs[0])), pairs), shape=(self.count, self.count))
        near.data[:] = 1.0
        near = near + scipy.sparse.eye_array(self.count)
        self.average = (scipy.sparse.diags_array(1 / near.sum(axis=1)) @ near).tocsr()
        self.bases = [self._cells(core, count) for count in _CELLS if 8 * count < self.count]

    def _cells(self, core: _core.Surface, count: int) -> Any:
        """Return smooth functions that add up to 1, one for each of the cells of a division of the surface."""
        _, cells = core.cells(np.arange(self.count, dtype=np.uint32), count, 0)
        cells = np.maximum(cells.astype(np.int64) - 1, 0)
        basis = scipy.sparse.csr_array((np.ones(self.count), (np.arange(self.count), cells)), shape=(self.count, count))
        for _ in range(max(3, round(0.6 * self.count / count / np.pi))):  # half the radius of a cell
            self._tick()
            basis = self.average @ basis
            basis.data[basis.data < 1e-3] = 0
            basis.eliminate_zeros()
        return (scipy.sparse.diags_array(1 / basis.sum(axis=1)) @ basis).tocsr()

    def onto(self, start: _Floats, target: Shape) -> _Floats:
        """Return the points of the mesh on the next frame; `start` are those on the frame before."""
        before = Shape(start, self.faces)
        shift = target.centre - before.centre
        points = min((start, start + shift), key=lambda places: float(target.nearest(places)[2].mean()))
        rest = Shape(self.reference.points * (target.size / self.reference.size), self.faces)
        affine = np.column_stack([np.ones(self.count), (start - before.centre) / before.size])
        for basis, steps in zip((scipy.sparse.csr_array(affine), *self.bases), _STEPS, strict=False):
            for _ in range(steps):
                move = self._step(rest, points, target, basis)
                points = points + move
                if float(np.sqrt((move**2).sum(axis=1).mean())) < _STILL * rest.size:
                    break
        for averaging in (*_SMOOTHINGS, 0):
            move, alike = self._gap(points, target)
            move[~alike] = 0
            for _ in range(averaging):
                move = self.average @ move
            points = points + move
        return self._unfolded(points, target)

    def _unfolded(self, points: _Floats, target: Shape) -> _Floats:
        """Return points without folds: those of folded triangles move to the mean of their neighbours."""
        for _ in range(_UNFOLDINGS):
            folded = self.folded(points, target)
            if not folded.any():
                break
            near = np.zeros(self.count)
            near[self.faces[folded]] = 1
            rows = np.flatnonzero(self.average @ near)
            if self.reference.border is not None:
                rows = np.setdiff1d(rows, self.reference.border.vertices)
            points = points.copy()
            points[rows] = (self.average @ points)[rows]
            points[rows] += self._gap(points, target)[0][rows]
        return points

    def folded(self, points: _Floats, target: Shape) -> NDArray[np.bool_]:
        """Find the triangles that face against the surface of a frame."""
        a, b, c = (points[self.faces[:, corner]] for corner in range(3))
        corners, weights, _ = target.nearest((a + b + c) / 3)
        normals = target.mixed(target.normals, corners, weights)
        return np.asarray((np.cross(b - a, c - a) * normals).sum(axis=1) < 0)

    def _gap(self, points: _Floats, target: Shape) -> tuple[_Floats, NDArray[np.bool_]]:
        """Return the way from each vertex to the next frame, and whether the normals at both ends agree."""
        self._tick()
        own = Shape(points, self.faces)
        corners, weights, _ = target.nearest(points)
        feet, normals = target.mixed(target.points, corners, weights), target.mixed(target.normals, corners, weights)
        alike = (own.normals * normals).sum(axis=1) > _ALIKE
        if own.border is not None and target.border is not None:
            rows = own.border.vertices
            feet[rows], alike[rows] = target.border.nearest(points[rows])[0], True
        return feet - points, alike

    def _step(self, rest: Shape, points: _Floats, target: Shape, basis: Any) -> _Floats:
        """Return a Gauss-Newton step: the movement (N, 3) within the span of a basis."""
        samples = max(_FEWEST_SAMPLES, _SAMPLES * basis.shape[1])
        own = Shape(points, self.faces)
        blocks = [
            self._fit(own, target, samples),
            self._cover(own, target, samples),
            self._strain(rest, points, samples),
        ]
        if own.border is not None and target.border is not None:
            blocks.append(self._border(own, target))
        reach = _REACH * rest.size
        scales = [1 / reach, 1 / reach, 1.0, 1 / reach]
        columns = 3 * basis.shape[1]
        normal, pull = np.zeros((columns, columns)), np.zeros(columns)
        for (parts, misfit, weights), scale in zip(blocks, scales, strict=False):
            self._tick()
            jacobian = scipy.sparse.hstack([part @ basis for part in parts], format="csr")
            weighted = scipy.sparse.diags_array(weights * scale**2) @ jacobian
            normal += (jacobian.T @ weighted).toarray()
            pull += weighted.T @ misfit
        normal[np.diag_indices(columns)] += _RIDGE * np.trace(normal) / columns
        found = scipy.linalg.solve(normal, pull, assume_a="pos")
        return np.asarray(basis @ found.reshape(3, -1).T)

    def _fit(self, own: Shape, target: Shape, samples: int) -> tuple[list[Any], _Floats, _Floats]:
        """Return how far vertices of the mesh are from the next frame, along its normals."""
        rows, share = _spread(self.count, samples)
        corners, weights, _ = target.nearest(own.points[rows])
        normals = target.mixed(target.normals, corners, weights)
        gap = target.mixed(target.points, corners, weights) - own.points[rows]
        alike = (own.normals[rows] * normals).sum(axis=1) > _ALIKE
        if own.border is not None:
            alike &= ~np.isin(rows, own.border.vertices)
        parts = _rows(rows[:, None], normals[:, None], self.count)
        return parts, (gap * normals).sum(axis=1), own.areas[rows] * share * alike

    def _cover(self, own: Shape, target: Shape, samples: int) -> tuple[list[Any], _Floats, _Floats]:
        """Return how far vertices of the next frame are from the mesh, along the normals of the next frame."""
        rows, share = _spread(len(target.points), samples)
        corners, weights, _ = own.nearest(target.points[rows])
        normals = target.normals[rows]
        gap = target.points[rows] - own.mixed(own.points, corners, weights)
        alike = (own.mixed(own.normals, corners, weights) * normals).sum(axis=1) > _ALIKE
        parts = _rows(corners, weights[..., None] * normals[:, None], self.count)
        return parts, (gap * normals).sum(axis=1), target.areas[rows] * share * alike

    def _border(self, own: Shape, target: Shape) -> tuple[list[Any], _Floats, _Floats]:
        """Return how far the boundary is from that of the next frame, across the boundary."""
        assert own.border is not None
        assert target.border is not None
        rows = own.border.vertices
        feet, along = target.border.nearest(own.points[rows])
        up = own.normals[rows]
        up = up - (up * along).sum(axis=1, keepdims=True) * along
        up /= np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-9)
        across = np.stack([up, np.cross(along, up)]).reshape(-1, 3)
        gap = np.tile(feet - own.points[rows], (2, 1))
        parts = _rows(np.tile(rows, 2)[:, None], across[:, None], self.count)
        return parts, (gap * across).sum(axis=1), np.tile(own.areas[rows], 2)

    def _strain(self, rest: Shape, points: _Floats, samples: int) -> tuple[list[Any], _Floats, _Floats]:
        """Return the Green strain of triangles, with opposite sign."""
        triangles, share = _spread(len(self.faces), samples)
        corners = self.faces[triangles].astype(np.int64)
        a, b, c = (rest.points[corners[:, corner]] for corner in range(3))
        first = (b - a) / np.maximum(np.linalg.norm(b - a, axis=1, keepdims=True), 1e-300)
        cross = np.cross(b - a, c - a)
        twice = np.maximum(np.linalg.norm(cross, axis=1), 1e-9 * rest.size**2 / len(self.faces))
        second = np.cross(cross / twice[:, None], first)
        # gradients of the linear functions that are 1 at one corner, in the plane of the triangle at rest
        turned = (
            np.cross((cross / twice[:, None])[:, None], np.stack([c - b, a - c, b - a], axis=1)) / twice[:, None, None]
        )
        gradient = np.stack([(turned * first[:, None]).sum(axis=2), (turned * second[:, None]).sum(axis=2)], axis=2)
        stretch = np.einsum("tcx,tca->txa", points[corners], gradient)  # (T, 3, 2)
        strain = (np.einsum("txa,txb->tab", stretch, stretch) - np.eye(2)) / 2
        parts: list[list[Any]] = [[], [], []]
        misfit, weights = [], []
        for one, other in ((0, 0), (1, 1), (0, 1)):
            change = stretch[:, None, :, one] * gradient[:, :, None, other]
            change = (change + stretch[:, None, :, other] * gradient[:, :, None, one]) / 2  # (T, corner, axis)
            for axis, rows in enumerate(_rows(corners, change, self.count)):
                parts[axis].append(rows)
            misfit.append(-strain[:, one, other])
            weights.append(twice / 2 * share * (1 if one == other else 2))
        return (
            [scipy.sparse.vstack(each, format="csr") for each in parts],
            np.concatenate(misfit),
            np.concatenate(weights),
        )


def _spread(count: int, samples: int) -> tuple[NDArray[np.int64], float]:
    """Return at most a number of indices in a fixed random order, and how many each of them stands for."""
    if samples >= count:
        return np.arange(count), 1.0
    return np.sort(np.random.default_rng(0).permutation(count)[:samples]), count / samples


def _rows(corners: NDArray[Any], factors: _Floats, count: int) -> list[Any]:
    """Return one sparse matrix (P, N) per axis from the vertices (P, K) and factors (P, K, 3) of each row."""
    rows, each = corners.shape
    starts = np.arange(0, rows * each + 1, each)
    flat = corners.ravel().astype(np.int64)
    return [
        scipy.sparse.csr_array((factors[..., axis].ravel(), flat, starts), shape=(rows, count)) for axis in range(3)
    ]
