"""The columns of the table of a study, and their descriptions for its JSON file."""

from collections.abc import Mapping, Sequence
from typing import Any

from voxflat.distortion.bands import HUMAN, Bands, in_bands, key_in_bands
from voxflat.lab.results import bands_in, figure_of

_FIRST: dict[str, tuple[str, str]] = {
    "participant_id": ("participant", ""),
    "session_id": ("session", ""),
    "hemi": ("hemisphere: L or R", ""),
    "status": ("done, or missing if there is no map", ""),
    "reason": ("reason why there is no map", ""),
    "outliers": (
        "measures of group.html in which the hemisphere is high or low among the hemispheres of its side (modified z "
        "score above 3.5 among at least five), and nonzero numbers of flipped or covering triangles or of boundary "
        "crossings",
        "",
    ),
    "warnings": ("reasons to check the map", ""),
    "cortex": ("what defines the cortex, such as the cortex label", ""),
    "cuts": ("source of the cuts: standard, automatic, given, or the name of a template", ""),
    "points": ("number of vertices on the map; a vertex at a cut is counted once", ""),
    "width": ("width of the map", "mm"),
    "height": ("height of the map", "mm"),
}
_DISTANCES = {  # d are distances on the map, and δ geodesic distances on the surface
    "scale": ("factor by which distances on the map are multiplied", ""),
    "relative_error": (
        "mean of |d − δ|/δ over pairs of points with the distance d on the map and δ on the surface, as a fraction",
        "",
    ),
    "relative_error_0_5mm": ("mean of |d − δ|/δ over pairs with δ up to 5 mm, as a fraction", ""),
    "relative_error_5_15mm": ("mean of |d − δ|/δ over pairs with δ above 5 and up to 15 mm, as a fraction", ""),
    "relative_error_15_30mm": ("mean of |d − δ|/δ over pairs with δ above 15 and up to 30 mm, as a fraction", ""),
    "relative_error_10mm": ("mean of |d − δ|/δ over pairs with δ up to 10 mm, as a fraction", ""),
    "relative_error_30mm": ("mean of |d − δ|/δ over pairs with δ up to 30 mm, as a fraction", ""),
    "absolute_error": ("mean of |d − δ|", "mm"),
    "stress_1": ("Kruskal's stress-1, sqrt(Σ(d − δ)² / Σδ²)", ""),
    "sammon_stress": ("Sammon's stress, (1/Σδ) Σ (d − δ)²/δ", ""),
}
_SCALES = {
    "raw": "the unscaled map",
    "best_scale": "the map at the scale with the smallest mean relative error",
    "interior": "pairs whose shortest path does not bend around the boundary, at the scale with their smallest error",
}
_OTHERS = {
    "interior_share": ("share of the pairs whose shortest path does not bend around the boundary", ""),
    "pearson_r": ("correlation of d and δ", ""),
    "mean_geodesic": ("mean of δ", "mm"),
    "sources": ("number of random reference sources", ""),
    "pairs": ("number of pairs of a source and a point", ""),
}
_AREAS = (
    "share of the surface whose area changes by more than a factor of {}, at the scale that preserves the total area"
)
_TRIANGLES = {
    "areal_median": ("median of |log2(map area / surface area)| over the vertices", ""),
    "areal_p95": ("95th percentile of |log2(map area / surface area)| over the vertices", ""),
    "equal_area_scale": ("factor that gives the map the area of the surface", ""),
    "equal_area_median": ("median of |log2(map area / surface area)| at the scale that preserves the total area", ""),
    "equal_area_p95": (
        "95th percentile of |log2(map area / surface area)| at the scale that preserves the total area",
        "",
    ),
    "edge": ("mean of |length on the map / length on the surface − 1| over the edges, as a fraction", ""),
    "angle": ("mean change of the corner angles, weighted by the areas of the triangles", "degrees"),
    "quasi_conformal": ("median of σ1/σ2, where σ1 ≥ σ2 are the stretches of a triangle; 1 if angles are kept", ""),
    "isometric": ("median of max(σ1, 1/σ2); 1 if lengths are kept", ""),
    "symmetric_dirichlet": ("median of (σ1² + σ2² + σ1⁻² + σ2⁻²)/2; 2 if lengths are kept", ""),
    "flipped": ("number of flipped triangles; 0 in a correct map", ""),
    "flipped_share": ("share of the surface in flipped triangles", ""),
    "collapsed": ("number of triangles without area on the map", ""),
    "crossings": ("number of pairs of boundary edges that cross; 0 in a correct map", ""),
    "covering": ("number of triangles that cover another triangle; 0 in a correct map", ""),
    "area_beyond_1_25": (_AREAS.format("1.25"), ""),
    "area_beyond_1_5": (_AREAS.format("1.5"), ""),
    "area_beyond_2": (_AREAS.format("2"), ""),
}
_VOXELS = {"voxel_size": ("geometric mean of the voxel spacings; n/a for meshes", "mm")}
_MEASURES = {
    **{
        f"{scale}.{name}": (f"{about}, for {kind}", unit)
        for scale, kind in _SCALES.items()
        for name, (about, unit) in _DISTANCES.items()
    },
    **_OTHERS,
    **{f"triangles.{name}": row for name, row in _TRIANGLES.items()},
    **_VOXELS,
    "template.best_scale.relative_error": (
        "mean of |d − δ|/δ over pairs of points on the flat map of --template, at the scale with the smallest mean "
        "relative error, as a fraction",
        "",
    ),
}


def columns_of(records: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, str]]:
    """Return the columns of the table of some records, and the description of each, as BIDS defines it for tables."""
    kinds = dict.fromkeys(map(bands_in, records)) or {(HUMAN, "mm"): None}
    measures = {
        _named(place, *kind): (in_bands(about, *kind) if "relative_error_" in place else about, unit)
        for place, (about, unit) in _MEASURES.items()
        for kind in kinds
    }
    columns = {**_FIRST, **measures}
    return {name: {"Description": about} | ({"Units": unit} if unit else {}) for name, (about, unit) in columns.items()}


def measures_in(record: Mapping[str, Any]) -> dict[str, float | None]:
    """Return the measures of a record, keyed by column."""
    return {_named(place, *bands_in(record)): figure_of(record, place) for place in _MEASURES}


def _named(place: str, bands: Bands, unit: str) -> str:
    """Return a path in ``record["figures"]``, as in `figure_of`, with the bands of a surface."""
    return ".".join(key_in_bands(key, bands, unit) for key in place.split("."))
