"""Write regions of interest to pycortex's ``overlays.svg``, and read those that are drawn in it.

pycortex assigns a vertex to a region if its position on the flat map lies in a path of the region. It tests each part
of a path separately, so a hole has to be connected with the outline around it by a slit.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.path import Path as Polygon
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from voxflat.arguments import printable
from voxflat.io.files import REMEDY, contents, naming, require
from voxflat.maps.outlines import Collar, directed_boundary

HEIGHT = 1024.0  # of the drawing, in pixels
_DECIMALS = 5  # of pixels
_MARK = 0.05  # pixels, half the width of an outline around a single vertex
_DIAMOND = np.array([[1.0, 0], [0, 1], [-1, 0], [0, -1], [1, 0]])
_COLLAR = 0.02  # mm by which outlines of regions at the edge of the map pass around it
_SVG = "http://www.w3.org/2000/svg"
_INKSCAPE = "http://www.inkscape.org/namespaces/inkscape"
_LABEL = f"{{{_INKSCAPE}}}label"
_LAYERS = ("rois", "sulci", "cutouts", "display")
_TEXT = (
    "font-family:Helvetica, sans-serif;font-size:14pt;font-weight:bold;font-style:italic;fill:white;fill-opacity:1;"
    "text-anchor:middle;filter:url(#dropshadow)"
)  # the defaults of pycortex

_Floats = NDArray[np.float64]
_Masks = dict[str, NDArray[np.bool_]]


@dataclass(frozen=True, eq=False)
class FlatSurface:
    """The flat surface of a hemisphere, with one position for each vertex of the mesh."""

    uv: NDArray[np.float32]  # (V, 2), in mm
    faces: NDArray[np.int64]  # (F, 3)

    @property
    def is_on_map(self) -> NDArray[np.bool_]:
        """Which vertices belong to triangles of the map, shape (V,)."""
        is_there = np.zeros(len(self.uv), dtype=np.bool_)
        is_there[self.faces] = True
        return is_there


@dataclass(frozen=True, eq=False)
class Roi:
    """A region of interest: its vertices, by hemisphere (lh or rh), and a colour."""

    masks: _Masks
    colour: tuple[int, int, int] | None = None


class Drawing:
    """The drawing of both hemispheres side by side, as pycortex places them."""

    def __init__(self, flats: Mapping[str, FlatSurface]) -> None:
        self.flats = flats
        left, right = (flats[hemi].uv for hemi in ("lh", "rh"))
        shifts = {"lh": left[:, 0].max(), "rh": right[:, 0].min()}
        self.places = {hemi: flat.uv - np.array([shifts[hemi], 0], np.float32) for hemi, flat in flats.items()}
        both = np.concatenate([self.places["lh"], self.places["rh"]]).astype(np.float64)
        self.low, self.high = both.min(axis=0), both.max(axis=0)
        self.width = float(HEIGHT * np.divide(*(self.high - self.low)))

    def pixels(self, places: NDArray[Any]) -> _Floats:
        """Return positions in the drawing, whose y axis points downwards."""
        shares = (np.asarray(places, np.float64) - self.low) / (self.high - self.low)
        return np.column_stack([shares[:, 0] * self.width, (1 - shares[:, 1]) * HEIGHT])

    def outlines(self, roi: Roi) -> dict[str, list[_Floats]]:
        """Return closed outlines of a region in pixels, by hemisphere, in which pycortex finds exactly its vertices."""
        found = {}
        for hemi, mask in roi.masks.items():
            wanted = mask & self._is_on_map[hemi]
            loops = [np.round(self.pixels(loop), _DECIMALS) for loop in _loops(self._collars[hemi], wanted)]
            if loops:
                found[hemi] = _corrected(loops, wanted, self.inside(hemi, map(Polygon, loops)), self._tested[hemi])
        return found

    def inside(self, hemi: str, outlines: Iterable[Polygon]) -> NDArray[np.bool_]:
        """Return the vertices on the map in any of several outlines, by pycortex's rule."""
        mask = np.zeros(len(self._tested[hemi]), dtype=np.bool_)
        for outline in outlines:
            mask |= _contained(outline, self._tested[hemi])
        return mask & self._is_on_map[hemi]

    def svg(self, rois: Mapping[str, Roi], outlines: Mapping[str, Mapping[str, list[_Floats]]]) -> bytes:
        """Return the file with the regions of interest, and empty layers for everything else that pycortex draws."""
        root = _root(self.width)
        edge = [self.pixels(self.places[hemi][line]) for hemi, flat in self.flats.items() for line in _edge_loops(flat)]
        clip = root.find(f".//{{{_SVG}}}path")
        clip.set("d", _path_data(edge))
        layers = {name: _layer(root, name) for name in ("data", *_LAYERS)}
        for name in _LAYERS:
            shapes = _layer(layers[name], "shapes", f"{name}_shapes")
            shapes.set("clip-path", "url(#edgeclip)")
            labels = _layer(layers[name], "labels", f"{name}_labels")
            if name == "rois":
                for roi, region in rois.items():
                    self._draw(shapes, labels, roi, region, outlines[roi])
        ET.indent(root)
        return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True))

    def _draw(self, shapes: Any, labels: Any, name: str, roi: Roi, outlines: Mapping[str, list[_Floats]]) -> None:
        """Draw a region: a path and a label for each hemisphere."""
        text = printable(name)
        group = _layer(shapes, text)
        red, green, blue = roi.colour or (255, 255, 255)
        style = f"fill:none;stroke:#{red:02x}{green:02x}{blue:02x};stroke-width:2"
        for hemi, loops in outlines.items():
            ET.SubElement(group, f"{{{_SVG}}}path", {"d": _path_data(loops), "style": style})
            vertices = self._tested[hemi][roi.masks[hemi] & self._is_on_map[hemi]]
            x, y = _middle(vertices, np.concatenate(loops)).tolist()
            label = ET.SubElement(labels, f"{{{_SVG}}}text", {"x": f"{x:.1f}", "y": f"{y:.1f}", "style": _TEXT})
            label.text = text

    @cached_property
    def _is_on_map(self) -> _Masks:
        return {hemi: flat.is_on_map for hemi, flat in self.flats.items()}

    @cached_property
    def _collars(self) -> dict[str, Collar]:
        return {
            hemi: Collar.around(self.places[hemi].astype(np.float64), flat.faces, width=_COLLAR)
            for hemi, flat in self.flats.items()
        }

    @cached_property
    def _tested(self) -> dict[str, _Floats]:
        """The vertices in pixels, with the rounding of pycortex, which computes in single precision."""
        low, size = self.low.astype(np.float32), (self.high - self.low).astype(np.float32)
        shares = {hemi: (places - low) / size for hemi, places in self.places.items()}
        pixels = {hemi: share * np.array([self.width, HEIGHT]) for hemi, share in shares.items()}
        return {hemi: np.column_stack([of[:, 0], HEIGHT - of[:, 1]]) for hemi, of in pixels.items()}


def read_overlays(path: Path) -> tuple[dict[str, list[Polygon]], list[str]]:
    """Return the regions of interest in an ``overlays.svg``, and the names of its other layers with drawings.

    A region consists of the parts of its paths, in pixels, as pycortex reads them.
    """
    with naming(path, REMEDY):
        root = ET.fromstring(contents(path))
        layers = root.findall(f"{{{_SVG}}}g")
        drawn = [layer.get(_LABEL, "") for layer in layers if layer.find(f".//{{{_SVG}}}path") is not None]
        return _shapes(root), [name for name in drawn if name not in ("rois", "data")]


def _shapes(root: Any) -> dict[str, list[Polygon]]:
    rois = _named(root, "rois")
    shapes = None if rois is None else _named(rois, "shapes")
    groups = [] if shapes is None else shapes.findall(f"{{{_SVG}}}g")
    found: dict[str, list[Polygon]] = {}
    for group in groups:
        loops = [loop for path in group.findall(f"{{{_SVG}}}path") for loop in _parts(path.get("d", ""))]
        if loops:
            found.setdefault(group.get(_LABEL, ""), []).extend(loops)
    return found


def _named(parent: Any, label: str) -> Any:
    return next((group for group in parent.findall(f"{{{_SVG}}}g") if group.get(_LABEL) == label), None)


def _parts(data: str) -> Iterator[Polygon]:
    """Yield the parts of a path, with their curves; pycortex ignores transformations."""
    svg = require("svgelements")
    for part in svg.Path(data).as_subpaths():
        points, codes = [], []
        for segment in svg.Path(part):
            if isinstance(segment, svg.CubicBezier):
                points += [segment.control1, segment.control2, segment.end]
                codes += 3 * [Polygon.CURVE4]
            elif segment.end is not None:
                points.append(segment.end)
                codes.append(Polygon.MOVETO if isinstance(segment, svg.Move) else Polygon.LINETO)
        if len(points) > 2:
            yield Polygon([(point.x, point.y) for point in points], codes)


def _corrected(
    loops: list[_Floats], wanted: NDArray[np.bool_], found: NDArray[np.bool_], pixels: _Floats
) -> list[_Floats]:
    """Add small outlines around lost vertices, and small holes around others, where a map nearly touches itself."""
    wrong = np.flatnonzero(wanted != found)
    if len(wrong) == 0:
        return loops
    distances, _ = cKDTree(pixels).query(pixels[wrong], k=2)
    for vertex, room in zip(wrong.tolist(), distances[:, 1].tolist(), strict=True):
        mark = pixels[vertex] + min(_MARK, room / 3) * _DIAMOND
        if wanted[vertex]:
            loops = [*loops, mark]
        else:
            loops = [_slit(loop, [mark]) if Polygon(loop).contains_point(pixels[vertex]) else loop for loop in loops]
    return loops


def _contained(outline: Polygon, points: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which points lie in an outline, by Matplotlib's test, which pycortex uses."""
    corners = np.asarray(outline.vertices)
    inside = ((points >= corners.min(axis=0)) & (points <= corners.max(axis=0))).all(axis=1)
    inside[inside] = outline.contains_points(points[inside])
    return np.asarray(inside)


def _root(width: float) -> Any:
    ET.register_namespace("", _SVG)
    ET.register_namespace("inkscape", _INKSCAPE)
    size = {"width": f"{width:.6f}", "height": f"{HEIGHT:g}"}
    root = ET.Element(f"{{{_SVG}}}svg", {**size, "id": "svg2", "version": "1.1"})
    defs = ET.SubElement(root, f"{{{_SVG}}}defs", {"id": "defs4"})
    clip = ET.SubElement(defs, f"{{{_SVG}}}clipPath", {"id": "edgeclip"})
    ET.SubElement(clip, f"{{{_SVG}}}path", {"id": "clippath"})
    shadow = ET.SubElement(defs, f"{{{_SVG}}}filter", {"id": "dropshadow"})
    ET.SubElement(shadow, f"{{{_SVG}}}feGaussianBlur", {"in": "SourceAlpha", "stdDeviation": "2"})
    merge = ET.SubElement(shadow, f"{{{_SVG}}}feMerge")
    ET.SubElement(merge, f"{{{_SVG}}}feMergeNode")
    ET.SubElement(merge, f"{{{_SVG}}}feMergeNode", {"in": "SourceGraphic"})
    return root


def _layer(parent: Any, name: str, identity: str | None = None) -> Any:
    attributes = {"id": identity or ("datalayer" if name == "data" else name), "style": "display:inline;"}
    return ET.SubElement(parent, f"{{{_SVG}}}g", {**attributes, _LABEL: name, f"{{{_INKSCAPE}}}groupmode": "layer"})


def _path_data(loops: Sequence[_Floats]) -> str:
    """Return the data of a path, with spaces where pycortex splits it."""
    parts = (["M", *(f"{x:.{_DECIMALS}f},{y:.{_DECIMALS}f}" for x, y in loop[:-1].tolist()), "Z"] for loop in loops)
    return " ".join(" ".join([*part[:2], "L", *part[2:]]) for part in parts)


def _middle(vertices: _Floats, outline: _Floats) -> _Floats:
    """Return the vertex of a region that is farthest from its outline."""
    return np.asarray(vertices[cKDTree(outline).query(vertices)[0].argmax()])


# ------------------------------------------------------------------------------ outlines


def _edge_loops(flat: FlatSurface) -> list[NDArray[np.int64]]:
    """Return the boundary of a map as closed lines of vertices."""
    edges, following = directed_boundary(flat.faces, len(flat.uv))
    starts, after = edges[:, 0], following.tolist()
    rest, lines = set(range(len(edges))), []
    for first in range(len(edges)):
        line, number = [], first
        while number in rest:
            rest.remove(number)
            line.append(number)
            number = after[number]
        if line:
            lines.append(starts[[*line, first]])
    return lines


def _loops(collar: Collar, mask: NDArray[np.bool_]) -> list[_Floats]:
    """Return closed outlines around the vertices of a region, without holes: slits connect holes with their outline."""
    lines = [np.concatenate([loop, loop[:1]]) for loop in collar.outlines(mask)]
    return _without_holes(lines) if lines else []


def _without_holes(loops: list[_Floats]) -> list[_Floats]:
    """Connect each hole with the outline around it by the shortest slit."""
    if len(loops) == 1:
        return loops
    polygons = [Polygon(loop) for loop in loops]
    around = [
        [n for n, polygon in enumerate(polygons) if n != k and polygon.contains_point(loop[0])]
        for k, loop in enumerate(loops)
    ]
    holes: dict[int, list[_Floats]] = {k: [] for k, outer in enumerate(around) if len(outer) % 2 == 0}
    for k, outer in enumerate(around):
        if len(outer) % 2:
            holes[next(n for n in outer if len(around[n]) == len(outer) - 1)].append(loops[k])
    return [_slit(loops[k], inner) for k, inner in holes.items()]


def _slit(outline: _Floats, holes: list[_Floats]) -> _Floats:
    """Return one closed line around an outline and its holes; the nearest hole is connected first."""
    rest = list(holes)
    while rest:
        tree = cKDTree(outline)
        nearest = [tree.query(hole[:-1]) for hole in rest]
        k = min(range(len(rest)), key=lambda n: float(nearest[n][0].min()))
        hole, (distances, ends) = rest.pop(k)[:-1], nearest[k]
        start = int(distances.argmin())
        at = int(ends[start])
        turned = np.concatenate([hole[start:], hole[: start + 1]])
        outline = np.concatenate([outline[: at + 1], turned, outline[at:]])
    return outline
