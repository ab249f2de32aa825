"""Closed outlines around labelled points of a map, from which the same points are found again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.maps.lines import borders, edges_of

_WIDTH = 0.02  # of the band around a map, as a share of the median edge

_Floats = NDArray[np.float64]
_Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Collar:
    """The triangles of a map, and a narrow band of triangles around it that belongs to no region."""

    uv: _Floats
    faces: _Ints
    count: int  # points of the map, which come first

    @classmethod
    def around(cls, uv: _Floats, faces: NDArray[Any], *, width: float | None = None) -> Collar:
        """Surround a map by a band of a width, so that outlines of regions at its edge are closed around their points.

        By default, the width is a share of the median edge at the boundary.
        """
        faces = faces.astype(np.int64)
        edges, following = directed_boundary(faces, len(uv))
        along = uv[edges[:, 1]] - uv[edges[:, 0]]
        lengths = np.linalg.norm(along, axis=1, keepdims=True)
        along = along / np.maximum(lengths, 1e-12)
        outwards = np.column_stack([along[:, 1], -along[:, 0]])
        before = np.empty_like(following)
        before[following] = np.arange(len(following))
        normals = outwards + outwards[before]
        sums = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = np.where(sums > 1e-6, normals / np.maximum(sums, 1e-6), outwards)
        if width is None:
            width = _WIDTH * float(np.median(lengths)) if len(lengths) else 0.0
        ghosts = len(uv) + np.arange(len(edges))
        a, b, here, there = edges[:, 0], edges[:, 1], ghosts, ghosts[following]
        band = np.concatenate([np.column_stack([a, here, b]), np.column_stack([b, here, there])])
        return cls(np.concatenate([uv, uv[a] + width * normals]), np.concatenate([faces, band]), len(uv))

    def outlines(self, mask: NDArray[np.bool_]) -> tuple[_Floats, ...]:
        """Return closed polygons (k, 2) around the points of a region, and around its holes."""
        labels = np.zeros(len(self.uv), dtype=np.int64)
        labels[: self.count] = mask
        inside = labels[self.faces].sum(axis=1)
        near = self.faces[(inside > 0) & (inside < 3)]
        lines = borders(self.uv, near, labels) if len(near) else []
        return tuple(line[:-1] for line in lines if len(line) > 3)


def directed_boundary(faces: _Ints, count: int) -> tuple[_Ints, _Ints]:
    """Return the directed boundary edges (B, 2), and the number of the edge that follows each around the same corner.

    Where a vertex lies on the boundary several times, the corners are those of the map, not of its surroundings.
    """
    _, of_face, counts = edges_of(faces, count)
    is_edge = counts[of_face] == 1  # (F, 3), of the edge from corner k to k + 1
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2)[is_edge]
    at_boundary = np.zeros(count, dtype=np.bool_)
    at_boundary[edges] = True
    third = {}
    for triangle in faces[at_boundary[faces].any(axis=1)].tolist():
        for a, b, c in zip(triangle, triangle[1:] + triangle[:1], triangle[2:] + triangle[:2], strict=True):
            third[a, b] = c
    numbers = {tuple(edge): number for number, edge in enumerate(edges.tolist())}
    following = []
    for a, b in edges.tolist():
        c = third[a, b]
        while (c, b) in third:  # turn around b to the other end of its corner
            c = third[c, b]
        following.append(numbers[b, c])
    return edges, np.array(following, dtype=np.int64)


def around_pixels(mask: NDArray[np.bool_]) -> list[_Floats]:
    """Return closed polygons (k, 2) of rows and columns around the pixels (H, W) of a region."""
    padded = np.pad(mask, 1)
    links = []
    for axis in (0, 1):
        rows, columns = np.nonzero(np.diff(padded.astype(np.int8), axis=axis))
        starts = np.column_stack([rows + (axis == 0), columns + (axis == 1)])
        links.append(np.stack([starts, starts + ([0, 1] if axis == 0 else [1, 0])], axis=1))
    ends = np.concatenate(links)  # (K, 2, 2), corners of pixels
    width = padded.shape[1] + 1
    loops = _closed(ends[..., 0] * width + ends[..., 1])
    return [np.column_stack([loop // width, loop % width]) - 1.5 for loop in loops]


def _closed(links: _Ints) -> list[_Ints]:
    """Join links, of which an even number meets at each end, into closed lines without their straight corners."""
    near: dict[int, list[int]] = {}
    for number, (a, b) in enumerate(links.tolist()):
        near.setdefault(a, []).append(number)
        near.setdefault(b, []).append(number)
    ends, is_used, loops = links.tolist(), np.zeros(len(links), dtype=bool), []
    for first in range(len(links)):
        if is_used[first]:
            continue
        line, number, at = [], first, ends[first][0]
        while not is_used[number]:
            is_used[number] = True
            line.append(at)
            at = ends[number][1] if ends[number][0] == at else ends[number][0]
            number = next((one for one in near[at] if not is_used[one]), number)
        loop = np.array(line)
        is_corner = np.roll(loop, -1) - loop != loop - np.roll(loop, 1)
        loops.append(loop[is_corner])
    return loops
