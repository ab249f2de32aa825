"""
.. _tutorial-mask:

Draw a region on the map and use it as a mask
=============================================

On a flat map you can outline a region that is hidden in a fold of the brain. This tutorial draws a region around the
hand area of the motor cortex, carries it back through the cortex into the voxels of a volume, and reads values with
it. It takes about fifteen seconds.
"""

import tempfile
from pathlib import Path

import numpy as np
from nilearn import datasets, image, plotting

import voxflat
from voxflat import figures

data = Path(datasets.__file__).parent / "data"
fsaverage5 = data / "fsaverage5"
contrast = data / "image_10426.nii.gz"  # button presses with the left hand minus the right hand, z values
folder = Path(tempfile.mkdtemp())

# %%
# Make the map
# ------------
# The map is made from a white and a pial surface, as in :ref:`tutorial-statistic`. It knows both, and so it knows the
# cortex between them. This matters for the way back: a region on the map becomes a piece of cortex with a thickness.

surface = voxflat.surface(fsaverage5 / "white_right.gii.gz", pial=fsaverage5 / "pial_right.gii.gz")
flat_map = surface.drop("medial wall").flatten(cuts="standard", sphere=fsaverage5 / "sphere_right.gii.gz")

# %%
# Draw the region
# ---------------
# A region is a polygon in the coordinates of the map, (u, v) in mm. How do you find the coordinates of a place that
# you know? :meth:`voxflat.FlatMap.points_to_map` takes points in the brain to the map. Here is the peak of the
# contrast, at (44, -21, 58) mm; the second result is its distance from the surface midway between white and pial
# surface.

uv, distance = flat_map.points_to_map([[44, -21, 58]])
print(f"(u, v) = {np.round(uv[0], 1)} mm, {distance[0]:.1f} mm from the surface")

# %%
# The polygon surrounds this place. Its corners were chosen by looking at the activation.

hand = uv[0] + [[-30, 16], [-34, -14], [-16, -32], [6, -42], [22, -36], [26, -14], [12, 10], [-8, 26]]

# %%
# Draw the map in pyplot, and the polygon over it. The axes of the map inside the figure are in mm.

statistic = figures.Overlay(contrast, threshold=3, limits=(-8, 8), label="left minus right button presses (z)")
figure = flat_map.plot(statistic, fraction=0.5)
axes = next(ax for ax in figure.axes if ax.get_label() == "map")
axes.fill(*hand.T, facecolor="none", edgecolor="black", linewidth=1.5)
figure

# %%
# You need not type coordinates: :meth:`voxflat.FlatMap.regions` also reads paths that you draw into an SVG figure
# with Inkscape, a Shapes layer of napari, and label images.

regions = flat_map.regions({"hand area": hand})
print(regions)
print(f"{(regions.vertex_labels > 0).sum()} vertices")

# %%
# Carry it into the volume
# ------------------------
# A voxel belongs to the region if its centre lies in the cortex below or above the region. The mask gets the grid of
# the volume that you pass: here that of the statistic, with voxels of 3 mm.

regions.save(folder / "hand.nii.gz", volume=contrast)
mask = image.load_img(folder / "hand.nii.gz")
print(mask.shape, f"{int(mask.get_fdata().sum())} voxels")

# %%
# In the sections below the mask follows the cortical ribbon around the central sulcus. It does not leak into white
# matter or across the sulcus, as a sphere around the same point would.

template = data / "mni_icbm152_t1_tal_nlin_sym_09a_converted.nii.gz"
fine = regions.volume(template)
fine_mask = image.new_img_like(template, fine.data.astype(np.int32))
plotting.plot_roi(fine_mask, bg_img=str(template), cut_coords=(44, -21, 58), cmap="autumn", black_bg=False)

# %%
# Use the mask
# ------------
# From here on it is an ordinary mask, for nilearn, FSL or any other program.

values = image.load_img(contrast).get_fdata()[mask.get_fdata() > 0]
print(f"mean z = {values.mean():.1f}, maximum {values.max():.1f}, in {values.size} voxels")

# %%
# Check the way back
# ------------------
# A mask can be shown on the map like any other volume. The polygon and the voxels agree up to the size of a voxel.

shown = figures.Overlay(fine, threshold=0.5, limits=(0, 1), colour_map="autumn_r", label="mask")
figure = flat_map.plot(shown, fraction=0.5)
axes = next(ax for ax in figure.axes if ax.get_label() == "map")
axes.fill(*hand.T, facecolor="none", edgecolor="black", linewidth=1.5)
figure

# %%
# Save the region for other programs
# ----------------------------------
# ``.label`` is FreeSurfer's format for one region, ``.annot`` and ``.label.gii`` hold several. On the command line:
#
# .. code-block:: console
#
#     $ voxflat regions map.npz --svg drawn.svg -o rh.hand.label
#     $ voxflat regions map.npz --svg drawn.svg --volume zstat.nii.gz -o hand.nii.gz
#
# Where to go next
# ----------------
# * :ref:`tutorial-study`: maps of many subjects with the same cuts, on which one polygon fits all approximately.
# * :ref:`gallery-depth`: look at several depths of the cortex.

regions.save(folder / "rh.hand.label")
