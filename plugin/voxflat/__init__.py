"""Flatten curved surfaces, above all the cortex, into the plane while keeping geodesic distances.

The way through: `surface` makes a `Surface` of a label volume or a mesh, `range_image` one of depths; `flatten` takes
it, or a volume or mesh as it is, to a `FlatMap`; `check` says beforehand whether that works; `geodesic` and `path` give
the distances alone; `open_rows` opens distances on disk; `load` reads a saved map; `measure` judges any map, of
whatever tool, and `compare` several of them. `patches` flattens a surface of any topology in pieces, as a `FlatAtlas`,
with bounds of the distortion that are proven.
"""

from voxflat._check import Check, check
from voxflat._core import __version__
from voxflat._cut import Cut, CutSurface, cut
from voxflat._distortion import Distortion, Figures, StandardErrors, Triangles
from voxflat._errors import Cancelled, InputError, VoxflatError
from voxflat._geodesic import geodesic
from voxflat._glued import GluedAtlas, GluedPiece, Seams, load_atlas
from voxflat._judge import Comparison, compare, measure
from voxflat._lookup import Places
from voxflat._page import FlatPage
from voxflat._path import Path, path
from voxflat._pieces import FlatPieces
from voxflat._rangeimage import range_image
from voxflat._surface import Surface, surface
from voxflat._texture import TexturedSurface
from voxflat.api import flatten
from voxflat.atlas import Certificate, FlatAtlas, FlatPatch, Plane, patches
from voxflat.flatmap import FlatMap, load
from voxflat.rows import DistanceRows, open_rows

__all__ = [
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
    "FlatPieces",
    "GluedAtlas",
    "GluedPiece",
    "InputError",
    "Path",
    "Places",
    "Plane",
    "Seams",
    "StandardErrors",
    "Surface",
    "TexturedSurface",
    "Triangles",
    "VoxflatError",
    "__version__",
    "check",
    "compare",
    "cut",
    "flatten",
    "geodesic",
    "load",
    "load_atlas",
    "measure",
    "open_rows",
    "patches",
    "path",
    "range_image",
    "surface",
]
