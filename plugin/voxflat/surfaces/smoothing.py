"""Smooth a surface: remove short waves from its shape, and report how far the surface moved."""

from dataclasses import replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from voxflat.arguments import Progress, checked_number
from voxflat.errors import Cancelled, InputError
from voxflat.io.grid import in_unit
from voxflat.surfaces.manifold import SurfaceT

MOVED = "smoothing moved the surface"  # start of a warning that is always made

_CLOSE = 1e-3  # relative residual at which the iteration stops
_MOST_STEPS = 5000
_STEEPEST = 1e-6  # least sine of an angle of a triangle that counts: smaller ones have cotangents beyond 1e6


def smoothed(surface: SurfaceT, length: float, progress: Progress | None) -> SurfaceT:
    """Return a surface without waves that are shorter than a length."""
    length = checked_number(length, "length")
    if not (np.isfinite(length) and length > 0):
        raise InputError(f"length is {length:g}. Pass the length of the shortest waves to keep, such as 10.0")
    if surface.whole is not None:
        raise InputError("this surface is a part of another one. Smooth the whole surface, then select the part")
    if surface.white_points is not None or surface.pial_points is not None:
        raise InputError("this surface lies between a white and a pial surface. Smooth these before you pass them")
    points, faces = surface.points, surface.faces.astype(np.int64)
    extent = float(np.linalg.norm(np.ptp(points, axis=0)))
    if length > extent:
        wrong = in_unit(
            f"length is {length:g} mm, but the surface is only {extent:.3g} mm long", surface.origin.named_unit
        )
        raise InputError(f"{wrong}. Pass a smaller length")
    moves = _moves(points, faces, length, progress)
    core = surface.core.moved(points + moves)
    along = np.abs((moves * _normals(points, faces)[1]).sum(axis=1))
    before, after = _folded(points, faces), _folded(points + moves, faces)
    figures: dict[str, Any] = {"length": length, "mean": float(along.mean()), "p95": float(np.percentile(along, 95))}
    text = f"{MOVED} by {figures['mean']:.3g} mm on average (95 %: {figures['p95']:.3g} mm)"
    if len(surface.core.topology()["loops"]) == 0:
        figures["volume_change"] = _volume(points + moves, faces) / _volume(points, faces) - 1
        text += f" and changed its volume by {100 * figures['volume_change']:.2g} %"
    warnings = [in_unit(text, surface.origin.named_unit)]
    if after > before:
        warnings.append(f"smoothing folded {after - before} of {len(faces)} triangles. Use a smaller length")
    details = {**surface.details, "smoothed": figures}
    return replace(surface, core=core, details=details, warnings=(*surface.warnings, *warnings))


def _moves(
    points: NDArray[np.float64], faces: NDArray[np.int64], length: float, progress: Progress | None
) -> NDArray[np.float64]:
    """Return the displacements (N, 3) that halve waves of the given length, remove shorter ones and keep longer ones.

    They minimise the squared displacement plus the squared mean curvature vector, each integrated over the surface.
    """
    bend, area = _laplacian(points, faces)
    spread = scipy.sparse.diags_array((length / (2 * np.pi)) ** 4 / area)
    stiff = (bend.T @ (spread @ bend)).tocsr()
    system = (stiff + scipy.sparse.diags_array(area)).tocsr()
    scale = 1 / system.diagonal()[:, None]
    moves = np.zeros_like(points)
    rest = -(stiff @ points)
    first = np.sqrt((rest * scale * rest).sum(axis=0))
    solved = scale * rest
    size = (rest * solved).sum(axis=0)
    for step in range(_MOST_STEPS):
        if (np.sqrt(size) <= _CLOSE * first).all():
            break
        if progress is not None and progress("smoothing", step, _MOST_STEPS) is False:
            raise Cancelled("smoothing was cancelled")
        pushed = system @ solved
        rate = _ratio(size, (solved * pushed).sum(axis=0))
        moves += rate * solved
        rest -= rate * pushed
        better = scale * rest
        size, last = (rest * better).sum(axis=0), size
        solved = better + _ratio(size, last) * solved
    return moves


def _ratio(dividend: NDArray[np.float64], divisor: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a quotient, which is 0 for the columns that are already solved."""
    return np.divide(dividend, divisor, out=np.zeros_like(dividend), where=divisor > 0)


def cotangents(points: NDArray[np.float64], faces: NDArray[np.int64]) -> tuple[Any, NDArray[np.float64]]:
    """Return the cotangent matrix, and the area around each vertex."""
    count = len(points)
    rows, columns, values = [], [], []
    area = np.zeros(count)
    for corner in range(3):
        apex, left, right = faces[:, corner], faces[:, (corner + 1) % 3], faces[:, (corner + 2) % 3]
        a, b = points[left] - points[apex], points[right] - points[apex]
        cross = np.linalg.norm(np.cross(a, b), axis=1)
        least = _STEEPEST * np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
        cotangent = 0.5 * (a * b).sum(axis=1) / np.maximum(cross, least)
        area += np.bincount(apex, cross / 6, count)
        rows += [left, right]
        columns += [right, left]
        values += [cotangent, cotangent]
    index = np.concatenate(rows), np.concatenate(columns)
    off = scipy.sparse.coo_array((np.concatenate(values), index), shape=(count, count)).tocsr()
    return (scipy.sparse.diags_array(off.sum(axis=1)) - off).tocsr(), np.maximum(area, 1e-12 * area.mean())


def _laplacian(points: NDArray[np.float64], faces: NDArray[np.int64]) -> tuple[Any, NDArray[np.float64]]:
    """Return the cotangent matrix, with empty rows for the boundary, and the area around each vertex."""
    matrix, area = cotangents(points, faces)
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    once, times = np.unique(edges, axis=0, return_counts=True)
    inside = np.ones(len(points))
    inside[once[times == 1]] = 0
    return (scipy.sparse.diags_array(inside) @ matrix).tocsr(), area


def _normals(points: NDArray[np.float64], faces: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the normals of triangles, twice as long as their area, and the unit normals of vertices."""
    a, b, c = (points[faces[:, corner]] for corner in range(3))
    of_faces = np.cross(b - a, c - a)
    sums = np.zeros_like(points)
    for corner in range(3):
        for axis in range(3):
            sums[:, axis] += np.bincount(faces[:, corner], of_faces[:, axis], len(points))
    return of_faces, sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), np.finfo(float).tiny)


def _folded(points: NDArray[np.float64], faces: NDArray[np.int64]) -> int:
    """Return the number of triangles that face against the mean normal of their corners."""
    of_faces, of_vertices = _normals(points, faces)
    return int(((of_vertices[faces].sum(axis=1) * of_faces).sum(axis=1) < 0).sum())


def _volume(points: NDArray[np.float64], faces: NDArray[np.int64]) -> float:
    """Return the enclosed volume."""
    a, b, c = (points[faces[:, corner]] - points.mean(axis=0) for corner in range(3))
    return float((a * np.cross(b, c)).sum() / 6)
