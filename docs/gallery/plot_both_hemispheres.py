"""
A statistic on both hemispheres, straight from a volume
=======================================================

No surfaces are needed: both hemispheres are extracted from the white-matter probability of the MNI152 template,
registered by their folds, and cut along standard cuts. The statistic is sampled 2 mm outside white matter, in the
grey matter. The template's file has values up to 255, which ``demo.demo_cortex`` divides by 255. A threshold of 0.5 in
Python is therefore 127.5 on the command line.

.. code-block:: console

    $ voxflat flatten wm.nii.gz --hemisphere both --threshold 127.5 -o map.npz
    $ voxflat figure lh.map.npz rh.map.npz --overlay zstat.nii.gz --depth 2 --threshold 3 --range -8,8 \\
          --label "left against right button presses (z)" -o zstat.png
    $ voxflat figure lh.map.npz rh.map.npz --overlay zstat.nii.gz --depth 2 --alpha zstat.nii.gz -o zstat_alpha.png
"""

from pathlib import Path

from nilearn import datasets

import voxflat
from voxflat import demo, figures

contrast = Path(datasets.__file__).parent / "data" / "image_10426.nii.gz"
white_matter, _, _ = demo.demo_cortex()
maps = []
for side in ("left", "right"):
    half = voxflat.hemisphere(white_matter, side, threshold=0.5)
    maps.append(voxflat.surface(half, repair="voxels").flatten(cuts="standard"))
overlay = figures.Overlay(contrast, threshold=3, limits=(-8, 8), label="left against right button presses (z)")
figures.flat_map(maps, overlay, depth=2)

# %%
# Instead of a threshold, the magnitude of the statistic can set the opacity: weak effects fade out.

shaded = figures.Overlay(contrast, limits=(-8, 8), label="left against right button presses (z)")
figures.flat_map(maps, shaded, opacity=contrast, depth=2)
