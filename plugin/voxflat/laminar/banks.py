"""Keep columns within their bank, and place a border where the banks of a sulcus touch without one."""

import numpy as np
import scipy
from numpy.typing import NDArray

from voxflat import _core
from voxflat.laminar.labels import Layered

_THICK = 1.5  # thickness, relative to the usual one, from which two banks may touch
_BANK = (0.5, 1.5)  # thickness of each of these banks, relative to the usual one
_SHARE = 0.2  # of a part of the surface, at least, that lies at such places
_SAMPLE = 20_000  # voxels from which the usual thickness is estimated

_STEPS = np.eye(3, dtype=np.int64)
_BESIDE = np.concatenate([_STEPS, -_STEPS])
_AROUND = [np.array([0 * a, a, a + b, b]) for a, b in (_STEPS[[1, 2]], _STEPS[[0, 2]], _STEPS[[0, 1]])]


def crosses(
    rim: Layered,
    label: int,
    places: NDArray[np.float64],
    ends: NDArray[np.float64],
    nearest: NDArray[np.float64],
    threads: int | None = None,
) -> NDArray[np.int64]:
    """Return the places whose straight way to `ends` passes a label, which is at least at the distance `nearest`."""
    half = 0.5 * float(rim.volume.spacing.min())
    to_voxels = np.linalg.inv(rim.affine).tolist()
    return np.flatnonzero(
        _core.ways_pass(rim.extended == label, to_voxels, places, ends, nearest - 2 * half, half, threads)
    )


def neighbours_of(
    rim: Layered, voxels: NDArray[np.int64], ends: NDArray[np.float64], lost: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return for each of the grey `voxels` its own number or, if it is lost, that of a voxel whose end it takes.

    It is the nearest end of its neighbours, from voxel to voxel through grey matter; -1 where this reaches none.
    """
    places = rim.places(voxels)
    number = np.full(rim.labels.shape, -1, dtype=np.int32)
    number[tuple(voxels.T)] = np.arange(len(voxels))
    taken = np.arange(len(voxels) + 1)
    taken[lost] = taken[-1] = -1  # the last one is for -1
    last = np.array(rim.labels.shape) - 1
    while len(lost):
        near = taken[number[tuple(np.moveaxis((voxels[lost][:, None] + _BESIDE).clip(0, last), -1, 0))]]
        distances = np.linalg.norm(ends[near] - places[lost][:, None], axis=2)
        distances[near < 0] = np.inf
        best = distances.argmin(axis=1)
        is_reached = np.isfinite(distances.min(axis=1))
        if not is_reached.any():
            break
        taken[lost[is_reached]] = near[is_reached, best[is_reached]]
        lost = lost[~is_reached]
    return taken[:-1]


def keep_to_bank(
    rim: Layered,
    label: int,
    voxels: NDArray[np.int64],
    feet: NDArray[np.float64],
    nearest: NDArray[np.float64],
    threads: int | None = None,
) -> NDArray[np.float64]:
    """Return the nearest points on a border that grey `voxels` reach without passing a label.

    The nearest point of a border can belong to the other bank of a sulcus. Such voxels take the point of a neighbour.
    `nearest` are distances to the label.
    """
    taken = neighbours_of(rim, voxels, feet, crosses(rim, label, rim.places(voxels), feet, nearest, threads))
    return np.where((taken >= 0)[:, None], feet[taken], feet)


def between_banks(
    voxels: NDArray[np.int64],
    shape: tuple[int, ...],
    places: NDArray[np.float64],
    feet: NDArray[np.float64],
    outwards: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.uint32]]:
    """Return the points and triangles of the surface halfway between banks that touch.

    Neighbouring voxels lie on opposite sides if the directions to their nearest points on the inner border (`feet`) are
    opposed. The surface crosses the line between their centres (`places`) where both points are equally distant.
    `outwards` are the distances from the outer border in mm.

    Opposite sides also meet below the bottom of a narrow sulcus. Therefore, a part of the surface counts only if the
    grey matter around it is often too thick for one bank, and each half of it has the thickness of a bank.
    """
    number = np.full(shape, -1, dtype=np.int32)
    number[tuple(voxels.T)] = np.arange(len(voxels))
    last = np.array(shape) - 1
    columns = places - feet
    inwards = np.linalg.norm(columns, axis=1)
    pairs, crossings, cells = [], [], []
    for step, around in zip(_STEPS, _AROUND, strict=True):
        second = number[tuple(np.minimum(voxels + step, last).T)]  # itself at the end of the box
        first = np.flatnonzero(second >= 0)
        second = second[first]
        way, apart = places[second] - places[first], feet[second] - feet[first]
        ahead = ((feet[first] + feet[second]) / 2 - places[first]) * apart
        whole = (way * apart).sum(axis=1)
        is_opposed = ((columns[first] * columns[second]).sum(axis=1) < 0) & (whole > 0)
        first, second, way = first[is_opposed], second[is_opposed], way[is_opposed]
        part = ahead.sum(axis=1)[is_opposed] / whole[is_opposed]
        pairs.append(np.stack([first, second]))
        crossings.append(places[first] + part.clip(0, 1)[:, None] * way)
        cells.append(np.ravel_multi_index(tuple(np.moveaxis(voxels[first][:, None] - around, -1, 0)), shape))
    pair, crossing, corners = np.concatenate(pairs, axis=1), np.concatenate(crossings), np.concatenate(cells)
    if not len(crossing):
        return crossing, np.zeros((0, 3), dtype=np.uint32)
    used, corners = np.unique(corners, return_inverse=True)
    corners = corners.reshape(-1, 4)  # a quadrilateral for each pair of voxels, with a point in each cell of 8 voxels
    points = np.zeros((len(used), 3))
    np.add.at(points, corners, crossing[:, None])
    points /= np.bincount(corners.ravel(), minlength=len(used))[:, None]

    sample = slice(None, None, len(voxels) // _SAMPLE + 1)
    nearest = scipy.spatial.cKDTree(crossing).query(places[sample])[0]
    usual = np.median(inwards[sample] + np.minimum(outwards[sample], nearest))
    bank, both = inwards[pair] / usual, (inwards + outwards)[pair] / usual
    is_thick = ((both > _THICK) & (bank > _BANK[0]) & (bank < _BANK[1])).all(axis=0)
    links = scipy.sparse.coo_matrix(
        (np.ones(corners.size), (corners.ravel(), np.roll(corners, 1, axis=1).ravel())), shape=(len(used), len(used))
    )
    part_of = scipy.sparse.csgraph.connected_components(links, directed=False)[1][corners[:, 0]]
    share = np.bincount(part_of, is_thick) / np.maximum(np.bincount(part_of), 1)
    corners = corners[share[part_of] > _SHARE]
    rows, corners = np.unique(corners, return_inverse=True)
    points, corners = points[rows], corners.reshape(-1, 4)
    return points, np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]]).astype(np.uint32)
