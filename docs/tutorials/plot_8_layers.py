"""
.. _tutorial-layers:

Layer fMRI: from a rim to a profile
===================================

In layer fMRI, the cortex is often segmented by hand, in a patch that covers only part of the brain. There are no white
and pial surfaces. This tutorial starts with such a segmentation, called a *rim*. It divides the grey matter into layers
and columns, flattens it into a flat volume, and plots activity along cortical depth. It runs in about a minute.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.ndimage import zoom
from scipy.spatial import cKDTree

import voxflat
from voxflat.io import write_volume

# %%
# Data to try it on
# -----------------
# We make a patch of folded cortex, 2.5 mm thick, with voxels of 0.4 mm. As in LayNii, 1 marks the outer border
# (cerebrospinal fluid), 2 the inner border (white matter), and 3 grey matter. With your own rim, skip to the section
# about depth.

STEP = 0.4  # mm
x, y, z = np.meshgrid(np.arange(-16, 16, STEP), np.arange(-10, 10, STEP), np.arange(-6, 9, STEP), indexing="ij")


def height(x, y):
    """Return the height of the inner border of the grey matter."""
    return 2.5 * np.sin(x / 3.2 + 0.06 * y) * (1 + 0.02 * y)


border = np.stack(np.meshgrid(np.arange(-22, 22, 0.1), np.arange(-16, 16, 0.1), indexing="ij"), axis=-1).reshape(-1, 2)
border = np.column_stack([border, height(*border.T)])
distance, foot = cKDTree(border).query(np.stack([x, y, z], axis=-1).reshape(-1, 3))
distance = distance.reshape(x.shape) * np.sign(z - height(x, y))
foot = border[foot.reshape(x.shape)]
labels = np.select(
    [abs(distance + 0.4) <= 0.4, (distance > 0) & (distance < 2.5), abs(distance - 2.9) <= 0.4], [2, 3, 1]
)

# %%
# The activity is superficial in one area, and deep in another. The functional volume has larger voxels, of 0.8 mm, and
# noise.

depth = distance / 2.5
activity = sum(
    np.exp(-((foot[..., 0] - at) ** 2 + foot[..., 1] ** 2) / 30 - (depth - peak) ** 2 / 0.05)
    for at, peak in ((-8, 0.8), (8, 0.25))
)
bold = zoom(activity, 0.5, order=1, grid_mode=True, mode="nearest")
bold += np.random.default_rng(0).normal(scale=0.1, size=bold.shape)

folder = Path(tempfile.mkdtemp())
affine = np.diag([STEP, STEP, STEP, 1.0])
affine[:3, 3] = x.min(), y.min(), z.min()
coarse = np.diag([2 * STEP, 2 * STEP, 2 * STEP, 1.0])
coarse[:3, 3] = affine[:3, 3] + STEP / 2
write_volume(folder / "rim.nii.gz", labels.astype(np.uint8), affine)
write_volume(folder / "bold.nii.gz", bold.astype(np.float32), coarse)

# %%
# Measure depth
# -------------
# :func:`voxflat.rim` finds both borders with subvoxel accuracy. Each voxel of grey matter then has a depth between
# them. Layers of equal volume, the default, are thinner on the convex side of a fold.

rim = voxflat.rim(folder / "rim.nii.gz")
print(rim)
columns = rim.columns(area=4.0)
print(columns)

figure, axes = plt.subplots(2, 2, figsize=(9, 5), layout="constrained")
pictures = {
    "rim": (labels.astype(float), "viridis"),
    "depth (equivolume)": (rim.depth().data, "magma"),
    "9 layers": (rim.layers(9).data.astype(float), "turbo"),
    "columns of 4 mm²": (np.where(columns.volume.data > 0, columns.volume.data % 20 + 1.0, 0), "tab20"),
}
for ax, (title, (data, colours)) in zip(axes.flat, pictures.items(), strict=True):
    section = np.where(labels > 0, data, np.nan)[:, data.shape[1] // 2].T
    ax.imshow(np.where(section > 0, section, np.nan), origin="lower", cmap=colours, interpolation="nearest")
    ax.set_title(title)
    ax.axis("off")

# %%
# Flatten it
# ----------
# The surface halfway between the borders can be flattened like any other surface. With ``depths``,
# :meth:`voxflat.FlatMap.images` samples a volume at the centre of each layer. The result is a flat volume: a map for
# each depth. Superficial activity appears in the last maps, and deep activity in the first ones.

flat_map = rim.surface.flatten()
print(*flat_map.distortion.table().splitlines()[1:3], sep="\n")
flat_volume = flat_map.images(folder / "bold.nii.gz", depths=5)

figure, axes = plt.subplots(1, 5, figsize=(10, 2.6), layout="constrained")
for ax, image in zip(axes, flat_volume, strict=True):
    ax.imshow(image.data, cmap="inferno", vmin=0, vmax=0.8, extent=image.extent)
    ax.set_title(f"depth {image.name.split()[-1]}")
    ax.axis("off")

# %%
# Draw regions, and plot profiles
# -------------------------------
# Regions that are drawn on the map contain complete columns. Here, we draw a square of 8 mm around each area.
# :meth:`voxflat.Rim.profile` averages the functional volume in each layer.

regions = {}
for name, side in (("superficial", -1), ("deep", 1)):
    places = flat_map.points_to_map(np.array([[side * 8.0, 0.0, height(side * 8.0, 0.0) + 1.25]]))[0]
    (u, v) = places[0]
    regions[name] = [[u - 4, v - 4], [u + 4, v - 4], [u + 4, v + 4], [u - 4, v + 4]]

profile = rim.profile(folder / "bold.nii.gz", flat_map.regions(regions), count=10)
print(profile)
profile.plot(label="activity")

# %%
# Back to the volume
# ------------------
# :meth:`voxflat.Rim.paint` transfers a flat volume to the voxels of the grey matter. Values are not interpolated, so
# labels that were drawn in the flat volume are transferred exactly. Here, voxels of the flat volume with high activity
# are labelled.

drawn = (np.nan_to_num(flat_volume.data) > 0.35).astype(np.uint8)
painted = rim.paint(drawn, flat_map)
section = (painted.data + 1 * (labels == 3))[:, labels.shape[1] // 2].T
figure, ax = plt.subplots(figsize=(6, 2.4), layout="constrained")
ax.imshow(section, origin="lower", cmap="inferno", interpolation="nearest")
ax.axis("off")

# %%
# On the command line
# -------------------
#
# .. code-block:: console
#
#     $ voxflat layers rim.nii.gz -n 9 -o layers.nii.gz
#     $ voxflat columns rim.nii.gz --area 4 -o columns.nii.gz
#     $ voxflat flatten rim.nii.gz --rim -o map.npz
#     $ voxflat image map.npz --volume bold.nii.gz --depths 5 -o flat_volume.nii.gz
#     $ voxflat profile rim.nii.gz --volume bold.nii.gz -n 10 -o profile.tsv --figure profile.png
#
# Where to go next
# ----------------
# * :ref:`tutorial-statistic`: data of a complete hemisphere.
