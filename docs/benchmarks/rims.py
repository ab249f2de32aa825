"""Rims beside LayNii on the same files: bias in slabs, columns from border to border, and time.

python docs/benchmarks/rims.py slabs --laynii DIR               # where LN2_LAYERS and LN2_COLUMNS were built
python docs/benchmarks/rims.py small --laynii DIR               # spherical shells of a few voxels
python docs/benchmarks/rims.py columns --laynii DIR RIM...      # such as LayNii's sc_rim.nii.gz
python docs/benchmarks/rims.py time --laynii DIR RIM            # three alternate pairs; medians of the ratios
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import scipy
from columns import connected
from columns import laynii as laynii_columns
from layers import bent_layers
from layers import laynii as laynii_layers

import voxflat

_CUBE = np.ones((3, 3, 3), dtype=bool)


def bias(depth, truth):
    """Return the mean error as text."""
    error = (depth - truth)[np.isfinite(truth) & np.isfinite(depth)]
    return f"{error.mean():+.3f}"


def slabs(folder):
    """Print the bias of equivolume depth in slabs, beside LN2_LAYERS."""
    print("shape, voxels | slices | voxflat | LN2_LAYERS | voxflat equidistant | LN2_LAYERS equidistant")
    for shape in ("cylinder", "fold", "sphere"):
        for spacing in (0.5, 0.3, 0.2):
            labels, volume, straight = bent_layers(shape, spacing)
            for count in (1, 3, 5, 15, 40):
                first = (labels.data.shape[2] - count) // 2
                if first < 0:
                    continue
                slab = np.s_[:, :, first : first + count]
                part = voxflat.io.Volume(labels.data[slab].copy(), labels.affine)
                rim = voxflat.rim(part)
                # Folds are curved at the ends of their labels along the first axis.
                inner = np.s_[8:-8] if shape == "fold" else np.s_[:]
                found = [rim.depth(layering).data for layering in ("equivolume", "equidistant")]
                others = laynii_layers(folder, part)[:2]
                cells = [
                    bias(depth[inner], true[slab][inner])
                    for true, pair in ((volume, (found[0], others[0])), (straight, (found[1], others[1])))
                    for depth in pair
                ]
                print(" | ".join([f"{shape}, {spacing} mm", str(count), *cells]), flush=True)


def small(folder):
    """Print the bias in spherical shells with a small inner radius, at eight positions of the grid."""
    print("inner radius, thickness (voxels) | mean, range of voxflat | mean, range of LN2_LAYERS")
    random = np.random.default_rng(0)
    for radius, thickness in ((4, 4), (4, 8), (6, 6), (8, 8)):
        size = radius + thickness + 6
        axes = np.meshgrid(*[np.arange(-size, size + 1)] * 3, indexing="ij")
        errors = []
        for shift in random.random((8, 3)):
            distance = np.linalg.norm(np.stack(axes, axis=-1) - shift, axis=-1)
            parts = [distance < radius, distance <= radius + thickness]
            labels = np.select(parts, [2, 3], 1).astype(np.int16)
            truth = (distance**3 - radius**3) / ((radius + thickness) ** 3 - radius**3)
            volume = voxflat.io.Volume(labels, np.eye(4))
            found = voxflat.rim(volume).depth().data, laynii_layers(folder, volume)[0]
            errors.append([(depth - truth)[labels == 3].mean() for depth in found])
        cells = [
            f"{mean:+.3f}, {low:+.3f} to {high:+.3f}"
            for mean, low, high in zip(
                np.mean(errors, axis=0), np.min(errors, axis=0), np.max(errors, axis=0), strict=True
            )
        ]
        print(" | ".join([f"{radius}, {thickness}", *cells]), flush=True)


def reach(columns, labels):
    """Return the number of columns that are used, and of those that miss the inner and the outer border."""
    used = np.unique(columns[columns > 0])
    missed = []
    for label in (2, 1):
        touching = scipy.ndimage.binary_dilation(labels == label, _CUBE)
        missed.append(len(np.setdiff1d(used, columns[touching])))
    return [len(used), *missed]


def bent_round(columns, labels, spacing):
    """Return the number of columns with voxels far from each other through grey matter, but not in a straight line.

    A column on one bank is about as long through grey matter as it is straight. The longest way starts at the voxel
    farthest from an arbitrary one, within the grey matter around the column.
    """
    found = 0
    for number, box in enumerate(scipy.ndimage.find_objects(columns), start=1):
        if box is None:
            continue
        grey = np.argwhere(labels[box] == 3)
        own = columns[box][tuple(grey.T)] == number
        pairs = scipy.spatial.cKDTree(grey).query_pairs(1.8, output_type="ndarray")
        lengths = np.linalg.norm((grey[pairs[:, 0]] - grey[pairs[:, 1]]) * spacing, axis=1)
        graph = scipy.sparse.csr_matrix((lengths, pairs.T), shape=(len(grey), len(grey)))
        own = np.flatnonzero(own)
        start = own[scipy.sparse.csgraph.dijkstra(graph, False, own[0])[own].argmax()]
        ways = scipy.sparse.csgraph.dijkstra(graph, False, start)[own]
        straight = np.linalg.norm((grey[own] - grey[start]) * spacing, axis=1)
        found += bool((ways > 2 * straight + 4 * spacing.max()).any())
    return found


def columns(folder, paths, count):
    """Print whether columns reach both borders, are connected and stay on their bank, beside LN2_COLUMNS."""
    print("rim | columns | miss inner | miss outer | connected | bent around a border | voxels in none")
    for path in paths:
        volume = voxflat.io.read_volume(path)
        volume = voxflat.io.Volume(np.asarray(volume.data).astype(np.int16), volume.affine)
        rim = voxflat.rim(volume)
        spacing = np.linalg.norm(volume.affine[:3, :3], axis=0)
        for name, found in (
            ("voxflat", rim.columns(count).volume.data),
            ("LN2_COLUMNS", laynii_columns(folder, volume, count)[0]),
        ):
            lacking = np.count_nonzero((volume.data == 3) & (found == 0))
            cells = [*reach(found, volume.data), connected(found), bent_round(found, volume.data, spacing), lacking]
            print(" | ".join([f"{path.name}, {name}", *map(str, cells)]), flush=True)


def seconds(command, place):
    """Return the wall and CPU seconds of a command."""
    start, before = time.perf_counter(), os.times()
    subprocess.run(command, cwd=place, check=True, stdout=subprocess.DEVNULL)
    after = os.times()
    used = after.children_user + after.children_system - before.children_user - before.children_system
    return time.perf_counter() - start, used


def times(folder, path):
    """Print the times of both command lines for three alternate pairs, and the medians of their ratios."""
    path = path.resolve()
    ratios = []
    print("voxflat wall, CPU (s) | LN2_LAYERS wall, CPU (s)")
    with tempfile.TemporaryDirectory() as place:
        (Path(place) / path.name).symlink_to(path)
        ours = [
            sys.executable,
            "-m",
            "voxflat.cli",
            "layers",
            path.name,
            "-n",
            "10",
            "-o",
            "layers.nii.gz",
            "--overwrite",
        ]
        theirs = [folder.resolve() / "LN2_LAYERS", "-rim", path.name, "-nr_layers", "10", "-equivol"]
        for _ in range(3):
            pair = np.array([seconds(ours, place), seconds(theirs, place)])
            ratios.append(pair[0] / pair[1])
            print(" | ".join(f"{wall:.1f}, {used:.1f}" for wall, used in pair), flush=True)
    wall, used = np.median(ratios, axis=0)
    print(f"median ratio: wall {wall:.2f}, CPU {used:.2f}")


def main():
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("table", choices=("slabs", "small", "columns", "time"))
    parser.add_argument("rims", type=Path, nargs="*")
    parser.add_argument("--laynii", type=Path, required=True)
    parser.add_argument("--count", type=int, default=1000)
    asked = parser.parse_intermixed_args()
    if asked.table == "slabs":
        slabs(asked.laynii)
    elif asked.table == "small":
        small(asked.laynii)
    elif asked.table == "columns":
        columns(asked.laynii, asked.rims, asked.count)
    else:
        times(asked.laynii, asked.rims[0])


if __name__ == "__main__":
    main()
