"""Make the report on a subject, a self-contained HTML page."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from voxflat._core import __version__
from voxflat.citation.methods_text import cite
from voxflat.lab.freshness import page_key
from voxflat.lab.layouts import HEMISPHERES
from voxflat.lab.pages import PICTURE_WIDTH, colour_bar, filled, layers_of, pictures, scene
from voxflat.lab.results import FIGURES, LoadedResults, figure_of, places_in, title_of
from voxflat.maps.worst_search import worst_places

REFERENCES: dict[str, dict[str, tuple[tuple[float, ...], ...]]] = {
    "standard": {
        "fsaverage5 white surface, standard cuts": (
            (10.69, 12.44, 12.28, 0.1349, 13.71, 0.112, 0.340, 0, 0),
            (9.89, 11.99, 12.05, 0.1235, 13.12, 0.107, 0.349, 0, 0),
        ),
        "FreeSurfer's flat map of fsaverage5": (
            (11.37, 13.69, 16.00, 0.1455, 18.36, 0.269, 0.893, 0, 0),
            (11.09, 14.06, 15.83, 0.1352, 18.18, 0.275, 0.779, 0, 0),
        ),
    },
    "automatic": {
        "fsaverage5 white surface, automatic cuts": (
            (4.87, 7.97, 8.61, 0.0525, 8.95, 0.071, 0.254, 0, 0),
            (5.19, 7.61, 8.25, 0.0593, 9.14, 0.071, 0.275, 0, 0),
        )
    },
}
"""Measures of maps of fsaverage5, left and right, in the order of `FIGURES`, by the source of the cuts."""


def subject_page(name: str, results: Mapping[str, LoadedResults], failures: Mapping[str, str]) -> str:
    """Return the report on a subject as HTML, from the results and the failures of "lh" and "rh"."""
    hemispheres: list[dict[str, Any]] = []
    drawn: dict[str, dict[str, Any]] = {}
    together = layers_of([side.values for side in results.values()])
    pixel_size = max([np.ptp(side.flat_map.uv[:, 0]) / PICTURE_WIDTH for side in results.values()], default=None)
    for (hemi, loaded), layers in zip(results.items(), together, strict=True):
        by_name = {layer.name: layer for layer in layers}
        chosen = [by_name[key] for key in (*loaded.record["overlays"], "distanceerror", "areachange") if key in by_name]
        images = pictures(loaded.flat_map, [None, *chosen], pixel_size)
        for picture, layer in zip(images, [None, *chosen], strict=True):
            key = "" if layer is None else layer.name
            of_layer = drawn.setdefault(key, {"layer": layer, "bar": layer and colour_bar(layer), "sides": []})
            of_layer["sides"].append({**picture, "letter": HEMISPHERES[hemi][0], "side": HEMISPHERES[hemi][1]})
        content: dict[str, Any] = {"hemi": hemi, "side": HEMISPHERES[hemi][1], "record": loaded.record}
        content["overlays"] = loaded.record["overlays"]
        content["layers"] = [{"layer": layer, "bar": colour_bar(layer)} for layer in layers]
        content["scene"], content["cuts"] = scene(loaded.flat_map, layers, loaded.cuts), list(loaded.cuts)
        content["figures"], content["worst"] = _figures(loaded.record, hemi), worst_places(loaded.flat_map)
        content["references"] = list(REFERENCES.get(loaded.record["map"]["cuts_by"], {}))
        hemispheres.append(content)
    return filled(
        "subject.html",
        name=name,
        key=page_key([side.record for side in results.values()], failures),
        hemispheres=hemispheres,
        drawn=list(drawn.values()),
        failures={HEMISPHERES[hemi][1]: reason for hemi, reason in failures.items()},
        citation=cite(*(side.flat_map for side in results.values())),
        version=__version__,
    )


def _figures(record: Mapping[str, Any], hemi: str) -> list[dict[str, Any]]:
    """Return the rows of the table of measures."""
    side = list(HEMISPHERES).index(hemi)
    references = REFERENCES.get(record["map"]["cuts_by"], {})
    rows: list[dict[str, Any]] = []
    for n, place in enumerate(places_in([record])):
        _, factor, unit = FIGURES[place]
        value, error = figure_of(record, place), figure_of(record, f"standard_error.{place}")
        is_count = place.endswith(("flipped", "covering"))
        digits = 0 if is_count else 2 if unit else 3
        texts = {
            "value": "–" if value is None else f"{factor * value:.{digits}f}",
            "error": "" if error is None else f" ± {factor * error:.{digits}f}",
            "others": [f"{of[side][n]:.{digits}f}" if n < len(of[side]) else "–" for of in references.values()],
        }
        rows.append({"title": title_of(place, [record]), "unit": unit, **texts, "is_bad": is_count and bool(value)})
    return rows
