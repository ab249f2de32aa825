"""Where there is no room, whatever writes raises an OSError that names the file, and leaves nothing half written."""

import errno
import resource
import sys
from contextlib import contextmanager

import numpy as np
import pytest
from command_line import run
from mesh_files import grid

import voxflat
from voxflat import figures, io
from voxflat.maps.raster import FlatImage
from voxflat.methods import Voxflat

pytestmark = pytest.mark.slow


@contextmanager
def no_room():
    """No file can become longer than 4,000 bytes; bytecode is not kept, of which Python would leave broken files."""
    usual, keeps = resource.getrlimit(resource.RLIMIT_FSIZE), sys.dont_write_bytecode
    sys.dont_write_bytecode = True
    resource.setrlimit(resource.RLIMIT_FSIZE, (4000, usual[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, usual)
        sys.dont_write_bytecode = keeps


def sheet():
    mesh = grid(30, 0.1 * np.random.default_rng(0).random(900), step=1.0)
    return mesh.points, mesh.faces


def writers():
    """Return what writes each kind of file, by the file's name."""
    random = np.random.default_rng(0)
    noise = random.integers(0, 255, (200, 200, 3)).astype(np.uint8)
    flat_map = voxflat.flatten(sheet(), Voxflat(sources=30))
    image, textured = FlatImage(random.normal(size=(200, 200)), 0.5, (0.0, 0.0), "noise"), flat_map.textured(noise)
    volume = random.normal(size=(40, 40, 40)).astype(np.float32)
    write = {f"map.{ending}": flat_map.save for ending in ("npz", "surf.gii", "patch.flat", "vtp", "ply", "obj")}
    write |= {f"image.{ending}": image.save for ending in ("png", "tif", "nii", "nii.gz", "npy")}
    write |= {f"textured.{ending}": textured.save for ending in ("obj", "vtp", "glb", "ply")}
    write["atlas.npz"] = voxflat.surface(sheet()).patches(5).save
    write["lh.white"] = lambda path: io.write_mesh(path, io.Mesh(*sheet()))
    for ending in ("nii", "nrrd", "mha", "mgh", "mgz", "npy", "npz"):
        write[f"volume.{ending}"] = lambda path: io.write_volume(path, volume, np.eye(4))
    for ending in ("png", "pdf", "svg"):
        write[f"figure.{ending}"] = lambda path: figures.save(figures.scatter(flat_map), path)
    write["picture.png"] = lambda path: figures.save_picture(noise, path)
    return write


def test_every_writer_names_the_file_and_keeps_the_old_one(tmp_path):
    write = writers()
    for name in write:
        (tmp_path / name).write_text("old")
    told = []
    for name, save in write.items():
        with no_room(), pytest.raises(OSError, match="File too large") as caught:
            save(tmp_path / name)
        told.append((name, type(caught.value), caught.value.errno, caught.value.filename))
    assert len(told) > 25
    assert told == [(name, OSError, errno.EFBIG, str(tmp_path / name)) for name in write]
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {name: "old" for name in write}


def test_the_command_line_ends_with_one_line(tmp_path):
    io.write_mesh(tmp_path / "sheet.ply", io.Mesh(*sheet()))
    with no_room():
        done = run("patches", tmp_path / "sheet.ply", "-o", tmp_path / "atlas.npz", "--quiet")
    assert done.exit_code == 1
    assert done.stderr == f"voxflat: error: {tmp_path / 'atlas.npz'}: File too large\n"
    assert [path.name for path in tmp_path.iterdir()] == ["sheet.ply"]
