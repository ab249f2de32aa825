"""
.. _tutorial-statistic:

One fMRI statistic on a flat map
================================

You have a statistic in a volume, such as a z map from a group analysis, and the white and pial surfaces of a brain.
This tutorial flattens both hemispheres and shows the statistic on them. It takes about ten seconds.

The surfaces are those of fsaverage5, and the statistic is a motor contrast: both come with nilearn. With your own
subject, replace the files by FreeSurfer's ``lh.white``, ``lh.pial`` and ``lh.sphere.reg``.
"""

from pathlib import Path

import numpy as np
from nilearn import datasets

import voxflat
from voxflat import figures

data = Path(datasets.__file__).parent / "data"
fsaverage5 = data / "fsaverage5"
contrast = data / "image_10426.nii.gz"  # button presses with the left hand minus the right hand, z values

# %%
# Read the surface
# ----------------
# :func:`voxflat.surface` reads a white surface together with its pial surface. Distances are then measured midway
# between the two, in the middle of the cortex. The medial wall is not cortex. It is found where both surfaces touch,
# and dropped.

surface = voxflat.surface(fsaverage5 / "white_left.gii.gz", pial=fsaverage5 / "pial_left.gii.gz")
cortex = surface.drop("medial wall")
print(surface)
print(cortex)

# %%
# Flatten it
# ----------
# A hemisphere cannot be laid flat in one piece: it has to be cut open. *Standard cuts* run along the same lines in
# every brain, so that maps of different subjects can be compared. voxflat finds these lines with the registered
# sphere.

left = cortex.flatten(cuts="standard", sphere=fsaverage5 / "sphere_left.gii.gz")
print(left)

# %%
# Every map knows how much it distorts. The table compares distances on the map with distances along the surface. Read
# the first line first: on average, a distance on this map is wrong by that many per cent. The last lines count errors
# that must not occur, such as flipped triangles or parts of the map that cover each other. They should all be zero.

print(left.distortion.table())

# %%
# Show the folds
# --------------
# Without data, the figure shows the folds: gyri are light, sulci are dark. The arrows point to anterior and superior
# at the middle of the map, and the bar gives the scale. The names in italics stand where the border of the map is a
# cut.

left.plot()

# %%
# Show the statistic
# ------------------
# The contrast is a volume in MNI space. ``fraction=0.5`` samples it in the middle of the cortex, halfway between
# white and pial surface. Only values whose magnitude is greater than the threshold are shown; the folds stay visible
# elsewhere.

statistic = figures.Overlay(contrast, threshold=3, limits=(-8, 8), label="left minus right button presses (z)")
left.plot(statistic, fraction=0.5)

# %%
# Both hemispheres
# ----------------
# Flatten the right hemisphere in the same way, and draw both maps on one page with one colour scale. The hand area
# lies in the central sulcus. It responds to the *opposite* hand: red on the right map, blue on the left map.

right = (
    voxflat.surface(fsaverage5 / "white_right.gii.gz", pial=fsaverage5 / "pial_right.gii.gz")
    .drop("medial wall")
    .flatten(cuts="standard", sphere=fsaverage5 / "sphere_right.gii.gz")
)
figures.flat_map([left, right], statistic, fraction=0.5)

# %%
# From the map back to the brain
# ------------------------------
# Each point of a map keeps its place in the brain. Here is the peak of the contrast on each map, in mm: right,
# anterior and superior are positive.

for side, flat_map in (("left", left), ("right", right)):
    values = flat_map.image(contrast, pixel_size=1.0, fraction=0.5).data
    row, column = np.unravel_index(np.nanargmax(np.abs(values)), values.shape)
    _, points = flat_map.locate(pixel_size=1.0)
    print(f"{side}: z = {values[row, column]:.1f} at {np.round(points[row, column], 1)} mm")

# %%
# Save the maps and the figure
# ----------------------------
# A saved map holds the surface, the cuts, the distortion, and a record of the files that it was made from.
#
# .. code-block:: python
#
#     left.save("lh.npz")
#     figures.save(figures.flat_map([left, right], statistic, fraction=0.5), "motor.svg")
#
# The same steps on the command line:
#
# .. code-block:: console
#
#     $ voxflat flatten lh.white --pial lh.pial --drop medial-wall --cuts standard --sphere lh.sphere.reg -o lh.npz
#     $ voxflat flatten rh.white --pial rh.pial --drop medial-wall --cuts standard --sphere rh.sphere.reg -o rh.npz
#     $ voxflat figure lh.npz rh.npz --overlay zstat.nii.gz --fraction 0.5 --threshold 3 --range -8,8 -o motor.svg
#
# Where to go next
# ----------------
# * :ref:`tutorial-study`: many subjects, one report.
# * :ref:`tutorial-mask`: turn a region on the map into a mask for the volume.
# * :ref:`gallery`: what else a figure can show.
