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
    made: Any = flat
    of = ExtractedSurface.of(made)
    used, corners = np.unique(of.mesh.faces, return_inverse=True)
    ids = surface.points(np.asarray(made.point_data[_ORIGINAL])[used], "the map's points")
    return of.mesh.points[used], corners.reshape(-1, 3), ids
