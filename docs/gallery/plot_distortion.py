"""
Distortion of a map
===================

The heat map shows the mean relative error of the distances from each point. Dark regions are reliable.

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
# Show the same colours on the folded surface.

figures.patch_3d(flat_map)

# %%
# Compare distances on the surface and on the map. Without distortion, all pairs would lie on the diagonal.

figures.scatter(flat_map)
