"""What the parts of `distances.py` share: tables, targets, errors, times."""

import os
import platform
import time
from collections import defaultdict

import numpy as np

misses = []
"""What is not met: one line each."""

measured = defaultdict(dict)
"""Curves of growth: of each, seconds by size."""


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


def judged(value, shown, limit, what, least=False):
    """Put a figure beside its target, and note it if the target is missed.

    `shown`: how a number is formatted. `limit`: the most that `value` may be, or with `least` the least. Without a
    limit the figure is only shown. `what`: says in the list of misses what this is.
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


def cost(work):
    """Do some work; return its CPU and wall time, s, all threads together."""
    start = time.process_time(), time.perf_counter()
    work()
    return np.array([time.process_time() - start[0], time.perf_counter() - start[1]])


def in_turn(works, rounds):
    """Let works take turns; return the medians of their CPU and wall times, s, by name."""
    taken = {name: [] for name in works}
    for _ in range(rounds):
        for name, work in works.items():
            taken[name].append(cost(work))
    return {name: np.median(times, axis=0) for name, times in taken.items()}


def exponent(sizes, values):
    """Slope of the straight line through the logarithms."""
    return np.polyfit(np.log(sizes), np.log(values), 1)[0]


def seconds(value):
    """Format a time, s."""
    return f"{value:.1f} s" if value >= 10 else f"{value:.2f} s" if value >= 0.1 else f"{1e3 * value:.1f} ms"


def machine():
    """Name the processor, its cores and the load."""
    try:
        with open("/proc/cpuinfo") as file:
            names = [line.split(":", 1)[1].strip() for line in file if line.startswith("model name")]
    except OSError:
        names = []
    load = f", load {os.getloadavg()[0]:.1f} at the start" if hasattr(os, "getloadavg") else ""
    return f"{names[0] if names else platform.processor()} ({platform.machine()}), {os.cpu_count()} cores{load}"


def run(sections, parser):
    """Run the sections that ``--only`` names, or all; tell which targets were missed."""
    options = parser.parse_args()
    chosen = options.only.split(",") if options.only else list(sections)
    if unknown := set(chosen) - set(sections):
        parser.error(f"unknown sections: {', '.join(sorted(unknown))}; there are {', '.join(sections)}")
    print(f"{machine()}, Python {platform.python_version()}")
    for name in chosen:
        start = time.perf_counter()
        sections[name](options)
        print(f"_{name}: {time.perf_counter() - start:.0f} s_", flush=True)
    print("\n## " + (f"{len(misses)} targets missed" if misses else "All targets met") + "\n")
    print("\n".join(f"- {line}" for line in misses))
