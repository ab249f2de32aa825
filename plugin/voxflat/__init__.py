"""Flatten curved surfaces, such as the cerebral cortex, into the plane while preserving geodesic distances.

`flatten` flattens an input with default settings. For more control, `surface` makes a `Surface` from a volume, a mesh
or a file, and the other steps are its methods: `Surface.keep`, `drop`, `disk` and `polygon` select a part,
`Surface.cut` cuts it open, `Surface.flatten` makes the map, `Surface.geodesic` and `path` measure distances, and
`Surface.patches` divides the surface into certified patches. `methods` contains the flattening methods with their
options, and `samples` contains small surfaces for examples.

`check` reports whether an input can be flattened. `load` reads a saved map. `measure` evaluates a flat map made by any
tool, `compare` evaluates several, and `worst_places` finds the regions whose areas change most, with suggested cuts.
`map_page` shows a map beside its surface in a notebook or a browser.

The modules `voxflat.figures` (drawing), `voxflat.io` (files) and `voxflat.vtk` (VTK filters) complete the package. All
names are imported on first use, so that `import voxflat` is quick.
All examples assume ``import numpy as np``, ``import pyvista as pv`` and ``import voxflat``.

>>> import numpy as np
>>> import voxflat
>>> labels = np.zeros((24, 24, 24), dtype=np.uint8)
>>> labels[4:20, 4:20, 4:20] = 3
>>> surface = voxflat.surface(labels, label=3)
>>> flat_map = surface.disk((4, 12, 12), radius=6.0).flatten()
>>> flat_map.uv.shape == (len(flat_map.points), 2)
True
"""

import importlib
from typing import TYPE_CHECKING

from voxflat import display, providers
from voxflat._core import __version__

__all__ = [
    "AreaBoundError",
    "Atlas",
    "Cancelled",
    "Check",
    "Citation",
    "Columns",
    "Comparison",
    "Cut",
    "CutSurface",
    "DistanceMatrix",
    "DistanceRows",
    "Distortion",
    "FlatAtlas",
    "FlatImage",
    "FlatMap",
    "FlatMovie",
    "FlatSeries",
    "FlatStack",
    "GluedAtlas",
    "HemisphereError",
    "InputError",
    "Path",
    "Places",
    "Profile",
    "Raster",
    "Regions",
    "Registration",
    "Rim",
    "Surface",
    "VoxflatError",
    "WorstPlaces",
    "__version__",
    "autoflatten_subject",
    "check",
    "cite",
    "compare",
    "flatten",
    "flatten_group",
    "flatten_series",
    "hemisphere",
    "load",
    "load_atlas",
    "load_series",
    "map_page",
    "measure",
    "methods",
    "open_rows",
    "range_image",
    "rim",
    "samples",
    "standard_map",
    "surface",
    "to_nilearn",
    "to_pycortex",
    "worst_places",
]

display.views = providers

if TYPE_CHECKING:
    from voxflat import figures as figures
    from voxflat import io as io
    from voxflat import methods, samples
    from voxflat import vtk as vtk
    from voxflat.atlases.atlas import Atlas
    from voxflat.atlases.certified import FlatAtlas, load_atlas
    from voxflat.atlases.glued import GluedAtlas
    from voxflat.citation.methods_text import Citation, cite
    from voxflat.distances.path import Path
    from voxflat.distances.rows import DistanceRows, open_rows
    from voxflat.distortion.distortion import Distortion
    from voxflat.errors import Cancelled, HemisphereError, InputError, VoxflatError
    from voxflat.evaluation.given_map import load
    from voxflat.evaluation.measure import Comparison, compare, measure
    from voxflat.lab.map_page import map_page
    from voxflat.lab.pycortex import autoflatten_subject, to_pycortex
    from voxflat.laminar.columns import Columns
    from voxflat.laminar.profile import Profile
    from voxflat.laminar.rim import Rim, rim
    from voxflat.maps.flat_map import FlatMap
    from voxflat.maps.nilearn_surfaces import to_nilearn
    from voxflat.maps.plane import Places
    from voxflat.maps.raster import FlatImage, FlatStack, Raster
    from voxflat.maps.regions import Regions
    from voxflat.maps.worst_places import AreaBoundError, WorstPlaces
    from voxflat.maps.worst_search import worst_places
    from voxflat.pipeline.check import check
    from voxflat.pipeline.cut_surface import CutSurface
    from voxflat.pipeline.distance_matrix import DistanceMatrix
    from voxflat.pipeline.flat_movie import FlatMovie
    from voxflat.pipeline.flat_series import FlatSeries, load_series
    from voxflat.pipeline.flatten import flatten
    from voxflat.pipeline.group_map import flatten_group
    from voxflat.pipeline.range_image import range_image
    from voxflat.pipeline.series import flatten_series
    from voxflat.pipeline.standard_map import standard_map
    from voxflat.pipeline.surface import Surface, surface
    from voxflat.surfaces.cuts import Cut
    from voxflat.surfaces.findings import Check
    from voxflat.surfaces.hemispheres import hemisphere
    from voxflat.surfaces.standard.registration import Registration
else:
    _MODULES = {  # of the public names
        "atlases.atlas": ("Atlas",),
        "atlases.certified": ("FlatAtlas", "load_atlas"),
        "atlases.glued": ("GluedAtlas",),
        "citation.methods_text": ("Citation", "cite"),
        "distances.path": ("Path",),
        "distances.rows": ("DistanceRows", "open_rows"),
        "distortion.distortion": ("Distortion",),
        "errors": ("Cancelled", "HemisphereError", "InputError", "VoxflatError"),
        "evaluation.given_map": ("load",),
        "evaluation.measure": ("Comparison", "compare", "measure"),
        "lab.map_page": ("map_page",),
        "lab.pycortex": ("autoflatten_subject", "to_pycortex"),
        "laminar.columns": ("Columns",),
        "laminar.profile": ("Profile",),
        "laminar.rim": ("Rim", "rim"),
        "maps.flat_map": ("FlatMap",),
        "maps.nilearn_surfaces": ("to_nilearn",),
        "maps.plane": ("Places",),
        "maps.raster": ("FlatImage", "FlatStack", "Raster"),
        "maps.regions": ("Regions",),
        "maps.worst_places": ("AreaBoundError", "WorstPlaces"),
        "maps.worst_search": ("worst_places",),
        "pipeline.check": ("check",),
        "pipeline.cut_surface": ("CutSurface",),
        "pipeline.distance_matrix": ("DistanceMatrix",),
        "pipeline.flat_movie": ("FlatMovie",),
        "pipeline.flat_series": ("FlatSeries", "load_series"),
        "pipeline.flatten": ("flatten",),
        "pipeline.group_map": ("flatten_group",),
        "pipeline.range_image": ("range_image",),
        "pipeline.series": ("flatten_series",),
        "pipeline.standard_map": ("standard_map",),
        "pipeline.surface": ("Surface", "surface"),
        "surfaces.cuts": ("Cut",),
        "surfaces.findings": ("Check",),
        "surfaces.hemispheres": ("hemisphere",),
        "surfaces.standard.registration": ("Registration",),
    }
    _module_of = {name: module for module, names in _MODULES.items() for name in names}

    def __getattr__(name: str) -> object:
        """Import a public name on first use."""
        if name in ("figures", "io", "methods", "samples", "vtk"):
            return importlib.import_module(f"voxflat.{name}")
        if name not in _module_of:
            raise AttributeError(f"module 'voxflat' has no attribute {name!r}")
        value = globals()[name] = getattr(importlib.import_module(f"voxflat.{_module_of[name]}"), name)
        return value

    def __dir__() -> list[str]:
        return sorted({*__all__, "figures", "io", "vtk", *(name for name in globals() if name.startswith("__"))})
