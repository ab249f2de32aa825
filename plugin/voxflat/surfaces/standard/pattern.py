"""Load the template's folds on a grid over the unit sphere in fsaverage space (``docs/templates/pattern.py``)."""

from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from voxflat.unique_rows import distinct

SIDES = ("left", "right")

DEPTH_UNIT, PLACE_UNIT, WEIGHT_UNIT = 1 / 32, 1 / 100, 1 / 255  # of the file's integers: SDs, `_core`'s length, 1

SUBDIVISIONS = 5


class Pattern(NamedTuple):
    """The values that a registration compares at N places on the sphere, for `_core.Surface.register`."""

    depths: NDArray[np.float64]
    places: NDArray[np.float64]
    weights: NDArray[np.float64]


@cache
def icosphere(subdivisions: int = SUBDIVISIONS) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the points and triangles of a subdivided icosahedron on the unit sphere, counterclockwise from outside."""
    golden = (1 + 5**0.5) / 2
    cycle = [np.roll([0.0, a, b * golden], k) for k in range(3) for a in (-1, 1) for b in (-1, 1)]
    points = np.array(cycle) / np.hypot(1, golden)
    near = points @ points.T > 0.4  # neighbours have 1 / √5
    corners = [
        (i, j, k)
        for i in range(12)
        for j in range(12)
        for k in range(12)
        if i < min(j, k) and near[i, j] and near[j, k] and near[k, i] and np.linalg.det(points[[i, j, k]]) > 0
    ]
    faces = np.array(corners, dtype=np.int64)
    for _ in range(subdivisions):
        edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        unique = distinct(edges)
        a, b, c = faces.T
        ab, bc, ca = len(points) + unique.which.reshape(3, -1)
        middle = points[unique.rows].sum(axis=1)
        points = np.concatenate([points, middle / np.linalg.norm(middle, axis=1, keepdims=True)])
        faces = np.concatenate([np.stack(abc, axis=1) for abc in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))])
    return points, faces


@cache
def pattern(side: str) -> Pattern:
    """Return the template's pattern of a hemisphere, at the points of `icosphere`."""
    with files(__package__).joinpath("pattern.npz").open("rb") as file, np.load(file) as saved:
        stored: dict[str, NDArray[Any]] = {name: saved[f"{side}_{name}"] for name in Pattern._fields}
    return Pattern(
        np.ascontiguousarray(stored["depths"] * DEPTH_UNIT),
        np.ascontiguousarray(np.cumsum(stored["places"], axis=0, dtype=np.int16) * PLACE_UNIT),
        stored["weights"] * WEIGHT_UNIT,
    )
