"""Flat maps that surfaces come with, and the default's on the same vertices and cuts."""

import numpy as np
from maps_peers import SHIPPED, compared, fsaverage5_disk, made_by
from tables import misses, table

import voxflat

AHEAD = 5.0
"""By which part, %, each figure of the default map is to be less than the published one's."""

SUIT = "SUITPy/surfaces"
KINDS = ("white", "mid", "pial")


def suit_disk(folder, kind):
    """Return the cerebellum of SUIT, from the folder into which suitpy was put, and the places of its own flat map."""
    folder = folder / SUIT
    white, pial = (folder / f"{name}_SUIT.surf.gii" for name in ("WHITE", "PIAL"))
    surface = {"white": (white, None), "mid": (white, pial), "pial": (pial, None)}[kind]
    surface = voxflat.surface(surface[0], pial=surface[1])
    flat = voxflat.io.read_mesh(folder / "FLAT.surf.gii")
    return surface.points, surface.faces, flat.points[surface.vertices, :2]


def file_disk(path):
    """Return points, faces and places of a .npz file with V, F and flat."""
    with np.load(path) as file:
        return file["V"].astype(float), file["F"].astype(np.int64), file["flat"].astype(float)


def surfaces(options):
    """Yield each surface's name, points, faces and published places: what is installed, and files of one's own."""
    for side in options.sides:
        for kind in options.kinds:
            yield f"fsaverage5 {kind} {side}", *fsaverage5_disk(side, kind)
    if options.suit is not None:
        for kind in options.kinds:
            yield f"SUIT {kind}", *suit_disk(options.suit, kind)
    for path in options.more:
        yield path.stem, *file_disk(path)


def published(options):
    """Compare the default's maps with published ones, and note where they are not far enough ahead."""
    rows = []
    for name, points, faces, places in surfaces(options):
        made = made_by(["voxflat"], {"points": points, "faces": faces}, options)
        if not made:
            continue
        comparison = compared(points, faces, made, options.whole_sources, **{SHIPPED: places})
        judged = [comparison["voxflat"], comparison[SHIPPED]]
        edges = [edge(points, faces, one, of) for one, of in zip((made["voxflat"].places, places), judged, strict=True)]
        pairs = zip(*map(figures, judged, edges), strict=True)
        cells = [
            ahead(f"{name}, {figure}", shown, *pair)
            for (figure, shown), pair in zip(FIGURES.items(), pairs, strict=True)
        ]
        counts = (f"{ours:,}, {theirs:,}" for ours, theirs in zip(*map(faults, judged), strict=True))
        rows.append([name, f"{len(points):,}", *cells, *counts])
    columns = ("surface", "vertices", *FIGURES, "turned over", "covering")
    table("Beside published maps: ours, theirs (by how much ours is less, %)", columns, rows)


FIGURES = {
    "all %": ".2f",
    "≤ 30 mm %": ".2f",
    "≤ 10 mm %": ".2f",
    "stress-1": ".4f",
    "edges %": ".2f",
    "area: median": ".3f",
    "95 %": ".3f",
}
"""Each at the map's best scale, those of areas at the scale that keeps the whole; how they are shown."""


def figures(distortion, edge):
    """Return the figures of a map in the order of `FIGURES`."""
    best, triangles = distortion.best_scale, distortion.triangles
    shares = (best.relative_error, best.relative_error_30mm, best.relative_error_10mm)
    areas = (triangles.equal_area_median, triangles.equal_area_p95)
    return (*(100 * share for share in shares), best.stress_1, 100 * edge, *areas)


def faults(distortion):
    """Return how many triangles are turned over, and cover another one."""
    return distortion.triangles.flipped, distortion.triangles.covering


def edge(points, faces, places, distortion):
    """Return the edges' error at the scale that is best for distances."""
    scaled = distortion.best_scale.scale * places
    return voxflat.measure((points, faces), scaled, sources=1, reference="graph").triangles.edge


def ahead(name, shown, ours, theirs):
    """Return a cell of two figures; note them if ours is not far enough ahead."""
    better = 100 * (1 - ours / theirs)
    if better < AHEAD:
        misses.append(f"{name}: {better:.1f} % less than the published map's, target {AHEAD:g}")
    return f"{ours:{shown}}, {theirs:{shown}} ({better:.1f})"
