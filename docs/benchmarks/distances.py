"""Measure distances: how right they are, beside the targets and beside peers on the same input in the same run.

    make bench-distances
    python docs/benchmarks/distances.py --only cortex,voxels

Peers: pygeodesic, potpourri3d, and Connectome Workbench if installed. Speed: `make bench`.
"""

import argparse
import os

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"  # read by numpy when it is imported

import anatomy
import distances_anatomy
import distances_meshes
import tables

SECTIONS = {
    "cortex": distances_meshes.cortex,
    "paths": distances_meshes.paths,
    "known": distances_meshes.known,
    "voxels": distances_anatomy.voxels,
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
    tables.run(SECTIONS, parser)


if __name__ == "__main__":
    main()
