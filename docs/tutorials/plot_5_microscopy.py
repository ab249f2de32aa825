"""
.. _tutorial-microscopy:

A closed organ in microscopy
============================

voxflat is designed for the cortex, but it flattens any surface. This tutorial takes a microscopy stack of an embryo,
flattens the layer of cells at its surface, and shows their pattern on a single map instead of hundreds of sections.
All lengths are in µm. The tutorial runs in about twenty seconds.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import tifffile
from scipy import ndimage

import voxflat
from voxflat import figures

# %%
# A stack to try it on
# --------------------
# No package includes such a stack, so we make one: a bent ellipsoid, 470 µm long, whose surface is covered by 2000
# nuclei. The nuclei are brighter in seven stripes, like those of a pair-rule gene in *Drosophila*. The stack is saved
# as an ImageJ TIFF with voxels of 4 µm. With your own stack, start at the next step.

STEP = 4.0  # µm
random = np.random.default_rng(0)
shape = (130, 72, 64)
x, y, z = np.meshgrid(*(STEP * (np.arange(n) - (n - 1) / 2) for n in shape), indexing="ij")
inside = (x / 235) ** 2 + ((y + 30 * np.cos(np.pi * x / 480) - 15) / 105) ** 2 + (z / 95) ** 2 < 1
depth = STEP * ndimage.distance_transform_edt(inside)
layer = np.argwhere((depth > 8) & (depth <= 13))
nuclei = np.zeros(shape)
for voxel in layer[random.permutation(len(layer))[:2000]]:
    along = x[tuple(voxel)]
    nuclei[tuple(voxel)] = 1 + 3 * (np.cos(2 * np.pi * along / 56) > 0.2 and abs(along) < 196)
nuclei = np.tanh(ndimage.gaussian_filter(nuclei, 1.1) / 0.25)
stack = 70 * ndimage.gaussian_filter(inside.astype(float), 1) + 110 * nuclei + random.normal(scale=2, size=shape)
path = Path(tempfile.mkdtemp()) / "embryo.tif"
pages = np.clip(stack, 0, 255).astype(np.uint8).transpose(2, 1, 0)
about = {"axes": "ZYX", "spacing": STEP, "unit": "um"}
tifffile.imwrite(path, pages, imagej=True, resolution=(1 / STEP, 1 / STEP), metadata=about)

figure, axes = plt.subplots(1, 2, figsize=(9, 3), layout="constrained")
axes[0].imshow(pages[32], cmap="gray")
axes[1].imshow(pages[:, 36], cmap="gray")
for ax, title in zip(axes, ("a page of the stack", "a section across the pages"), strict=True):
    ax.set_title(title)
    ax.axis("off")

# %%
# Read it in µm
# -------------
# The TIFF file stores the size of its voxels in µm, and all results are in µm, too. The threshold separates tissue from
# background, and the surface is the border between the two. :meth:`voxflat.Surface.smooth` removes the bumps that are
# shorter than 40 µm, and reports how far this moved the surface. To choose one of several channels, use
# :func:`voxflat.io.read_volume`.

surface = voxflat.surface(path, threshold=35).smooth(40)
print(surface)
print(surface.warnings[-1])

# %%
# Choose a cut
# ------------
# The surface is closed, so it must be cut before it can be flattened. By default, voxflat chooses the cut. For an
# embryo, it is better to cut along one side, from pole to pole, so that the rest stays in one piece.
# :meth:`voxflat.Surface.path` finds the shortest path along the surface through points given by their voxels.

ids = surface.ids
side = ids[np.abs(ids[:, 2] - 32) < 1]  # the middle page
poles = side[side[:, 0].argmin()], side[side[:, 0].argmax()]
back = side[side[:, 1].argmax()]
cut = surface.path(poles[0], back, poles[1], geodesic="edges")
print(f"the cut is {cut.length:.0f} µm long")

# %%
# Flatten it
# ----------
# An embryo is curved everywhere, so no map of it is free of distortion. Further cuts at the border of the map reduce
# the distortion: ``relax=900`` lets voxflat extend the cuts until they are 900 µm long in total.

flat_map = surface.flatten(cuts=[cut.ids], relax=900)
print(flat_map)
print(*flat_map.distortion.table().splitlines()[1:3], sep="\n")

# %%
# See the map
# -----------
# The nuclei lie about 10 µm below the surface, so the stack is sampled at a depth of -10 µm; negative depths lie
# inside the surface. The seven stripes cross the map from side to side. The scale bar and all figures are in µm. The
# arrows point along the axes x, y and z of the stack.

stack = voxflat.io.read_volume(path).data.astype(float)  # whole numbers would be sampled as labels
overlay = figures.Overlay(stack, colour_map="magma", limits=(60, 180), label="intensity")
figures.flat_map(flat_map, overlay, depth=-10, width=120)

# %%
# How far can you trust distances?
# --------------------------------
# The heat map shows the mean error of the distances from each point. Be careful with distances from bright regions:
# measure them on the surface, with :meth:`voxflat.Surface.geodesic`.

figures.heat_map(flat_map)

# %%
# Measure along the surface
# -------------------------
# Each map point stores its position in the stack. The intensity along the long axis, averaged over the map, has seven
# peaks.

values = ndimage.map_coordinates(stack, (flat_map.points - 10 * flat_map.normals).T / STEP, order=1)
bins = np.digitize(flat_map.points[:, 0], np.arange(0, STEP * shape[0], 8))
figure, ax = plt.subplots(figsize=(7, 2.6), layout="constrained")
ax.plot(*zip(*((8 * n, values[bins == n].mean()) for n in np.unique(bins)), strict=True))
ax.set(xlabel="position along the embryo (µm)", ylabel="mean intensity")

# %%
# The same on the command line:
#
# .. code-block:: console
#
#     $ voxflat flatten embryo.tif --threshold 35 --smooth 40 -o embryo.npz
#     $ voxflat image embryo.npz --volume embryo.tif --depth=-10 --interpolation linear -o embryo_flat.tif
#
# Where to go next
# ----------------
# * :ref:`tutorial-large`: surfaces of a million vertices.
# * :ref:`tutorial-texture`: meshes and pictures.
