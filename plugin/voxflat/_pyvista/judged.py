"""Flat maps that PyVista's users hand over, as the judge takes them."""

from typing import Any

import numpy as np
import pyvista as pv
from scipy.spatial import KDTree

from voxflat._pyvista.flat import is_map
from voxflat._pyvista.skins import Skin
from voxflat.errors import InputError
from voxflat.pipeline.surface import Surface

_ORIGINAL = "vtkOriginalPointIds"
_SAME = 1e-4  # of the median edge: meshes may hold float32


def rows_of(flat: object, whole: Surface, skin: Skin | None) -> object:
    """Return a map as `voxflat.measure` takes it."""
    if isinstance(flat, pv.PolyData) and is_map(flat):
        faces = np.asarray(flat.regular_faces, dtype=np.int64)
        if "torn" in flat.cell_data:
            faces = faces[~np.asarray(flat.cell_data["torn"], dtype=np.bool_)]
        return np.asarray(flat.points), faces, _vertices(flat, whole, skin)
    if skin is not None and _is_extracted(flat, skin):
        of = Skin.of(flat)  # type: ignore[arg-type]
        ids = skin.points(np.asarray(flat.point_data[_ORIGINAL])[of.point_ids], "the map's points")  # type: ignore[attr-defined]
        return np.asarray(of.mesh.points), np.asarray(of.mesh.regular_faces), ids
    if skin is None or skin.is_dataset or not isinstance(flat, pv.DataSet | np.ndarray):
        return flat
    places: Any = flat.points if isinstance(flat, pv.DataSet) else flat
    return np.asarray(places)[skin.point_ids] if len(places) == skin.dataset.n_points else flat


def _is_extracted(flat: object, skin: Skin) -> bool:
    """Say whether a mesh was made by a filter of VTK that tells which point of the dataset each of its points was."""
    return isinstance(flat, pv.PolyData) and _ORIGINAL in flat.point_data and _ORIGINAL not in skin.dataset.point_data


def _vertices(flat: pv.PolyData, whole: Surface, skin: Skin | None) -> object:
    """Return the vertex of the whole surface that each point of a map of ours is."""
    if skin is not None and "vertex_ids" in flat.point_data:
        return skin.points(np.asarray(flat.point_data["vertex_ids"]), "the map's vertex_ids")
    apart, found = KDTree(whole.points).query(np.asarray(flat.point_data["surface_points"], dtype=np.float64))
    if not (apart <= _SAME * whole.usual_edge).all():
        raise InputError(
            f"the map's surface_points are up to {apart.max():.3g} away from the surface: is it of this one?"
        )
    return whole.vertices[found]
