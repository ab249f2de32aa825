"""Flat maps and pages as PyVista meshes."""

import json
from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from voxflat.atlases.atlas import Atlas
from voxflat.atlases.pieces import FIGURES
from voxflat.distortion.distortion import Distortion
from voxflat.distortion.triangles import measure_arrays
from voxflat.evaluation.measure import MeasuredMap
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.textures.pictures import place
from voxflat.pipeline.cut_surface import CutSurface
from voxflat.pipeline.surface import Surface
from voxflat.unique_rows import in_rows


def to_polydata(flat_map: FlatMap, *, picture_shape: tuple[int, ...] = (1, 1)) -> pv.PolyData:
    """Return a flat map as a mesh in the plane z = 0, in mm.

    The point and cell data of the mesh contain the measures of distortion.

    Parameters
    ----------
    flat_map : FlatMap
        A flat map.
    picture_shape : tuple of ints
        Shape of the image for which texture coordinates are computed. The default is a square image.

    Returns
    -------
    pyvista.PolyData
        The mesh. Its point data are ``distance_error`` (active), ``areal``, ``angle``, ``voxel_ids`` (i, j, k) or
        ``vertex_ids``, ``surface_points`` (RAS+ mm) and texture coordinates that place an image as `FlatMap.texture`
        does. Its cell data are ``isometric``, ``quasi_conformal``, ``flipped`` and ``torn`` (whether the triangle
        bridges a gap in the surface). `voxflat.distortion.triangles` defines the measures. The field data ``voxflat``
        contain the metadata and the distortion measures: ``json.loads(mesh.field_data["voxflat"][0])``. A map without
        its surface has neither ``surface_points`` nor measures of distortion.

    See Also
    --------
    to_surface_polydata : Return the surface in 3D with the same data.

    Examples
    --------
    >>> flat_map = voxflat.samples.hill().flatten()
    >>> pv.Plane().voxflat.to_polydata(flat_map).n_points
    441
    """
    return _mesh(flat_map, _in_plane(flat_map.uv), picture_shape)


def to_surface_polydata(flat_map: FlatMap, *, picture_shape: tuple[int, ...] = (1, 1)) -> pv.PolyData:
    """Return the surface of a flat map as a 3D mesh, in RAS+ mm.

    Torn triangles bridge gaps in the surface.

    Parameters
    ----------
    flat_map : FlatMap
        A flat map.
    picture_shape : tuple of ints
        Shape of the image for which texture coordinates are computed. The default is a square image.

    Returns
    -------
    pyvista.PolyData
        The same triangles and data as in `to_polydata`.

    See Also
    --------
    to_polydata : Return the flat map in the plane.

    Examples
    --------
    >>> flat_map = voxflat.samples.hill().flatten()
    >>> pv.Plane().voxflat.to_surface_polydata(flat_map).n_points
    441
    """
    return _mesh(flat_map, flat_map.points, picture_shape)


def to_page_polydata(atlas: Atlas, *, packing: str = "boxes") -> pv.PolyData:
    """Return the page of an atlas as a mesh in the plane z = 0, in mm.

    The patches lie side by side. The cells are the triangles of the surface, in the same order.

    Parameters
    ----------
    atlas : Atlas
        An atlas, for example from `voxflat.Surface.patches`.
    packing : {"boxes", "shapes"}
        How patches are arranged on the page, as in `Atlas.page`.

    Returns
    -------
    pyvista.PolyData
        The mesh. Its cell data are ``patch`` (active), ``piece`` (which differs from ``patch`` if patches are glued),
        ``isometric`` (C), ``quasi_conformal`` (K) and ``areal`` (log2 of the ratio of areas). Its point data are
        ``voxel_ids`` or ``vertex_ids``, ``surface_points`` (RAS+ mm) and texture coordinates for an image of the page.
        The field data ``voxflat`` contain the metadata.

    See Also
    --------
    to_polydata : Return a flat map as a mesh.

    Examples
    --------
    >>> atlas = voxflat.samples.hill().patches(max_angle=20)
    >>> pv.Plane().voxflat.to_page_polydata(atlas).n_cells
    800
    """
    page = atlas.page(packing=packing)
    mesh = triangles(_in_plane(page.uv), atlas.uv_faces)
    mesh.cell_data["patch"] = atlas.patch_ids
    mesh.cell_data["piece"] = atlas.piece_ids
    for name in FIGURES:
        mesh.cell_data[name] = getattr(atlas, name)
    with np.errstate(divide="ignore"):
        mesh.cell_data["areal"] = np.log2(atlas.areal)  # as in flat maps
    is_voxels = atlas.origin.is_voxels
    mesh.point_data["voxel_ids" if is_voxels else "vertex_ids"] = atlas.ids[atlas.vertex_ids]
    mesh.point_data["surface_points"] = atlas.points[atlas.vertex_ids]
    mesh.active_texture_coordinates = page.texture_coordinates()
    mesh.field_data["voxflat"] = [json.dumps(atlas.metadata)]
    mesh.set_active_scalars("patch", preference="cell")
    return mesh.copy()


def to_measured_polydata(
    measured: MeasuredMap, points: NDArray[np.float64], ids: NDArray[np.int64], *, in_voxels: bool = False
) -> pv.PolyData:
    """Return a measured map as a mesh in the plane z = 0, in mm."""
    mesh = triangles(_in_plane(measured.uv), measured.faces)
    mesh.point_data["voxel_ids" if in_voxels else "vertex_ids"] = ids
    mesh.point_data["surface_points"] = points
    _add_measures(mesh, measured.distortion, points, measured.uv)
    mesh.field_data["voxflat"] = [json.dumps({"distortion": measured.distortion.figures()})]
    mesh.set_active_scalars("distance_error", preference="point")
    return mesh.copy()  # PyVista shares memory, but the arrays of the map must not change with the mesh


def to_cut_polydata(done: CutSurface[Surface]) -> pv.PolyData:
    """Return a cut surface as a 3D mesh, in RAS+ mm."""
    whole = done.surface
    mesh = triangles(whole.points, whole.faces)
    number = np.full(len(whole), -1, dtype=np.int64)
    for which, cut in enumerate(done.cuts):
        number[in_rows(whole.ids, cut.ids)] = which
    mesh.point_data["cut"] = number
    mesh.point_data["voxel_ids" if whole.is_voxels else "vertex_ids"] = whole.ids
    cuts = [
        {"ids": cut.ids.tolist(), "length": cut.length, "reason": cut.reason, "name": cut.name} for cut in done.cuts
    ]
    mesh.field_data["voxflat"] = [json.dumps({"cuts": cuts, "warnings": list(done.warnings)})]
    mesh.set_active_scalars("cut", preference="point")
    return mesh.copy()  # PyVista shares memory, but the arrays of the map must not change with the mesh


def triangles(points: Any, faces: Any) -> pv.PolyData:
    """Return a triangle mesh, which has its own points."""
    mesh: pv.PolyData = pv.PolyData.from_regular_faces(np.array(points), faces.astype(np.int64))
    return mesh


def _in_plane(uv: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.column_stack([uv, np.zeros(len(uv))])


def is_map(mesh: pv.DataSet) -> bool:
    """Return whether a dataset is a flat map or a page that voxflat made, and contains the surface positions."""
    return isinstance(mesh, pv.PolyData) and "voxflat" in mesh.field_data and "surface_points" in mesh.point_data


def _add_measures(
    mesh: pv.PolyData, distortion: Distortion, points: NDArray[np.float64], uv: NDArray[np.float64]
) -> None:
    """Add the distortion of each point and triangle to a mesh."""
    of_points, of_triangles = measure_arrays(distortion, points, np.asarray(mesh.regular_faces), uv)
    mesh.point_data.update(of_points)
    mesh.cell_data.update(of_triangles)


def _mesh(flat_map: FlatMap, points: NDArray[np.float64], picture_shape: tuple[int, ...]) -> pv.PolyData:
    mesh = triangles(points, flat_map.faces)
    mesh.cell_data["torn"] = flat_map.torn
    mesh.point_data["voxel_ids" if flat_map.is_voxels else "vertex_ids"] = flat_map.ids
    if flat_map.has_surface:
        mesh.point_data["surface_points"] = flat_map.points
        _add_measures(mesh, flat_map.distortion, flat_map.points, flat_map.uv)
    mesh.active_texture_coordinates = place(flat_map.uv, picture_shape)
    mesh.field_data["voxflat"] = [json.dumps(flat_map.description())]
    mesh.set_active_scalars("distance_error" if flat_map.has_surface else None, preference="point")
    return mesh.copy()  # PyVista shares memory, but the arrays of the map must not change with the mesh
