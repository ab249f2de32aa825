"""
Folds
=====

Without data, a figure shows the folds: gyri are light, sulci are dark. By default, the shades of grey show the mean
curvature of the uncut surface. ``underlay="sulcal depth"`` shows the depth of each point instead.

.. code-block:: console

    $ voxflat flatten lh.white --pial lh.pial --drop medial-wall -o lh.npz
    $ voxflat figure lh.npz -o folds.png
    $ voxflat figure lh.npz --underlay "sulcal depth" -o depth.png
"""

from pathlib import Path

from nilearn import datasets

import voxflat

folder = Path(datasets.__file__).parent / "data" / "fsaverage5"
surface = voxflat.surface(folder / "white_left.gii.gz", pial=folder / "pial_left.gii.gz").drop("medial wall")
flat_map = surface.flatten(cuts="standard", sphere=folder / "sphere_left.gii.gz")
flat_map.plot(underlay="sulcal depth")
