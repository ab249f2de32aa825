"""What benchmarks share: tables, targets, errors, sections that run one by one."""

import os
import platform
import re
import time
from pathlib import Path

import numpy as np

misses = []
"""What is not met: one line each."""


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


DISTANCES = ("all %", "≤ 30 mm %", "≤ 10 mm %")
SHAPES = ("stress-1", "edges %", "area: median, 95 %", "turned over", "covering")


def distance_cells(distortion, of=None):
    """Return how far the distances of a map are off, %, for `DISTANCES`; of its best scale, or of another part."""
    of = distortion.best_scale if of is None else of
    names = ("relative_error", "relative_error_30mm", "relative_error_10mm")
    return [f"{100 * getattr(of, name):.2f}" for name in names]


def shape_cells(distortion):
    """Return the other figures of a map, for `SHAPES`."""
    triangles = distortion.triangles
    return [
        f"{distortion.best_scale.stress_1:.4f}",
        f"{100 * triangles.edge:.2f}",
        f"{triangles.equal_area_median:.3f}, {triangles.equal_area_p95:.3f}",
        str(triangles.flipped),
        str(triangles.covering),
    ]


def judged(value, shown, limit, what, least=False):
    """Put a figure beside its target, the most or with `least` the least that it may be, if there is one.

    `what`: says in the list of misses what this is.
    """
    text = format(value, shown)
    if limit is None:
        return text
    met = value >= limit if least else value <= limit
    sign = "≥" if least else "≤"
    target = f"{sign} {format(limit, shown).rstrip('0').rstrip('.') if '.' in format(limit, shown) else limit}"
    if met:
        return f"{text} ({target})"
    misses.append(f"{what}: {text}, target {target}")
    return f"**{text}** ({target}: missed)"


def errors(found, true):
    """Relative errors of distances, of the pairs that are apart."""
    apart = true > 0
    return np.asarray(found, dtype=float)[apart] / true[apart] - 1


def exponent(sizes, values):
    """Slope of the straight line through the logarithms."""
    return np.polyfit(np.log(sizes), np.log(values), 1)[0]


def machine():
    """Name the processor, its cores and the load."""
    cpus = Path("/proc/cpuinfo")
    names = re.findall(r"^model name\s*: (.*)$", cpus.read_text() if cpus.exists() else "", re.MULTILINE)
    load = f", load {os.getloadavg()[0]:.1f} at the start" if hasattr(os, "getloadavg") else ""
    name = names[0] if names else platform.processor()
    return f"{name} ({platform.machine()}), {os.cpu_count()} cores{load}, Python {platform.python_version()}"


def run(sections, parser):
    """Run the sections that ``--only`` names, or all; tell which targets were missed."""
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
