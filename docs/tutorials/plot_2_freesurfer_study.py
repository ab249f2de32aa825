"""
.. _tutorial-study:

From a FreeSurfer study to a group report
=========================================

Suppose you have processed all subjects of a study with FreeSurfer's ``recon-all``. Two commands flatten every
hemisphere, write a report for each subject, and compare all subjects on one page. This tutorial runs both in about
half a minute and examines their output.
"""

import base64
import re
import subprocess
import sys
import tempfile
from io import BytesIO
from pathlib import Path

import matplotlib.pyplot as plt
import nibabel as nib
import numpy as np
from nilearn import datasets
from PIL import Image

# %%
# A small study
# -------------
# First, we create a small study with three subjects in FreeSurfer's layout: copies of fsaverage5 from nilearn, each
# with a different size and slightly bent, so that no two brains are alike. With your own data, skip this step and set
# ``study`` to the folder that contains ``sub-01/surf/lh.white`` and so on.

fsaverage5 = Path(datasets.__file__).parent / "data" / "fsaverage5"
study = Path(tempfile.mkdtemp()) / "study"


def write_subject(folder, seed):
    """Write the subject files that voxflat reads: white and pial surfaces, registered sphere and thickness."""
    random = np.random.default_rng(seed)
    size, waves, phases = random.uniform(0.94, 1.06, 3), random.normal(scale=0.04, size=(3, 3)), random.uniform(0, 6, 3)
    surf = folder / "surf"
    surf.mkdir(parents=True)
    for hemi, side in (("lh", "left"), ("rh", "right")):
        for name, source in (("white", "white"), ("pial", "pial"), ("sphere.reg", "sphere")):
            points, faces = nib.load(fsaverage5 / f"{source}_{side}.gii.gz").agg_data()
            if source != "sphere":
                points = points * size + 2.5 * np.sin(points @ waves + phases)
            nib.freesurfer.write_geometry(surf / f"{hemi}.{name}", points, faces)
        thickness = nib.load(fsaverage5 / f"thick_{side}.gii.gz").agg_data()
        nib.freesurfer.write_morph_data(surf / f"{hemi}.thickness", thickness * random.uniform(0.9, 1.1))


for number in (1, 2, 3):
    write_subject(study / f"sub-0{number}", number)

# %%
# Flatten all subjects
# --------------------
# ``voxflat bids STUDY OUTPUT participant`` finds the subjects and flattens both hemispheres of each. All maps have
# the same standard cuts. If one subject fails, for example because a file is missing, the others are still processed,
# and the report gives the reason. ``--participant-label 01`` processes only one subject, for example in a cluster
# job.


def voxflat(*arguments):
    """Run a voxflat command as in a terminal, and print its output."""
    command = [sys.executable, "-m", "voxflat.cli", *map(str, arguments)]
    print(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


maps = study / "maps"
voxflat("bids", study, maps, "participant")

# %%
# Each line describes one hemisphere: the number of points on its map and the mean relative error of distances. If you
# run the command again, it processes only missing or outdated results:

voxflat("bids", study, maps, "participant")

# %%
# What was written
# ----------------
# The output folder is a BIDS derivative. For each hemisphere it contains
#
# * ``*_flat.surf.gii``, the map as a flat surface, which Workbench and nilearn open;
# * ``*_flat.npz``, the complete map, which :func:`voxflat.load` and ``voxflat figure`` open;
# * ``*.shape.gii``, values at the vertices: thickness, curvature, sulcal depth, and how much the map distorts;
# * ``*_flat.json``, the distortion measures, warnings, parameters, and the checksums of all input files.
#
# ``sub-01.html`` is the report of one subject. This single file works offline.

for path in sorted((maps / "sub-01" / "anat").glob("*hemi-L*")):
    print(path.name)

# %%
# Compare the subjects
# --------------------
# The level ``group`` collects all hemispheres.

voxflat("bids", study, maps, "group")

# %%
# ``group.html`` shows all maps at the same scale, plots each distortion figure for each hemisphere, and marks
# outliers. The maps are embedded in the page; here we extract and display them, with left hemispheres above and right
# hemispheres below. Because the cuts are the same, the maps of one side look alike, so a subject with a poor surface
# or registration stands out.

page = (maps / "group.html").read_text()
pictures = [
    Image.open(BytesIO(base64.b64decode(found))) for found in re.findall(r"data:image/png;base64,([^\"]+)", page)
]
figure, axes = plt.subplots(2, 3, figsize=(9, 5.5), layout="constrained")
for ax, picture, title in zip(axes.ravel(), pictures, 2 * ("sub-01", "sub-02", "sub-03"), strict=False):
    ax.imshow(picture)
    ax.set_title(title)
    ax.axis("off")

# %%
# The mean of the group
# ---------------------
# The ``group`` level also writes the mean and the standard deviation of every overlay as images with one pixel per
# mm. Corresponding points of different subjects lie 5 to 10 mm apart on standard maps, so the mean is blurred by this
# distance.

figure, axes = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
for ax, letter, side in zip(axes, "LR", ("left", "right"), strict=True):
    mean = nib.load(maps / f"group_hemi-{letter}_stat-mean_desc-voxflat_thickness.nii.gz").get_fdata().squeeze()
    image = ax.imshow(mean, vmin=1.5, vmax=3.5)
    ax.set(title=f"mean thickness, {side}")
    ax.axis("off")
figure.colorbar(image, ax=axes, label="mm", shrink=0.7)

# %%
# ``group_desc-voxflat_measures.tsv`` lists all figures, with one row per hemisphere; its column ``outliers`` names
# the figures that deviate from the group.
#
# Where to go next
# ----------------
# * ``voxflat freesurfer sub-01`` writes the maps of one subject to its FreeSurfer folder.
# * :ref:`tutorial-hcp`: surfaces and data of the Human Connectome Project.
# * The job-array guide shows how to run one job per subject.
