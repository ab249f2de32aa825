"""Shapes of known geometry, as voxels."""

from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from voxflat.io.sources import taken
from voxflat.pipeline.surface import Surface
from voxflat.surfaces.foreground import foreground_of
from voxflat.surfaces.of_volume import of_volume

DATA = Path(__file__).parents[1] / "data"


def sheet(size=(40, 40)):
    """Return a flat sheet of voxels, one voxel thick, surrounded by background."""
    volume = np.zeros((size[0] + 2, size[1] + 2, 3), dtype=np.uint8)
    volume[1:-1, 1:-1, 1] = 1
    return volume


def two_sided(volume, repair=None):
    """Return the surface of a one-voxel-thick sheet, treated as a thin solid."""
    foreground = foreground_of(taken(volume), label=None, threshold=None)
    return of_volume(foreground, Surface, sheet=False, repair=repair)


def ball(radius=10):
    axis = np.arange(-radius - 2, radius + 3)
    return sum(np.meshgrid(axis**2, axis**2, axis**2, indexing="ij")) < radius**2


def curled_sheet(length=88.0, width=44.0, turns=0.9, rotation=None, traversed=False):
    """Curl a sheet along its length into an open cylinder and digitise it (Grossmann et al. 2002, figures 4 and 7).

    If `traversed`, the voxels are all those that the sheet intersects. Otherwise they are those whose centre lies
    within half a voxel of it along the axis nearest to its normal: one voxel in each column.
    """
    rotation = Rotation.identity() if rotation is None else rotation
    fine = 16  # samples per voxel
    angle = 2 * np.pi * turns * np.linspace(0, 1, int(length * fine))
    radius = length / (2 * np.pi * turns)
    normal = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    across = np.linspace(0, width, int(width * fine))
    points = (radius * normal)[:, None] + across[None, :, None] * [0, 0, 1]
    points = rotation.apply(points.reshape(-1, 3))
    normals = np.repeat(rotation.apply(normal), len(across), axis=0)
    points -= points.min(axis=0) - 2
    voxels = np.floor(points).astype(int)
    if not traversed:
        offset = voxels + 0.5 - points
        apart = np.abs((offset * normals).sum(axis=1))
        near = np.linalg.norm(offset, axis=1) < 1
        voxels = voxels[near & (apart <= np.abs(normals).max(axis=1) / 2)]
    volume = np.zeros(voxels.max(axis=0) + 3, dtype=bool)
    volume[tuple(voxels.T)] = True
    return volume


def depth_surface(depth):
    """Return the voxels of a depth image, 0 where it is empty, which reach down to the neighbours' depths."""
    depth = np.pad(np.asarray(depth, dtype=int), 1)
    low = depth.copy()
    for shift in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        neighbour = np.roll(depth, shift, axis=(0, 1))
        low = np.where(neighbour > 0, np.minimum(low, neighbour + 1), low)
    z = np.arange(depth.max() + 2)
    return (z <= depth[..., None]) & (z >= low[..., None]) & (depth[..., None] > 0)


def head_depth():
    """Return the depth image of a head, shape (279, 214); see data/README.md."""
    return np.asarray(Image.open(DATA / "demosthenes_depth.png"))


def line_links(direction, rng, lines=400, links=150):
    """Return the mean numbers of links along 0 to 3 axes of digitised lines, and the length of a line in voxels.

    A line is cut by the planes of voxel centres across its fastest axis; the other two coordinates are rounded.
    """
    step = 1 / np.abs(direction).max()
    start = rng.uniform(-0.5, 0.5, size=(lines, 1, 3))
    voxels = np.round(start + np.arange(links + 1)[None, :, None] * step * np.asarray(direction)).astype(int)
    return _link_counts(voxels) / lines, links * step


def circle_links(radius, rng):
    """Count the links of a digitised circle with random orientation and position, cut as in `line_links`."""
    angle = np.linspace(0, 2 * np.pi, int(radius * 2000))
    zero = np.zeros_like(angle)
    rotation = Rotation.random(None, rng)
    points = rotation.apply(radius * np.stack([np.cos(angle), np.sin(angle), zero], axis=1)) + rng.random(3)
    tangents = rotation.apply(np.stack([-np.sin(angle), np.cos(angle), zero], axis=1))
    main = np.abs(tangents).argmax(axis=1)[:-1]
    row = np.arange(len(main))
    cut = np.floor(points[row, main]) != np.floor(points[row + 1, main])
    voxels = np.round(points[:-1][cut]).astype(int)
    chain = [voxels[0]]
    for voxel in [*voxels[1:], voxels[0]]:
        while np.abs(voxel - chain[-1]).max() > 1:  # two cuts can be two voxels apart if the main axis changes
            chain.append(chain[-1] + np.sign(voxel - chain[-1]))
        chain.append(voxel)
    return _link_counts(np.array(chain)[None]), 2 * np.pi * radius


def _link_counts(voxels):
    axes = np.abs(np.diff(voxels, axis=1)).sum(axis=2)
    return np.bincount(axes.ravel(), minlength=4).astype(float)
