"""Read outlines drawn in an SVG figure of a map: the closed paths of a named layer, in map coordinates (mm).

The root element defines the position of the axes: ``data-voxflat-extent`` (left, right, bottom and top in mm) and
``data-voxflat-axes`` (x, y, width and height of the same area in user units of the viewBox, with y pointing downwards).
"""

import os
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import checked_path, printable
from voxflat.errors import InputError
from voxflat.io.files import check_regular, naming, require
from voxflat.io.reading import record_file

EXTENT, AXES = "data-voxflat-extent", "data-voxflat-axes"
REGIONS = "data-voxflat-regions"
"""Marks files of regions, which `write_outlines` wrote."""

_SVG = "http://www.w3.org/2000/svg"
_INKSCAPE = "http://www.inkscape.org/namespaces/inkscape"
_LABEL, _MODE = f"{{{_INKSCAPE}}}label", f"{{{_INKSCAPE}}}groupmode"
_TOLERANCE = 0.005  # mm, largest distance of a chord from its curve
_MOST = 1024  # largest number of chords per curve


@dataclass(frozen=True, eq=False)
class Outline:
    """Store the outline of a region."""

    name: str
    loops: tuple[NDArray[np.float64], ...]  # closed polygons (k, 2), (u, v) in mm
    is_even_odd: bool = False  # even-odd fill rule, else non-zero
    colour: tuple[int, int, int] | None = None  # red, green, blue
    is_coloured: bool = False  # whether other regions with the same colour were given it on purpose


def read_outlines(path: str | os.PathLike[str], layer: str) -> list[Outline]:
    """Read the paths of a layer, lowest first, named by ``inkscape:label``, or else by their group, title or id."""
    path = checked_path(path)
    with naming(path, "check that it is an SVG figure that voxflat wrote"):
        check_regular(path)
        path.open("rb").close()
        svg = require("svgelements")
        root = svg.SVG.parse(os.fspath(path), reify=True)
        record_file(path)
        to_mm = _placement(root, svg)
        groups = list(_groups(root, svg))
        drawn = next((group for group in groups if layer in (_own(group, _LABEL), group.id)), None)
        if drawn is None:
            layers = [group for group in groups if _own(group, _MODE) == "layer"] or groups  # else not from Inkscape
            names = ", ".join(repr(_own(group, _LABEL) or str(group.id)) for group in layers) or "other elements"
            raise InputError(f"has no layer {layer!r} (layers: {names}). Draw the regions in a layer named {layer!r}")
        outlines = [outline for outline in _outlines(drawn, svg, to_mm, _own(drawn, _LABEL)) if outline.loops]
        if root.values.get(REGIONS) is not None:
            outlines = [replace(outline, is_coloured=True) for outline in outlines]
        if not outlines:
            raise InputError(f"its layer {layer!r} has no path. Draw the regions in this layer as closed paths")
        return outlines


def write_outlines(
    path: Path, outlines: Sequence[Outline], extent: tuple[float, float, float, float], layer: str, text: str
) -> None:
    """Write outlines as paths of a layer that Inkscape shows, in a drawing of the given extent in mm.

    `extent` is left, right, bottom and top. `text` is stored as metadata.
    """
    left, right, bottom, top = extent
    width, height = right - left, top - bottom
    ET.register_namespace("", _SVG)
    ET.register_namespace("inkscape", _INKSCAPE)
    size = {"width": f"{width:.9g}mm", "height": f"{height:.9g}mm", "viewBox": f"0 0 {width:.17g} {height:.17g}"}
    placed = {EXTENT: " ".join(f"{end:.17g}" for end in extent), AXES: f"0 0 {width:.17g} {height:.17g}", REGIONS: "1"}
    root = ET.Element(f"{{{_SVG}}}svg", {"version": "1.1", **size, **placed})
    ET.SubElement(root, f"{{{_SVG}}}metadata").text = text
    group = ET.SubElement(root, f"{{{_SVG}}}g", {"id": printable(layer), _LABEL: printable(layer), _MODE: "layer"})
    for number, outline in enumerate(outlines, 1):
        red, green, blue = outline.colour or (0, 0, 0)
        colour = f"#{red:02x}{green:02x}{blue:02x}"
        data = " ".join(_path_data(loop - [left, top]) for loop in outline.loops)
        look = {"fill": colour, "fill-opacity": "0.5", "stroke": colour, "stroke-width": f"{width / 500:.3g}"}
        rule = "evenodd" if outline.is_even_odd else "nonzero"
        named = {"id": f"region{number}", _LABEL: printable(outline.name), "fill-rule": rule}
        ET.SubElement(group, f"{{{_SVG}}}path", {**named, **look, "d": data})
    ET.indent(root)
    path.write_bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True))


def _path_data(loop: NDArray[np.float64]) -> str:
    """Return the data of a closed path; its y axis points downwards."""
    return "M " + " L ".join(f"{x:.12g},{-y:.12g}" for x, y in loop.tolist()) + " Z"


def _placement(root: Any, svg: Any) -> Any:
    """Return the function that maps points of the parsed file to mm."""
    area = []
    for key in (EXTENT, AXES):
        numbers = [float("nan")]
        with suppress(ValueError):
            numbers = [float(word) for word in str(root.values.get(key, "")).replace(",", " ").split()]
        if len(numbers) != 4 or not np.isfinite(numbers).all():
            raise InputError(f"its root does not define {key} as four numbers. Draw in a figure written by voxflat")
        area.append(numbers)
    (left, right, bottom, top), (x, y, width, height) = area
    if width <= 0 or height <= 0 or left == right or bottom == top:
        raise InputError(f"its {EXTENT} or {AXES} has no area. Draw in a figure written by voxflat")
    to_units = ~svg.Matrix(root.viewbox_transform or "")

    def to_mm(points: NDArray[np.float64]) -> NDArray[np.float64]:
        with np.errstate(invalid="ignore", over="ignore"):
            px = to_units.a * points[:, 0] + to_units.c * points[:, 1] + to_units.e
            py = to_units.b * points[:, 0] + to_units.d * points[:, 1] + to_units.f
            mm = np.column_stack([left + (px - x) / width * (right - left), top - (py - y) / height * (top - bottom)])
        if not np.isfinite(mm).all():
            raise InputError("has a path with infinite coordinates. Draw the path again, or check the viewBox")
        return mm

    return to_mm


def _own(element: Any, key: str) -> str | None:
    """Return an attribute of an element itself, because the library merges it with the attributes of its parents."""
    value = element.values.get("attributes", {}).get(key)
    return None if value is None else str(value)


def _groups(group: Any, svg: Any) -> Iterator[Any]:
    """Yield the groups that are layers, or have an id or a label."""
    for element in group:
        if isinstance(element, svg.Group):
            if element.id is not None or _own(element, _LABEL) or _own(element, _MODE):
                yield element
            yield from _groups(element, svg)


def _outlines(group: Any, svg: Any, to_mm: Any, around: str | None) -> Iterator[Outline]:
    elements = list(group)
    for n, element in enumerate(elements):
        if isinstance(element, svg.Group):
            yield from _outlines(element, svg, to_mm, _own(element, _LABEL) or around)
        elif isinstance(element, svg.Shape):
            after = elements[n + 1] if n + 1 < len(elements) else None
            title = after.title if isinstance(after, svg.Title) else None
            inside = around if around != _own(group, _LABEL) or not _own(group, _MODE) else None
            name = _own(element, _LABEL) or inside or title or element.id or f"region {n + 1}"
            loops = tuple(_loops(svg.Path(element), svg, to_mm))
            rule = element.values.get("fill-rule") == "evenodd"
            colours = [c for c in (element.fill, element.stroke) if c is not None and c.value is not None]
            colour = (colours[0].red, colours[0].green, colours[0].blue) if colours else None
            yield Outline(str(name).strip(), loops, rule, colour)


def _loops(path: Any, svg: Any, to_mm: Any) -> Iterator[NDArray[np.float64]]:
    """Yield the closed parts of a path; curves become chords."""
    for part in path.as_subpaths():
        segments = [segment for segment in svg.Path(part) if not isinstance(segment, svg.Move)]
        points = [to_mm(_chords(segment, svg, to_mm)) for segment in segments]
        loop = np.concatenate(points) if points else np.zeros((0, 2))
        if len(loop):
            loop = loop[np.r_[True, np.any(np.diff(loop, axis=0) != 0, axis=1)]]
        if len(loop) >= 3:
            yield loop


def _chords(segment: Any, svg: Any, to_mm: Any) -> NDArray[np.float64]:
    """Return points along a segment, close enough together for the chords to stay within the tolerance."""
    if isinstance(segment, svg.Line | svg.Close):
        ends = [segment.start, segment.end]
        return np.array([[end.x, end.y] for end in ends if end is not None], dtype=np.float64).reshape(-1, 2)
    count = 8
    while True:
        points = np.array([[p.x, p.y] for p in map(segment.point, np.linspace(0, 1, 2 * count + 1))])
        placed = to_mm(points)
        off = np.linalg.norm(placed[1::2] - (placed[:-1:2] + placed[2::2]) / 2, axis=1).max()
        if off <= _TOLERANCE or count >= _MOST:
            return points
        count *= 2
