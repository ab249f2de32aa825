"""Flat volumes of rims, beside LayNii's LN2_MULTILATERATE and LN2_PATCH_FLATTEN on the same disk.

    python docs/benchmarks/flat_volumes.py --laynii DIR    # where LayNii was built, with its test_data

Prints, for each rim: the share of bins, one voxel wide, that are empty inside the patch; the mean relative error of
distances between voxels (of pairs more than 3 voxels apart), against closed forms or exact geodesics on the middle
surface; the area error (median and 95th percentile of the absolute log2); and CPU seconds and memory of all commands
from the rim to the flat volume.
`--picture FILE` draws both flat volumes of a pattern of cubes.
"""

import argparse
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import nibabel as nib
import numpy as np
import scipy
from layers import bent_layers

import voxflat
from voxflat import _core

SOURCES = 20
CASES = (  # rim, radius of the disk in mm; sc_rim is a slab of 4.8 mm, and the last two are single slices
    *(("half sphere", 8.0), ("fold", 6.0), ("sc_rim", 1.5), ("sc_rim", 10.0)),
    *(("lo_rim_LL", 8.0), ("rim_M", 2.0)),
)


def sphere_distances(points, sources):
    """Return great-circle distances on the middle of the sphere of `bent_layers`."""
    radial = points - (14.0 + np.array([0.13, 0.27, -0.31]))
    radial /= np.linalg.norm(radial, axis=1)[:, None]
    return 11.25 * np.arccos((radial[sources] @ radial.T).clip(-1, 1))


def fold_distances(points, sources):
    """Return distances on the middle of the fold of `bent_layers`, which unrolls into a plane."""
    x = np.linspace(-25, 25, 20001)
    rise = np.cos(np.pi * x / 8) * np.pi / 4
    normal = np.stack([-rise, np.ones(len(x))], axis=1) / np.hypot(1, rise)[:, None]
    middle = np.stack([x, 2 * np.sin(np.pi * x / 8)], axis=1) + 1.25 * normal
    along = np.append(0, np.linalg.norm(np.diff(middle, axis=0), axis=1).cumsum())
    nearest = scipy.spatial.cKDTree(middle).query(points[:, :2] - [12 - 0.03, 6 - 0.01])[1]
    unrolled = np.stack([along[nearest], points[:, 2]], axis=1)
    return np.linalg.norm(unrolled[sources][:, None] - unrolled, axis=2)


def exact_distances(surface, points, sources):
    """Return exact geodesic distances between points of a surface, interpolated between vertices."""
    links = (np.ones(surface.faces.size), (surface.faces.ravel(), np.roll(surface.faces, 1, axis=1).ravel()))
    component = scipy.sparse.csgraph.connected_components(scipy.sparse.coo_array(links, shape=[len(surface)] * 2))[1]
    (triangle, *_), _, _ = _core.NearestFinder(surface.points, surface.faces).find(points[:1], 1e6)
    faces = surface.faces[(component == component[surface.faces[triangle, 0]])[surface.faces[:, 0]]]
    kept, faces = np.unique(faces, return_inverse=True)
    mesh = voxflat.surface((surface.points[kept], faces.reshape(-1, 3)), repair="none")
    triangles, weights, _ = _core.NearestFinder(mesh.points, mesh.faces).find(points, 1e6)
    corners = mesh.faces[triangles].astype(np.int64)
    wanted, which = np.unique(corners[sources], return_inverse=True)
    rows = np.asarray(mesh.geodesic(wanted, geodesic="exact"))
    to_points = np.einsum("snk,nk->sn", rows[:, corners], weights)
    return np.einsum("sk,skn->sn", weights[sources], to_points[which.reshape(-1, 3)])


def run(place, *words):
    """Run a command with GNU time, and return its CPU seconds and its peak memory in MiB."""
    timed = ["/usr/bin/time", "-o", "cost.txt", "-f", "%U %S %M", *map(str, words)]
    subprocess.run(timed, cwd=place, check=True, stdout=subprocess.DEVNULL)
    user, system, memory = map(float, (place / "cost.txt").read_text().split())
    return user + system, memory / 1024


def spent(*parts):
    """Return the seconds and the memory of several commands as text."""
    return f"{sum(one[0] for one in parts):.1f} | {max(one[1] for one in parts):.0f}"


def errors(uv, points, truth, sources, spacing, is_slice):
    """Return the mean error of distances in percent, and median and 95th percentile of the area error."""
    flat = np.linalg.norm(uv[sources][:, None] - uv, axis=2)
    is_far = truth > 3 * spacing
    error = 100 * (np.abs(flat - truth)[is_far] / truth[is_far]).mean()
    if is_slice:
        return f"{error:.1f} | –"
    changes = []
    for near in truth < 3 * spacing:
        apart = points[near] - points[near].mean(axis=0)
        tangent = np.linalg.svd(apart, full_matrices=False)[2][:2]
        system = np.column_stack([apart @ tangent.T, np.ones(near.sum())])
        jacobian = np.linalg.lstsq(system, uv[near], rcond=None)[0][:2]
        changes.append(abs(np.log2(max(abs(np.linalg.det(jacobian)), 1e-6))))
    return f"{error:.1f} | {np.median(changes):.2f}, {np.quantile(changes, 0.95):.2f}"


def empty(has_value):
    """Return the share of bins (depth, row, column) without a value inside the outline of the patch, in percent."""
    covered = np.pad(has_value.any(axis=0), 3)
    patch = scipy.ndimage.binary_fill_holes(scipy.ndimage.binary_closing(covered, iterations=2))[3:-3, 3:-3]
    return 100 * (1 - has_value[:, patch].mean())


def laynii(folder, place, radius, depths):
    """Run LayNii; return the control point, (u, v) of the voxels, the flat volume, its density, and the costs."""
    costs = [run(place, folder / "LN2_LAYERS", "-rim", "rim.nii.gz", "-nr_layers", depths)]
    image = nib.load(place / "rim_midGM_equidist.nii.gz")
    points = np.asarray(image.dataobj).copy()
    voxels = np.argwhere(points > 0)
    centre = voxels[((voxels - voxels.mean(axis=0)) ** 2).sum(axis=1).argmin()]
    points[tuple(centre)] = 2
    nib.Nifti1Image(points, image.affine, image.header).to_filename(place / "points.nii.gz")
    given = ("-rim", "rim.nii.gz", "-control_points", "points.nii.gz", "-radius", radius)
    costs.append(run(place, folder / "LN2_MULTILATERATE", *given))
    uv = nib.load(place / "rim_UV_coordinates.nii.gz").get_fdata()
    domain = np.asarray(nib.load(place / "rim_perimeter_chunk.nii.gz").dataobj) > 0
    uv = uv.reshape(*domain.shape, -1)
    uv[~domain] = np.nan
    if not domain.any():
        return centre, uv, None, None, spent(*costs)
    spacing = np.prod(image.header.get_zooms()[:3]) ** (1 / 3)
    bins = np.maximum(1, np.ceil(np.ptp(uv[domain], axis=0) / spacing)).astype(int)
    given = ("-values", "values.nii.gz", "-coord_uv", "rim_UV_coordinates.nii.gz", "-domain")
    given += (
        "rim_perimeter_chunk.nii.gz",
        "-coord_d",
        "rim_metric_equidist.nii.gz",
        "-bins_u",
        bins[0],
        "-bins_v",
        bins[1],
        "-bins_d",
        depths,
    )
    costs.append(run(place, folder / "LN2_PATCH_FLATTEN", *given, "-density", "-output", "flat.nii.gz"))
    made = "flat_flat_" + "x".join(map(str, (*bins, depths)))
    flat, density = (nib.load(place / f"{made}{end}.nii.gz").get_fdata() for end in ("", "_density"))
    return centre, uv, flat.reshape(*bins, depths), density.reshape(*bins, depths), spent(*costs)


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--laynii", type=Path, required=True)
    parser.add_argument("--only", help="names of rims, separated by commas")
    parser.add_argument("--picture", type=Path)
    asked = parser.parse_args()
    folder = asked.laynii.resolve()
    print("rim | radius (mm) | tool | empty bins (%) | distance error (%) | area error | CPU s | MiB")
    drawn = {}
    for name, radius in CASES:
        if asked.only is None or name in asked.only.split(","):
            with tempfile.TemporaryDirectory() as made:
                layers = compare(name, radius, folder, Path(made))
            if layers is not None:
                drawn[f"{name}, {radius:g} mm"] = layers
    if asked.picture:
        draw(drawn, asked.picture)


def compare(name, radius, folder, place):
    """Print the rows of a rim, and return a layer of both flat volumes, or None if LayNii has none."""
    if name == "half sphere":
        volume = bent_layers("sphere", 0.5)[0]
        volume = replace(volume, data=volume.data[: len(volume.data) // 2])
    elif name == "fold":
        volume = bent_layers(name, 0.5)[0]
        volume = replace(volume, data=np.tile(volume.data, (1, 1, 3)))  # 18 mm wide
    else:
        volume = voxflat.io.read_volume(folder / f"test_data/{name}.nii.gz")
    labels, affine = np.asarray(volume.data, dtype=np.int16), volume.affine
    nib.Nifti1Image(labels, affine).to_filename(place / "rim.nii.gz")
    rim = voxflat.rim(volume)
    spacing = np.prod(volume.spacing) ** (1 / 3)
    depths = round(float(np.median(rim.values.thickness)) / spacing)  # bins are one voxel wide in all directions
    size = radius / 4
    where = np.moveaxis(np.indices(labels.shape), 0, -1) @ affine[:3, :3].T
    checks = (np.floor(where / size).sum(axis=-1) % 2 + 1).astype(np.int16)
    nib.Nifti1Image(checks, affine).to_filename(place / "values.nii.gz")
    centre, theirs, their_flat, density, their_cost = laynii(folder, place, radius, depths)
    program = (sys.executable, "-m", "voxflat.cli")
    region = ("--seed-point", ",".join(map(str, centre)), "--radius", radius)
    cost = run(place, *program, "flatten", "rim.nii.gz", "--rim", *region, "-o", "map.npz", "--quiet")
    given = ("map.npz", "--volume", "values.nii.gz", "--depths", depths, "--pixel-size", spacing, "--layering")
    cost = spent(cost, run(place, *program, "image", *given, "equidistant", "-o", "flat.npy", "--quiet"))
    flat_map, flat = voxflat.load(place / "map.npz"), np.load(place / "flat.npy")

    points, grey = rim.values.halfway, rim.labels.grey + rim.labels.first
    ours = flat_map.points_to_map(points, 1e-6)[0]
    theirs = theirs[tuple(grey.T)][:, :2]
    both = np.isfinite(ours).all(axis=1) & (np.isfinite(theirs).all(axis=1) | (density is None))
    points, ours, theirs = points[both], ours[both], theirs[both]
    sources = np.random.default_rng(0).choice(len(points), min(SOURCES, len(points)), replace=False)
    if name == "half sphere":
        truth = sphere_distances(points, sources)
    elif name == "fold":
        truth = fold_distances(points, sources)
    else:
        truth = exact_distances(rim.surface, points, sources)
    is_slice = min(np.ptp(grey, axis=0)) == 0
    common = (points, truth, sources, spacing, is_slice)
    cells = "empty patch | – | –"
    if density is not None:
        cells = f"{empty(density.transpose(2, 0, 1) > 0):.0f} | {errors(theirs, *common)}"
    print(f"{name} | {radius:g} | LayNii | {cells} | {their_cost}", flush=True)
    print(
        f"{name} | {radius:g} | voxflat | {empty(np.isfinite(flat)):.0f} | {errors(ours, *common)} | {cost}", flush=True
    )
    print(f"  {both.sum()} voxels of {spacing:.2f} mm", file=sys.stderr)
    if density is None:
        return None
    theirs = np.where(density > 0, their_flat, np.nan)[:, ::-1].transpose(2, 1, 0)
    return theirs[depths // 2], flat[depths // 2]


def draw(drawn, path):
    """Draw the middle layer of the flat volumes side by side."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(len(drawn), 2, figsize=(7, 2.6 * len(drawn)), squeeze=False, layout="constrained")
    for row, (name, pair) in zip(axes, drawn.items(), strict=True):
        for ax, image, tool in zip(row, pair, ("LN2_PATCH_FLATTEN", "voxflat"), strict=True):
            ax.imshow(image, cmap="gray", vmin=0.7, vmax=2.3, interpolation="nearest")
            ax.set_facecolor("#d8c8b0")
            ax.set(title=f"{name}, {tool}", xticks=[], yticks=[])
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    main()
