"""
Movies and phases
=================

A time series becomes a movie with a fixed colour scale and the time. The data are simulated: a wedge rotates through
the visual field once every 32 s, and the visual cortex gives a noisy response.

.. code-block:: console

    $ voxflat movie lh.npz --overlay bold.nii.gz --fraction 0.5 --change --threshold 0.8 --range -3,3 -o bold.mp4
    $ voxflat figure lh.npz --overlay angle.mgz --period 360 --strength coherence.mgz --threshold 0.4 -o angle.png
"""

from pathlib import Path

import nibabel as nib
import numpy as np
from nilearn import datasets

import voxflat
from voxflat import figures

folder = Path(datasets.__file__).parent / "data" / "fsaverage5"
white, pial, sphere = (folder / f"{name}_left.gii.gz" for name in ("white", "pial", "sphere"))
flat_map = voxflat.surface(white, pial=pial).drop("medial wall").flatten(cuts="standard", sphere=sphere)
away = nib.load(white).agg_data("pointset") - [-12, -98, -4]  # mm, from the occipital pole
angle = np.arctan2(away[:, 2], away[:, 0] + 4)
gain = 3 * np.exp(-0.5 * (np.linalg.norm(away, axis=1) / 30) ** 2)
wave = gain[:, None] * np.cos(2 * np.pi * np.arange(64) / 16 - angle[:, None])  # 4 cycles of 16 frames
series = wave + np.random.default_rng(0).normal(scale=0.5, size=wave.shape)
look = {"threshold": 0.8, "limits": (-3, 3), "label": "signal change (%), simulated"}
figures.movie(flat_map, figures.Overlay(series[:, :16], **look, time_step=2), rate=8, size=480)

# %%
# A phase map has a period, a cyclic colour map, and a colour wheel instead of a colour bar. Only points with a
# coherence above 0.4 are shown.

spectrum = np.fft.rfft(series, axis=1)[:, 1:]
phase = np.degrees(-np.angle(spectrum[:, 3])) % 360
coherence = np.abs(spectrum[:, 3]) / np.sqrt((np.abs(spectrum) ** 2).sum(axis=1))
look = {"threshold": 0.4, "strength": coherence, "period": 360, "label": "polar angle (degrees), simulated"}
flat_map.plot(figures.Overlay(phase, **look))
