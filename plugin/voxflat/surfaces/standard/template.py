"""Define templates of cuts: named lines on the unit sphere, for any brain with a registered sphere."""

import os
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import checked_path
from voxflat.errors import InputError
from voxflat.io.files import check_format, contents, from_json
from voxflat.io.provenance import Record, as_text

STANDARD = "standard"  # name of the built-in template
SPACES = ("fsaverage", "fs_LR")  # the spaces in which a sphere may be registered
SIDES = {"left": "CortexLeft", "right": "CortexRight"}  # the sides, and GIFTI's names for them

_FORMAT = 1
_UNIT = 1e-3  # tolerance of the radius


@dataclass(frozen=True, eq=False)
class Line:
    """A line on the unit sphere, with great-circle arcs between its points.

    An outline is closed: its last point is joined to its first, and the patch lies on its left as seen from outside. A
    cut begins at its root, which is an outline or an earlier cut; on a surface without a boundary it has no root.
    """

    name: str  # such as "calcarine"
    points: NDArray[np.float64]  # (k, 3), unit vectors
    root: str | None = None


@dataclass(frozen=True, eq=False)
class Anchors:
    """Corresponding points, which align maps with a standard frame and reveal unsuitable spheres."""

    sphere: NDArray[np.float64]  # (a, 3), on the unit sphere
    flat: NDArray[np.float64]  # (a, 2), on the flat map of fsaverage5, mm
    white: NDArray[np.float64]  # (a, 3), on the white surface of fsaverage5, mm


@dataclass(frozen=True, eq=False)
class Template:
    """The lines along which a hemisphere is cut."""

    name: str  # name, or path of its file
    space: str  # fsaverage or fs_LR: sphere of its lines
    side: str  # left or right
    outlines: tuple[Line, ...]  # closed: around the medial wall, or around a region
    cuts: tuple[Line, ...]  # in the order in which they are made
    anchors: Anchors | None = None  # only in the built-in template
    provenance: Record = field(default_factory=dict)  # its origin

    def __repr__(self) -> str:
        names = ", ".join(line.name for line in self.cuts)
        return f"<Template {self.name}: {self.side}, {self.space}; {names or 'no cuts'}>"

    def as_json(self) -> str:
        """Return the content of the template's file."""
        content: dict[str, Any] = {
            "voxflat": "template",
            "format": _FORMAT,
            "name": self.name,
            "space": self.space,
            "side": self.side,
            "outlines": [{"name": line.name, "line": line.points.round(6).tolist()} for line in self.outlines],
            "cuts": [
                {"name": line.name, "root": line.root, "line": line.points.round(6).tolist()} for line in self.cuts
            ],
            "provenance": self.provenance,
        }
        return as_text(content) + "\n"


@cache
def standard_template(space: str, side: str) -> Template:
    """Return the built-in template: medial wall, calcarine cut, three medial cuts and a temporal cut."""
    path = Path(__file__).parent / f"{space}.{side}.json"
    return _parsed(path, from_json(path.read_text(encoding="utf-8")), STANDARD)


def is_template(path: Path) -> bool:
    """Return whether a cuts file is a template rather than a list of one surface's vertices."""
    try:
        content = from_json(contents(path)) if path.suffix.lower() == ".json" else None
    except (OSError, ValueError):
        return False
    return isinstance(content, dict) and content.get("voxflat") == "template"


def read_template(path: str | os.PathLike[str]) -> Template:
    """Read a template from a file written by `CutSurface.save_template`."""
    path = checked_path(path)
    try:
        content = from_json(contents(path))
    except OSError as error:
        raise InputError(f"cannot read the template {path}: {error.strerror}") from error
    except ValueError as error:
        raise InputError(f"{path} is not a template of cuts: {error}") from error
    return _parsed(path, content, os.fspath(path))


def _parsed(path: Path, content: Any, name: str) -> Template:
    if not isinstance(content, dict) or content.get("voxflat") != "template":
        raise InputError(f"{path} is not a template of cuts. Create one with voxflat cut --save-template")
    check_format(path, content.get("format"), _FORMAT, "Save the template again")
    for key, choices in (("space", SPACES), ("side", tuple(SIDES))):
        if content.get(key) not in choices:
            raise InputError(f"{path}: {key} is {content.get(key)!r}, but must be {' or '.join(map(repr, choices))}")
    outlines = tuple(_line(path, entry, 3) for entry in _entries(path, content, "outlines"))
    cuts = tuple(_line(path, entry, 2) for entry in _entries(path, content, "cuts"))
    if not outlines and not cuts:
        raise InputError(f"{path} has neither outlines nor cuts. Create a template with at least one of them")
    names = {line.name for line in outlines}
    for cut in cuts:
        if cut.root is not None and cut.root not in names:
            raise InputError(
                f"{path}: {cut.root!r}, the root of {cut.name!r}, is neither an outline nor an earlier cut"
            )
        if cut.name in names:
            raise InputError(f"{path} has two lines named {cut.name!r}")
        names.add(cut.name)
    more = _anchors(path, content), content.get("provenance", {})
    return Template(name, content["space"], content["side"], outlines, cuts, *more)


def _entries(path: Path, content: dict[str, Any], name: str) -> list[Any]:
    entries = content.get(name, [])
    if not isinstance(entries, list):
        raise InputError(f"{path}: {name} is not a list")
    return entries


def _line(path: Path, entry: Any, fewest: int) -> Line:
    if not isinstance(entry, dict) or not isinstance(entry.get("name"), str) or not entry["name"]:
        raise InputError(f"{path}: each outline and each cut must have a name")
    root = entry.get("root")
    if root is not None and not isinstance(root, str):
        raise InputError(f"{path}: the root of {entry['name']!r} is not a name")
    points = _numbers(path, entry.get("line"), 3, repr(entry["name"]), fewest)
    far = np.abs(np.linalg.norm(points, axis=1) - 1)
    if (far > _UNIT).any():
        raise InputError(f"{path}: point {far.argmax()} of {entry['name']!r} does not lie on the unit sphere")
    points = points / np.linalg.norm(points, axis=1)[:, None]
    apart = np.linalg.norm(np.diff(points, axis=0), axis=1)
    keep = np.concatenate([[True], apart > 1e-6])  # arcs need two end points
    if keep.sum() < fewest or apart.max() > 1:
        raise InputError(f"{path}: the points of {entry['name']!r} coincide, or are too far apart to be joined")
    return Line(entry["name"], points[keep], root)


def _anchors(path: Path, content: dict[str, Any]) -> Anchors | None:
    anchors = content.get("anchors")
    if anchors is None:
        return None
    if not isinstance(anchors, dict):
        raise InputError(f"{path}: anchors is not a JSON object")
    widths = {"sphere": 3, "flat": 2, "white": 3}
    arrays = [_numbers(path, anchors.get(key), width, key, 3) for key, width in widths.items()]
    if len({len(array) for array in arrays}) != 1:
        raise InputError(f"{path}: the anchors have different lengths")
    return Anchors(*arrays)


def _numbers(path: Path, values: Any, width: int, name: str, fewest: int) -> NDArray[np.float64]:
    try:
        array = np.asarray(values, dtype=np.float64)
    except (ValueError, TypeError):
        array = np.empty(0)
    if array.ndim != 2 or array.shape[1] != width or len(array) < fewest or not np.isfinite(array).all():
        raise InputError(f"{path}: {name} must consist of at least {fewest} rows of {width} finite numbers")
    return array
