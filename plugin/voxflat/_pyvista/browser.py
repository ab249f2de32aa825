"""Maps of PyVista in a browser."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from voxflat._pyvista.laying import laid
from voxflat.lab.map_page import MapPage, map_page

_OWN = ("vertex_ids", "voxel_ids", "torn", "mesh_vertex_ids")


@dataclass(frozen=True, eq=False)
class _Sheet:
    """What a page shows of a map."""

    uv: NDArray[np.float64]
    points: NDArray[np.float64]
    ids: NDArray[np.int64]
    faces: NDArray[np.uint32]
    torn: NDArray[np.bool_]


def page_of(flat: pv.PolyData, title: str) -> MapPage:
    """Return a page with a map, its surface and all its arrays that have a number a point or a triangle.

    Parameters
    ----------
    flat : pyvista.PolyData
        A map or a page of an atlas.
    title : str
        Of the page.

    Returns
    -------
    MapPage

    Raises
    ------
    InputError
        As in `map_page`.
    """
    surface = np.array(flat.point_data["surface_points"], dtype=np.float64)
    plane = np.asarray(flat.points, dtype=np.float64)
    faces = np.asarray(flat.regular_faces)
    ids = next((flat.point_data[name] for name in _OWN[:2] if name in flat.point_data), np.arange(len(plane)))
    torn = flat.cell_data["torn"] if "torn" in flat.cell_data else np.zeros(len(faces))
    sheet = _Sheet(
        plane[:, :2].copy(),
        surface,
        np.asarray(ids, dtype=np.int64),
        faces.astype(np.uint32),
        np.asarray(torn, dtype=np.bool_),
    )
    return map_page(sheet, laid(plane, surface)[1], _values(flat, faces), title)


def _values(flat: pv.PolyData, faces: NDArray[np.int64]) -> dict[str, NDArray[np.float64]]:
    """Return what can be shown, the active array first; of triangles the mean around each point."""
    values: dict[str, NDArray[np.float64]] = {}
    for name in flat.point_data:
        array = np.asarray(flat.point_data[name])
        if array.ndim == 1 and array.dtype.kind in "biuf" and name not in _OWN:
            values[name] = array.astype(np.float64)
    count = np.maximum(np.bincount(faces.ravel(), minlength=flat.n_points), 1)
    for name in flat.cell_data:
        array = np.asarray(flat.cell_data[name])
        if array.ndim == 1 and array.dtype.kind in "biuf" and name not in (*_OWN, *values):
            summed = np.bincount(faces.ravel(), np.repeat(array.astype(np.float64), 3), flat.n_points)
            values[name] = summed / count
    first = [name for name in (flat.active_scalars_name,) if name in values]
    return {name: values[name] for name in [*first, *(name for name in values if name not in first)]}
