"""Readers of saved flat maps and atlases."""

from pathlib import Path

from voxflat._napari.results.flat_layers import LayerData, hidden
from voxflat._napari.results.maps import map_layers, page_layers
from voxflat.atlases.certified import load_atlas
from voxflat.maps.flat_map import load


def map_layers_of(path: Path) -> list[LayerData]:
    """Read a saved flat map; raises InputError if the file is damaged."""
    flat_map = load(path)
    flat_map.metadata.setdefault("napari", _origin(path))
    return [hidden(layer) for layer in map_layers(flat_map, path.stem).layers]


def atlas_layers_of(path: Path) -> list[LayerData]:
    """Read a saved atlas as layers: its surface, and images of its page; raises InputError if the file is damaged."""
    atlas = load_atlas(path)
    atlas.metadata.setdefault("napari", _origin(path))
    drawn = page_layers(atlas)
    return [hidden(layer) for layer in [*drawn.in_space, *drawn.layers]]


def _origin(path: Path) -> dict[str, str]:
    """Return the origin metadata of a map that was not made in napari."""
    return {"layer": path.stem, "world_axes": "RAS", "unit": "millimeter"}
