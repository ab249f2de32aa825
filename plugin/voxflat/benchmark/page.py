"""The page of results: tables and figures for the documentation, and the same numbers as CSV and JSON."""

import csv
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from voxflat.benchmark.manifest import Entry, chosen
from voxflat.benchmark.score import load_result
from voxflat.benchmark.tools import FREE, GIVEN, NOT_RUN
from voxflat.errors import InputError
from voxflat.io.files import atomic_path

OURS = "voxflat"
"""The tool whose places the page reports where it is not first."""

_COLUMNS: dict[str, tuple[str, float, str]] = {  # header, factor, format; smaller is better
    "relative_error": ("all, %", 100, ".2f"),
    "relative_error_30mm": ("≤ 30 mm, %", 100, ".2f"),
    "relative_error_10mm": ("≤ 10 mm, %", 100, ".2f"),
    "stress_1": ("stress-1", 1, ".3f"),
    "edge": ("edges, %", 100, ".2f"),
    "equal_area_median": ("area, median", 1, ".3f"),
    "equal_area_p95": ("area, 95 %", 1, ".3f"),
    "area_beyond_1_5": ("area > 1.5, %", 100, ".1f"),
    "angle": ("angles, °", 1, ".2f"),
    "flipped": ("flipped", 1, ".0f"),
    "covering": ("overlapping", 1, ".0f"),
}
_FREE_COLUMNS: dict[str, tuple[str, float, str]] = {
    "uncut_relative_error": ("uncut, %", 100, ".1f"),
    "cut_length": ("cuts", 1, ".0f"),
    "charts": ("charts", 1, ".0f"),
}
_PLACED = tuple(name for name in _COLUMNS if name not in ("flipped", "covering"))
_COSTS = ("wall", "cpu", "peak")
_TITLES = {GIVEN: "given cuts", FREE: "free cuts"}
_FIGURE_SIZE = (7.2, 4.2)
_FLOOR = 0.5  # %, at which smaller errors are drawn
_TICKS = (0.5, 1, 2, 5, 10, 20, 50, 100)

Row = dict[str, Any]


def write_page(results: Sequence[Path], folder: Path) -> list[Path]:
    """Write ``results.md``, ``results.csv``, ``results.json`` and the figures, and return their paths."""
    loaded = [load_result(path) for path in results]
    rows = rows_of(loaded)
    if not rows:
        raise InputError("the results contain no maps. Pass files that `voxflat bench score` wrote")
    folder.mkdir(parents=True, exist_ok=True)
    figures = {
        track: folder / f"results-{track}.png" for track in _TITLES if any(row["track"] == track for row in rows)
    }
    texts = {"results.md": markdown(loaded, rows, figures), "results.csv": as_csv(rows)}
    texts["results.json"] = json.dumps({"results": loaded}, indent=1) + "\n"
    for name, text in texts.items():
        with atomic_path(folder / name) as temporary:
            temporary.write_text(text, encoding="utf-8", newline="\n")
    for track, path in figures.items():
        draw([row for row in rows if row["track"] == track], _TITLES[track], path)
    return [*(folder / name for name in texts), *figures.values()]


def rows_of(results: Iterable[Mapping[str, Any]]) -> list[Row]:
    """Return one row per track, surface and tool, in the order of the surfaces, the smallest error first."""
    order = {entry.name: entry for entry in chosen()}
    rows = []
    for result in results:
        about = {key: result[key] for key in ("tool", "version", "machine", "track")}
        for name, found in result["surfaces"].items():
            if name in order:
                place = {"surface": name, "family": order[name].family}
                errors = {f"{key}_se": value for key, value in found["standard_errors"].items() if value is not None}
                rows.append({**about, **place, **found["measures"], **errors, **found["costs"]})
    places = {name: place for place, name in enumerate(order)}
    rows.sort(key=lambda row: (row["track"] != GIVEN, places[row["surface"]], row["relative_error"]))
    _check_once(rows)
    return rows


def _check_once(rows: Iterable[Row]) -> None:
    """Raise an error for two results of the same tool and track, which might not be of one run."""
    seen = set()
    for row in rows:
        key = row["track"], row["tool"], row["surface"]
        if key in seen:
            raise InputError(f"two results contain a map of {key[2]} by {key[1]} with {_TITLES[key[0]]}. Omit one")
        seen.add(key)


def as_csv(rows: Sequence[Row]) -> str:
    """Return all measures as CSV, with one row per map."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


# ------------------------------------------------------------------------------------------------------------- tables


def markdown(results: Sequence[Mapping[str, Any]], rows: Sequence[Row], figures: Mapping[str, Path]) -> str:
    """Return the page as Markdown."""
    lines = ["# Results of the benchmark", ""]
    lines += ["This page is written by `voxflat bench page`. [The benchmark](index.md) defines the columns and rules."]
    lines += ["The best value of each column is bold. ± is the standard error over the sources. `results.csv` and"]
    lines += ["`results.json` beside this page contain all measures."]
    for track, title in _TITLES.items():
        of_track = [row for row in rows if row["track"] == track]
        across = "length of the cuts" if track == FREE else "time"
        if of_track:
            lines += [
                "",
                f"## {title.capitalize()}",
                "",
                f"![Error against {across}, {title}]({figures[track].name})",
                "",
            ]
            if track == FREE:
                lines += ["Errors are measured within charts, so maps in many charts have small errors. Read them"]
                lines += ["together with the errors on the uncut surface, the length of the cuts and the charts.", ""]
            lines += _means(of_track)
            for entry in chosen():
                lines += _table(entry, [row for row in of_track if row["surface"] == entry.name])
            lines += _not_first(of_track)
    return "\n".join([*lines, *_tools(results)]) + "\n"


def _table(entry: Entry, rows: Sequence[Row]) -> list[str]:
    """Return the table of a surface."""
    if not rows:
        return []
    columns = _COLUMNS | (_FREE_COLUMNS if rows[0]["track"] == FREE else {})
    best = {name: _best(rows, name) for name in columns}
    lines = ["", f"### {entry.title} (`{entry.name}`)", ""]
    lines += _head(["map", *(header for header, _, _ in columns.values()), "CPU s", "GiB"])
    for row in rows:
        cells = [_cell(row, name, *columns[name][1:], best[name]) for name in columns]
        cells += [_number(row.get("cpu"), ".1f"), _number(row.get("peak"), ".2f")]
        lines.append(_line([row["tool"], *cells]))
    return [*lines, "", f"*{entry.title}; cuts: {entry.cuts}; source: {entry.source}.*"]


def _means(rows: Sequence[Row]) -> list[str]:
    """Return the table of the means over the families, for the tools that have a map of every surface of a family."""
    entries = chosen()
    families = list(dict.fromkeys(entry.family for entry in entries))
    shown = {family: {row["surface"] for row in rows if row["family"] == family} for family in families}
    families = [family for family in families if shown[family]]
    lines = ["### Mean error of all distances by family, %", "", *_head(["map", *families])]
    for tool in sorted({row["tool"] for row in rows}):
        cells = []
        for family in families:
            own = {row["surface"]: row["relative_error"] for row in rows if row["tool"] == tool}
            values = [own[name] for name in shown[family] if own.get(name) is not None]
            is_complete = len(values) == len(shown[family])
            cells.append(f"{100 * np.mean(values):.2f}" if is_complete else "")
        lines.append(_line([tool, *cells]))
    note = "*A cell is empty if the tool has no map of a surface of the family.*"
    return [*lines, "", note]


def _not_first(rows: Sequence[Row]) -> list[str]:
    """Return where a map without folds by another tool has a better value than voxflat."""
    lines = []
    for name in dict.fromkeys(row["surface"] for row in rows):
        of_surface = [row for row in rows if row["surface"] == name]
        own = [row for row in of_surface if row["tool"] == OURS]
        if not own:
            continue
        for measure in _PLACED:
            header, factor, shown = _COLUMNS[measure]
            own_text = _number(own[0].get(measure), shown, factor)
            better = [row for row in of_surface if _is_less(row.get(measure), own[0].get(measure))]
            better = [row for row in better if _number(row[measure], shown, factor) != own_text]
            if better:
                first = min(better, key=lambda row: row[measure])
                values = (format(factor * row[measure], shown) for row in (own[0], first))
                folds = "" if not first["flipped"] else f", with {first['flipped']} flipped triangles"
                lines.append("| {} | {} | {} | {} ({}){} |".format(name, header, *values, first["tool"], folds))
    if not lines:
        return ["", "voxflat is first in every column for distances, edges, areas and angles."]
    head = _head(["surface", "column", "voxflat", "best"])
    return [
        "",
        "### Where voxflat is not first",
        "",
        *head,
        *lines,
        "",
        "*All columns, whether or not maps are folded.*",
    ]


def _tools(results: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the list of tools with their versions, and what is missing."""
    lines = ["", "## Tools", "", *_head(["tool", "track", "version", "machine", "maps", "no map"])]
    for result in results:
        missing = [f"{name}: {reason}" for name, reason in result["missing"].items()]
        counts = [str(len(result["surfaces"])), "; ".join(missing).replace("|", "/")]
        lines.append(_line([*(result[key] for key in ("tool", "track", "version", "machine")), *counts]))
    lines += ["", "### Tools that were not run", "", *_head(["tool", "reason"])]
    return [*lines, *(_line([name, reason]) for name, reason in NOT_RUN.items())]


def _head(names: Sequence[str]) -> list[str]:
    return [_line(names), "|" + "---|" * len(names)]


def _line(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _best(rows: Sequence[Row], name: str) -> float:
    return min((row[name] for row in rows if row.get(name) is not None), default=np.nan)


def _cell(row: Row, name: str, factor: float, shown: str, best: float) -> str:
    value = row.get(name)
    if value is None:
        return "–"
    text = format(factor * value, shown)
    text = f"**{text}**" if text == format(factor * best, shown) else text
    error = row.get(f"{name}_se")
    return text if error is None else f"{text} ± {format(factor * error, shown)}"


def _number(value: float | None, shown: str, factor: float = 1) -> str:
    return "" if value is None else format(factor * value, shown)


def _is_less(value: float | None, than: float | None) -> bool:
    """Return whether a value is better than another one by more than rounding."""
    return value is not None and than is not None and value < than - 1e-4 * max(abs(than), 1e-3)


# ------------------------------------------------------------------------------------------------------------ figures


def draw(rows: Sequence[Row], title: str, path: Path) -> None:
    """Draw the errors of all maps against CPU time or, with free cuts, against the length of the cuts."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import FormatStrFormatter, NullFormatter

    is_free = rows[0]["track"] == FREE
    figure = Figure(figsize=_FIGURE_SIZE, layout="constrained", dpi=150)
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    names = sorted({row["tool"] for row in rows}, key=lambda name: (name != OURS, name))
    for number, tool in enumerate(names):
        of_tool = [row for row in rows if row["tool"] == tool]
        across = np.array([row["cut_length"] if is_free else row.get("cpu") or np.nan for row in of_tool])
        errors = np.maximum([100 * row["relative_error"] for row in of_tool], _FLOOR)
        if np.isfinite(across).any():
            marker = "ov^sDP*Xdph<>"[number % 13]
            axes.plot(across, errors, marker, color=f"C{number % 10}", alpha=0.8, label=tool, zorder=3 if number else 4)
    axes.set(xscale="symlog" if is_free else "log", yscale="log", title=f"Benchmark, {title}: one point per map")
    axes.set_xlabel("length of the cuts (mm, or µm for organs)" if is_free else "CPU time (s)")
    axes.set_ylabel(f"mean error of all distances (%), at least {_FLOOR:g} shown")
    low, high = axes.get_ylim()
    axes.set_yticks([tick for tick in _TICKS if low <= tick <= high])
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(FormatStrFormatter("%g"))
        axis.set_minor_formatter(NullFormatter())
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small", loc="center left", bbox_to_anchor=(1, 0.5))
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", metadata={"Software": None})
