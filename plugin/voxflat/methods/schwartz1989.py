"""The method "schwartz1989": minimise Sammon's stress of exact distances from random starts."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from voxflat.arguments import checked_choice, is_whole
from voxflat.distances.sources import SAMPLINGS, SourceChoice, source_choice
from voxflat.errors import InputError
from voxflat.maps.flat_map import FlatMap
from voxflat.methods.common import bands_of, map_over_triangles
from voxflat.methods.method import FlattenSettings, OverTriangles, checked_count
from voxflat.surfaces.cutting import CutManifold
from voxflat.surfaces.manifold import Manifold

_SAME_STRESS = 1.01  # starts that end in the same map differ by less than this factor
_NO_STRESS = 1e-9  # or by less than this value: distances have an error of 0.003 %


@dataclass(frozen=True, kw_only=True)
class Schwartz1989(OverTriangles):
    r"""Flatten by minimising Sammon's stress of exact distances, from random starts.

    As in [1]_, exact geodesic distances :math:`\delta_{ij}` are stored for each vertex and its neighbourhood, and, as
    in [2]_, from some `sources` to all vertices. The vertices start at random positions and move to reduce Sammon's
    stress

    .. math:: E = \frac{1}{\sum_{i<j} \delta_{ij}} \sum_{i<j} \frac{(d_{ij} - \delta_{ij})^2}{\delta_{ij}},

    where :math:`d_{ij}` are distances in the map. In each step, all coordinates :math:`x` are updated at once, as in
    Newton's method with a diagonal Hessian:

    .. math:: x \leftarrow x - 0.35\, \frac{\partial E / \partial x}{|\partial^2 E / \partial x^2|} .

    The result is the map with the least stress among all starts. ``metadata["starts"]`` lists the stress of each start.

    Parameters
    ----------
    sources : int or array_like of int
        Number of points from which long distances are measured, in addition to the neighbourhoods (all points, if there
        are fewer), or the points themselves: voxel indices (m, 3) or vertex numbers (m,). The default is 50. With 0,
        most starts end in a folded map.
    sampling : {"farthest", "curvature", "random"}
        How sources are chosen: "farthest" spreads them evenly along the surface; "curvature" places them up to four
        times as densely where the surface bends; "random" draws them at random.
    neighbourhood : int or "all", optional
        Size of the neighbourhood of each vertex in which distances are stored, as a number of edges, or "all" for all
        pairs. By default the neighbourhood covers a tenth of the vertices, which the paper found to be sufficient, and
        at least 100 vertices.
    starts : int
        Number of random starts; by default 3, as in [1]_.

    See Also
    --------
    Voxflat : The default method, which also scales to large surfaces.
    Surface.flatten : Flatten a surface with a method.

    References
    ----------
    .. [1] E. L. Schwartz, A. Shaw, E. Wolfson: A Numerical Solution to the Generalized Mapmaker's Problem: Flattening
       Nonconvex Polyhedral Surfaces. IEEE Transactions on Pattern Analysis and Machine Intelligence 11 (9), 1005-1008,
       1989.
    .. [2] E. Wolfson, E. L. Schwartz: Computing Minimal Distances on Polyhedral Surfaces. IEEE Transactions on Pattern
       Analysis and Machine Intelligence 11 (9), 1001-1005, 1989.

    Examples
    --------
    >>> from voxflat.methods import Schwartz1989
    >>> depth = voxflat.range_image(np.zeros((9, 9)), 1.0)
    >>> flat_map = depth.flatten(Schwartz1989(starts=2))
    >>> len(flat_map.metadata["starts"])
    2
    """

    name: ClassVar[str] = "schwartz1989"
    summary: ClassVar[str] = "uses exact distances and random starts"

    sources: int | ArrayLike = 50
    sampling: str = "farthest"
    neighbourhood: int | str | None = None
    starts: int = 3

    def __post_init__(self) -> None:
        """Check the options."""
        checked_choice(self.sampling, "sampling", SAMPLINGS)
        if self.neighbourhood is not None and self.neighbourhood != "all":
            checked_count(self.neighbourhood, "neighbourhood", "a number of rings, at least 1, or 'all'")
        checked_count(self.starts, "starts", "a number of random starts, at least 1")

    def _map(self, cut: CutManifold[Manifold], settings: FlattenSettings) -> FlatMap:
        """Flatten a disk of triangles."""
        part = cut.surface
        if is_whole(self.sources) and self.sources == 0:
            if settings.keep_rows:
                raise InputError("sources is 0, so there are no rows to keep. Use more sources, or omit rows")
            choice = SourceChoice(part, 0, np.empty(0, dtype=np.uint32), self.sampling, settings.seed, "given")
        else:
            choice = source_choice(part, self.sources, self.sampling, settings.seed, fewest=3, at_most_all=True)
        rings: int | None = None  # all pairs
        if not isinstance(self.neighbourhood, str):
            rings = self.neighbourhood or part.core.schwartz1989_rings(settings.progress)
        need = part.core.schwartz1989_memory_need(rings, choice.count, settings.workers, settings.progress)
        extent = "between all pairs" if rings is None else f"within {rings} rings of each"
        remedy = "Use a smaller neighbourhood or patch, or the method 'voxflat'"
        need += settings.rows_memory_need(choice.count, len(part))
        need = settings.check_memory(need, f"distances {extent} of {len(part)} points are stored. {remedy}")
        chosen = choice.made(settings.progress)
        result = part.core.schwartz1989(
            rings,
            chosen,
            self.starts,
            settings.seed,
            bands_of(part),
            settings.keep_rows,
            settings.threads,
            settings.progress,
        )
        if np.isnan(result["planarity"]):
            result["planarity"] = None  # without sources
        energies, converged = result["convergence"]
        details: dict[str, Any] = {
            "neighbourhood": rings or "all",
            "pairs": result["pairs"],
            "starts": result["stresses"],
            "descent": {"converged": converged, "energies": energies},
        }
        warnings, rows = _warnings(result["stresses"]), result["rows"]
        return map_over_triangles(self.name, cut, settings, result, need, rows, details, warnings, sampling=choice.rule)


def _warnings(stresses: Sequence[float]) -> list[str]:
    """Return a warning if only one of the random starts reached the least stress."""
    least, *others = sorted(stresses)
    if not others or others[0] <= _SAME_STRESS * least + _NO_STRESS:
        return []
    return [
        f"only one of {len(stresses)} random starts reached the least stress, {least:.3g} (the next best is "
        f"{others[0]:.3g}), so a better map may exist. Use more starts, more sources or a larger neighbourhood"
    ]
