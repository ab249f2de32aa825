"""Turn a method's result into a `FlatMap`: measure its distortion, orient it, and collect warnings."""

import platform
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat import _core
from voxflat.arguments import log
from voxflat.distances.table import Table
from voxflat.distortion.bands import Bands, usual_bands
from voxflat.distortion.distortion import Distortion
from voxflat.distortion.figures import TriangleFigures
from voxflat.distortion.later import MeasuredLater
from voxflat.maps.flat_map import FlatMap
from voxflat.methods.method import FlattenSettings
from voxflat.surfaces.cuts import BEARABLE, relaxation_advice
from voxflat.surfaces.cutting import CutManifold
from voxflat.surfaces.manifold import Manifold
from voxflat.surfaces.standard.sphere import Sphere, interpolated
from voxflat.surfaces.standard.template import standard_template

MUCH = 0.01  # tolerated relative error of distances; graph distances usually have an error of 0.1 %

_FEWEST = 3  # corresponding points needed for a rotation
_FEW = 40  # exact reference sources if graph distances are too inaccurate: one minute for 80,000 vertices


def error_of_distances(part: Manifold, geodesic: str, settings: FlattenSettings) -> float:
    """Return the mean relative error of a solver's distances, compared with exact distances."""
    return part.core.error_of_distances(settings.seed, geodesic, settings.threads, settings.progress)


def bands_of(part: Manifold) -> Bands:
    """Return the distance bands of the measures for a surface."""
    return usual_bands(part.core.area, part.origin.unit)


def _measured(
    cut: CutManifold[Manifold], result: dict[str, Any], geodesic: str, links_error: float, settings: FlattenSettings
) -> Distortion:
    """Measure the distortion against graph distances, or against exact distances if graph distances are inaccurate."""
    part, reference, distances = cut.surface, "graph", result["distortion"]
    bands = bands_of(part)
    if geodesic == "exact" or links_error > MUCH:
        tube = None if cut.chart is None else cut.chart.tube
        joined, rows = (part, np.arange(len(part))) if tube is None else (tube.part, tube.rows(part))
        uv = np.empty((len(joined), 2))
        uv[rows] = result["uv"]
        count = _core.REFERENCE_SOURCES if geodesic == "exact" else _FEW
        sources = _core.reference_sources(len(joined), count, settings.seed)
        options, period = (
            (_core.KEPT_BYTES, settings.seed, bands, settings.threads, settings.progress),
            result.get("period"),
        )
        reference, distances = "exact", joined.core.judge([uv], sources, "exact", *options, period=period)[0]
        distances["per_point"] = distances["per_point"][rows]
    of_triangles = part.core.measure(result["uv"], settings.progress)
    return Distortion._of(distances, of_triangles, reference, voxel_size=part.voxel_size, bands=bands)


def map_over_triangles(
    method: str,
    cut: CutManifold[Manifold],
    settings: FlattenSettings,
    result: dict[str, Any],
    need: int | None,
    rows: NDArray[np.float32] | Table | None,
    more: dict[str, Any],
    method_warnings: Sequence[str] = (),
    *,
    store: Path | None = None,
    sampling: str | None = None,
    links_error: float | None = None,
    distortion: Distortion | None = None,
) -> FlatMap:
    """Return the map of a triangle surface, with its distortion, details and warnings."""
    part = cut.surface
    warnings = [*cut.warnings, *method_warnings]
    if distortion is None:
        if links_error is None:
            links_error = error_of_distances(part, "graph", settings)
        distortion = _measured(cut, result, more.get("geodesic", "graph"), links_error, settings)
    if not more.get("descent", {"converged": True})["converged"]:
        steps = len(more["descent"]["energies"])
        warnings.append(f"the optimisation stopped after {steps} steps before it converged. A better map may exist")
    if text := warning_of_distances(distortion):
        may_relax = settings.relax is None and cut.chart is None and all(one.reason != "relaxation" for one in cut.cuts)
        warnings.append(text + (relaxation_advice(part, settings.threads, settings.progress) if may_relax else ""))
    triangles = distortion.triangles
    assert triangles is not None
    warnings += warnings_of_triangles(triangles, len(part.faces))
    known: dict[str, Any] = {"need": need, "rows": rows, "more": more, "sampling": sampling, "store": store}
    return placed_map(method, cut, settings, result, distortion, warnings, **known)


def warning_of_distances(distortion: Distortion) -> str:
    """Return a warning about large errors of distances, or an empty text."""
    error, pairs = distortion.best_scale.relative_error, "of the map"
    if distortion.interior is not None and distortion.interior_share > 0:  # longer paths around notches are no errors
        error, pairs = distortion.interior.relative_error, "of interior pairs"
    if not error > BEARABLE:
        return ""
    return f"the mean relative distance error {pairs} is {100 * error:.0f} %, even at the best scale"


def warnings_of_triangles(triangles: TriangleFigures, count: int) -> list[str]:
    """Return warnings about overlaps and flipped triangles of a map with `count` triangles."""
    warnings = []
    if triangles.crossings:
        warnings.append(f"the map overlaps itself: its boundary crosses itself {triangles.crossings} times")
    elif triangles.covering and not triangles.flipped:
        warnings.append(f"the map overlaps itself: {triangles.covering} triangles cover another one")
    if triangles.flipped:
        warnings.append(f"the map folds over: {triangles.flipped} of {count} triangles are flipped")
    return warnings


def placed_map(
    method: str,
    cut: CutManifold[Manifold],
    settings: FlattenSettings,
    result: dict[str, Any],
    distortion: Distortion | MeasuredLater,
    warnings: list[str],
    *,
    need: int | None = None,
    rows: NDArray[np.float32] | Table | None = None,
    more: Mapping[str, Any],
    sampling: str | None = None,
    store: Path | None = None,
) -> FlatMap:
    """Return the map of a triangle surface with known warnings, with its anatomy, position and merged vertices."""
    part, chosen = cut.surface, result["sources"]
    anatomy = cut._anatomy(settings.threads, settings.progress)
    uv, frame, framed = _framed(result["uv"], cut, settings)
    merged, places = part._also_merged()
    rows_of: Any = slice(None)
    ids, vertices = part.ids, part.vertices
    if len(merged):  # each merged vertex has its own row, at the same position
        rows_of = np.concatenate([np.arange(len(part)), places])
        ids = vertices = np.concatenate([ids, merged])
        rows = rows[:, rows_of] if isinstance(rows, np.ndarray) else rows

    def of_map(measured: Distortion) -> Distortion:
        """Return the distortion at the points of the map; triangles that close holes come last, and are not part."""
        triangles = measured.triangles
        assert triangles is not None
        is_flipped = triangles.is_flipped[: len(cut.faces)]
        of_triangles = replace(triangles, areal=triangles.areal[rows_of], is_flipped=is_flipped)
        return replace(measured, per_point=measured.per_point[rows_of], triangles=of_triangles)

    known: Any = distortion.then(of_map) if isinstance(distortion, MeasuredLater) else of_map(distortion)
    return FlatMap(
        uv=uv[rows_of],
        points=part.points[rows_of],
        normals=result["normals"][rows_of],
        ids=ids,
        faces=cut.faces,
        torn=np.zeros(len(cut.faces), dtype=np.bool_),
        sources=chosen.astype(np.int64),
        eigenvalues=result["eigenvalues"],
        distortion=known,
        origin=cut.whole.origin,
        cuts=cut.cuts,
        cuts_by=cut.cuts_by,
        method=method,
        seed=settings.seed,
        warnings=tuple(warnings),
        frame=frame,
        period=result.get("period"),
        store=store,
        details={
            **cut.details,
            **framed,
            **making_details(chosen, result, need, warnings, sampling, logged=cut.warnings if cut.has_logged else ()),
            **more,
        },
        record=cut.whole.provenance,
        rows=rows,
        bridges=part._bridges(cut.faces),
        **{name: values[rows_of] for name, values in anatomy.items()},
        white_points=None if part.white_points is None else part.white_points[vertices],
        pial_points=None if part.pial_points is None else part.pial_points[vertices],
    )


def _framed(
    uv: NDArray[np.float64], cut: CutManifold[Manifold], settings: FlattenSettings
) -> tuple[NDArray[np.float64], str | None, dict[str, Any]]:
    """Align a map with the standard frame or with the axis of its chart, and mirror it on request."""
    frame, details = None, dict[str, Any](mirrored=settings.mirror)
    if cut.chart is not None:
        onto = cut.chart.onto[cut.surface.vertices]
        is_known = np.isfinite(onto).all(axis=1)
        if cut.chart.tube is None:  # the axes of a periodic map are those of its period
            uv, _ = _core.turn_onto(uv, uv[is_known], onto[is_known])
        uv, frame = uv - uv.mean(axis=0), "axis"
    if cut.sphere is not None and cut.given_length is not None:  # cuts of a template, or cuts passed with a sphere
        uv, points, residual = _in_standard_frame(uv, cut.surface, cut.faces, cut.sphere)
        if points:
            frame, details = "standard", {**details, "frame_points": points, "frame_residual": residual}
    return uv * [-1.0, 1.0] if settings.mirror else uv, frame, details


def _in_standard_frame(
    uv: NDArray[np.float64], part: Manifold, faces: NDArray[Any], sphere: Sphere
) -> tuple[NDArray[np.float64], int, float]:
    """Align a map rigidly with the flat map of fsaverage, using corresponding points on the sphere.

    The points are evenly spaced on the template's map, so that all parts have equal weight. The rotation minimises the
    sum of squared distances (Schönemann 1966), without scaling or mirroring, and the centroids coincide. Also return
    the number of points (0 if there are too few) and the root mean square of the residual distances in mm.
    """
    anchors = standard_template(sphere.space, sphere.side).anchors
    assert anchors is not None
    places, is_inside = interpolated(sphere.places[part.vertices], faces, uv, anchors.sphere)
    places, count = places[is_inside], int(is_inside.sum())
    if count < _FEWEST:
        return uv, 0, np.nan
    turned, _ = _core.turn_onto(np.concatenate([uv, places]), places, anchors.flat[is_inside])
    apart = np.linalg.norm(turned[len(uv) :] - anchors.flat[is_inside], axis=1)
    return np.ascontiguousarray(turned[: len(uv)]), count, float(np.sqrt((apart**2).mean()))


def making_details(
    chosen: NDArray[Any],
    result: dict[str, Any],
    need: int | None,
    warnings: list[str],
    sampling: str | None,
    logged: Sequence[str] = (),
) -> dict[str, Any]:
    """Log the warnings that were not logged before, and return details of how a map was made."""
    for warning in warnings:
        if warning not in logged:
            log.warning(warning)
    of_sources: dict[str, Any] = {}
    if sampling is not None:  # the method has sources
        of_sources = {"sources": len(chosen), "sampling": sampling, "planarity": result["planarity"]}
    return {
        **of_sources,
        **({} if need is None else {"memory_need_bytes": need}),
        "versions": {"voxflat": _core.__version__, "numpy": np.__version__, "python": platform.python_version()},
    }
