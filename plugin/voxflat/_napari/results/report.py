"""The measures of a flat map or an atlas, and its warnings, as text."""

from html import escape
from typing import TypeAlias

import numpy as np

from voxflat._napari.layers.world import ASSUMED_UNIT
from voxflat._napari.results.flat_layers import FlatLayers, in_unit_of, unit_of_map
from voxflat._napari.wording import in_window, sentence
from voxflat.atlases.atlas import Atlas
from voxflat.atlases.certified import FlatAtlas
from voxflat.atlases.glued import GluedAtlas
from voxflat.distortion.bands import in_bands
from voxflat.distortion.figures import TriangleFigures
from voxflat.io.grid import rounded
from voxflat.maps.flat_map import FlatMap

Row: TypeAlias = tuple[str, str]  # the name of a measure, and its value

INTERIOR = "distance error of interior pairs"
MEANINGS = {
    INTERIOR: "The mean relative error of pairs whose shortest path does not bend around the boundary",
    "mean relative distance error": "Mean of |distance on the map − distance on the surface| / distance on the surface",
    "stress-1": "Kruskal's stress, which is 0 for a map that preserves all distances",
    "correlation": "Correlation between distances on the map and distances on the surface (at best 1)",
    "median area change (factor)": "The areas of half of the vertices grow or shrink by less than this factor",
}  # explanations of the measures


def summary(flat_map: FlatMap | Atlas) -> str:
    if isinstance(flat_map, GluedAtlas):
        return flat_map.title
    if isinstance(flat_map, FlatAtlas):
        return f"{len(flat_map):,} patches of {len(flat_map.faces):,} triangles, C ≤ {flat_map.certificate.c:.4f}"
    assert isinstance(flat_map, FlatMap)
    return f"{len(flat_map):,} points, mean distance error {flat_map.distortion._summary()}"


def table(flat_map: FlatMap | Atlas) -> str:
    return flat_map.distortion.table() if isinstance(flat_map, FlatMap) else flat_map.table()


def figures(flat_map: FlatMap | Atlas) -> list[Row]:
    """Return the most important measures of a flat map or an atlas, with lengths in its unit, if any."""
    return [(name, in_unit_of(flat_map, value)) for name, value in _in_mm(flat_map)]


def _in_mm(flat_map: FlatMap | Atlas) -> list[Row]:
    if isinstance(flat_map, GluedAtlas):
        return _of_glued(flat_map)
    if isinstance(flat_map, FlatAtlas):
        return _of_atlas(flat_map)
    assert isinstance(flat_map, FlatMap)
    distortion, raw, triangles = flat_map.distortion, flat_map.distortion.raw, flat_map.distortion.triangles
    interior = distortion.interior
    width, height = np.ptp(flat_map.uv, axis=0)
    return [
        *([] if interior is None else [(INTERIOR, f"{100 * interior.relative_error:.1f} %")]),
        ("mean relative distance error", f"{100 * raw.relative_error:.1f} %"),
        (_within("10 mm", flat_map), f"{100 * raw.relative_error_10mm:.1f} %"),
        (_within("30 mm", flat_map), f"{100 * raw.relative_error_30mm:.1f} %"),
        ("mean absolute distance error", f"{rounded(raw.absolute_error, 2)} mm"),
        ("stress-1", f"{raw.stress_1:.4f}"),
        ("correlation", f"{flat_map.distortion.pearson_r:.4f}"),
        *([] if triangles is None else _of_triangles(triangles)),
        ("size of the map", f"{rounded(width)} × {rounded(height)} mm"),
        *_of_topology(flat_map),
    ]


def _within(end: str, flat_map: FlatMap) -> str:
    return in_bands(f"   within {end}", flat_map.distortion.bands, flat_map.origin.named_unit or "unknown")


def _of_atlas(atlas: FlatAtlas) -> list[Row]:
    found, certified = atlas._figures(), atlas.certificate
    measured = found["measured"]
    return [
        ("patches", f"{len(atlas):,}"),
        ("   that cover half of the area", f"{found['half_of_the_area']:,}"),
        ("   of a single triangle", f"{found['single_triangles']:,}"),
        ("certified: inclination", f"≤ {certified.angle:.2f}°"),
        ("   C, lengths", f"≤ {certified.c:.4f}"),
        ("   K, angles", f"≤ {certified.k:.4f}"),
        ("measured: inclination", f"{measured['angle']:.2f}°"),
        ("   C, lengths", f"{measured['c']:.4f}"),
        ("   K, angles", f"{measured['k']:.4f}"),
        _page(atlas),
    ]


def _of_glued(atlas: GluedAtlas) -> list[Row]:
    found, seams = atlas._figures(), atlas.seams
    measured = found["measured"]
    return [
        ("patches", f"{found['patches']:,}"),
        ("glued pieces", f"{len(atlas):,}"),
        ("   area of the largest piece", f"{100 * found['largest_area_share']:.1f} %"),
        ("seams closed", f"{100 * seams.closed_share:.1f} %"),
        ("   still open", f"{rounded(seams.cuts)} mm"),
        ("C, lengths: bound", f"≤ {atlas.bound:g}"),
        ("   largest", f"{measured['c']:.4f}"),
        ("   mean", f"{measured['mean_c']:.4f}"),
        ("K, angles: largest", f"{measured['k']:.4f}"),
        _page(atlas),
    ]


def _page(atlas: FlatAtlas | GluedAtlas) -> Row:
    width, height = atlas.layout().max(axis=0)
    return "page", f"{rounded(width)} × {rounded(height)} mm"


def _of_triangles(triangles: TriangleFigures) -> list[Row]:
    return [
        ("median area change (factor)", f"{2**triangles.areal_median:.2f}"),
        ("mean change of edge lengths", f"{100 * triangles.edge:.1f} %"),
        ("mean change of angles", f"{triangles.angle:.1f}°"),
        ("flipped triangles", f"{triangles.flipped} ({100 * triangles.flipped_share:.2g} % of the area)"),
        ("overlapping triangles", f"{triangles.covering}"),
    ]


def _of_topology(flat_map: FlatMap) -> list[Row]:
    """Return the automatic cuts, the torn part of a map of the 26-neighbour graph, and the Euler characteristic."""
    rows = []
    if cuts := [cut for cut in flat_map.cuts if cut.is_automatic]:
        rows.append(("automatic cuts", f"{len(cuts)}, {rounded(sum(cut.length or 0.0 for cut in cuts))} mm"))
    if flat_map.distortion.triangles is None:
        rows.append(("torn faces", f"{100 * flat_map.torn.mean():.1f} %"))
    if isinstance(topology := flat_map.details.get("topology"), dict):
        rows.append(("Euler characteristic (disk: 1)", f"{topology['euler_characteristic']}"))
    return rows


def warnings(layers: FlatLayers) -> list[str]:
    """Return the warnings about a map or an atlas, and about frames of a movie."""
    of_frames = [] if layers.movie is None else [*layers.movie.series.warnings]
    found = [*of_frames, *layers.flat_map.warnings, *layers.warnings]
    if layers.flat_map.origin.in_pixels:
        found.append(ASSUMED_UNIT.format(unit_of_map(layers.flat_map)))
    return [sentence(in_window(warning)) for warning in dict.fromkeys(found)]


def as_html(found: list[str]) -> str:
    """Return warnings as rich text."""
    return "".join(f"<p>⚠ {escape(warning)}</p>" for warning in found)
