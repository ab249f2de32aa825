"""Draw a surface that was cut open, with its cuts, from both sides."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

if TYPE_CHECKING:
    from voxflat.surfaces.manifold import Manifold

_CUT = "#d62728"
_SHADES = (0.35, 0.9)  # grey levels of points that face sideways and of points that face the viewer
_VIEW = 3.2  # length of the longer side of a view, inches


def cut_surface_views(surface: Manifold) -> Figure:
    """Draw the points of a surface along its shortest axis from both sides, with the visible part of its boundary."""
    points, faces = surface.points, surface.faces
    axis = int(np.argmin(np.ptp(points, axis=0)))
    across, up = (other for other in range(3) if other != axis)
    width, height = np.ptp(points[:, [across, up]], axis=0)
    scale = _VIEW / max(width, height)
    figure = Figure(figsize=(2 * scale * width + 0.3, scale * height + 0.3), dpi=110, layout="constrained")
    normals, edges = _normals(points, faces), _boundary(faces)
    spacing = np.sqrt(width * height / max(len(points) / 4, 1)) * scale * 72  # points
    for side, axes in zip((-1, 1), figure.subplots(1, 2), strict=True):
        seen = np.flatnonzero(side * normals[:, axis] > 0)
        seen = seen[np.argsort(side * points[seen, axis], kind="stable")]  # nearer points are drawn last
        shades = np.interp(side * normals[seen, axis], (0, 1), _SHADES)
        flip = side if across == 0 else -side  # keeps the view right-handed
        look: dict[str, Any] = {"cmap": "gray", "vmin": 0, "vmax": 1, "linewidths": 0, "rasterized": True}
        axes.scatter(flip * points[seen, across], points[seen, up], c=shades, s=(1.6 * spacing) ** 2, **look)
        facing = edges[(side * normals[edges, axis] > 0).all(axis=1)]
        lines = points[facing][:, :, [across, up]] * (flip, 1)
        axes.add_collection(LineCollection(list(lines), colors=_CUT, linewidths=1.2))
        axes.set_aspect("equal")
        axes.set_axis_off()
    return figure


def _normals(points: NDArray[np.float64], faces: NDArray[np.integer]) -> NDArray[np.float64]:
    a, b, c = points[faces].transpose(1, 0, 2)
    normals = np.zeros(points.shape)
    np.add.at(normals, faces, np.cross(b - a, c - a)[:, None])
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None])


def _boundary(faces: NDArray[np.integer]) -> NDArray[np.int64]:
    """Return the edges that belong to only one triangle, shape (E, 2)."""
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64), axis=1)
    found, counts = np.unique(edges, axis=0, return_counts=True)
    return np.asarray(found[counts == 1])
