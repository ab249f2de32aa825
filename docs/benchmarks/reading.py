"""What it costs that ITK, VTK and Pillow read in a process of their own: files of 100 MB, there and in this process.

    python docs/benchmarks/reading.py
    python docs/benchmarks/reading.py .vtp .vtk     # only these

Medians of 5 rounds in turn, seconds by the clock: in the other process, and with the same function called here.
"""

from __future__ import annotations

import argparse
import contextlib
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any
from unittest import mock

import numpy as np
import pyvista
from PIL import Image

from voxflat.io import Mesh, read_mesh, read_volume, readers, write_mesh, write_volume
from voxflat.io.formats import vtk
from voxflat.maps.textures import pictures
from voxflat.maps.textures.pictures import as_picture

ROUNDS = 5


def files(folder: Path) -> dict[Path, Callable[[Path], Any]]:
    """Write files of 100 MB, as far as they are not packed.

    `folder`: where. Returns: what reads each.
    """
    smooth = np.arange(370**3, dtype=np.int32).reshape(370, 370, 370) // 7
    found: dict[Path, Callable[[Path], Any]] = {}
    for name, data in {
        "v.nii": smooth.astype(np.int16),
        "float.nii": smooth[:293].astype(np.float32),
        "v.nii.gz": smooth.astype(np.int16),
        "v.nrrd": smooth.astype(np.int16),
        "v.mha": smooth.astype(np.int16),
    }.items():
        found[folder / name] = read_volume
        write_volume(folder / name, data, np.eye(4))
    head = f"sizes: {' '.join(map(str, smooth.shape))}\nendian: little\nencoding: raw\n\n"
    (folder / "raw.nrrd").write_bytes(
        b"NRRD0004\ntype: short\ndimension: 3\n" + head.encode() + smooth.astype("<i2").tobytes("F")
    )
    found[folder / "raw.nrrd"] = read_volume
    n = 1700
    sheet = pyvista.Plane(i_resolution=n, j_resolution=n).triangulate()
    sheet.clear_data()
    write_mesh(folder / "s.vtp", Mesh(np.asarray(sheet.points) * 100, np.asarray(sheet.regular_faces)))
    sheet.save(folder / "s.vtk")
    rows, columns = np.indices((6000, 6000))
    noise = np.random.default_rng(0).integers(0, 256, rows.shape)
    photograph = Image.fromarray(np.stack([rows // 24, columns // 24, noise], axis=-1).astype(np.uint8))
    for name in ("p.png", "p.jpg", "p.tif"):
        photograph.save(folder / name)
        found[folder / name] = as_picture
    return found | {folder / "s.vtp": read_mesh, folder / "s.vtk": read_mesh}


def here(function: Callable[..., Any], _: str, path: Path, *arguments: Any, **_options: Any) -> Any:
    """Call a function in this process, as `voxflat.io.apart` does in another."""
    return function(path, *arguments)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("endings", nargs="*", default=[""], help="of the names of files that are read; by default all")
    endings = tuple(parser.parse_args().endings)
    print("| file | MB | apart, s | here, s | ratio |\n|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for path, read in files(Path(folder)).items():
            if not path.name.endswith(endings):
                continue
            seconds: dict[str, list[float]] = {"apart": [], "here": []}
            for _ in range(ROUNDS + 1):
                for where, found in seconds.items():
                    calls = here if where == "here" else readers.apart
                    with contextlib.ExitStack() as patched:
                        for module in (readers, vtk, pictures):
                            patched.enter_context(mock.patch.object(module, "apart", calls))
                        start = time.perf_counter()
                        read(path)
                        found.append(time.perf_counter() - start)
            apart, direct = (median(found[1:]) for found in seconds.values())  # the first loads packages
            size = path.stat().st_size / 1e6
            print(f"| {path.name} | {size:.0f} | {apart:.2f} | {direct:.2f} | {apart / direct:.2f} |", flush=True)


if __name__ == "__main__":
    main()
