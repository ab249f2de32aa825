"""Pictures of `docs/gallery.md`: folds, a statistic, depths, thickness of both hemispheres, an atlas with names.

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
DEPTHS = (-1.0, 1.0, 3.0)  # mm outside white matter: in it, in grey matter, beyond


def main(packages, output):
    """Draw all of them."""
    data = Path(find_spec("nilearn").origin).parent / "datasets" / "data"
    white_matter, t1, _ = demo.demo_cortex()
    flat = voxflat.flatten(voxflat.hemisphere(white_matter, "left", threshold=demo.THRESHOLD), cuts="standard")
    draw(figures.flat_map(flat), output / "gallery_folds.png")
    label = "left against right button presses (z)"
    statistic = figures.Overlay(data / "image_10426.nii.gz", threshold=3, limits=(-8, 8), label=label)
    contrast = figures.flat_map(flat, statistic, depth=1.5)
    draw(contrast, output / "gallery_statistic.png")
    for number, depth in enumerate(DEPTHS):
        look = figures.Overlay(t1, colour_map="gray", limits=(0.2, 0.9), label=f"T1, {depth:+g} mm")
        draw(figures.flat_map(flat, look, depth=depth, width=60), output / f"gallery_depth_{number}.png")
    for side in ("left", "right"):
        draw(thickness(data / "fsaverage5", side), output / f"gallery_thickness_{side}.png")
    draw(atlas(packages), output / "gallery_atlas.png")


def thickness(folder, side):
    """Flatten a hemisphere of fsaverage5 without its medial wall, and show its thickness."""
    (white, faces), (pial, _), (sphere, _) = (
        nib.load(folder / f"{name}_{side}.gii.gz").agg_data() for name in ("white", "pial", "sphere")
    )
    structure = f"Cortex{side.title()}"
    faces = faces.astype(int)
    white, pial = (voxflat.io.Mesh(points.astype(float), faces, structure=structure) for points in (white, pial))
    surface = voxflat.surface(white, pial=pial)
    flat = surface.drop("medial wall").flatten(cuts="standard", sphere=sphere.astype(float))
    values = np.asarray(nib.load(folder / f"thick_{side}.gii.gz").agg_data(), dtype=float)
    return figures.flat_map(flat, figures.Overlay(values, limits=(1.5, 3.5), label="thickness (mm)"))


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
