"""Pictures on surfaces, for PyVista."""

from __future__ import annotations

import numpy as np
import pyvista as pv

from voxflat.maps.textures.pictures import as_picture, check_cover, place, values_at


def textured(
    flat: pv.PolyData, picture: object, texel_size: float | None, *, repeat: bool
) -> tuple[pv.PolyData, pv.Texture]:
    """Lay a picture onto the surface of a flat map."""
    colours, _ = as_picture(picture)
    uv = np.asarray(flat.points, dtype=np.float64)[:, :2]
    coordinates = place(uv, colours.shape, texel_size)
    if texel_size is not None and not repeat:
        check_cover(coordinates, colours.shape, texel_size)
    surface = flat.copy(deep=False)
    if "torn" in flat.cell_data and np.any(flat.cell_data["torn"]):
        surface = surface.remove_cells(np.flatnonzero(flat.cell_data["torn"]).tolist())
    surface.SetPoints(pv.vtk_points(np.array(surface.point_data["surface_points"])))  # those of `flat` stay
    surface.point_data["colours"] = np.round(values_at(colours, coordinates, repeat)).astype(np.uint8)
    surface.active_texture_coordinates = coordinates
    texture: pv.Texture = pv.Texture(colours)  # type: ignore[no-untyped-call]
    texture.repeat = repeat
    return surface, texture
