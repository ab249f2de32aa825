"""The method "schwartz1989": exact distances, and from random starts Newton steps to the least of Sammon's stress.

Schwartz, Shaw, Wolfson (1989): distances within a neighbourhood of each point are kept, and those from some sources.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from voxflat.arguments import is_whole, shown
from voxflat.distances.sources import SourceChoice, source_choice
from voxflat.errors import InputError
from voxflat.maps.flat_map import FlatMap
from voxflat.methods.common import How, map_over_triangles
from voxflat.methods.options import default
from voxflat.surfaces.region import Cutout

__all__ = ["checked", "flatten"]

_SAME_STRESS = 1.01  # starts that end in the same map differ by a smaller factor,
_NO_STRESS = 1e-9  # or by less than this: distances are right to 0.003 %
_MOST = 2**31  # more than any surface has


def checked(neighbourhood: object, starts: object) -> dict[str, Any]:
    """Return the neighbourhood (rings, "all", or None) and the number of random starts, if they can be used."""
    if neighbourhood is not None and neighbourhood != "all":
        neighbourhood = _whole(neighbourhood, "the neighbourhood", "a number of rings, 1 or more, or 'all'")
    return {"neighbourhood": neighbourhood, "starts": _whole(starts, "starts", "a number of random starts, 1 or more")}


def _whole(value: object, name: str, wanted: str) -> int:
    if not is_whole(value) or not 1 <= value < _MOST:
        raise InputError(f"{name} is {shown(value)}; give {wanted}")
    return int(value)


def _doubts(stresses: Sequence[float]) -> list[str]:
    """Return what the user should know of the stresses that random starts ended with."""
    least, *others = sorted(stresses)
    if not others or others[0] <= _SAME_STRESS * least + _NO_STRESS:
        return []
    return [
        f"the least stress of {len(stresses)} random starts, {least:.3g}, was reached by one of them only (then "
        f"{others[0]:.3g}): a better map may exist; give more starts, more sources or a larger neighbourhood"
    ]


def flatten(cut: Cutout, how: How, *, neighbourhood: int | str | None, starts: int) -> FlatMap:
    """Flatten a disk of triangles."""
    part = cut.part
    if is_whole(how.sources) and how.sources == 0:
        if how.keep_rows:
            raise InputError("sources is 0, so there are no rows to keep; give sources, or leave out keep_rows")
        choice = SourceChoice(part, 0, np.empty(0, dtype=np.uint32), how.sampling, how.seed)
    else:
        usual = default("sources", "schwartz1989")
        choice = source_choice(part, how.sources, how.sampling, how.seed, fewest=3, usual=usual)
    rings: int | None = None  # all pairs
    if not isinstance(neighbourhood, str):
        rings = neighbourhood or part.core.schwartz1989_rings(how.progress)
    need = part.core.schwartz1989_memory_need(rings, choice.count, how.workers, how.progress)
    kept = "among all" if rings is None else f"within {rings} rings of each"
    remedy = "give a smaller neighbourhood or patch, or take the method 'voxflat'"
    need += how.rows_memory_need(choice.count, len(part))
    need = how.check_memory(need, f"distances {kept} of {len(part)} points are kept: {remedy}")
    chosen = choice.made(how.progress)
    result = part.core.schwartz1989(rings, chosen, starts, how.seed, how.keep_rows, how.threads, how.progress)
    if np.isnan(result["planarity"]):
        result["planarity"] = None  # there were no sources
    energies, converged = result["convergence"]
    told: dict[str, Any] = {
        "neighbourhood": rings or "all",
        "pairs": result["pairs"],
        "starts": result["stresses"],
        "descent": {"converged": converged, "energies": energies},
    }
    return map_over_triangles("schwartz1989", cut, how, result, need, result["rows"], told, _doubts(result["stresses"]))
