"""Measure the time and the peak memory of writing a long series on a flat map, for 100 and 1,000 frames.

    make bench-series

The map is the left hemisphere of fsaverage5 (nilearn) without its medial wall, at 0.5 mm per pixel. The volumes have
voxels of 2 mm (int16, scaled). Each run is a separate process. The table lists the peak of the resident set, and the
part of it that the frames added.
"""

import argparse
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import nibabel as nib
import numpy as np
import psutil
from anatomy import fsaverage5_file

import voxflat

SHAPE, STEP = (60, 98, 83), 2.0
AFFINE = np.array([[2.0, 0, 0, -76], [0, 2, 0, -112], [0, 0, 2, -62], [0, 0, 0, 1]])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, nargs="+", default=[100, 1000])
    parser.add_argument("--pixel-size", type=float, default=0.5)
    parser.add_argument("--directory", type=Path, help="directory of the files, about 6 GB")
    parser.add_argument("--case", nargs=3, help="run one case in this process: map, series, output")
    options = parser.parse_args()
    if options.case:
        return measure(*map(Path, options.case), options.pixel_size)
    with tempfile.TemporaryDirectory(dir=options.directory) as directory:
        folder = Path(directory)
        hemisphere().save(folder / "map.npz")
        print(f"{'':23}{'wall s':>8}{'CPU s':>8}{'peak MiB':>10}{'for frames':>12}{'MB written':>12}", flush=True)
        for count in options.frames:
            path = volumes(folder, count)
            for ending in (".nii", ".nii.gz", ".zarr", ".tif"):
                output = folder / f"flat{ending}"
                print(f"{count:6} frames, {ending:8}", end="", flush=True)
                case = ["--case", folder / "map.npz", path, output]
                size = ["--pixel-size", str(options.pixel_size)]
                subprocess.run([sys.executable, __file__, *size, *case], check=True)
                subprocess.run(["rm", "-r", output], check=True)
            path.unlink()
    return None


def hemisphere():
    white, pial, sphere = (fsaverage5_file(name, "left") for name in ("white", "pial", "sphere"))
    return voxflat.surface(white, pial=pial).drop("medial wall").flatten(cuts="standard", sphere=sphere)


def volumes(folder, count):
    """Write a series of noisy volumes, frame by frame."""
    header = nib.Nifti1Header()
    header.set_data_dtype(np.int16)
    header.set_data_shape((*SHAPE, count))
    header.set_zooms((2.0, 2.0, 2.0, STEP))
    header.set_sform(AFFINE, "scanner")
    header.set_xyzt_units("mm", "sec")
    header["scl_slope"], header["scl_inter"] = 0.1, 0
    rng = np.random.default_rng(0)
    noise = rng.normal(8000, 400, SHAPE).astype(np.int16)
    with (folder / "bold.nii").open("wb") as file:
        header.write_to(file)
        file.write(bytes(int(header["vox_offset"]) - file.tell()))
        for _ in range(count):
            file.write(np.roll(noise, rng.integers(noise.size)).tobytes(order="F"))
    return folder / "bold.nii"


def measure(flat, series, output, pixel_size):
    flat_map = voxflat.load(flat)
    flat_map.raster(pixel_size)
    before = peak = psutil.Process().memory_info().rss
    done = threading.Event()

    def watch():
        nonlocal peak
        while not done.wait(0.005):
            peak = max(peak, psutil.Process().memory_info().rss)

    threading.Thread(target=watch, daemon=True).start()
    start = time.perf_counter(), time.process_time()
    flat_map.images(series, pixel_size, interpolation="linear", fraction=0.5).save(output)
    wall, cpu = time.perf_counter() - start[0], time.process_time() - start[1]
    done.set()
    files = [path for path in output.rglob("*") if path.is_file()] if output.is_dir() else [output]
    written = sum(path.stat().st_size for path in files) / 1e6
    print(f"{wall:8.1f}{cpu:8.1f}{peak / 2**20:10.0f}{(peak - before) / 2**20:12.0f}{written:12.0f}", flush=True)


if __name__ == "__main__":
    main()
