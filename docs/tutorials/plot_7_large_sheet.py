"""
.. _tutorial-large:

A large surface: unrolling a scroll
===================================

Segmentations of scrolls, leaves or whole organs can have millions of vertices. This tutorial rolls up and dents a
page of text, then flattens the resulting mesh of a million vertices so that the text can be read again. On two cores
it takes about two minutes and three gigabytes of memory.
"""

import resource
import time

import matplotlib.pyplot as plt
import numpy as np
import pyvista as pv
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import voxflat

pv.OFF_SCREEN = True

# %%
# A page of text
# --------------
# The page is an image of 500 by 2,000 pixels. Each pixel becomes one of a million vertices.

ROWS, COLUMNS = 500, 2000
page = Figure(figsize=(COLUMNS / 100, ROWS / 100), dpi=100)
page.text(
    0.5, 0.5, "A page of a million vertices,\nrolled up, dented, and unrolled.", fontsize=88, ha="center", va="center"
)
canvas = FigureCanvasAgg(page)
canvas.draw()
ink = 255 - np.asarray(canvas.buffer_rgba())[::-1, :, 0]

# %%
# Roll it up
# ----------
# The page measures 400 by 100 mm. It becomes a spiral whose layers are 3 mm apart and dented by up to 0.6 mm. The
# result is a mesh of points and triangles, like the segmentation of a real scroll.

SIZE = 0.2  # mm per pixel
turn = np.linspace(0, 40, 20_000)  # radians
radius = 5 + 3 * turn / (2 * np.pi)
length = np.append(0, np.cumsum(np.hypot(np.diff(radius * np.cos(turn)), np.diff(radius * np.sin(turn)))))
angle, height = np.meshgrid(np.interp(SIZE * np.arange(COLUMNS), length, turn), SIZE * np.arange(ROWS))
away = 5 + 3 * angle / (2 * np.pi) + 0.6 * np.sin(height / 6 + 2 * angle) * np.sin(5 * angle)
points = np.stack([away * np.cos(angle), away * np.sin(angle), height], axis=-1).reshape(-1, 3)
corners = np.arange(ROWS * COLUMNS).reshape(ROWS, COLUMNS)
a, b, c, d = (part.ravel() for part in (corners[:-1, :-1], corners[:-1, 1:], corners[1:, 1:], corners[1:, :-1]))
faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])

mesh = pv.PolyData.from_regular_faces(points, faces)
mesh["ink"] = ink.ravel()
plotter = pv.Plotter(off_screen=True, window_size=(900, 700))
plotter.set_background("white")
plotter.add_mesh(mesh, scalars="ink", cmap="copper_r", show_scalar_bar=False, ambient=0.3)
plotter.view_vector((0.4, -1, 0.9), viewup=(0, 0, 1))
plotter.camera.zoom(1.05)
plotter.screenshot()

# %%
# Flatten it
# ----------
# The spiral has one boundary and no handles, so it is already a disk and does not need a cut. voxflat checks the
# required memory before it starts. ``memory_limit`` sets a custom limit, and ``progress`` accepts a function that
# reports progress.

start = time.perf_counter()
surface = voxflat.surface((points, faces), unit="mm")
flat_map = surface.flatten()
print(flat_map)
print(f"{time.perf_counter() - start:.0f} s; {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.1f} GB at most")

# %%
# How good is the map?
# --------------------
# A rolled page can be flattened without distortion, so errors should be tiny. The remaining errors come from the
# dents, which stretch the page locally. No triangle is flipped, and no part of the map covers another.

print(*flat_map.distortion.table().splitlines()[1:6], sep="\n")
triangles = flat_map.distortion.triangles
print(f"{triangles.flipped} flipped triangles, {triangles.covering} that cover another one")

# %%
# Read the page
# -------------
# :meth:`voxflat.FlatMap.image` resamples vertex values to map pixels. For the volume of a real scroll, pass its path
# and a depth instead: ``flat_map.image("scroll.zarr", depth=0.1)``. Only the chunks that the surface intersects are
# read.

image = flat_map.image(ink.ravel().astype(float), pixel_size=0.25)
figure, ax = plt.subplots(figsize=(9, 2.6), layout="constrained")
ax.imshow(image.data, cmap="copper_r")
ax.axis("off")

# %%
# Time and memory are roughly proportional to the number of vertices. For a first look at a large surface, flatten a
# coarser mesh, for example from PyVista's ``mesh.decimate(0.9)``.
#
# On the command line:
#
# .. code-block:: console
#
#     $ voxflat flatten scroll.ply --unit mm -o scroll.npz
#     $ voxflat image scroll.npz --volume scroll.ome.zarr --depth 0.1 -o page.tif
#
# Where to go next
# ----------------
# * :ref:`tutorial-texture`: put pictures on surfaces.
# * :ref:`tutorial-microscopy`: surfaces from a stack of images.
