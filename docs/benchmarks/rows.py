"""Time distance rows against navis-fastcore and scipy, on the same graph, in the same run.

    make bench

One row: CPU time of a whole call for one source. A further row: what each source beyond the first adds (what a peer
spends on building its own graph is left out). Short calls are timed some together. All take turns, and medians are
given: compare ratios, machines differ.
`distances.py` does the same at more sizes.
"""

import time

import navis_fastcore
import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from tables import machine
from tqdm import tqdm

from voxflat import _core

ROUNDS = 7
FURTHER = 8
LARGE = 200_000
"""Points from which on a call is timed alone; on fewer, as many calls together as take as long."""


def main():
    """Measure and print."""
    surface = bumpy_ball()
    points = len(surface)
    print(f"{points} surface voxels, {len(surface.csr[1]) / points:.1f} links a voxel")
    print(f"{machine()}\n")
    solvers = solvers_of(surface)
    for name, apart in check_equal(solvers, some_sources(points)[:2]).items():
        print(f"{name}: largest difference {apart:.1e} mm")
    first, further = compare(solvers, points)
    print(f"\n{'CPU time':16}{'one row':>12}{'further row':>14}{'a vertex':>12}{'one':>9}{'further':>9}")
    for name in solvers:
        cells = f"{1e3 * first[name]:>9.1f} ms{1e3 * further[name]:>11.1f} ms{1e9 * further[name] / points:>9.1f} ns"
        shares = f"{first['voxflat'] / first[name]:>9.2f}{further['voxflat'] / further[name]:>9.2f}"
        print(f"{name:16}{cells}{shares}")
    print("(last columns: voxflat's time as a share of it)\n")
    ratios, more = threads(surface)
    print(
        f"two threads, wall time of 64 rows: {np.median(ratios):.2f} times as fast as one "
        f"({min(ratios):.2f} to {max(ratios):.2f}), for {np.median(more):.2f} times the CPU time"
    )


def bumpy_ball(radius=133):
    """Return the surface of a ball with bumps, a little above 200,000 voxels."""
    axis = np.arange(-radius - 12, radius + 13, dtype=np.float32)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij", sparse=True)
    mask = np.sqrt(x**2 + y**2 + z**2) < radius + 8 * np.sin(x / 9) * np.sin(y / 9) * np.sin(z / 9)
    return _core.VoxelSurface.from_mask(mask, np.eye(4).tolist(), "chain-code").cut_out()


def solvers_of(surface):
    """Return functions from sources to rows by the name of their solver, all over the links of a surface."""
    points = len(surface)
    starts, neighbours, lengths = surface.csr
    graph = csr_matrix(
        (lengths.astype(float), neighbours.astype(np.int64), starts.astype(np.int64)), shape=(points,) * 2
    )
    ends = np.repeat(np.arange(points), np.diff(starts))
    once = ends < neighbours
    edges, weights = np.stack([ends[once], neighbours[once]], axis=1), lengths[once]

    def ours(sources):
        return surface.rows(sources, 1)

    def navis(sources):
        return navis_fastcore.geodesic_matrix_graph(edges, points, weights=weights, sources=sources, threads=1)

    def scipy(sources):
        return dijkstra(graph, indices=sources.astype(int))

    return {"voxflat": ours, "navis-fastcore": navis, "scipy": scipy}


def some_sources(points, count=FURTHER + 1):
    """Return the sources of which rows are timed."""
    return np.random.default_rng(0).choice(points, count, replace=False).astype(np.uint32)


def check_equal(solvers, sources):
    """Assert that all give the same rows, to the rounding of their number types; return the largest differences, mm."""
    expected = solvers["voxflat"](sources)
    apart = {}
    for name, solve in solvers.items():
        rows = np.asarray(solve(sources))
        np.testing.assert_allclose(rows, expected, rtol=1e-5, err_msg=name)
        apart[name] = np.abs(rows - expected).max()
    return apart


def compare(solvers, points, rounds=ROUNDS, more=FURTHER):
    """Return the CPU seconds of one row and of a further row, by name."""
    sources = some_sources(points, more + 1)
    calls = max(1, LARGE // points)
    one = {name: [] for name in solvers}
    many = {name: [] for name in solvers}
    for _ in tqdm(range(rounds), leave=False):
        for name, solve in solvers.items():
            one[name].append(cpu(solve, sources[:1], calls))
            many[name].append(cpu(solve, sources))
    first = {name: np.median(times) for name, times in one.items()}
    further = {name: np.median(np.subtract(many[name], one[name])) / more for name in solvers}
    return first, further


def cpu(solve, sources, calls=1):
    """CPU seconds of a call, all threads together: the mean of some calls in succession."""
    start = time.process_time()
    for _ in range(calls):
        solve(sources)
    return (time.process_time() - start) / calls


def threads(surface, rounds=ROUNDS):
    """Return, of pairs of calls, how much faster two threads make 64 rows (wall time), and their share of CPU time.

    On a small surface there are as many pairs as take as long as those of a large one.
    """
    sources = np.linspace(0, len(surface) - 1, 64).astype(np.uint32)
    ratios, more = [], []
    for _ in range(rounds * max(1, LARGE // len(surface))):
        walls, cpus = [], []
        for count in (1, 2):
            start = time.perf_counter(), time.process_time()
            surface.rows(sources, count)
            walls.append(time.perf_counter() - start[0])
            cpus.append(time.process_time() - start[1])
        ratios.append(walls[0] / walls[1])
        more.append(cpus[1] / cpus[0])
    return ratios, more


if __name__ == "__main__":
    main()
