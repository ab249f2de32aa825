"""Judge automatic relaxation cuts: beside those that fsaverage5's flat maps come with, and on whole closed hemispheres.

    python docs/benchmarks/maps_cuts.py [PICTURE]

`make bench-flatten` runs it, too. On fsaverage5 the medial wall is left out as the shipped map leaves it out, and
automatic cuts may be as long as the shipped ones. Each map is judged by the distances on its own cut surface; `uncut`
is its mean relative error against distances on the surface that lacks the medial wall only, between the same 300 points
and all others.
"""

import sys
import time
from functools import partial
from types import SimpleNamespace

import anatomy
import numpy as np
from tables import DISTANCES, SHAPES, distance_cells, shape_cells

import voxflat

SOURCES = 300
COLUMNS = ("surface", "cuts", "mm", "vertices", "wall s", "CPU s", *DISTANCES, "uncut %", *SHAPES)


def main():
    """Print the table, and draw the maps of the left hemisphere if a picture is named."""
    line(*COLUMNS)
    line(*("---" for _ in COLUMNS))
    drawn = {}
    for side in anatomy.SIDES:
        of = shipped(side)
        of.report("medial wall only", 0, of.cortex, relax=False)
        drawn[side, "shipped cuts"] = of.report("shipped", of.length, of.cut)
        drawn[side, "automatic cuts"] = of.report("automatic", None, of.cortex, relax=of.length)
        of.report("automatic, as long as it pays", None, of.cortex, relax=True)
    if len(sys.argv) > 1:
        draw({cuts: flat for (side, cuts), flat in drawn.items() if side == "left"}, sys.argv[1])
    for side in anatomy.SIDES:
        labels, affine, _ = anatomy.mni152_white_matter(side)
        surface = voxflat.surface(labels, affine=affine, repair="voxels")
        for name, relax in (("one line", False), ("automatic", None)):
            report(f"MNI152 white matter {side}, whole", None, name, None, surface, relax=relax)


def shipped(side):
    """Return a hemisphere without its medial wall, what its shipped map has of it, the cuts' length, and `report`.

    The map leaves out the medial wall and strips along its cuts. The wall: left-out vertices among left-out ones, and
    their left-out neighbours. The length, mm, is half of what cuts add to the boundary.
    """
    hemisphere = anatomy.fsaverage5(side)
    points, faces, flat = hemisphere["white"], hemisphere["faces"], hemisphere["flat"][1]
    left_out = np.ones(len(points), dtype=bool)
    left_out[flat] = False
    ends = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    inside = left_out.copy()
    inside[ends[~left_out[ends[:, 1]], 0]] = False
    wall = inside.copy()
    wall[ends[inside[ends[:, 1]], 0]] = True
    wall &= left_out
    surface = voxflat.surface((points, faces))
    cortex = surface.drop(wall)
    length = (around(points, flat) - around(points, faces[~wall[faces].any(axis=1)])) / 2
    chosen = np.random.default_rng(0).choice(np.unique(flat), SOURCES, replace=False)
    of_side = partial(report, f"fsaverage5 white {side}", cortex.geodesic(np.sort(chosen)))
    return SimpleNamespace(cortex=cortex, cut=surface.keep((points, flat)), length=length, report=of_side)


def around(points, faces):
    """Return the length of the boundary, mm."""
    return float(np.linalg.norm(np.diff(points[anatomy.border(faces)], axis=1), axis=2).sum())


def error_on(rows, flat):
    """Return the mean relative error of a map against given distances, at its best scale."""
    places = np.full((rows.ids.max() + 1, 2), np.nan)
    places[flat.ids[::-1]] = flat.uv[::-1]  # of the two sides of a cut the first
    places = places[rows.ids]
    delta = np.asarray(rows, dtype=float)
    apart = np.linalg.norm(places[rows.sources][:, None] - places[None], axis=2)
    known = (delta > 0) & (apart > 0)
    ratio, weight = delta[known] / apart[known], apart[known] / delta[known]
    order = ratio.argsort()
    total = weight[order].cumsum()
    scale = ratio[order[np.searchsorted(total, total[-1] / 2)]]
    return float(np.abs(scale * weight - 1).mean())


def report(surface_name, uncut, cuts, length, surface, /, **how):
    """Make a map, print a row, and return the map; `uncut`: distances on the surface without cuts."""
    wall, cpu = time.monotonic(), time.process_time()
    flat = voxflat.flatten(surface, **how)
    wall, cpu = time.monotonic() - wall, time.process_time() - cpu
    if length is None:
        length = sum(cut["length"] for cut in flat.metadata["automatic_cuts"])
    against = "" if uncut is None else f"{100 * error_on(uncut, flat):.2f}"
    made = surface_name, cuts, f"{length:.0f}", len(flat), f"{wall:.1f}", f"{cpu:.1f}"
    line(*made, *distance_cells(flat.distortion), against, *shape_cells(flat.distortion))
    return flat


def line(*cells):
    """Print a row as soon as there is one."""
    print("|", *(f"{cell} |" for cell in cells), flush=True)


def draw(maps, path):
    """Draw maps side by side: how much areas are distorted, and the outline that the cuts make."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(maps), figsize=(6 * len(maps), 5.2), layout="constrained")
    for axis, (name, flat) in zip(axes, maps.items(), strict=True):
        values = 100 * flat.distortion.per_point
        drawn = axis.tripcolor(*flat.uv.T, flat.faces, values, shading="gouraud", cmap="magma", vmin=0, vmax=25)
        border = flat.uv[anatomy.border(flat.faces)]
        axis.plot(*np.moveaxis(border, 2, 0).transpose(0, 2, 1), color="black", linewidth=1)
        error = 100 * flat.distortion.best_scale.relative_error
        axis.set_title(f"fsaverage5 white left, {name}: mean error {error:.1f} %", fontsize=10)
        axis.set_aspect("equal")
        axis.set_axis_off()
    figure.colorbar(drawn, ax=axes, label="mean relative error of distances from a point, %", shrink=0.8)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
