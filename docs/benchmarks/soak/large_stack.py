"""Project a stack of 20 GB, whose file is sparse, within 4 GiB of memory, and compare it with its known values.

    python docs/benchmarks/soak/large_stack.py DIR [--size 2160] [--pixel-size 1]

DIR needs a file system with sparse files. The intensities of a shell around a sphere are written; everything else is
empty. The memory is the peak of the process that projects, and of its children, as the system counts it.
"""

import argparse
import os
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import tifffile
import zarr

import voxflat

_SHELL = 16  # voxels on both sides of the sphere that are written
_OFFSETS = "-10:10:1"
_CLI = [sys.executable, "-m", "voxflat.cli"]


def shell(size: int, z: int) -> tuple[slice, np.ndarray]:
    """Return the rows and the values of a slice near the sphere."""
    radius = 0.42 * size
    half = int(np.sqrt(max(0.0, (radius + _SHELL) ** 2 - (z - size / 2) ** 2)))
    rows = slice(max(0, int(size / 2) - half), min(size, int(size / 2) + half + 1))
    y, x = np.mgrid[rows, :size]
    away = np.sqrt((x - size / 2.0) ** 2 + (y - size / 2.0) ** 2 + (z - size / 2.0) ** 2) - radius
    return rows, np.where(np.abs(away) < _SHELL, np.round(10000 + 100 * away), 0).astype(np.uint16)


def write(folder: Path, size: int, slices: range) -> None:
    """Write some slices of a stack as OME-TIFF and OME-Zarr, both sparse, and the map of the sphere."""
    shape, told = (size, size, size), {"axes": "ZYX"}
    told |= {f"PhysicalSize{axis}": 1.0 for axis in "XYZ"} | {f"PhysicalSize{axis}Unit": "µm" for axis in "XYZ"}
    tifffile.imwrite(folder / "stack.ome.tif", shape=shape, dtype=np.uint16, metadata=told, bigtiff=True)
    pages = tifffile.memmap(folder / "stack.ome.tif", mode="r+")
    group = zarr.open_group(folder / "stack.zarr", mode="w", zarr_format=2)
    array = group.create_array("0", shape=shape, dtype=np.uint16, chunks=(64, 128, 128), fill_value=0)
    axes = [{"name": axis, "type": "space", "unit": "micrometer"} for axis in "zyx"]
    datasets = [{"path": "0", "coordinateTransformations": [{"type": "scale", "scale": [1.0] * 3}]}]
    group.attrs["multiscales"] = [{"version": "0.4", "axes": axes, "datasets": datasets}]
    for first in range(slices.start, slices.stop, 64):
        block = np.zeros((min(64, slices.stop - first), size, size), np.uint16)
        for z in range(first, first + len(block)):
            rows, values = shell(size, z)
            block[z - first, rows] = pages[z, rows] = values
        array[first : first + len(block)] = block
    pages.flush()
    voxflat.surface(ball(size), unit="µm").flatten().save(folder / "map.npz")


def main() -> None:
    """Write the stack and a map, project the stack, and print time, memory and errors."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("folder", type=Path)
    arguments.add_argument("--size", type=int, default=2160)
    arguments.add_argument("--pixel-size", type=float, default=1.0)
    given = arguments.parse_args()
    folder, size = given.folder, given.size
    folder.mkdir(parents=True, exist_ok=True)
    first = size // 2 // 64 * 64
    slices = range(first, min(size, first + 320))
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:  # its memory would count as that of commands
        pool.submit(write, folder, size, slices).result()
    heights = voxflat.load(folder / "map.npz").locate(given.pixel_size)[1][..., 2]
    files = [folder / "stack.ome.tif", folder / "stack.zarr"]
    for path in files:
        apparent = 2 * size**3 if path.is_dir() else path.stat().st_size
        for name, more in (("max", ["--projection", "max"]), ("layers", [])):
            output = folder / f"{path.name.split('.')[1]}_{name}.zarr"
            command = [*_CLI, "image", folder / "map.npz", "--volume", path, f"--depth={_OFFSETS}", *more]
            output = output if name == "layers" else output.with_suffix(".tif")
            command += ["--pixel-size", given.pixel_size, "-o", output, "--quiet"]
            start = time.perf_counter()
            peak = measured([str(word) for word in command])
            took = time.perf_counter() - start
            told = f"{path.name} {apparent / 1e9:.1f} GB, {name}: {took:.0f} s, {peak / 2**30:.2f} GiB"
            print(f"{told}, {error(output, heights, slices)}", flush=True)


def ball(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the points, in µm, and the triangles of a sphere."""
    import pyvista

    mesh = pyvista.Icosphere(radius=0.42 * size, center=(size / 2,) * 3, nsub=6)
    return np.asarray(mesh.points, np.float64), mesh.regular_faces


def measured(command: list[str]) -> int:
    """Run a command and return the peak of the memory, in bytes, of it or its largest child."""
    process = subprocess.Popen(command)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(process.returncode)
    return usage.ru_maxrss * 1024


def error(output: Path, heights: np.ndarray, slices: range) -> str:
    """Return the errors of the pixels that lie in the written slices; `heights` are the slices of the pixels."""
    if output.suffix == ".zarr":
        found, expected = np.asarray(zarr.open_array(output / "0", mode="r")[0, 15]), 10500.0  # of the offset 5
    else:
        found, expected = tifffile.imread(output), 11000.0
    away = np.abs(found[(heights > slices.start + 12) & (heights < slices.stop - 12)] - expected) / 100
    least, most = f"{np.percentile(away, 95):.2f}", f"{away.max():.2f}"
    return f"{found.size / 1e6:.1f} million pixels, error of {away.size} checked: 95 % {least} µm, largest {most} µm"


if __name__ == "__main__":
    main()
