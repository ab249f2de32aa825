"""Make parts of HTML pages: layers of values with colours, images, 3-D scenes, and templates."""

import base64
import io
import json
import re
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape
from matplotlib import colormaps
from numpy.typing import NDArray
from PIL import Image
from scipy.sparse import coo_matrix, csr_matrix, diags
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from voxflat.figures.colours import AREAS, ERRORS, top
from voxflat.figures.flat_maps import folds
from voxflat.figures.overlays import painted
from voxflat.lab.results import MEASURES
from voxflat.maps.colours import WINDOW, all_whole, label_colours
from voxflat.maps.flat_map import FlatMap
from voxflat.unique_rows import distinct

_MOST_POINTS = 20_000  # in a scene; they take 0.5 MB of the page
_POINTS_A_STEP = 60  # points per smoothing step, so that the smoothing does not depend on the number of points
_NOTHING = 65_535  # code of a missing value
_EXACT = 2**53  # smaller integers are exact in JavaScript
_COLOURS = 64  # number of colours of a layer in a scene
PICTURE_WIDTH = 620  # width of an image, pixels
_BAR = 12  # number of colours of a colour bar
_SHADE = 0.45  # greatest share by which the folds darken an overlay


@dataclass(frozen=True, eq=False)
class Layer:
    """Values at the points of a map, with their colours."""

    name: str  # name in the file name
    title: str  # name on the page
    unit: str
    values: NDArray[np.float64]  # (N,), NaN if missing
    colour_map: str  # a Matplotlib name
    limits: tuple[float, float]  # values at the ends of the colours
    first_label: int | None = None  # smallest label that is not background, such as 1; None for values

    @property
    def is_shaded(self) -> bool:
        """Whether the folds darken the layer, so that sulci stay visible; in diverging colours, dark means extreme."""
        return self.name not in MEASURES and not self.limits[0] < 0 < self.limits[1]

    def colours(self, values: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Return the colours (n, 3) of labels, or of values between the limits."""
        if self.first_label is not None:
            return label_colours(values[:, None] + 1.0 - self.first_label)[:, 0, :3]
        low, high = self.limits
        return np.asarray(colormaps[self.colour_map]((values - low) / (high - low), bytes=True)[:, :3])


def layers_of(maps: Sequence[Mapping[str, NDArray[np.float64]]]) -> list[list[Layer]]:
    """Return the layers of several maps with common colour scales; overlays come before measures."""
    names = list(dict.fromkeys(name for values in maps for name in values))
    measures = ("curvature", "distanceerror", "areachange", "sulcaldepth")
    names.sort(key=lambda name: measures.index(name) if name in measures else -1)
    looks = {name: _look(name, np.concatenate([values[name] for values in maps if name in values])) for name in names}
    return [
        [
            Layer(name, title, unit, factor * values[name], colour_map, limits)
            for name, (title, unit, factor, colour_map, limits) in looks.items()
            if name in values
        ]
        for values in maps
    ]


def _look(name: str, values: NDArray[np.float64]) -> tuple[str, str, float, str, tuple[float, float]]:
    """Return the title, unit, factor, colour map and limits of a layer."""
    if name == "curvature":
        return "Folds (mean curvature)", "1/mm", 1.0, "gray", (-0.06, 0.06)
    if name == "distanceerror":
        return "Distance error", "%", 100.0, ERRORS, (0.0, 100 * top(values))
    if name == "areachange":
        most = top(np.abs(values))
        return "Area change, log2(map / surface)", "", 1.0, AREAS, (-most, most)
    if name == "sulcaldepth":
        most = top(np.abs(values))
        return "Sulcal depth", "mm", 1.0, "cividis", (-most, most)
    defined = values[np.isfinite(values)]
    low, high = np.percentile(defined, WINDOW).tolist() if len(defined) else (0.0, 1.0)
    if low < 0 < high:
        low, high = -max(-low, high), max(-low, high)
    unit = "mm" if name == "thickness" else ""
    limits = (low, high) if low < high else (low - 0.5, low + 0.5)
    return name[:1].upper() + name[1:], unit, 1.0, "RdBu_r" if low < 0 < high else "viridis", limits


def pictures(
    flat_map: FlatMap, layers: Sequence[Layer | None], pixel_size: float | None = None
) -> list[dict[str, Any]]:
    """Draw each layer over the folds of a map, 620 pixels wide by default; return images as `png` does."""
    width = float(np.ptp(flat_map.uv[:, 0]))
    raster = flat_map.raster(width / PICTURE_WIDTH if pixel_size is None else pixel_size)
    under = folds(flat_map, raster)
    shade = 1 - _SHADE + _SHADE * (under[..., :1] / under[..., :1].max())
    drawn = []
    for layer in layers:
        pixels = under
        if layer is not None:
            over = painted(raster.interpolate(layer.values), layer.colour_map, layer.limits)
            if layer.is_shaded:
                over[..., :3] = np.round(over[..., :3] * shade)
            pixels = np.where(over[..., 3:] > 0, over, under)
        drawn.append(png(pixels, raster.shape[1] * raster.pixel_size))
    return drawn


def png(pixels: NDArray[np.uint8], mm: float) -> dict[str, Any]:
    """Return pixels (H, W, 4) as a PNG data URI (``source``), with width and height in pixels, and width in ``mm``."""
    held = io.BytesIO()
    image = Image.fromarray(pixels)
    image.quantize(colors=255, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(held, "PNG")
    source = "data:image/png;base64," + base64.b64encode(held.getvalue()).decode()
    return {"source": source, "width": pixels.shape[1], "height": pixels.shape[0], "mm": mm}


def colour_bar(layer: Layer) -> dict[str, Any]:
    """Return the colour bar of a layer for a page: a CSS ``gradient``, the values at its ends, and the unit."""
    labels = None if layer.first_label is None else np.unique(layer.values[np.isfinite(layer.values)])
    colours = layer.colours(np.linspace(*layer.limits, _BAR) if labels is None else labels)
    listed = [f"rgb({r} {g} {b})" for r, g, b in colours.tolist()]
    if labels is not None:  # one field per label
        ends = np.linspace(0, 100, len(labels) + 1)
        listed = [f"{colour} {low:.2f}% {high:.2f}%" for colour, low, high in zip(listed, ends, ends[1:], strict=False)]
    low, high = (f"{value:.3g}" if labels is None else f"{value:.0f}" for value in layer.limits)
    return {"gradient": f"linear-gradient(to right, {', '.join(listed)})", "low": low, "high": high, "unit": layer.unit}


@dataclass(frozen=True, eq=False)
class SceneMap:
    """The parts of a map that a scene shows, as in a `FlatMap`."""

    uv: NDArray[np.float64]
    points: NDArray[np.float64]
    ids: NDArray[np.int64]
    faces: NDArray[np.uint32]
    torn: NDArray[np.bool_]


MapLike: TypeAlias = FlatMap | SceneMap


def scene(
    flat_map: MapLike,
    layers: Sequence[Layer],
    cuts: Mapping[str, NDArray[np.int64]],
    target: NDArray[np.float64] | None = None,
    *,
    view: tuple[float, float] | None = None,
    unit: str = "mm",
) -> str:
    """Return a map and its surface as JSON for the viewer of a page.

    `cuts` contains the points of the map along each cut. The slider moves the points of the surface to `target` (N, 3),
    by default to the surface without its folds. `view` is the initial rotation about z (0 looks along y) and elevation
    in radians, by default the medial side of a hemisphere. ``data`` contains all arrays, deflated, in base64: positions
    and values with 16 bits between minimum and maximum (0.005 mm), and exact integers.
    """
    rows = distinct(flat_map.ids).which  # both sides of a cut share a row
    chosen, faces = thinned(flat_map.uv, flat_map.faces[~flat_map.torn], rows)
    places = flat_map.points[chosen]
    parts: list[bytes] = []
    arrays: list[dict[str, Any]] = []

    def add(name: str, values: NDArray[np.float64], labels: NDArray[np.float64] | None = None) -> None:
        if labels is None:
            low, high = float(np.nanmin(values)), float(np.nanmax(values))
            step = (high - low) / (_NOTHING - 1) or 1.0
            codes: NDArray[Any] = np.round((np.nan_to_num(values) - low) / step)
            about: dict[str, Any] = {"low": low, "step": step}
        else:
            codes, about = np.searchsorted(labels, np.nan_to_num(values)), {"known": labels.astype(np.int64).tolist()}
        parts.append(np.where(np.isnan(values), _NOTHING, codes).astype("<u2").tobytes())
        arrays.append({"name": name, **about, "length": int(values.size)})

    add("uv", flat_map.uv[chosen])
    add("folded", places)
    if target is None:
        of_whole, counts = _edges(rows[flat_map.faces[~flat_map.torn]])
        is_rim = np.zeros(rows.max() + 1, dtype=bool)
        is_rim[of_whole[counts == 1]] = True  # the rim of the medial wall
        add("smooth", _smoothed(places, faces, rows[chosen], is_rim[rows[chosen]]))
    else:
        add("smooth", target[chosen])
    described = []
    for layer in layers:
        values = layer.values[chosen]
        numbers = np.unique(values[np.isfinite(values)])
        positions = np.linspace(*layer.limits, _COLOURS) if layer.first_label is None else numbers
        about = {"name": layer.name, "title": layer.title, "unit": layer.unit, "limits": layer.limits}
        colours = layer.colours(positions).ravel().tolist()
        described.append({**about, "labelled": layer.first_label is not None, "colours": colours})
        if not len(numbers):
            add(layer.name, np.zeros(len(chosen)))
            continue
        is_whole = all_whole(values) and len(numbers) < _NOTHING and np.abs(numbers).max() < _EXACT
        add(layer.name, values, numbers if is_whole else None)
    near = np.asarray(cKDTree(places).query(flat_map.points)[1], dtype=np.int64)  # the nearest kept points
    lines = {name: near[points] for name, points in cuts.items()}
    lines = {name: line[np.flatnonzero(np.diff(line, prepend=-1))] for name, line in lines.items()}  # without repeats
    parts.append(faces.astype("<u4").tobytes())
    ids = flat_map.ids[chosen]
    content = {
        "points": len(chosen),
        "of": len(flat_map.uv),
        "triangles": len(faces),
        "arrays": arrays,
        "layers": described,
        "cuts": {name: line.tolist() for name, line in lines.items()},
        "ids": ids.tolist() if ids.ndim == 1 else [],
        "view": view,
        "unit": unit,
        "data": base64.b64encode(zlib.compress(b"".join(parts), 9)).decode(),
    }
    return json.dumps(content, separators=(",", ":")).replace("<", "\\u003c")  # safe within HTML


def thinned(
    uv: NDArray[np.float64], faces: NDArray[Any], ids: NDArray[np.int64], most: int = _MOST_POINTS
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Reduce the points of a map to about `most`: keep one per cell of a grid over the plane, and all points at cuts.

    `ids` are the vertices of the points; the two sides of a cut share a vertex. Cells at the border keep a border
    point. Return the kept points, shape (k,), and their triangles, shape (G, 3).
    """
    used = np.unique(faces)
    if len(used) <= most:
        row = np.zeros(len(uv), dtype=np.int64)
        row[used] = np.arange(len(used))
        return used, row[faces]
    a, b, c = (uv[faces[:, corner]] for corner in range(3))
    ab, ac = b - a, c - a
    area = float(np.abs(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]).sum() / 2)
    size = np.sqrt(area / most)
    cell = distinct(np.floor((uv - uv.min(axis=0)) / size).astype(np.int64)).which
    pairs, counts = _edges(faces)
    is_single = np.bincount(ids)[ids] == 1  # keep all points at cuts, so that both sides still match
    within = pairs[(cell[pairs[:, 0]] == cell[pairs[:, 1]]) & is_single[pairs].all(axis=1)]
    shape = (len(uv), len(uv))
    _, group = connected_components(coo_matrix((np.ones(len(within)), within.T), shape), directed=False)
    is_inner = np.ones(len(uv), dtype=bool)
    is_inner[pairs[counts == 1]] = False
    order = used[np.lexsort((used, is_inner[used], group[used]))]
    first = np.flatnonzero(np.diff(group[order], prepend=-1))
    chosen, row = order[first], np.zeros(group.max() + 1, dtype=np.int64)
    row[group[chosen]] = np.arange(len(chosen))
    left = row[group[faces.astype(np.int64)]]
    left = left[(left[:, 0] != left[:, 1]) & (left[:, 1] != left[:, 2]) & (left[:, 2] != left[:, 0])]
    once = np.sort(distinct(np.sort(left, axis=1)).first)
    used, faces = np.unique(left[once], return_inverse=True)
    return chosen[used], faces.reshape(-1, 3)


def _edges(faces: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the edges of triangles, shape (E, 2), and the number of triangles at each."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    edges = distinct(np.sort(ends, axis=1))
    return edges.rows, edges.counts


def _smoothed(
    points: NDArray[np.float64], faces: NDArray[np.int64], ids: NDArray[np.int64], is_rim: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return a surface smoothed until its folds are gone; cuts stay closed, and the rim stays in place."""
    _, first, vertex = np.unique(ids, return_index=True, return_inverse=True)
    moved, corners = points[first], vertex.ravel()[faces]
    edges, _ = _edges(corners)
    links = csr_matrix((np.ones(2 * len(edges)), np.concatenate([edges, edges[:, ::-1]]).T), 2 * (len(moved),))
    mean = diags(1 / np.maximum(np.asarray(links.sum(axis=1)).ravel(), 1)) @ links
    is_free = ~is_rim[first, None]
    for _ in range(max(10, len(moved) // _POINTS_A_STEP)):
        moved = np.where(is_free, 0.5 * moved + 0.5 * (mean @ moved), moved)
    return np.asarray(moved[vertex.ravel()])


def filled(template: str, **content: Any) -> str:
    """Render a template of the package, such as ``subject.html``, as a self-contained page."""
    return _environment().get_template(template).render(**content)


@lru_cache
def _environment() -> Environment:
    rules: Any = {"autoescape": True, "trim_blocks": True, "lstrip_blocks": True, "undefined": StrictUndefined}
    environment = Environment(loader=PackageLoader("voxflat.lab", "templates"), **rules)
    environment.filters["message"] = _message
    return environment


def _message(text: str) -> Markup:
    """Return a message as a sentence of a page, in which `commands` between backticks are set as code."""
    if re.match(r"[a-z]+ ", text):  # no name of a file or an option
        text = text[0].upper() + text[1:]
    end = "" if text.endswith((".", "!", "?")) else "."
    return Markup(re.sub("`([^`]+)`", r"<code>\1</code>", str(escape(text + end))))
