"""Measure distances: how right they are, beside the targets and beside peers on the same input in the same run.

    make bench-distances
    python docs/benchmarks/distances.py --only cortex,voxels

On meshes: real cortex against exact distances, spheres and rolls against the truth, paths; on voxels:
`distances_anatomy.py`. Peers: pygeodesic, potpourri3d, and Connectome Workbench if installed. Speed: `make bench`.
"""

import argparse
import os

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"  # read by numpy when it is imported

import anatomy
import distances_anatomy
import distances_solvers as solvers
import numpy as np
from scipy.spatial import Delaunay
from tables import errors, exponent, judged, run, table

import voxflat

SIZES = (640, 2560, 10240, 40960)
"""Vertices of the meshes whose truth is known."""

KNOWN_SOURCES = 10
WORKBENCH_SOURCES = 20

NAMES = tuple(f"voxflat {geodesic}" for geodesic in (*solvers.OURS, solvers.STRAIGHT_FRONTS))


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
        f"Both hemispheres, 10,242 vertices each, {options.sources} random sources a surface to all vertices"
        f" ({min(WORKBENCH_SOURCES, options.sources)} for Workbench), against `pygeodesic` (f64). voxflat's rows are"
        " f32, which holds a distance to 6e-8 of it.",
    )


def cortex_errors(points, faces, count):
    """Yield each solver's name and relative errors."""
    sources = np.random.default_rng(0).choice(len(points), count, replace=False)
    exact = solvers.exact(points, faces)
    true = np.array([exact(source) for source in sources])
    for name, rows in rows_of(points, faces, sources, solvers.PEERS):
        yield name, errors(rows, true)
    few = slice(WORKBENCH_SOURCES)
    found = solvers.workbench(points, faces, sources[few])
    if found is not None:
        yield "Workbench", errors(found, true[few])


def rows_of(points, faces, sources, peers):
    """Yield each solver's name and rows."""
    mine = solvers.Mine(points, faces)
    for geodesic in (*solvers.OURS, solvers.STRAIGHT_FRONTS):
        yield f"voxflat {geodesic}", mine.rows(sources, geodesic).astype(float)
    for name in peers:
        solve = solvers.PEERS[name](points, faces)
        yield name, np.array([solve(source) for source in sources])


def cortex_cells(kind, name, relative):
    """Format errors beside their targets."""
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
        f"{options.paths} random pairs a surface. A path of `marching` follows the front back; its length is its own.",
    )


def of_pair(surface, exact, a, b):
    """Return how far the lengths of exact paths and of links are from what they should be, and marching's excess."""
    sources = np.array([a], dtype=np.uint32)
    row = {kind: surface.core.rows(sources, geodesic=kind, threads=1)[0, b] for kind in ("exact", "graph")}
    path = {kind: surface.path(a, b, geodesic=kind) for kind in ("exact", "graph", "marching")}
    drawn = np.linalg.norm(np.diff(path["exact"].points, axis=0), axis=1).sum()
    true = exact(a)[b]
    ratios = drawn / row["exact"], drawn / true, path["exact"].length / true, path["graph"].length / row["graph"]
    return np.abs(np.array(ratios) - 1), path["marching"].length / true - 1


def known(options):
    """Compare with the truth on spheres and swiss rolls of several resolutions."""
    del options
    for title, make in (("Sphere", sphere), ("Swiss roll", swiss_roll)):
        found = {}
        sizes = []
        for size in SIZES:
            points, faces, truth = make(size)
            sources = np.random.default_rng(2).choice(len(points), KNOWN_SOURCES, replace=False)
            true = np.array([truth(source) for source in sources])
            far = true > true.max() / 4
            for name, distances in rows_of(points, faces, sources, list(solvers.PEERS)[:2]):
                found.setdefault(name, []).append(np.abs(distances[far] / true[far] - 1).mean())
            sizes.append(len(points))
        rows = []
        for name, means in found.items():
            order = -exponent(np.sqrt(sizes), means)
            limit = 1.0 if name in NAMES[:-1] else None
            cells = [f"{100 * mean:.3f}" for mean in means]
            rows.append([name, *cells, judged(order, ".2f", limit, f"{title}, {name}, order", least=True)])
        table(
            f"{title}: mean error against the truth, %, pairs farther than a quarter of the greatest distance",
            ["solver", *(f"{size:,} vertices" for size in sizes), "order in the mesh's width"],
            rows,
        )


def sphere(count, radius=50.0):
    """Make an irregular mesh of a sphere, a spiral of points, shaken; return true distances from a vertex as well."""
    rng = np.random.default_rng(3)
    height = 1 - (2 * np.arange(count) + 1) / count
    angle = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    flat = np.sqrt(1 - height**2)
    points = np.stack([flat * np.cos(angle), flat * np.sin(angle), height], axis=1)
    points += 0.3 * np.sqrt(4 * np.pi / count) * rng.uniform(-1, 1, points.shape)
    points *= radius / np.linalg.norm(points, axis=1, keepdims=True)

    def truth(source):
        across = np.linalg.norm(points - points[source], axis=1) / (2 * radius)
        return 2 * radius * np.arcsin(np.minimum(across, 1))

    return points, anatomy.outward_hull(points), truth


def swiss_roll(count, length=120.0, width=60.0):
    """Make an irregular mesh of a rectangle rolled up along a spiral; as `sphere`."""
    rng = np.random.default_rng(4)
    rows = int(np.sqrt(count * width / length))
    columns = count // rows
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"), axis=-1).astype(float)
    grid[1:-1, 1:-1] += rng.uniform(-0.35, 0.35, grid[1:-1, 1:-1].shape)
    plane = grid.reshape(-1, 2) * [length / (columns - 1), width / (rows - 1)]
    faces = Delaunay(grid.reshape(-1, 2)).simplices
    turn = np.linspace(1.5 * np.pi, 4.5 * np.pi, 1 << 16)
    along = np.cumsum(np.hypot(np.gradient(turn * np.cos(turn)), np.gradient(turn * np.sin(turn))))
    along = length * (along - along[0]) / (along[-1] - along[0])
    scale = length / np.hypot(np.diff(turn * np.cos(turn)), np.diff(turn * np.sin(turn))).sum()
    t = np.interp(plane[:, 0], along, turn)
    points = np.stack([scale * t * np.cos(t), scale * t * np.sin(t), plane[:, 1]], axis=1)
    return points, faces.astype(np.int64), lambda source: np.linalg.norm(plane - plane[source], axis=1)


SECTIONS = {"cortex": cortex, "paths": paths, "known": known, "voxels": distances_anatomy.voxels}


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
    run(SECTIONS, parser)


if __name__ == "__main__":
    main()
