"""Readers of saved flat maps and atlases."""

from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from voxflat._napari.files.late_stacks import follow_stacks
from voxflat._napari.layers.volumes import TimeAxis, time_axis
from voxflat._napari.results.flat_layers import MAPS, FlatLayers, LayerData, MovieMaps, hidden
from voxflat._napari.results.maps import map_layers, page_layers
from voxflat._napari.results.session import Session, session_of
from voxflat._napari.stacks import stack_of
from voxflat.atlases.atlas import Atlas
from voxflat.atlases.certified import load_atlas
from voxflat.maps.flat_map import FlatMap, load_saved
from voxflat.pipeline.flat_series import load_series

_Made = TypeVar("_Made", bound=FlatMap | Atlas)


def map_layers_of(path: Path) -> list[LayerData]:
    """Read a saved flat map; raises InputError if the file is damaged."""
    return opened_layers(load_saved(path), path)


def opened_layers(flat_map: FlatMap, path: Path) -> list[LayerData]:
    """Return the layers of a flat map that was opened from a file."""
    return [hidden(layer) for layer in drawn_map(flat_map, path).layers]


def drawn_map(flat_map: FlatMap, path: Path) -> FlatLayers:
    """Draw a flat map that was opened from a file."""
    return map_layers(_in_session(flat_map, path), path.stem)


def movie_layers_of(path: Path) -> list[LayerData]:
    """Read the saved maps of a movie, like `map_layers_of`."""
    series = load_series(path)
    series = replace(series, flat_map=_in_session(series.flat_map, path))
    time = session_of(series.flat_map).time
    movie = MovieMaps(series, TimeAxis() if time is None else TimeAxis.of(time))
    layers = [hidden(layer) for layer in map_layers(series.flat_map, path.stem).layers]
    for _, keywords, _ in layers:
        keywords["metadata"][MAPS] = movie
    return layers


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
    if stack is not None and stack.layer.ndim > 3:
        session = replace(session, time=time_axis(stack.layer).record())
    return replace(session, layer=path.stem).put(made)
