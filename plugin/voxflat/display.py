"""Draw results and convert them to objects of other packages.

The functions that do this lie above the results. The package sets `views` to the module `voxflat.providers` when it is
imported, so that no module imports one above it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    import pyvista as pv
    from matplotlib.figure import Figure


class Providers(Protocol):
    """The functions of `voxflat.providers`."""

    def atlas_page(self, atlas: Any, /) -> Figure:
        """Draw the pieces of an atlas."""

    def cut_surface_views(self, surface: Any, /) -> Figure:
        """Draw the two broad sides of a surface with its cuts."""

    def map_to_pyvista(self, flat_map: Any, /) -> pv.PolyData:
        """Convert a map."""

    def map_with_overlay(self, flat_map: Any, overlay: object = None, /, *, ax: Any = None, **options: Any) -> Figure:
        """Draw a map with an overlay."""

    def profile(self, profile: Any, /, *, label: str | None, ax: Any) -> Figure:
        """Draw values along cortical depth."""

    def rim_to_pyvista(self, rim: Any, columns: Any, /) -> pv.MultiBlock:
        """Convert the surfaces of a rim."""

    def sections(self, white: Any, affine: Any, template: Any, /) -> Figure:
        """Draw sections through a mask and a template."""


views: Providers
