"""Flatten curved surfaces, above all the cortex, into the plane while keeping geodesic distances.

The way through: `flatten` takes a label volume to a `FlatMap`; `check` says beforehand whether that works; `geodesic`
and `path` give the distances alone; `load` reads a saved map.
"""

from voxflat._check import Check, check
from voxflat._core import __version__
from voxflat._errors import Cancelled, InputError, VoxflatError
from voxflat.api import DistanceRows, Path, flatten, geodesic, path
from voxflat.flatmap import Distortion, Figures, FlatMap, load

__all__ = [
    "Cancelled",
    "Check",
    "DistanceRows",
    "Distortion",
    "Figures",
    "FlatMap",
    "InputError",
    "Path",
    "VoxflatError",
    "__version__",
    "check",
    "flatten",
    "geodesic",
    "load",
    "path",
]
