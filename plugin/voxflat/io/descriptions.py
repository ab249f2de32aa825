"""Check the values of the keys that describe a map or an atlas in its file."""

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
_FRAME: _Kind = (lambda value: value in ("standard", "axis"), "'standard' or 'axis'")

_OF_SURFACE: dict[str, _Kind] = {
    **dict.fromkeys(("input", "structure", "measured_on", "cuts_by", "store"), _null_or(_TEXT)),
    **dict.fromkeys(("method", "input_sha256", "axes", "sampling", "geodesic", "scale"), _TEXT),
    **dict.fromkeys(("sources", "points", "surface_points", "memory_need_bytes"), _COUNT),
    **dict.fromkeys(("foreground", "series_frame"), _null_or(_COUNT)),
    **dict.fromkeys(("sphere", "range_image"), _null_or(_OBJECT)),
    **dict.fromkeys(("mended", "repair", "chart", "napari", "descent", "series"), _OBJECT),
    **dict.fromkeys(("threshold", "planarity"), _null_or(_NUMBER)),
    **dict.fromkeys(("weighting", "distance_error"), _null_or(_SIZE)),
    "warnings": _all(_TEXT, "a list of texts"),
    "seed": (lambda value: is_whole(value) and 0 <= value < 2**64, "a whole number from 0 to 2**64 - 1"),
    "unit": _UNIT,
    "label": _null_or(_LABEL),
    "sheet": _null_or(_FLAG),
    "mirrored": _FLAG,
    "frame": _null_or(_FRAME),
    "period": _null_or(_LENGTH),
    "cuts": _null_or(_all(_LIST, "a list of lists")),
    "cut_names": _null_or(_all(_null_or(_TEXT), "a list of texts")),
    "automatic_cuts": _null_or(_all(_OBJECT, "a list of objects")),
    "versions": (lambda value: _OBJECT[0](value) and all(map(_TEXT[0], value.values())), "an object with texts"),
    "provenance": _OBJECT,
}
_OF_CUT: dict[str, _Kind] = {"ids": _LIST, "length": _null_or(_SIZE), "reason": _TEXT}
_OF_SPACE: dict[str, _Kind] = {
    "name": (lambda value: value in ("scanner", "tkRAS", "unknown"), "'scanner', 'tkRAS' or 'unknown'"),
    "volume": _null_or(_OBJECT),
    "doubt": _TEXT,
}
_COUNTED = {"components", "euler", "handles", "loops"}
_COUNTS = ", ".join(sorted(_COUNTED))
_REFERENCES = ("exact", "graph", "chain")
_OF_DISTORTION: dict[str, _Kind] = {
    **dict.fromkeys(("raw", "best_scale", "standard_error"), _OBJECT),
    "triangles": _null_or(_OBJECT),
    "topology": _null_or((lambda value: _OBJECT[0](value) and value.keys() >= _COUNTED, f"an object of {_COUNTS}")),
    **dict.fromkeys(("sources", "pairs"), _COUNT),
    **dict.fromkeys(("flipped", "collapsed", "crossings", "covering"), _COUNT),
    **dict.fromkeys(_COUNTED - {"euler"}, _COUNT),
    **dict.fromkeys(("flipped_share", "area_beyond_1_25", "area_beyond_1_5", "area_beyond_2"), _null_or(_SHARE)),
    "euler": (is_whole, "a whole number"),
    "voxel_size": _null_or(_LENGTH),
    "reference": (lambda value: value in _REFERENCES, "'exact', 'graph' or 'chain'"),
    "unit": _UNIT,
    "pearson_r": _null_or((lambda value: is_number(value) and -1 <= value <= 1, "a number from -1 to 1")),
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


def _check(content: Mapping[str, Any], kinds: Mapping[str, _Kind]) -> None:
    for name, (is_of_kind, words) in kinds.items():
        if name in content and not is_of_kind(content[name]):
            raise InputError(f"its key {name!r} is {shown(content[name])} instead of {words}. {AGAIN}")
