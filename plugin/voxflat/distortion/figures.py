"""Distortion measures of distances and of triangles, their standard errors, and conversion for JSON."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.read_only import ReadOnly


@dataclass(frozen=True)
class Figures:
    """Measures of the distance distortion of a flat map at one scale.

    δ are geodesic distances on the surface, and d are flat distances times `scale`. Undefined measures are NaN.

    Parameters
    ----------
    scale : float
        Factor applied to flat distances.
    relative_error : float
        Mean of ``|d − δ|/δ`` over all pairs (Grossmann et al. 2002: ε̄_r).
    relative_error_0_5mm, relative_error_5_15mm, relative_error_15_30mm : float
        The same for pairs with δ up to the first end of `Distortion.bands`, from the first to the third, and from the
        third to the fourth; on a human hemisphere, up to 5 mm, 5 to 15 mm, and 15 to 30 mm. Upper ends are included.
    relative_error_10mm, relative_error_30mm : float
        The same for pairs with δ up to the second and up to the fourth end; 10 and 30 mm on a human hemisphere.
    absolute_error : float
        Mean of ``|d − δ|``, in mm (Grossmann et al. 2002: ε̄).
    stress_1 : float
        Kruskal's stress-1, √(Σ(d − δ)² / Σδ²).
    sammon_stress : float
        Sammon's stress, (1/Σδ) Σ (d − δ)²/δ (Schwartz et al. 1989, equation 1.0).

    See Also
    --------
    Distortion : All measures of a map.

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
class TriangleFigures(ReadOnly):
    """Measures of the distortion of the triangles of a flat map.

    σ1 ≥ σ2 are the principal stretches of a triangle. Means, medians and 95th percentiles are weighted by the areas of
    triangles on the surface, except those of `areal`, which are taken over vertices. Undefined measures are NaN.

    Parameters
    ----------
    areal_median, areal_p95 : float
        Median and 95th percentile of ``|log2(A_flat / A_surface)|`` over the vertices, as in Connectome Workbench's
        -surface-distortion.
    equal_area_scale : float
        Factor by which to scale the map so that its area equals that of the surface.
    equal_area_median, equal_area_p95 : float
        `areal_median` and `areal_p95` at `equal_area_scale`.
    edge : float
        Mean of ``|l_flat / l_surface − 1|`` over the edges.
    angle : float
        Mean over the triangles, weighted by area, of the mean change of their three corner angles, in degrees.
    quasi_conformal, isometric, symmetric_dirichlet : float
        Medians of σ1/σ2, of max(σ1, 1/σ2), and of ½(σ1² + σ2² + σ1⁻² + σ2⁻²). Without distortion, they are 1, 1 and 2.
    flipped : int
        Number of flipped triangles, that is, triangles with the minority orientation.
    flipped_share : float
        Share of the surface area in flipped triangles.
    collapsed : int
        Number of triangles with zero area in the map.
    crossings : int
        Number of pairs of boundary edges that cross in the map.
    covering : int
        Number of triangles that cover another triangle.
    areal : ndarray, shape (N,)
        Change of area at each vertex, ``log2(A_flat / A_surface)``.
    is_flipped : ndarray of bool, shape (F,)
        Whether each triangle is flipped.
    area_beyond_1_25, area_beyond_1_5, area_beyond_2 : float
        Share of the surface area in triangles whose area changes by more than this factor, in either direction, at
        `equal_area_scale`. NaN for maps that were saved before these measures were introduced.

    See Also
    --------
    Distortion : All measures of a map.

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
    """Standard errors of distortion measures with respect to the choice of sources.

    They are computed by bootstrapping (Efron 1979): n sources are resampled with replacement 1000 times, and the
    standard deviation is multiplied by √(n/(n − 1) · (1 − n/N)), where N is the number of points. The best scale is
    held fixed. Errors are NaN if they are undefined, that is, with a single source or if a sample contains no pairs.

    Parameters
    ----------
    raw, best_scale : Figures
        Standard errors of the figures of the same name; their `scale` is NaN.
    pearson_r, mean_geodesic : float
        Standard errors of the measures with the same names.

    See Also
    --------
    Distortion : All measures of a map.

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
        raw, best = (100 * figures.relative_error for figures in (self.raw, self.best_scale))
        return f"<StandardErrors: relative error {raw:.2f} %, at the best scale {best:.2f} %>"


def json_ready(value: Any) -> Any:
    """Replace numbers that JSON does not support (NaN, which means undefined, and infinity) with None."""
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
