"""Convert the flat maps that users pass to ``mesh.voxflat.measure``."""

from typing import Any

import numpy as np
import pyvista as pv

from voxflat._pyvista.extracted_surface import ExtractedSurface

_ORIGINAL = "vtkOriginalPointIds"


def rows_of(flat: object, surface: ExtractedSurface | None) -> object:
    """Return a map in a form that `voxflat.measure` accepts."""
    numbered = isinstance(flat, pv.PolyData) and _ORIGINAL in flat.point_data  # by a VTK filter
    if not numbered or surface is None or _ORIGINAL in surface.dataset.point_data:
        return flat
    dataset: Any = flat
    extracted = ExtractedSurface.of(dataset)
    used, corners = np.unique(extracted.mesh.faces, return_inverse=True)
    ids = surface.points(np.asarray(dataset.point_data[_ORIGINAL])[used], "the map's points")
    return extracted.mesh.points[used], corners.reshape(-1, 3), ids
