"""Speed on voxels: rows over the 26-neighbour graph, few and many, against navis-fastcore and scipy."""

import time

import numpy as np
import rows as bench
from distances_tables import judged, measured, seconds, table

RADII = {"20k": 42, "200k": 133, "1M": 294}
"""Of bumpy balls, voxels."""

ROUNDS = {"20k": 7, "200k": 3, "1M": 1}
"""Repetitions of 4,000 rows, at most."""

WHOLE = ("20k",)
"""Of which navis-fastcore makes all 4,000 rows as well."""

ALL = 4000
HELD = 1000
"""Sources of which the rows of a million voxels are held at a time: 4 GB."""

_surfaces = {}


def ball(name):
    """Return a bumpy ball's surface; made once."""
    if name not in _surfaces:
        _surfaces[name] = bench.bumpy_ball(RADII[name])
    return _surfaces[name]


def few(options):
    """Time one row, further rows, and two threads."""
    lines = []
    for size in options.sizes:
        surface = ball(size)
        points = len(surface)
        solvers = bench.solvers_of(surface)
        bench.check_equal(solvers, bench.some_sources(points)[:2])
        first, further = bench.compare(solvers, points, options.rounds, 64 if points < 100_000 else bench.FURTHER)
        for name in solvers:
            measured[f"a row by {name.replace('voxflat', 'voxflat chain')}"][points] = further[name]
            mine = name == "voxflat"
            ratios = [
                ""
                if mine
                else judged(taken[name] / taken["voxflat"], ".2f", limit, f"{size} voxels, {what}", least=True)
                for taken, what in ((first, "one row"), (further, "a further row"))
                for limit in [2.5 if name == "navis-fastcore" else None]
            ]
            lines.append(
                [
                    f"{points:,}",
                    name,
                    seconds(first[name]),
                    seconds(further[name]),
                    f"{1e9 * further[name] / points:.0f} ns",
                    *ratios,
                ]
            )
        ratios, more = bench.threads(surface, options.rounds)
        two = judged(np.median(ratios), ".2f", 1.9, f"{size} voxels, two threads", least=True)
        spent = f"for {np.median(more):.2f} times the CPU time"
        lines.append([f"{points:,}", "voxflat, two threads beside one", "", "", "", two, spent])
    table(
        "Rows over the 26-neighbour graph of a bumpy ball, CPU time, one thread",
        ["voxels", "solver", "one row", "a further row", "a vertex", "voxflat faster: one row", "a further row"],
        lines,
        "The same graph for all, rows asserted equal. A further row: what each source beyond the first adds. Two"
        " threads: wall time of 64 rows; on a machine that others use they get less than two cores.",
    )


def many(options):
    """Time 4,000 rows."""
    lines = []
    for size in options.sizes:
        surface = ball(size)
        points = len(surface)
        solvers = bench.solvers_of(surface)
        sources = np.random.default_rng(6).choice(points, ALL, replace=False).astype(np.uint32)
        held = min(ALL, HELD if points > 500_000 else ALL)
        counts = [count for count in (1, 4, 16, 64, 256, 1000, ALL) if count <= held]
        rows = surface.rows(sources[:held], 1)[:: held // 4].copy()  # a view would keep them all
        check = np.asarray(solvers["navis-fastcore"](sources[:held][:: held // 4]))
        np.testing.assert_allclose(rows, check, rtol=1e-5, err_msg="bundled rows are navis-fastcore's")
        times = {count: spent(surface, sources[:count]) for count in counts[:-1]}
        firsts, furthers, wholes, peers = [], [], [], []
        for _ in range(min(ROUNDS[size], options.rounds)):
            first, further = bench.compare({"navis-fastcore": solvers["navis-fastcore"]}, points, 1)
            firsts.append(first["navis-fastcore"])
            furthers.append(further["navis-fastcore"])
            if size in WHOLE:
                peers.append(bench.cpu(solvers["navis-fastcore"], sources))
            wholes.append(spent(surface, sources[:held]))
        first, further = np.median(firsts), np.median(furthers)
        times[held] = np.median(wholes, axis=0)
        peer = np.median(peers) if peers else first + (ALL - 1) * further
        for count in counts:
            measured[f"m rows of {size} voxels by voxflat"][count] = times[count][0]
            measured[f"m rows of {size} voxels by navis-fastcore"][count] = first + (count - 1) * further
        whole, wall = times[held]
        batches = ALL // held
        ours = batches * whole
        ratio = judged(peer / ours, ".2f", 10 if points < 100_000 else 5, f"{size} voxels, 4,000 rows", least=True)
        lines.append(
            [
                f"{points:,}",
                f"{batches} x {held:,}" if batches > 1 else f"{ALL:,}",
                f"{seconds(ours)} ({seconds(batches * wall)})",
                f"{1e9 * whole / held / points:.1f} ns",
                seconds(peer),
                ratio,
            ]
        )
    table(
        "4,000 rows over the 26-neighbour graph, CPU time, one thread",
        [
            "voxels",
            "rows in memory at a time",
            "voxflat in all (wall)",
            "a vertex and source",
            "navis-fastcore",
            "voxflat faster",
        ],
        lines,
        "navis-fastcore: at 20k all 4,000 rows, beyond one row and 3,999 times a further row, for each of its rows"
        " costs the same (medians of "
        + ", ".join(f"{min(ROUNDS[size], options.rounds)} at {size}" for size in options.sizes)
        + ")."
        f" Of a million voxels 4,000 rows are 16 GB: {HELD:,} are made at a time, four times. One batch is measured.",
    )


def spent(surface, sources):
    """Return the CPU time and the wall time of some rows, s."""
    start = time.process_time(), time.perf_counter()
    surface.rows(sources, 1)
    return time.process_time() - start[0], time.perf_counter() - start[1]
