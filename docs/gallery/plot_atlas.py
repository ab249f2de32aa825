"""
.. _gallery-atlas:

An atlas with names
===================

Borders, colours and names come from the label file. Names that do not fit in their parcel are omitted; a wider figure
fits more names. In an SVG file the names are text, and ``curvature``, ``parcels``, ``names`` and ``marks`` are
layers.

.. code-block:: console

    $ voxflat figure lh.npz --parcels lh.aparc.annot --width 170 -o atlas.svg
"""

import os
from pathlib import Path

import nibabel as nib
import numpy as np

import voxflat

data = Path(os.environ["VOXFLAT_DOCS_DATA"]) / "t1prep" / "data"  # pip install --no-deps --target ... t1prep==0.8.1
parcels = data / "atlases_surfaces_32k" / "lh.aparc_DK40.freesurfer.annot"
central, sphere = (data / "templates_surfaces_32k" / f"lh.{kind}.freesurfer.gii" for kind in ("central", "sphere"))
labels, _, names = nib.freesurfer.read_annot(parcels)
wall = (labels < 0) | np.isin(labels, [names.index(b"unknown"), names.index(b"corpuscallosum")])
flat_map = voxflat.surface(central).drop(wall).flatten(cuts="standard", sphere=sphere)
flat_map.plot(parcels=parcels, width=170)
