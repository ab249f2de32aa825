"""PyVista: ``mesh.voxflat(...)`` on every dataset, and flat maps as meshes.

PyVista 0.48 and later load this module on the first use of ``.voxflat``. With older versions, import
``voxflat._pyvista`` first.

Coordinates are interpreted as RAS+ mm: x increases to the right, y to the front, and z upwards. First convert images
from readers that keep LPS coordinates, such as ITK: multiply the origin and the first two rows of the direction matrix
by −1. Otherwise, the map exchanges left and right, and front and back.

`inputs` converts datasets to surfaces and volumes, `extracted_surface` extracts the surface of a dataset and copies its
data, and `flat` converts maps to meshes. `accessor` defines the operations on a dataset, and `blocks` defines those on
a MultiBlock.
"""

from typing import Any

import pyvista as pv

from voxflat._pyvista.accessor import VoxflatAccessor
from voxflat._pyvista.blocks import BlocksAccessor
from voxflat._pyvista.flat import to_page_polydata, to_polydata, to_surface_polydata

__all__ = ["BlocksAccessor", "VoxflatAccessor", "to_page_polydata", "to_polydata", "to_surface_polydata"]

if hasattr(pv, "register_dataset_accessor"):  # PyVista 0.48
    pv.register_dataset_accessor("voxflat", pv.DataSet)(VoxflatAccessor)
    pv.register_dataset_accessor("voxflat", pv.MultiBlock)(BlocksAccessor)
else:
    dataset: Any = pv.DataSet
    dataset.voxflat = property(VoxflatAccessor)
    multiblock: Any = pv.MultiBlock
    multiblock.voxflat = property(BlocksAccessor)
