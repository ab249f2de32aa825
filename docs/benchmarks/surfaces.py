"""Say what surfaces of real anatomy are like: manifolds, repair, disks, areal distortion beside Connectome Workbench's.

    make bench-surfaces

Volumes are made from nilearn's data by ``anatomy.py``; nothing is downloaded.
"""

import shutil
import subprocess
import tempfile
import time
from collections import Counter
from pathlib import Path

import anatomy
import numpy as np
from scipy import ndimage
from tables import machine

import voxflat
from voxflat import _core
from voxflat.io.meshes import Mesh, read_mesh, write_mesh
from voxflat.io.overlays import read_overlay

DISKS = 100
RADIUS = 45.0


def main():
    """Measure and print."""
    print(f"{machine()}\n")
    print(f"{'volume':26}{'voxels':>10}{'vertices':>10}{'split':>7}{'handles':>9}{'χ':>5}{'s':>7}")
    for side in anatomy.SIDES:
        mesh = anatomy.fsaverage5(side)
        for spacing in anatomy.SPACINGS:
            labels, affine, _ = anatomy.voxelise(mesh["white"], mesh["faces"], spacing)
            name = f"fsaverage5 {side} {spacing} mm"
            if describe(name, labels, affine):
                repair(labels, affine)
    for side in anatomy.SIDES:
        labels, affine, _ = anatomy.mni152_white_matter(side)
        describe(f"MNI152 {side} 1 mm", labels, affine)
        disks(f"MNI152 {side}, repaired", repair(labels, affine), affine)
    if shutil.which("wb_command"):
        workbench()
    else:
        print("\nwb_command is not installed (Debian: connectome-workbench); its areal distortion is not compared")


def describe(name, labels, affine):
    """Print what a label volume's surface is like, and return its number of handles."""
    start = time.perf_counter()
    surface = voxflat.surface(labels, affine=affine, repair="none")
    seconds = time.perf_counter() - start
    topology = surface.core.topology()
    voxels = np.unique(surface.ids, axis=0)
    inside = labels != 0
    open_side = inside & ~ndimage.binary_erosion(inside)
    assert not topology["loops"], "closed"
    assert (voxels == np.argwhere(open_side)).all(), "every surface voxel is a vertex, and every vertex a surface voxel"
    print(
        f"{name:26}{labels.sum():>10}{len(surface):>10}{surface.metadata['split_vertices']:>7}"
        f"{topology['handles']:>9}{topology['euler']:>5}{seconds:>7.2f}"
    )
    return topology["handles"]


def repair(labels, affine):
    """Print what repair changes, and return the repaired labels."""
    start = time.perf_counter()
    mask, _ = _core.repair(labels.astype(bool), [1.0, 1.0, 1.0])
    seconds = time.perf_counter() - start
    changed = int((mask != labels.astype(bool)).sum())
    print(f"  repaired: {changed} voxels changed ({100 * changed / labels.sum():.3f} %) in {seconds:.2f} s")
    describe("  repaired", mask.astype(np.uint8), affine)
    return mask.astype(np.uint8)


def disks(name, labels, affine):
    """Print how many geodesic disks are disks, and why the others are refused."""
    surface = voxflat.surface(labels, affine=affine)
    seeds = np.random.default_rng(0).choice(len(surface), DISKS, replace=False)
    reasons = Counter()
    filled = []
    for seed in seeds.tolist():
        try:
            disk, taken_in = surface.core.disk(seed, RADIUS)
        except voxflat.InputError as error:
            reasons[" ".join(str(error).split()[5:8])] += 1
            continue
        topology = disk.topology()
        reasons[f"χ = {topology['euler']}"] += 1
        filled.append(taken_in / len(disk.faces))
    shown = ", ".join(f"{count} x {reason}" for reason, count in reasons.most_common())
    print(f"\n{name}: {DISKS} disks of {RADIUS:g} mm: {shown}; taken in: {100 * max(filled):.1f} % at most")


def workbench():
    """Print how our areal distortion differs from that of wb_command -surface-distortion, from the same files."""
    print("\nareal distortion, log2: voxflat beside wb_command -surface-distortion")
    for side in anatomy.SIDES:
        mesh = anatomy.fsaverage5(side)
        places, faces = np.nan_to_num(mesh["flat"][0]), mesh["flat"][1]
        with tempfile.TemporaryDirectory() as folder:
            ours = Path(folder) / "voxflat.surf.gii"
            voxflat.surface((mesh["white"], mesh["faces"])).keep((places, faces)).flatten().save(ours)
            subprocess.run(["wb_command", "-file-information", ours], check=True, capture_output=True)
            for name, flat in (("voxflat", read_mesh(ours)), ("shipped", Mesh(places * [1, 1, 0], faces))):
                paths = [Path(folder) / name for name in ("white.surf.gii", "flat.surf.gii", "out.func.gii")]
                # Workbench wants the same triangles in both
                write_mesh(paths[0], Mesh(mesh["white"], flat.faces))
                write_mesh(paths[1], flat)
                subprocess.run(["wb_command", "-surface-distortion", *paths], check=True, capture_output=True)
                used = np.unique(flat.faces)
                theirs = read_overlay(paths[2], len(mesh["white"]))[used]
                apart = np.abs(voxflat.measure(paths[0], paths[1], sources=1).triangles.areal - theirs)
                within = 100 * np.mean(apart < 1e-4)
                told = f"{within:.2f} % of {len(used)} within 1e-4, greatest {apart.max():.0e}"
                print(f"  fsaverage5 {side}, {name}: {told}")


if __name__ == "__main__":
    main()
