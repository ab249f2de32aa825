"""The command `voxflat info`."""

import os
import platform
import re
from importlib import metadata
from pathlib import Path
from typing import Any

import click
import cloup
import numpy as np

from voxflat._core import __version__
from voxflat.arguments import amount, free_memory
from voxflat.cli import options
from voxflat.cli.output import print_json

_FEATURES = ("SSE42", "AVX2", "FMA3", "AVX512F", "NEON", "SVE")  # instruction sets that affect speed
_FURTHER = ("vtk", "pyqt6")  # dependencies of the optional packages


@cloup.command("info")
@options.section("Output", options.as_json)
@options.run()
def command(as_json: bool) -> None:
    """Print the versions and the machine for a bug report.

    The list contains the versions of voxflat, of Python and of the required and optional packages, the operating
    system, the processor, the number of threads and the memory. It contains no names of users, computers or files.
    """
    import psutil

    features = _numpy_features()
    told: dict[str, Any] = {
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
    if as_json:
        print_json(told)
        return
    lines = {name: told[name] for name in ("voxflat", "python", "system", "cpu", "threads")}
    lines["cpu"] += f" ({', '.join(told['cpu_features']) or 'no vector instructions known'})"
    lines["memory"] = f"{amount(told['memory_bytes'])}, {amount(told['free_memory_bytes'])} free"
    lines |= {name: version or "not installed" for name, version in told["packages"].items()}
    click.echo("\n".join(f"{name:16}{value}" for name, value in lines.items()))


def _cpu() -> str:
    """Return the name of the processor."""
    try:
        found = re.search(r"^model name\s*: (.+)$", Path("/proc/cpuinfo").read_text(encoding="utf-8"), re.MULTILINE)
    except OSError:  # not Linux
        found = None
    return found[1] if found else platform.processor() or platform.machine()


def _numpy_features() -> dict[str, bool]:
    """Return the processor features that NumPy detected, for which NumPy does not have a public function."""
    core = getattr(np, "_core", None) or np.core
    features: dict[str, bool] = getattr(core._multiarray_umath, "__cpu_features__", {})
    return features


def _packages() -> dict[str, str | None]:
    """Return the versions of the packages that voxflat can use; None if a package is not installed."""
    try:
        required = metadata.requires("voxflat") or []
    except metadata.PackageNotFoundError:  # a checkout that is not installed
        required = []
    names = dict.fromkeys([*(re.split(r"[^\w.-]", one, maxsplit=1)[0] for one in required), *_FURTHER])
    return {name: _version(name) for name in names if name != "voxflat"}


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
