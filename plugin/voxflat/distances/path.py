"""Shortest paths over a surface, for display, measurement and cutting."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import checked_choice, voxel_indices
from voxflat.errors import InputError
from voxflat.io.provenance import Record, Recorded
from voxflat.io.spaces import Space
from voxflat.read_only import ReadOnly
from voxflat.surfaces.manifold import Manifold
from voxflat.surfaces.voxel_graph import voxel_graph


@dataclass(frozen=True, eq=False)
class Path(ReadOnly, Recorded):
    """A shortest path along a surface.

    `Surface.path` returns it.

    Parameters
    ----------
    ids : ndarray of int64, shape (k, 3) or (k,)
        Voxels or vertices on the path, including both ends; −1 where the path crosses an edge.
    points : ndarray of float64, shape (k, 3)
        Positions along the path, in RAS+ mm (see `space`). The path is straight between these points, except that a
        path of links follows the triangles.
    length : float
        Length of the path along the surface, in mm.
    space : Space
        The coordinate space of the surface.
    provenance : dict
        Record of how the path was computed.

    See Also
    --------
    Surface.path : Find the shortest path through points.

    Examples
    --------
    >>> path = voxflat.samples.hill().path(0, 440)
    >>> round(path.length, 1)
    60.4
    """

    ids: NDArray[np.int64]
    points: NDArray[np.float64]
    length: float
    space: Space
    provenance: Record = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<Path over {len(self.ids)} points, length {self.length:.1f}>"


def path(surface: Manifold, stops: Sequence[Sequence[int] | int], geodesic: str, link_lengths: str | None) -> Path:
    """Find a shortest path; see `voxflat.Surface.path`."""
    checked_choice(geodesic, "geodesic", ("graph", "marching", "exact", "edges", "chain"))
    if geodesic == "chain":
        graph = voxel_graph(surface, link_lengths)
        core: Any = graph.whole
        vertices = core.find(voxel_indices(stops, "the stops"))
        ids, find, space = core.voxels, core.path, graph.origin.space
    else:
        if link_lengths is not None:
            raise InputError(f"link_lengths does not apply to geodesic={geodesic!r}. Omit it")
        core = surface.core
        vertices = surface.find(stops, "the stops")
        ids, find, space = surface.ids, core.path if geodesic == "graph" else core.edge_path, surface.space
    points, passed, length = [core.points[vertices[:1]]], [vertices[:1].astype(np.int64)], 0.0
    for (start, end), leg in zip(pairwise(vertices.tolist()), pairwise(stops), strict=True):
        try:
            if geodesic in ("marching", "exact"):
                trace = core.exact_path if geodesic == "exact" else core.marching_path
                places, steps, leg_length = trace(start, end)
            else:
                steps, leg_length = find(start, end)
                places = core.points[steps]
        except InputError:
            raise InputError(
                f"no path connects {np.asarray(leg[0]).tolist()} and {np.asarray(leg[1]).tolist()}: they lie in "
                "different components of the surface. Choose all stops in one component"
            ) from None
        points.append(places[1:])
        passed.append(steps[1:].astype(np.int64))
        length += float(leg_length)
    along = np.concatenate(passed)
    at_vertex = (along >= 0).reshape(-1, *[1] * (ids.ndim - 1))
    return Path(np.where(at_vertex, ids[along].astype(np.int64), -1), np.concatenate(points), length, space)
