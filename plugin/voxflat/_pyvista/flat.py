"""Flat maps and pages as meshes of PyVista."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from voxflat.atlases.atlas import Atlas
from voxflat.atlases.pieces import FIGURES
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.pictures import place


def to_polydata(flat_map: FlatMap, *, picture_shape: tuple[int, ...] = (1, 1)) -> pv.PolyData:
    """Return a flat map as a mesh in the plane z = 0, in mm.

    Parameters
    ----------
    flat_map : FlatMap
        A flat map.
    picture_shape : tuple of ints
        Height and width (its ``shape``) of the picture that the texture coordinates are for; by default a square one.

    Returns
    -------
    pyvista.PolyData
        Point data ``distortion`` (mean relative error of the distances from each point, a fraction; active),
        ``voxel_ids`` (i, j, k) or ``vertex_ids``, ``surface_points`` (RAS+ mm) and texture coordinates, by which a
        picture lies as in `FlatMap.texture`. Cell data ``torn``: no surface lies in between. Field data ``voxflat``:
        metadata and distortion figures, ``json.loads(mesh.field_data["voxflat"][0])``.
    """
    return _mesh(flat_map, np.column_stack([flat_map.uv, np.zeros(len(flat_map))]), picture_shape)


def to_surface_polydata(flat_map: FlatMap, *, picture_shape: tuple[int, ...] = (1, 1)) -> pv.PolyData:
    """Return the surface patch of a flat map as a mesh in space, RAS+ mm.

    Parameters
    ----------
    flat_map, picture_shape
        As in `to_polydata`.

    Returns
    -------
    pyvista.PolyData
        The same faces and data as in `to_polydata`. Faces that are torn reach across gaps in space.
    """
    return _mesh(flat_map, flat_map.points, picture_shape)


def to_page_polydata(atlas: Atlas, *, packing: str = "boxes") -> pv.PolyData:
    """Return the page of an atlas as a mesh in the plane z = 0, in mm.

    Parameters
    ----------
    atlas : Atlas
        An atlas, such as `voxflat.patches` returns.
    packing : {"boxes", "shapes"}
        As in `Atlas.page`.

    Returns
    -------
    pyvista.PolyData
        Its cells are the surface's triangles, in their order. Cell data ``patch`` (active), ``piece`` (not the
        same where patches are glued), ``isometric`` (C),
        ``quasi_conformal`` (K) and ``areal``; point data ``voxel_ids`` or ``vertex_ids``, ``surface_points`` (RAS+ mm)
        and texture coordinates, by which an image of the page lies on it; field data ``voxflat``: the metadata.
    """
    page = atlas.page(packing=packing)
    corners: Any = atlas.uv_faces
    mesh: pv.PolyData = pv.PolyData.from_regular_faces(np.column_stack([page.uv, np.zeros(len(page.uv))]), corners)
    _add_figures(mesh, atlas)
    is_voxels = atlas.metadata["kind"] == "voxels"
    mesh.point_data["voxel_ids" if is_voxels else "vertex_ids"] = atlas.ids[atlas.vertex_ids]
    mesh.point_data["surface_points"] = atlas.points[atlas.vertex_ids]
    mesh.active_texture_coordinates = page.texture_coordinates()
    mesh.field_data["voxflat"] = [json.dumps(atlas.metadata)]
    mesh.set_active_scalars("patch", preference="cell")
    return mesh


def _add_figures(mesh: pv.PolyData, atlas: Atlas) -> None:
    """Add to each triangle which patch it belongs to, and how much it is distorted."""
    mesh.cell_data["patch"] = atlas.patch_ids
    mesh.cell_data["piece"] = atlas.piece_ids
    for name in FIGURES:
        mesh.cell_data[name] = getattr(atlas, name)


def _mesh(flat_map: FlatMap, points: NDArray[np.float64], picture_shape: tuple[int, ...]) -> pv.PolyData:
    faces: Any = flat_map.faces.astype(np.int64)
    mesh: pv.PolyData = pv.PolyData.from_regular_faces(points, faces)
    mesh.cell_data["torn"] = flat_map.torn
    mesh.point_data["voxel_ids" if flat_map.is_voxels else "vertex_ids"] = flat_map.ids
    mesh.point_data["surface_points"] = flat_map.points
    mesh.point_data["distortion"] = flat_map.distortion.per_point
    mesh.active_texture_coordinates = place(flat_map.uv, picture_shape)
    mesh.field_data["voxflat"] = [json.dumps(flat_map.description())]
    mesh.set_active_scalars("distortion", preference="point")
    return mesh
