"""Measure distance matrices, beside Workbench, and a null model (docs/decisions/0057-distance-matrices.md).

    python docs/benchmarks/distance_matrix.py L.midthickness.surf.gii R.midthickness.surf.gii PARCELS.dlabel.nii
        [--roi L.atlasroi.shape.gii] [--only dense,parcels,accuracy,workbench,null]

`accuracy` needs pygeodesic, `null` needs brainsmash, and `workbench` needs wb_command.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import nibabel as nib
import numpy as np

import voxflat

VOXFLAT = [sys.executable, "-m", "voxflat.cli"]


def measured(words):
    """Run a program; return its wall time, its CPU time (both in s) and its peak memory (in GiB)."""
    start = time.monotonic()
    process = subprocess.Popen([str(word) for word in words], stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"{words} failed")
    return time.monotonic() - start, used.ru_utime + used.ru_stime, used.ru_maxrss / 2**20


def dense(asked, folder):
    """Compute all distances of one hemisphere, with and without the medial wall."""
    runs = {"all vertices, float32": [], "all vertices, uint8": ["--dtype", "uint8"]}
    if asked.roi:
        runs["without the medial wall, float32"] = ["--keep", asked.roi]
    for name, more in runs.items():
        wall, cpu, memory = measured(
            [*VOXFLAT, "distance-matrix", asked.left, *more, "-o", folder / "dense.npy", "--overwrite", "--quiet"]
        )
        size = np.load(folder / "dense.npy", mmap_mode="r").shape
        print(f"dense, {name}, {size[0]} x {size[1]}: {cpu:.1f} CPU s, {wall:.1f} s, {memory:.2f} GiB", flush=True)


def parcels(asked, folder):
    """Compute the distances between the parcels of both sides, by each method."""
    for method in ("mean", "min", "centroid"):
        words = [*VOXFLAT, "distance-matrix", asked.left, asked.right, "--parcels", asked.parcels]
        words += ["--method", method, "-o", folder / "parcels.csv", "--overwrite", "--quiet"]
        wall, cpu, memory = measured(words)
        size = np.loadtxt(folder / "parcels.csv", delimiter=",").shape
        print(f"parcels, {method}, {size[0]} x {size[1]}: {cpu:.1f} CPU s, {wall:.1f} s, {memory:.2f} GiB", flush=True)


def sources_of(surface, count):
    """Return the sources whose rows are compared."""
    return np.sort(np.random.default_rng(0).choice(len(surface), count, replace=False))


def accuracy(asked, folder):
    """Compare rows with exact distances by pygeodesic and, if there is wb_command, with those of Workbench."""
    import pygeodesic.geodesic as pg

    surface = voxflat.surface(asked.left)
    sources = sources_of(surface, asked.rows)
    start = time.process_time()
    solver = pg.PyGeodesicAlgorithmExact(surface.points.astype(np.float64), surface.faces.astype(np.int32))
    exact = np.array([solver.geodesicDistances(np.array([source]), None)[0] for source in sources])
    print(f"accuracy: pygeodesic took {time.process_time() - start:.0f} CPU s for {len(sources)} rows", flush=True)
    np.save(folder / "exact.npy", exact)
    report("voxflat", surface.geodesic(surface.ids[sources]).rows, exact, sources)
    report("voxflat, exact", surface.geodesic(surface.ids[sources], geodesic="exact").rows, exact, sources)
    others = workbench_rows(asked.left, sources, len(surface), folder)
    for name, found in others.items():
        report(name, found, exact[:, sources], sources, among=True)


def report(name, rows, exact, sources, *, among=False):
    """Print the relative errors of rows."""
    rows = np.asarray(rows, dtype=np.float64)
    is_self = np.zeros(exact.shape, dtype=bool)
    is_self[np.arange(len(sources)), np.arange(len(sources)) if among else sources] = True
    errors = np.abs(rows[~is_self] / exact[~is_self] - 1)
    text = f"mean error {errors.mean():.4%}, median {np.median(errors):.4%}, 99 % below {np.quantile(errors, 0.99):.3%}"
    print(f"accuracy, {name}: {text}, longest {errors.max():.2%}", flush=True)


def workbench_rows(path, sources, count, folder):
    """Return the distances among the sources that Workbench finds by both of its rules."""
    found = {}
    for name, more in {"Workbench": [], "Workbench -naive": ["-naive"]}.items():
        write_roi(path, sources, count, folder / "roi.shape.gii")
        words = ["wb_command", "-surface-geodesic-distance-all-to-all", path, folder / "wb.dconn.nii"]
        measured([*words, "-roi", folder / "roi.shape.gii", *more])
        found[name] = nib.load(folder / "wb.dconn.nii").get_fdata()
    return found


def write_roi(path, chosen, count, file):
    """Write a mask of vertices for Workbench."""
    values = np.zeros(count, dtype=np.float32)
    values[chosen] = 1
    image = nib.load(path)
    meta = nib.gifti.GiftiMetaData({**image.darrays[0].meta, **image.meta})
    nib.save(nib.gifti.GiftiImage(meta=meta, darrays=[nib.gifti.GiftiDataArray(values, "NIFTI_INTENT_SHAPE")]), file)


def workbench(asked, folder):
    """Time Workbench on two numbers of rows and extrapolate to all of them."""
    surface = voxflat.surface(asked.left)
    count, took = len(surface), {}
    for rows in asked.shares:
        write_roi(asked.left, sources_of(surface, rows), count, folder / "roi.shape.gii")
        words = ["wb_command", "-surface-geodesic-distance-all-to-all", asked.left, folder / "wb.dconn.nii"]
        wall, cpu, memory = measured([*words, "-roi", folder / "roi.shape.gii"])
        took[rows] = wall, cpu
        print(f"workbench, {rows} of {count} rows: {cpu:.1f} CPU s, {wall:.1f} s, {memory:.2f} GiB", flush=True)
    (few, first), (many, last) = took.items()
    wall, cpu = ((last[n] - first[n]) / (many - few) * (count - few) + first[n] for n in (0, 1))
    print(f"workbench, all {count} rows, extrapolated: {cpu / 60:.0f} CPU minutes, {wall / 60:.0f} minutes", flush=True)


def null(asked, folder):
    """Make surrogates of a map of parcels with brainsmash, and compare their variograms with that of the map."""
    from brainsmash.mapgen.base import Base

    surface = voxflat.surface(asked.left)
    matrix = surface.geodesic_matrix(asked.parcels)
    noise = np.random.default_rng(1).normal(size=surface.count)
    smooth = surface.smooth_values(noise, asked.fwhm)
    labels = voxflat.io.read_overlay(asked.parcels, surface.count, structure="CortexLeft")
    brain_map = np.array([smooth[labels == label].mean() for label in matrix.ids])
    brain_map = (brain_map - brain_map.mean()) / brain_map.std()
    base = Base(brain_map, matrix.values, seed=0)
    surrogates = base(n=asked.surrogates)
    shuffled = [np.random.default_rng(n).permutation(brain_map) for n in range(asked.surrogates)]
    own = base.compute_smooth_variogram(brain_map)
    for name, maps in {"surrogates": surrogates, "shuffled maps": shuffled}.items():
        found = np.array([base.compute_smooth_variogram(values) for values in maps])
        off = np.abs(found.mean(axis=0) / own - 1)
        alike = np.abs([np.corrcoef(values, brain_map)[0, 1] for values in maps]).mean()
        text = f"mean {off.mean():.1%}, largest {off.max():.1%}; mean |r| with the map {alike:.2f}"
        print(f"null, {len(maps)} {name} of {len(brain_map)} parcels: variogram off by {text}", flush=True)


def main():
    """Run the parts."""
    parts = {"dense": dense, "parcels": parcels, "accuracy": accuracy, "workbench": workbench, "null": null}
    parser = argparse.ArgumentParser()
    for name in ("left", "right", "parcels"):
        parser.add_argument(name)
    parser.add_argument("--roi", help="mask of the cortex without the medial wall")
    parser.add_argument("--rows", type=int, default=200)
    parser.add_argument("--shares", type=int, nargs=2, default=[100, 300], help="numbers of rows for Workbench")
    parser.add_argument("--fwhm", type=float, default=30, help="of the brain map, in mm")
    parser.add_argument("--surrogates", type=int, default=1000)
    parser.add_argument("--only", default=",".join(parts))
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for name in asked.only.split(","):
            parts[name](asked, Path(folder))


if __name__ == "__main__":
    main()
