"""
.. _gallery-depth:

Three depths
============

The panels show the same patch of cortex in a T1 image at three distances from the white-matter border: 1 mm inside,
in white matter; 1 mm outside, in grey matter; and 3 mm outside, at the outer border. With a white and a pial surface,
``fraction=0.5`` is the middle of the cortex instead.

.. code-block:: console

    $ voxflat flatten wm.nii.gz --threshold 0.5 --seed-point 136,112,127 --radius 45 -o map.npz
    $ voxflat figure map.npz --overlay t1.nii.gz --depth -1 --cmap gray --range 0.2,0.9 -o t1_in_white.png
"""

import matplotlib.pyplot as plt

import voxflat
from voxflat import demo, figures

white_matter, t1, _ = demo.demo_cortex()
surface = voxflat.surface(white_matter, threshold=0.5).disk(demo.SEED_POINT, radius=45)
flat_map = surface.flatten()
figure, axes = plt.subplots(1, 3, figsize=(9, 3.9), dpi=200)
figure.subplots_adjust(left=0, right=1, bottom=0, top=1, wspace=0.03)
for ax, depth in zip(axes, (-1, 1, 3), strict=True):
    overlay = figures.Overlay(t1, colour_map="gray", limits=(0.2, 0.9), label=f"T1, {depth:+d} mm")
    flat_map.plot(overlay, depth=depth, ax=ax)
