"""
.. _tutorial-texture:

A picture on a scanned surface
==============================

To put a picture on a mesh, a renderer needs *texture coordinates*, which assign a part of the picture to each
triangle. A flat map provides them. Since it preserves distances, the picture is hardly stretched. This tutorial
covers the scan of a skull with a chequered pattern and puts a logo on its forehead. It runs in about ten seconds.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pyvista as pv
from PIL import Image
from pyvista import examples

import voxflat
from voxflat import figures

pv.OFF_SCREEN = True
folder = Path(tempfile.mkdtemp())

# %%
# Read the scan
# -------------
# The skull is a closed mesh in the voxflat repository, with 5,154 vertices and two handles (the cheek bones). A PLY
# file does not store a unit, so we pass it. (The scan shows a small model, 14 cm high.)

surface = voxflat.surface(Path("../../tests/data/skull.ply"), unit="cm")
print(surface)
print(np.round(np.ptp(surface.points, axis=0), 1), "cm")

# %%
# Flatten it
# ----------
# voxflat automatically cuts a closed surface with handles. The map's metadata list each cut and the reason for it.

flat_map = surface.flatten()
for cut in flat_map.metadata["automatic_cuts"]:
    print(f"{cut['length']:.1f} cm: {cut['reason']}")

# %%
# The figure shows the map coloured by the height above the chin. The border of the map consists of the cuts.

height = figures.Overlay(surface.points[:, 1], limits=(0, 14), label="height (cm)")
flat_map.plot(height, underlay="none", width=60)

# %%
# A pattern all over
# ------------------
# :meth:`voxflat.FlatMap.textured` places a picture on the map and transfers it to the surface. ``texel_size`` is the
# width of a picture pixel on the surface, and ``repeat`` tiles the picture. Here each square is 0.5 cm wide.

tone = np.kron([[0, 1], [1, 0]], np.ones((16, 16), dtype=int))
chequers = np.array([[226, 214, 190], [60, 92, 128]], dtype=np.uint8)[tone]
textured = flat_map.textured(chequers, texel_size=0.5 / 16, repeat=True)
print(textured)

# %%
# To show it in PyVista, pass the points, the triangles and the texture coordinates. PyVista needs one texture
# coordinate per point, so the surface is opened at the cuts. The squares keep their size over bumps and hollows, but
# the rows do not match across cuts.


def show(textured, direction, rest=None):
    """Render a textured surface with PyVista and, if given, the rest of the surface in one colour."""
    textured = textured.opened()
    mesh = pv.PolyData.from_regular_faces(textured.points, textured.faces)
    mesh.active_texture_coordinates = textured.texture_coordinates
    texture = pv.Texture(textured.picture)
    texture.repeat = True
    plotter = pv.Plotter(off_screen=True, window_size=(700, 700))
    plotter.set_background("white")
    plotter.add_mesh(mesh, texture=texture, smooth_shading=True, ambient=0.3, diffuse=0.8, specular=0)
    if rest is not None:
        body = pv.PolyData.from_regular_faces(rest.points * 0.995, rest.faces)
        plotter.add_mesh(body, color=(226, 214, 190), smooth_shading=True, ambient=0.3, diffuse=0.8, specular=0)
    plotter.view_vector(direction, viewup=(0, 1, 0))
    plotter.camera.zoom(1.2)
    return plotter.screenshot()


figure, axes = plt.subplots(1, 2, figsize=(9, 4.6), layout="constrained")
for ax, direction in zip(axes, ((0.5, 0.2, 1), (-1, 0.5, -0.6)), strict=True):
    ax.imshow(show(textured, direction))
    ax.axis("off")

# %%
# A picture at one place
# ----------------------
# For a single picture, flatten only its target region. A disk with a radius of 4 cm around the top of the forehead
# has little curvature, so it needs no cut and is hardly distorted.

forehead = int(np.linalg.norm(surface.points - [0, 10.5, 5.5], axis=1).argmin())
cap = surface.disk(forehead, radius=4.0).flatten()
print(cap)

# %%
# We paste the PyVista logo on a bone-coloured square. Maps are oriented with z pointing up, but in this scan y points
# up, so the map of the forehead is upside down. We therefore rotate the picture by 180° before placing it on the map.

logo = Image.open(examples.logofile)
square = Image.new("RGBA", (1800, 1800), (226, 214, 190, 255))
square.alpha_composite(logo, ((1800 - logo.width) // 2, (1800 - logo.height) // 2))
branded = cap.textured(square.rotate(180))

# %%
# The rest of the skull is drawn without a texture and slightly smaller, so that the disk lies on top.

show(branded, (0.2, 0.5, 1), surface)

# %%
# Save it
# -------
# ``.obj`` comes with its picture and a material file, ``.glb`` is a single file for web pages and game engines, and
# ``.vtp`` is for ParaView. ``.ply`` stores vertex colours instead, with additional vertices where the picture needs
# them.

textured.save(folder / "skull.obj")
textured.save(folder / "skull.glb")
print(sorted(path.name for path in folder.iterdir()))

# %%
# On the command line:
#
# .. code-block:: console
#
#     $ voxflat flatten skull.ply --unit cm -o skull.npz
#     $ voxflat texture skull.npz chequers.png --texel-size 0.03 --repeat -o skull.glb
#
# Where to go next
# ----------------
# * :ref:`gallery-pyvista`: ``mesh.voxflat`` does the same within PyVista.
# * :ref:`tutorial-microscopy`: surfaces from volumes.
