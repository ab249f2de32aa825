"""Trace the lines of a template on a surface: the region inside its outlines, and its cuts as paths along edges.

A cut is the cheapest path from the vertex at its tip to its root; edges cost more the farther they lie from the
template's line. It runs through vertices that belong to no boundary and no other cut, and ends at the first vertex of
its root. Therefore it is a simple path that touches nothing else, for any mesh, and a surface with one boundary keeps
one boundary and its Euler characteristic.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import NDArray

from voxflat.arguments import Progress
from voxflat.errors import InputError
from voxflat.surfaces.manifold import Manifold
from voxflat.surfaces.standard.sphere import Sphere
from voxflat.surfaces.standard.template import Line, Template

_STEP = 0.0025  # radians between points of a line for distances: 0.25 mm at a radius of 100 mm
_BEYOND = 0.3  # radians, extension of a cut's line beyond its root, because the subject's wall may lie there
_DIRECTION = 0.1  # radians at a line's root that define its direction
_ASTRAY = 0.1  # radians, largest distance of a path or tip from its line (at least four edges)
_ASIDE = 0.3  # position of a saved outline, as a fraction of the way to the centres of outer triangles
_SMALL_LOOP = 15.0  # mm circumference; cuts do not begin at smaller holes
_FAR = 0.4  # radians; larger distances are equal
_STEEP = 1e6  # largest cost per length of an edge


@dataclass(frozen=True, eq=False)
class TracedCut:
    """A cut of a template, traced on a surface."""

    name: str  # the template's
    vertices: NDArray[np.int64]  # (k,), of the part, from the root to the tip
    length: float  # mm


def kept_by(template: Template, whole: Manifold, sphere: Sphere) -> NDArray[np.bool_]:
    """Find the triangles that a template's outlines keep: all on their left, in one piece with one boundary each."""
    faces = whole.faces
    mask = np.ones(len(faces), dtype=np.bool_)
    for outline in template.outlines:
        dropped = ~_left_of(outline, sphere.places[whole.vertices])
        mask &= ~_largest(dropped, faces)[faces].any(axis=1)
    if not mask.any():
        raise InputError(f"the outlines of the template {template.name} exclude every triangle of the surface")
    piece = whole.core.part_of_faces(mask).largest_piece()
    in_piece = np.zeros(whole.count, dtype=np.bool_)
    in_piece[piece.ids] = True
    return np.asarray(mask & in_piece[whole.vertices[faces]].all(axis=1))


def _largest(chosen: NDArray[np.bool_], faces: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """Return the largest connected piece of the chosen vertices."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    a, b = edges[chosen[edges].all(axis=1)].T.astype(np.int64)
    graph = scipy.sparse.coo_matrix((np.ones(len(a)), (a, b)), shape=(len(chosen), len(chosen)))
    _, piece = scipy.sparse.csgraph.connected_components(graph, directed=False)
    counts = np.bincount(piece[chosen], minlength=piece.max() + 1)
    return np.asarray(chosen & (piece == counts.argmax()))


def _left_of(outline: Line, places: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Find points on the left of a closed line, as seen from outside the sphere."""
    line = outline.points
    pole = line.mean(axis=0)
    pole = pole / np.linalg.norm(pole) if np.linalg.norm(pole) > 1e-6 else np.cross(line[0], line[1])
    x, y = _across(pole)

    def flat(points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Project stereographically, which preserves circles and orientation."""
        away = np.maximum(1 + points @ pole, 1e-9)
        return np.stack([points @ x, points @ y], axis=1) / away[:, None]

    a = flat(_dense(np.concatenate([line, line[:1]]), 0.01))[:-1]
    b = np.roll(a, -1, axis=0)
    uv = flat(places)
    near = np.flatnonzero(((uv >= a.min(axis=0)) & (uv <= a.max(axis=0))).all(axis=1))
    u, v = uv[near].T
    inside = np.zeros(len(near), dtype=np.bool_)
    for (au, av), (bu, bv) in zip(a, b, strict=True):
        if av != bv:
            inside ^= ((av > v) != (bv > v)) & (u < au + (v - av) * ((bu - au) / (bv - av)))
    is_inside = np.zeros(len(places), dtype=np.bool_)
    is_inside[near] = inside
    is_counterclockwise = float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()) > 0
    return is_inside if is_counterclockwise else ~is_inside


def _across(pole: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return two unit vectors that form a right-handed orthogonal system with a third."""
    x = np.cross(np.eye(3)[np.abs(pole).argmin()], pole)
    x /= np.linalg.norm(x)
    y = np.cross(pole, x)
    return x, y / np.linalg.norm(y)


def _dense(points: NDArray[np.float64], step: float) -> NDArray[np.float64]:
    """Return a line with additional points on the unit sphere, at most one step apart."""
    parts = []
    for a, b in pairwise(points):
        t = np.linspace(0, 1, max(1, int(np.ceil(np.linalg.norm(b - a) / step))), endpoint=False)[:, None]
        parts.append((1 - t) * a + t * b)
    dense = np.concatenate([*parts, points[-1:]])
    return np.asarray(dense / np.linalg.norm(dense, axis=1)[:, None])


def traced(
    template: Template, part: Manifold, sphere: Sphere, progress: Progress | None
) -> tuple[list[TracedCut], list[str]]:
    """Find a template's cuts on an uncut part in one piece; warnings report omitted cuts."""
    places = sphere.places[part.vertices]
    topology = part.core.topology()
    loops = [np.asarray(loop["vertices"], dtype=np.int64) for loop in topology["loops"]]
    wide = [loop for loop, row in zip(loops, topology["loops"], strict=True) if row["length"] > _SMALL_LOOP] or loops
    is_border = np.zeros(len(part), dtype=np.bool_)
    for loop in loops:
        is_border[loop] = True
    corners = places[part.faces]
    edge = float(np.median(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)))
    astray = max(_ASTRAY, 4 * edge)
    is_open = ~is_border
    cuts: list[TracedCut] = []
    warnings = []
    names = {outline.name for outline in template.outlines}
    paths: dict[str, NDArray[np.int64]] = {}
    for cut in template.cuts:
        tips = np.flatnonzero(is_open)
        apart = np.linalg.norm(places[tips] - cut.points[-1], axis=1)
        tip = int(tips[apart.argmin()]) if len(tips) else -1
        if tip < 0 or apart.min() > max(edge, _ASTRAY / 2):
            warnings.append(f"the cut {cut.name!r} ends outside the flattened region and is omitted")
            continue
        is_root = np.zeros(len(part), dtype=np.bool_)
        if cut.root is None and not loops:
            is_root[int(np.linalg.norm(places - cut.points[0], axis=1).argmin())] = True
        elif cut.root is None or cut.root in names:
            is_root[_nearest_loop(wide, places, cut)] = True
        elif cut.root in paths:
            is_root[paths[cut.root]] = True
        else:
            warnings.append(f"the cut {cut.name!r} begins at {cut.root!r}, which is omitted, so it is also omitted")
            continue
        aside = _beside(cut, places, drawn_on=cut.root is not None)
        factors = np.minimum(1 + (aside / edge) ** 2, _STEEP)
        try:
            way = part.core.edge_path_to_any(tip, is_root, is_open, factors, progress).astype(np.int64)
        except InputError:
            raise InputError(
                f"the cut {cut.name!r} has no path from its tip to its root, because boundaries or other cuts lie "
                "between them. Exclude another region, or pass cuts='automatic'"
            ) from None
        if aside[way].max() > astray:
            aside_mm = 100 * min(float(aside[way].max()), _FAR)
            raise InputError(
                f"the cut {cut.name!r} would deviate from its line by {aside_mm:.0f} mm on a sphere of radius 100 mm, "
                "because an excluded region is in its way. Exclude another region, or pass cuts='automatic'"
            )
        vertices = way[::-1]
        steps = np.diff(part.points[vertices], axis=0)
        cuts.append(TracedCut(cut.name, vertices, float(np.linalg.norm(steps, axis=1).sum())))
        paths[cut.name] = vertices
        is_open[vertices] = False
    return cuts, warnings


def _nearest_loop(loops: list[NDArray[np.int64]], places: NDArray[np.float64], cut: Line) -> NDArray[np.int64]:
    """Return the boundary at which a cut begins, which is the boundary nearest to its line."""
    if not loops:
        raise InputError(
            f"the cut {cut.name!r} begins at {cut.root!r}, but the surface has no boundary there, because that region "
            "was not excluded. Exclude the region, or pass cuts='automatic'"
        )
    start = cut.points[: max(2, len(cut.points) // 3)]
    apart = [float(scipy.spatial.KDTree(places[loop]).query(start)[0].min()) for loop in loops]
    return loops[int(np.argmin(apart))]


def _beside(cut: Line, places: NDArray[np.float64], *, drawn_on: bool) -> NDArray[np.float64]:
    """Return the distance of points from a cut's line, which may be extended beyond its root."""
    points = cut.points
    if drawn_on:
        reach = max(_DIRECTION, np.linalg.norm(points[1] - points[0]))
        inwards = points[np.linalg.norm(points - points[0], axis=1) <= reach]
        back = points[0] - inwards[-1]
        back -= (back @ points[0]) * points[0]
        back /= max(float(np.linalg.norm(back)), 1e-12)
        angles = np.arange(_BEYOND, 0, -0.01)[:, None]
        points = np.concatenate([np.cos(angles) * points[0] + np.sin(angles) * back, points])
    return np.asarray(scipy.spatial.KDTree(_dense(points, _STEP)).query(places, distance_upper_bound=_FAR)[0])


def template_of(
    whole: Manifold, faces: NDArray[np.bool_], cuts: list[tuple[str, NDArray[np.int64]]], sphere: Sphere
) -> Template:
    """Create a template from the triangles that remain of a surface, and its cuts (names and paths of vertices)."""
    part = whole._with_core(whole.core.part_of_faces(faces))
    beyond = _beyond(whole, faces, sphere)
    outlines = []
    owner: dict[int, str] = {}
    for number, loop in enumerate(_directed_loops(part)):
        name = "outline" if number == 0 else f"outline {number + 1}"
        outlines.append(Line(name, beyond[part.vertices[loop]]))
        owner.update(dict.fromkeys(part.vertices[loop].tolist(), name))
    lines: list[Line] = []
    rest = list(cuts)
    while rest:
        for name, path in rest:
            ends = int(path[0]), int(path[-1])
            if ends[0] == ends[1] or len(path) < 2:
                raise InputError(f"the cut {name!r} is closed, but a template cannot contain loops around handles")
            if ends[0] in owner or ends[1] in owner:
                way = path if ends[0] in owner else path[::-1]
                root: str | None = owner[int(way[0])]
            elif not outlines and not lines:
                way, root = path, None
            else:
                continue
            lines.append(Line(name, sphere.places[way], root))
            for vertex in way.tolist():
                owner.setdefault(int(vertex), name)
            rest = [item for item in rest if item[0] != name]
            break
        else:
            raise InputError(
                f"the cut {rest[0][0]!r} begins neither at a boundary nor at another cut. Extend it to one of them"
            )
    return Template("", sphere.space, sphere.side, tuple(outlines), tuple(lines))


def _beyond(whole: Manifold, faces: NDArray[np.bool_], sphere: Sphere) -> NDArray[np.float64]:
    """Return points slightly outside the vertices at the boundary of the kept part, so that these lie inside."""
    corners = whole.vertices[whole.faces]
    towards = np.zeros_like(sphere.places)
    counts = np.zeros(len(towards))
    for chosen, sign in ((~faces, 1.0), (faces, -1.0)):  # away from the kept part if nothing was excluded
        middles = sphere.places[corners[chosen]].mean(axis=1)
        is_new = counts == 0
        for corner in corners[chosen].T:
            is_at = is_new[corner]
            np.add.at(towards, corner[is_at], sign * (middles[is_at] - sphere.places[corner[is_at]]))
            np.add.at(counts, corner[is_at], 1)
    moved = sphere.places + _ASIDE * towards / np.maximum(counts, 1)[:, None]
    return np.asarray(moved / np.linalg.norm(moved, axis=1)[:, None])


def _directed_loops(part: Manifold) -> list[NDArray[np.int64]]:
    """Return the boundaries except small holes, longest first, with the surface on their left."""
    faces = part.faces.astype(np.int64)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    keys = edges[:, 0] * len(part) + edges[:, 1]
    loops = sorted(part.core.topology()["loops"], key=lambda loop: -loop["length"])
    directed = []
    for loop in (loop for loop in loops if loop["length"] > _SMALL_LOOP):
        vertices = np.asarray(loop["vertices"], dtype=np.int64)
        if len(vertices) > 1 and vertices[0] == vertices[-1]:
            vertices = vertices[:-1]
        runs_with = bool(np.isin(vertices[0] * len(part) + vertices[1], keys))
        directed.append(vertices if runs_with else vertices[::-1])
    return directed
