"""Follow a surface from frame to frame of a movie: move a mesh onto the next frame with as little strain as possible.

The shape of the next frame determines how the mesh moves along its normals. In the other directions, the mesh moves so
that an energy is smallest: that of an elastic sheet that is at rest in the reference frame, scaled to the area of the
next frame, and of friction, which holds the mesh where it was in the frame before. The movement is a sum of smooth
functions, from a few (affine) to many (one per cell of a division of the surface). Landmarks pull the mesh to known
positions.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
import scipy
from numpy.typing import NDArray

from voxflat import _core
from voxflat.pipeline.shapes import ALIKE, Shape

_Floats = NDArray[np.float64]
# linear equations for a movement: one sparse matrix (P, N) per axis, right-hand side (P,) and weights (P,)
_Equations: TypeAlias = tuple[list[Any], _Floats, _Floats]

_CELLS = (30, 150, 600)  # functions of each level after the affine one
_SAMPLES = 24  # points per function at which positions and strains are compared
_FEWEST_SAMPLES = 1500
_STEPS = (15, 8, 6, 4)  # Gauss-Newton steps of each level
# weights of the distances in each level; the next attempt follows where the mesh folds, as a loosely held sheet does
_TIGHT = ((1, 1, 1, 1), (1, 1, 1, 10), (1, 1, 10, 300))
_STILL = 2e-4  # change of a step, relative to the size of the surface, at which a level ends
_REACH = 0.1  # deviation that weighs as much as a strain of 1, relative to the size of the surface
_FRICTION = 0.03  # weight of movements along the surface, relative to that of distances
_PULL = 10.0  # weight of all landmarks, relative to that of distances
_THINNEST = 0.05  # least stretch; keeps the equations of collapsed triangles finite
_RIDGE = 1e-9  # relative; decides where nothing else does
_UNFOLDINGS = 50  # most attempts
_WIDENED = 10  # attempts after which the neighbourhood of folds grows by one ring
_SMOOTHINGS = (12, 4)  # averaging steps of the movements that close the last gaps


class Follower:
    """Moves the mesh of a reference frame onto frame after frame."""

    def __init__(
        self, core: _core.Surface, landmarks: _Floats | None = None, tick: Callable[[], None] = lambda: None
    ) -> None:
        self._tick = tick  # called often; it may raise an error to stop the work
        self.reference = Shape(core.points, np.ascontiguousarray(core.faces))
        self.faces, self.count = self.reference.faces, len(core)
        self.marks = None if landmarks is None else self.reference.nearest(landmarks)[:2]
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

    def onto(self, start: _Floats, target: Shape, landmarks: _Floats | None = None) -> _Floats:
        """Return the points of the mesh on the next frame; `start` are those on the frame before.

        `landmarks` (K, 3) are the positions of the landmarks in the next frame, NaN where they are not known.
        """
        best, fewest = start, len(self.faces) + 1
        for tight in dict.fromkeys(weights[: 1 + len(self.bases)] for weights in _TIGHT):
            points = self._closed(self._moved(start, target, landmarks, tight), target)
            folds = int(self.folded(points, target).sum())
            if folds < fewest:
                best, fewest = points, folds
            if not folds:
                break
        return self._unfolded(best, target)

    def _moved(self, start: _Floats, target: Shape, landmarks: _Floats | None, tight: tuple[float, ...]) -> _Floats:
        """Return the points with the least energy, from few to many functions."""
        before = Shape(start, self.faces)
        shift = target.centre - before.centre
        points = min((start, start + shift), key=lambda places: float(target.nearest(places)[2].mean()))
        rest = Shape(self.reference.points * (target.size / self.reference.size), self.faces)
        affine = np.column_stack([np.ones(self.count), (start - before.centre) / before.size])
        bases = (scipy.sparse.csr_array(affine), *self.bases)
        scale = target.size / before.size
        held = (start - before.centre) * scale + target.centre
        for basis, steps, weight in zip(bases, _STEPS, tight, strict=False):
            samples = max(_FEWEST_SAMPLES, _SAMPLES * basis.shape[1])
            unit = 1 / (_REACH * rest.size) ** 2
            for _ in range(steps):
                moved = Shape(points, self.faces)
                equations = [(self._strain(rest, points, samples), 1.0)]
                equations += [(each, unit * weight) for each in self._distances(moved, target, samples)]
                equations.append((self._friction(moved, held, samples), unit * _FRICTION))
                if self.marks is not None and landmarks is not None:
                    equations.append((self._landmarks(moved, landmarks), unit * weight * _PULL))
                move = self._least_squares(equations, basis)
                points = points + move
                if basis is bases[0]:
                    held = _turned(before, points) * scale + target.centre
                if float(np.sqrt((move**2).sum(axis=1).mean())) < _STILL * rest.size:
                    break
        return points

    def _closed(self, points: _Floats, target: Shape) -> _Floats:
        """Return points on the next frame: movements to the nearest points, at first averaged over neighbours."""
        for averaging in (*_SMOOTHINGS, 0):
            move, alike = self._gap(points, target)
            move[~alike] = 0
            for _ in range(averaging):
                move = self.average @ move
            points = points + move
        return points

    def _unfolded(self, points: _Floats, target: Shape) -> _Floats:
        """Return points without folds: those of folded triangles move to the mean of their neighbours."""
        for attempt in range(_UNFOLDINGS):
            folded = self.folded(points, target)
            if not folded.any():
                break
            near = np.zeros(self.count)
            near[self.faces[folded]] = 1
            for _ in range(1 + attempt // _WIDENED):
                near = self.average @ near
            rows = np.flatnonzero(near)
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
        moved = Shape(points, self.faces)
        corners, weights, _ = target.nearest(points)
        feet, normals = target.mixed(target.points, corners, weights), target.mixed(target.normals, corners, weights)
        alike = (moved.normals * normals).sum(axis=1) > ALIKE
        if moved.border is not None and target.border is not None:
            rows = moved.border.vertices
            feet[rows], alike[rows] = target.border.nearest(points[rows])[0], True
        return feet - points, alike

    def _least_squares(self, equations: list[tuple[_Equations, float]], basis: Any) -> _Floats:
        """Return the movement (N, 3) within the span of a basis that fulfils weighted equations best."""
        columns = 3 * basis.shape[1]
        normal, pull = np.zeros((columns, columns)), np.zeros(columns)
        for (parts, misfit, weights), scale in equations:
            self._tick()
            jacobian = scipy.sparse.hstack([part @ basis for part in parts], format="csr")
            weighted = scipy.sparse.diags_array(weights * scale) @ jacobian
            normal += (jacobian.T @ weighted).toarray()
            pull += weighted.T @ misfit
        normal[np.diag_indices(columns)] += _RIDGE * np.trace(normal) / columns
        solution = _core.solve(normal, pull)
        return np.asarray(basis @ solution.reshape(3, -1).T)

    def _distances(self, moved: Shape, target: Shape, samples: int) -> list[_Equations]:
        """Return the distances between the mesh and the next frame, and between their boundaries."""
        equations = [self._fit(moved, target, samples), self._cover(moved, target, samples)]
        if moved.border is not None and target.border is not None:
            equations.append(self._border(moved, target))
        return equations

    def _fit(self, moved: Shape, target: Shape, samples: int) -> _Equations:
        """Return how far vertices of the mesh are from the next frame, along its normals."""
        rows, share = _spread(self.count, samples)
        corners, weights, alike = target.facing(moved.points[rows], moved.normals[rows])
        normals = target.mixed(target.normals, corners, weights)
        gap = target.mixed(target.points, corners, weights) - moved.points[rows]
        if moved.border is not None:
            alike &= ~np.isin(rows, moved.border.vertices)
        parts = _rows(rows[:, None], normals[:, None], self.count)
        return parts, (gap * normals).sum(axis=1), moved.areas[rows] * share * alike

    def _cover(self, moved: Shape, target: Shape, samples: int) -> _Equations:
        """Return how far vertices of the next frame are from the mesh, along the normals of the next frame."""
        rows, share = _spread(len(target.points), samples)
        corners, weights, alike = moved.facing(target.points[rows], target.normals[rows])
        normals = target.normals[rows]
        gap = target.points[rows] - moved.mixed(moved.points, corners, weights)
        parts = _rows(corners, weights[..., None] * normals[:, None], self.count)
        return parts, (gap * normals).sum(axis=1), target.areas[rows] * share * alike

    def _border(self, moved: Shape, target: Shape) -> _Equations:
        """Return how far the boundary is from that of the next frame, across the boundary."""
        assert moved.border is not None
        assert target.border is not None
        rows = moved.border.vertices
        feet, along = target.border.nearest(moved.points[rows])
        up = moved.normals[rows]
        up = up - (up * along).sum(axis=1, keepdims=True) * along
        up /= np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-9)
        across = np.stack([up, np.cross(along, up)]).reshape(-1, 3)
        gap = np.tile(feet - moved.points[rows], (2, 1))
        parts = _rows(np.tile(rows, 2)[:, None], across[:, None], self.count)
        return parts, (gap * across).sum(axis=1), np.tile(moved.areas[rows], 2)

    def _landmarks(self, moved: Shape, landmarks: _Floats) -> _Equations:
        """Return how far the landmarks of the mesh are from their positions in the next frame."""
        assert self.marks is not None
        is_known = np.isfinite(landmarks).all(axis=1)
        corners, weights = self.marks[0][is_known], self.marks[1][is_known]
        gap = landmarks[is_known] - moved.mixed(moved.points, corners, weights)
        axes = np.asarray(np.repeat(np.eye(3), len(gap), axis=0), dtype=np.float64)
        parts = _rows(np.tile(corners, (3, 1)), np.tile(weights, (3, 1))[..., None] * axes[:, None], self.count)
        return parts, gap.T.ravel(), np.full(gap.size, moved.areas.sum() / max(1, len(gap)))

    def _friction(self, moved: Shape, held: _Floats, samples: int) -> _Equations:
        """Return how far vertices moved along the surface."""
        rows, share = _spread(self.count, samples)
        normals = moved.normals[rows]
        across = np.eye(3)[np.abs(normals).argmin(axis=1)]
        first = np.cross(normals, across)
        first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-9)
        along = np.concatenate([first, np.cross(normals, first)])
        gap = np.tile(held[rows] - moved.points[rows], (2, 1))
        parts = _rows(np.tile(rows, 2)[:, None], along[:, None], self.count)
        return parts, (gap * along).sum(axis=1), np.tile(moved.areas[rows] * share, 2)

    def _strain(self, rest: Shape, points: _Floats, samples: int) -> _Equations:
        """Return half the difference between the stretch of triangles and its inverse, with opposite sign."""
        triangles, share = _spread(len(self.faces), samples)
        corners = self.faces[triangles].astype(np.int64)
        a, b, c = (rest.points[corners[:, corner]] for corner in range(3))
        first = (b - a) / np.maximum(np.linalg.norm(b - a, axis=1, keepdims=True), 1e-300)
        cross = np.cross(b - a, c - a)
        twice = np.maximum(np.linalg.norm(cross, axis=1), 1e-9 * rest.size**2 / len(self.faces))
        up = cross / twice[:, None]
        plane = np.stack([first, np.cross(up, first)], axis=2)
        # gradients of the linear functions that are 1 at one corner, in the plane of the triangle at rest
        gradient = np.cross(up[:, None], np.stack([c - b, a - c, b - a], axis=1)) @ plane / twice[:, None, None]
        stretch = np.swapaxes(points[corners], 1, 2) @ gradient  # (T, 3, 2)
        squares, axes = np.linalg.eigh(np.swapaxes(stretch, 1, 2) @ stretch)
        stretch, gradient = stretch @ axes, gradient @ axes  # along the principal directions
        sizes = np.sqrt(np.maximum(squares, _THINNEST**2))
        strain = (sizes - 1 / sizes) / 2
        parts: list[list[Any]] = [[], [], []]
        misfit, weights = [], []
        for side, other in ((0, 0), (1, 1), (0, 1)):
            change = stretch[:, None, :, side] * gradient[:, :, None, other]
            change = change + stretch[:, None, :, other] * gradient[:, :, None, side]  # of the squared stretch
            slope = (1 + 1 / (sizes[:, side] * sizes[:, other])) / (sizes[:, side] + sizes[:, other]) / 2
            for axis, rows in enumerate(_rows(corners, change * slope[:, None, None], self.count)):
                parts[axis].append(rows)
            misfit.append(-strain[:, side] if side == other else np.zeros(len(strain)))
            weights.append(twice / 2 * share * (1 if side == other else 2))
        return (
            [scipy.sparse.vstack(each, format="csr") for each in parts],
            np.concatenate(misfit),
            np.concatenate(weights),
        )


def _turned(before: Shape, points: _Floats) -> _Floats:
    """Return the points of a shape around its centre, turned to where the points are now."""
    centred = before.points - before.centre
    now = (points - Shape(points, before.faces).centre) * before.areas[:, None]
    left, _, right = np.linalg.svd(np.einsum("na,nb->ab", centred, now))
    left[:, 2] *= np.sign(np.linalg.det(left @ right))
    return np.asarray(centred @ left @ right)


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
