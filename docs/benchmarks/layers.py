"""Cortical depth from segmentations, beside LayNii's LN2_LAYERS: analytic shapes, and fsaverage5's ribbon.

    python docs/benchmarks/layers.py --laynii DIR    # where LN2_LAYERS was built; without it, voxflat alone

Prints mean and 95th percentile of the absolute error of depth (equidistant, equivolume) and of the time.
"""

import argparse
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
import pyvista as pv
import scipy.spatial
from nibabel import Nifti1Image, load
from nilearn.datasets import load_fsaverage

import voxflat
from voxflat import _core
from voxflat.maps.depth import LAYERINGS, vertex_areas


def bent_layers(shape, spacing):
    """Return the rim of a bent layer 2.5 mm thick, and its true equivolume and equidistant depth."""
    if shape == "fold":
        x, y, _ = np.meshgrid(
            np.arange(-12, 12, spacing), np.arange(-6, 8, spacing), np.arange(0, 6, spacing), indexing="ij"
        )
        where = np.linspace(-25, 25, 20001)
        rise = np.cos(np.pi * where / 8) * np.pi / 4  # slope of 2 sin(πx/8)
        line = np.stack([where, 2 * np.sin(np.pi * where / 8)], 1)
        flat = np.stack([x[:, :, 0] + 0.03, y[:, :, 0] + 0.01], -1).reshape(-1, 2)
        _, nearest = scipy.spatial.cKDTree(line).query(flat)
        length = np.hypot(1, rise)[nearest]
        normal = np.stack([-rise[nearest], np.ones(len(nearest))], 1) / length[:, None]
        bend = np.pi**2 / 32 * np.sin(np.pi * where[nearest] / 8) / length**3  # the area is 1 + bend s at the height s
        height, bend = (
            np.broadcast_to(values.reshape(x.shape[:2])[:, :, None], x.shape)
            for values in (((flat - line[nearest]) * normal).sum(1), bend)
        )
        volume = (height + bend * height**2 / 2) / (2.5 + bend * 2.5**2 / 2)
    else:
        inner, power = (10.0, 3) if shape == "sphere" else (4.0, 2)
        axis = np.arange(-np.ceil((inner + 4) / spacing), np.ceil((inner + 4) / spacing) + 1) * spacing
        x, y, z = np.meshgrid(axis, axis, axis if power == 3 else np.arange(0, 12, spacing), indexing="ij")
        radius = np.sqrt((x - 0.13) ** 2 + (y - 0.27) ** 2 + (z + 0.31) ** 2 * (power == 3))
        height = radius - inner
        volume = (radius**power - inner**power) / ((inner + 2.5) ** power - inner**power)
    border = 2.5 * spacing
    parts = [
        (height > -border) & (height < 0),
        (height >= 0) & (height <= 2.5),
        (height > 2.5) & (height < 2.5 + border),
    ]
    labels = np.select(parts, [2, 3, 1], 0).astype(np.int16)
    truth = (np.where(labels == 3, depth, np.nan) for depth in (volume, height / 2.5))
    return voxflat.io.Volume(labels, np.diag([spacing, spacing, spacing, 1.0])), *truth


def ribbon(spacing):
    """Return the rim of fsaverage5's left hemisphere, with depths by its surfaces; NaN outside the ribbon."""
    mesh = load_fsaverage("fsaverage5")
    white, pial = (mesh[name].parts["left"] for name in ("white_matter", "pial"))
    faces = white.faces.astype(np.uint32)
    low = pial.coordinates.min(0) - 3 * spacing
    shape = np.ceil((pial.coordinates.max(0) + 3 * spacing - low) / spacing).astype(int)
    affine = np.diag([spacing, spacing, spacing, 1.0])
    affine[:3, 3] = low
    ends = [(surface.coordinates.astype(float) - low) / spacing for surface in (white, pial)]
    numbers = np.arange(len(ends[0]))
    voxels, triangles, weights, depth = _core.ribbon_voxels(*ends, faces, numbers, shape.tolist(), 0.5)
    grid = pv.ImageData(dimensions=shape, spacing=(spacing,) * 3, origin=low)
    closed = pv.PolyData.from_regular_faces(white.coordinates, white.faces)
    # By distance, because VTK's test of enclosed points marks lines of wrong voxels: one in twelve here.
    distance = grid.compute_implicit_distance(closed)["implicit_distance"]
    inside = (distance < 0).reshape(shape, order="F")
    inner, outer = ((weights * vertex_areas(end, faces)[faces[triangles]]).sum(1) for end in ends)
    volume = depth * (inner + depth * (outer - inner) / 2) / (0.5 * (inner + outer))
    labels = np.where(inside, 2, 1).astype(np.int16)
    labels.flat[voxels] = 3
    truth = np.full((2, *shape), np.nan)
    truth[0].flat[voxels], truth[1].flat[voxels] = volume, depth
    return voxflat.io.Volume(labels, affine), *truth


def laynii(folder, rim):
    """Return depths (equidistant, equivolume) by LN2_LAYERS, and the seconds that it took."""
    with tempfile.TemporaryDirectory() as place:
        Nifti1Image(rim.data.astype(np.int16), rim.affine).to_filename(f"{place}/rim.nii.gz")
        start = time.perf_counter()
        command = [Path(folder).resolve() / "LN2_LAYERS", "-rim", "rim.nii.gz", "-nr_layers", "10", "-equivol"]
        subprocess.run(command, cwd=place, check=True, stdout=subprocess.DEVNULL)
        seconds = time.perf_counter() - start
        return *(load(f"{place}/rim_metric_{name}.nii.gz").get_fdata() for name in ("equivol", "equidist")), seconds


def shown(found, truth):
    """Return the mean and the 95th percentile of the absolute error as text."""
    error = np.abs(found - truth)[np.isfinite(truth) & np.isfinite(found)]
    return f"{error.mean():.3f}, {np.quantile(error, 0.95):.3f}"


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--laynii", type=Path)
    asked = parser.parse_args()
    cases = {
        f"{shape}, {h} mm": (bent_layers, shape, h) for shape in ("sphere", "cylinder", "fold") for h in (0.8, 0.5, 0.3)
    }
    cases["fsaverage5, 0.7 mm"] = (ribbon, 0.7)
    print("shape | voxels | equivolume | equidistant | s | LN2_LAYERS equivolume | equidistant | s")
    for name, (make, *how) in cases.items():
        labels, *truth = make(*how)
        start = time.perf_counter()
        rim = voxflat.rim(labels)
        seconds = time.perf_counter() - start
        cells = [shown(rim.depth(layering).data, true) for layering, true in zip(LAYERINGS, truth, strict=True)]
        cells.append(f"{seconds:.1f}")
        if asked.laynii:
            *others, seconds = laynii(asked.laynii, labels)
            cells += [*(shown(other, true) for other, true in zip(others, truth, strict=True)), f"{seconds:.1f}"]
        print(" | ".join([name, str(np.count_nonzero(labels.data == 3)), *cells]), flush=True)


if __name__ == "__main__":
    main()
