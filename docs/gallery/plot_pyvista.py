"""
.. _gallery-pyvista:

In PyVista
==========

Once voxflat is installed, every PyVista mesh has the accessor ``mesh.voxflat``. Here a hemisphere is flattened and
shown next to its map. In an interactive window, a click on either side marks the same point on both. ``"areal"`` is
log2 of the area on the map over the area on the surface: 0 means no change, and 1 means twice as large.
"""

from pathlib import Path

import pyvista as pv
from nilearn import datasets

import voxflat

folder = Path(datasets.__file__).parent / "data" / "fsaverage5"
pv.OFF_SCREEN = True
white = voxflat.io.read_mesh(folder / "white_left.gii.gz")  # pv.read reads lh.white and .surf.gii by itself
mesh = pv.PolyData.from_regular_faces(white.points, white.faces)
flat = mesh.voxflat()
flat.voxflat.plot("areal", window_size=(1400, 700)).image

# %%
# Certified patches cut the surface into pieces in which no length changes by more than a given factor, here 1.5.

mesh.voxflat.patches(bound=1.5).voxflat.plot("patch", window_size=(1400, 700)).image

# %%
# The next figure shows distances along the surface from one vertex.

mesh.voxflat.geodesic(0).plot(scalars="geodesic_distance", cpos="yz", return_img=True, window_size=(900, 600))

# %%
# ``flat.voxflat.morph(40).save("unfold.gif")`` writes a movie that unfolds the surface into its map, and
# ``flat.voxflat.export_html("map.html")`` writes a web page that shows both.
