"""Flatten curved surfaces, above all the cortex, into the plane while keeping geodesic distances.

The way through: `surface` makes a `Surface` of a label volume or a mesh, `range_image` one of depths; `flatten` takes
it, or a volume or mesh as it is, to a `FlatMap`; `check` says beforehand whether that works; `geodesic` and `path` give
the distances alone; `open_rows` opens distances on disk; `load` reads a saved map; `measure` judges any map, of
whatever tool, and `compare` several of them; `worst_places` says where a map changes areas most, and where to cut.
`patches` flattens a surface of any topology in pieces, as a `FlatAtlas`, with bounds of the distortion that are proven.
`map_page` shows a map beside its surface in a notebook or a browser.

``voxflat.vtk`` has filters of VTK; it is imported when it is first asked for.
"""

from voxflat import _interrupt  # noqa: F401  (first: Ctrl-C while the program starts)

# isort: split
from typing import TYPE_CHECKING

from voxflat._core import __version__
from voxflat.atlases.atlas import Atlas
from voxflat.atlases.certified import Certificate, FlatAtlas, FlatPatch, Plane, load_atlas
from voxflat.atlases.glued import GluedAtlas, GluedPiece, Seams
from voxflat.atlases.making import patches
from voxflat.atlases.page import FlatPage
from voxflat.distances.geodesic import geodesic
from voxflat.distances.path import Path, path
from voxflat.distances.rows import DistanceRows, open_rows
from voxflat.distortion.distortion import Distortion
from voxflat.distortion.figures import Figures, StandardErrors, TriangleFigures
from voxflat.errors import AreaBoundError, Cancelled, InputError, VoxflatError
from voxflat.judging.measure import Comparison, compare, measure
from voxflat.maps.flat_map import FlatMap, load
from voxflat.maps.look_up import Places
from voxflat.maps.texture import TexturedSurface
from voxflat.maps.worst_places import RelievingCut, WorstPlace, WorstPlaces, worst_places
from voxflat.methods.flatten import flatten
from voxflat.surfaces.check import Check, check
from voxflat.surfaces.cut import Cut, CutSurface, cut
from voxflat.surfaces.making import surface
from voxflat.surfaces.range_image import range_image
from voxflat.surfaces.standard.registration import Registration, register
from voxflat.surfaces.surface import Surface

__all__ = [
    "AreaBoundError",
    "Atlas",
    "Cancelled",
    "Certificate",
    "Check",
    "Comparison",
    "Cut",
    "CutSurface",
    "DistanceRows",
    "Distortion",
    "Figures",
    "FlatAtlas",
    "FlatMap",
    "FlatPage",
    "FlatPatch",
    "GluedAtlas",
    "GluedPiece",
    "InputError",
    "MapPage",
    "Path",
    "Places",
    "Plane",
    "Registration",
    "RelievingCut",
    "Seams",
    "StandardErrors",
    "Surface",
    "TexturedSurface",
    "TriangleFigures",
    "VoxflatError",
    "WorstPlace",
    "WorstPlaces",
    "__version__",
    "check",
    "compare",
    "cut",
    "flatten",
    "geodesic",
    "load",
    "load_atlas",
    "map_page",
    "measure",
    "open_rows",
    "patches",
    "path",
    "range_image",
    "register",
    "surface",
    "worst_places",
]

if TYPE_CHECKING:
    from voxflat import vtk as vtk
    from voxflat.lab.map_page import MapPage, map_page
else:

    def __getattr__(name: str) -> object:
        """Import what needs packages that not everybody has."""
        if name == "vtk":
            import importlib

            return importlib.import_module("voxflat.vtk")
        if name in ("MapPage", "map_page"):
            from voxflat.lab import map_page as module

            return getattr(module, name)
        raise AttributeError(f"module 'voxflat' has no attribute {name!r}")
