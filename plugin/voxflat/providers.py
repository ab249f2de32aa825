"""The functions of `voxflat.display`. The module of each is imported on first use, to keep the import quick."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    import pyvista as pv
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from voxflat.atlases.atlas import Atlas
    from voxflat.laminar.columns import Columns
    from voxflat.laminar.profile import Profile
    from voxflat.laminar.rim import Rim
    from voxflat.maps.flat_map import FlatMap
    from voxflat.surfaces.manifold import Manifold


def atlas_page(atlas: Atlas) -> Figure:
    """Draw the pieces of an atlas side by side."""
    from voxflat.figures import atlases

    return atlases.atlas_page(atlas)


def cut_surface_views(surface: Manifold) -> Figure:
    """Draw the two broad sides of a surface with its cuts."""
    from voxflat.figures import cut_surfaces

    return cut_surfaces.cut_surface_views(surface)


def map_to_pyvista(flat_map: FlatMap) -> pv.PolyData:
    """Convert a map to a mesh in the plane."""
    from voxflat._pyvista import flat

    return flat.to_polydata(flat_map)


def map_with_overlay(flat_map: FlatMap, overlay: object = None, /, *, ax: Any = None, **options: Any) -> Figure:
    """Draw a map; the options are those of `figures.flat_map` and of `figures.Overlay`."""
    from voxflat.figures import flat_maps

    return flat_maps.map_with_overlay(flat_map, overlay, ax=ax, **options)


def profile(profile: Profile, *, label: str | None, ax: Any) -> Figure:
    """Draw values along cortical depth."""
    from voxflat.figures import profiles

    return profiles.profile(profile, label=label, ax=ax)


def rim_to_pyvista(rim: Rim, columns: Columns | None) -> pv.MultiBlock:
    """Convert the surfaces of a rim to meshes."""
    from voxflat._pyvista import rims

    return rims.to_multiblock(rim, columns)


def sections(white: NDArray[np.bool_], affine: NDArray[np.float64], template: NDArray[np.bool_] | None) -> Figure:
    """Draw sections through the middle of a mask, with the outline of a template."""
    from voxflat.figures import sections as drawing

    return drawing.sections(white, affine, template)
