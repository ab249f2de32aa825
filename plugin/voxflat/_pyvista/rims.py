"""The borders and the middle surface of a rim as PyVista meshes."""

import numpy as np
import pyvista as pv

from voxflat._pyvista.flat import triangles
from voxflat.laminar.columns import Columns
from voxflat.laminar.rim import Rim


def to_multiblock(rim: Rim, columns: Columns | None = None) -> pv.MultiBlock:
    """Return the surfaces ``inner``, ``middle`` and ``outer`` of a rim, in RAS+ mm, as `Rim.to_pyvista` does."""
    surface = rim.surface
    blocks = pv.MultiBlock()
    vertices = surface.vertices  # vertices where parts touch share their number
    ends = (np.asarray(surface.white_points)[vertices], np.asarray(surface.pial_points)[vertices])
    places = {"inner": ends[0], "middle": surface.points, "outer": ends[1]}
    for name, points in places.items():
        mesh = triangles(points, surface.faces)
        mesh.point_data["voxel_ids"] = surface.ids
        mesh.point_data["thickness"] = np.asarray(surface.thickness)[vertices]
        if columns is not None:
            mesh.point_data["column"] = columns.vertex_columns
        mesh.set_active_scalars("thickness" if columns is None else "column", preference="point")
        blocks[name] = mesh
    return blocks
