"""Maps in several charts, such as UV maps from Blender: their parts, and the distortion of all of them together."""

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from voxflat import _core
from voxflat.distortion.distortion import Distortion
from voxflat.distortion.figures import Figures, StandardErrors, TriangleFigures
from voxflat.maps.matching import Matched

_COMBINED = ("relative_error", "absolute_error")  # means over pairs; others have no value for all charts together


def charts_of(flat: Matched) -> list[tuple[Matched, NDArray[np.int64]]]:
    """Return the charts of a map, largest first, and their rows in the map; only the map itself if it is connected."""
    faces, count = flat.core.faces.astype(np.int64), len(flat.uv)
    links = scipy.sparse.coo_array((np.ones(2 * len(faces)), (faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel())))
    links.resize((count, count))
    number, label = scipy.sparse.csgraph.connected_components(links, directed=False)
    if number == 1:
        return [(flat, np.arange(count))]
    points = flat.core.points
    corners = points[faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    charts = []
    for chart in np.argsort(-np.bincount(label[faces[:, 0]], areas, number), kind="stable"):
        core, _ = _core.Surface.from_triangles(points, faces[label[faces[:, 0]] == chart])
        rows = core.ids.astype(np.int64)
        charts.append((Matched(core.with_ids(flat.core.ids[rows]), flat.uv[rows]), rows))
    return charts


def total(charts: Sequence[Distortion], rows: Sequence[NDArray[np.int64]], triangles: Mapping[str, Any]) -> Distortion:
    """Return the distortion of all charts: distances within charts, each at its own best scale; and all triangles."""
    pairs = np.array([chart.pairs for chart in charts])
    weights = pairs / pairs.sum()
    unknown = Figures(**{field.name: np.nan for field in fields(Figures)})

    def figures(name: str) -> tuple[Figures, Figures]:
        both = [(getattr(chart, name), getattr(chart.standard_error, name)) for chart in charts]
        means = {key: float(weights @ [getattr(value, key) for value, _ in both]) for key in _COMBINED}
        errors = {key: float(np.linalg.norm(weights * [getattr(error, key) for _, error in both])) for key in _COMBINED}
        return replace(unknown, **means), replace(unknown, **errors)

    (raw, raw_error), (best, best_error) = figures("raw"), figures("best_scale")
    inner = [chart.interior_share * chart.pairs for chart in charts]
    interiors = [chart.interior for chart in charts if chart.interior is not None]
    interior = None
    if len(interiors) == len(charts):
        of_pairs = {key: np.average([getattr(of, key) for of in interiors], weights=inner) for key in _COMBINED}
        interior = replace(unknown, **{key: float(mean) for key, mean in of_pairs.items()})
    per_point = np.full(1 + max(int(ids.max()) for ids in rows), np.nan)
    for chart, row in zip(charts, rows, strict=True):
        per_point[row] = chart.per_point
    apart = np.array([[chart.mean_geodesic, chart.standard_error.mean_geodesic] for chart in charts])
    error = float(np.linalg.norm(weights * apart[:, 1]))
    return replace(
        charts[0],
        raw=replace(raw, scale=1.0),
        best_scale=best,
        interior=interior,
        interior_share=float(sum(inner) / pairs.sum()),
        pearson_r=np.nan,
        mean_geodesic=float(weights @ apart[:, 0]),
        standard_error=StandardErrors(raw=raw_error, best_scale=best_error, pearson_r=np.nan, mean_geodesic=error),
        sources=sum(chart.sources for chart in charts),
        pairs=int(pairs.sum()),
        per_point=per_point,
        scatter=np.concatenate([chart.scatter for chart in charts]),
        triangles=TriangleFigures(**triangles),
        topology={key: sum((chart.topology or {})[key] for chart in charts) for key in charts[0].topology or {}},
        lower_bound=np.nan,
    )
