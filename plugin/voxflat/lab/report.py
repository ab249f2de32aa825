"""The report on a subject: one page of HTML that needs no other file and no network."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat._core import __version__
from voxflat.io.files import REMEDY, naming
from voxflat.io.overlays import read_overlay
from voxflat.lab.inputs import HEMISPHERES
from voxflat.lab.pages import colour_bar, filled, layers_of, picture, scene
from voxflat.lab.results import Results, page_key, read_record
from voxflat.lab.subject import MEASURES
from voxflat.maps.flat_map import FlatMap, load

__all__ = ["FIGURES", "REFERENCES", "Shown", "citation", "figure_of", "subject_page"]

FIGURES: dict[str, tuple[str, float, str]] = {
    "best_scale.relative_error": ("Distance error", 100, "%"),
    "best_scale.relative_error_30mm": ("up to 30 mm", 100, "%"),
    "best_scale.relative_error_10mm": ("up to 10 mm", 100, "%"),
    "best_scale.stress_1": ("Stress-1", 1, ""),
    "triangles.edge": ("Edges", 100, "%"),
    "triangles.equal_area_median": ("Area, log2: median", 1, ""),
    "triangles.equal_area_p95": ("95 %", 1, ""),
    "triangles.flipped": ("Triangles turned over", 1, ""),
    "triangles.covering": ("Triangles that cover another", 1, ""),
}
"""Figures of a page: their place in a record, what they are called, a factor, the unit."""

REFERENCES: dict[str, dict[str, tuple[tuple[float, ...], ...]]] = {
    "standard": {
        "fsaverage5, these cuts": (
            (10.78, 12.42, 12.22, 0.1363, 13.59, 0.121, 0.374, 0, 0),
            (9.94, 11.93, 11.86, 0.1247, 13.00, 0.116, 0.384, 0, 0),
        ),
        "FreeSurfer's own map of it": (
            (11.37, 13.69, 16.00, 0.1455, 18.36, 0.269, 0.914, 0, 0),
            (11.09, 14.06, 15.83, 0.1352, 18.18, 0.275, 0.779, 0, 0),
        ),
    },
    "automatic": {
        "fsaverage5, automatic cuts": (
            (4.88, 7.96, 8.58, 0.0528, 8.87, 0.079, 0.283, 0, 0),
            (5.11, 7.69, 8.47, 0.0580, 9.08, 0.078, 0.295, 0, 0),
        ),
    },
}
"""By what said where to cut: maps of fsaverage5, left and right, in the order of `FIGURES`
(docs/benchmarks/standard.md)."""


@dataclass(frozen=True, eq=False)
class Shown:
    """The results of a hemisphere, as they were written.

    Parameters
    ----------
    results : Results
        Where they are.
    record : dict
        What the record says.
    flat_map : FlatMap
        The map.
    values : dict of str to ndarray of float64, shape (N,)
        Measures and overlays at the points of the map.
    """

    results: Results
    record: dict[str, Any]
    flat_map: FlatMap
    values: dict[str, NDArray[np.float64]]

    @classmethod
    def read(cls, results: Results) -> Shown:
        """Read results.

        Parameters
        ----------
        results : Results
            Where they are.

        Returns
        -------
        Shown

        Raises
        ------
        InputError, OSError
            If they are damaged, or not there.
        """
        record, flat_map = read_record(results.record), load(results.map)
        names = [name for name in (*record["overlays"], *MEASURES) if results.values(name).name in record["outputs"]]
        structure = flat_map.metadata.get("structure")
        values = {}
        for name in names:
            path = results.values(name)
            with naming(path, REMEDY):
                count = len(flat_map) if flat_map.is_voxels else flat_map.metadata["vertices"]
                found = read_overlay(path, count, structure=structure).astype(np.float64)
            values[name] = found if flat_map.is_voxels else found[flat_map.ids]
        return cls(results, record, flat_map, values)

    @property
    def cuts(self) -> dict[str, NDArray[np.int64]]:
        """Points of the map along each cut, by its name."""
        metadata = self.flat_map.metadata
        rows = {_key(of): row for row, of in enumerate(self.flat_map.ids.tolist())}
        given = zip(metadata["cut_names"], metadata["cuts"], strict=True)
        named = [(name or f"cut {n}", line) for n, (name, line) in enumerate(given, 1)]
        named += [(f"automatic {n}", cut["ids"]) for n, cut in enumerate(metadata["automatic_cuts"], 1)]
        found = {name: [rows[_key(of)] for of in line if _key(of) in rows] for name, line in named}
        return {name: np.array(points, dtype=np.int64) for name, points in found.items() if len(points) > 1}


def _key(of: Any) -> Any:
    return tuple(of) if isinstance(of, list) else of


def figure_of(record: Mapping[str, Any], place: str) -> float | None:
    """Return a figure of a record by its place, such as ``best_scale.stress_1``; None where it is undefined."""
    value: Any = record["figures"]
    for key in place.split("."):
        value = None if value is None else value.get(key)
    return None if value is None else float(value)


def subject_page(name: str, shown: Mapping[str, Shown], failures: Mapping[str, str]) -> str:
    """Return the report on a subject.

    Parameters
    ----------
    name : str
        The subject's.
    shown : dict of str to Shown
        By hemisphere, "lh" and "rh".
    failures : dict of str to str
        Why a hemisphere has no map.

    Returns
    -------
    str
        HTML.
    """
    hemispheres = []
    together = layers_of([one.values for one in shown.values()])
    for (hemi, one), layers in zip(shown.items(), together, strict=True):
        by_name = {layer.name: layer for layer in layers}
        chosen = [by_name[key] for key in (*one.record["overlays"], "distanceerror", "areachange") if key in by_name]
        pictures = [{**picture(one.flat_map, layer), "layer": layer, "bar": colour_bar(layer)} for layer in chosen]
        hemispheres.append(
            {
                "hemi": hemi,
                "side": HEMISPHERES[hemi][1],
                "record": one.record,
                "folds": picture(one.flat_map),
                "pictures": pictures,
                "layers": [{"layer": layer, "bar": colour_bar(layer)} for layer in layers],
                "scene": scene(one.flat_map, layers, one.cuts),
                "cuts": list(one.cuts),
                "figures": _figures(one.record, hemi),
                "references": list(REFERENCES.get(one.record["map"]["cuts_by"], {})),
            }
        )
    return filled(
        "subject.html",
        name=name,
        key=page_key([one.record for one in shown.values()], failures),
        hemispheres=hemispheres,
        failures={HEMISPHERES[hemi][1]: reason for hemi, reason in failures.items()},
        citation=citation([one.record for one in shown.values()]),
        version=__version__,
    )


def _figures(record: Mapping[str, Any], hemi: str) -> list[dict[str, Any]]:
    """Return the rows of the table of figures."""
    side = list(HEMISPHERES).index(hemi)
    references = REFERENCES.get(record["map"]["cuts_by"], {})
    rows = []
    for n, (place, (title, factor, unit)) in enumerate(FIGURES.items()):
        value, error = figure_of(record, place), figure_of(record, f"standard_error.{place}")
        shown = None if value is None else factor * value
        others = [of[side][n] for of in references.values()]
        digits = 0 if place.endswith(("flipped", "covering")) else 2 if unit else 3
        rows.append(
            {
                "title": title,
                "unit": unit,
                "value": "–" if shown is None else f"{shown:.{digits}f}",
                "error": "" if error is None else f" ± {factor * error:.{digits}f}",
                "others": [f"{other:.{digits}f}" for other in others],
                "is_bad": place.endswith(("flipped", "covering")) and bool(value),
                "is_part": title[0].islower() or title[0].isdigit(),
            }
        )
    return rows


def citation(records: Sequence[Mapping[str, Any]]) -> str:
    """Return a paragraph on what was done, for a methods section."""
    if not records:
        return ""
    record = records[0]
    told, of_surface = record["parameters"], record["surface"]
    by = record["map"]["cuts_by"]
    cuts = {
        "standard": f"along standard lines ({', '.join(record['map']['cut_names'])}) traced by the registered sphere",
        "automatic": "where that relieved the map most",
    }.get(by, f"as {by} says")
    on = "the surface of white matter in voxels" if told["volume"] else f"the {told['geometry']} surface"
    figures = record["figures"]
    return (
        f"Cortical hemispheres were flattened with voxflat {record['voxflat']}, which keeps geodesic distances over "
        f"{on} ({of_surface['vertices']:,} vertices). Surfaces were cut {cuts}. Maps were judged by the distances from "
        f"{figures['sources']} random sources ({figures['reference']}): relative errors are means of |d − δ|/δ over "
        "all pairs, d on the map and δ on the cut surface."
    )
