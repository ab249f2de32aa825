"""Convert PyVista maps to pages for a web browser."""

from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from voxflat.lab.map_page import MapPage, page_of
from voxflat.lab.pages import SceneMap

_OWN = ("vertex_ids", "voxel_ids", "torn", "mesh_vertex_ids")


def browser_page(flat: pv.PolyData, title: str) -> MapPage:
    """Return a page with a map, its surface, and its numeric arrays."""
    surface = np.array(flat.point_data["surface_points"], dtype=np.float64)
    plane = np.asarray(flat.points, dtype=np.float64)
    faces = np.asarray(flat.regular_faces)
    ids = next((flat.point_data[name] for name in _OWN[:2] if name in flat.point_data), np.arange(len(plane)))
    torn = flat.cell_data["torn"] if "torn" in flat.cell_data else np.zeros(len(faces))
    numbers, is_torn = np.asarray(ids, dtype=np.int64), np.asarray(torn, dtype=np.bool_)
    scene = SceneMap(plane[:, :2].copy(), surface, numbers, faces.astype(np.uint32), is_torn)
    of_points, of_triangles = _values(flat.point_data), _values(flat.cell_data)
    return page_of(scene, of_points, of_triangles, title, first=flat.active_scalars_name)


def _values(data: pv.DataSetAttributes) -> dict[str, NDArray[Any]]:
    """Return the arrays that can be shown, which have one number per point or triangle."""
    arrays = {name: np.asarray(data[name]) for name in data if name not in _OWN}
    return {name: array for name, array in arrays.items() if array.ndim == 1 and array.dtype.kind in "biuf"}
