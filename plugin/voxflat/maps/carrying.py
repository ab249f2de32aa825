"""Carry a flat map over the sphere to a surface with another mesh of the same brain."""

from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from voxflat.arguments import Progress
from voxflat.errors import Cancelled
from voxflat.maps.flat_map import FlatMap
from voxflat.surfaces.cutting import CutManifold
from voxflat.surfaces.standard.sphere import Sphere, in_triangles

_AT_ONCE = 20_000  # vertices that are located between two reports of progress
_INSIDE = 1e-9  # tolerance of barycentric weights
_ROUNDS = 40  # in which vertices are moved
_INWARDS = 0.3  # share of the way to its neighbours by which a vertex of a crossing edge moves


def carried(
    flat: FlatMap, sphere: Sphere, onto: CutManifold[Any], onto_sphere: Sphere, progress: Progress | None
) -> NDArray[np.float64]:
    """Return the positions of a surface's vertices on the map of a surface with another mesh, by their spheres.

    Both surfaces have almost the same cuts. Away from the cuts, a vertex has the position of its place in the map's
    triangles. The other vertices continue the map from the nearest of these, so that they stay on their side of a cut.
    """
    places, faces = sphere.places[flat.ids], flat.faces.astype(np.int64)
    part = onto.surface
    wanted, finer = onto_sphere.places[part.vertices], part.faces.astype(np.int64)
    located = []
    for start in range(0, len(wanted), _AT_ONCE):
        if progress is not None and progress("resampling the map", start, len(wanted)) is False:
            raise Cancelled("resampling the map was cancelled")
        located.append(in_triangles(places, faces, wanted[start : start + _AT_ONCE]))
    corners, weights, is_inside = map(np.concatenate, zip(*located, strict=True))
    triangle = np.empty(len(wanted), dtype=np.int64)
    triangle[is_inside] = _numbers(faces, corners[is_inside])
    is_known = is_inside & ~np.isin(corners, _border(faces)).any(axis=1)
    is_known[_border(finer)] = False
    ends = np.unique(np.sort(finer[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    lengths = np.linalg.norm(wanted[ends[:, 0]] - wanted[ends[:, 1]], axis=1)
    graph = scipy.sparse.csr_matrix((lengths, ends.T), shape=(len(part), len(part)))
    known = np.flatnonzero(is_known)
    apart, before, _ = scipy.sparse.csgraph.dijkstra(
        graph, directed=False, indices=known, min_only=True, return_predecessors=True
    )
    others = np.flatnonzero(~is_known)
    beside = _neighbours(faces)
    for row in others[np.argsort(apart[others], kind="stable")]:
        triangle[row], weights[row] = _walked(triangle[before[row]], wanted[row], places, faces, beside)
    return _repaired(np.einsum("ij,ijk->ik", weights, flat.uv[faces[triangle]]), finer)


def _repaired(uv: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    """Move vertices until no triangle is flipped and the border does not cross itself, if this takes few rounds.

    The vertices of flipped triangles move, one after the other, to where the least of their triangles is largest, and
    those of crossing edges towards their neighbours.
    """
    border = _border(faces)
    is_border = np.zeros(len(uv), dtype=np.bool_)
    is_border[border] = True
    for _ in range(_ROUNDS):
        flipped, crossing = np.unique(faces[_double_areas(uv, faces) <= 0]), _crossing(uv, border)
        for vertex in crossing:
            around = np.unique(faces[(faces == vertex).any(axis=1)])
            inner = around[~is_border[around]]
            uv[vertex] += _INWARDS * (uv[inner if len(inner) else around].mean(axis=0) - uv[vertex])
        for vertex in flipped:
            ring = faces[(faces == vertex).any(axis=1)]
            turn = (ring == vertex).argmax(axis=1)
            a, b = (uv[np.take_along_axis(ring, ((turn + k) % 3)[:, None], axis=1)[:, 0]] for k in (1, 2))
            # twice the area of a triangle is linear in its corner, and the last unknown is at most each of them
            rows = np.column_stack([b[:, 1] - a[:, 1], a[:, 0] - b[:, 0], np.ones(len(a))])
            limits = np.stack([np.minimum(a, b).min(axis=0), np.maximum(a, b).max(axis=0)], axis=1)
            areas = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
            uv[vertex] = scipy.optimize.linprog([0, 0, -1], rows, areas, bounds=[*limits, (None, None)]).x[:2]
        if not len(flipped) and not len(crossing):
            break
    return uv


def _border(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the edges at the border, shape (B, 2)."""
    opposite = _neighbours(faces) < 0
    return np.column_stack([faces[:, [1, 2, 0]][opposite], faces[:, [2, 0, 1]][opposite]])


def _crossing(uv: NDArray[np.float64], edges: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the vertices of edges that cross another one."""
    middles, reach = uv[edges].mean(axis=1), np.linalg.norm(uv[edges[:, 0]] - uv[edges[:, 1]], axis=1).max()
    pairs = edges[scipy.spatial.KDTree(middles).query_pairs(reach, output_type="ndarray")]
    pairs = pairs[(pairs[:, 0, :, None] != pairs[:, 1, None, :]).all(axis=(1, 2))]
    (a, b), (c, d) = np.moveaxis(uv[pairs], (1, 2), (0, 1))

    def side(p: NDArray[np.float64], q: NDArray[np.float64], r: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.linalg.det(np.stack([q - p, r - p], axis=1)))

    is_across = (side(a, b, c) * side(a, b, d) <= 0) & (side(c, d, a) * side(c, d, b) <= 0)
    return np.unique(pairs[is_across])


def _double_areas(uv: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    a, b, c = np.moveaxis(uv[faces], 1, 0)
    return np.asarray(np.linalg.det(np.stack([b - a, c - a], axis=1)))


def _numbers(faces: NDArray[np.int64], corners: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the number of each triangle by its corners, which no other triangle has in this order."""
    numbers = {tuple(of): number for number, of in enumerate(faces.tolist())}
    return np.array([numbers[tuple(of)] for of in corners.tolist()], dtype=np.int64)


def _neighbours(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the triangle beyond the edge opposite each corner, shape (F, 3), or -1 at the border."""
    edges = np.sort(faces[:, [1, 2, 2, 0, 0, 1]].reshape(-1, 2), axis=1)
    order = np.lexsort(edges.T)
    is_shared = (edges[order][1:] == edges[order][:-1]).all(axis=1)
    a, b = order[:-1][is_shared], order[1:][is_shared]
    beside = np.full(len(edges), -1)
    beside[a], beside[b] = b // 3, a // 3
    return beside.reshape(-1, 3)


def _walked(
    triangle: int,
    place: NDArray[np.float64],
    places: NDArray[np.float64],
    faces: NDArray[np.int64],
    beside: NDArray[np.int64],
) -> tuple[int, NDArray[np.float64]]:
    """Walk from a triangle towards a place until a triangle contains it, or the border is in the way."""
    for _ in range(len(faces)):
        weights = np.linalg.solve(places[faces[triangle]].T, place)
        weights /= weights.sum()
        least = int(weights.argmin())
        if weights[least] >= -_INSIDE or beside[triangle, least] < 0:
            break
        triangle = int(beside[triangle, least])
    return triangle, weights
