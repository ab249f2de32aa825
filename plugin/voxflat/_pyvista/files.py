"""Readers for ``pyvista.read`` and writers for ``mesh.save``: surfaces and flat maps (PyVista 0.48 and later)."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv

from voxflat._pyvista.flat import to_polydata, triangles
from voxflat.errors import InputError
from voxflat.io.files import SAVED_ENDINGS, naming
from voxflat.io.grid import warn_of_unit
from voxflat.io.meshes import Mesh, read_mesh, write_mesh
from voxflat.io.patches import is_patch, read_patch
from voxflat.maps.flat_map import load_saved
from voxflat.maps.map_files import mesh_of_vertices
from voxflat.pipeline.surface import surface as _surface


def read(path: str, *, surface: object | None = None) -> pv.PolyData:
    """Read a surface, a saved map, or a patch (whose triangles come from `surface`) for ``pyvista.read``."""
    is_saved = path.lower().endswith(SAVED_ENDINGS)
    if not is_saved and is_patch(path):
        return _patch(path, surface)
    if surface is not None:
        raise InputError(f"{path}: surface is given, but the file is not a patch. Omit surface")
    if is_saved:
        return to_polydata(load_saved(path))
    mesh = read_mesh(path)
    dataset = triangles(mesh.points, mesh.faces)
    for name, array in mesh.point_data.items():
        dataset.point_data[name] = array
    return dataset


def write(dataset: pv.DataSet, path: str) -> None:
    """Write triangles to a ``.surf.gii`` file for ``mesh.save``; a map of a mesh keeps the original vertex numbers."""
    with naming(path, "can this format hold it?"):
        if not isinstance(dataset, pv.PolyData) or not dataset.is_all_triangles:
            raise InputError(
                f"cannot save the {type(dataset).__name__}. Convert it to triangles: "
                "mesh.extract_surface().triangulate()"
            )
        if "voxflat" not in dataset.field_data:
            write_mesh(path, Mesh(np.asarray(dataset.points), np.asarray(dataset.regular_faces)))
            return
        description = json.loads(str(dataset.field_data["voxflat"][0]))
        write_mesh(path, _of_map(dataset, description))
        warn_of_unit(path, description.get("unit", "mm"))


def _of_map(flat: pv.PolyData, description: dict[str, Any]) -> Mesh:
    """Return a flat map; if a mesh was flattened, the map has the vertex numbers of the mesh."""
    faces = np.asarray(flat.regular_faces)
    if "torn" in flat.cell_data:
        faces = faces[~np.asarray(flat.cell_data["torn"], dtype=np.bool_)]
    if "vertex_ids" not in flat.point_data or "vertices" not in description:
        return Mesh(np.asarray(flat.points), faces)
    ids = np.asarray(flat.point_data["vertex_ids"], dtype=np.int64)
    return mesh_of_vertices(np.asarray(flat.points), ids, faces, description["vertices"], description.get("structure"))


def _patch(path: str, surface: object | None) -> pv.PolyData:
    patch = read_patch(path)
    if surface is None:
        name = Path(path).name
        remedy = f"Pass its surface: pyvista.read({name!r}, surface='lh.white')"
        raise InputError(f"{name} is a patch without triangles. {remedy}")
    whole = _surface(surface)
    row = np.full(whole.count, -1, dtype=np.int64)
    with naming(path, "is it of this surface?"):
        faces = whole.vertices[whole.faces[whole._in_patch(patch)]]
    row[patch.vertex_ids] = np.arange(len(patch.vertex_ids))
    merged, copy = whole.merged.T
    row[copy] = np.where(row[copy] < 0, row[merged], row[copy])
    flat = triangles(patch.points, row[faces])
    flat.point_data["vertex_ids"] = patch.vertex_ids
    points = np.zeros((whole.count, 3))
    points[whole.vertices] = whole.points
    flat.point_data["surface_points"] = points[patch.vertex_ids]
    return flat
