"""From INPUT and its options to what a command works on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from voxflat.cli.console import Bars
from voxflat.cli.options import MAKING, VOLUME
from voxflat.errors import InputError
from voxflat.surfaces.making import surface
from voxflat.surfaces.surface import Surface

__all__ = ["source_of", "surface_of"]


def source_of(input_: Path, given: dict[str, Any], shown: Bars) -> Path | Surface:
    """Return the input, or the surface made of it if options say how; these are taken out of what is given."""
    if any(given[name] for name in MAKING):
        if given.get("method") == "grossmann2002" or given.get("geodesic") == "chain":
            raise InputError("--pial, --probability and --repair are for surfaces of triangles; leave them out")
        return surface_of(input_, given, shown)
    for name in MAKING:
        del given[name]
    return input_


def surface_of(input_: Path, given: dict[str, Any], shown: Bars) -> Surface:
    """Make the surface of an input; the options that say how are taken out of what is given."""
    how = {name: given.pop(name) for name in (*MAKING, *VOLUME)}
    limits = {name: given[name] for name in ("memory_limit", "threads") if name in given}
    return surface(input_, **how, **limits, progress=shown.progress)
