"""Volumes are written completely or not at all, and can be read again."""

import os

import numpy as np
import pytest
from refusals import refused
from volume_files import NIFTI, SHAPE, change, oblique, physical, values

from voxflat.io.files import atomic_path
from voxflat.io.sources import as_volume
from voxflat.io.volumes import Volume, read_volume, write_volume

itk = pytest.importorskip("itk")
nib = pytest.importorskip("nibabel")
tifffile = pytest.importorskip("tifffile")


@pytest.mark.parametrize("ending", [*NIFTI, ".nrrd", ".mha", ".mgh", ".mgz", ".npz"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_round_trip(tmp_path, ending, order):
    path, affine = tmp_path / f"v.1{ending}", oblique(11)
    for dtype in ("u1", "i2", "i4", "f4", "?"):
        data = np.asarray(values(dtype), order=order)
        write_volume(path, data, affine)
        volume = read_volume(path)
        np.testing.assert_array_equal(volume.data, data)
        assert volume.data.dtype == (data.dtype if ending == ".npz" or dtype != "?" else np.uint8)
        np.testing.assert_allclose(volume.affine, affine, atol=1e-4)
    assert os.listdir(tmp_path) == [path.name]


@pytest.mark.parametrize("ending", [".nii.gz", ".nrrd", ".npz"])
@pytest.mark.parametrize("channels", [3, 4])
def test_colour_round_trip(tmp_path, ending, channels):
    data = values("u1", (*SHAPE, channels))
    write_volume(tmp_path / f"v{ending}", data, oblique())
    volume = read_volume(tmp_path / f"v{ending}")
    np.testing.assert_array_equal(volume.data, data)
    np.testing.assert_allclose(volume.affine, oblique(), atol=1e-4)


@pytest.mark.parametrize("dtype", ["i1", "u2", "u4", "i8", "u8", "f8"])
def test_nifti_keeps_every_type(tmp_path, dtype):
    data = values(dtype)
    write_volume(tmp_path / "v.nii.gz", data, oblique())
    image = nib.load(tmp_path / "v.nii.gz")
    np.testing.assert_array_equal(np.asarray(image.dataobj), data)
    assert image.get_data_dtype() == data.dtype
    assert image.header.get_xyzt_units()[0] == "mm"


def test_written_files_say_the_same_to_itk(tmp_path):
    for ending in (".nii", ".nrrd", ".mha"):
        write_volume(tmp_path / f"v{ending}", values(), oblique())
        image = itk.imread(str(tmp_path / f"v{ending}"))
        np.testing.assert_allclose(physical(image, (3, 2, 1)), (oblique() @ [3, 2, 1, 1])[:3], atol=1e-4)


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 2, 0)])
@pytest.mark.parametrize("spacing", [(0.4e-3, 0.4e-3, 1.1e-3), (1.0, 1.0, 1.0), (2.0, 3.0, 0.7)])
def test_tiff_stacks_keep_values_and_sizes_of_voxels(tmp_path, order, spacing):
    """Axes in any order become z, y, x, as Fiji, tifffile and napari have them."""
    for dtype in ("u1", "u2", "i4", "f4", "?"):
        data = values(dtype) % 2 if dtype == "?" else (values(dtype) if dtype[0] == "f" else values(dtype) % 250)
        affine = np.diag([*spacing, 1.0])[:, [*order, 3]]
        write_volume(tmp_path / "v.tif", data.transpose(order), affine)
        np.testing.assert_array_equal(tifffile.imread(tmp_path / "v.tif"), data.T)
        volume = read_volume(tmp_path / "v.tif")
        np.testing.assert_array_equal(volume.data, data)
        np.testing.assert_allclose(volume.in_unit("mm").affine, np.diag([*spacing, 1.0]), rtol=1e-6)
    write_volume(tmp_path / "plain.tif", values("u1"), np.eye(4), has_unit=False)
    assert not read_volume(tmp_path / "plain.tif").is_placed


def test_what_a_format_cannot_hold_is_refused(tmp_path):
    for name, data, reason in [
        ("v.npy", values(), "cannot hold an affine"),
        ("v.mgz", values("f8"), "float64"),
        ("v.mgz", values("u1", (*SHAPE, 3)), "cannot hold colours"),
        ("v.mha", values("u1", (*SHAPE, 3)), "colours"),
        ("v.nrrd", values("i8"), "int64.*Convert"),
        ("v.mhd", values(), "two files"),
        ("v.nhdr", values(), "two files"),
        ("v.xyz", values(), "ending '.xyz'"),
        ("v.tif", values(), "origin and the directions of the voxels. Use .nii.gz"),
        ("v.nii", values(shape=(4, 5)), r"\(4, 5\)"),
        ("v.nii", values(shape=(40000, 1, 1)), "v.nii: "),
    ]:
        refused(reason, write_volume, tmp_path / name, data, oblique())
    refused("sheared", write_volume, tmp_path / "v.nii", values(), change(0, 1, 1))
    assert os.listdir(tmp_path) == []
    for data, reason in (
        (values("f8"), "cannot hold the type float64"),
        (values("i4") * 0 + 65536, "from 0 to 65535, not from 65536 to 65536"),
        (values("i4") * 0 - 1, "not from -1 to -1"),
        (values("u1", (*SHAPE, 3)), "neither colours"),
    ):
        refused(f"v.tif: a TIFF.*{reason}", write_volume, tmp_path / "v.tif", data, np.eye(4))
    refused("origin and the directions", write_volume, tmp_path / "v.tif", values(), np.diag([-1.0, 1, 1, 1]))
    assert os.listdir(tmp_path) == []
    write_volume(tmp_path / "v.npy", values(), np.eye(4))


def test_atomic_path_keeps_the_endings(tmp_path):
    path = tmp_path / "sub-01.surf.gii"
    path.write_text("old")
    with atomic_path(path) as temporary:
        assert temporary.parent == tmp_path
        assert temporary.name.endswith("sub-01.surf.gii")
        temporary.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert os.listdir(tmp_path) == [path.name]
    (tmp_path / "plain").touch()
    assert path.stat().st_mode == (tmp_path / "plain").stat().st_mode


@pytest.mark.parametrize("failure", [RuntimeError, KeyboardInterrupt])
def test_atomic_path_leaves_nothing_after_a_failure(tmp_path, failure):
    path = tmp_path / "v.txt"
    path.write_text("old")

    def interrupted():
        with atomic_path(path) as temporary:
            temporary.write_text("half")
            raise failure

    with pytest.raises(failure):
        interrupted()
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["v.txt"]


def test_unwritable_places(tmp_path):
    (tmp_path / "file").touch()
    (tmp_path / "folder.nii").mkdir()
    for path in (tmp_path / "file" / "v.nii", tmp_path / "missing" / "v.nii", tmp_path / "folder.nii"):
        with pytest.raises(OSError, match=str(path)):
            write_volume(path, values(), oblique())
    assert sorted(os.listdir(tmp_path)) == ["file", "folder.nii"]


def test_a_volume_knows_whether_its_place_was_given():
    voxels = values()
    assert not as_volume(voxels).is_placed
    assert not as_volume(as_volume(voxels)).is_placed
    assert as_volume(as_volume(voxels), spacing=(1, 2, 3)).is_placed
    assert as_volume(voxels, affine=oblique()).is_placed
    assert as_volume(Volume(voxels, oblique())).is_placed
