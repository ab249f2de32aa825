"""Pictures of functional data: a movie, and retinotopy.

    python docs/gallery/functional.py docs/pictures

On fsaverage5 (nilearn), whose visual cortex is stimulated by a wedge that turns once in 32 s: a simulation, with noise.
Phase and coherence are those of the Fourier transform at that frequency, as in any travelling-wave experiment.
"""

import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np

import voxflat
from voxflat import figures

PERIOD, STEP, CYCLES = 32.0, 2.0, 4  # s, s
POLE = np.array([-12.0, -98.0, -4.0])  # where the left calcarine sulcus begins, mm
REACH = 30.0  # mm


def main(output):
    """Draw all of them."""
    flat = hemisphere()
    series = stimulated(flat)
    look = {"threshold": 0.8, "limits": (-3, 3), "label": "signal change (%), simulated"}
    shown = figures.Overlay(series[:, : round(PERIOD / STEP)], **look, time_step=STEP)
    film = figures.movie(flat, shown, rate=8, size=480)
    figures.save_movie(film, output / "functional_movie.gif")
    phase, coherence = travelling_wave(series)
    look = {"threshold": 0.4, "strength": coherence, "period": 360, "label": "polar angle (degrees), simulated"}
    drawn = figures.flat_map(flat, figures.Overlay(phase, **look))
    figures.save(drawn, output / "functional_phase.png")
    print(*(output / name for name in ("functional_movie.gif", "functional_phase.png")), sep="\n")


def hemisphere():
    """Flatten fsaverage5's left hemisphere without its medial wall, along standard cuts."""
    data = Path(find_spec("nilearn").origin).parent / "datasets" / "data" / "fsaverage5"
    white, pial, sphere = (data / f"{name}_left.gii.gz" for name in ("white", "pial", "sphere"))
    return voxflat.surface(white, pial=pial).drop("medial wall").flatten(cuts="standard", sphere=sphere)


def stimulated(flat):
    """Return a series at the vertices, (V, T): those near the pole answer when the wedge is at their angle."""
    places = np.full((flat.metadata["vertices"], 3), np.nan)
    places[flat.ids] = flat.points
    away = np.nan_to_num(places - POLE, nan=1e3)
    angle = np.arctan2(away[:, 2], away[:, 0] + 4)  # around the sulcus: upper field below, lower field above
    gain = 3 * np.exp(-0.5 * (np.linalg.norm(away, axis=1) / REACH) ** 2)
    times = STEP * np.arange(round(CYCLES * PERIOD / STEP))
    signal = gain[:, None] * np.cos(2 * np.pi * times / PERIOD - angle[:, None])
    return signal + np.random.default_rng(0).normal(scale=0.5, size=signal.shape)


def travelling_wave(series):
    """Return the phase, degrees, and the coherence of each vertex at the frequency of the stimulus."""
    spectrum = np.fft.rfft(series, axis=1)[:, 1:]
    at = spectrum[:, CYCLES - 1]
    return np.degrees(-np.angle(at)) % 360, np.abs(at) / np.sqrt((np.abs(spectrum) ** 2).sum(axis=1))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
