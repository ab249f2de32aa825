"""
Distortion of a map
===================

The heat map shows for each place the mean relative error of the distances from there. Dark places are reliable.

.. code-block:: console

    $ voxflat image map.npz --heat-map -o distortion.png
"""

import voxflat
from voxflat import demo, figures

white_matter, _, _ = demo.demo_cortex()
surface = voxflat.surface(white_matter, threshold=0.5)
flat_map = surface.disk(demo.SEED_POINT, radius=45).flatten()
figures.heat_map(flat_map)

# %%
# The same colours on the folded surface.

figures.patch_3d(flat_map)

# %%
# Each pair of points: the distance on the surface, and on the map. Without distortion all would lie on the diagonal.

figures.scatter(flat_map)
