"""Convert the flat maps that users pass to ``mesh.voxflat.measure``."""

from typing import Any

import numpy as np
import pyvista as pv
from scipy.spatial import KDTree

from voxflat._pyvista.extracted_surface import ExtractedSurface
from voxflat._pyvista.flat import is_map
from voxflat.errors import InputError
from voxflat.pipeline.surface import Surface

_ORIGINAL = "vtkOriginalPointIds"
_SAME = 1e-4  # relative to the median edge length, because mesh coordinates may be float32


def rows_of(flat: object, whole: Surface, surface: ExtractedSurface | None) -> object:
    """Return a map in a form that `voxflat.measure` accepts."""
    if isinstance(flat, pv.PolyData) and is_map(flat):
        faces = np.asarray(flat.regular_faces, dtype=np.int64)
        if "torn" in flat.cell_data:
            faces = faces[~np.asarray(flat.cell_data["torn"], dtype=np.bool_)]
        return np.asarray(flat.points), faces, _vertices(flat, whole, surface)
    numbered = isinstance(flat, pv.PolyData) and _ORIGINAL in flat.point_data  # by a VTK filter
    if numbered and surface is not None and _ORIGINAL not in surface.dataset.point_data:
        made: Any = flat
        of = ExtractedSurface.of(made)
        ids = surface.points(np.asarray(made.point_data[_ORIGINAL])[of.point_ids], "the map's points")
        return np.asarray(of.mesh.points), np.asarray(of.mesh.regular_faces), ids
    if surface is None or surface.is_dataset or not isinstance(flat, pv.DataSet | np.ndarray):
        return flat
    places: Any = flat.points if isinstance(flat, pv.DataSet) else flat
    return np.asarray(places)[surface.point_ids] if len(places) == surface.dataset.n_points else flat


def _vertices(flat: pv.PolyData, whole: Surface, surface: ExtractedSurface | None) -> object:
    """Return the vertex of the complete surface for each point of a map that voxflat made."""
    if surface is not None and "vertex_ids" in flat.point_data:
        return surface.points(np.asarray(flat.point_data["vertex_ids"]), "the map's vertex_ids")
    apart, found = KDTree(whole.points).query(np.asarray(flat.point_data["surface_points"], dtype=np.float64))
    if not (apart <= _SAME * whole.usual_edge).all():
        raise InputError(
            f"the map's surface_points are up to {apart.max():.3g} away from the surface. Pass a map of this surface"
        )
    return whole.vertices[found]
