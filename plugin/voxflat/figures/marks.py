"""Compute the annotations of a map: anatomical directions, hemisphere, names of cuts, and length of the scale bar."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from voxflat.maps.flat_map import FlatMap
from voxflat.maps.summary import summary_of

_MIDDLE = 0.35  # share of the radius of a disk with the map's area
_TELLING = 0.3  # R² at or above which a direction counts as lying in the plane
_APART = np.cos(np.radians(30))
_SIDES = {"CortexLeft": "L", "CortexRight": "R", "left": "L", "right": "R"}


@dataclass(frozen=True)
class Direction:
    """An anatomical direction on the map."""

    letter: str  # R, A or S: right, anterior, superior; or x, y or z of a volume without anatomical directions
    u: float  # (u, v) is a unit vector
    v: float
    share: float  # R² of the linear fit: the share of the coordinate's variance that the plane explains


def directions(flat_map: FlatMap) -> list[Direction]:
    """Return the two directions of the space that are closest to the map plane at its middle, if there are any.

    Each coordinate of the points around the middle is fitted linearly in (u, v); the gradient is its direction.
    """
    if not flat_map.has_surface:
        return []
    is_unknown = flat_map.space.name == "unknown" and flat_map.origin.structure not in _SIDES
    if is_unknown and not flat_map.is_voxels:
        return []
    points = flat_map.space.to_scanner(flat_map.points)
    corners = flat_map.uv[flat_map.faces[~flat_map.torn]]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
    middle = (corners.mean(axis=1) * area[:, None]).sum(axis=0) / area.sum()
    apart = np.linalg.norm(flat_map.uv - middle, axis=1)
    near = apart <= max(_MIDDLE * np.sqrt(area.sum() / np.pi), float(np.sort(apart)[min(20, len(apart) - 1)]))
    design = np.column_stack([flat_map.uv[near] - middle, np.ones(near.sum())])
    candidates = []
    for letter, values in zip("xyz" if is_unknown else "RAS", points[near].T, strict=True):
        fit, *_ = np.linalg.lstsq(design, values, rcond=None)
        rest, spread = values - design @ fit, values - values.mean()
        share = 1 - float(rest @ rest) / max(float(spread @ spread), 1e-12)
        (u, v), length = fit[:2].tolist(), float(np.hypot(fit[0], fit[1]))
        if share >= _TELLING and length > 0:
            candidates.append(Direction(letter, u / length, v / length, share))
    candidates.sort(key=lambda direction: -direction.share)
    others = [
        direction
        for direction in candidates[1:]
        if abs(direction.u * candidates[0].u + direction.v * candidates[0].v) < _APART
    ]
    return candidates[:1] + others[:1]


def side(flat_map: FlatMap) -> str | None:
    """Return "L" or "R" if the file or the registered sphere of a map identifies its hemisphere, and None otherwise."""
    names = (flat_map.origin.structure, summary_of(flat_map).side)
    return next((_SIDES[name] for name in names if name in _SIDES), None)


def cut_names(flat_map: FlatMap) -> list[tuple[str, NDArray[np.float64]]]:
    """Return the names of cuts, and positions (k, 2) in mm between the sides of each cut, the best one first."""
    named = [cut for cut in flat_map.cuts if cut.name]
    rows: dict[object, list[int]] = {}
    used = np.unique(flat_map.faces) if named else np.empty(0, dtype=np.int64)
    for row, key in zip(used.tolist(), flat_map.ids[used].tolist(), strict=True):
        rows.setdefault(tuple(key) if isinstance(key, list) else key, []).append(row)
    names = []
    for cut in named:
        both_sides = [rows.get(tuple(key) if isinstance(key, list) else key, []) for key in cut.ids.tolist()]
        places = [flat_map.uv[points] for points in both_sides if points]
        if places:
            names.append((str(cut.name), _between(places)))
    return names


def _between(places: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return the midpoints between the sides of a cut; the first has a wider gap than two thirds of the cut."""
    gaps = np.array([np.ptp(points, axis=0).max() for points in places])
    best = np.argsort(-gaps, kind="stable")[len(gaps) // 3] if gaps.max() > 0 else len(gaps) // 2
    return np.array([points.mean(axis=0) for points in places])[np.argsort(np.abs(gaps - gaps[best]), kind="stable")]


def round_length(room: float) -> float:
    """Return the greatest length (1, 2 or 5 times a power of ten) that fits into the available room."""
    power = 10.0 ** np.floor(np.log10(room))
    return float(power * max(step for step in (1, 2, 5) if step * power <= room * (1 + 1e-9)))
