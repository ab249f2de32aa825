"""Read border files of Connectome Workbench: named lines on a surface.

Each point of a line is given by the three vertices of a triangle and its barycentric weights. Versions 1 and 3 of the
format are supported (https://www.humanconnectome.org/software/workbench-command).
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.errors import InputError

_NO_COLOUR = "???"


@dataclass(frozen=True, eq=False)
class BorderLine:
    """Store one line of a border."""

    vertices: NDArray[np.int64]  # (k, 3), the corners of the triangle that contains each point
    weights: NDArray[np.float64]  # (k, 3), with sum 1
    is_closed: bool


@dataclass(frozen=True, eq=False)
class Border:
    """Store a named border, which may consist of several lines."""

    name: str
    colour: tuple[int, int, int] | None  # red, green, blue
    lines: tuple[BorderLine, ...]


def read_borders(data: bytes, points: int) -> list[Border]:
    """Return the borders in a file, in its order; borders with the same name are one border."""
    try:
        root = ET.fromstring(data)
    except ET.ParseError as error:
        raise InputError(f"is not a border file ({error}). Write it again with Workbench") from None
    if root.tag != "BorderFile":
        raise InputError(f"is not a border file, but contains {root.tag[:40]!r}. Pass a .border file of Workbench")
    version = root.get("Version", "")
    if version not in ("1", "3"):
        raise InputError(f"has version {version[:20]!r}. Convert it to version 1 or 3 with Workbench")
    stated = root.get("SurfaceNumberOfVertices")
    if stated is not None and stated != str(points):
        raise InputError(f"belongs to a surface with {stated[:20]} vertices, but this surface has {points}")
    named: dict[str, Border] = {}
    for border in _of_version_3(root) if version == "3" else _of_version_1(root):
        first = named.get(border.name, Border(border.name, border.colour, ()))
        named[border.name] = Border(first.name, first.colour, (*first.lines, *border.lines))
    for border in named.values():
        for line in border.lines:
            _check(line, border.name, points)
    if not named:
        raise InputError("contains no borders. Draw at least one border")
    return list(named.values())


def border_structure(data: bytes) -> str | None:
    """Return the structure of a border file in GIFTI notation, such as "CortexLeft"; None if it is not known."""
    try:
        root = ET.fromstring(data)
    except ET.ParseError:
        return None  # the reader reports it
    name = root.get("Structure") or root.findtext(".//Structure") or ""
    return "".join(word.capitalize() for word in name.strip().split("_")) or None


def _of_version_3(root: ET.Element) -> Iterator[Border]:
    for group in root.iter("Class"):
        for border in group.iter("Border"):
            colour = _colour([border.get(name) for name in ("Red", "Green", "Blue")])
            lines = []
            for part in border.iter("BorderPart"):
                name = border.get("Name", "")
                vertices = _rows(part.findtext("Vertices"), name)
                weights = _rows(part.findtext("Weights"), name)
                lines.append(_line(vertices, weights, name, part.get("Closed", "").lower() == "true"))
            yield Border(border.get("Name", ""), colour, tuple(lines))


def _of_version_1(root: ET.Element) -> Iterator[Border]:
    colours = {}
    for label in root.iterfind("BorderNameColorTable/LabelTable/Label"):
        colours[(label.text or "").strip()] = _colour([label.get(name) for name in ("Red", "Green", "Blue")])
    classes = {}
    for label in root.iterfind("BorderClassColorTable/LabelTable/Label"):
        classes[(label.text or "").strip()] = _colour([label.get(name) for name in ("Red", "Green", "Blue")])
    colours.pop(_NO_COLOUR, None)
    classes.pop(_NO_COLOUR, None)
    for border in root.iter("Border"):
        name = (border.findtext("Name") or "").strip()
        items = list(border.iter("ProjectionBarycentric"))
        vertices = _rows(" ".join(item.findtext("TriangleNodes") or "" for item in items), name)
        weights = _rows(" ".join(item.findtext("TriangleAreas") or "" for item in items), name)
        ends = vertices[[0, -1]]
        is_closed = len(vertices) > 2 and bool(np.isin(*ends).any())  # this version does not say which lines are closed
        colour = colours.get(name) or classes.get((border.findtext("ClassName") or "").strip())
        yield Border(name, colour, (_line(vertices, weights, name, is_closed),))


def _colour(parts: list[Any]) -> tuple[int, int, int] | None:
    try:
        red, green, blue = (round(255 * float(part)) for part in parts)
    except (TypeError, ValueError, OverflowError):
        return None
    return (red, green, blue) if min(red, green, blue) >= 0 and max(red, green, blue) <= 255 else None


def _rows(text: str | None, name: str) -> NDArray[np.float64]:
    try:
        numbers = np.array((text or "").split(), dtype=np.float64)
    except ValueError as error:
        raise InputError(f"its border {name[:60]!r} has damaged points ({error}). Write it again") from None
    if len(numbers) % 3 or len(numbers) == 0 or not np.isfinite(numbers).all():
        raise InputError(f"its border {name[:60]!r} has {len(numbers)} numbers, not three per point. Write it again")
    return numbers.reshape(-1, 3)


def _line(vertices: NDArray[np.float64], weights: NDArray[np.float64], name: str, is_closed: bool) -> BorderLine:
    sums = weights.sum(axis=1, keepdims=True)
    if len(vertices) != len(weights) or (sums <= 0).any() or (weights < -1e-3 * sums).any():
        raise InputError(f"its border {name[:60]!r} has weights that are not those of its points. Write it again")
    shares = np.maximum(weights / sums, 0)
    ends = [dict(zip(vertices[n].tolist(), shares[n].round(6).tolist(), strict=True)) for n in (0, -1)]
    first, last = ({vertex: share for vertex, share in end.items() if share > 0} for end in ends)
    is_closed |= len(vertices) > 2 and first == last
    return BorderLine(vertices.astype(np.int64), shares, is_closed)


def _check(line: BorderLine, name: str, points: int) -> None:
    low, high = int(line.vertices.min()), int(line.vertices.max())
    if low < 0 or high >= points:
        bad = low if low < 0 else high
        raise InputError(f"its border {name[:60]!r} uses vertex {bad}, but the surface has vertices 0 to {points - 1}")
