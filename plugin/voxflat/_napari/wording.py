"""Messages in the words of the window: the fields of the forms instead of the arguments of Python."""

import re

_FIELDS = {
    "bound": "Bound C",
    "cuts": "Cuts",
    "geodesic": "Distances",
    "link_lengths": "Links",
    "mirror": "Mirror",
    "neighbourhood": "Neighbourhood",
    "pixel_size": "Pixel size",
    "relax": "Relaxation cuts",
    "sampling": "Sampling",
    "scale": "Scale",
    "seed_point": "Seed point",
    "weighting": "Local to global",
}
_PHRASES = {  # about the map to continue from
    r"\bthe start\b": "the displayed map",
    r"(?:^|(?<=[.:] ))start(?= (?:is|has|does)\b)": "the displayed map",
    r"Also pass the cuts of the displayed map, or omit cuts, sphere, relax and adapt": (
        "Press From map in Draw cuts to include its cuts, or switch off Continue"
    ),
    r"Pass a map that covers all of them, or omit start": "Choose a smaller part, or switch off Continue",
}
_STATES = {"True": "enabled", "False": "disabled"}
_ARGUMENT = re.compile(
    rf"(?P<verb>\b(?:[Uu]se|[Pp]ass) )?(?<![\w.])(?P<name>{'|'.join(_FIELDS)})=(?P<value>'[^']*'|[\w.+-]*\w)"
)


def in_window(text: str) -> str:
    """Return a message with fields of the form, such as Relaxation cuts, instead of arguments, such as relax=False."""
    for phrase, instead in _PHRASES.items():
        text = re.sub(phrase, instead, text)
    return _ARGUMENT.sub(_field, text)


def _field(found: re.Match[str]) -> str:
    value = found["value"].strip("'")
    field, value = _FIELDS[found["name"]], _STATES.get(value, value)
    if found["verb"] is None:
        return f"{field}: {value}"
    return f"{'Set' if found['verb'][0].isupper() else 'set'} {field} to {value}"
