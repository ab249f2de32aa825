"""Details of how a map was made that several figures, reports and citations tell."""

from dataclasses import dataclass
from typing import Any

from voxflat.maps.flat_map import FlatMap
from voxflat.surfaces.standard.sphere import OWN_REGISTRATION


@dataclass(frozen=True)
class Summary:
    """Details of how a map was made."""

    points: int  # the two sides of a cut count once
    chart: str | None  # the name of one of several charts
    space: str | None  # of the registered sphere
    side: str | None
    is_by_folds: bool  # whether voxflat registered the sphere


def summary_of(flat_map: FlatMap) -> Summary:
    """Return details of how a map was made; old files lack some of them."""
    details: dict[str, Any] = flat_map.details
    chart, sphere = details.get("chart", {}), details.get("sphere") or {}
    name = None if chart.get("count", 1) == 1 else str(chart["name"])
    by_folds = sphere.get("input") == OWN_REGISTRATION
    return Summary(details.get("points", len(flat_map)), name, sphere.get("space"), sphere.get("side"), by_folds)
