"""Start from a known flat map: the part that it covers, its cuts, and the positions of its vertices."""

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import Progress
from voxflat.errors import InputError
from voxflat.maps.map_cuts import at_corners, covered, seams
from voxflat.maps.matching import Matched
from voxflat.surfaces.cutting import CutManifold, cut_out_as, opened_to_disk
from voxflat.surfaces.manifold import Manifold


def cut_as(whole: Manifold, start: Matched, threads: int | None, progress: Progress | None) -> CutManifold[Manifold]:
    """Cut out the part that a map covers, along the map's own cuts."""
    part = covered(whole, start, "start")
    cut = cut_out_as(whole, part, seams(part, start), "start")
    return opened_to_disk(cut, False, threads, progress)


def places_of(cut: CutManifold[Manifold], start: Matched) -> NDArray[np.float64]:
    """Return the start's position for every vertex; both sides of a cut that the start lacks share a position."""
    vertices = cut.surface.vertices
    corners, is_there = at_corners(vertices, cut.faces, start)
    if not is_there.all():
        lacking = vertices[cut.faces[np.flatnonzero(~is_there)[0]]].tolist()
        raise InputError(
            f"start does not contain {int((~is_there).sum())} of the {len(is_there)} triangles to be flattened "
            f"(for example, the triangle of vertices {lacking}). Pass a map that covers all of them, or omit start"
        )
    places = np.full((len(vertices), 2), np.nan)
    places[cut.faces] = corners
    torn = np.argwhere((places[cut.faces] != corners).any(axis=2))
    if len(torn):
        vertex = int(vertices[cut.faces[tuple(torn[0])]])
        raise InputError(
            f"start is cut at vertex {vertex}, but the surface is not. Also pass the cuts of the start, or omit cuts, "
            "sphere, relax and adapt"
        )
    return places
