"""Measure distances: how right and how fast, beside the targets and beside peers on the same input in the same run.

    make bench-distances
    python docs/benchmarks/distances.py --only cortex,rows

Times are CPU and wall time, medians of repetitions that take turns, of one thread unless said: compare ratios,
machines differ. Peers: pygeodesic, potpourri3d, navis-fastcore, scipy, and Connectome Workbench if installed.
"""

import argparse
import os
import platform
import time

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"  # read by numpy when it is imported

import distances_meshes
import distances_tables

SECTIONS = {
    "cortex": distances_meshes.cortex,
    "paths": distances_meshes.paths,
    "known": distances_meshes.known,
}


def main():
    """Run the sections that are asked for, and say what is not met."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", help=f"sections, with commas between: {', '.join(SECTIONS)}")
    parser.add_argument("--sources", type=int, default=200, help="sources a surface of cortex")
    parser.add_argument("--paths", type=int, default=20, help="exact paths a surface")
    options = parser.parse_args()
    chosen = options.only.split(",") if options.only else list(SECTIONS)
    if unknown := set(chosen) - set(SECTIONS):
        parser.error(f"unknown sections: {', '.join(sorted(unknown))}; there are {', '.join(SECTIONS)}")
    print(f"{machine()}, Python {platform.python_version()}")
    for name in chosen:
        start = time.perf_counter()
        SECTIONS[name](options)
        print(f"_{name}: {time.perf_counter() - start:.0f} s_", flush=True)
    missed = distances_tables.misses
    print("\n## " + (f"{len(missed)} targets missed" if missed else "All targets met") + "\n")
    print("\n".join(f"- {line}" for line in missed))


def machine():
    """Name the processor, its cores and the load."""
    try:
        with open("/proc/cpuinfo") as file:
            names = [line.split(":", 1)[1].strip() for line in file if line.startswith("model name")]
    except OSError:
        names = []
    load = f", load {os.getloadavg()[0]:.1f} at the start" if hasattr(os, "getloadavg") else ""
    return f"{names[0] if names else platform.processor()} ({platform.machine()}), {os.cpu_count()} cores{load}"


if __name__ == "__main__":
    main()
