"""Volumes in files and as objects, and comparisons with other readers."""

import gzip

import numpy as np
import pytest

from voxflat.io.volumes import read_volume

itk = pytest.importorskip("itk")
nib = pytest.importorskip("nibabel")

RNG = np.random.default_rng(7)
SHAPE = (4, 5, 6)
NIFTI = [".nii", ".nii.gz"]


def rotation(seed=0):
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q


def oblique(seed=0, sizes=(1 / 3, 2.0, 3.0), origin=(-123.45678, 2.0, 3.3)):
    affine = np.eye(4)
    affine[:3, :3] = rotation(seed) * sizes
    affine[:3, 3] = origin
    return affine


def values(dtype="int16", shape=SHAPE):
    dtype = np.dtype(dtype)
    if dtype.kind == "f":
        return RNG.normal(size=shape).astype(dtype)
    if dtype.kind == "b":
        return RNG.random(shape) < 0.5
    info = np.iinfo(dtype)
    return RNG.integers(info.min, info.max, size=shape, dtype=dtype.newbyteorder("="), endpoint=True).astype(dtype)


def save(path, data, affine=None, *, sform=1, qform=0, qaffine=None, endian="<", patch=None, dtype=None):
    """Write NIfTI by nibabel; `patch` overwrites header bytes at offsets."""
    affine = oblique() if affine is None else affine
    image = nib.Nifti1Image(data, affine, header=nib.Nifti1Header(endianness=endian), dtype=dtype or data.dtype)
    image.set_sform(affine, sform)
    image.set_qform(affine if qaffine is None else qaffine, qform)
    nib.save(image, path)
    if patch:
        raw = bytearray(gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes())
        for offset, value in patch.items():
            raw[offset : offset + value.nbytes] = value.tobytes()
        path.write_bytes(gzip.compress(raw) if path.suffix == ".gz" else raw)
    return path


def same_as_nibabel(path):
    volume, image = read_volume(path), nib.load(path)
    expected = np.asarray(image.dataobj)
    np.testing.assert_array_equal(volume.data, expected)
    assert volume.data.dtype == expected.dtype.newbyteorder("=")
    assert volume.data.dtype.isnative
    np.testing.assert_allclose(volume.affine, image.affine, rtol=1e-12, atol=1e-12)
    assert volume.orientation == "".join(nib.aff2axcodes(image.affine))
    np.testing.assert_allclose(volume.spacing, nib.affines.voxel_sizes(image.affine))
    assert volume.path == path
    return volume


def itk_image(data, direction=None, spacing=(1.0, 2.0, 3.0), origin=(5.0, -6.0, 7.0)):
    image = itk.image_from_array(np.ascontiguousarray(data.T))
    image.SetSpacing(list(spacing))
    image.SetOrigin(list(origin))
    image.SetDirection(itk.matrix_from_array(rotation(3) if direction is None else direction))
    return image


def physical(image, index):
    """Return the RAS+ position of a voxel computed by ITK, mm."""
    x, y, z = image.TransformIndexToPhysicalPoint([int(i) for i in index])
    return np.array([-x, -y, z])


def agrees_with_itk(volume, image):
    start = np.array(image.GetBufferedRegion().GetIndex())
    for index in [(0, 0, 0), (3, 0, 0), (0, 4, 0), (0, 0, 5), (1, 2, 3)]:
        point = volume.affine @ [*index, 1]
        np.testing.assert_allclose(point[:3], physical(image, start + index), atol=1e-10)
        assert volume.data[index] == image.GetPixel([int(i) for i in start + index])


def change(row, column, value):
    affine = np.diag([1.0, 2, 3, 1])
    affine[row, column] = value
    return affine
