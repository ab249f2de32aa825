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
# cortex between them. This matters for the way back: a region on the map becomes a piece of cortex with a thickness. A
# map without a pial surface, such as one made with ``--hemisphere``, does not know the thickness: pass a depth instead,
# in every step below that samples a volume (``depth=2.0`` instead of ``fraction=0.5``) or makes a mask.

surface = voxflat.surface(fsaverage5 / "white_right.gii.gz", pial=fsaverage5 / "pial_right.gii.gz")
flat_map = surface.drop("medial wall").flatten(cuts="standard", sphere=fsaverage5 / "sphere_right.gii.gz")

# %%
# Draw the region
# ---------------
# A region is a polygon in the coordinates of the map, (u, v) in mm: u runs to the right and v upwards. With standard
# cuts, (0, 0) is the same place in every brain; otherwise it is the mean position of all points of the map. How do you
# find the coordinates of a place that you know? :meth:`voxflat.FlatMap.points_to_map` takes points in the brain to the
# map. Here is the peak of the contrast, at (44, -21, 58) mm; the second result is its distance from the surface midway
# between white and pial surface.

uv, distance = flat_map.points_to_map([[44, -21, 58]])
print(f"(u, v) = {np.round(uv[0], 1)} mm, {distance[0]:.1f} mm from the surface")

# %%
# The polygon surrounds this place. Its corners were chosen by looking at the activation. Corners that you picked in a
# viewer go through ``points_to_map`` in the same way, or through ``voxflat points`` on the command line.

hand = uv[0] + [[-30, 16], [-34, -14], [-16, -32], [6, -42], [22, -36], [26, -14], [12, 10], [-8, 26]]

# %%
# Draw the map in pyplot, and the polygon over it. The axes of the map inside the figure are in mm. They are hidden by
# default; turn them on to read coordinates.

statistic = figures.Overlay(contrast, threshold=3, limits=(-8, 8), label="left minus right button presses (z)")
figure = flat_map.plot(statistic, fraction=0.5)
axes = next(ax for ax in figure.axes if ax.get_label() == "map")
axes.fill(*hand.T, facecolor="none", edgecolor="black", linewidth=1.5)
axes.set_axis_on()
axes.xaxis.tick_top()
axes.grid(alpha=0.5)
figure

# %%
# You need not type coordinates: :meth:`voxflat.FlatMap.regions` also reads paths that you draw with Inkscape into the
# layer ``rois`` of an SVG figure, a Shapes layer of napari, and label images.

regions = flat_map.regions({"hand area": hand})
print(regions)
print(f"{(regions.vertex_labels > 0).sum()} vertices")

# %%
# Carry it into the volume
# ------------------------
# A voxel belongs to the region if its centre lies in the cortex below or above the region. The mask gets the grid of
# the volume that you pass: here that of the statistic, with voxels of 3 mm. Without a pial surface, also pass
# ``depth=(0, 2.5)``: the voxels from the border of the white matter to 2.5 mm outside it.

regions.save(folder / "hand.nii.gz", volume=contrast)
mask = image.load_img(folder / "hand.nii.gz")
print(mask.shape, f"{int(mask.get_fdata().sum())} voxels")

# %%
# To check a mask, make it on a fine grid too: 3 mm is about the thickness of the cortex. Here it is on the grid of a T1
# image of 1 mm. The mask follows the cortical ribbon around the central sulcus. It lies between the white and the pial
# surface, so it does not leak across the sulcus, as a sphere around the same point would. (The surfaces are those of
# fsaverage, and the image is MNI152, so both fit only approximately.) With a depth instead of a pial surface, the mask
# has the same thickness everywhere. It then contains voxels of the opposite bank where banks are closer than the depth.

template = data / "mni_icbm152_t1_tal_nlin_sym_09a_converted.nii.gz"
fine = regions.volume(template)
fine_mask = image.new_img_like(template, fine.data.astype(np.int32))
plotting.plot_roi(fine_mask, bg_img=str(template), cut_coords=(44, -21, 58), cmap="autumn", black_bg=False)

# %%
# Use the mask
# ------------
# From here on it is an ordinary mask, for nilearn, FSL or any other program. The statistic is exactly 0 outside its own
# brain mask, so these voxels are excluded.

values = image.load_img(contrast).get_fdata()[mask.get_fdata() > 0]
print(f"{(values == 0).sum()} of {values.size} voxels lie outside the brain mask of the statistic")
values = values[values != 0]
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
#     $ voxflat figure map.npz --overlay zstat.nii.gz --threshold 3 -o drawn.svg    # draw in a new layer named rois
#     $ voxflat regions map.npz --svg drawn.svg -o rh.hand.label                    # vertices of a mesh
#     $ voxflat regions map.npz --svg drawn.svg --volume zstat.nii.gz -o hand.nii.gz                # with --pial
#     $ voxflat regions map.npz --svg drawn.svg --volume zstat.nii.gz --depth 0,2.5 -o hand.nii.gz  # without
#
# A map made from a volume has no mesh, so it saves voxels only.
#
# Where to go next
# ----------------
# * :ref:`tutorial-study`: maps of many subjects with the same cuts, on which one polygon fits all approximately.
# * :ref:`gallery-depth`: look at several depths of the cortex.

regions.save(folder / "rh.hand.label")
