"""Compare the accuracy of distances with targets and with other tools, on the same input.

    make bench-distances
    python docs/benchmarks/distances.py --only cortex,voxels

On meshes, distances and paths on real cortex are compared with exact distances; for voxels, see `distances_anatomy.py`.
The other tools are pygeodesic, potpourri3d and, if installed, Connectome Workbench. `make bench-rows` measures speed.
"""

import argparse
import os

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"  # read by numpy when it is imported

import anatomy
import distances_anatomy
import distances_solvers as solvers
import numpy as np
from tables import errors, judged, run, table

import voxflat

WORKBENCH_SOURCES = 20


def cortex(options):
    """Compare all solvers with pygeodesic on the cortex of fsaverage5."""
    rows = []
    for kind in ("pial", "white"):
        gathered = {}
        for side in anatomy.SIDES:
            mesh = anatomy.fsaverage5(side)
            for name, relative in cortex_errors(mesh[kind], mesh["faces"], options.sources):
                gathered.setdefault(name, []).append(relative)
        for name, relative in ((name, np.concatenate(parts)) for name, parts in gathered.items()):
            rows.append([kind, name, f"{len(relative):,}", *cortex_cells(kind, name, relative)])
    table(
        "Cortex: errors against exact distances",
        ["fsaverage5", "solver", "pairs", "mean error, %", "99th percentile, %", "bias, %", "greatest"],
        rows,
        f"Both hemispheres, 10,242 vertices each, {options.sources} random sources per surface, to all vertices"
        f" ({min(WORKBENCH_SOURCES, options.sources)} for Workbench), against `pygeodesic` (f64). voxflat's rows are"
        " f32, so they are rounded by up to 6e-8 of a distance.",
    )


def cortex_errors(points, faces, count):
    """Yield the name and the relative errors of each solver."""
    sources = np.random.default_rng(0).choice(len(points), count, replace=False)
    exact = solvers.exact(points, faces)
    true = np.array([exact(source) for source in sources])
    ours = solvers.ours(points, faces)
    for geodesic in (*solvers.OURS, solvers.STRAIGHT_FRONTS):
        yield f"voxflat {geodesic}", errors(ours(sources, geodesic).astype(float), true)
    for name, peer in solvers.PEERS.items():
        solve = peer(points, faces)
        yield name, errors(np.array([solve(source) for source in sources]), true)
    few = slice(WORKBENCH_SOURCES)
    found = solvers.workbench(points, faces, sources[few])
    if found is not None:
        yield "Workbench", errors(found, true[few])


def cortex_cells(kind, name, relative):
    """Format errors with their targets."""
    mean, high = 100 * np.abs(relative).mean(), 100 * np.percentile(np.abs(relative), 99)
    limits = {"voxflat graph": (0.5, 2.0), "voxflat marching": (2.0, None)}.get(name, (None, None))
    bias, greatest = 100 * relative.mean(), np.abs(relative).max()
    if name == "voxflat exact":
        most = judged(greatest, ".0e", 1e-6, f"{kind}, {name}, greatest error")
        return [f"{mean:.0e}", f"{high:.0e}", f"{bias:+.0e}", most]
    cells = [
        judged(value, ".2f", limit, f"{kind}, {name}, {what}, %")
        for value, limit, what in zip((mean, high), limits, ("mean error", "99th percentile"), strict=True)
    ]
    return [*cells, f"{bias:+.2f}", f"{100 * greatest:.0f} %"]


def paths(options):
    """Compare the lengths of traced paths with the distances, and with pygeodesic's."""
    rows = []
    rng = np.random.default_rng(1)
    for side in anatomy.SIDES:
        mesh = anatomy.fsaverage5(side)
        for kind in ("pial", "white"):
            points, faces = mesh[kind], mesh["faces"]
            surface = voxflat.surface((points, faces))
            exact = solvers.exact(points, faces)
            pairs = rng.choice(len(points), (options.paths, 2)).tolist()
            apart, longer = zip(*(of_pair(surface, exact, a, b) for a, b in pairs), strict=True)
            others = ("its row", "pygeodesic", "its length", "the row of links")
            checks = zip(np.max(apart, axis=0), others, strict=True)
            cells = [judged(value, ".0e", 1e-6, f"{kind} {side}, path, {against}") for value, against in checks]
            rows.append([f"{side} {kind}", *cells, f"{100 * np.mean(longer):.2f} ({100 * np.max(longer):.2f})"])
    table(
        "Paths: the greatest relative difference of their lengths",
        [
            "fsaverage5",
            "`exact`: polyline to voxflat's row (f32)",
            "polyline to pygeodesic",
            "`.length` to pygeodesic",
            "`graph`: `.length` to its row",
            "`marching`: longer than pygeodesic's, % (greatest)",
        ],
        rows,
        f"{options.paths} random pairs per surface. A path of `marching` follows the front; its length is its own.",
    )


def of_pair(surface, exact, a, b):
    """Return the relative errors of the lengths of exact paths and links, and the excess length of marching."""
    sources = np.array([a], dtype=np.uint32)
    row = {kind: surface.core.rows(sources, geodesic=kind, threads=1)[0, b] for kind in ("exact", "graph")}
    path = {kind: surface.path(a, b, geodesic=kind) for kind in ("exact", "graph", "marching")}
    drawn = np.linalg.norm(np.diff(path["exact"].points, axis=0), axis=1).sum()
    true = exact(a)[b]
    ratios = drawn / row["exact"], drawn / true, path["exact"].length / true, path["graph"].length / row["graph"]
    return np.abs(np.array(ratios) - 1), path["marching"].length / true - 1


SECTIONS = {"cortex": cortex, "paths": paths, "voxels": distances_anatomy.voxels}


def main():
    """Run the requested sections, and list the targets that are missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", help=f"comma-separated sections: {', '.join(SECTIONS)}")
    parser.add_argument("--sources", type=int, default=200, help="sources per surface")
    parser.add_argument("--paths", type=int, default=20, help="paths per surface")
    parser.add_argument("--sides", nargs="+", default=list(anatomy.SIDES), choices=anatomy.SIDES)
    parser.add_argument("--spacings", nargs="+", type=float, default=list(anatomy.SPACINGS), help="voxel sizes, mm")
    parser.add_argument("--voxel-sources", type=int, default=50, help="sources per voxelised hemisphere")
    parser.add_argument("--targets", type=int, default=20_000, help="targets per voxelised hemisphere")
    run(SECTIONS, parser)


if __name__ == "__main__":
    main()
