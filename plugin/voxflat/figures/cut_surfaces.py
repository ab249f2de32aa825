"""Draw a surface that was cut open, with its cuts, from both sides."""

from typing import Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from voxflat.maps.lines import edges_of
from voxflat.surfaces.manifold import Manifold

_CUT = "#d62728"
_SHADES = (0.35, 0.9)  # grey levels of points that face sideways and of points that face the viewer
_VIEW = 3.2  # length of the longer side of a view, inches


def cut_surface_views(surface: Manifold) -> Figure:
    """Draw the points of a surface from both ends of its shortest axis, with the visible part of its boundary."""
    points, faces = surface.points, surface.faces
    axis = int(np.argmin(np.ptp(points, axis=0)))
    across, up = (other for other in range(3) if other != axis)
    width, height = np.ptp(points[:, [across, up]], axis=0)
    scale = _VIEW / max(width, height)
    figure = Figure(figsize=(2 * scale * width + 0.3, scale * height + 0.3), dpi=110, layout="constrained")
    a, b, c = points[faces].transpose(1, 0, 2)
    normals = np.zeros(points.shape)
    np.add.at(normals, faces, np.cross(b - a, c - a)[:, None])
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
    sides, _, counts = edges_of(faces, len(points))
    edges = sides[counts == 1]  # the boundary
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
