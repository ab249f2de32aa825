"""Choose one side of each cut for files that store one position per vertex.

A cut doubles the vertices along it. GIFTI surfaces and FreeSurfer's patches use the vertex numbers of the mesh and
store one position for each, so triangles on one side of a cut are lost. A patch does not store triangles, either:
programs read the triangles of the mesh whose corners are all listed (`in_patch`), and some of these would bridge the
cut. Therefore, vertices at the sides of cuts are excluded until no triangle bridges a cut.
"""

import heapq
from collections import defaultdict
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from voxflat.unique_rows import distinct


def triangles_of(points: NDArray[np.int64], faces: NDArray[Any]) -> NDArray[np.bool_]:
    """Find the triangles whose three corners are all among the given points."""
    is_there = np.zeros(max(faces.max(initial=0), points.max(initial=0)) + 1, dtype=np.bool_)
    is_there[points] = True
    return np.asarray(is_there[faces].all(axis=1))


def one_point_a_vertex(ids: NDArray[np.int64], faces: NDArray[Any]) -> NDArray[np.int64]:
    """Choose one of the points that share a vertex, in ascending order of vertices, so that few triangles are lost.

    `ids` are the vertices of the points. The search starts with the points on one side of the cut and exchanges points
    one by one as long as this keeps more triangles.
    """
    vertices, first, counts = np.unique(ids, return_index=True, return_counts=True)
    if counts.max(initial=1) == 1:
        return first
    is_doubled = np.isin(ids, vertices[counts > 1])
    around: defaultdict[int, list[list[int]]] = defaultdict(list)
    for triangle in faces[is_doubled[faces].any(axis=1)].tolist():
        for point in triangle:
            around[point].append(triangle)
    vertex_of = ids.tolist()
    chosen = dict(zip(vertices.tolist(), first.tolist(), strict=True))
    points_of: defaultdict[int, list[int]] = defaultdict(list)
    for point in np.flatnonzero(is_doubled).tolist():
        points_of[vertex_of[point]].append(point)

    def kept(point: int) -> int:
        others = ([q for q in triangle if q != point] for triangle in around[point])
        return sum(all(chosen[vertex_of[q]] == q for q in pair) for pair in others)

    is_settled = False
    while not is_settled:
        is_settled = True
        for vertex, points in sorted(points_of.items()):
            best = max(points, key=kept)
            if kept(best) > kept(chosen[vertex]):
                chosen[vertex] = best
                is_settled = False
    return np.array([chosen[vertex] for vertex in vertices.tolist()], dtype=np.int64)


def listed_points(ids: NDArray[np.int64], faces: NDArray[Any], bridges: NDArray[np.int64]) -> NDArray[np.int64]:
    """Choose the points that a patch may list: all triangles of the mesh among them belong to these points.

    `bridges` are other triangles of the mesh, given by vertices, whose corners are all vertices of these points. The
    result has at most one point per vertex, is connected, and contains each point in a triangle with others.
    """
    points = one_point_a_vertex(ids, faces)
    is_wrong = ~triangles_of(points, faces)
    suspects = np.union1d(ids[faces[is_wrong]], bridges)
    inner, others = faces, bridges
    while len(suspects):
        points = _one_piece(_Corners(ids, inner, others, suspects).without_bridges(points), ids, inner)
        is_apart = triangles_of(points, inner)
        is_apart[is_apart] = ~_of_largest_piece(inner[is_apart])
        if not is_apart.any():
            return _Corners(ids, faces, bridges, np.setdiff1d(ids, ids[points])).with_restored(points)
        # programs would read triangles whose corners are in the piece, but not its edges: exclude them like bridges
        others, suspects = np.concatenate([others, ids[inner[is_apart]]]), np.union1d(suspects, ids[inner[is_apart]])
        inner = inner[~is_apart]
    return _one_piece(points, ids, faces)


class _Corners:
    """The triangles at vertices that may be excluded, and the sets of points with which each one is correct.

    A bridge is not correct with any points. A triangle is correct with several sets of points if a slit between its
    corners was closed.
    """

    def __init__(
        self, ids: NDArray[np.int64], faces: NDArray[Any], bridges: NDArray[np.int64], suspects: NDArray[np.int64]
    ) -> None:
        self.ids, self.faces, self.suspects = ids, faces, suspects
        near = faces[np.isin(ids[faces], suspects).any(axis=1)]
        self.vertices = np.unique(ids[near])
        self.points: dict[frozenset[int], list[dict[int, int]]] = {frozenset(row): [] for row in bridges.tolist()}
        for vertices, points in zip(ids[near].tolist(), near.tolist(), strict=True):
            self.points.setdefault(frozenset(vertices), []).append(dict(zip(vertices, points, strict=True)))
        self.around: defaultdict[int, list[frozenset[int]]] = defaultdict(list)
        for triangle in self.points:
            for vertex in triangle:
                self.around[vertex].append(triangle)

    def read(self, vertex: int, listed: dict[int, int]) -> list[tuple[frozenset[int], bool]]:
        """Return the triangles at a vertex that a program would read, and whether each one is correct."""
        triangles = [triangle for triangle in self.around[vertex] if triangle <= listed.keys()]
        return [(face, any(points.items() <= listed.items() for points in self.points[face])) for face in triangles]

    def without_bridges(self, points: NDArray[np.int64]) -> NDArray[np.int64]:
        """Exclude vertices one by one: those with the most wrong triangles first, then those with the fewest others."""
        listed = self._by_vertex(points)

        def rank(vertex: int) -> tuple[int, int, int]:
            is_right = [right for _, right in self.read(vertex, listed)]
            return -is_right.count(False), is_right.count(True), vertex

        heap = [rank(vertex) for vertex in self.suspects.tolist()]
        heapq.heapify(heap)
        while heap:
            wrong, right, vertex = rank(heap[0][-1])
            if wrong == 0 or (wrong, right, vertex) == heap[0]:
                heapq.heappop(heap)
                if wrong:
                    del listed[vertex]
            else:  # other vertices were excluded in the meantime
                heapq.heapreplace(heap, (wrong, right, vertex))
        return self._points(listed)

    def with_restored(self, points: NDArray[np.int64]) -> NDArray[np.int64]:
        """Restore vertices, on either side of a cut, that add only correct triangles that share edges with others."""
        listed = self._by_vertex(points)
        listed_faces = self.faces[triangles_of(points, self.faces)]
        corners = self.ids[listed_faces[np.isin(self.ids[listed_faces], self.vertices).any(axis=1)]].tolist()
        edges = {edge for triangle in corners for edge in _edges(triangle)}
        places: defaultdict[int, list[int]] = defaultdict(list)
        for point in np.flatnonzero(np.isin(self.ids, self.suspects)).tolist():
            places[int(self.ids[point])].append(point)
        is_settled = False
        while not is_settled:
            is_settled = True
            for vertex in (vertex for vertex in sorted(places) if vertex not in listed):
                for point in places[vertex]:
                    listed[vertex] = point
                    triangles = self.read(vertex, listed)
                    if (
                        triangles
                        and all(right for _, right in triangles)
                        and _are_connected([list(triangle) for triangle, _ in triangles], edges)
                    ):
                        edges.update(edge for triangle, _ in triangles for edge in _edges(list(triangle)))
                        is_settled = False
                        break
                    del listed[vertex]
        return self._points(listed)

    def _by_vertex(self, points: NDArray[np.int64]) -> dict[int, int]:
        return dict(zip(self.ids[points].tolist(), points.tolist(), strict=True))

    @staticmethod
    def _points(listed: dict[int, int]) -> NDArray[np.int64]:
        return np.array([point for _, point in sorted(listed.items())], dtype=np.int64)


def _edges(triangle: list[int]) -> list[frozenset[int]]:
    a, b, c = triangle
    return [frozenset((a, b)), frozenset((b, c)), frozenset((c, a))]


def _are_connected(triangles: list[list[int]], edges: set[frozenset[int]]) -> bool:
    """Return whether triangles are connected to edges, directly or through each other."""
    rest, reached = triangles, set[frozenset[int]]()
    while rest:
        is_far = [edges.isdisjoint(_edges(triangle)) and reached.isdisjoint(_edges(triangle)) for triangle in rest]
        if all(is_far):
            return False
        reached.update(edge for triangle, far in zip(rest, is_far, strict=True) if not far for edge in _edges(triangle))
        rest = [triangle for triangle, far in zip(rest, is_far, strict=True) if far]
    return True


def _one_piece(points: NDArray[np.int64], ids: NDArray[np.int64], faces: NDArray[Any]) -> NDArray[np.int64]:
    """Return the points of the edge-connected piece with the most triangles."""
    listed = faces[triangles_of(points, faces)]
    largest = np.unique(listed[_of_largest_piece(listed)]).astype(np.int64)
    return largest[np.argsort(ids[largest], kind="stable")]


def _of_largest_piece(faces: NDArray[Any]) -> NDArray[np.bool_]:
    """Find the triangles of the edge-connected piece with the most triangles, shape (F,)."""
    if len(faces) == 0:
        return np.zeros(0, dtype=np.bool_)
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64), axis=1)
    face_ids = np.tile(np.arange(len(faces)), 3)
    of_edges = scipy.sparse.coo_matrix((np.ones(len(face_ids)), (face_ids, distinct(edges).which))).tocsr()
    _, pieces = scipy.sparse.csgraph.connected_components(of_edges @ of_edges.T, directed=False)
    return np.asarray(pieces == np.bincount(pieces).argmax())
