"""Readers of saved flat maps and atlases."""

from pathlib import Path
from typing import Any

import numpy as np

from voxflat._napari.results.flat_layers import LayerData, hidden
from voxflat._napari.results.maps import map_layers, page_layers
from voxflat._napari.stacks import stack_of
from voxflat.atlases.certified import load_atlas
from voxflat.maps.flat_map import load


def map_layers_of(path: Path) -> list[LayerData]:
    """Read a saved flat map; raises InputError if the file is damaged."""
    flat_map = load(path)
    flat_map.metadata.setdefault("napari", _origin(path, flat_map.metadata))
    return [hidden(layer) for layer in map_layers(flat_map, path.stem).layers]


def atlas_layers_of(path: Path) -> list[LayerData]:
    """Read a saved atlas as layers: its surface, and images of its page; raises InputError if the file is damaged."""
    atlas = load_atlas(path)
    atlas.metadata.setdefault("napari", _origin(path, atlas.metadata))
    drawn = page_layers(atlas)
    return [hidden(layer) for layer in [*drawn.in_space, *drawn.layers]]


def _origin(path: Path, metadata: dict[str, Any]) -> dict[str, str]:
    """Return the origin metadata of a map that was not made in napari, with the axes of the stack, if it is open."""
    from napari import current_viewer

    stack = None
    if metadata["kind"] == "voxels":
        affine = np.asarray(metadata["affine"], dtype=np.float64)
        stack = stack_of(current_viewer(), tuple(metadata["shape"]), affine, metadata.get("unit", "mm"))
    usual = {"world_axes": "RAS", "unit": "millimeter"} if stack is None else stack.place.origin
    return {**usual, "layer": path.stem}
