"""Find out whether the maps of a group were made in the same way; if not, they cannot be averaged."""

from collections.abc import Mapping, Sequence
from typing import Any

from voxflat.lab.comparison import Row
from voxflat.lab.freshness import worded
from voxflat.lab.inputs import overlay_name

_LISTED = 5  # most hemispheres that a sentence lists


def differences(rows: Sequence[Row]) -> dict[str, str]:
    """Return a clause for each parameter that differs among the maps, keyed by its option, or by the overlay's name."""
    made = {row.hemisphere: _how(row.record) for row in rows if row.record is not None}
    found: dict[str, str] = {}
    for what in dict.fromkeys(key for how in made.values() for key in how):
        by_value: dict[str, list[str]] = {}
        for hemisphere, how in made.items():
            if what in how:
                by_value.setdefault(how[what], []).append(hemisphere)
        if len(by_value) > 1:
            most, *others = sorted(by_value.items(), key=lambda one: -len(one[1]))
            rest = "; ".join(f"{value} for {listed(of)}" for value, of in others)
            name = f"the overlay {what}" if what.isalnum() else what
            found[what] = f"{name} is {rest}; {most[0]} for {_others(len(most[1]))}"
    return found


def _others(count: int) -> str:
    return f"the other {count} hemispheres" if count > 1 else "the other hemisphere"


def listed(hemispheres: Sequence[str]) -> str:
    """Return the first hemispheres or participants of a list, and the number of the others."""
    more = len(hemispheres) - _LISTED
    return ", ".join(hemispheres[:_LISTED]) + (f" and {more} more" if more > 0 else "")


def _how(record: Mapping[str, Any]) -> dict[str, str]:
    """Return everything that must be the same for all maps; overlays are keyed by name."""
    parameters, inputs = record["parameters"], record["inputs"]
    how = {f"--{key}": worded(parameters[key]) for key in ("cuts", "geometry", "volume", "seed")}
    how["the version of voxflat"] = record["voxflat"]
    if "cuts" in inputs:
        how[f"the content of {inputs['cuts']['path']}"] = f"SHA-256 {inputs['cuts']['sha256'][:12]}"
    given = {overlay_name(text): text for text in parameters["overlays"]}
    return how | {name: given.get(name, name) for name in record["overlays"]}
