"""Speed on meshes, and how times grow with the mesh and with the number of sources."""

from pathlib import Path

import anatomy
import distances_solvers as solvers
import numpy as np
from distances_tables import cost, exponent, judged, measured, seconds, table
from matplotlib.figure import Figure

import voxflat
from voxflat import figures

PICTURE = Path(__file__).resolve().parents[1] / "pictures" / "distances_growth.png"

MESHES = {"fsaverage5": None, "1.2 mm": 1.2, "0.7 mm": 0.7, "0.43 mm": 0.43}
"""The white surface of fsaverage5 left, and the same as voxels of some size: surfaces of 38,000 to 300,000 vertices."""

FURTHER = {"graph": 4, "marching": 4, "exact": 1, "potpourri3d marching": 4, "potpourri3d heat": 4, "pygeodesic": 1}
"""How many sources beyond the first are timed."""

KINDS = {
    "chain": ("voxflat chain", "navis-fastcore", "scipy"),
    "marching": ("voxflat marching", "potpourri3d marching", "potpourri3d heat"),
    "exact": ("voxflat exact", "pygeodesic"),
}
"""Solvers that are drawn in the same colour."""

DASHES = {
    "navis-fastcore": "s--",
    "scipy": "^:",
    "potpourri3d marching": "s--",
    "potpourri3d heat": "^:",
    "pygeodesic": "s--",
}

SLOW = 200_000
"""Vertices from which on pygeodesic is timed once only; it takes ten seconds a source and more there."""


def meshes(options):
    """Time all solvers on surfaces of a cortex, preparation apart."""
    lines = []
    for name in options.meshes:
        points, faces = mesh(name)
        count = len(points)
        prepared, further = solver_times(points, faces, options.rounds)
        for solver in FURTHER:
            shown = solver if solver in solvers.PEERS or solver == "pygeodesic" else f"voxflat {solver}"
            measured[f"a row by {shown}"][count] = further[solver][0]
            each = 1e6 * further[solver][0] / count
            lines.append(
                [
                    f"{count:,}",
                    shown,
                    seconds(prepared[solver][0]),
                    f"{seconds(further[solver][0])} ({seconds(further[solver][1])})",
                    judged(
                        each,
                        ".2f",
                        0.5 if solver == "graph" and count > 9e4 else None,
                        f"{count:,} vertices, graph, µs",
                    ),
                    beside(solver, count, {name: times[0] for name, times in further.items()}),
                ]
            )
    table(
        "Meshes: CPU time (wall) of a further source, one thread",
        ["vertices", "solver", "preparation", "a further source", "µs a vertex and source", "beside its peer"],
        lines,
        "White surface of fsaverage5 left: the mesh, and what voxflat makes of it as voxels of 1.2, 0.7 and 0.43 mm;"
        f" all solvers on the same triangles. Medians of {options.rounds} rounds in turn (pygeodesic beyond {SLOW:,}"
        " vertices: once). Preparation: a solver's constructor, and for voxflat what the first source takes longer than"
        " the others.",
    )


def beside(solver, count, times):
    """Compare with the peer that does the same."""
    if solver == "marching":
        ratio = times["marching"] / times["potpourri3d marching"]
        what = f"{count:,} vertices, marching, share of potpourri3d's time"
        return judged(ratio, ".2f", 1.0, what) + " of potpourri3d marching"
    if solver == "exact":
        ratio = times["pygeodesic"] / times["exact"]
        limit = 3.0 if 9e4 < count < SLOW else None
        return judged(ratio, ".1f", limit, f"{count:,} vertices, exact", least=True) + " times as fast as pygeodesic"
    return ""


def mesh(name):
    """Return points and faces of a cortex."""
    white = anatomy.fsaverage5("left")
    points, faces = white["white"], white["faces"]
    if MESHES[name] is None:
        return points, faces
    labels, affine, _ = anatomy.voxelise(points, faces, MESHES[name])
    surface = voxflat.surface(labels, affine=affine)
    return surface.points, surface.faces.astype(np.int64)


def solver_times(points, faces, rounds):
    """Return CPU and wall time of preparation and of a further source, s, by solver."""
    prepared = {name: [] for name in FURTHER}
    further = {name: [] for name in FURTHER}
    sources = np.random.default_rng(7).choice(len(points), 1 + max(FURTHER.values()), replace=False)
    makers = {**solvers.PEERS, "pygeodesic": solvers.exact}
    made = {}
    for number in range(rounds):
        for name, more in FURTHER.items():
            some = sources[1 : 1 + more]
            if name == "pygeodesic" and number and len(points) > SLOW:
                continue
            if name in makers:
                prepared[name].append(cost(lambda name=name: made.update({name: makers[name](points, faces)})))
                solve = made.pop(name)
                further[name].append(cost(lambda solve=solve, some=some: [solve(source) for source in some]) / more)
                continue
            mine = solvers.Mine(points, faces)
            first = cost(lambda name=name, mine=mine: mine.rows(sources[:1], name))
            again = cost(lambda name=name, mine=mine: mine.rows(sources[:1], name))
            whole = cost(lambda name=name, mine=mine, some=some: mine.rows([sources[0], *some], name))
            step = (whole - again) / more
            prepared[name].append(np.maximum(first - step, 0))
            further[name].append(step)
    return [{name: np.median(times, axis=0) for name, times in found.items()} for found in (prepared, further)]


def growth(options):
    """Print exponents of what was measured, and draw it."""
    del options
    lines = []
    for name, curve in measured.items():
        sizes, times = sorted(curve), [curve[size] for size in sorted(curve)]
        if len(sizes) < 2:
            continue
        by = "sources" if name.startswith("m rows") else "vertices"
        last = exponent(sizes[-2:], times[-2:])
        span = f"{sizes[0]:,} to {sizes[-1]:,}"
        lines.append([name, by, span, f"{exponent(sizes, times):.2f}", f"{last:.2f}"])
    if not lines:
        print("\nNothing was measured: name rows, many or meshes in --only as well.")
        return
    table(
        "Growth: exponents of CPU time",
        ["what", "in the number of", "from ... to", "exponent", "last step"],
        lines,
        "Slopes on logarithmic axes. A row by pygeodesic or by voxflat exact is no linear work; 1 is linear.",
    )
    draw()


def draw():
    """Draw the curves of growth on logarithmic axes: a solver in the colour of its peer, peers dashed."""
    figure = Figure(figsize=(12, 5.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    colours = {}
    for name, curve in measured.items():
        sizes = sorted(curve)
        what, solver = name.rsplit(" by ", 1)
        many = what.startswith("m rows")
        kind = what if many else next((kind for kind, names in KINDS.items() if solver in names), solver)
        colour = colours.setdefault(kind, f"C{len(colours)}")
        label = f"{what.removeprefix('m rows of ')}, {solver}" if many else solver
        style = "o-" if solver.startswith("voxflat") else DASHES[solver]
        (right if many else left).loglog(sizes, [curve[size] for size in sizes], style, color=colour, label=label)
    left.set(title="one more source", xlabel="vertices, or surface voxels", ylabel="CPU time (s)")
    right.set(
        title="m sources over the 26-neighbour graph", xlabel="sources m", ylabel="CPU time (s), with preparation"
    )
    for axes in (left, right):
        axes.grid(which="major", alpha=0.3)
        if axes.lines:
            axes.set_ylim(top=60 * axes.get_ylim()[1])  # room for the legend
            axes.legend(fontsize="small", frameon=False, ncols=2, loc="upper left")
    figures.save(figure, PICTURE)
    print(f"drawn: {PICTURE.relative_to(PICTURE.parents[2])}")
