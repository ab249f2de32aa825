"""Readers of saved flat maps and atlases."""

from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from voxflat._napari.files.late_stacks import follow_stacks
from voxflat._napari.results.flat_layers import LayerData, hidden
from voxflat._napari.results.maps import map_layers, page_layers
from voxflat._napari.results.session import Session
from voxflat._napari.stacks import stack_of
from voxflat.atlases.atlas import Atlas
from voxflat.atlases.certified import load_atlas
from voxflat.maps.flat_map import FlatMap, load

_Made = TypeVar("_Made", bound=FlatMap | Atlas)


def map_layers_of(path: Path) -> list[LayerData]:
    """Read a saved flat map; raises InputError if the file is damaged."""
    flat_map = load(path)
    flat_map = _in_session(flat_map, path)
    return [hidden(layer) for layer in map_layers(flat_map, path.stem).layers]


def atlas_layers_of(path: Path) -> list[LayerData]:
    """Read a saved atlas as layers: its surface, and images of its page; raises InputError if the file is damaged."""
    atlas = load_atlas(path)
    atlas = _in_session(atlas, path)
    drawn = page_layers(atlas)
    return [hidden(layer) for layer in [*drawn.in_space, *drawn.layers]]


def _in_session(made: _Made, path: Path) -> _Made:
    """Return a map with the session in its file; one from elsewhere gets the axes of its stack, if this is open."""
    from napari import current_viewer

    if Session.of(made) is not None:
        return made
    of, stack = made.origin, None
    if of.is_voxels:
        stack = stack_of(current_viewer(), of.voxels.shape, of.voxels.affine, of.unit)
        follow_stacks()
    session = Session() if stack is None else Session.made_from(stack.place.origin)
    return replace(session, layer=path.stem).put(made)
