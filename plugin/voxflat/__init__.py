"""Flatten curved surfaces, such as the cerebral cortex, into the plane while preserving geodesic distances.

`surface` makes a `Surface` of a volume, a mesh or a file, and everything else is a method of it: parts by
`Surface.keep`, `drop`, `disk` and `polygon`, `Surface.cut`, `Surface.flatten`, distances by `Surface.geodesic` and
`path`, certified patches by `Surface.patches`. `flatten` does it all with defaults. `methods` has the methods with
their options. `check` says beforehand whether an input can be flattened; `load` reads a saved map; `measure` judges any
map, of whatever tool, and `compare` several of them; `worst_places` says where a map changes areas most, and where to
cut. `samples` has small surfaces to try all of it. `map_page` shows a map beside its surface in a notebook or a
browser.

`voxflat.figures` draws, `voxflat.io` reads and writes, `voxflat.vtk` has filters of VTK; each is imported when it is
first asked for. Examples take for granted ``import numpy as np``, ``import pyvista as pv`` and ``import voxflat``.

>>> import numpy as np
>>> import voxflat
>>> labels = np.zeros((24, 24, 24), dtype=np.uint8)
>>> labels[4:20, 4:20, 4:20] = 3
>>> surface = voxflat.surface(labels, label=3)
>>> flat_map = surface.disk((4, 12, 12), radius=6.0).flatten()
>>> flat_map.uv.shape == (len(flat_map.points), 2)
True
"""

from typing import TYPE_CHECKING

from voxflat import methods, samples
from voxflat._core import __version__
from voxflat.atlases.atlas import Atlas
from voxflat.atlases.certified import FlatAtlas, load_atlas
from voxflat.distances.rows import DistanceRows, open_rows
from voxflat.distortion.distortion import Distortion
from voxflat.errors import AreaBoundError, Cancelled, HemisphereError, InputError, VoxflatError
from voxflat.evaluation.measure import compare, measure
from voxflat.maps.flat_map import FlatMap, load
from voxflat.maps.worst_search import worst_places
from voxflat.pipeline.check import check
from voxflat.pipeline.cut_surface import CutSurface
from voxflat.pipeline.flatten import flatten
from voxflat.pipeline.range_image import range_image
from voxflat.pipeline.surface import Surface, surface
from voxflat.surfaces.hemispheres import hemisphere

__all__ = [
    "AreaBoundError",
    "Atlas",
    "Cancelled",
    "CutSurface",
    "DistanceRows",
    "Distortion",
    "FlatAtlas",
    "FlatMap",
    "HemisphereError",
    "InputError",
    "Surface",
    "VoxflatError",
    "__version__",
    "check",
    "compare",
    "flatten",
    "hemisphere",
    "load",
    "load_atlas",
    "map_page",
    "measure",
    "methods",
    "open_rows",
    "range_image",
    "samples",
    "surface",
    "worst_places",
]

if TYPE_CHECKING:
    from voxflat import figures as figures
    from voxflat import io as io
    from voxflat import vtk as vtk
    from voxflat.lab.map_page import map_page
else:

    def __getattr__(name: str) -> object:
        """Import what needs packages that not everybody has."""
        if name in ("figures", "io", "vtk"):
            import importlib

            return importlib.import_module(f"voxflat.{name}")
        if name == "map_page":
            from voxflat.lab import map_page as module

            return getattr(module, name)
        raise AttributeError(f"module 'voxflat' has no attribute {name!r}")
