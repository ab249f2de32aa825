"""Choose the function that reads a file that is opened in napari, if voxflat can read the file."""

import re
from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from napari import Viewer

from voxflat._napari.layers.world import MADE_FROM
from voxflat._napari.notifications import showing_warnings
from voxflat._napari.results.flat_layers import LayerData
from voxflat._napari.wording import error_text
from voxflat.errors import InputError, VoxflatError
from voxflat.io import formats
from voxflat.io.files import SAVED_ENDINGS, check_regular

_Read: TypeAlias = Callable[[Path], list[LayerData]]

_NOTHING: list[Any] = [(None,)]  # tells napari that there are no layers, without an error message

_MAPS = f"Flat maps and atlases ({' '.join(f'*{ending}' for ending in reversed(SAVED_ENDINGS))})"
_VOLUMES = "Volumes (*.nii *.nii.gz *.mgz *.mgh *.nrrd *.nhdr *.mha *.mhd)"
_SURFACES = "Surfaces and values on surfaces (*)"  # FreeSurfer's files have no common suffix

# on Python 3.10, napari's commands cannot compare list[str] and Callable[[str], ...] with classes
Paths: TypeAlias = Any  # str, list[str] or None
Reader: TypeAlias = Any  # Callable[[str], list[LayerData]] or None


def map_reader(path: Paths = None) -> Reader:
    """Return a reader for a flat map or an atlas; without a path (napari's command palette), it asks for a file."""
    file = _file(path, "Read a flat map", _MAPS)
    if file is None:
        return None
    from voxflat._napari.files import saved
    from voxflat.atlases.certified import saved_kind

    kind = saved_kind(path) or ("map" if path.lower().endswith(".voxflat") else None)
    readers = {"map": saved.map_layers_of, "series": saved.movie_layers_of, "atlas": saved.atlas_layers_of}
    return None if kind is None else _reporting_errors(readers[kind])


def surface_reader(path: Paths = None) -> Reader:
    """Return a reader for a surface, for values or labels on a surface, or for a patch, like `map_reader`."""
    file = _file(path, "Read a surface or values on a surface", _SURFACES)
    read = None if file is None else _reader_of(file)
    return None if read is None else _reporting_errors(read)


def volume_reader(path: Paths = None) -> Reader:
    """Return a reader for a voxel volume, like `map_reader`."""
    file = _file(path, "Read a volume", _VOLUMES)
    if file is None or _holds_points(file):
        return None
    from voxflat._napari.files.volumes import volume_layers

    return _reporting_errors(volume_layers)


def _holds_points(path: Path) -> bool:
    """Return whether a file with the name of a volume contains values at surface points."""
    name = path.name.lower()
    if not name.endswith(".mgh"):
        return ".dscalar." in name or ".dtseries." in name or ".dlabel." in name
    return _are_points(_start_of(path) or b"")


def _start_of(path: Path) -> bytes | None:
    """Return the first bytes of a file, or None if it cannot be read; this failure is reported later."""
    try:
        check_regular(path)  # because opening a pipe would block
        with path.open("rb") as file:
            return file.read(64)
    except (OSError, InputError):
        return None


def _reader_of(path: Path) -> _Read | None:
    """Return the reader for a file, chosen by its name if the name is unambiguous, otherwise by its first bytes."""
    from voxflat._napari.files import given_maps, values

    name = path.name.lower()
    start = _start_of(path)
    if start is None:
        return given_maps.surface_layers
    if name.endswith(".mgh"):
        return values.value_layers if _are_points(start) else None
    if name.endswith((".annot", ".label")):
        return values.value_layers
    if start.startswith(b"\xff\xff\xff\xff"):
        return values.patch_layers
    if name.endswith(".txt"):
        return values.value_layers if re.match(rb"\s*[-+]?(\d|\.\d|nan|inf)", start, re.IGNORECASE) else None
    if formats.by_name(path) is not None:
        return values.gifti_layers if ".gii" in name else given_maps.surface_layers
    if not values.VALUES.isdisjoint(name.split(".")):
        # only the length reveals FreeSurfer's old format of values
        is_old = len(start) >= 6 and path.stat().st_size == 6 + 2 * int.from_bytes(start[:3], "big")
        return values.value_layers if start.startswith(b"\xff\xff\xff") or is_old else None
    return given_maps.surface_layers if start[:3] in (b"\xff\xff\xfe", b"\xff\xff\xfd", b"\xff\xff\xff") else None


def _are_points(start: bytes) -> bool:
    """Return whether an MGH file contains values at points instead of voxels."""
    return sorted(np.frombuffer(start[4:16].ljust(12, b"\0"), ">i4"))[:2] == [1, 1]


def _reporting_errors(read: _Read) -> Callable[[str], list[LayerData]]:
    """Wrap a reader so that it reports its errors; napari would only report that the reader failed."""

    def read_or_report(path: str) -> list[LayerData]:
        from napari import current_viewer
        from napari.utils.notifications import show_error

        viewer = current_viewer()
        try:
            with showing_warnings() if viewer is not None else nullcontext():
                layers = read(Path(path))
        except (VoxflatError, OSError, MemoryError) as error:
            if viewer is None:
                raise
            show_error(error_text(error))
            return _NOTHING
        if viewer is not None:
            _make_ready(viewer, layers)
        return layers

    return read_or_report


def _make_ready(viewer: Viewer, layers: list[LayerData]) -> None:
    """Register opened runs with the viewer, and switch to 3D for surfaces, which 2D shows at most as outlines."""
    from napari.layers import Surface
    from qtpy.QtCore import QTimer

    from voxflat._napari.map_viewer.dock import open_flat_map
    from voxflat._napari.viewer_state import ViewerState

    ViewerState.of(viewer)
    if any(keywords.get("metadata", {}).get("voxflat") is not None for _, keywords, _ in layers):
        open_flat_map(viewer)
    others = [layer for layer in viewer.layers if not _is_of_map(layer)]
    are_volumes = all(
        kind in ("image", "labels") and np.ndim(data) == 3 and "voxflat" not in keywords.get("metadata", {})
        for data, keywords, kind in layers
    )
    if are_volumes and not others:
        QTimer.singleShot(0, partial(_show_slices, viewer))  # after the layer is added
    in_space = all(kind == "surface" and np.shape(data[0])[-1] == 3 for data, _, kind in layers)
    if in_space and all(isinstance(layer, Surface) for layer in others):
        viewer.dims.ndisplay = 3
        _show_surfaces(viewer, layers)


def _is_of_map(layer: Any) -> bool:
    """Return whether a layer shows a map, or was drawn on one."""
    return not {"voxflat", MADE_FROM}.isdisjoint(layer.metadata)


def _show_slices(viewer: Viewer) -> None:
    from voxflat._napari.map_viewer.viewer_parts import show_sagittal

    if viewer.dims.ndim == 3:
        show_sagittal(viewer)
        viewer.reset_view()


def _show_surfaces(viewer: Viewer, layers: list[LayerData]) -> None:
    """Show the first surface laterally, or a flat one from above.

    Inflated surfaces, spheres and flat maps are hidden if others are in anatomical position.
    """
    from qtpy.QtCore import QTimer

    from voxflat._napari.layers.meshes import is_elsewhere
    from voxflat._napari.map_viewer.viewer_parts import is_right, look_from_above, look_from_side
    from voxflat.maps.matching import is_flat

    elsewhere = [keywords for _, keywords, _ in layers if is_elsewhere(keywords.get("name", ""))]
    if any(layer.visible and not is_elsewhere(layer.name) and not _is_of_map(layer) for layer in viewer.layers):
        for keywords in elsewhere:
            keywords["visible"] = False
        return
    if viewer.layers and len(elsewhere) == len(layers):
        return
    for layer in viewer.layers:
        layer.visible = layer.visible and not is_elsewhere(layer.name)
    data, keywords, _ = layers[0]
    if is_flat(np.asarray(data[0])[np.unique(data[1])]):
        QTimer.singleShot(0, partial(look_from_above, viewer))
        return
    right = is_right(data[0], keywords.get("metadata", {}).get("structure"))
    QTimer.singleShot(0, partial(look_from_side, viewer, right=right))  # after the layer is added


def _file(path: Paths, title: str, kinds: str) -> Path | None:
    """Return the path if it is a single file; if no path is given, ask for a file, and open it in the viewer."""
    if path is not None:
        return Path(path) if isinstance(path, str) else None
    from napari import current_viewer
    from qtpy.QtWidgets import QFileDialog

    viewer = current_viewer()
    chosen, _ = QFileDialog.getOpenFileName(None, title, "", kinds)
    if viewer is not None and chosen:
        viewer.open(chosen, plugin="voxflat")
    return None
