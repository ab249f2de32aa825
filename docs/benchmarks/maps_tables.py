"""What the parts of `maps.py` share: jobs, judging, rows of tables."""

import sys

import anatomy
import maps_makers as makers
import numpy as np
from distances_tables import table

import voxflat

COLUMNS = (
    "map",
    "vertices",
    "wall s",
    "CPU s",
    "GiB",
    "all %",
    "≤ 30 mm %",
    "≤ 10 mm %",
    "stress-1",
    "edges %",
    "area: median, 95 %",
    "turned over",
    "covering",
    "crossings",
)
SHIPPED = "shipped"


def fsaverage5_disk(side, kind="white"):
    """Return the part of a hemisphere that its shipped flat map has, as points and faces, and the shipped places."""
    hemisphere = anatomy.fsaverage5(side)
    places, faces = hemisphere["flat"]
    used, faces = np.unique(faces, return_inverse=True)
    return hemisphere[kind][used], faces.reshape(-1, 3), places[used, :2]


def made_by(names, job, options):
    """Return the maps of makers, by their names; say of which there is none, and why."""
    made = {}
    for name in names:
        print(f"{name} ...", end=" ", file=sys.stderr, flush=True)
        try:
            made[name] = makers.make(name, job, options.limit, options.keep)
        except makers.NoMapError as error:
            print(f"{name}: {error}", flush=True)
    print(file=sys.stderr, flush=True)
    return made


def compared(points, faces, made, sources, **more):
    """Judge maps of a disk by exact distances over its triangles.

    `points`, `faces`: the disk. `made`: maps by their makers' names. `**more`: more places, by a name.
    """
    maps = {name: one.places for name, one in made.items()} | more
    return voxflat.compare((points, faces), maps, sources=sources, reference="exact")


def print_maps(title, comparison, made, note=""):
    """Print a table of judged maps and what they took."""
    rows = [[name, *cells(comparison[name], made.get(name))] for name in comparison.maps]
    table(title, COLUMNS, rows, note)


def cells(distortion, made=None):
    """Return the cells of a row of `COLUMNS` but for the first: figures at the best scale, with standard errors."""
    of, errors, triangles = distortion.best_scale, distortion.standard_error.best_scale, distortion.triangles
    costs = ["", "", ""]
    if made is not None:
        costs = [f"{made.wall:.1f}", f"{made.cpu:.1f}", f"{made.peak:.2f}"]
    names = ("relative_error", "relative_error_30mm", "relative_error_10mm")
    return [
        f"{len(distortion.per_point):,}",
        *costs,
        *(f"{100 * getattr(of, name):.2f} ± {100 * getattr(errors, name):.2f}" for name in names),
        f"{of.stress_1:.4f} ± {errors.stress_1:.4f}",
        f"{100 * triangles.edge:.2f}",
        f"{triangles.equal_area_median:.3f}, {triangles.equal_area_p95:.3f}",
        str(triangles.flipped),
        str(triangles.covering),
        str(triangles.crossings),
    ]
