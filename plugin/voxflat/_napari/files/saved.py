"""Flat maps and atlases that were saved, as runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from voxflat._napari.results.maps import map_layers
from voxflat._napari.results.pages import page_layers
from voxflat._napari.results.run import Run
from voxflat.atlases.certified import load_atlas
from voxflat.atlases.saved import saved_kind
from voxflat.maps.flat_map import load

__all__ = ["opened_run"]


def opened_run(path: Path) -> Run:
    """Read a flat map or an atlas that was saved.

    Parameters
    ----------
    path : Path
        An .npz or .voxflat file.

    Returns
    -------
    Run

    Raises
    ------
    InputError
        If the file is damaged.
    """
    origin = {"layer": path.stem, "world_axes": "RAS", "unit": "millimeter"}
    if saved_kind(path) == "atlas":
        atlas = load_atlas(path)
        atlas.metadata["napari"] = origin
        return Run(page_layers(atlas), path.stem)
    flat_map = load(path)
    told: dict[str, Any] = flat_map.metadata.setdefault("napari", origin)
    told["layer"] = path.stem
    return Run(map_layers(flat_map, path.stem), path.stem)
