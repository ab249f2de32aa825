"""How alike the standard maps of a mesh are at its densities, and how wrong they are at each.

    python docs/benchmarks/standard_maps.py fsaverage FOLDER...
    python docs/benchmarks/standard_maps.py fs_LR FOLDER...

FOLDER holds the files that `voxflat.standard_map` asks for: surfaces and spheres of all densities, and the published
flat maps. The positions of two maps are compared at the vertices of the coarser one, which are located on the sphere of
the finer one.
"""

import argparse
import logging
import time
from pathlib import Path

import numpy as np
from tables import DISTANCES, distance_cells, table

import voxflat
from voxflat.pipeline.standard_map import CUTS, mesh_file
from voxflat.surfaces.standard.sphere import in_triangles

DENSITIES = {"fsaverage": ("fsaverage5", "fsaverage6", "fsaverage"), "fs_LR": ("32k", "59k", "164k")}
APART = ("apart mm: median", "95 %", "99 %")
COLUMNS = ("density", "cuts", "side", "vertices", *APART, "flipped", "crossings", *DISTANCES, "CPU s")


def main():
    """Print the table, and fail if a triangle is flipped or the maps differ."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("mesh", choices=DENSITIES)
    parser.add_argument("folder", type=Path, nargs="+")
    parser.add_argument("--cuts", choices=CUTS, action="append", help="only these cuts")
    parser.add_argument("--side", choices=("left", "right"), action="append", help="only this hemisphere")
    options = parser.parse_args()
    logging.disable(logging.WARNING)
    rows = []
    for side in options.side or ("left", "right"):
        for cuts in options.cuts or CUTS:
            first = None
            for density in DENSITIES[options.mesh]:
                started = time.process_time()
                name = (options.mesh, density) if options.mesh == "fs_LR" else (density,)
                flat = voxflat.standard_map(*name, hemisphere=side, cuts=cuts, files=options.folder)
                seconds = time.process_time() - started
                sphere = mesh_file(options.mesh, density, side, "sphere", options.folder).points
                sphere = sphere / np.linalg.norm(sphere, axis=1)[:, None]
                apart = [np.nan] * 3
                if first is None:
                    first = flat, sphere
                else:
                    apart = np.nanquantile(differences(*first, flat, sphere), [0.5, 0.95, 0.99])
                triangles = flat.distortion.triangles
                cells = [density, cuts, side, str(len(flat)), *(f"{value:.2f}" for value in apart)]
                cells += [str(triangles.flipped), str(triangles.crossings), *distance_cells(flat.distortion)]
                rows.append([*cells, f"{seconds:.0f}"])
                print(rows[-1], flush=True)
    table(f"Standard maps of {options.mesh}", COLUMNS, rows)
    if any(row[COLUMNS.index("flipped")] != "0" for row in rows):
        raise SystemExit("triangles are flipped")


def differences(coarse, coarse_sphere, fine, fine_sphere):
    """Return how far apart the positions of the coarse map's vertices are on both maps."""
    places = coarse_sphere[coarse.ids]
    corners, weights, is_inside = in_triangles(fine_sphere[fine.ids], fine.faces, places)
    apart = np.linalg.norm(np.einsum("ij,ijk->ik", weights, fine.uv[corners]) - coarse.uv, axis=1)
    return apart[is_inside]


if __name__ == "__main__":
    main()
