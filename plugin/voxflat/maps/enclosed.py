"""Vertices that are enclosed by lines on a surface, such as the borders of Connectome Workbench."""

import heapq
from collections.abc import Iterable, Sequence

import numpy as np
import scipy  # its modules are imported on first use
from numpy.typing import NDArray

from voxflat.errors import InputError
from voxflat.io.formats.border import Border, BorderLine
from voxflat.maps.lines import edges_of

_Ints = NDArray[np.int64]

_ON_EDGE = 1e-5  # weight below which a point does not lie inside the triangle
_OUTSIDE = -1  # the number of the place beyond the boundary


class Enclosing:
    """Find the vertices enclosed by borders on the triangles of a surface, or of a part of one.

    A line crosses edges between vertices. Two vertices are on the same side if a path between them crosses the line an
    even number of times. The inside is the side with fewer vertices of the whole mesh.
    """

    def __init__(self, faces: _Ints, points: NDArray[np.float64] | None, count: int) -> None:
        """Take triangles (F, 3) of mesh vertices, the positions of these if known, and the size of the mesh."""
        self._faces, self._count = faces, count
        self._edges, self._of_face, counts = edges_of(faces, count)
        if counts.max(initial=0) > 2:
            raise InputError("an edge of the surface has more than two triangles. Repair the surface")
        order = np.argsort(self._of_face.ravel(), kind="stable")
        ends = np.cumsum(counts)
        first, last = order[ends - counts] // 3, order[ends - 1] // 3
        self._beside = np.column_stack([first, np.where(counts == 2, last, _OUTSIDE)])  # the faces at each edge
        keys = (self._edges[:, 0] * count + self._edges[:, 1]).tolist()
        self._numbers = {key: number for number, key in enumerate(keys)}
        self._centres = None if points is None else points[faces].mean(axis=1)
        self._used = np.unique(faces)

    def inside(self, border: Border) -> NDArray[np.bool_]:
        """Return a mask of the mesh vertices inside all closed lines of a border; in a hole, they are outside."""
        is_odd = np.zeros(len(self._edges), dtype=bool)
        for line in border.lines:
            if line.is_closed:
                np.logical_xor.at(is_odd, self._crossed(line), True)
        side = self._sides(is_odd, border.name)
        here = np.bincount(side[self._used], minlength=2)
        at_boundary = np.unique(side[self._edges[self._beside[:, 1] == _OUTSIDE]])
        if len(at_boundary) == 1:
            here[at_boundary[0]] += self._count - len(self._used)
        is_inside = np.zeros(self._count, dtype=bool)
        is_inside[self._used] = side[self._used] == here.argmin()
        return is_inside

    def _sides(self, is_odd: NDArray[np.bool_], name: str) -> _Ints:
        """Return 0 or 1 for each vertex, such that exactly the odd edges join vertices of different sides."""
        links, crossing = self._edges[~is_odd], self._edges[is_odd]
        graph = scipy.sparse.coo_matrix((np.ones(len(links)), links.T), shape=(self._count, self._count))
        _, group = scipy.sparse.csgraph.connected_components(graph, directed=False)
        near: dict[int, set[int]] = {}
        for a, b in {tuple(pair) for pair in group[crossing].tolist()}:
            near.setdefault(a, set()).add(b)
            near.setdefault(b, set()).add(a)
        side = np.zeros(group.max(initial=0) + 1, dtype=np.int64)
        known: set[int] = set()
        for start in sorted(near):
            waiting = [] if start in known else [start]
            known.update(waiting)
            while waiting:
                one = waiting.pop()
                for other in near[one] - known:
                    side[other] = 1 - side[one]
                    known.add(other)
                    waiting.append(other)
        if any(side[a] == side[b] for a in near for b in near[a]):
            raise InputError(f"the border {name!r} does not divide the surface. Draw a closed border around a region")
        return np.asarray(side[group])

    def _crossed(self, line: BorderLine) -> list[int]:
        """Return the numbers of the edges that a closed line crosses, in its order."""
        places = [self._places(*point) for point in zip(line.vertices.tolist(), line.weights.tolist(), strict=True)]
        places = [one for n, one in enumerate(places) if n == 0 or one != places[n - 1]]
        crossed: list[int] = []
        legs: list[tuple[int, int]] = []
        for n, here in enumerate(places):
            there = places[(n + 1) % len(places)]
            common = sorted(here & there)
            if common:
                kept = legs[-1][1] if legs and legs[-1][1] in common else common[-1]
                legs.append((kept, kept))
            else:
                start, end, between = self._walk(here, there)
                crossed += between
                legs.append((start, end))
        for n, (start, _) in enumerate(legs):
            crossed += self._walk({legs[n - 1][1]}, {start}, places[n])[2]  # at the point between two legs
        return crossed

    def _places(self, corners: Sequence[int], weights: Sequence[float]) -> frozenset[int]:
        """Return the faces that contain a point, and `_OUTSIDE` where it lies on the boundary or beyond it."""
        on = [corner for corner, weight in zip(corners, weights, strict=True) if weight > _ON_EDGE]
        if len(on) == 1:
            fan = np.flatnonzero((self._faces == on[0]).any(axis=1))
            ends = {face for edge in self._of_face[fan].ravel().tolist() for face in self._beside[edge].tolist()}
            outside = {_OUTSIDE} & ends if len(fan) else {_OUTSIDE}
            return frozenset(fan.tolist()) | outside
        number = self._numbers.get(min(on[:2]) * self._count + max(on[:2]))
        faces = set() if number is None else set(self._beside[number].tolist())
        if len(on) == 3:
            faces = {face for face in faces if face >= 0 and set(self._faces[face].tolist()) == set(on)}
        return frozenset(faces or {_OUTSIDE})

    def _step(self, place: int, other: int) -> float:
        """Return the length of a step to a neighbouring place; all steps are equal where no positions are known."""
        if other == _OUTSIDE:
            return 0.0
        return 1.0 if self._centres is None else float(np.linalg.norm(self._centres[other] - self._centres[place]))

    def _walk(
        self, starts: Iterable[int], ends: Iterable[int], within: frozenset[int] | None = None
    ) -> tuple[int, int, list[int]]:
        """Return the first and last place of the shortest way between places, and the edges that it crosses."""
        goals, begin = set(ends), set(starts)
        if begin & goals:
            place = min(begin & goals)
            return place, place, []
        if _OUTSIDE in begin and len(begin) == 1:  # from the surface to its boundary
            end, start, crossed = self._walk(goals, begin, within)
            return start, end, crossed[::-1]
        waiting = [(0.0, place, place) for place in sorted(begin - {_OUTSIDE})]
        came: dict[int, tuple[int, int]] = {}
        reached = {place: (0.0, place) for _, place, _ in waiting}
        heapq.heapify(waiting)
        while waiting:
            length, place, start = heapq.heappop(waiting)
            if place in goals:
                crossed, at = [], place
                while at in came:
                    at, edge = came[at]
                    crossed.append(edge)
                return start, place, crossed[::-1]
            if place == _OUTSIDE or length > reached[place][0]:
                continue
            for edge in self._of_face[place].tolist():
                a, b = self._beside[edge].tolist()
                other = b if a == place else a
                if within is not None and other not in within:
                    continue
                step = self._step(place, other)
                if length + step < reached.get(other, (np.inf, 0))[0]:
                    reached[other] = (length + step, start)
                    came[other] = (place, edge)
                    heapq.heappush(waiting, (length + step, other, start))
        return self._walk(begin, goals) if within is not None else (min(begin), min(goals), [])
