"""Where there is no room, whatever writes raises an OSError that names the file, and leaves nothing half written."""

import ast
import errno
import subprocess
import sys

import pytest

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform == "win32", reason="Windows has no limit on the size of files"),
]

SETUP = """
import resource, sys
sys.dont_write_bytecode = True  # a module that is compiled within the limit would be cut short, for all who come after
import numpy as np
from pathlib import Path
import voxflat
from voxflat import figures, io
from voxflat.maps.raster import FlatImage

place = Path(sys.argv[1])
random = np.random.default_rng(0)
noise = random.integers(0, 255, (200, 200, 3)).astype(np.uint8)
i, j = np.indices((30, 30)).reshape(2, -1)
corner = np.arange(900).reshape(30, 30)[:-1, :-1].ravel()
faces = np.concatenate([corner[:, None] + [0, 30, 1], corner[:, None] + [1, 30, 31]])
sheet = np.column_stack([i, j, 0.1 * random.random(900)]), faces
"""

WRITERS = (
    SETUP
    + """
flat_map = voxflat.flatten(sheet, sources=30)
image, textured = FlatImage(random.normal(size=(200, 200)), 0.5, (0.0, 0.0), "noise"), flat_map.textured(noise)
atlas = voxflat.patches(sheet, 5)
volume = random.normal(size=(40, 40, 40)).astype(np.float32)
write = {f"map.{ending}": flat_map.save for ending in ("npz", "surf.gii", "patch.flat", "vtp", "ply", "obj")}
write |= {f"image.{ending}": image.save for ending in ("png", "tif", "nii", "nii.gz", "npy")}
write |= {f"textured.{ending}": textured.save for ending in ("obj", "vtp", "glb", "ply")}
write |= {"atlas.npz": atlas.save, "lh.white": lambda path: io.write_mesh(path, io.Mesh(*sheet))}
for ending in ("nii", "nrrd", "mha", "mgh", "mgz", "npy", "npz"):
    write[f"volume.{ending}"] = lambda path: io.write_volume(path, volume, np.eye(4))
for ending in ("png", "pdf", "svg"):
    write[f"figure.{ending}"] = lambda path: figures.save(figures.scatter(flat_map), path)
write["picture.png"] = lambda path: figures.save_picture(noise, path)
for name in write:
    (place / name).write_text("old")
resource.setrlimit(resource.RLIMIT_FSIZE, (4000, resource.RLIM_INFINITY))
for name, save in write.items():
    try:
        save(place / name)
        told = None
    except Exception as error:
        told = type(error).__name__, getattr(error, "errno", None), getattr(error, "filename", None)
    print((name, told))
"""
)


def test_every_writer_names_the_file_and_keeps_the_old_one(tmp_path):
    done = subprocess.run([sys.executable, "-c", WRITERS, tmp_path], capture_output=True, text=True, check=True)
    told = [ast.literal_eval(line) for line in done.stdout.splitlines()]
    assert len(told) > 25
    assert told == [(name, ("OSError", errno.EFBIG, str(tmp_path / name))) for name, _ in told]
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {name: "old" for name, _ in told}


def test_the_command_line_ends_with_one_line(tmp_path):
    command = SETUP + (
        "io.write_mesh(place / 'sheet.ply', io.Mesh(*sheet))\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (4000, resource.RLIM_INFINITY))\n"
        "from voxflat.cli import main\n"
        "main(['patches', str(place / 'sheet.ply'), '-o', str(place / 'atlas.npz'), '--quiet'])\n"
    )
    done = subprocess.run([sys.executable, "-c", command, tmp_path], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr == f"voxflat: error: {tmp_path / 'atlas.npz'}: File too large\n"
    assert [path.name for path in tmp_path.iterdir()] == ["sheet.ply"]
