"""The method "zigelman2002": fast marching, classical scaling, re-insertion (Zigelman, Kimmel, Kiryati 2002)."""

from __future__ import annotations

from voxflat.arguments import checked_choice
from voxflat.distances.sources import source_choice
from voxflat.errors import InputError
from voxflat.maps.flat_map import FlatMap
from voxflat.methods.common import How, map_over_triangles
from voxflat.methods.options import default
from voxflat.surfaces.range_image import pixels_of
from voxflat.surfaces.region import Cutout

__all__ = ["SAMPLINGS", "checked", "flatten"]

SAMPLINGS = ("decimation", "farthest", "curvature", "random", "grid")


def checked() -> dict[str, object]:
    """Return the options that this method alone knows: there are none."""
    return {}


def flatten(cut: Cutout, how: How) -> FlatMap:
    """Flatten a disk of triangles, or a range image."""
    part, usual = cut.part, default("sources", "zigelman2002")
    checked_choice(how.sampling, "sampling", SAMPLINGS)
    choice = source_choice(part, how.sources, how.sampling, how.seed, fewest=3, usual=usual)
    grid = vertices = None
    if how.sampling == "grid":
        if choice.given is not None:
            raise InputError("sampling is 'grid', which chooses the sources itself; give their number, or leave it out")
        grid = pixels_of(part)
    need = part.core.zigelman2002_memory_need(choice.count, how.workers)
    need = how.check_memory(need + how.rows_memory_need(choice.count, len(part)))
    if grid is None and (choice.given is not None or how.sampling != "decimation"):
        vertices = choice.made(how.progress)
    chosen = (choice.count, how.seed, vertices, grid, "circle")
    result = part.core.zigelman2002(*chosen, how.keep_rows, how.threads, how.progress)
    placed_by = "re-insertion" if grid is None else "bilinear functions between a grid's pixels"
    return map_over_triangles("zigelman2002", cut, how, result, need, result["rows"], {"placed_by": placed_by})
