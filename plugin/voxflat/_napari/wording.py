"""Messages in the words of the window: the fields of the forms instead of the arguments of Python."""

import re
from typing import Any

from voxflat.errors import VoxflatError, user_message
from voxflat.wording import in_words

CHOICES: dict[str, tuple[str, dict[Any, str], str]] = {
    "cuts": (
        "Cuts",
        {None: "default", "standard": "standard", "automatic": "automatic"},
        "Standard cuts are the same for every brain; automatic cuts minimise the distortion of this surface. By "
        "default, standard cuts are used if the sphere of the surface is known, and automatic cuts otherwise",
    ),
    "relax": (
        "Relaxation cuts",
        {None: "default", True: "enabled", False: "disabled"},
        "Additional cuts from the border inwards, where they reduce the distortion most",
    ),
    "geodesic": (
        "Distances",
        {None: "default", "graph": "graph of links", "marching": "fast marching", "exact": "exact"},
        "How the distances that the map preserves are computed",
    ),
    "scale": (
        "Scale",
        {None: "fit distances", "areas": "fit areas"},
        "Whether the scale of the map fits the distances or the total area of the surface",
    ),
    "sampling": (
        "Sampling",
        {None: "default", "farthest": "even", "curvature": "denser at folds", "random": "random"},
        "How the sources are distributed. Distances are computed from these points",
    ),
    "link_lengths": (
        "Links",
        {None: "chain code", "euclidean": "1, √2, √3 voxels"},
        "Lengths assigned to the links between neighbouring voxels",
    ),
}  # the fields of the options with a list: name, entries and tooltip

_FIELDS = {name: title for name, (title, _, _) in CHOICES.items()} | {
    "bound": "Bound C",
    "count": "Number",
    "depth": "Depth",
    "label": "Label",
    "max_angle": "Angle",
    "mirror": "Mirror",
    "neighbourhood": "Neighbourhood",
    "pial": "Pial surface",
    "pixel_size": "Pixel size",
    "radius": "Radius",
    "seed": "Random seed",
    "seed_point": "Seed point",
    "sources": "Sources",
    "starts": "Starts",
    "threshold": "Threshold",
    "weighting": "Local to global",
}
_PHRASES = {
    r"\bthe start\b": "the displayed map",
    r"(?:^|(?<=[.:] ))start(?= (?:is|has|does)\b)": "the displayed map",
    r"Also pass the cuts of the displayed map, or omit cuts, sphere, relax and adapt": (
        "Press From map in Draw cuts to include its cuts, or switch off Continue"
    ),
    r"Also pass surface, the surface that it shows": "Open the file of the flat map, and that of its surface",
    r"Pass a map that covers all of them, or omit start": "Choose a smaller part, or switch off Continue",
    r"Pass hemisphere='left' or 'right'": "Choose the ribbon of one hemisphere as the Label",
    r"Choose one, as in voxflat\.io\.read_volume\(path, channel=0\)": "Save one of them as a file, and open that file",
    r"`voxflat check` compares": "Check surface compares",
    r", or pass the values as an array to use them anyway": "",
    r" with the output of --debug": "",
}
_NO_FIELDS = "colour_map|max_area|on_surface|texel_size|time_step|voxel_size"  # arguments that no form has
_PYTHON = re.compile(rf"\b[a-z_]+=|\bvoxflat\.[a-z]|\b(?:{_NO_FIELDS})\b|\b(?:True|False|None)\b")
_UNKNOWN = re.compile(rf"(?<![\w/.-])(?:(?P<name>[a-z_]+)='?(?P<value>[\w.]*)'?|(?:{_NO_FIELDS})\b(?!\.\w))")
_ASIDE = re.compile(r" \([a-z_]+='?[\w.]*'?\)")
_SENTENCES = re.compile(r"(?<=[.;]) (?=[A-Z])")
_ALTERNATIVES = re.compile(r",? or |, (?!and )")
_SET = re.compile(rf"\b(?P<verb>[Uu]se|[Pp]ass) (?P<name>{'|'.join(_FIELDS)})=(?P<value>'[^']*'|[\w.+-]*\w)")
_VERB = re.compile(
    r"(?:add|check|choose|cut|extract|flatten|give|increase|make|measure|omit|pass|read|remove|repair|set|use)\b", re.I
)


def error_text(error: BaseException) -> str:
    """Return the text of an error for the window; every part of it shows errors by this text."""
    is_expected = isinstance(error, VoxflatError | MemoryError | OSError)
    return in_window(user_message(error)) if is_expected else f"{type(error).__name__}: {error}"


def in_window(text: str) -> str:
    """Return a message with fields of the form, such as Relaxation cuts, instead of arguments, such as relax=False.

    Remedies that only Python offers are left out.
    """
    text = _SET.sub(_setting, _ASIDE.sub("", text))
    first, *others = _SENTENCES.split(in_words(text, _PHRASES, _field))
    first = _UNKNOWN.sub(_plain, first)
    return " ".join([first, *filter(None, map(_remedy, others))])


def sentence(message: str) -> str:
    """Return a message with a capital first letter and a full stop."""
    return f"{message[:1].upper()}{message[1:]}{'' if message.endswith('.') else '.'}"


def _field(name: str, value: str | None, original: str) -> str:
    if name not in _FIELDS or (value is None and "_" not in name):
        return original
    if value is None:
        return _FIELDS[name]
    return f"{_FIELDS[name]} {_entry(name, value)}".rstrip()


def _plain(match: re.Match[str]) -> str:
    """Return an argument that the window does not have, such as packing='shapes', as words."""
    name = (match["name"] or match[0]).replace("_", " ")
    return f"{name} {match['value']}".rstrip() if match["name"] else name


def _setting(match: re.Match[str]) -> str:
    verb = "Set" if match["verb"][0].isupper() else "set"
    return f"{verb} {_FIELDS[match['name']]} to {_entry(match['name'], match['value'])}"


def _entry(name: str, value: str) -> str:
    """Return the entry of a list for a value of Python."""
    entries = {str(key): entry for key, entry in CHOICES[name][1].items()} if name in CHOICES else {}
    return entries.get(value.strip("'"), value)


def _remedy(sentence: str) -> str:
    """Return a sentence without the alternatives that only Python offers."""
    if not _PYTHON.search(sentence):
        return sentence
    parts = _ALTERNATIVES.split(sentence.rstrip("."))
    verb = parts[0].split()[0]
    left = [part if _VERB.match(part) else f"{verb.lower()} {part}" for part in parts if not _PYTHON.search(part)]
    if not left:
        return ""
    *others, last = left
    text = f"{', '.join(others)}{',' if len(others) > 1 else ''} or {last}" if others else last
    return f"{text[:1].upper()}{text[1:]}{'.' if sentence.endswith('.') else ''}"
