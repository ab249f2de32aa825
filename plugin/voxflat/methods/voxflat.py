"""The method "voxflat": minimise the distortion of distances and triangles, from coarse to fine."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat import _core
from voxflat.arguments import checked_choice, is_number, log, shown
from voxflat.distances.geodesic import SOLVERS
from voxflat.distances.rows import open_rows
from voxflat.distances.sources import SAMPLINGS, source_choice
from voxflat.distances.store import prepare_store
from voxflat.distortion.distortion import Distortion
from voxflat.errors import InputError
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.map_cuts import covered, named_as
from voxflat.maps.matching import match
from voxflat.maps.worst_places import AreaBoundError, area_changes
from voxflat.maps.worst_search import worst_places
from voxflat.methods.common import MUCH, bands_of, error_of_distances, map_over_triangles
from voxflat.methods.method import FlattenSettings, OverTriangles
from voxflat.methods.start import cut_as, places_of
from voxflat.surfaces.cutting import CutManifold, Tube
from voxflat.surfaces.manifold import Manifold

SCALES = ("distances", "areas")  # quantities that the scale of a map may preserve

_WITHIN = 0.99  # exponent of the bound on areas during descent, whose total area includes closed holes


class CutGroup(Protocol):
    """Surfaces with the same triangles, cut open as their mean surface."""

    def combined(self, chosen: NDArray[np.uint32]) -> _core.Group:
        """Return their combined distances from the given sources, and their combined shapes."""

    def distortion(self, uv: NDArray[np.float64]) -> Distortion:
        """Return the mean distortion of a map."""


@dataclass(frozen=True, kw_only=True)
class Voxflat(OverTriangles):
    r"""Flatten by minimising the distortion of distances and triangles (the default method).

    Among the maps without flipped triangles, the method searches for one that minimises the energy

    .. math::

       E = \sum_b a_b\, \operatorname{mean}_{(i,j) \in b}\, \rho\!\left(\frac{d_{ij} - \delta_{ij}}{\delta_{ij}}\right)
       + \beta\, \operatorname{mean}_{T}\, \psi(J_T) .

    The first term compares distances :math:`d_{ij}` in the map with geodesic distances :math:`\delta_{ij}` from the
    `sources`, in three bands :math:`b`: all pairs, near pairs, which are up to 0.11 times the square root of the area
    apart (30 mm on a human hemisphere), and pairs up to a third of that. If the shortest path of a pair passes the
    boundary between its ends, it is only an upper bound: the difference counts if it is positive [1]_. The loss
    :math:`\rho(r)` is :math:`r^2` for small errors and grows like :math:`|r|` for larger ones, so that distances that
    no map can preserve do not dominate. The second term averages the distortion of the triangles :math:`T` over the
    surface, where :math:`J` is the Jacobian of the map, :math:`\sigma_1 \ge \sigma_2` are its singular values and
    :math:`D` is its determinant:

    .. math::

       \psi = \rho(\sqrt{\varphi}), \quad \varphi = 2 (1 - \lambda) \sum_k (\sigma_k - 1)^2
       + \lambda \left(\tfrac{1}{2} \|J\|^2 (1 + D^{-2}) - 2\right) + \gamma \log^2 D .

    The part weighted by :math:`\lambda = 0.02` tends to infinity when a triangle is about to flip [2]_. The other part
    keeps the map as rigid as possible [3]_. The descent starts from a Tutte embedding of a coarse surface and proceeds
    level by level until all vertices are placed. No triangle is flipped in the process, and no triangles overlap.

    Parameters
    ----------
    sources : int or array_like of int
        Number of points from which distances are measured (all points, if there are fewer), or the points themselves:
        voxel indices (m, 3) or vertex numbers (m,). The default is 400; using more sources did not change any measured
        map.
    sampling : {"farthest", "curvature", "random"}
        How sources are chosen: "farthest" spreads them evenly along the surface; "curvature" places them up to four
        times as densely where the surface bends; "random" draws them at random.
    geodesic : {"graph", "marching", "exact"}, optional
        How distances are measured, as in `Surface.geodesic`. The default is "graph". If its error exceeds 1 % for a
        sample of sources, which thin triangles can cause, "marching" is used instead, or "exact" if the error of
        "marching" also exceeds 1 %.
    weighting : float
        Balance between preserving triangles (0) and long distances (1); by default 0.5. The weights of triangles and of
        near pairs are multiplied by ``10 ** (1 - 2 * weighting)``: 0 preserves angles and areas best, and 1
        preserves long distances best.
    scale : {"distances", "areas"}
        Whether the scale of the map preserves distances or areas; no map of a curved surface preserves both.
        "distances" minimises the mean relative error of distances; "areas" makes the area of the map equal to that of
        the surface. ``distortion.triangles.equal_area_scale`` and ``distortion.best_scale.scale`` are the factors that
        convert one scale to the other.
    max_area : float, optional
        Maximum factor (above 1) by which the area of any triangle may change, relative to the scale that preserves the
        total area. Starting from the usual map, the descent continues with an increasing penalty on larger changes.
        ``metadata["area_change"]`` is the factor reached. If no such map is found, flattening raises an
        `AreaBoundError`, which holds the best map and suggested cuts.
    start : map, optional
        A flat map of the surface to start from, of any kind that `voxflat.measure` accepts. It may have any position,
        scale and orientation. The result is the map with the least energy near it, in the same orientation, but never
        mirrored. Unless a part is chosen, the result covers the same part as the start; a chosen part must be within
        this part. Unless cuts are chosen, the result has the cuts of the start; chosen cuts must include them. A few
        flipped triangles are repaired; a start that cannot be repaired raises an error.

    See Also
    --------
    Surface.flatten : Flatten a surface with a method.
    worst_places : Find the regions where a map changes areas most.

    References
    ----------
    .. [1] G. Rosman, M. M. Bronstein, A. M. Bronstein, R. Kimmel: Nonlinear Dimensionality Reduction by
       Topologically Constrained Isometric Embedding. International Journal of Computer Vision 89 (1), 56-68, 2010.
    .. [2] J. Smith, S. Schaefer: Bijective Parameterization with Free Boundaries. ACM Transactions on Graphics 34 (4),
       2015.
    .. [3] L. Liu, L. Zhang, Y. Xu, C. Gotsman, S. J. Gortler: A Local/Global Approach to Mesh Parameterization.
       Computer Graphics Forum 27 (5), 1495-1504, 2008.

    Examples
    --------
    >>> from voxflat.methods import Voxflat
    >>> depth = voxflat.range_image(np.zeros((9, 9)), 1.0)
    >>> flat_map = depth.flatten(Voxflat(sources=20, scale="areas"))
    >>> flat_map.metadata["scale"]
    'areas'
    """

    name: ClassVar[str] = "voxflat"
    summary: ClassVar[str] = "minimises the distortion of distances and triangles"
    _keeps_holes: ClassVar[bool] = True
    _takes_store: ClassVar[bool] = True
    _takes_tubes: ClassVar[bool] = True

    sources: int | ArrayLike = 400
    sampling: str = "farthest"
    geodesic: str | None = None
    weighting: float = 0.5
    scale: str = "distances"
    max_area: float | None = None
    start: object | None = None

    def __post_init__(self) -> None:
        """Check the options."""
        checked_choice(self.sampling, "sampling", SAMPLINGS)
        if self.geodesic is not None:
            checked_choice(self.geodesic, "geodesic", SOLVERS)
        if not (is_number(self.weighting) and 0 <= self.weighting <= 1):
            raise InputError(f"weighting is {shown(self.weighting)}. Pass a number from 0 (triangles) to 1 (distances)")
        checked_choice(self.scale, "scale", SCALES)
        if self.max_area is not None and not (is_number(self.max_area) and 1 < self.max_area < np.inf):
            raise InputError(f"max_area is {shown(self.max_area)}. Pass a factor greater than 1, such as 2")

    def _cut(self, surface: Manifold, settings: FlattenSettings) -> CutManifold[Manifold]:
        """Cut a surface open to a disk: the part that the start covers, and along its cuts, unless others are given."""
        if self.start is None or surface.steps:
            return super()._cut(surface, settings)
        start = match(surface, self.start)
        if settings.defines_cuts:
            return super()._cut(covered(surface, start, "start"), settings)
        return named_as(cut_as(surface, start, settings.threads, settings.progress), self.start)

    def _map(
        self,
        cut: CutManifold[Manifold],
        settings: FlattenSettings,
        group: CutGroup | None = None,
    ) -> FlatMap:
        """Flatten a disk of triangles, from a coarse surface or from a given map, or that of the mean of a group."""
        if cut.chart is not None and cut.chart.tube is not None:
            return self._periodic_map(cut, cut.chart.tube, settings)
        part, weighting = cut.surface, float(self.weighting)
        max_area = None if self.max_area is None else float(self.max_area)
        places = None if self.start is None else places_of(cut, match(cut.whole, self.start))
        choice = source_choice(part, self.sources, self.sampling, settings.seed, fewest=3, at_most_all=True)
        storage = "stored" if settings.store is not None else "kept" if settings.keep_rows else "dropped"
        of_group = 0 if group is None else _core.Group.memory_need(len(part), choice.count)
        need = settings.check_memory(part.core.memory_need(choice.count, settings.workers, storage) + of_group)
        chosen = choice.made(settings.progress)
        links_error = error_of_distances(part, "graph", settings)
        solver, error, warnings = _solver(part, self.geodesic, links_error, settings)
        store = None
        if settings.store is not None:
            store = prepare_store(
                settings.store, part.core, part.ids, chosen, geodesic=solver, progress=settings.progress
            )
        arguments = (
            chosen,
            settings.seed,
            bands_of(part),
            solver,
            weighting,
            self.scale,
            settings.keep_rows,
            settings.threads,
            settings.progress,
        )
        bound, key = None if max_area is None else max_area**_WITHIN, None if store is None else store.key
        result = part.core.voxflat(
            *arguments, key, places, max_area=bound, group=None if group is None else group.combined(chosen)
        )
        if store is not None:
            store.tell(result["found"])
        energies, converged = result["convergence"]
        details: dict[str, Any] = {"geodesic": solver, "distance_error": error}
        details |= {"weighting": weighting, "scale": self.scale} | ({} if self.start is None else {"start": True})
        details["descent"] = {"converged": converged, "energies": energies}
        rows, more = result["rows"], dict[str, Any](sampling=choice.rule, links_error=links_error)
        if group is not None:
            more["distortion"] = group.distortion(result["uv"])
        if store is not None:
            more["store"], rows = store.path, open_rows(store.path).rows
        flat = map_over_triangles(self.name, cut, settings, result, need, rows, details, warnings, **more)
        return flat if max_area is None else _within(flat, max_area, settings)

    def _periodic_map(self, cut: CutManifold[Manifold], tube: Tube, settings: FlattenSettings) -> FlatMap:
        """Flatten a tube such that the two sides of its seam differ by one period."""
        refused = {"max_area": self.max_area, "start": self.start, "rows": settings.rows or None}
        for name in (name for name, value in refused.items() if value is not None):
            raise InputError(f"{name} does not apply to the chart 'cylinder'. Omit it, or use a single chart")
        part = tube.part
        choice = source_choice(part, self.sources, self.sampling, settings.seed, fewest=3, at_most_all=True)
        need = settings.check_memory(cut.surface.core.memory_need(choice.count, settings.workers, "dropped"))
        links_error = error_of_distances(part, "graph", settings)
        solver, error, warnings = _solver(part, self.geodesic, links_error, settings)
        of_seam = (cut.surface.core, tube.seam.astype(np.uint32), choice.made(settings.progress), settings.seed)
        result = part.core.periodic(
            *of_seam,
            bands_of(cut.surface),
            solver,
            float(self.weighting),
            self.scale,
            settings.threads,
            settings.progress,
        )
        energies, converged = result["convergence"]
        details = {"geodesic": solver, "distance_error": error, "weighting": self.weighting, "scale": self.scale}
        details["descent"] = {"converged": converged, "energies": energies}
        details["planarity"] = None  # distances around a tube are not those in a plane
        more: dict[str, Any] = {"sampling": choice.rule, "links_error": links_error}
        return map_over_triangles(self.name, cut, settings, result, need, None, details, warnings, **more)


def _within(flat: FlatMap, max_area: float, settings: FlattenSettings) -> FlatMap:
    """Return a map that satisfies the bound on area changes, or raise an error."""
    areas, logs = area_changes(flat)
    areas, logs = areas[np.isfinite(logs)], logs[np.isfinite(logs)]  # triangles with an area on the surface
    reached = float(np.exp2(np.abs(logs).max()))
    flat = replace(flat, details={**flat.details, "max_area": max_area, "area_change": reached})
    if reached <= max_area:
        return flat
    is_beyond = np.abs(logs) > np.log2(max_area)
    share = float(areas[is_beyond].sum() / areas.sum())
    places = worst_places(flat, 3, beyond=max_area, threads=settings.threads, progress=settings.progress)
    lengths = [f"{place.cut.length:.0f}" for place in places.places if place.cut is not None]
    cuts = f"Add the cuts that voxflat.worst_places suggests ({' + '.join(lengths)} mm), use" if lengths else "Use"
    raise AreaBoundError(
        f"no map was found in which every triangle changes its area by at most a factor of {max_area:g}. In the best "
        f"map, one triangle changes by {reached:.3g}, and {int(is_beyond.sum())} of {len(logs)} triangles "
        f"({100 * share:.2g} % of the area) by more than {max_area:g}. {cuts} relax=True, flatten a smaller patch, or "
        "increase max_area",
        flat,
        places,
    )


def usual_solver(part: Manifold, settings: FlattenSettings) -> tuple[str, float, list[str]]:
    """Return the usual solver for distances on a surface, its error, and warnings about it."""
    return _solver(part, None, error_of_distances(part, "graph", settings), settings)


def _solver(
    part: Manifold, asked: str | None, links_error: float, settings: FlattenSettings
) -> tuple[str, float, list[str]]:
    """Return the solver for distances, its error, and warnings about it."""
    if asked == "exact":
        return asked, 0.0, []
    solver = "graph" if asked is None else asked
    error = links_error if solver == "graph" else error_of_distances(part, solver, settings)
    if not error > MUCH:
        return solver, error, []
    warning = f"distances by {_NAMES[solver]} have a mean error of {100 * error:.1f} %, which thin triangles can cause."
    if asked is not None:
        return solver, error, [f"{warning} Omit geodesic, or pass 'exact'"]
    solver, error = "marching", error_of_distances(part, "marching", settings)
    if error > MUCH:
        solver, error = "exact", 0.0
        log.info("measuring exact distances, which is slower")
    return solver, error, [f"{warning} Distances are measured by {_NAMES[solver]} instead"]


_NAMES = {"graph": "graph paths", "marching": "fast marching", "exact": "exact geodesics"}
