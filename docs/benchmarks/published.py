"""Published surfaces of cerebellum, hippocampus and dentate gyrus as they are: what is mended, and how they flatten.

    make bench-published

The files are those of SUIT (suitpy 2.1.2, MIT) and of HippoMaps 0.1.17 (GPL 3), which `make` puts into a folder of
their own. They are read as data; neither package is imported, nor are its requirements installed. Every surface must
open, flatten without a triangle turned over, and keep the number of every vertex that a triangle has. No cuts are made
beside those that the surfaces come with. Maps that are published stand beside ours in `maps_published.py`.
"""

import argparse
import logging
import time
from pathlib import Path

import nibabel
import numpy as np
import tables
from maps_published import SUIT

import voxflat
from voxflat.errors import InputError

HIPPOCAMPUS = "hippomaps/resources/canonical_surfs"
DENSITIES = ("2mm", "1mm", "0p5mm", "unfoldiso")


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
            wrong.append(
                f"{name}: {len(missing)} vertex numbers are lost, {judged.triangles.flipped} triangles turned over"
            )
        rows.append(
            [
                name,
                f"{len(np.unique(faces)):,}",
                before,
                *(str(done.get(key, 0)) for key in ("dropped", "flipped")),
                *(str(len(done.get(key, []))) for key in ("merged", "split")),
                str(len(missing)),
                f"{100 * judged.best_scale.relative_error:.1f}",
                str(judged.triangles.flipped),
                str(judged.triangles.crossings),
                f"{seconds:.1f}",
            ]
        )
    columns = ["surface", "vertices", "without mending", "dropped", "flipped away", "merged", "split", "numbers lost"]
    tables.table("Eleven surfaces", [*columns, "error %", "turned over", "crossings", "wall s"], rows)
    return wrong


if __name__ == "__main__":
    main()
