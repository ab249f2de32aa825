"""The commands `voxflat cite` and `voxflat info`, which describe maps for a paper and the system for a bug report."""

import os
import platform
import re
from dataclasses import asdict
from importlib import metadata
from pathlib import Path
from typing import Any

import cloup
import numpy as np

from voxflat._core import __version__
from voxflat.arguments import amount, free_memory
from voxflat.atlases.certified import saved_kind
from voxflat.citation.methods_text import cite
from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.input import load_maps
from voxflat.cli.options import FILE
from voxflat.cli.output import report
from voxflat.pipeline.flat_series import load_series

_FEATURES = ("SSE42", "AVX2", "FMA3", "AVX512F", "NEON", "SVE")  # instruction sets that affect speed
_FURTHER = ("vtk", "pyqt6")  # dependencies of the optional packages


@options.command("cite", "voxflat cite lh.npz rh.npz", "voxflat cite lh.npz rh.npz --bibtex > references.bib")
@options.map_options(cloup.argument("maps", metavar="[MAP]...", type=FILE, nargs=-1))
@options.section("Output", options.flag("--bibtex", "Print only the BibTeX entries."), options.as_json)
@options.run()
def cite_command(maps: tuple[Path, ...], bibtex: bool) -> None:
    """Print a paragraph for the methods section of a paper, with references.

    Each MAP is a file written by voxflat flatten. The paragraph states the version of voxflat, the method, its options,
    the cuts, and the distance errors. Without MAP, voxflat prints a general paragraph with all references.
    """
    with bars():
        series = {path: load_series(path).flat_map for path in maps if saved_kind(path) == "series"}
        loaded = iter(load_maps([path for path in maps if path not in series]))
        citation = cite(*(series[path] if path in series else next(loaded) for path in maps))
    report(asdict(citation), citation.bibtex if bibtex else str(citation))


@options.command("info")
@options.section("Output", options.as_json)
@options.run()
def info_command() -> None:
    """Print version and system information for a bug report.

    The command lists the versions of voxflat, Python, and the required and optional packages, as well as the operating
    system, the processor, the number of threads, and the amount of memory. It does not list the names of users,
    computers or files.
    """
    import psutil

    core = getattr(np, "_core", None) or np.core  # NumPy has no public function that returns the features
    features: dict[str, bool] = getattr(core._multiarray_umath, "__cpu_features__", {})
    system: dict[str, Any] = {
        "voxflat": __version__,
        "python": f"{platform.python_version()} ({platform.python_implementation()})",
        "system": platform.platform(),
        "cpu": _cpu(),
        "cpu_features": [name for name in _FEATURES if features.get(name)],
        "threads": os.cpu_count(),
        "memory_bytes": psutil.virtual_memory().total,
        "free_memory_bytes": free_memory(),
        "packages": _packages(),
    }
    lines = {name: system[name] for name in ("voxflat", "python", "system", "cpu", "threads")}
    lines["cpu"] += f" ({', '.join(system['cpu_features']) or 'vector instructions unknown'})"
    lines["memory"] = f"{amount(system['memory_bytes'])}, {amount(system['free_memory_bytes'])} free"
    lines |= {name: version or "not installed" for name, version in system["packages"].items()}
    report(system, "\n".join(f"{name:16}{value}" for name, value in lines.items()))


def _cpu() -> str:
    """Return the name of the processor."""
    try:
        match = re.search(r"^model name\s*: (.+)$", Path("/proc/cpuinfo").read_text(encoding="utf-8"), re.MULTILINE)
    except OSError:  # not Linux
        match = None
    return match[1] if match else platform.processor() or platform.machine()


def _packages() -> dict[str, str | None]:
    """Return the versions of the packages that voxflat can use; None if a package is not installed."""
    try:
        required = metadata.requires("voxflat") or []
    except metadata.PackageNotFoundError:  # a checkout that is not installed
        required = []
    names = dict.fromkeys([*(re.split(r"[^\w.-]", requirement, maxsplit=1)[0] for requirement in required), *_FURTHER])
    return {name: _version(name) for name in names if name != "voxflat"}


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
