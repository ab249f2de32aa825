"""Check the values of the keys that describe a map, an atlas or a store of distances in its file."""

import re
from collections.abc import Callable, Mapping
from typing import Any

from voxflat.arguments import is_number, is_whole, shown
from voxflat.errors import InputError
from voxflat.io.files import AGAIN
from voxflat.io.grid import UNITS

_Kind = tuple[Callable[[Any], bool], str]  # whether a value is of the kind, and the kind in words


def _null_or(kind: _Kind) -> _Kind:
    return lambda value: value is None or kind[0](value), f"{kind[1]} or null"


def _all(kind: _Kind, words: str) -> _Kind:
    return lambda value: isinstance(value, list) and all(map(kind[0], value)), words


def _object(kind: _Kind, words: str) -> _Kind:
    return lambda value: isinstance(value, dict) and all(map(kind[0], value.values())), words


def _one_of(*words: str) -> _Kind:
    return lambda value: isinstance(value, str) and value in words, " or ".join(map(repr, words))


def _matching(pattern: str, words: str) -> _Kind:
    return lambda value: isinstance(value, str) and bool(re.fullmatch(pattern, value)), words


_TEXT: _Kind = (lambda value: isinstance(value, str), "a text")
_FLAG: _Kind = (lambda value: isinstance(value, bool), "true or false")
_OBJECT: _Kind = (lambda value: isinstance(value, dict), "an object")
_LIST: _Kind = (lambda value: isinstance(value, list), "a list")
_COUNT: _Kind = (lambda value: is_whole(value) and value >= 0, "a whole number of at least 0")
_NUMBER: _Kind = (is_number, "a number")
_SIZE: _Kind = (lambda value: is_number(value) and value >= 0, "a number of at least 0")
_LENGTH: _Kind = (lambda value: is_number(value) and value > 0, "a positive number")
_SHARE: _Kind = (lambda value: is_number(value) and 0 <= value <= 1, "a number from 0 to 1")
_UNIT: _Kind = (lambda value: value in (*UNITS, "unknown") and isinstance(value, str), "a unit of length or 'unknown'")
_LABEL: _Kind = (
    lambda value: is_whole(value) or _all((is_whole, ""), "")[0](value),
    "a whole number or a list of them",
)
_ID: _Kind = (
    lambda value: _COUNT[0](value) or (_all(_COUNT, "")[0](value) and len(value) == 3),
    "a vertex number or three voxel indices",
)
_FACTOR: _Kind = (lambda value: is_number(value) and value >= 1, "a number of at least 1")
_SHA256: _Kind = _matching("[0-9a-f]{64}", "64 hexadecimal digits")
_NUMBERS: _Kind = _object(_null_or(_NUMBER), "an object with numbers")

_OF_SURFACE: dict[str, _Kind] = {
    **dict.fromkeys(("input", "structure", "measured_on", "cuts_by", "store"), _null_or(_TEXT)),
    **dict.fromkeys(("method", "sampling", "geodesic", "placed_by"), _TEXT),
    **dict.fromkeys(("sources", "points", "surface_points", "frame_points", "memory_need_bytes", "patches"), _COUNT),
    **dict.fromkeys(("split_vertices", "conflicts", "components", "pairs"), _COUNT),
    **dict.fromkeys(("sketch_error", "frame_residual", "area_change", "torn_faces"), _null_or(_SIZE)),
    **dict.fromkeys(("keep", "drop", "start"), _FLAG),
    **dict.fromkeys(("seed_point", "seed_found"), _null_or(_ID)),
    **dict.fromkeys(("seams", "before", "measured", "smoothed"), _NUMBERS),
    **dict.fromkeys(("foreground", "series_frame"), _null_or(_COUNT)),
    **dict.fromkeys(("sphere", "range_image"), _null_or(_OBJECT)),
    **dict.fromkeys(("mended", "repair", "chart", "napari", "descent", "series", "glue"), _OBJECT),
    **dict.fromkeys(("threshold", "planarity"), _null_or(_NUMBER)),
    **dict.fromkeys(("weighting", "distance_error"), _null_or(_SIZE)),
    "warnings": _all(_TEXT, "a list of texts"),
    "seed": (lambda value: is_whole(value) and 0 <= value < 2**64, "a whole number from 0 to 2**64 - 1"),
    "unit": _UNIT,
    "label": _null_or(_LABEL),
    "sheet": _null_or(_FLAG),
    "mirrored": _FLAG,
    "frame": _null_or(_one_of("standard", "axis")),
    "period": _null_or(_LENGTH),
    "scale": _one_of("distances", "areas"),
    "axes": _one_of("unknown"),
    "input_sha256": _matching("([0-9a-f]{64})?", "64 hexadecimal digits"),
    "link_lengths": _null_or(_one_of("chain-code", "euclidean")),
    "radius": _null_or(_LENGTH),
    "polygon": _null_or(_all(_ID, "a list of vertex numbers or of voxel indices")),
    "touching_labels": _all((is_whole, ""), "a list of whole numbers"),
    "largest_components": _all(_COUNT, "a list of whole numbers of at least 0"),
    "handles_cut": _all(_all(_ID, ""), "a list of lists of vertex numbers or of voxel indices"),
    "starts": _all(_null_or(_NUMBER), "a list of numbers"),
    "max_area": _FACTOR,
    "bound": _FACTOR,
    "limit": _object(_NUMBER, "an object with numbers"),
    "neighbourhood": (lambda value: _COUNT[0](value) or value == "all", "a whole number of at least 0 or 'all'"),
    "seeds": (lambda value: _TEXT[0](value) or _LIST[0](value) or _COUNT[0](value), "a text, a list or a whole number"),
    "topology": _object((lambda value: is_whole(value) or _FLAG[0](value), ""), "an object with whole numbers"),
    "cuts": _null_or(_all(_LIST, "a list of lists")),
    "cut_names": _null_or(_all(_null_or(_TEXT), "a list of texts")),
    "people": _all(_OBJECT, "a list of objects"),
    "automatic_cuts": _null_or(_all(_OBJECT, "a list of objects")),
    "versions": _object(_TEXT, "an object with texts"),
    "provenance": _OBJECT,
}
_OF_CUT: dict[str, _Kind] = {"ids": _LIST, "length": _null_or(_SIZE), "reason": _TEXT}
_OF_SPACE: dict[str, _Kind] = {
    "name": _one_of("scanner", "tkRAS", "unknown"),
    "volume": _null_or(_OBJECT),
    "doubt": _TEXT,
}
_COUNTED = {"components", "euler", "handles", "loops"}
_COUNTS = ", ".join(sorted(_COUNTED))
_OF_DISTORTION: dict[str, _Kind] = {
    **dict.fromkeys(("raw", "best_scale", "standard_error"), _OBJECT),
    **dict.fromkeys(("interior", "triangles"), _null_or(_OBJECT)),
    "bands": (
        lambda value: _all(_LENGTH, "")[0](value) and len(value) == 4 and sorted(set(value)) == value,
        "four ascending lengths",
    ),
    "topology": _null_or((lambda value: _OBJECT[0](value) and value.keys() >= _COUNTED, f"an object of {_COUNTS}")),
    **dict.fromkeys(("sources", "pairs"), _COUNT),
    **dict.fromkeys(("flipped", "collapsed", "crossings", "covering"), _COUNT),
    **dict.fromkeys(_COUNTED - {"euler"}, _COUNT),
    **dict.fromkeys(
        ("interior_share", "flipped_share", "area_beyond_1_25", "area_beyond_1_5", "area_beyond_2"), _null_or(_SHARE)
    ),
    "euler": (is_whole, "a whole number"),
    "voxel_size": _null_or(_LENGTH),
    "reference": _one_of("exact", "graph", "chain"),
    "unit": _UNIT,
    "pearson_r": _null_or((lambda value: is_number(value) and -1 <= value <= 1, "a number from -1 to 1")),
}
_OF_ATLAS: dict[str, _Kind] = {
    **dict.fromkeys(("certificate", "seams"), _OBJECT),
    **dict.fromkeys(("c", "k", "bound", "certified_before", "measured_before"), _FACTOR),
    "angle": (lambda value: is_number(value) and 0 <= value <= 90, "a number from 0 to 90"),
}
_OF_SEAMS = dict.fromkeys(("length", "closed", "holonomy", "bound", "overlap"), _SIZE)
_OF_STORE: dict[str, _Kind] = {
    "geodesic": _one_of("graph", "marching", "exact", "chain"),
    "link_lengths": _OF_SURFACE["link_lengths"],
    **dict.fromkeys(("points", "sources"), (lambda value: is_whole(value) and value > 0, "a positive whole number")),
    "fingerprint": _matching("[0-9a-f]{16}", "16 hexadecimal digits"),
    **dict.fromkeys(("points_sha256", "ids_sha256", "sources_sha256"), _SHA256),
}


def check_description(metadata: Mapping[str, Any]) -> None:
    """Raise an error for a documented key of a map, a series or an atlas whose value is not of its kind.

    Keys may be missing, and keys that are not known are ignored.
    """
    _check(metadata, _OF_SURFACE)
    if isinstance(metadata.get("space"), dict):
        _check(metadata["space"], _OF_SPACE)
    for cut in metadata.get("automatic_cuts") or ():
        _check(cut, _OF_CUT)


def check_distortion(figures: Mapping[str, Any]) -> None:
    """Raise an error for a distortion measure whose value is impossible; undefined measures are null."""
    _check(figures, {name: _OF_DISTORTION.get(name, _null_or(_SIZE)) for name in figures})
    for part in figures.values():
        if isinstance(part, dict):
            check_distortion(part)


def check_atlas(content: Mapping[str, Any]) -> None:
    """Raise an error for a bound or a length of an atlas whose value is impossible."""
    _check(content, _OF_ATLAS)
    _check(content.get("certificate", {}), _OF_ATLAS)
    _check(content.get("seams", {}), _OF_SEAMS)


def check_store(content: Mapping[str, Any], remedy: str) -> None:
    """Raise an error for a key of `store.json` whose value is impossible."""
    _check(content, _OF_STORE, remedy)


def _check(content: Mapping[str, Any], kinds: Mapping[str, _Kind], remedy: str = AGAIN) -> None:
    for name, (is_of_kind, words) in kinds.items():
        if name in content and not is_of_kind(content[name]):
            raise InputError(f"its key {name!r} is {shown(content[name])} instead of {words}. {remedy}")
