"""The measures of the benchmark, and those of other programs and papers by their own formulas.

δ are true distances and d distances in the map; `docs/benchmark/measures.md` defines all measures. Sums over the
sources are kept apart until the end, because standard errors need them.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from voxflat import _core
from voxflat.distortion.bands import Bands
from voxflat.distortion.triangles import stretches

_Rows = NDArray[np.float64]  # (S, N): from each source to each vertex

_RINGS = 7  # the neighbourhood in which FreeSurfer measures distances
_SCALES = np.linspace(0.80, 1.25, 91)  # at which autoflatten's benchmark looks for the best scale


def distances_on_map(uv: NDArray[np.float64], sources: NDArray[np.int64]) -> _Rows:
    """Return the distances in the map from sources to all vertices."""
    return np.stack([np.hypot(*(uv - uv[source]).T) for source in sources])


def best_scale(true: _Rows, flat: _Rows) -> float:
    """Return the factor s that minimises the mean of |s d − δ| / δ over all pairs: a weighted median of δ / d."""
    is_pair = _pairs(true) & (flat > 0)
    ratio, weight = true[is_pair] / flat[is_pair], flat[is_pair] / true[is_pair]
    order = np.argsort(ratio)
    half = np.cumsum(weight[order])
    return float(ratio[order][np.searchsorted(half, half[-1] / 2)])


def distance_measures(
    true: _Rows, flat: _Rows, bands: Bands, scale: float | None = None
) -> tuple[dict[str, float], dict[str, float]]:
    """Return the errors of distances at the best scale, and their standard errors over the sources at a fixed scale.

    The mean relative error is given for all pairs and for those up to the second and the fourth band, which are 10 and
    30 mm on human hemispheres.
    """
    scale = best_scale(true, flat) if scale is None else scale
    is_pair = _pairs(true)
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.where(is_pair, np.abs(scale * flat - true) / true, 0.0)
    measures, errors = {"scale": scale}, {"scale": np.nan}
    limits = {"relative_error": np.inf, "relative_error_30mm": bands[3], "relative_error_10mm": bands[1]}
    for name, limit in limits.items():
        is_near = is_pair & (true <= limit)
        measures[name], errors[name] = _ratio((relative * is_near).sum(axis=1), is_near.sum(axis=1))
    squares = np.where(is_pair, (scale * flat - np.where(is_pair, true, 0.0)) ** 2, 0.0).sum(axis=1)
    ratio, error = _ratio(squares, (np.where(is_pair, true, 0.0) ** 2).sum(axis=1))
    measures["stress_1"] = float(np.sqrt(ratio))
    errors["stress_1"] = float(error / (2 * np.sqrt(ratio))) if ratio > 0 else np.nan
    return measures, errors


def others_distance_measures(true: _Rows, flat: _Rows, faces: NDArray[np.int64], sources: Any) -> dict[str, float]:
    """Return the measures of other programs, at the scale of the map and with exact distances.

    The benchmark of autoflatten: the mean relative errors up to 30 units and of all pairs, and that of all pairs at the
    best of 91 scales. FreeSurfer: the mean error divided by the mean distance, within seven rings of neighbours, and
    J_d of Fischl et al. (1999), with these neighbours.
    """
    is_pair = _pairs(true) & (true > 1e-6)
    pairs, of_map = true[is_pair], flat[is_pair]
    relative = np.abs(of_map - pairs) / pairs
    is_local = pairs <= 30
    place = np.searchsorted(_SCALES, best_scale(pairs, of_map))
    near = _SCALES[max(place - 1, 0) : place + 1]  # the error is convex, so the best of all scales is one of these
    rings = is_pair & neighbours(faces, sources, true.shape[1])
    apart = np.abs(flat[rings] - true[rings])
    return {
        "autoflatten_local": _mean(relative[is_local]),
        "autoflatten_global": _mean(relative),
        "autoflatten_global_best_scale": min(_mean(np.abs(scale * of_map - pairs) / pairs) for scale in near),
        "freesurfer_error": float(apart.sum() / true[rings].sum()) if rings.any() else np.nan,
        "fischl_jd": float((apart**2).sum() / (4 * len(true))),
    }


def neighbours(faces: NDArray[np.int64], sources: Any, count: int, rings: int = _RINGS) -> NDArray[np.bool_]:
    """Return which vertices are within some rings of neighbours of each source, shape (S, N)."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ends = np.concatenate([ends, ends[:, ::-1]])
    links = scipy.sparse.csr_array((np.ones(len(ends), dtype=np.float32), ends.T), shape=(count, count))
    is_near = np.zeros((count, len(sources)), dtype=np.float32)
    is_near[sources, np.arange(len(sources))] = 1
    for _ in range(rings):
        is_near = np.minimum(is_near + links @ is_near, 1)
    return np.asarray(is_near.T > 0)


def triangle_measures(core: _core.Surface, uv: NDArray[np.float64], scale: float) -> dict[str, Any]:
    """Return the measures of triangles and edges; edges at the best scale for distances, areas at that of equal area.

    The symmetric Dirichlet energy is the mean of σ1² + σ2² + σ1⁻² + σ2⁻², weighted by area, as in SLIM: 4 without
    distortion, and infinite if a triangle collapses.
    """
    found: Mapping[str, Any] = core.measure(np.ascontiguousarray(scale * uv))
    names = ("edge", "angle", "equal_area_median", "equal_area_p95", "area_beyond_1_5")
    counts = ("flipped", "flipped_share", "collapsed", "covering", "crossings")
    measures = {name: found[name] for name in (*names, *counts)}
    points, faces = core.points, core.faces.astype(np.int64)
    first, second = (points[faces[:, corner]] - points[faces[:, 0]] for corner in (1, 2))
    areas = np.linalg.norm(np.cross(first, second), axis=1)
    squares = stretches(points, faces, scale * found["equal_area_scale"] * uv) ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        energy = (squares + 1 / squares).sum(axis=1)
    is_known = areas > 0
    energies = energy[is_known]
    mean = np.average(energies, weights=areas[is_known]) if np.isfinite(energies).all() else np.inf
    return measures | {"symmetric_dirichlet_mean": float(mean)}


def _pairs(true: _Rows) -> NDArray[np.bool_]:
    return (true > 0) & np.isfinite(true)


def _mean(values: NDArray[np.float64]) -> float:
    return float(values.mean()) if len(values) else np.nan


def _ratio(parts: NDArray[Any], wholes: NDArray[Any]) -> tuple[float, float]:
    """Return a ratio of sums over sources, and its standard error (of a ratio estimator, to first order)."""
    total, count = float(wholes.sum()), len(parts)
    if not total:
        return np.nan, np.nan
    ratio = float(parts.sum()) / total
    if count < 2:
        return ratio, np.nan
    spread = float(((parts - ratio * wholes) ** 2).sum())
    return ratio, float(np.sqrt(count / (count - 1) * spread) / total)
