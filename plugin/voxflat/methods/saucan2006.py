"""The method "saucan2006": a map that is glued of certified patches (Appleboim, Saucan, Zeevi 2006)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from voxflat.arguments import is_number, shown
from voxflat.atlases.glued import Seams, measured
from voxflat.errors import InputError
from voxflat.maps.flat_map import FlatMap
from voxflat.methods.common import How, map_over_triangles
from voxflat.surfaces.region import Cutout

__all__ = ["checked", "flatten"]


def checked(bound: float) -> dict[str, float]:
    """Return the bound on C, if it can be used."""
    if not (is_number(bound) and 1 < bound <= 10):
        raise InputError(
            f"bound is {shown(bound)}; give a number above 1, up to 10: how much lengths may change at most"
        )
    return {"bound": float(bound)}


def flatten(cut: Cutout, how: How, *, bound: float) -> FlatMap:
    """Flatten a disk in patches that are glued to one piece, and cut it open where seams remain."""
    need = how.check_memory(cut.part.core.saucan2006_memory_need(how.workers), "take a smaller patch")
    result = cut.part.core.saucan2006(bound, how.seed, how.threads, how.progress)
    part, seams = cut.part.with_core(result["surface"]), Seams(**result["seams"])
    faces = part.faces[: len(cut.faces)]  # holes that were closed come last
    cut = replace(cut, part=part, faces=faces, metadata={**cut.metadata, "points": len(np.unique(part.vertices))})
    told = {
        "bound": bound,
        "patches": result["patches"],
        "seams": seams.figures(),
        "before": {"certified_c": result["certified"], "c": result["before"]},
        "measured": measured(result["stretch"], part.points[part.faces]),
    }
    doubts = [f"{seams.cuts:.0f} mm of seams between patches stay cut"] if seams.cuts > 0 else []
    return map_over_triangles("saucan2006", cut, how, result, need, None, told, doubts)
