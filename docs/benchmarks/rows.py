"""Time distance rows beside navis-fastcore and scipy, on the same graph, in the same run.

    make bench-rows

`one row` is the CPU time of a call with one source. `further row` is the time that each additional source adds, so it
excludes the time in which a peer builds its own graph. The solvers take turns; the figures are medians. Machines
differ, so compare ratios.
"""

import time
from functools import partial

import navis_fastcore
import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from tables import machine
from tqdm import tqdm

from voxflat import _core

ROUNDS = 7
FURTHER = 8


def main():
    """Measure and print."""
    surface = bumpy_ball()
    points = len(surface)
    print(f"{points} surface voxels, {len(surface.csr[1]) / points:.1f} links a voxel")
    print(f"{machine()}\n")
    solvers = solvers_of(surface)
    sources = np.random.default_rng(0).choice(points, FURTHER + 1, replace=False).astype(np.uint32)
    check_equal(solvers, sources[:2])
    first, further = compare(solvers, sources)
    print(f"\n{'CPU time':16}{'one row':>12}{'further row':>14}{'a vertex':>12}{'one':>9}{'further':>9}")
    for name in solvers:
        cells = f"{1e3 * first[name]:>9.1f} ms{1e3 * further[name]:>11.1f} ms{1e9 * further[name] / points:>9.1f} ns"
        shares = f"{first['voxflat'] / first[name]:>9.2f}{further['voxflat'] / further[name]:>9.2f}"
        print(f"{name:16}{cells}{shares}")
    print("(last columns: voxflat's time as a fraction of the solver's)")


def bumpy_ball(radius=133):
    """Return the surface of a ball with bumps: slightly more than 200,000 voxels."""
    axis = np.arange(-radius - 12, radius + 13, dtype=np.float32)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij", sparse=True)
    mask = np.sqrt(x**2 + y**2 + z**2) < radius + 8 * np.sin(x / 9) * np.sin(y / 9) * np.sin(z / 9)
    return _core.VoxelSurface.from_mask(mask, np.eye(4).tolist(), "chain-code").cut_out()


def solvers_of(surface):
    """Return a function from sources to rows for each solver. All use the links of the surface."""
    points = len(surface)
    starts, neighbours, lengths = surface.csr
    arrays = lengths.astype(float), neighbours.astype(np.int64), starts.astype(np.int64)
    graph = csr_matrix(arrays, shape=(points, points))
    ends = np.repeat(np.arange(points), np.diff(starts))
    once = ends < neighbours
    edges, weights = np.stack([ends[once], neighbours[once]], axis=1), lengths[once]

    navis = partial(navis_fastcore.geodesic_matrix_graph, edges, points, weights=weights, threads=1)
    return {
        "voxflat": lambda sources: surface.rows(sources, 1),
        "navis-fastcore": lambda sources: navis(sources=sources),
        "scipy": lambda sources: dijkstra(graph, indices=sources.astype(int)),
    }


def check_equal(solvers, sources):
    """Assert that all solvers agree up to rounding, and print the largest differences."""
    expected = solvers["voxflat"](sources)
    for name, solve in solvers.items():
        rows = np.asarray(solve(sources))
        np.testing.assert_allclose(rows, expected, rtol=1e-5, err_msg=name)
        print(f"{name}: largest difference {np.abs(rows - expected).max():.1e} mm")


def compare(solvers, sources):
    """Return the CPU seconds of one row and of a further row for each solver."""
    one, many = ({name: [] for name in solvers} for _ in range(2))
    for _ in tqdm(range(ROUNDS), leave=False):
        for name, solve in solvers.items():
            one[name].append(seconds(solve, sources[:1]))
            many[name].append(seconds(solve, sources))
    first = {name: np.median(times) for name, times in one.items()}
    further = {name: np.median(np.subtract(many[name], one[name])) / FURTHER for name in solvers}
    return first, further


def seconds(solve, sources):
    """Return the CPU seconds of a call, of all threads together."""
    start = time.process_time()
    solve(sources)
    return time.process_time() - start


if __name__ == "__main__":
    main()
