"""Read arrays, nibabel and ITK images, .npy and .npz files as volumes; check affines."""

import gc
from pathlib import Path

import numpy as np
import pytest
from refusals import refused
from volume_files import SHAPE, agrees_with_itk, change, itk_image, oblique, physical, rotation, save, values

from voxflat.io.grid import check_affine, voxel_size
from voxflat.io.sources import as_volume
from voxflat.io.volumes import Volume, read_volume

itk = pytest.importorskip("itk")
nib = pytest.importorskip("nibabel")


def test_npy_and_npz(tmp_path):
    data, affine = np.asfortranarray(values()), oblique()
    np.save(tmp_path / "v.npy", data)
    np.savez(tmp_path / "one.npz", anything=data)
    np.savez(tmp_path / "placed.npz", data=data, affine=affine, more=np.zeros(3))
    np.savez(tmp_path / "many.npz", uv=data, ids=data)
    for name, expected in [("v.npy", np.eye(4)), ("one.npz", np.eye(4)), ("placed.npz", affine)]:
        volume = read_volume(tmp_path / name)
        np.testing.assert_array_equal(volume.data, data)
        np.testing.assert_array_equal(volume.affine, expected)
        if name == "placed.npz":
            refused("defines the size of its voxels. Omit affine", as_volume, tmp_path / name, affine=affine)
        else:
            np.testing.assert_array_equal(as_volume(tmp_path / name, affine=affine).affine, affine)
    refused(r"many\.npz: .*'uv', 'ids'", read_volume, tmp_path / "many.npz")


def test_pickles_are_never_loaded(tmp_path):
    trap = np.empty(SHAPE, dtype=object)
    np.save(tmp_path / "v.npy", trap, allow_pickle=True)
    np.savez(tmp_path / "v.npz", data=trap, allow_pickle=True)
    for name in ("v.npy", "v.npz"):
        refused(name, read_volume, tmp_path / name)


def test_arrays_are_not_copied(tmp_path):
    np.save(tmp_path / "v.npy", values())
    mapped = np.load(tmp_path / "v.npy", mmap_mode="r")
    for data in (values(), np.asfortranarray(values()), values()[::2, ::-1], mapped):
        volume = as_volume(data)
        assert np.shares_memory(volume.data, data)
        assert volume.data.strides == data.strides
        np.testing.assert_array_equal(volume.affine, np.eye(4))
        assert volume.path is None
    assert as_volume(values(">f4")).data.dtype.isnative


def test_spacing_and_affine():
    volume = as_volume(values(), spacing=(0.5, 2, 3))
    np.testing.assert_array_equal(volume.affine, np.diag([0.5, 2, 3, 1]))
    np.testing.assert_array_equal(volume.spacing, [0.5, 2, 3])
    assert volume.orientation == "RAS"
    np.testing.assert_array_equal(as_volume(values(), affine=oblique()).affine, oblique())
    again = as_volume(volume)
    assert again.data is volume.data
    np.testing.assert_array_equal(again.affine, volume.affine)


@pytest.mark.parametrize("spacing", [(1, 1, 0), (1, -1, 1), (1, np.nan, 1), (np.inf, 1, 1), (1, 1), 1.0, "abc"])
def test_bad_spacing(spacing):
    refused("spacing", as_volume, values(), spacing=spacing)


def test_a_place_is_given_once(tmp_path):
    refused("spacing and affine are both given", as_volume, values(), spacing=(1, 1, 1), affine=np.eye(4))
    path = save(tmp_path / "v.nii", values())
    for obj in (path, str(path), nib.load(path), itk_image(values()), Volume(values(), oblique())):
        remedy = "correct the file, for example with nibabel" if isinstance(obj, str | Path) else "pass only the array"
        refused(rf"voxels \(.* mm\)\. Omit spacing, or {remedy}", as_volume, obj, spacing=(1, 1, 1))
        refused(f"voxels. Omit affine, or {remedy}", as_volume, obj, affine=np.eye(4))


def test_nibabel_images():
    data, affine = values(), oblique()
    volume = as_volume(nib.Nifti1Image(data, affine))
    assert np.shares_memory(volume.data, data)
    np.testing.assert_array_equal(volume.affine, affine)
    refused("Nifti1Image: affine None is not an array of numbers", as_volume, nib.Nifti1Image(data, None))


@pytest.mark.slow
def test_itk_images():
    image = itk_image(values())
    agrees_with_itk(as_volume(image), image)
    part = itk.region_of_interest_image_filter(image, region_of_interest=itk.ImageRegion[3]([1, 2, 1], [3, 2, 4]))
    np.testing.assert_allclose(as_volume(part).affine[:3, 3], physical(image, (1, 2, 1)))


def test_itk_region_that_does_not_start_at_0():
    image = itk.Image[itk.SS, 3].New()
    image.SetRegions(itk.ImageRegion[3]([2, 3, 4], list(SHAPE)))
    image.Allocate()
    image.SetSpacing([1.0, 2.0, 3.0])
    image.SetDirection(itk.matrix_from_array(rotation(3)))
    itk.array_view_from_image(image)[:] = values().T
    agrees_with_itk(as_volume(image), image)


@pytest.mark.medium
def test_itk_memory_outlives_the_image(tmp_path):
    data = values("i2", (40, 50, 60))
    itk.imwrite(itk_image(data), str(tmp_path / "v.nrrd"))
    view = as_volume(itk.array_view_from_image(itk_image(data)).T)
    volumes = [read_volume(tmp_path / "v.nrrd"), as_volume(itk_image(data)), view]
    gc.collect()
    others = [np.ones_like(data) for _ in range(20)]
    for volume in volumes:
        np.testing.assert_array_equal(volume.data, data)
    assert len(others) == 20


def test_objects_with_array():
    data = values()
    lazy = type("Lazy", (), {"__array__": lambda self, dtype=None, copy=None: data})
    assert as_volume(lazy()).data is data
    dask = pytest.importorskip("dask.array")
    np.testing.assert_array_equal(as_volume(dask.from_array(data, chunks=2)).data, data)
    np.testing.assert_array_equal(as_volume(values("?")).data.dtype, bool)


def test_what_is_no_volume():
    refused("object", as_volume, np.empty(SHAPE, dtype=object))
    refused("NoneType: .*object", as_volume, None)
    refused("list: ", as_volume, [[1, 2], [3]])
    refused(r"\(4, 5, 6, 5\)", as_volume, np.zeros((*SHAPE, 5), np.uint8))
    refused("mask", as_volume, np.ma.zeros(SHAPE))


def test_bad_affines():
    def bad(affine, reason):
        refused(reason, check_affine, affine)
        refused(reason, as_volume, values(), affine=affine)

    refused("not an array", check_affine, None)
    bad("abc", "not an array")
    bad([[1, 2], [3]], "not an array")
    bad(change(0, 3, np.inf), "finite")
    bad(change(3, 0, 5), "last row.*Transpose")
    bad(change(3, 3, 2), "last row")
    bad(change(0, 1, 0.01), "sheared.*0.005.*Resample")
    bad(change(0, 1, 1e9), "sheared")


def test_the_size_of_voxels_is_the_mean_of_the_spacings():
    for size in (0.1, 0.25, 0.3, 0.5, 0.7, 1.0, 1.25):  # exactly, so that pixels have the same size on every machine
        assert voxel_size(np.diag([size, -size, size, 1])) == size
    assert voxel_size(np.diag([1.0, 1.0, 8.0, 1.0])) == pytest.approx(2.0)
    assert voxel_size(oblique()) == pytest.approx(np.abs(np.linalg.det(oblique()[:3, :3])) ** (1 / 3))
