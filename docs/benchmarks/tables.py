"""Helpers of the benchmarks: tables, targets, errors, and sections that run one by one."""

import os
import platform
import re
import time
from pathlib import Path

import numpy as np

misses = []
"""The missed targets, one line each."""


def table(title, columns, rows, note=""):
    """Print a Markdown table; its cells are strings."""
    print(f"\n### {title}\n")
    print("| " + " | ".join(columns) + " |")
    print("|" + "---|" * len(columns))
    for row in rows:
        print("| " + " | ".join(row) + " |")
    if note:
        print(f"\n{note}")
    print(flush=True)


BANDS = (5, 10, 15, 30)  # mm, also for smaller surfaces than a hemisphere
DISTANCES = ("all %", "≤ 30 mm %", "≤ 10 mm %")
SHAPES = ("stress-1", "edges %", "area: median, 95 %", "flipped", "covering")


def distance_cells(distortion, of=None):
    """Return the distance errors of a map, %, for `DISTANCES`: at its best scale, or of another part."""
    of = distortion.best_scale if of is None else of
    names = ("relative_error", "relative_error_30mm", "relative_error_10mm")
    return [f"{100 * getattr(of, name):.2f}" for name in names]


def shape_cells(distortion):
    """Return the other figures of a map for `SHAPES`."""
    triangles = distortion.triangles
    return [
        f"{distortion.best_scale.stress_1:.4f}",
        f"{100 * triangles.edge:.2f}",
        f"{triangles.equal_area_median:.3f}, {triangles.equal_area_p95:.3f}",
        str(triangles.flipped),
        str(triangles.covering),
    ]


def judged(value, shown, limit, what):
    """Return a figure with its upper limit, if there is one. `what` names the figure in the list of missed targets."""
    text = format(value, shown)
    if limit is None:
        return text
    target = f"≤ {format(limit, shown).rstrip('0').rstrip('.') if '.' in format(limit, shown) else limit}"
    if value <= limit:
        return f"{text} ({target})"
    misses.append(f"{what}: {text}, target {target}")
    return f"**{text}** ({target}: missed)"


def errors(found, true):
    """Return the relative errors of the distances that are not 0."""
    apart = true > 0
    return np.asarray(found, dtype=float)[apart] / true[apart] - 1


def exponent(sizes, values):
    """Return the slope of the straight line through the logarithms."""
    return np.polyfit(np.log(sizes), np.log(values), 1)[0]


def machine():
    """Return the name of the processor, its number of cores and the load."""
    cpus = Path("/proc/cpuinfo")
    names = re.findall(r"^model name\s*: (.*)$", cpus.read_text() if cpus.exists() else "", re.MULTILINE)
    load = f", load {os.getloadavg()[0]:.1f} at the start" if hasattr(os, "getloadavg") else ""
    name = names[0] if names else platform.processor()
    return f"{name} ({platform.machine()}), {os.cpu_count()} cores{load}, Python {platform.python_version()}"


def run(sections, parser):
    """Run all sections, or those that ``--only`` names, and list the missed targets."""
    options = parser.parse_args()
    chosen = options.only.split(",") if options.only else list(sections)
    if unknown := set(chosen) - set(sections):
        parser.error(f"unknown sections: {', '.join(sorted(unknown))}; there are {', '.join(sections)}")
    print(machine())
    for name in chosen:
        start = time.perf_counter()
        sections[name](options)
        print(f"_{name}: {time.perf_counter() - start:.0f} s_", flush=True)
    print("\n## " + (f"{len(misses)} targets missed" if misses else "All targets met") + "\n")
    print("\n".join(f"- {line}" for line in misses))
