"""A user's script, which mypy checks with all else: the accessor is no ``Any``, and what is misspelt is found."""

import numpy as np
import pyvista as pv
from typing_extensions import assert_type

import voxflat
from voxflat._pyvista.accessor import VoxflatAccessor
from voxflat._pyvista.blocks import BlocksAccessor
from voxflat._pyvista.morphs import Morph

mesh = pv.Sphere()
assert_type(mesh.voxflat, VoxflatAccessor)
assert_type(pv.ImageData().voxflat, VoxflatAccessor)
assert_type(pv.MultiBlock().voxflat, BlocksAccessor)
assert_type(mesh.voxflat(seed_point=(0.0, 0.0, 1.0), radius=0.3), pv.PolyData)
assert_type(mesh.voxflat.flatten(), voxflat.FlatMap)
assert_type(mesh.voxflat.morph(3), Morph)
assert_type(mesh.voxflat.texture(np.zeros((2, 2))), tuple[pv.PolyData, pv.Texture])
assert_type(voxflat.vtk.FlattenSurface(relax=False).radius, float | None)
assert_type(pv.MultiBlock().voxflat.cut(relax=False), pv.MultiBlock)
assert_type(pv.MultiBlock().voxflat.flatten(), dict[str, voxflat.FlatMap])
assert_type(voxflat.map_page(mesh.voxflat.flatten()), voxflat.MapPage)
mesh.voxflat(raduis=3)  # type: ignore[call-arg]
mesh.voxflat.plot(clim="wide")  # type: ignore[arg-type]
mesh.voxflat.flaten()  # type: ignore[attr-defined]
pv.MultiBlock().voxflat.plot()  # type: ignore[attr-defined]
voxflat.vtk.SurfaceGeodesic().method = 3  # type: ignore[assignment]
