"""Read surfaces: a flat map of another tool and its surface, opened in any order, become a flat map."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from napari import Viewer

from voxflat._napari.files.saved import drawn_map
from voxflat._napari.files.surfaces import Geometry, anatomical_first, open_geometries
from voxflat._napari.map_viewer.dock import open_flat_map
from voxflat._napari.results.flat_layers import FlatLayers, LayerData, Run
from voxflat._napari.results.session import session_of
from voxflat._napari.scripts import OpenedFile
from voxflat._napari.viewer_state import ViewerState
from voxflat._napari.wording import error_text
from voxflat._napari.worker import JobWorker
from voxflat.arguments import Progress
from voxflat.errors import Cancelled
from voxflat.evaluation.given_map import load
from voxflat.io.meshes import Mesh
from voxflat.io.spaces import Space
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.matching import is_flat


def surface_layers(path: Path) -> list[LayerData]:
    """Read a surface, and load the flat map of another tool if this or an open surface is one.

    Loading takes seconds on large meshes, so another thread does it, and the layers are added when it has finished.
    Raises InputError if the file is damaged.
    """
    from napari import current_viewer
    from napari.utils.notifications import show_info

    viewer, read = current_viewer(), Geometry.read(path)
    is_map, own = _is_map(read), read.layer(path)
    opened = _opened_maps(viewer)
    others = [one for one in open_geometries() if _is_map(one) != is_map and str(one.path) not in opened]
    fitting = [one for one in others if one.fits(read)]
    if not fitting or viewer is None:
        if is_map:
            counts = "" if not others else f" with {len(read.vertices):,} vertices, which no open surface has"
            show_info(
                f"{path.name} is flat. It shows values and labels of its vertices. To measure distances and to sample "
                f"volumes, also open its surface{counts}"
            )
        return [own]
    other = anatomical_first(fitting)[0]
    flat, surface = (read, other) if is_map else (other, read)
    _load_later(viewer, flat, surface, flat.path or path)
    return [own]


def _load_later(viewer: Viewer, flat: Geometry, surface: Geometry, path: Path) -> None:
    """Load a flat map in another thread, with progress, and show it when it is there."""
    state = ViewerState.of(viewer)
    worker = JobWorker(partial(_load, flat, surface, path), f"Loading {flat.name}")
    worker.returned.connect(partial(_show, viewer, worker, flat, surface, path))
    worker.errored.connect(_tell_error)
    worker.finished.connect(partial(state.loading.pop, worker, None))
    state.loading[worker] = str(flat.path)
    worker.start()


def _load(flat: Geometry, surface: Geometry, path: Path, progress: Progress) -> FlatLayers:
    flat_map = load(_input(flat), _input(surface), progress=progress)._measured(progress)
    return drawn_map(flat_map, path)


def _show(viewer: Viewer, worker: JobWorker, flat: Geometry, surface: Geometry, path: Path, drawn: FlatLayers) -> None:
    """Show a map that was loaded, and hide the layer of its flat surface."""
    from napari.utils.notifications import show_info

    if worker.abort_requested:  # just as it finished
        return
    name, flat_map = session_of(drawn.flat_map).layer, drawn.flat_map
    open_flat_map(viewer)
    run = Run(drawn, name, OpenedFile(str(path), flat_map), title=path.stem)
    ViewerState.of(viewer).add(run, keeps_earlier=True)
    for layer in viewer.layers:
        if "voxflat" not in layer.metadata and layer.metadata.get("surface_file", layer.source.path) == str(flat.path):
            layer.visible = False
    show_info(f"{flat.name} is opened as a flat map of {surface.name}")


def _tell_error(error: Exception) -> None:
    """Report why a map was not loaded, such as that the two surfaces do not belong together."""
    from napari.utils.notifications import show_error

    if not isinstance(error, Cancelled):
        show_error(error_text(error))


def _opened_maps(viewer: Viewer | None) -> set[str]:
    """Return the files of the maps of other tools that are open or being loaded."""
    if viewer is None:
        return set()
    state = ViewerState.of(viewer)
    maps = [run.flat_map for run in state.runs if isinstance(run.flat_map, FlatMap)]
    records: list[Any] = [flat_map.record.get("parameters", {}) for flat_map in maps]
    return {str(parameters.get("flat")) for parameters in records} | set(state.loading.values())


def _is_map(geometry: Geometry) -> bool:
    return is_flat(geometry.vertices[np.unique(geometry.faces)])


def _input(geometry: Geometry) -> Path | Mesh:
    """Return the file of a surface, or its mesh if the layer has been changed."""
    if geometry.path is not None and geometry.path.is_file():
        file = Geometry.read(geometry.path)
        if np.array_equal(file.vertices, geometry.vertices) and np.array_equal(file.faces, geometry.faces):
            return geometry.path
    return Mesh(geometry.vertices, geometry.faces, structure=geometry.structure, space=Space("scanner"))
