"""Measure the width of smoothing kernels, beside Connectome Workbench (docs/decisions/0053-smoothing.md).

    python docs/benchmarks/smoothing.py SURFACE.surf.gii [--fwhm 6,10] [--vertices 60]

The width of a kernel is 2.355 times the root of half its second moment over exact geodesic distances, which is the
FWHM of a Gaussian in a plane.
"""

import argparse
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import nibabel as nib
import numpy as np

import voxflat

WIDTH = 2 * np.sqrt(2 * np.log(2))


def areas(surface):
    """Return a third of the area of the triangles around each vertex."""
    a, b, c = np.moveaxis(surface.points[surface.faces], 1, 0)
    each = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6
    return np.bincount(surface.faces.ravel(), np.repeat(each, 3), len(surface))


def workbench(path, kernels, fwhm):
    """Smooth by `wb_command -metric-smoothing`, whose default is a geodesic Gaussian."""
    with tempfile.TemporaryDirectory() as folder:
        source, result = (Path(folder) / name for name in ("a.func.gii", "b.func.gii"))
        arrays = [nib.gifti.GiftiDataArray(column.astype(np.float32)) for column in kernels.T]
        nib.save(nib.gifti.GiftiImage(darrays=arrays), source)
        words = ["wb_command", "-metric-smoothing", path, source, str(fwhm), result, "-fwhm"]
        subprocess.run(words, check=True, capture_output=True)
        return np.column_stack([array.data for array in nib.load(result).darrays]).astype(float)


def main():
    """Print a table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("surface")
    parser.add_argument("--pial")
    parser.add_argument("--fwhm", default="4,6,8,12")
    parser.add_argument("--vertices", type=int, default=60)
    asked = parser.parse_args()
    surface = voxflat.surface(asked.surface, pial=asked.pial)
    vertices = np.random.default_rng(0).choice(surface.ids, asked.vertices, replace=False)
    path = Path(tempfile.mkdtemp()) / "lh.surf.gii"
    surface.save(path)
    squares = np.asarray(surface.geodesic(vertices, geodesic="exact").rows, dtype=float) ** 2
    print(f"{len(surface)} vertices, median edge {surface.usual_edge:.2f}")
    impulses = np.zeros((surface.count, len(vertices)))
    impulses[vertices, np.arange(len(vertices))] = 1
    for fwhm in map(float, asked.fwhm.split(",")):
        start = time.process_time()
        found = {"voxflat": surface.smooth_values(impulses, fwhm)}
        took = time.process_time() - start
        if shutil.which("wb_command"):
            found["Workbench"] = workbench(path, impulses, fwhm)
        for name, kernels in found.items():
            weights = areas(surface)[:, None] * kernels[surface.ids]
            widths = WIDTH * np.sqrt((weights * squares.T).sum(axis=0) / weights.sum(axis=0) / 2) / fwhm
            least, median, most = np.percentile(widths, (5, 50, 95))
            kept = (areas(surface) @ kernels[surface.ids]) / areas(surface)[np.searchsorted(surface.ids, vertices)]
            print(f"{fwhm:5.1f} mm {name:10} width/asked {median:.3f} (5 to 95 %: {least:.3f} to {most:.3f})", end=" ")
            print(f"sum kept {np.percentile(kept, (5, 50, 95)).round(3)}")
        print(f"         {took:.2f} CPU s for {asked.vertices} columns")


if __name__ == "__main__":
    main()
