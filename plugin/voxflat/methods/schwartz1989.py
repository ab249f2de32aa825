"""The method "schwartz1989": exact distances, and Newton steps from random starts to the least of Sammon's stress."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from voxflat.arguments import checked_choice, is_whole
from voxflat.distances.sources import SAMPLINGS, SourceChoice, source_choice
from voxflat.errors import InputError
from voxflat.maps.flat_map import FlatMap
from voxflat.methods.common import map_over_triangles
from voxflat.methods.method import How, OverTriangles, checked_count
from voxflat.surfaces.cutting import Cutout

_SAME_STRESS = 1.01  # starts that end in the same map differ by a smaller factor,
_NO_STRESS = 1e-9  # or by less than this: distances are right to 0.003 %


@dataclass(frozen=True, kw_only=True)
class Schwartz1989(OverTriangles):
    """Flatten by the least stress of exact distances.

    Exact distances δ are kept within a neighbourhood of each vertex, and from some sources. From random places Newton
    steps lead to the least of Sammon's stress, (1/Σδ) Σ (d - δ)²/δ with d the distances in the map: each coordinate
    moves by 0.35 of its derivative over the magnitude of its second one, all at once. The least stress of several
    starts counts; ``metadata["starts"]`` has the stress of each.

    Parameters
    ----------
    sources : int or array_like of int
        How many points long distances are measured from beside the neighbourhoods; all, if there are fewer. Or which:
        voxel indices (m, 3), or vertex numbers (m,) (Wolfson, Schwartz 1989). With 0 most starts end in a fold.
    sampling : {"farthest", "curvature", "random"}
        How sources are chosen: evenly, each farthest from the others along the surface; up to four times as close where
        the surface bends; or at random.
    neighbourhood : int or "all", optional
        Distances from each point are kept to those that so many edges lead to, or to all. By default as far as a tenth
        of the points, which the paper found to be enough, and a hundred if there are so many.
    starts : int
        How many random starts, of which the map of least stress is kept. The paper has 3.

    References
    ----------
    E. L. Schwartz, A. Shaw, E. Wolfson: A Numerical Solution to the Generalized Mapmaker's Problem: Flattening
    Nonconvex Polyhedral Surfaces. IEEE Transactions on Pattern Analysis and Machine Intelligence 11 (9), 1005-1008,
    1989.

    Examples
    --------
    >>> import numpy as np
    >>> import voxflat
    >>> from voxflat.methods import Schwartz1989
    >>> depth = voxflat.range_image(np.zeros((9, 9)), 1.0)
    >>> flat_map = depth.flatten(Schwartz1989(starts=2))
    >>> len(flat_map.metadata["starts"])
    2
    """

    name: ClassVar[str] = "schwartz1989"
    summary: ClassVar[str] = "by exact distances from random starts"

    sources: int | ArrayLike = 50
    sampling: str = "farthest"
    neighbourhood: int | str | None = None
    starts: int = 3

    def __post_init__(self) -> None:
        """Check the options."""
        checked_choice(self.sampling, "sampling", SAMPLINGS)
        if self.neighbourhood is not None and self.neighbourhood != "all":
            checked_count(self.neighbourhood, "the neighbourhood", "a number of rings, 1 or more, or 'all'")
        checked_count(self.starts, "starts", "a number of random starts, 1 or more")

    def _map(self, cut: Cutout, how: How) -> FlatMap:
        """Flatten a disk of triangles."""
        part = cut.part
        if is_whole(self.sources) and self.sources == 0:
            if how.keep_rows:
                raise InputError("sources is 0, so there are no rows to keep; give sources, or leave out rows")
            choice = SourceChoice(part, 0, np.empty(0, dtype=np.uint32), self.sampling, how.seed, "given")
        else:
            choice = source_choice(part, self.sources, self.sampling, how.seed, fewest=3, at_most_all=True)
        rings: int | None = None  # all pairs
        if not isinstance(self.neighbourhood, str):
            rings = self.neighbourhood or part.core.schwartz1989_rings(how.progress)
        need = part.core.schwartz1989_memory_need(rings, choice.count, how.workers, how.progress)
        kept = "among all" if rings is None else f"within {rings} rings of each"
        remedy = "give a smaller neighbourhood or patch, or take the method 'voxflat'"
        need += how.rows_memory_need(choice.count, len(part))
        need = how.check_memory(need, f"distances {kept} of {len(part)} points are kept: {remedy}")
        chosen = choice.made(how.progress)
        result = part.core.schwartz1989(rings, chosen, self.starts, how.seed, how.keep_rows, how.threads, how.progress)
        if np.isnan(result["planarity"]):
            result["planarity"] = None  # there were no sources
        energies, converged = result["convergence"]
        told: dict[str, Any] = {
            "neighbourhood": rings or "all",
            "pairs": result["pairs"],
            "starts": result["stresses"],
            "descent": {"converged": converged, "energies": energies},
        }
        doubts, rows = _doubts(result["stresses"]), result["rows"]
        return map_over_triangles(self.name, cut, how, result, need, rows, told, doubts, sampling=choice.rule)


def _doubts(stresses: Sequence[float]) -> list[str]:
    """Return what the user should know of the stresses that random starts ended with."""
    least, *others = sorted(stresses)
    if not others or others[0] <= _SAME_STRESS * least + _NO_STRESS:
        return []
    return [
        f"the least stress of {len(stresses)} random starts, {least:.3g}, was reached by one of them only (then "
        f"{others[0]:.3g}): a better map may exist; give more starts, more sources or a larger neighbourhood"
    ]
