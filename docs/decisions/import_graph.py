"""The graph of the package's imports: its figures, and a picture with rooms on a staircase.

    python docs/decisions/import_graph.py [-o PICTURE] [FOLDER]

FOLDER holds the package (default: plugin). What lies directly in the package is a room: a folder with its modules, or a
module alone. A room imports what stands below it on the staircase: from its row to the number, and down to the other
room. The number says how many pairs of modules that are. What runs back up is red.

Lazy imports count, those for types alone, too. A circle are modules that reach each other. Running back are the
imports, as few as a search finds, that must go until no room and no folder has a circle.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from pathlib import Path

import grimp
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

PACKAGE, CORE = "voxflat", "voxflat._core"
INK, PAPER, ALONG, BACK, ROOM = "#22303c", "#ffffff", "#3f7cac", "#d1495b", "#e8eff5"

Arrows = set[tuple[str, str]]


def imports(folder: Path) -> tuple[grimp.ImportGraph, Arrows]:
    """Return the graph and its arrows, from importing to imported module."""
    sys.path.insert(0, str(folder))
    graph = grimp.build_graph(PACKAGE, cache_dir=None)
    for module in graph.find_modules_that_directly_import(PACKAGE):
        lines = {found["line_contents"] for found in graph.get_import_details(importer=module, imported=PACKAGE)}
        if any("_core" in line for line in lines):  # the compiled module is no file that grimp knows
            graph.add_import(importer=module, imported=CORE)
        if all("_core" in line for line in lines):
            graph.remove_import(importer=module, imported=PACKAGE)
    arrows = {(a, b) for a in graph.modules for b in graph.find_modules_directly_imported_by(a)}
    return graph, {(a, b) for a, b in arrows if a != PACKAGE}  # the package itself shows what users call


def room(module: str) -> str:
    """Return the room of a module."""
    return module.split(".")[1] if "." in module else module


def circles(arrows: Arrows) -> list[list[str]]:
    """Return the modules of each circle, the largest first."""
    names = sorted({name for arrow in arrows for name in arrow})
    ends = np.array([(names.index(a), names.index(b)) for a, b in arrows]).reshape(-1, 2).T
    graph = coo_array((np.ones(ends.shape[1]), (ends[0], ends[1])), shape=(len(names), len(names)))
    _, which = connected_components(graph, connection="strong")
    groups = [[names[i] for i in np.flatnonzero(which == group)] for group in np.unique(which)]
    return sorted((group for group in groups if len(group) > 1), key=lambda group: (-len(group), group))


def running_back(graph: grimp.ImportGraph, folder: str = PACKAGE) -> Arrows:
    """Return the imports without which a folder, and what lies in it, has no circle."""
    children = graph.find_children(folder)
    found = set(graph.nominate_cycle_breakers(folder)) if len(children) > 1 else set()
    return found.union(*(running_back(graph, child) for child in children))


def staircase(graph: grimp.ImportGraph, arrows: Arrows) -> list[str]:
    """Return the rooms from the top down, importing before imported ones."""
    below: dict[str, set[str]] = {room(name): set() for name in graph.modules if name != PACKAGE}
    for a, b in arrows - running_back(graph):
        if room(a) != room(b) and b != PACKAGE:
            below[room(a)].add(room(b))

    def level(name: str) -> int:
        return 1 + max(map(level, below[name]), default=0)

    return sorted(below, key=lambda name: (-level(name), name))


def figures(graph: grimp.ImportGraph, arrows: Arrows) -> dict[str, int]:
    """Return the figures and what they are."""
    between = {(room(a), room(b)) for a, b in arrows if room(a) != room(b)}
    return {
        "modules": len(graph.modules) - 1,
        "imports": len(arrows),
        "rooms": len({room(name) for name in graph.modules}) - 1,
        "imports between rooms": len(between),
        "running back": len(running_back(graph)),
        "circles": len(circles(arrows)),
    }


def picture(graph: grimp.ImportGraph, arrows: Arrows, text: list[str]) -> Figure:
    """Draw the rooms on a staircase, and the numbers of imports between them."""
    order = staircase(graph, arrows)
    count = len(order)
    step = 0.62 if count < 30 else 0.33  # inches
    size = step * (count + 1.5)
    wide = 2.6 if count < 30 else 5.2  # rooms, in steps
    figure = Figure(figsize=(size + wide * step, size), facecolor=PAPER)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(-wide - 0.2, count + 0.6), ylim=(count - 0.1, -1.6), aspect="equal")
    axes.set_axis_off()
    small = 8.5 if count < 30 else 7.0
    title, *told = text
    axes.text(-wide, -1.0, title, fontsize=2 * small, color=INK, weight="bold", va="center")
    axes.text(-wide, count - 1, "\n".join(told), fontsize=1.6 * small, color=INK, va="bottom", linespacing=1.6)
    modules = Counter(room(name) for name in graph.modules)
    rank = {name: place for place, name in enumerate(order)}
    between = Counter((room(a), room(b)) for a, b in arrows if room(a) != room(b) and PACKAGE not in (a, b))
    last = {row: max((rank[b] for a, b in between if rank[a] == row), default=row) for row in range(count)}
    for row in range(count):
        axes.plot([row, last[row]], [row, row], color="#c9d6e2", lw=0.7, zorder=1)
    for (a, b), number in between.items():
        row, column = rank[a], rank[b]
        colour = BACK if column < row else ALONG
        axes.plot([column, column], [row, column], color=colour, lw=0.7, alpha=0.25 if column > row else 0.45, zorder=1)
        if column < row:
            axes.plot([column, row], [row, row], color=colour, lw=0.7, alpha=0.45, zorder=1)
        axes.plot(column, row, "o", ms=(15 if count < 30 else 9), color=colour, mec=PAPER, zorder=3)
        axes.text(
            column, row, str(number), ha="center", va="center_baseline", fontsize=small - 1, color=PAPER, zorder=4
        )
    for name, row in rank.items():
        folder = modules[name] > 1 and f"{PACKAGE}.{name}" in graph.modules
        box = FancyBboxPatch(
            (row - wide + 0.45, row - 0.34),
            wide - 0.1,
            0.68,
            boxstyle="round,pad=0,rounding_size=0.16",
            fc=ROOM if folder or count > 30 else "#f6f8fa",
            ec=INK,
            lw=0.6,
            zorder=5,
        )
        axes.add_patch(box)
        text = f"{name}/ {modules[name] - 1}" if folder else name
        axes.text(
            row - wide / 2 + 0.4, row, text, ha="center", va="center_baseline", fontsize=small, color=INK, zorder=6
        )
    return figure


def main() -> None:
    """Print the figures, and draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path, default=Path("plugin"))
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--title", default="A room imports what stands below it on the staircase")
    chosen = parser.parse_args()
    graph, arrows = imports(chosen.folder)
    told = [f"{count} {what}" for what, count in figures(graph, arrows).items()]
    print("\n".join(told))
    for circle in circles(arrows):
        print(f"  {len(circle)} modules: {', '.join(name.removeprefix(PACKAGE + '.') for name in circle)}")
    if chosen.output is not None:
        picture(graph, arrows, [chosen.title, *told]).savefig(chosen.output, dpi=110)


if __name__ == "__main__":
    main()
