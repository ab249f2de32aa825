"""
.. _gallery-pyvista:

In PyVista
==========

Once voxflat is installed, every PyVista mesh has ``mesh.voxflat``. Here a hemisphere is flattened, and shown beside
its map. In a window, a click on either side marks the same place on both. ``"areal"`` is log2 of the area on the map
over the area on the surface: 0 is no change, 1 is twice as large.
"""

from pathlib import Path

import pyvista as pv
from nilearn import datasets

folder = Path(datasets.__file__).parent / "data" / "fsaverage5"
pv.OFF_SCREEN = True
mesh = pv.read(folder / "white_left.gii.gz")
flat = mesh.voxflat()
flat.voxflat.plot("areal", window_size=(1400, 700)).image

# %%
# Certified patches cut the surface into pieces in which no length changes by more than a given factor, here 1.5.

mesh.voxflat.patches(bound=1.5).voxflat.plot("patch", window_size=(1400, 700)).image

# %%
# Distances along the surface from a vertex.

mesh.voxflat.geodesic(0).plot(scalars="geodesic_distance", cpos="yz", return_img=True, window_size=(900, 600))

# %%
# ``flat.voxflat.morph(14).save("unfold.gif")`` writes a movie from the surface to the map. Here are four of its
# frames.

plotter = pv.Plotter(shape=(1, 4), window_size=(1400, 380), border=False)
for column, frame in enumerate(flat.voxflat.morph(4)):
    plotter.subplot(0, column)
    plotter.add_mesh(frame, scalars="areal", cmap="RdBu_r", clim=(-1, 1), show_scalar_bar=False)
    plotter.view_vector((-1, 0, 0.2), viewup=(0, 0, 1)) if column < 3 else plotter.view_xy()
plotter.screenshot()
