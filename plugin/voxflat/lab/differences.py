"""Find reasons to check a group: maps that were made in different ways, which cannot be averaged, and warnings."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any

from voxflat.lab.comparison import Row
from voxflat.lab.freshness import worded
from voxflat.lab.inputs import overlay_name
from voxflat.lab.layouts import HEMISPHERES

_LISTED = 5  # most hemispheres that a sentence lists
_SURFACES = ("white", "pial", "volume")  # inputs that differ between persons
_SIDES = dict(HEMISPHERES.values())  # left and right, by letter


def warnings_about(rows: Sequence[Row], again: str) -> list[str]:
    """Return the warnings about the maps of a group; `again` is the command that makes them."""
    rows = [row for row in rows if row.record is not None]
    letters = {row.letter for row in rows}
    warnings = []
    if different := differences(rows):
        places = _places(rows, differences)
        so = f", so {_clause(places, letters, ', and may be outliers')}" if places else " between left and right"
        details = ". ".join(clause[0].upper() + clause[1:] for clause in different.values())
        remedy = f"Run {again} for all participants, with the same kinds of input and the same options"
        warnings.append(f"the maps of this group differ{so}. {details}. {remedy}")
    if changed := [f"{row.hemisphere} ({', '.join(row.changed)})" for row in rows if row.changed]:
        so = _clause(_places(rows, _changed), letters)
        details = f"inputs changed after these maps were made, so {so}: {', '.join(changed)}"
        warnings.append(f"{details}. Run {again} with the same options as before")
    warnings += _repeated(rows)
    of_text: dict[str, list[str]] = {}
    overlays = {letter: _overlays(row for row in rows if row.letter == letter) for letter in letters}
    for row in rows:
        lacking = [name for name in overlays[row.letter] if name not in _overlays([row])]
        lacks = [f"the overlay {name}, which other maps have, is missing" for name in lacking]
        for text in (*(row.record or {})["warnings"], *lacks):
            of_text.setdefault(text, []).append(row.hemisphere)
    return warnings + [f"{listed(names)}: {text}" for text, names in of_text.items()]


def _repeated(rows: Sequence[Row]) -> list[str]:
    """Return warnings about participants with identical surfaces or volumes, who are probably the same person."""
    by_files: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        files = (row.record or {})["inputs"]
        digest = next(files[name]["sha256"] for name in _SURFACES if name in files)
        by_files.setdefault((row.letter, digest), []).append(row.name + row.session)
    same = dict.fromkeys(tuple(names) for names in by_files.values() if len(names) > 1)
    claim = "have identical input files, so the same data are counted {} times. Correct the files, or remove the copies"
    return [f"{listed(names)} {claim.format(len(names))}" for names in same]


def not_averaged(rows: Sequence[Row]) -> set[tuple[str, str]]:
    """Return the sides, L or R, and overlays ("" for all values) whose maps differ or are outdated."""
    return _places(rows, differences) | _places(rows, _changed)


def _overlays(rows: Iterable[Row]) -> list[str]:
    """Return the names of all overlays of maps."""
    return list(dict.fromkeys(name for row in rows if row.record is not None for name in row.record["overlays"]))


def _places(rows: Sequence[Row], find: Callable[[Sequence[Row]], Iterable[str]]) -> set[tuple[str, str]]:
    """Return the sides and overlays of the faults that a function finds among the maps of one side."""
    sides = {letter: [row for row in rows if row.letter == letter] for letter in _SIDES}
    return {(letter, name if name.isalnum() else "") for letter, members in sides.items() for name in find(members)}


def _changed(rows: Sequence[Row]) -> Iterable[str]:
    """Return the changed overlays by name, and "" for other changed inputs."""
    names = (name.partition("overlay ") for row in rows for name in row.changed)
    return (name if not before else "" for before, _, name in names)


def _clause(places: set[tuple[str, str]], letters: Collection[str], more: str = "") -> str:
    """Return a clause about values that are not averaged, in a group with the sides `letters`."""
    whole = sorted(letter for letter, name in places if not name)
    who = "they" if set(whole) == letters else f"the {' and '.join(_SIDES[letter] for letter in whole)} maps"
    clauses = [f"{who} are not averaged{more}"] if whole else []
    names = sorted((name, _SIDES[letter]) for letter, name in places if name and letter not in whole)
    return ", and ".join(clauses + [f"{name} of the {side} maps is not averaged" for name, side in names])


def differences(rows: Sequence[Row]) -> dict[str, str]:
    """Return a clause for each parameter that differs among the maps, keyed by its option, or by the overlay's name."""
    settings = {row.hemisphere: _settings(row.record) for row in rows if row.record is not None}
    clauses: dict[str, str] = {}
    for option in dict.fromkeys(key for values in settings.values() for key in values):
        by_value: dict[str, list[str]] = {}
        for hemisphere, values in settings.items():
            if option in values:
                by_value.setdefault(values[option], []).append(hemisphere)
        if len(by_value) > 1:
            most, *others = sorted(by_value.items(), key=lambda item: -len(item[1]))
            rest = "; ".join(f"{value} for {listed(names)}" for value, names in others)
            name = f"the overlay {option}" if option.isalnum() else option
            clauses[option] = f"{name} is {rest}; {most[0]} for {_others(len(most[1]))}"
    return clauses


def _others(count: int) -> str:
    return f"the other {count} hemispheres" if count > 1 else "the other hemisphere"


def listed(hemispheres: Sequence[str]) -> str:
    """Return the first hemispheres or participants of a list, and the number of the others."""
    more = len(hemispheres) - _LISTED
    return ", ".join(hemispheres[:_LISTED]) + (f" and {more} more" if more > 0 else "")


def _settings(record: Mapping[str, Any]) -> dict[str, str]:
    """Return everything that must be the same for all maps; overlays are keyed by name."""
    parameters, inputs = record["parameters"], record["inputs"]
    settings = {f"--{key}": worded(parameters[key]) for key in ("cuts", "geometry", "volume", "seed")}
    settings["the version of voxflat"] = record["voxflat"]
    settings["the definition of the cortex"] = record["surface"]["cortex"]
    if parameters["geometry"] == "midthickness":
        settings["the surface of the distances"] = record["surface"]["measured_on"]
    if record["map"]["frame"] == "standard":
        settings["the registration"] = record["map"]["registration"]
    if "cuts" in inputs:
        settings[f"the content of {inputs['cuts']['path']}"] = f"SHA-256 {inputs['cuts']['sha256'][:12]}"
    for name in ("template", "template sphere"):
        settings[f"the {name}"] = f"SHA-256 {inputs[name]['sha256'][:12]}" if name in inputs else "none"
    texts = {overlay_name(text): text for text in parameters["overlays"]}
    return settings | {name: texts.get(name, name) for name in record["overlays"]}
