"""Derive the template with which `voxflat.hemisphere` finds the parts of a brain: ``hemispheres.py``.

The white matter of MNI152, included in nilearn, is split at x = 0 mm, and separated from the cerebellum and the brain
stem at z = -14 mm. Voxels deep inside the white surfaces of fsaverage5, more than 5 mm from the cortex, are filled:
these are ventricles and deep nuclei. The file in the package has voxels of 2 mm and a size of some kilobytes.
"""

from pathlib import Path

import numpy as np
import pyvista as pv
import scipy.ndimage
from nilearn import datasets

import voxflat
from voxflat.demo import THRESHOLD, demo_cortex

OUTPUT = Path(voxflat.__file__).parent / "surfaces" / "standard" / "hemispheres.npz"
SIDES = ("left", "right")
TO_MNI152 = np.eye(4)  # from MNI305, the space of fsaverage
TO_MNI152[0] = 0.9975, -0.0073, 0.0176, -0.0429
TO_MNI152[1] = 0.0146, 1.0009, -0.0024, 1.5496
TO_MNI152[2] = -0.0130, -0.0093, 0.9971, 1.1840
DEEP = 5.0  # mm from the cortex
THIN = 0.2  # mm between the white and pial surfaces; less on the medial wall


def largest(mask):
    """Return the largest component under face adjacency."""
    components, _ = scipy.ndimage.label(mask)
    sizes = np.bincount(components.ravel())
    sizes[0] = 0
    return components == sizes.argmax()


def parted(white, affine):
    """Return 1 for the white matter of the left hemisphere, 2 for the right one, 3 for the rest."""
    x, y, z = (affine[axis, 3] + affine[axis, axis] * np.arange(length) for axis, length in enumerate(white.shape))
    labels = np.where(white, 3, 0).astype(np.uint8)
    for label, beyond in enumerate((x >= 0, x <= 0), 1):
        side = white.copy()
        side[beyond] = False
        side[np.ix_(np.abs(x) <= 20, (y > -45) & (y < 0), z == -14)] = False  # cut the brain stem
        labels[largest(side)] = label
    return labels


def inside(mesh, shape):
    """Return a mask of the voxels inside a closed surface whose points are voxel indices."""
    grid = pv.ImageData(dimensions=shape)
    mask = mesh.voxelize_binary_mask(reference_volume=grid)["mask"]
    return np.asarray(mask).reshape(shape[::-1]).T > 0


def deep(side, to_index, shape):
    """Return a mask of the voxels deep inside a hemisphere."""
    meshes = datasets.load_fsaverage("fsaverage5")
    white, pial = (meshes[name].parts[side] for name in ("white_matter", "pial"))
    is_cortex = np.linalg.norm(white.coordinates - pial.coordinates, axis=1) > THIN
    points = np.concatenate([white.coordinates, white.coordinates[white.faces].mean(axis=1)])
    places = (np.column_stack([points, np.ones(len(points))]) @ TO_MNI152.T @ to_index.T)[:, :3]
    is_near = np.concatenate([is_cortex, is_cortex[white.faces].all(axis=1)])
    far = np.ones(shape, dtype=bool)
    far[tuple(places[is_near].round().astype(int).T)] = False
    mesh = pv.PolyData.from_regular_faces(places[: len(white.coordinates)], white.faces)
    found = inside(mesh, shape) & (scipy.ndimage.distance_transform_edt(far) > DEEP)
    return scipy.ndimage.binary_opening(found, iterations=2)


def main():
    white_matter, _, _ = demo_cortex()
    affine, shape = white_matter.affine, white_matter.data.shape
    labels = parted(white_matter.data > THRESHOLD, affine)
    filled = np.zeros(shape, dtype=np.uint8)
    for label, side in enumerate(SIDES, 1):
        filled[deep(side, np.linalg.inv(affine), shape)] = label
    coarse = affine @ np.diag([2.0, 2.0, 2.0, 1.0])
    arrays = {"white": labels[::2, ::2, ::2], "deep": filled[::2, ::2, ::2], "affine": coarse}
    np.savez_compressed(OUTPUT, **arrays)
    print(f"{OUTPUT.stat().st_size / 1000:.0f} kB: {OUTPUT}")


if __name__ == "__main__":
    main()
