"""Repair white matter of real anatomy, and compare areal distortion with that of Connectome Workbench.

    make bench-surfaces

The volumes and surfaces come with nilearn; nothing is downloaded.
"""

import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import anatomy
import numpy as np
from scipy import ndimage
from tables import machine

import voxflat
from voxflat import _core
from voxflat.io.meshes import Mesh, read_mesh, write_mesh
from voxflat.io.overlays import read_overlay


def main():
    """Measure and print."""
    print(f"{machine()}\n")
    print(f"{'volume':26}{'voxels':>10}{'vertices':>10}{'split':>7}{'handles':>9}{'χ':>5}{'s':>7}")
    for side in anatomy.SIDES:
        labels, affine, _ = anatomy.mni152_white_matter(side)
        describe(f"MNI152 {side} 1 mm", labels, affine)
        start = time.perf_counter()
        mask, _ = _core.repair(labels.astype(bool), [1.0, 1.0, 1.0])
        seconds = time.perf_counter() - start
        changed = int((mask != labels.astype(bool)).sum())
        print(f"  repaired: {changed} voxels changed ({100 * changed / labels.sum():.3f} %) in {seconds:.2f} s")
        describe("  repaired", mask.astype(np.uint8), affine)
    if shutil.which("wb_command"):
        workbench()
    else:
        print("\nwb_command is not installed (Debian: connectome-workbench), so areal distortion is not compared")


def describe(name, labels, affine):
    """Check and print the topology of the surface of a label volume."""
    start = time.perf_counter()
    surface = voxflat.surface(labels, affine=affine, repair="none")
    seconds = time.perf_counter() - start
    topology = surface.core.topology()
    inside = labels != 0
    open_side = inside & ~ndimage.binary_erosion(inside)
    assert not topology["loops"], "closed"
    assert (np.unique(surface.ids, axis=0) == np.argwhere(open_side)).all(), "the vertices are the surface voxels"
    print(
        f"{name:26}{labels.sum():>10}{len(surface):>10}{surface.metadata['split_vertices']:>7}"
        f"{topology['handles']:>9}{topology['euler']:>5}{seconds:>7.2f}"
    )


def workbench():
    """Print how the areal distortion differs from that of wb_command -surface-distortion on the same files."""
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
                # Workbench requires the same triangles in both
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
