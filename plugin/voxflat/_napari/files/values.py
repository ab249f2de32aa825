"""Read values and labels on surfaces, and patches of surfaces."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from voxflat._napari.files.given_maps import surface_layers
from voxflat._napari.files.surfaces import Geometry, geometries_for, tell_choice
from voxflat._napari.results.flat_layers import LayerData, limits
from voxflat.errors import InputError
from voxflat.io.label_tables import own_table
from voxflat.io.meshes import holds_mesh
from voxflat.io.overlays import read_overlay, read_region
from voxflat.io.patches import patch_faces, read_patch
from voxflat.maps.colours import label_colours

_FOLDS = ("curv", "sulc")
# words in the names of FreeSurfer's values files; "pial" or "mid" may follow
VALUES = frozenset(("avg_curv", "thickness", "area", "volume", *_FOLDS))
_UNLABELLED = (0.82, 0.82, 0.82)  # as in images of labels

_Read = TypeVar("_Read")


def gifti_layers(path: Path) -> list[LayerData]:
    """Read a GIFTI file that contains a surface, or values on a surface."""
    return surface_layers(path) if holds_mesh(path) else value_layers(path)


def value_layers(path: Path) -> list[LayerData]:
    """Read values or labels on a surface that is open or stored near the file; raises InputError if no surface fits."""
    is_region = path.name.lower().endswith(".label")
    read = read_region if is_region else read_overlay

    def on(geometry: Geometry) -> NDArray[Any]:
        return read(path, len(geometry.vertices), structure=geometry.structure)

    geometry, values = _on_surface(path, on, has_size=not is_region)
    table = None if is_region else own_table(path)
    if table is None or values.ndim > 1:
        return [geometry.layer(path, values.T.astype(np.float64), **_display(path, values))]
    return [geometry.layer(path, values.astype(np.int64), **_of_labels(values, table.names, table.colours))]


def patch_layers(path: Path) -> list[LayerData]:
    """Read a FreeSurfer patch; flat patches are shown in the plane, with v upwards. Raises InputError on failure."""
    patch = read_patch(path)

    def faces_of(geometry: Geometry) -> NDArray[np.int64]:
        return patch_faces(geometry.faces, patch.vertex_ids, len(geometry.vertices))

    geometry, faces = _on_surface(path, faces_of, has_size=False)
    features = {"vertex": patch.vertex_ids, "border": patch.border}
    if patch.points[:, 2].any():
        part = Geometry(geometry.space.to_scanner(patch.points), faces, geometry.structure, geometry.path)
        return [part.layer(path, features=features)]
    plane = Geometry(np.column_stack([-patch.points[:, 1], patch.points[:, 0]]), faces, None, geometry.path)
    about = {"patch_file": str(path), "axes": "rows: −v, columns: u, mm"}
    return [plane.layer(path, features=features, units=("mm",) * 2, shading="none", metadata=about)]


def _on_surface(path: Path, read: Callable[[Geometry], _Read], *, has_size: bool) -> tuple[Geometry, _Read]:
    """Find the surface to which a file belongs, which may tell the number of its vertices."""
    wrong: InputError | None = None
    for geometry in geometries_for(path, has_size=has_size):
        try:
            values = read(geometry)
        except InputError as error:
            wrong = wrong or error
        else:
            tell_choice(path, geometry)
            return geometry, values
    if wrong is not None:
        raise InputError(f"{wrong}. Open the surface to which the file belongs, then open the file again") from wrong
    raise InputError(f"{path}: the surface for this file was not found. Open it first (for example, lh.white)")


def _display(path: Path, values: NDArray[Any]) -> dict[str, Any]:
    """Return the display of values: grey levels centred on 0 for folds, colours for other values."""
    low, high = limits(values)
    if any(name in path.name.lower() for name in _FOLDS):
        most = max(abs(low), abs(high))
        return {"colormap": "gray_r", "contrast_limits": (-most, most)}
    return {"colormap": "viridis", "contrast_limits": (low, high)}


def _of_labels(values: NDArray[Any], names: dict[int, str], colours: dict[int, Any]) -> dict[str, Any]:
    """Return the display of labels, with the colours of their colour table."""
    keys, which = np.unique(values, return_inverse=True)
    defaults = label_colours(np.maximum(keys, 0)[:, None].astype(np.float64) + 1)[:, 0, :3] / 255
    rows = [
        np.divide(colours[int(label)], 255) if int(label) in colours else (default if label > 0 else _UNLABELLED)
        for label, default in zip(keys, defaults, strict=True)
    ]
    named = np.array([names.get(int(label), "") for label in keys], dtype=object)
    look = {"vertex_colors": np.array(rows)[which.reshape(-1)], "contrast_limits": limits(values)}
    return {**look, "features": {"name": named[which.reshape(-1)]}, "metadata": {"labels": names}}
