"""Make the HTML page of a study: a table, outliers, all maps at the same scale, and means."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from voxflat._core import __version__
from voxflat.citation.methods_text import citation_of, facts_of
from voxflat.figures.overlays import painted
from voxflat.lab.comparison import Mean, Row, counted
from voxflat.lab.pages import Layer, colour_bar, filled, layers_of, pictures, png
from voxflat.lab.results import COUNTS, FIGURES, figure_of, places_in, title_of
from voxflat.maps.flat_map import FlatMap

_SHOWN = 0.9  # pixels of the page per mm of a map
_AT_FULL = 60  # up to this number of maps, 1 pixel is 1 mm; larger studies get larger pixels to keep the page small
_DOTS = (240.0, 26.0)  # pixels of a row of dots
_RANKED_BY = "best_scale.relative_error"  # the table begins with the map in which this measure is largest


def study_page(
    rows: Sequence[Row],
    means: Sequence[Mean],
    maps: Sequence[Mapping[str, Any]],
    key: str,
    by_chance: float,
    warnings: Sequence[str],
) -> str:
    """Return the page of a study as HTML, with a table, maps, means, and links to the reports on subjects."""
    there = [row for row in rows if row.record is not None]
    missing = [row for row in rows if row.record is None]
    records = [row.record for row in rows if row.record is not None]
    ranked = sorted(there, key=lambda row: figure_of(row.record or {}, _RANKED_BY) or 0.0, reverse=True)
    places = places_in(records)
    table = [{"row": row, "cells": [_cell(row, place) for place in places]} for row in ranked]
    table += [{"row": row, "cells": []} for row in missing]
    return filled(
        "study.html",
        key=key,
        version=__version__,
        table=table,
        titles=[(title_of(place, records), FIGURES[place][2]) for place in places],
        missing=missing,
        pictures=[[entry for entry in maps if entry["row"].letter == letter] for letter in ("L", "R")],
        means=[_mean(mean) for mean in means],
        dots=[_dots(there, place) for place in places],
        warnings=warnings,
        marked=sum(len(row.outliers.keys() - set(COUNTS)) for row in there),
        by_chance=f"{by_chance:.2g}",
        citation=citation_of([entry["facts"] for entry in maps]),
        counted=counted(rows),
    )


def map_picture(row: Row, flat_map: FlatMap, count: int) -> dict[str, Any]:
    """Return an image of the folds of a map at the scale for a page of `count` maps, and facts for the methods text."""
    (drawn,) = pictures(flat_map, [None], pixel_size=max(1.0, float(np.sqrt(count / _AT_FULL))))
    return {**drawn, "row": row, "shown": round(_SHOWN * drawn["mm"]), "facts": facts_of(flat_map)}


def _cell(row: Row, place: str) -> dict[str, Any]:
    _, factor, unit = FIGURES[place]
    value, error = (figure_of(row.record or {}, name) for name in (place, f"standard_error.{place}"))
    digits = 0 if place.endswith(("flipped", "covering")) else 1 if unit else 3
    text, after = ("–" if number is None else f"{factor * number:.{digits}f}" for number in (value, error))
    interval = "" if error is None else f" ± {after}"
    return {"text": text, "error": interval, "outlier": row.outliers.get(place, ""), "is_count": place in COUNTS}


def _mean(mean: Mean) -> dict[str, Any]:
    """Return the mean, the standard deviation and the number of maps of a measure as images."""
    look = layers_of([{mean.name: mean.mean.data[np.isfinite(mean.mean.data)]}])[0][0]
    spread = mean.deviation.data[np.isfinite(mean.deviation.data)]
    high = float(np.percentile(spread, 99)) if len(spread) else 1.0
    of_deviation = Layer(mean.name, look.title, look.unit, spread, "viridis", (0.0, high or 1.0))
    images = []
    for statistic, image, layer in (("mean", mean.mean, look), ("standard deviation", mean.deviation, of_deviation)):
        pixels = painted(image.data, layer.colour_map, layer.limits)
        pixels[..., 3] = 255 * np.isfinite(image.data)
        drawn = png(pixels, image.data.shape[1] * image.pixel_size)
        images.append({**drawn, "bar": colour_bar(layer), "what": statistic})
    side = {"L": "left", "R": "right"}[mean.letter]
    return {"title": look.title, "side": side, "most": int(mean.count.data.max()), "images": images}


def _dots(rows: Sequence[Row], place: str) -> dict[str, Any]:
    """Return a dot plot of a measure over hemispheres."""
    _, factor, unit = FIGURES[place]
    title = title_of(place, [row.record for row in rows if row.record is not None])
    width, height = _DOTS
    pairs = [(row, figure_of(row.record or {}, place)) for row in rows]
    values = [factor * value for _, value in pairs if value is not None]
    low, high = (min(values), max(values)) if values else (0.0, 0.0)
    span = high - low or 1.0
    dots = [
        {
            "x": round(6 + (width - 12) * (factor * value - low) / span, 1),
            "y": round(height * (0.3 if row.letter == "L" else 0.7), 1),
            "is_outlier": place in row.outliers,
            "text": f"{row.hemisphere}: {factor * value:.4g} {unit} {row.outliers.get(place, '')}".rstrip(),
        }
        for row, value in pairs
        if value is not None
    ]
    median = f"{np.median(values):.3g}" if values else "–"
    return {"title": title, "unit": unit, "low": f"{low:.3g}", "median": median, "high": f"{high:.3g}", "dots": dots}
