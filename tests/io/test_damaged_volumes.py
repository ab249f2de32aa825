"""Files of volumes that are damaged or something else."""

import gzip

import numpy as np
import pytest
from volume_files import BOTH, NIFTI, hide, oblique, save, values

from voxflat.errors import InputError, VoxflatError
from voxflat.io import readers as _readers
from voxflat.io.sources import as_volume
from voxflat.io.volumes import read_volume, write_volume

itk = pytest.importorskip("itk")


# ---------------------------------------------------------------------------------------- damaged files


@pytest.mark.slow
@pytest.mark.parametrize("packages", BOTH)
@pytest.mark.parametrize("ending", [*NIFTI, ".mgh", ".mgz", ".nrrd", ".mha", ".npy", ".npz"])
def test_truncated_files(tmp_path, monkeypatch, ending, packages):
    path = tmp_path / f"v{ending}"
    affine = np.eye(4) if ending == ".npy" else oblique()
    write_volume(path, values("i2", (20, 20, 20)), affine)
    whole = path.read_bytes()
    hide(monkeypatch, *({"itk", "nibabel"} - set(packages.split("+"))))
    nearly = len(whole) - (30 if ending == ".mgh" else 9)  # beyond the optional footer of MGH
    for size in (len(whole) // 2, nearly, 300, 10, 0):
        path.write_bytes(whole[:size])
        with pytest.raises(InputError, match=f"v{ending}: ") as error:
            read_volume(path)
        assert "\n" not in str(error.value)
        assert len(str(error.value)) < 400


@pytest.mark.parametrize("ending", [".nii.gz", ".mgz", ".nrrd", ".mha", ".npz"])
def test_a_flipped_bit_is_noticed(tmp_path, ending):
    path = tmp_path / f"v{ending}"
    write_volume(path, values("i2", (20, 20, 20)), oblique())
    damaged = bytearray(path.read_bytes())
    damaged[len(damaged) // 2] ^= 4
    path.write_bytes(damaged)
    with pytest.raises(InputError, match=f"v{ending}: "):
        read_volume(path)


@pytest.mark.parametrize("ending", sorted(_readers.READERS))
def test_files_of_another_format(tmp_path, ending):
    path = tmp_path / f"v{ending}"
    path.write_text("this is a text file\n" * 50)
    with pytest.raises(InputError, match=f"v{ending}: "):
        read_volume(path)


def test_gz_and_nii_exchanged(tmp_path):
    save(tmp_path / "v.nii", values())
    (tmp_path / "w.nii.gz").write_bytes((tmp_path / "v.nii").read_bytes())
    (tmp_path / "v.nii").write_bytes(gzip.compress((tmp_path / "v.nii").read_bytes()))
    for name in ("v.nii", "w.nii.gz"):
        with pytest.raises(InputError, match=name):
            read_volume(tmp_path / name)


def test_no_file_directory_or_ending(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.nii"):
        read_volume(tmp_path / "none.nii")
    with pytest.raises(InputError, match="is a directory"):
        as_volume(str(tmp_path))
    (tmp_path / "v.jpg").touch()
    with pytest.raises(InputError, match=r"'.jpg' is unknown; .nii, "):
        read_volume(tmp_path / "v.jpg")
    assert issubclass(InputError, ValueError)
    assert issubclass(InputError, VoxflatError)
