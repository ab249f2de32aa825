"""Published surfaces of cerebellum, hippocampus and dentate gyrus as they are: what is mended, and how they flatten.

    make bench-published

The files are those of SUIT (suitpy 2.1.2, MIT) and of HippoMaps 0.1.17 (GPL 3), which `make` puts into a folder of
their own. They are read as data; neither package is imported, nor are its requirements installed. Every surface must
open, flatten without a triangle turned over, and keep the number of every vertex that a triangle has. No cuts are made
beside those that the surfaces come with. `maps.py --only published` puts maps that are published beside ours.
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

SUIT = "SUITPy/surfaces"
HIPPOCAMPUS = "hippomaps/resources/canonical_surfs"
DENSITIES = ("2mm", "1mm", "0p5mm", "unfoldiso")
KINDS = ("white", "mid", "pial")
AHEAD = 5.0
"""By which part, %, each figure of the default map is to be less than the published one's."""


def main():
    """Print the table of all surfaces."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="into which suitpy and HippoMaps were put")
    parser.add_argument("--sources", type=int, default=100, help="that maps are judged from")
    options = parser.parse_args()
    logging.disable(logging.WARNING)
    wrong = surfaces(options)
    if wrong:
        raise SystemExit("\n".join(wrong))


def files(folder):
    """Return the eleven files by their names."""
    found = {f"SUIT {name}": folder / SUIT / f"{name}.surf.gii" for name in ("PIAL_SUIT", "WHITE_SUIT", "FLAT")}
    for label in ("hipp", "dentate"):
        for density in DENSITIES:
            name = f"tpl-avg_space-canonical_den-{density}_label-{label}_midthickness.surf.gii"
            found[f"{label} {density}"] = folder / HIPPOCAMPUS / name
    return found


def surfaces(options):
    """Flatten each surface; return what is not as it must be."""
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
            told = f"{len(missing)} vertex numbers are lost, {judged.triangles.flipped} triangles turned over"
            wrong.append(f"{name}: {told}")
        mended = [done.get(key, 0) for key in ("dropped", "flipped")]
        mended += [len(done.get(key, [])) for key in ("merged", "split")]
        folds = (judged.triangles.flipped, judged.triangles.crossings)
        error = f"{100 * judged.best_scale.relative_error:.1f}"
        cells = [name, f"{len(np.unique(faces)):,}", before, *mended, len(missing), error, *folds, f"{seconds:.1f}"]
        rows.append(list(map(str, cells)))
    columns = ["surface", "vertices", "without mending", "dropped", "flipped away", "merged", "split", "numbers lost"]
    table("Eleven surfaces", [*columns, "error %", "turned over", "crossings", "wall s"], rows)
    return wrong


def suit_disk(folder, kind):
    """Return the cerebellum of SUIT, from the folder into which suitpy was put, and the places of its own flat map."""
    folder = folder / SUIT
    white, pial = (folder / f"{name}_SUIT.surf.gii" for name in ("WHITE", "PIAL"))
    surface = {"white": (white, None), "mid": (white, pial), "pial": (pial, None)}[kind]
    surface = voxflat.surface(surface[0], pial=surface[1])
    flat = voxflat.io.read_mesh(folder / "FLAT.surf.gii")
    return surface.points, surface.faces, flat.points[surface.vertices, :2]


def disks(options):
    """Yield each surface's name, points, faces and published places: what is installed, and files of one's own."""
    for side in options.sides:
        for kind in options.kinds:
            yield f"fsaverage5 {kind} {side}", *fsaverage5_disk(side, kind)
    if options.suit is not None:
        for kind in options.kinds:
            yield f"SUIT {kind}", *suit_disk(options.suit, kind)
    for path in options.more:
        with np.load(path) as file:
            yield path.stem, file["V"].astype(float), file["F"].astype(np.int64), file["flat"].astype(float)


def published(options):
    """Compare the default's maps with published ones, and note where they are not far enough ahead."""
    rows = []
    for name, points, faces, places in disks(options):
        made = made_by(["voxflat"], {"points": points, "faces": faces}, options)
        if not made:
            continue
        comparison = compared(points, faces, made, options.whole_sources, **{SHIPPED: places})
        both = [comparison["voxflat"], comparison[SHIPPED]]
        edges = [edge(points, faces, one, of) for one, of in zip((made["voxflat"].places, places), both, strict=True)]
        shown = zip(FIGURES.items(), zip(*map(figures, both, edges), strict=True), strict=True)
        cells = [ahead(f"{name}, {figure}", digits, *pair) for (figure, digits), pair in shown]
        ours, theirs = (one.triangles for one in both)
        counts = (f"{ours.flipped:,}, {theirs.flipped:,}", f"{ours.covering:,}, {theirs.covering:,}")
        rows.append([name, f"{len(points):,}", *cells, *counts])
    columns = ("surface", "vertices", *FIGURES, "turned over", "covering")
    table("Beside published maps: ours, theirs (by how much ours is less, %)", columns, rows)


FIGURES = dict.fromkeys(DISTANCES, ".2f")
FIGURES |= {"stress-1": ".4f", "edges %": ".2f", "area: median": ".3f", "95 %": ".3f"}
"""Each at the map's best scale, those of areas at the scale that keeps the whole; how they are shown."""


def figures(distortion, edge):
    """Return the figures of a map in the order of `FIGURES`."""
    best, triangles = distortion.best_scale, distortion.triangles
    shares = (best.relative_error, best.relative_error_30mm, best.relative_error_10mm)
    areas = (triangles.equal_area_median, triangles.equal_area_p95)
    return (*(100 * share for share in shares), best.stress_1, 100 * edge, *areas)


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


if __name__ == "__main__":
    main()
