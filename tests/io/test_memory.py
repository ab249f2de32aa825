"""Files that do not fit into memory are not read: headers specify their size, and decompression stops."""

import gzip
import io
import re
import subprocess
import sys
import time
import zipfile
import zlib
from types import SimpleNamespace

import numpy as np
import psutil
import pytest
from command_line import fail
from refusals import refused

import voxflat
from voxflat import arguments
from voxflat.io.reading import reading
from voxflat.io.volumes import read_volume

nib = pytest.importorskip("nibabel")

SHAPE = (1000, 1000, 500)  # 4 GB of float64


def big_image(path, kind=nib.Nifti1Header, **fields):
    """Write the header of a volume that is too large for a test, and its first voxels."""
    header = kind()
    header.set_data_dtype(np.int16)
    header.set_data_shape(SHAPE)
    for name, value in fields.items():
        header[name] = value
    path.write_bytes(gzip.compress(header.binaryblock + bytes(4) + bytes(1 << 20), 1))


def big_array():
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": SHAPE})
    return file.getvalue()


def big_npy(path):
    with path.open("wb") as file:
        file.write(big_array())
        file.truncate(8 * int(np.prod(SHAPE)) + 128)  # a hole


MHA = b"ObjectType = Image\nNDims = 3\nBinaryData = True\nCompressedData = True\nDimSize = 1000 1000 500\n"
MHA += b"ElementType = MET_DOUBLE\nElementDataFile = LOCAL\n" + zlib.compress(bytes(99))
NRRD = b"NRRD0004\ntype: double\ndimension: 3\nsizes: 1000 1000 500\nendian: little\nencoding: gzip\n\n"
BIG = {
    "a.nii.gz": (lambda path: big_image(path, vox_offset=352), "953.7 MiB"),
    "scaled.nii.gz": (lambda path: big_image(path, vox_offset=352, scl_slope=0.5), "4.66 GiB"),
    "two.nii.gz": (lambda path: big_image(path, nib.Nifti2Header, vox_offset=544), "953.7 MiB"),
    "a.mgz": (lambda path: big_image(path, nib.freesurfer.mghformat.MGHHeader), "953.7 MiB"),
    "a.npy": (big_npy, "3.73 GiB"),
    "a.mha": (lambda path: path.write_bytes(MHA), "3.73 GiB"),
    "a.nrrd": (lambda path: path.write_bytes(NRRD + gzip.compress(bytes(99))), "3.73 GiB"),
}


def most_memory():
    """Return the peak memory of this process in bytes."""
    try:
        import resource
    except ImportError:  # Windows
        return getattr(psutil.Process().memory_info(), "peak_wset", 0)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


@pytest.mark.medium
@pytest.mark.parametrize("name", BIG)
def test_headers_tell_what_would_be_too_much(tmp_path, name):
    if name.endswith((".mha", ".nrrd")):
        pytest.importorskip("itk")
    write, size = BIG[name]
    write(tmp_path / name)
    start, before = time.monotonic(), most_memory()
    told = rf"{name}: ({size}) of memory is needed, but the limit is 500 MiB. Crop"
    refused(told, voxflat.surface, tmp_path / name, threshold=0.5, memory_limit=500 << 20)
    assert most_memory() - before < 1 << 29  # ITK itself takes 300 MiB
    assert time.monotonic() - start < 20
    for command in (["flatten", "-o", tmp_path / "m.npz"], ["check", "--threshold", 0.5]):
        fail(1, "the limit is 500 MiB", *command, tmp_path / name, "--memory-limit", "500M")


def test_an_archive_is_no_larger_than_it_says(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("v.npy", big_array() + bytes(99))
    refused(r"ends after \d+ of 4000000128 bytes", read_volume, tmp_path / "a.npz")


def test_inflating_stops(tmp_path):
    image = nib.Nifti1Image(np.ones((4, 4, 4), np.uint8), np.eye(4))
    with gzip.open(tmp_path / "a.nii.gz", "wb", compresslevel=1) as file:
        file.write(image.to_bytes() + bytes(100 << 20))
    refused("is longer than the 416 bytes that its header specifies", read_volume, tmp_path / "a.nii.gz")
    mesh = tmp_path / "lh.surf.gii.gz"
    mesh.write_bytes(gzip.compress(b"<GIFTI>" + bytes(8 << 20), compresslevel=1))
    refused("to more than 1 MiB, a quarter of the memory", voxflat.surface, mesh, memory_limit=4 << 20)


def test_an_image_that_is_still_in_its_file(tmp_path):
    big_image(tmp_path / "a.nii.gz", vox_offset=352, scl_slope=0.5)
    with reading(500 << 20), pytest.raises(voxflat.InputError, match=r"4.66 GiB of memory is needed"):
        voxflat.io.as_volume(nib.load(tmp_path / "a.nii.gz"))


V1_FILES = ("memory", "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
GROUPS = {
    "version 2": ("0::/a/b\n", ("", "memory.max", "memory.current", "inactive_file")),
    "version 1": ("5:cpu:/\n4:blkio,memory:/a/b\n0::/\n", V1_FILES),
}


@pytest.mark.parametrize("version", GROUPS)
def test_control_groups_count(tmp_path, monkeypatch, version):
    text, (root, most, used, reclaimable) = GROUPS[version]
    for place, limit, usage, inactive in (("a", "3000000", 1_500_000, 200_000), ("a/b", "9000000", 1_000, 0)):
        group = tmp_path / "groups" / root / place
        group.mkdir(parents=True)
        (group / most).write_text(f"{limit}\n")
        (group / used).write_text(f"{usage}\n")
        (group / "memory.stat").write_text(f"anon 7\n{reclaimable} {inactive}\nfile 9\n")
    (tmp_path / "own").write_text(text)
    monkeypatch.setattr(arguments, "_CGROUPS", tmp_path / "groups")
    monkeypatch.setattr(arguments, "_OWN_CGROUPS", tmp_path / "own")
    assert arguments.free_memory() == 1_700_000  # limited by the parent group
    (tmp_path / "groups" / root / "a" / most).write_text("max\n")
    assert arguments.free_memory() == 8_999_000
    (tmp_path / "groups" / root / "a" / "b" / most).write_text("500\n")
    assert arguments.free_memory() == 0
    (tmp_path / "own").unlink()
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=12345))
    assert arguments.free_memory() == 12345


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(psutil, "RLIMIT_AS"), reason="this system does not tell the limits of a process")
def test_the_limit_of_the_process_counts(tmp_path):
    big_image(tmp_path / "a.nii.gz", vox_offset=352)
    code = """
import resource, sys, psutil, voxflat
from voxflat.arguments import free_memory
room = psutil.Process().memory_info().vms + (300 << 20)
resource.setrlimit(resource.RLIMIT_AS, (room, room))
assert free_memory() <= 300 << 20
voxflat.surface(sys.argv[1], threshold=0.5)
"""
    command = [sys.executable, "-c", code, tmp_path / "a.nii.gz"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "InputError" in done.stderr.splitlines()[-1]
    assert re.search("953.7 MiB of memory is needed, .*MiB is free", done.stderr)
