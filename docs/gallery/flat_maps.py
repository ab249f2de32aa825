"""Pictures of `docs/gallery.md`: folds, a statistic, no white matter, depths, thickness, an atlas with names.

    python docs/gallery/flat_maps.py .tools/t1prep docs/pictures

Everything comes from Python packages: the white matter of MNI152, a motor contrast and fsaverage5 (nilearn), T1Prep's
template with its atlas. All maps have standard cuts and lie alike: MNI152 is registered by its folds, the others have
their spheres.
"""

import sys
from importlib.util import find_spec
from pathlib import Path

import nibabel as nib
import numpy as np

import voxflat
from voxflat import demo, figures

ATLAS = "t1prep/data/atlases_surfaces_32k/lh.aparc_DK40.freesurfer.annot"
CENTRAL, SPHERE = (f"t1prep/data/templates_surfaces_32k/lh.{kind}.freesurfer.gii" for kind in ("central", "sphere"))
NO_CORTEX = ("unknown", "corpuscallosum")
SIDES = ("left", "right")
DEPTHS = (-1.0, 1.0, 3.0)  # mm outside white matter: in it, in grey matter, beyond


def main(packages, output):
    """Draw all of them."""
    data = Path(find_spec("nilearn").origin).parent / "datasets" / "data"
    white_matter, t1, _ = demo.demo_cortex()
    halves = [voxflat.hemisphere(white_matter, side, threshold=demo.THRESHOLD) for side in SIDES]
    both = [voxflat.flatten(voxflat.surface(half, repair="voxels"), cuts="standard") for half in halves]
    flat = both[0]
    draw(figures.flat_map(flat), output / "gallery_folds.png")
    label = "left against right button presses (z)"
    statistic = figures.Overlay(data / "image_10426.nii.gz", threshold=3, limits=(-8, 8), label=label)
    draw(figures.flat_map(both, statistic, depth=2), output / "gallery_statistic.png")
    contrast = data / "image_10426.nii.gz"
    shaded = figures.Overlay(contrast, limits=(-8, 8), label=label)
    draw(figures.flat_map(both, shaded, opacity=contrast, depth=2), output / "gallery_alpha.png")
    try:
        voxflat.hemisphere(t1, "left", threshold=0.3)
    except voxflat.HemisphereError as error:
        draw(error.figure(), output / "gallery_no_hemisphere.png")
    for number, depth in enumerate(DEPTHS):
        look = figures.Overlay(t1, colour_map="gray", limits=(0.2, 0.9), label=f"T1, {depth:+g} mm")
        draw(figures.flat_map(flat, look, depth=depth, width=60), output / f"gallery_depth_{number}.png")
    maps, thick = fsaverage(data / "fsaverage5")
    look = figures.Overlay(thick, limits=(1.5, 3.5), label="thickness (mm)")
    draw(figures.flat_map(maps, look), output / "gallery_thickness.png")
    draw(figures.flat_map(maps, statistic, fraction=0.5), output / "gallery_fsaverage.png")
    draw(atlas(packages), output / "gallery_atlas.png")


def fsaverage(folder):
    """Flatten both hemispheres of fsaverage5 without their medial walls; return the files of their thickness, too."""
    maps, values = [], []
    for side in SIDES:
        white, pial, sphere, thick = (folder / f"{name}_{side}.gii.gz" for name in ("white", "pial", "sphere", "thick"))
        surface = voxflat.surface(white, pial=pial).drop("medial wall")
        maps.append(surface.flatten(cuts="standard", sphere=sphere))
        values.append(thick)
    return maps, values


def atlas(packages):
    """Flatten T1Prep's template and show the atlas that it has, in two columns' width."""
    labels = packages / ATLAS
    numbers, _, names = nib.freesurfer.read_annot(labels)
    drop = (numbers < 0) | np.isin(numbers, [n for n, name in enumerate(names) if name.decode() in NO_CORTEX])
    flat = voxflat.surface(packages / CENTRAL).drop(drop).flatten(cuts="standard", sphere=packages / SPHERE)
    return figures.flat_map(flat, parcels=labels, width=170)


def draw(figure, path):
    """Save a figure."""
    figures.save(figure, path)
    print(path)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
