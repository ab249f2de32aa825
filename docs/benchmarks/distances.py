"""Measure distances: how right and how fast, beside the targets and beside peers on the same input in the same run.

    make bench-distances
    python docs/benchmarks/distances.py --only cortex,rows

Times are CPU and wall time, medians of repetitions that take turns, of one thread unless said: compare ratios,
machines differ. Peers: pygeodesic, potpourri3d, navis-fastcore, scipy, and Connectome Workbench if installed.
"""

import argparse
import os

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"  # read by numpy when it is imported

import anatomy
import distances_anatomy
import distances_meshes
import distances_rows
import distances_sheets
import distances_speed
import distances_tables

SECTIONS = {
    "cortex": distances_meshes.cortex,
    "paths": distances_meshes.paths,
    "known": distances_meshes.known,
    "voxels": distances_anatomy.voxels,
    "sheets": distances_sheets.sheets,
    "balls": distances_sheets.balls,
    "maps": distances_sheets.maps,
    "rows": distances_rows.few,
    "many": distances_rows.many,
    "meshes": distances_speed.meshes,
    "growth": distances_speed.growth,
}


def main():
    """Run the sections that are asked for, and say what is not met."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", help=f"sections, with commas between: {', '.join(SECTIONS)}")
    parser.add_argument("--sources", type=int, default=200, help="sources a surface of cortex")
    parser.add_argument("--paths", type=int, default=20, help="exact paths a surface")
    parser.add_argument("--sides", nargs="+", default=list(anatomy.SIDES), choices=anatomy.SIDES)
    parser.add_argument("--spacings", nargs="+", type=float, default=list(anatomy.SPACINGS), help="of voxels, mm")
    parser.add_argument("--voxel-sources", type=int, default=50, help="sources a voxelised hemisphere")
    parser.add_argument("--targets", type=int, default=20_000, help="targets a voxelised hemisphere")
    parser.add_argument("--orientations", type=int, default=20, help="of curled sheets")
    parser.add_argument("--maps", type=int, default=5, help="flat maps of curled sheets")
    parser.add_argument("--sizes", nargs="+", default=list(distances_rows.RADII), choices=distances_rows.RADII)
    parser.add_argument("--rounds", type=int, default=5, help="repetitions of what is timed")
    parser.add_argument("--meshes", nargs="+", default=list(distances_speed.MESHES), choices=distances_speed.MESHES)
    distances_tables.run(SECTIONS, parser)


if __name__ == "__main__":
    main()
