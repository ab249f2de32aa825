"""What napari keeps with a map: the flattened layer, the settings of the form, and the drawings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from voxflat.atlases.atlas import Atlas
from voxflat.maps.flat_map import FlatMap

_Made = TypeVar("_Made", bound=FlatMap | Atlas)


@dataclass(frozen=True)
class Session:
    """What napari keeps with a map or an atlas, in its metadata and its file."""

    layer: str = ""
    world_axes: str = "RAS"
    unit: str = "millimeter"  # as in napari; "pixel, taken as mm" if the layer has no unit
    form: Mapping[str, Any] | None = None
    time: Mapping[str, Any] | None = None  # the record of the `TimeAxis` of a movie
    drawn: Mapping[str, Any] = field(default_factory=dict)  # regions, marks and cuts

    @classmethod
    def made_from(cls, origin: Mapping[str, str], form: Mapping[str, Any] | None = None, **time: Any) -> Session:
        """Return the session of a layer, given its name, world axes and unit."""
        return cls(origin["layer"], origin["world_axes"], origin["unit"], form, **time)

    @classmethod
    def of(cls, made: FlatMap | Atlas) -> Session | None:
        """Return the session of a map; None if it was not made or opened in napari."""
        told = made.details.get("napari")
        if not isinstance(told, dict):
            return None
        own = {name: told[name] for name in ("layer", "world_axes", "unit", "form", "time") if name in told}
        return cls(**own, drawn={name: value for name, value in told.items() if name not in own})

    def put(self, made: _Made) -> _Made:
        """Return a map with this session."""
        known = {name: value for name, value in (("form", self.form), ("time", self.time)) if value is not None}
        told = {"layer": self.layer, "world_axes": self.world_axes, "unit": self.unit, **known, **self.drawn}
        origin = replace(made.origin, in_pixels=self.unit.startswith("pixel"))
        return made._with(origin=origin, details={**made.details, "napari": told})  # type: ignore[return-value]


def session_of(made: FlatMap | Atlas) -> Session:
    """Return the session of a map, or the usual one."""
    return Session.of(made) or Session()
