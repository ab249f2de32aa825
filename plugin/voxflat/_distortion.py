"""Figures of distortion: what flattening did to distances and triangles."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Distortion", "Figures", "Triangles", "json_ready", "undefined_as_nan"]


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
    relative_error_10mm, relative_error_30mm : float
        The same over pairs with δ ≤ 10 mm and ≤ 30 mm.
    absolute_error : float
        Mean of |d − δ|, mm (Grossmann et al. 2002: ε̄).
    stress_1 : float
        √(Σ(d − δ)² / Σδ²), Kruskal.
    sammon_stress : float
        (1/Σδ) Σ (d − δ)²/δ, Schwartz et al. 1989, equation 1.0.
    """

    scale: float
    relative_error: float
    relative_error_10mm: float
    relative_error_30mm: float
    absolute_error: float
    stress_1: float
    sammon_stress: float


@dataclass(frozen=True, eq=False)
class Triangles:
    """What flattening did to the triangles.

    σ1 ≥ σ2 are the stretches of a triangle in its two principal directions. Means, medians and 95th percentiles are by
    the triangles' areas on the surface, those of `areal` by vertices. NaN means undefined.

    Parameters
    ----------
    areal_median, areal_p95 : float
        Of |log2(A_flat / A_surface)| over the vertices, as Connectome Workbench's -surface-distortion has it.
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
    """

    areal_median: float
    areal_p95: float
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


@dataclass(frozen=True, eq=False)
class Distortion:
    """What flattening did to the distances, from reference sources (200 random points) to all points.

    Parameters
    ----------
    raw : Figures
        At scale 1: a flat map is in mm.
    best_scale : Figures
        At the scale with the least mean relative error.
    pearson_r : float
        Correlation of flat and geodesic distances.
    mean_geodesic : float
        Mean geodesic distance of the pairs, mm (Grossmann et al. 2002: δ̄).
    pairs : int
        Number of pairs.
    per_point : ndarray, shape (N,)
        Mean of |d − δ|/δ over the pairs of each point, at scale 1: the heat map.
    scatter : ndarray, shape (K, 2)
        Some pairs as (δ, d), mm.
    triangles : Triangles or None
        What it did to the triangles, where the surface has some.
    """

    raw: Figures
    best_scale: Figures
    pearson_r: float
    mean_geodesic: float
    pairs: int
    per_point: NDArray[np.float64]
    scatter: NDArray[np.float64]
    triangles: Triangles | None = None

    def figures(self) -> dict[str, Any]:
        """Return the figures without the arrays, ready for JSON: undefined ones are None.

        Returns
        -------
        dict
            ``raw`` and ``best_scale`` (dicts), ``pearson_r``, ``mean_geodesic``, ``pairs``, ``triangles`` (dict or
            None).
        """
        return dict(json_ready(_without_arrays(asdict(self))))

    def table(self) -> str:
        """Return the figures as a table of text."""
        rows = [
            ("relative error", "relative_error", 100.0, "%"),
            ("  pairs up to 10 mm", "relative_error_10mm", 100.0, "%"),
            ("  pairs up to 30 mm", "relative_error_30mm", 100.0, "%"),
            ("absolute error", "absolute_error", 1.0, "mm"),
            ("stress-1", "stress_1", 1.0, ""),
            ("Sammon stress", "sammon_stress", 1.0, ""),
        ]
        lines = [f"{'':22}{'raw':>10}{'at scale ' + format(self.best_scale.scale, '.3f'):>18}"]
        for name, key, factor, unit in rows:
            raw, best = (factor * getattr(figures, key) for figures in (self.raw, self.best_scale))
            digits = 2 if unit else 4
            lines.append(f"{name:22}{raw:>10.{digits}f}{best:>18.{digits}f} {unit}".rstrip())
        lines.append(f"{'mean geodesic':22}{self.mean_geodesic:>10.2f}{'':18} mm")
        lines.append(f"{'correlation':22}{self.pearson_r:>10.4f}")
        if self.triangles is not None:
            of = self.triangles
            lines += [
                f"{'areal, log2':22}{of.areal_median:>10.4f}{of.areal_p95:>18.4f} median, 95 %",
                f"{'edges':22}{100 * of.edge:>10.2f}{'':18} %",
                f"{'angles':22}{of.angle:>10.2f}{'':18} degrees",
                f"{'flipped triangles':22}{of.flipped:>10}{100 * of.flipped_share:>18.3f} % of the area",
                f"{'overlap':22}{of.covering:>10}{of.crossings:>18} triangles, crossings of the boundary",
            ]
        return "\n".join(lines)


def _without_arrays(values: dict[str, Any]) -> dict[str, Any]:
    """Leave out the arrays of nested dictionaries."""
    kept = {key: value for key, value in values.items() if not isinstance(value, np.ndarray)}
    return {key: _without_arrays(value) if isinstance(value, dict) else value for key, value in kept.items()}


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
