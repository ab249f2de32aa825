"""Lines on a map: its outline, and smooth borders between labelled regions."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

_Floats = NDArray[np.float64]
_Ints = NDArray[np.int64]

_STEPS = 60  # smoothing steps
_NEAREST = 0.1  # smallest distance to a vertex, as a share of the edge
_AROUND = 256  # corners of the polygon that approximates an ellipse


def outline(uv: _Floats, faces: NDArray[Any]) -> list[_Floats]:
    """Return the outline of a map as lines from `rim`, in mm."""
    return [uv[line] for line in rim(faces, len(uv))]


def rim(faces: NDArray[Any], count: int) -> list[_Ints]:
    """Return the boundary edges as lines of points; a closed line ends at its first point."""
    sides, _, counts = edges_of(faces, count)
    return chains(sides[counts == 1])


def ellipse(corners: _Floats) -> _Floats:
    """Return the ellipse inscribed in a parallelogram (4, D), as a polygon."""
    a, b, middle = (corners[1] - corners[0]) / 2, (corners[3] - corners[0]) / 2, corners.mean(axis=0)
    turn = np.linspace(0, 2 * np.pi, _AROUND, endpoint=False)[:, None]
    return np.asarray(middle + np.cos(turn) * a + np.sin(turn) * b)


def borders(uv: _Floats, faces: NDArray[Any], labels: _Ints) -> list[_Floats]:
    """Return smooth borders between labelled points as lines, in mm, using marching triangles.

    Crossings start at the midpoints of edges and move along them, but never reach an end, so that each vertex stays on
    its side. Where three labels meet, borders lead from the midpoints of the edges to the centre of the triangle.
    """
    edges, share, links, centres = _crossings(uv, faces, labels)
    crossings = uv[edges[:, 0]] + share[:, None] * (uv[edges[:, 1]] - uv[edges[:, 0]])
    places = np.concatenate([crossings, centres])
    return [places[line] for line in chains(links)]


def region_corners(
    uv: _Floats, faces: NDArray[Any], labels: _Ints, corners: NDArray[Any], weights: NDArray[np.floating[Any]]
) -> _Ints:
    """Return, for each place given by corners (M, 3) and weights, the corner on the same side of the `borders`."""
    corners = corners.astype(np.int64)
    at_corner = labels[corners]
    best = np.take_along_axis(corners, weights.argmax(axis=1)[:, None], axis=1)[:, 0]
    same = at_corner == np.roll(at_corner, -1, axis=1)  # corner k and k + 1
    two = same.sum(axis=1) == 1
    if not two.any():
        return best
    edges, share, _, _ = _crossings(uv, faces, labels)
    keys = edges[:, 0] * len(uv) + edges[:, 1]
    order = np.argsort(keys)
    lone = (same[two].argmax(axis=1) + 2) % 3  # the corner whose label differs from the other two
    rows = np.arange(len(lone))
    inside = corners[two]
    away = np.zeros(len(lone))
    for step in (1, 2):
        other = (lone + step) % 3
        a, b = inside[rows, lone], inside[rows, other]
        nearest = order[np.searchsorted(keys[order], np.minimum(a, b) * len(uv) + np.maximum(a, b))]
        from_lone = np.where(edges[nearest, 0] == a, share[nearest], 1 - share[nearest])
        away += weights[two][rows, other] / from_lone
    pair = (lone + 1) % 3
    best[two] = np.where(away < 1, inside[rows, lone], inside[rows, pair])
    return best


def chains(links: NDArray[Any]) -> list[_Ints]:
    """Join links (pairs of numbers) into lines that end at junctions; a closed line ends at its first point."""
    points, first, ends = np.unique(links, return_index=True, return_inverse=True)
    order = np.argsort(ends, axis=None, kind="stable")
    begin = np.searchsorted(ends.ravel()[order], np.arange(len(points) + 1)).tolist()  # each point's start in `ways`
    ways = (order // 2).tolist()  # one flat list: a list per point is slow in garbage collection
    sides = [side.tolist() for side in ends.reshape(-1, 2).T]
    is_used = [False] * len(links)

    def follow(start: int, number: int) -> _Ints:
        line, vertex = [start], start
        while True:
            is_used[number] = True
            vertex = sides[1][number] if vertex == sides[0][number] else sides[0][number]
            line.append(vertex)
            low = begin[vertex]
            if begin[vertex + 1] - low != 2 or vertex == start:
                break
            number = ways[low] if ways[low + 1] == number else ways[low + 1]
            if is_used[number]:
                break
        return points[line].astype(np.int64)

    lines = []
    for at in np.argsort(first).tolist():  # start at ends and junctions, then follow closed lines
        around = ways[begin[at] : begin[at + 1]]
        if len(around) != 2:
            lines += [follow(at, number) for number in around if not is_used[number]]
    return lines + [follow(start, number) for number, start in enumerate(sides[0]) if not is_used[number]]


def edges_of(faces: NDArray[Any], count: int) -> tuple[_Ints, _Ints, _Ints]:
    """Return edges (E, 2), smaller number first; the edges of each face (F, 3); and the face count at each edge."""
    faces = faces.astype(np.int64)
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2)
    keys = ends.min(axis=2) * count + ends.max(axis=2)
    unique, which, counts = np.unique(keys, return_inverse=True, return_counts=True)
    return np.column_stack([unique // count, unique % count]), which.reshape(faces.shape), counts


def _crossings(uv: _Floats, faces: NDArray[Any], labels: _Ints) -> tuple[_Ints, _Floats, _Ints, _Floats]:
    """Return crossed edges, positions along them, links, and centres of triangles with three labels (numbered last)."""
    edges, of_face, _ = edges_of(faces, len(uv))
    differs = labels[edges[:, 0]] != labels[edges[:, 1]]
    number = np.full(len(edges), -1)
    number[differs] = np.arange(differs.sum())
    edges = edges[differs]
    crossed = number[of_face]
    many = (crossed >= 0).sum(axis=1)
    two, three = crossed[many == 2], crossed[many == 3]
    pairs = two[two >= 0].reshape(-1, 2)
    middles = len(edges) + np.arange(len(three))
    links = np.concatenate([pairs, np.column_stack([three.ravel(), np.repeat(middles, 3)])])
    share = np.full(len(edges), 0.5)
    sums, count = np.zeros((len(edges), 2)), np.bincount(pairs.ravel(), minlength=len(edges))
    is_free = (count == 2) & ~np.isin(np.arange(len(edges)), three)
    start, along = uv[edges[:, 0]], uv[edges[:, 1]] - uv[edges[:, 0]]
    length = np.maximum((along**2).sum(axis=1), 1e-300)
    for _ in range(_STEPS):
        places = start + share[:, None] * along
        sums[:] = 0
        np.add.at(sums, pairs[:, 0], places[pairs[:, 1]])
        np.add.at(sums, pairs[:, 1], places[pairs[:, 0]])
        ideal = ((sums / 2 - start) * along).sum(axis=1) / length
        share = np.where(is_free, np.clip(ideal, _NEAREST, 1 - _NEAREST), share)
    return edges, share, links, uv[faces[many == 3].astype(np.int64)].mean(axis=1)
