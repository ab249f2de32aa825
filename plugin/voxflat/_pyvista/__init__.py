"""PyVista: ``mesh.voxflat(...)`` on every dataset, and flat maps as meshes.

PyVista (0.48 and later) loads this module on the first use of ``.voxflat``; before, ``import voxflat._pyvista`` does.

PyVista's coordinates are taken as RAS+ mm: x grows to the right, y to the front, z upwards. An image from a reader that
keeps LPS coordinates, as ITK's do, has to be turned first (origin and the first two rows of its direction matrix times
−1), or left and right, front and back are exchanged in what the map calls "superior up, seen from outside".

`skins` takes the surface of any dataset, and carries its data over; `images` takes arrays of images as volumes; `flat`
makes meshes of maps; `accessor` has the verbs, `blocks` those of a MultiBlock; `options` and `bars` are what they take.
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
