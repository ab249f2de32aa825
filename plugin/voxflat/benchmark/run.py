"""Run tools on the surfaces of the benchmark, and score their maps."""

import hashlib
import json
import os
import platform
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from voxflat.benchmark.fetch import sha256
from voxflat.benchmark.making import make
from voxflat.benchmark.manifest import Entry
from voxflat.benchmark.prepare import Prepared, load
from voxflat.benchmark.score import RUN, save_result, score
from voxflat.benchmark.tools import GIVEN, PUBLISHED, TOOLS, NoMapError, Tool
from voxflat.errors import InputError
from voxflat.io.files import atomic_path

LIMIT = 600.0
"""Default time limit of one map, s."""


def run(
    data: Path,
    out: Path,
    tools: Sequence[str],
    track: str,
    entries: Sequence[Entry],
    limit: float = LIMIT,
    tell: Callable[[str], None] = print,
) -> list[Path]:
    """Make and score the maps of tools, and return the files of the results.

    The maps are in ``out/TRACK/TOOL``, and the results in ``out/TRACK-TOOL.json``. Maps that
    the same version of a tool made of the same surface are kept.
    """
    results = []
    for name in tools:
        maps = out / track / name
        maps.mkdir(parents=True, exist_ok=True)
        if name == PUBLISHED:
            _published(data, maps, track, entries)
        else:
            _make_all(data, maps, TOOLS[name], track, entries, limit, tell)
        try:
            result = score(data, maps, track, entries)
        except InputError as error:
            tell(f"{name}: {error}")
            continue
        results.append(out / f"{track}-{name}.json")
        save_result(result, results[-1])
        tell(f"{name}: {len(result['surfaces'])} maps, {len(result['missing'])} missing; saved as {results[-1]}")
    return results


def checked_tools(names: str, track: str) -> list[str]:
    """Return the tools of a comma-separated list, all of which must be in a track."""
    known = [name for name, tool in TOOLS.items() if track in tool.tracks] + [PUBLISHED] * (track == GIVEN)
    chosen = known if names == "all" else names.split(",")
    for name in chosen:
        if name not in known:
            raise InputError(f"{name} is not a tool of the track {track!r}. Choose from {', '.join(known)}")
    return list(dict.fromkeys(chosen))


def _make_all(
    data: Path,
    maps: Path,
    tool: Tool,
    track: str,
    entries: Sequence[Entry],
    limit: float,
    tell: Callable[[str], None],
) -> None:
    about = {"tool": tool.title, "version": "", "track": track, "machine": machine()}
    try:
        about["version"] = tool.version
    except NoMapError as error:
        tell(f"{tool.name}: {error}")
        if not (maps / RUN).is_file():
            _record(maps, about, {}, {entry.name: str(error) for entry in entries})
        return
    about["code"] = "" if tool.packages else _code()
    costs, missing, inputs = _known(maps, about)
    for entry in entries:
        made, path = load(data, entry.name), maps / f"{entry.name}.npz"
        if entry.name in costs and inputs.get(entry.name) == made.hashes and path.is_file():
            continue
        path.unlink(missing_ok=True)  # so that no map of another surface or version is scored
        costs.pop(entry.name, None)
        missing.pop(entry.name, None)
        try:
            found = make(tool.name, _job(made, track), limit)
        except NoMapError as error:
            missing[entry.name] = str(error)
            tell(f"{tool.name}: {entry.name}: no map: {error}")
        else:
            flat = found.flat
            _save(path, uv=flat.uv, faces=flat.faces, vertices=flat.vertices)
            costs[entry.name], inputs[entry.name] = found.costs, made.hashes
            tell(f"{tool.name}: {entry.name}: {json.dumps(found.costs)}")
        _record(maps, about, costs, missing, inputs)
    _record(maps, about, costs, missing, inputs)


def _job(made: Prepared, track: str) -> dict[str, Any]:
    is_cut = track == GIVEN
    points, faces = (made.points, made.faces) if is_cut else (made.uncut_points, made.uncut_faces)
    return {"points": points, "faces": faces, "options": {"track": track}}


def _known(maps: Path, about: dict[str, str]) -> tuple[dict[str, Any], dict[str, str], dict[str, Any]]:
    """Return the costs, the missing maps and the hashes of the surfaces of an earlier run.

    They are empty unless the tool, its version and the machine are the same.
    """
    path = maps / RUN
    if path.is_file():
        earlier = json.loads(path.read_text(encoding="utf-8"))
        if {key: earlier.get(key) for key in about} == about:
            return earlier["costs"], earlier["missing"], earlier["inputs"]
    return {}, {}, {}


def _code() -> str:
    """Return the SHA-256 hash of the package, whose version stays the same while it is developed."""
    package = Path(__file__).parents[1]
    files = sorted(path for ending in ("py", "so", "pyd") for path in package.rglob(f"*.{ending}"))
    return hashlib.sha256("".join(map(sha256, files)).encode()).hexdigest()


def _published(data: Path, maps: Path, track: str, entries: Sequence[Entry]) -> None:
    """Write the maps that came with the surfaces."""
    missing = {}
    for entry in entries:
        made = load(data, entry.name)
        if made.published is None:
            missing[entry.name] = "no flat map was published with this surface"
        else:
            _save(maps / f"{entry.name}.npz", uv=made.published)
    about = {"tool": "published map", "version": "", "track": track, "machine": ""}
    _record(maps, about, {}, missing)


def _record(
    maps: Path,
    about: dict[str, str],
    costs: dict[str, Any],
    missing: dict[str, str],
    inputs: dict[str, Any] | None = None,
) -> None:
    with atomic_path(maps / RUN) as temporary:
        content = {**about, "costs": costs, "missing": missing, "inputs": inputs or {}}
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8", newline="\n")


def _save(path: Path, **arrays: Any) -> None:
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)


def machine() -> str:
    """Return the name of the processor, its number of cores, and the version of Python."""
    cpus = Path("/proc/cpuinfo")
    text = cpus.read_text(encoding="utf-8") if cpus.exists() else ""
    names = re.findall(r"^model name\s*: (.*)$", text, re.MULTILINE)
    name = names[0] if names else platform.processor() or platform.machine()
    return f"{name}, {os.cpu_count()} cores, {sys.platform}, Python {platform.python_version()}"
