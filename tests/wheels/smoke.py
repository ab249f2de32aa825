"""Test an installed voxflat: flatten a volume and a mesh, use the command line, save and load, and compare machines.

    python -I tests/wheels/smoke.py                          # test the installed package
    python -I tests/wheels/smoke.py -o here.npz              # also keep the maps
    python -I tests/wheels/smoke.py --against here.npz       # also compare the maps with those

`make wheel-check` runs this script in clean environments and on emulated CPUs.
"""

import argparse
import contextlib
import io
import platform
import shutil
import tempfile
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np

start = time.perf_counter()
import voxflat  # noqa: E402
from voxflat import cli  # noqa: E402
from voxflat.methods import Voxflat, Zigelman2002  # noqa: E402

seconds = time.perf_counter() - start

TOLERANCE = 1e-5  # greatest difference of a map between CPUs, relative to its extent


def bumps(n):
    """Return a bent sheet as voxels and as a mesh."""
    i, j = np.indices((n, n))
    height = 9 + 6 * np.sin(i / 7) * np.cos(j / 9)
    volume = np.zeros((n, n, 20), np.uint8)
    volume[i, j, np.round(height).astype(int)] = 1
    number = np.arange(n * n).reshape(n, n)
    a, b, c, d = (part.ravel() for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return volume, (np.stack([i, j, height], -1).reshape(-1, 3).astype(float), faces)


def maps():
    """Return the coordinates of some maps after checking their distance errors and the command line."""
    volume, mesh = bumps(40)
    made = {
        "volume": voxflat.flatten(volume),
        "mesh": voxflat.flatten(mesh),
        "mesh, Zigelman et al.": voxflat.flatten(mesh, Zigelman2002(sources=200)),
        "mesh, 4 threads": voxflat.flatten(mesh, threads=4),
        "mesh, fewer sources": voxflat.flatten(mesh, Voxflat(sources=50)),
    }
    np.testing.assert_array_equal(made["mesh"].uv, made["mesh, 4 threads"].uv)
    for name, one in made.items():
        error = one.distortion.raw.relative_error
        print(f"{name}: {len(one)} points, mean distance error {100 * error:.3f} %")
        assert error < 0.2, name
    with tempfile.TemporaryDirectory() as folder:
        made["mesh"].save(Path(folder) / "map.npz")
        np.testing.assert_array_equal(voxflat.load(Path(folder) / "map.npz").uv, made["mesh"].uv)
        np.save(Path(folder) / "v.npy", volume)
        assert "voxflat" in command("--version")
        command("flatten", Path(folder) / "v.npy", "-o", Path(folder) / "cli.npz", "--quiet")
        np.testing.assert_array_equal(voxflat.load(Path(folder) / "cli.npz").uv, made["volume"].uv)
        command("figure", Path(folder) / "cli.npz", "-o", Path(folder) / "figure.png")
        assert (Path(folder) / "figure.png").stat().st_size > 1000
    return {name: np.asarray(one.uv) for name, one in made.items()}


def command(*words):
    """Run a command in this process, because it may be emulated, and return its output."""
    printed, status = io.StringIO(), None
    with contextlib.redirect_stdout(printed):
        try:
            cli.main([str(word) for word in words], prog_name="voxflat")
        except SystemExit as done:
            status = done.code
    assert not status, printed.getvalue()
    return printed.getvalue()


def compared(made, path):
    """Print and check the greatest difference from kept maps."""
    with np.load(path) as kept:
        for name, uv in made.items():
            difference = np.abs(uv - kept[name]).max() / np.ptp(kept[name], axis=0).max()
            print(f"{name}: differs by at most {difference:.1e} of its extent")
            assert difference <= TOLERANCE, name


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--against", type=Path)
    asked = parser.parse_args()
    assert "plugin" not in Path(voxflat.__file__).parts, f"{voxflat.__file__} is the checkout"
    assert shutil.which("cargo") is None, "cargo is on the PATH: run this without it"
    system = f"{platform.system()} {platform.machine()}, Python {platform.python_version()}"
    print(f"voxflat {voxflat.__version__}, {system};", end=" ")
    print(", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "click", "pillow", "matplotlib")))
    print(f"imported in {seconds:.2f} s")
    found = maps()
    if asked.output:
        np.savez(asked.output, **found)
    if asked.against:
        compared(found, asked.against)
    print("the wheel works")
