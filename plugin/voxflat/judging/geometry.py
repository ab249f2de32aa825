"""On which geometry maps are judged: where they say on which they were made, on that."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import log
from voxflat.errors import InputError
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.matching import Matched, vertices_of
from voxflat.surfaces.manifold import Manifold

_SAME = 1e-3  # lengths of edges that agree so far, with their usual length: files hold float32


@dataclass(frozen=True, eq=False)
class Geometry:
    """A surface where maps say that it lies."""

    surface: Manifold  # the given one, its vertices moved to where the maps have them
    known: NDArray[np.bool_] | None = None  # vertices of the whole that the maps have; None: of the given geometry
    said_by: str = ""  # the name of the map that says so

    def check(self, name: str, matched: Matched) -> None:
        """Refuse a map with vertices of which it is not known where they lie."""
        if self.known is None:
            return
        unknown = matched.vertices[~self.known[matched.vertices]]
        if len(unknown):
            raise InputError(
                f"{_called(self.said_by)} was made on another geometry than the given surface's, and {_called(name)} "
                f"has {len(np.unique(unknown))} vertices more, whose places there are not known: give the surface that "
                "it was made on (with its pial surface), or judge all on the given one (on_surface)"
            )


def geometry_of(whole: Manifold, maps: Mapping[str, object]) -> Geometry:
    """Return the surface on which maps are judged: the given one, unless ours were made on another geometry."""
    ours = {name: flat for name, flat in maps.items() if isinstance(flat, FlatMap) and not flat.is_voxels}
    places = {name: vertices_of(whole, flat) for name, flat in ours.items()}
    moved = [name for name, flat in ours.items() if not _agree(flat, flat.points, whole.points[places[name]])]
    if not moved or whole.is_voxels:
        return Geometry(whole)
    first = moved[0]
    points, known = whole.points.copy(), np.zeros(whole.count, dtype=np.bool_)
    for name in [first, *(name for name in ours if name != first)]:
        flat, at = ours[name], places[name]
        if name != first:
            both = known[whole.vertices[at]]
            expected = np.where(both[:, None], points[at], flat.points)
            if name not in moved or not _agree(flat, flat.points, expected):
                raise InputError(
                    f"{_called(first)} was made on {_made_on(ours[first])}, {_called(name)} on {_made_on(flat)}, which "
                    "is another geometry: measure them one by one, or judge both on the given surface (on_surface)"
                )
        points[at] = flat.points
        known[whole.vertices[at]] = True
    log.warning(
        "%s was made on another geometry than the given surface's (%s): all figures are of that one; on_surface judges "
        "on the given one",
        _called(first),
        _made_on(ours[first]),
    )
    return Geometry(whole._with_core(whole.core.moved(points)), known, first)


def _agree(flat: FlatMap, one: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    """Tell whether a map's triangles have the same edges in both places, wherever these lie."""
    lengths = [
        np.linalg.norm(points[flat.faces] - points[np.roll(flat.faces, 1, axis=1)], axis=2) for points in (one, other)
    ]
    return bool(np.abs(lengths[0] - lengths[1]).max() <= _SAME * np.median(lengths[0]))


def _made_on(flat: FlatMap) -> str:
    of = flat.metadata.get("input")
    return f"{flat.metadata.get('measured_on', 'another surface')}" + (f", {of}" if of else "")


def _called(name: str) -> str:
    return name or "the map"
