"""Read surfaces: a flat map of another tool and its surface, opened in any order, become a flat map."""

from pathlib import Path
from typing import Any

import numpy as np

from voxflat._napari.files.saved import opened_layers
from voxflat._napari.files.surfaces import Geometry, anatomical_first, open_geometries
from voxflat._napari.results.flat_layers import LayerData, hidden
from voxflat._napari.wording import error_text
from voxflat.errors import InputError
from voxflat.evaluation.given_map import load
from voxflat.io.meshes import Mesh
from voxflat.io.spaces import Space
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.matching import is_flat


def surface_layers(path: Path) -> list[LayerData]:
    """Read a surface, or a flat map of an open surface; raises InputError if the file is damaged."""
    from napari.utils.notifications import show_error, show_info

    read = Geometry.read(path)
    is_map, own = _is_map(read), read.layer(path)
    opened = _opened_maps()
    others = [one for one in open_geometries() if _is_map(one) != is_map and str(one.path) not in opened]
    fitting = [one for one in others if one.fits(read)]
    if not fitting:
        if is_map:
            counts = "" if not others else f" with {len(read.vertices):,} vertices, which no open surface has"
            show_info(f"{path.name} is flat. To see it as a flat map, also open its surface{counts}")
        return [own]
    other = anatomical_first(fitting)[0]
    flat, surface = (read, other) if is_map else (other, read)
    try:
        drawn = opened_layers(load(_input(flat), _input(surface)), flat.path or path)
    except InputError as error:  # they do not belong together
        show_error(error_text(error))
        return [own]
    show_info(f"{flat.name} is opened as a flat map of {surface.name}")
    return [hidden(own) if is_map else own, *drawn]


def _opened_maps() -> set[str]:
    """Return the files of the maps of other tools that are already open."""
    from napari import current_viewer

    viewer = current_viewer()
    maps = [layer.metadata.get("voxflat") for layer in ([] if viewer is None else viewer.layers)]
    records: list[Any] = [made.record.get("parameters", {}) for made in maps if isinstance(made, FlatMap)]
    return {str(parameters.get("flat")) for parameters in records}


def _is_map(geometry: Geometry) -> bool:
    return is_flat(geometry.vertices[np.unique(geometry.faces)])


def _input(geometry: Geometry) -> Path | Mesh:
    """Return the file of a surface, or its mesh if the layer has been changed."""
    if geometry.path is not None and geometry.path.is_file():
        file = Geometry.read(geometry.path)
        if np.array_equal(file.vertices, geometry.vertices) and np.array_equal(file.faces, geometry.faces):
            return geometry.path
    return Mesh(geometry.vertices, geometry.faces, structure=geometry.structure, space=Space("scanner"))
