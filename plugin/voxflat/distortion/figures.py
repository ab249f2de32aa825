"""Figures of distortion, of distances and of triangles, with their errors, and as JSON has them."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Figures:
    """Distortion figures of a flat map at one scale.

    δ are geodesic distances on the surface, d flat distances times `scale`. NaN means undefined.

    Parameters
    ----------
    scale : float
        The factor on flat distances.
    relative_error : float
        Mean of |d − δ|/δ over all pairs (Grossmann et al. 2002: ε̄_r).
    relative_error_0_5mm, relative_error_5_15mm, relative_error_15_30mm : float
        The same over pairs with δ in these bands, whose upper ends belong to them.
    relative_error_10mm, relative_error_30mm : float
        The same over pairs with δ ≤ 10 mm and ≤ 30 mm.
    absolute_error : float
        Mean of |d − δ|, mm (Grossmann et al. 2002: ε̄).
    stress_1 : float
        √(Σ(d − δ)² / Σδ²), Kruskal.
    sammon_stress : float
        (1/Σδ) Σ (d − δ)²/δ, Schwartz et al. 1989, equation 1.0.

    Examples
    --------
    >>> figures = voxflat.samples.hill().flatten().distortion.raw
    >>> round(figures.relative_error, 3)  # of all distances, as a fraction
    0.036
    """

    scale: float
    relative_error: float
    relative_error_0_5mm: float
    relative_error_5_15mm: float
    relative_error_15_30mm: float
    relative_error_10mm: float
    relative_error_30mm: float
    absolute_error: float
    stress_1: float
    sammon_stress: float

    def __repr__(self) -> str:
        return (
            f"<Figures at scale {self.scale:.4g}: relative error {100 * self.relative_error:.2f} %, "
            f"absolute error {self.absolute_error:.3g}, stress-1 {self.stress_1:.4f}>"
        )


@dataclass(frozen=True, eq=False)
class TriangleFigures:
    """What flattening did to the triangles.

    σ1 ≥ σ2 are the stretches of a triangle in its two principal directions. Means, medians and 95th percentiles are by
    the triangles' areas on the surface, those of `areal` by vertices. NaN means undefined.

    Parameters
    ----------
    areal_median, areal_p95 : float
        Of |log2(A_flat / A_surface)| over the vertices, as Connectome Workbench's -surface-distortion has it.
    equal_area_scale : float
        The factor on the map that makes its area that of the surface.
    equal_area_median, equal_area_p95 : float
        `areal_median` and `areal_p95` at that scale.
    edge : float
        Mean over the edges of |l_flat / l_surface − 1|.
    angle : float
        Mean change of a corner's angle, degrees.
    quasi_conformal, isometric, symmetric_dirichlet : float
        Medians of σ1/σ2, of max(σ1, 1/σ2), and of ½(σ1² + σ2² + σ1⁻² + σ2⁻²); perfect are 1, 1 and 2.
    flipped : int
        Number of triangles of the minority orientation.
    flipped_share : float
        Their share of the surface's area.
    collapsed : int
        Number of triangles without area in the map.
    crossings : int
        Number of pairs of boundary edges that cross in the map.
    covering : int
        Number of triangles that cover another.
    areal : ndarray, shape (N,)
        log2(A_flat / A_surface) at each vertex.
    is_flipped : ndarray of bool, shape (F,)
        Which triangles are turned over.
    area_beyond_1_25, area_beyond_1_5, area_beyond_2 : float
        The share of the surface, by its area, in triangles whose area changes by more than this factor, either way, at
        `equal_area_scale`. NaN in maps that were saved before there was such a figure.

    Examples
    --------
    >>> triangles = voxflat.samples.hill().flatten().distortion.triangles
    >>> triangles.flipped
    0
    """

    areal_median: float
    areal_p95: float
    equal_area_scale: float
    equal_area_median: float
    equal_area_p95: float
    edge: float
    angle: float
    quasi_conformal: float
    isometric: float
    symmetric_dirichlet: float
    flipped: int
    flipped_share: float
    collapsed: int
    crossings: int
    covering: int
    areal: NDArray[np.float64]
    is_flipped: NDArray[np.bool_]
    area_beyond_1_25: float = np.nan
    area_beyond_1_5: float = np.nan
    area_beyond_2: float = np.nan

    def __repr__(self) -> str:
        return (
            f"<TriangleFigures: area, log2, {self.areal_median:.2f} (95 %: {self.areal_p95:.2f}), edges "
            f"{100 * self.edge:.1f} %, {self.flipped} flipped, {self.covering} covering another>"
        )


@dataclass(frozen=True)
class StandardErrors:
    """How far figures scatter with the choice of the sources: standard errors by the bootstrap (Efron 1979).

    Sources are drawn anew from those that there are, with replacement, 1000 times; the standard deviation over the
    draws is corrected for their number n out of N points, √(n/(n − 1) · (1 − n/N)). The best scale is held. NaN means
    undefined: of a single source, or where a draw has no pair.

    Parameters
    ----------
    raw, best_scale : Figures
        Of the figures of that name; their `scale` is NaN.
    pearson_r, mean_geodesic : float
        Of the figures of that name.

    Examples
    --------
    >>> error = voxflat.samples.hill().flatten().distortion.standard_error
    >>> error.raw.relative_error < 0.01
    True
    """

    raw: Figures
    best_scale: Figures
    pearson_r: float
    mean_geodesic: float

    def __repr__(self) -> str:
        raw, best = (100 * of.relative_error for of in (self.raw, self.best_scale))
        return f"<StandardErrors: relative error {raw:.2f} %, at the best scale {best:.2f} %>"


def json_ready(value: Any) -> Any:
    """Return the same with None for the numbers that JSON does not know: NaN, which means undefined, and infinity."""
    if isinstance(value, dict):
        return {key: json_ready(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [json_ready(item) for item in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def undefined_as_nan(value: Any) -> Any:
    """Undo `json_ready` for figures."""
    if isinstance(value, dict):
        return {key: undefined_as_nan(item) for key, item in value.items()}
    return float("nan") if value is None else value
