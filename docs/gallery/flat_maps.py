"""Pictures of `docs/gallery.md`: folds, thickness of both hemispheres, an atlas with names, a thresholded statistic.

    python docs/gallery/flat_maps.py demo/map.npz .tools/t1prep docs/pictures

Everything comes from Python packages: nilearn's fsaverage5 and its motor contrast, T1Prep's template with its atlas.
"""

import sys
from importlib.util import find_spec
from pathlib import Path

import nibabel as nib
import numpy as np

import voxflat
from voxflat import figures

ATLAS = "t1prep/data/atlases_surfaces_32k/lh.aparc_DK40.freesurfer.annot"
CENTRAL = "t1prep/data/templates_surfaces_32k/lh.central.freesurfer.gii"
NO_CORTEX = ("unknown", "corpuscallosum")


def main(demo, packages, output):
    """Draw all of them."""
    data = Path(find_spec("nilearn").origin).parent / "datasets" / "data"
    draw(figures.flat_map(voxflat.load(demo)), output / "gallery_folds.png")
    contrast = figures.flat_map(
        voxflat.load(demo), data / "image_10426.nii.gz", depth=1.5, above=3, below=-3, limits=(-8, 8),
        label="left against right button presses (z)",
    )  # fmt: skip
    draw(contrast, output / "gallery_statistic.png")
    for side in ("left", "right"):
        draw(thickness(data / "fsaverage5", side), output / f"gallery_thickness_{side}.png")
    draw(atlas(packages), output / "gallery_atlas.png")


def thickness(folder, side):
    """Flatten a hemisphere of fsaverage5 without its medial wall, and show its thickness."""
    (white, faces), (pial, _) = (nib.load(folder / f"{name}_{side}.gii.gz").agg_data() for name in ("white", "pial"))
    structure = f"Cortex{side.title()}"
    faces = faces.astype(int)
    white, pial = (voxflat.io.Mesh(points.astype(float), faces, structure=structure) for points in (white, pial))
    flat = voxflat.flatten(voxflat.surface(white, pial=pial), drop="medial wall")
    values = np.asarray(nib.load(folder / f"thick_{side}.gii.gz").agg_data(), dtype=float)
    return figures.flat_map(flat, values, limits=(1.5, 3.5), label="thickness (mm)")


def atlas(packages):
    """Flatten T1Prep's template and show the atlas that it has, in two columns' width."""
    surface, labels = packages / CENTRAL, packages / ATLAS
    numbers, _, names = nib.freesurfer.read_annot(labels)
    drop = (numbers < 0) | np.isin(numbers, [n for n, name in enumerate(names) if name.decode() in NO_CORTEX])
    return figures.flat_map(voxflat.flatten(surface, drop=drop), parcels=labels, width=170)


def draw(figure, path):
    """Save a figure."""
    figures.save(figure, path)
    print(path)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
