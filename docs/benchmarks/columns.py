"""Columns of fsaverage5's ribbon and of a hemisphere at 0.4 mm, beside LayNii's LN2_COLUMNS.

    python docs/benchmarks/columns.py --laynii DIR [--spacing 0.7] [--counts 1000 5000]

Prints the share of columns that are connected, the share that cross a sulcus, the coefficient of variation of their
volumes, and the times. A column crosses a sulcus if two of its voxels touch, although their true places on the
midthickness surface are more than 10 mm apart along the surface.
"""

import argparse
import resource
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
import scipy
from layers import ribbon
from nibabel import Nifti1Image, load
from nilearn.datasets import load_fsaverage

import voxflat
from voxflat import _core

_APART = 10.0  # mm


def places(rim):
    """Return the nearest vertex of each grey voxel on the true midthickness surface, by its column there."""
    mesh = load_fsaverage("fsaverage5")
    white, pial = (mesh[name].parts["left"] for name in ("white_matter", "pial"))
    faces = white.faces.astype(np.uint32)
    ends = [(end.coordinates.astype(float) - rim.affine[:3, 3]) / np.diag(rim.affine)[:3] for end in (white, pial)]
    voxels, triangles, weights, _ = _core.ribbon_voxels(
        *ends, faces, np.arange(len(ends[0])), list(rim.data.shape), 0.5
    )
    middle = (white.coordinates + pial.coordinates) / 2.0
    vertex = np.full(rim.data.shape, -1)
    vertex.flat[voxels] = faces[triangles, weights.argmax(axis=1)]
    return vertex, middle, faces


def crossing(columns, vertex, middle, faces):
    """Return the share of columns with voxels that touch across a sulcus."""
    pairs = []
    for offset in np.argwhere(np.ones((3, 3, 3)))[14:] - 1:
        here = tuple(slice(max(0, -o), n - max(0, o)) for o, n in zip(offset, columns.shape, strict=True))
        there = tuple(slice(max(0, o), n + min(0, o)) for o, n in zip(offset, columns.shape, strict=True))
        same = (columns[here] == columns[there]) & (columns[here] > 0) & (vertex[here] != vertex[there])
        pairs.append(np.stack([vertex[here][same], vertex[there][same], columns[here][same]], axis=1))
    pairs = np.concatenate(pairs)
    pairs = pairs[(pairs[:, :2] >= 0).all(axis=1)]
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    lengths = np.linalg.norm(middle[edges[:, 0]] - middle[edges[:, 1]], axis=1)
    graph = scipy.sparse.csr_matrix((lengths, edges.T), shape=(len(middle), len(middle)))
    starts, numbers = np.unique(pairs[:, 0], return_inverse=True)
    crossed = set()
    for first in range(0, len(starts), 500):
        rows = scipy.sparse.csgraph.dijkstra(graph, False, starts[first : first + 500], limit=_APART)
        here = (numbers >= first) & (numbers < first + 500)
        far = ~np.isfinite(rows[numbers[here] - first, pairs[here, 1]])
        crossed |= set(pairs[here][far, 2].tolist())
    return len(crossed)


def connected(columns):
    """Return the number of columns whose voxels are connected (26 neighbours)."""
    found = 0
    for number, box in enumerate(scipy.ndimage.find_objects(columns), start=1):
        found += box is not None and scipy.ndimage.label(columns[box] == number, np.ones((3, 3, 3)))[1] == 1
    return found


def laynii(folder, rim, count):
    """Return the columns by LN2_COLUMNS, with the seconds of LN2_LAYERS and of LN2_COLUMNS."""
    with tempfile.TemporaryDirectory() as place:
        Nifti1Image(rim.data.astype(np.int16), rim.affine).to_filename(f"{place}/rim.nii.gz")
        seconds = []
        for command in (
            ["LN2_LAYERS", "-rim", "rim.nii.gz", "-nr_layers", "10"],
            ["LN2_COLUMNS", "-rim", "rim.nii.gz", "-midgm", "rim_midGM_equidist.nii.gz", "-nr_columns", str(count)],
        ):
            start = time.perf_counter()
            run = [Path(folder).resolve() / command[0], *command[1:]]
            subprocess.run(run, cwd=place, check=True, stdout=subprocess.DEVNULL)
            seconds.append(time.perf_counter() - start)
        return load(f"{place}/rim_columns{count}.nii.gz").get_fdata().astype(np.int32), *seconds


def line(name, columns, seconds, truth):
    """Print a row of the table."""
    sizes = np.bincount(columns[columns > 0])[1:]
    used = int((sizes > 0).sum())
    sizes = sizes[sizes > 0]
    print(
        f"{name} | {used} | {connected(columns)} | {crossing(columns, *truth)} | {sizes.std() / sizes.mean():.2f} | "
        + " + ".join(f"{second:.1f}" for second in seconds),
        flush=True,
    )


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--laynii", type=Path)
    parser.add_argument("--spacing", type=float, default=0.7)
    parser.add_argument("--counts", type=int, nargs="+", default=[1000, 5000])
    asked = parser.parse_args()
    labels = ribbon(asked.spacing)[0]
    truth = places(labels)
    print(f"{np.count_nonzero(labels.data == 3)} voxels of grey matter, {asked.spacing} mm")
    print("columns | with voxels | connected | across a sulcus | variation of volumes | s for layers + columns")
    for count in asked.counts:
        start = time.perf_counter()
        rim = voxflat.rim(labels)
        between = time.perf_counter()
        columns = rim.columns(count).volume.data
        line(f"voxflat {count}", columns, (between - start, time.perf_counter() - between), truth)
        if asked.laynii:
            columns, *seconds = laynii(asked.laynii, labels, count)
            line(f"LN2_COLUMNS {count}", columns, seconds, truth)
    print(f"largest memory of voxflat: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.1f} GiB")


if __name__ == "__main__":
    main()
