"""What tells how good a flat map is, in words."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from voxflat._distortion import Triangles
from voxflat.flatmap import FlatMap

Row: TypeAlias = tuple[str, str]
"""A figure's name and its value."""


def figures(flat_map: FlatMap) -> list[Row]:
    """Return what tells how good a flat map is.

    Parameters
    ----------
    flat_map : FlatMap
        The map.

    Returns
    -------
    list of Row
    """
    raw, triangles = flat_map.distortion.raw, flat_map.distortion.triangles
    width, height = np.ptp(flat_map.uv, axis=0)
    return [
        ("relative error", f"{100 * raw.relative_error:.1f} %"),
        ("   pairs up to 10 mm", f"{100 * raw.relative_error_10mm:.1f} %"),
        ("   pairs up to 30 mm", f"{100 * raw.relative_error_30mm:.1f} %"),
        ("absolute error", f"{raw.absolute_error:.2f} mm"),
        ("stress-1", f"{raw.stress_1:.4f}"),
        ("correlation", f"{flat_map.distortion.pearson_r:.4f}"),
        *([] if triangles is None else _of_triangles(triangles)),
        ("map", f"{width:.0f} × {height:.0f} mm"),
        *_of_topology(flat_map),
    ]


def _of_triangles(triangles: Triangles) -> list[Row]:
    return [
        ("areas, median factor", f"{2**triangles.areal_median:.2f}"),
        ("edges", f"{100 * triangles.edge:.1f} %"),
        ("angles", f"{triangles.angle:.1f}°"),
        ("flipped triangles", f"{triangles.flipped} ({100 * triangles.flipped_share:.2g} % of the area)"),
        ("triangles that cover others", f"{triangles.covering}"),
    ]


def _of_topology(flat_map: FlatMap) -> list[Row]:
    """Return how the surface was opened, or where a map over the 26-neighbour graph is torn."""
    rows = []
    if cuts := flat_map.metadata.get("automatic_cuts"):
        rows.append(("automatic cuts", f"{len(cuts)}, {sum(cut['length'] for cut in cuts):.0f} mm"))
    if "torn_faces" in flat_map.metadata:
        rows.append(("torn faces", f"{100 * flat_map.metadata['torn_faces']:.1f} %"))
    if "topology" in flat_map.metadata:
        rows.append(("Euler characteristic (disk: 1)", f"{flat_map.metadata['topology']['euler_characteristic']}"))
    return rows


def warnings(flat_map: FlatMap) -> list[str]:
    """Return what the user should know of a map, as sentences.

    Parameters
    ----------
    flat_map : FlatMap
        The map.

    Returns
    -------
    list of str
    """
    return [f"{warning[:1].upper()}{warning[1:]}." for warning in flat_map.metadata["warnings"]]
