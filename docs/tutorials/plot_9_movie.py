"""
.. _tutorial-movie:

A movie of a growing embryo
===========================

A movie of living tissue shows a surface that changes its shape. This tutorial flattens all frames with one map, on
which cells stay near their places. Growth can then be measured on the map, and cells drawn in two dimensions return to
the stack. All lengths are in µm. The tutorial runs in about thirty seconds.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import tifffile
from scipy import ndimage

import voxflat

# %%
# A movie to try it on
# --------------------
# :func:`voxflat.samples.embryo` makes a small movie: an embryo with 300 nuclei in seven stripes grows by a quarter and
# bends. It also returns where each nucleus is, so that the result can be checked. With your own movie, start with one
# segmentation per frame (labels, a mask or a probability map) and one stack per frame.

embryo = voxflat.samples.embryo()
print(embryo)
print(embryo.images[0])

figure, axes = plt.subplots(2, 3, figsize=(9, 3.6), layout="constrained")
for time, ax in enumerate(axes.flat):
    ax.imshow(embryo.images[time].data.max(axis=2).T, cmap="gray", origin="lower")
    ax.set_title(f"frame {time}")
    ax.axis("off")

# %%
# One surface per frame
# ---------------------
# The voxels are twice as long in z as in x and y, so the segmentation has steps. ``smooth(20)`` removes bumps that are
# shorter than 20 µm.

surfaces = [voxflat.surface(labels).smooth(20) for labels in embryo.labels]
print(surfaces[0], surfaces[0].warnings[-1])

# %%
# One map for all frames
# ----------------------
# :meth:`voxflat.Surface.charts` cuts the first frame along its back, from end to end.
# :func:`voxflat.flatten_series` flattens it, and moves its mesh onto each following frame with as little strain as
# possible. The gaps tell how far the moved surface is from each frame (95th percentile), and no triangle folds over.

(chart,) = surfaces[0].charts()
series = voxflat.flatten_series(surfaces, cuts=chart)
print(series)
print("gaps:", series.gaps.round(2), "µm; folded triangles:", series.folded.sum())

# %%
# The movie on the map
# --------------------
# Each stack is sampled on the surface of its own frame, 4 µm below it, where the nuclei are. The embryo grows and
# bends, but on the map each nucleus stays near its place.

movie = series.images(embryo.images, pixel_size=1.0, depth=-4.0)
print(movie)

figure, axes = plt.subplots(1, 3, figsize=(9, 3.4), layout="constrained")
for time, ax in zip((0, 2, 5), axes, strict=True):
    ax.imshow(movie[time][0].data, cmap="magma", vmin=10, vmax=160)
    ax.set_title(f"frame {time}")
    ax.axis("off")

# %%
# How well do cells stay in place?
# --------------------------------
# For each nucleus, we compare its place on the map in the first and in the last frame. The movement is found from the
# shape alone, so nuclei drift where the embryo bends.

first, last = (series[time].points_to_map(embryo.points[time])[0] for time in (0, 5))
apart = np.linalg.norm(first - last, axis=1)
print(f"drift: median {np.nanmedian(apart):.1f} µm, 95 % {np.nanpercentile(apart, 95):.1f} µm")

# %%
# If some cells were tracked in the volume, for example with TrackMate, their positions help as landmarks. Here, the
# positions of every tenth nucleus are known, and the drift of the others becomes smaller.

is_tracked = np.arange(len(embryo.points[0])) % 10 == 0
landmarks = np.array([points[is_tracked] for points in embryo.points])  # (frame, landmark, 3)
guided = voxflat.flatten_series(surfaces, cuts=chart, landmarks=landmarks)
first, last = (guided[time].points_to_map(embryo.points[time][~is_tracked])[0] for time in (0, 5))
apart = np.linalg.norm(first - last, axis=1)
print(f"drift: median {np.nanmedian(apart):.1f} µm, 95 % {np.nanpercentile(apart, 95):.1f} µm")

# %%
# Growth
# ------
# The two stretches of each point multiply to the growth of areas.

growth = series.stretches(5, since=0).prod(axis=1)
figure, ax = plt.subplots(figsize=(5, 4), layout="constrained")
pixels = series.flat_map.raster(1.0).interpolate(growth)
shown = ax.imshow(pixels, cmap="viridis", vmin=1.0, vmax=2.0)
figure.colorbar(shown, label="area, last frame / first frame")
ax.axis("off")

# %%
# Measure cells
# -------------
# Here, a simple threshold segments the nuclei in the flat image of the last frame. You can use cellpose or draw
# labels instead. The areas in the table are areas on the surface of that frame, corrected for the distortion of the
# map.

frame = series[5]
flat_image = movie[5][0].data
labels, count = ndimage.label(flat_image > 60)
regions = frame.regions(labels, pixel_size=1.0)
table = pd.DataFrame(regions.properties(flat_image, pixel_size=1.0))
print(count, "nuclei or clusters")
print(table.head())

# %%
# Save everything
# ---------------
# The series, and the images of all frames as one OME-TIFF file for Fiji, QuPath or napari.

folder = Path(tempfile.mkdtemp())
series.save(folder / "movie.npz")
movie.save(folder / "movie.ome.tif")
with tifffile.TiffFile(folder / "movie.ome.tif") as written:
    print(written.series[0].axes, written.series[0].shape)

# %%
# The same on the command line:
#
# .. code-block:: console
#
#     $ voxflat movie-map frame_*_labels.tif --smooth 20 -o movie.npz
#     $ voxflat image movie.npz --volume frame_*.tif --depth -4 -o movie.ome.tif
#
# Where to go next
# ----------------
# * :ref:`tutorial-microscopy`: more about a single stack.
# * The how-to guide on movies describes frames, checks and files.
