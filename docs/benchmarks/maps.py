"""Compare flat maps of the default method and of other tools, with the same cuts, by exact distances.

    make bench-flatten
    python docs/benchmarks/maps.py --only fsaverage5,growth

Each map is made in a separate process; wall and CPU time, s, exclude reading the input. Machines differ, so compare
ratios. The other maps are those included in fsaverage5 and SUIT, ARAP and SLIM (libigl), and `autoflatten flatten`.
"""

import argparse
from pathlib import Path

import anatomy
import maps_growth
import maps_peers
import published
import tables

SECTIONS = {"published": published.published, "fsaverage5": maps_peers.fsaverage5, "whole": maps_peers.whole}
SECTIONS |= {"mni152": maps_peers.mni152, "growth": maps_growth.growth, "sheets": maps_growth.sheets}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", help=f"comma-separated sections: {', '.join(SECTIONS)}")
    parser.add_argument("--makers", nargs="+", default=list(maps_peers.TOOLS), choices=maps_peers.TOOLS)
    parser.add_argument("--sides", nargs="+", default=list(anatomy.SIDES), choices=anatomy.SIDES)
    parser.add_argument("--kinds", nargs="+", default=list(published.KINDS), choices=published.KINDS)
    parser.add_argument("--sources", type=int, default=300, help="sources of the evaluation of fsaverage5's maps")
    parser.add_argument("--suit", type=Path, help="where suitpy is installed, as by `make bench-published`")
    parser.add_argument("--more", nargs="*", type=Path, default=[], help=".npz files with V, F and flat")
    parser.add_argument("--whole", type=float, default=0.7, help="voxel size of the whole hemisphere, mm")
    evaluated = "sources of the evaluation of whole hemispheres and published maps"
    parser.add_argument("--whole-sources", type=int, default=100, help=evaluated)
    sheets = [30_000, 300_000, 900_000, 3_000_000]
    parser.add_argument("--sheets", nargs="+", type=int, default=sheets, help="numbers of vertices of the bent sheets")
    parser.add_argument(
        "--spacings", nargs="+", type=float, default=[1.35, 0.7, 0.6, 0.25], help="voxel sizes of growth, mm"
    )
    parser.add_argument("--limit", type=float, default=7200, help="maximal seconds per map")
    tables.run(SECTIONS, parser)


if __name__ == "__main__":
    main()
