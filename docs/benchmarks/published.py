"""Repair and flatten published surfaces of the cerebellum, the hippocampus and the dentate gyrus.

    make bench-published

The files are from SUIT (suitpy 2.1.2, MIT) and HippoMaps 0.1.17 (GPL 3). `make` installs them into a separate folder;
they are read as data, and neither package is imported. Each surface must open, flatten without flipped triangles, and
keep the number of each vertex of a triangle. No cuts are added to those of the surfaces. `maps.py --only published`
compares published maps with those of voxflat.
"""

import argparse
import logging
import time
from pathlib import Path

import nibabel
import numpy as np
from maps_peers import SHIPPED, compared, fsaverage5_disk, made_by
from tables import DISTANCES, misses, table

import voxflat
from voxflat.errors import InputError
from voxflat.surfaces.parts import largest_piece

SUIT = "SUITPy/surfaces"
HIPPOCAMPUS = "hippomaps/resources/canonical_surfs"
DENSITIES = ("2mm", "1mm", "0p5mm", "unfoldiso")
KINDS = ("white", "mid", "pial")
AHEAD = 5.0
"""Percentage by which each figure of the default map must be lower than that of the published map."""


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="where suitpy and HippoMaps are installed")
    parser.add_argument("--sources", type=int, default=100, help="sources of the evaluation")
    options = parser.parse_args()
    logging.disable(logging.WARNING)
    wrong = surfaces(options)
    if wrong:
        raise SystemExit("\n".join(wrong))


def files(folder):
    found = {f"SUIT {name}": folder / SUIT / f"{name}.surf.gii" for name in ("PIAL_SUIT", "WHITE_SUIT", "FLAT")}
    for label in ("hipp", "dentate"):
        for density in DENSITIES:
            name = f"tpl-avg_space-canonical_den-{density}_label-{label}_midthickness.surf.gii"
            found[f"{label} {density}"] = folder / HIPPOCAMPUS / name
    return found


def surfaces(options):
    """Flatten each surface, and return the errors."""
    rows, wrong = [], []
    for name, path in files(options.folder).items():
        faces = nibabel.load(path).agg_data("triangle")
        try:
            voxflat.surface(path, repair="none")
            before = "opened"
        except InputError:
            before = "refused"
        whole = voxflat.surface(path)
        done = whole.metadata.get("mended", {})
        start = time.perf_counter()
        flat = voxflat.flatten(whole, relax=False)
        seconds = time.perf_counter() - start
        judged = voxflat.measure(whole, flat, sources=options.sources)
        missing = np.setdiff1d(faces, flat.ids)
        if len(missing) or judged.triangles.flipped:
            wrong.append(f"{name}: {len(missing)} vertex numbers lost, {judged.triangles.flipped} triangles flipped")
        mended = [done.get(key, 0) for key in ("dropped", "flipped")]
        mended += [len(done.get(key, [])) for key in ("merged", "split")]
        folds = (judged.triangles.flipped, judged.triangles.crossings)
        error = f"{100 * judged.best_scale.relative_error:.1f}"
        cells = [name, f"{len(np.unique(faces)):,}", before, *mended, len(missing), error, *folds, f"{seconds:.1f}"]
        rows.append(list(map(str, cells)))
    columns = ["surface", "vertices", "without repair", "dropped", "flipped away", "merged", "split", "numbers lost"]
    table("Eleven surfaces", [*columns, "error %", "flipped", "crossings", "wall s"], rows)
    return wrong


def suit_disk(folder, kind):
    """Return the points and faces of SUIT's cerebellum, and the points of its own flat map."""
    folder = folder / SUIT
    white, pial = (folder / f"{name}_SUIT.surf.gii" for name in ("WHITE", "PIAL"))
    surface = {"white": (white, None), "mid": (white, pial), "pial": (pial, None)}[kind]
    surface = voxflat.surface(surface[0], pial=surface[1])
    flat = voxflat.io.read_mesh(folder / "FLAT.surf.gii")
    return surface.points, surface.faces, flat.points[surface.vertices, :2]


def disks(options):
    """Yield the name, the points, the faces and the published map of each surface."""
    for side in options.sides:
        for kind in options.kinds:
            yield f"fsaverage5 {kind} {side}", *fsaverage5_disk(side, kind)
    if options.suit is not None:
        for kind in options.kinds:
            yield f"SUIT {kind}", *suit_disk(options.suit, kind)
    for path in options.more:
        with np.load(path) as file:
            surface = largest_piece(voxflat.surface((file["V"], file["F"])))
            yield path.stem, surface.points, surface.faces, file["flat"].astype(float)[surface.vertices]


def published(options):
    """Compare maps of the default method with published maps."""
    rows = []
    for name, points, faces, places in disks(options):
        job = {"points": points, "faces": faces, "options": {"relax": False}}
        made = made_by(["voxflat"], job, options)
        if not made:
            continue
        comparison = compared(points, faces, made, options.whole_sources, **{SHIPPED: places})
        both = [comparison["voxflat"], comparison[SHIPPED]]
        edges = [edge(points, faces, one, of) for one, of in zip((made["voxflat"].flat.uv, places), both, strict=True)]
        shown = zip(FIGURES.items(), zip(*map(figures, both, edges), strict=True), strict=True)
        cells = [ahead(f"{name}, {figure}", digits, *pair) for (figure, digits), pair in shown]
        ours, theirs = (one.triangles for one in both)
        counts = (f"{ours.flipped:,}, {theirs.flipped:,}", f"{ours.covering:,}, {theirs.covering:,}")
        rows.append([name, f"{len(points):,}", *cells, *counts])
    columns = ("surface", "vertices", *FIGURES, "flipped", "covering")
    table("Compared with published maps: voxflat, published (reduction, %)", columns, rows)


FIGURES = dict.fromkeys(DISTANCES, ".2f")
FIGURES |= {"stress-1": ".4f", "edges %": ".2f", "area: median": ".3f", "95 %": ".3f"}
"""Formats of the figures: each at the best scale of the map, areas at the scale that preserves the total area."""


def figures(distortion, edge):
    best, triangles = distortion.best_scale, distortion.triangles
    shares = (best.relative_error, best.relative_error_30mm, best.relative_error_10mm)
    areas = (triangles.equal_area_median, triangles.equal_area_p95)
    return (*(100 * share for share in shares), best.stress_1, 100 * edge, *areas)


def edge(points, faces, places, distortion):
    """Return the error of edges at the best scale for distances."""
    scaled = distortion.best_scale.scale * places
    return voxflat.measure((points, faces), scaled, sources=1, reference="graph").triangles.edge


def ahead(name, shown, ours, theirs):
    """Return a cell of two figures, and record a missed target."""
    better = 100 * (1 - ours / theirs)
    if better < AHEAD:
        misses.append(f"{name}: {better:.1f} % lower than that of the published map, target {AHEAD:g} %")
    return f"{ours:{shown}}, {theirs:{shown}} ({better:.1f})"


if __name__ == "__main__":
    main()
