"""Judge flat maps: the default method beside its peers on the same cuts, by exact distances from the same sources.

    make bench-flatten
    python docs/benchmarks/maps.py --only fsaverage5,growth

Every map is made in a process of its own; wall and CPU time, s, are without reading input. Compare ratios, machines
differ. Peers: the flat maps that fsaverage5 and SUIT's cerebellum come with, ARAP and SLIM (libigl), `autoflatten
flatten`.
"""

import argparse
from pathlib import Path

import anatomy
import maps_growth
import maps_makers
import maps_peers
import published
import tables

SECTIONS = {"published": published.published, "fsaverage5": maps_peers.fsaverage5, "whole": maps_peers.whole}
SECTIONS |= {"mni152": maps_peers.mni152, "growth": maps_growth.growth, "sheets": maps_growth.sheets}


def main():
    """Run the sections that are asked for, and say what is not met."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", help=f"sections, with commas between: {', '.join(SECTIONS)}")
    parser.add_argument("--makers", nargs="+", default=list(maps_makers.MAKERS), choices=maps_makers.MAKERS)
    parser.add_argument("--sides", nargs="+", default=list(anatomy.SIDES), choices=anatomy.SIDES)
    parser.add_argument("--kinds", nargs="+", default=list(published.KINDS), choices=published.KINDS)
    parser.add_argument("--sources", type=int, default=300, help="that maps of fsaverage5 are judged from")
    parser.add_argument("--suit", type=Path, help="into which suitpy was put, as `make bench-published` does")
    parser.add_argument("--more", nargs="*", type=Path, default=[], help=".npz files with V, F and flat")
    parser.add_argument("--whole", type=float, default=0.7, help="voxels of the whole hemisphere, mm")
    judged = "that maps of whole hemispheres and published ones are judged from"
    parser.add_argument("--whole-sources", type=int, default=100, help=judged)
    sheets = [30_000, 300_000, 900_000, 3_000_000]
    parser.add_argument("--sheets", nargs="+", type=int, default=sheets, help="vertices of bent sheets")
    parser.add_argument("--spacings", nargs="+", type=float, default=[1.35, 0.7, 0.6, 0.25], help="of growth, mm")
    parser.add_argument("--limit", type=float, default=7200, help="seconds that a map may take")
    parser.add_argument("--keep", type=Path, help="directory where maps are kept; those there are not made anew")
    tables.run(SECTIONS, parser)


if __name__ == "__main__":
    main()
