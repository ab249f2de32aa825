"""Maps of voxflat and other tools on the same patches with the same cuts."""

import sys

import anatomy
import numpy as np
from tables import BANDS, DISTANCES, SHAPES, distance_cells, shape_cells, table

import voxflat
from voxflat.benchmark.making import make
from voxflat.benchmark.tools import GIVEN, NoMapError

TOOLS = {"voxflat": "voxflat", "ARAP": "arap", "SLIM": "slim", "autoflatten": "autoflatten"}
"""The tools of the benchmark by the names in the tables."""

SHIPPED = "shipped"
COLUMNS = ("map", "vertices", "wall s", "CPU s", "GiB", *DISTANCES, *SHAPES, "crossings")


def fsaverage5(options):
    for side in options.sides:
        for kind in options.kinds:
            points, faces, shipped = fsaverage5_disk(side, kind)
            job = {"points": points, "faces": faces, "options": {"track": GIVEN}}
            made = made_by(options.makers, job, options)
            comparison = compared(points, faces, made, options.sources, **{SHIPPED: shipped})
            print_maps(f"fsaverage5 {kind} {side}", comparison, made)


def whole(options):
    hemisphere = anatomy.fsaverage5("left")
    labels, affine, _ = anatomy.voxelise(hemisphere["white"], hemisphere["faces"], options.whole)
    title = f"fsaverage5 white left, voxels of {options.whole} mm, whole"
    cut_open(title, {"labels": labels, "affine": affine}, options)


def mni152(options):
    points, faces = anatomy.mni152_marching_cubes("left")
    cut_open("MNI152 white matter left, marching cubes, whole", {"points": points, "faces": faces}, options)


def cut_open(title, job, options):
    """Compare maps of a closed surface that voxflat cuts open."""
    ours = made_by(["voxflat"], job, options)
    if not ours:
        return
    flat = ours["voxflat"].flat
    points, faces = flat.points, flat.faces.astype(np.int64)
    peers = [name for name in options.makers if name != "voxflat"]
    made = ours | made_by(peers, {"points": points, "faces": faces}, options)
    note = "voxflat's time includes the cuts and, for voxels, the surface; the other tools start from these."
    print_maps(title, compared(points, faces, made, options.whole_sources), made, note)


def fsaverage5_disk(side, kind="white"):
    """Return points and faces of the part of a hemisphere that its shipped flat map covers, and the shipped map."""
    hemisphere = anatomy.fsaverage5(side)
    places, faces = hemisphere["flat"]
    used, faces = np.unique(faces, return_inverse=True)
    return hemisphere[kind][used], faces.reshape(-1, 3), places[used, :2]


def made_by(names, job, options):
    """Return the map of each maker, and print why a map is missing."""
    made = {}
    for name in names:
        print(f"{name} ...", end=" ", file=sys.stderr, flush=True)
        try:
            made[name] = make(TOOLS[name], job, options.limit)
        except NoMapError as error:
            print(f"{name}: {error}", flush=True)
    print(file=sys.stderr, flush=True)
    return made


def compared(points, faces, made, sources, **more):
    """Evaluate the maps of a disk, and more maps by name, by exact distances."""
    maps = {name: one.flat.uv for name, one in made.items()} | more
    return voxflat.compare((points, faces), maps, sources=sources, reference="exact", bands=BANDS)


def print_maps(title, comparison, made, note=""):
    rows = [[name, *cells(comparison[name], made.get(name))] for name in comparison.maps]
    table(title, COLUMNS, rows, note)


def cells(distortion, made=None):
    """Return the cells of a row, without the first: figures at the best scale, with standard errors."""
    deviation = distortion.standard_error.best_scale
    costs = ("", "", "") if made is None else (f"{made.wall:.1f}", f"{made.cpu:.1f}", f"{made.peak:.2f}")
    pairs = zip(distance_cells(distortion), distance_cells(distortion, deviation), strict=True)
    stress, *shapes = shape_cells(distortion)
    return [
        f"{len(distortion.per_point):,}",
        *costs,
        *(" ± ".join(pair) for pair in pairs),
        f"{stress} ± {deviation.stress_1:.4f}",
        *shapes,
        str(distortion.triangles.crossings),
    ]
