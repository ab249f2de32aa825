import gc
import gzip
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from voxflat.errors import InputError, VoxflatError
from voxflat.io import readers as _readers
from voxflat.io.files import atomic_path
from voxflat.io.grid import check_affine
from voxflat.io.volumes import Volume, as_volume, read_volume, write_volume

itk = pytest.importorskip("itk")
nib = pytest.importorskip("nibabel")

RNG = np.random.default_rng(7)
SHAPE = (4, 5, 6)
NIFTI = [".nii", ".nii.gz"]
BOTH = ["itk+nibabel", "itk", "nibabel"]


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
    """Write a NIfTI by nibabel; `patch` overwrites header bytes at offsets."""
    affine = oblique() if affine is None else affine
    header = nib.Nifti1Header(endianness=endian)
    image = nib.Nifti1Image(data, affine, header=header, dtype=dtype or data.dtype)
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


def hide(monkeypatch, *modules):
    for module in modules:
        monkeypatch.setitem(sys.modules, module, None)


def itk_image(data, direction=None, spacing=(1.0, 2.0, 3.0), origin=(5.0, -6.0, 7.0)):
    image = itk.image_from_array(np.ascontiguousarray(data.T))
    image.SetSpacing(list(spacing))
    image.SetOrigin(list(origin))
    image.SetDirection(itk.matrix_from_array(rotation(3) if direction is None else direction))
    return image


def physical(image, index):
    """The RAS+ mm of a voxel, by ITK's own arithmetic."""
    x, y, z = image.TransformIndexToPhysicalPoint([int(i) for i in index])
    return np.array([-x, -y, z])


def agrees_with_itk(volume, image):
    start = np.array(image.GetBufferedRegion().GetIndex())
    for index in [(0, 0, 0), (3, 0, 0), (0, 4, 0), (0, 0, 5), (1, 2, 3)]:
        point = volume.affine @ [*index, 1]
        np.testing.assert_allclose(point[:3], physical(image, start + index), atol=1e-10)
        assert volume.data[index] == image.GetPixel([int(i) for i in start + index])


# --------------------------------------------------------------------------------- NIfTI, by nibabel


@pytest.mark.parametrize("ending", NIFTI)
@pytest.mark.parametrize(
    "dtype", ["u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8", ">i2", ">i4", ">f4", ">f8", ">i8"]
)
def test_nifti_values(tmp_path, dtype, ending):
    endian = ">" if dtype[0] == ">" else "<"
    same_as_nibabel(save(tmp_path / f"v{ending}", values(dtype), endian=endian))


@pytest.mark.parametrize("sform", [0, 1, 2, 3, 4])
@pytest.mark.parametrize("qform", [0, 1, 2])
def test_nifti_chooses_the_affine_as_nibabel_does(tmp_path, sform, qform, capfd):
    path = save(tmp_path / "v.nii", values(), sform=sform, qform=qform, qaffine=oblique(1, (1, 2, 0.7), (1, 200, 3)))
    same_as_nibabel(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("flip", list(np.ndindex(2, 2, 2)))
@pytest.mark.parametrize("form", ["sform", "qform"])
def test_nifti_flipped_and_permuted_axes(tmp_path, flip, form):
    signs = 1 - 2 * np.array([*flip, 0])
    affine = (np.diag([1.0, 2, 3, 1]) * np.array([*signs[:3], 1]))[[2, 0, 1, 3]]
    codes = {"sform": 1, "qform": 0} if form == "sform" else {"sform": 0, "qform": 1}
    same_as_nibabel(save(tmp_path / "v.nii", values(), affine, **codes))


@pytest.mark.parametrize("module", ["itk", "nibabel"])
def test_one_package_is_enough(tmp_path, monkeypatch, module):
    path = save(tmp_path / "v.nii.gz", values(), sform=1, qform=1, qaffine=oblique(5))
    image = nib.load(path)
    hide(monkeypatch, *({"itk", "nibabel"} - {module}))
    volume = read_volume(path)
    np.testing.assert_array_equal(volume.data, np.asarray(image.dataobj))
    np.testing.assert_allclose(volume.affine, image.affine, rtol=1e-12)


def test_missing_packages_are_named(tmp_path, monkeypatch):
    path = save(tmp_path / "v.nii", values("i1"))
    hide(monkeypatch, "nibabel")
    with pytest.raises(InputError, match=r"pip install 'voxflat\[nibabel\]'"):
        read_volume(path)
    hide(monkeypatch, "itk")
    with pytest.raises(InputError, match=r"pip install 'voxflat\[itk\]'; .*pip install 'voxflat\[nibabel\]'"):
        read_volume(path)
    (tmp_path / "v.mha").write_text("ElementDataFile = LOCAL\n")
    with pytest.raises(InputError, match=r"pip install 'voxflat\[itk\]'$"):
        read_volume(tmp_path / "v.mha")


@pytest.mark.parametrize(("slope", "inter"), [(2.5, -3), (1, 5), (0, 5), (np.nan, 0), (-1, 0), (1, 0)])
@pytest.mark.parametrize("dtype", ["u1", "i2", "i4", "f4"])
def test_nifti_scaling(tmp_path, slope, inter, dtype):
    scale = {112: np.float32(slope), 116: np.float32(inter)}
    same_as_nibabel(save(tmp_path / "v.nii", values(dtype), patch=scale))


def test_nifti_scaled_on_writing(tmp_path):
    same_as_nibabel(save(tmp_path / "v.nii.gz", values("f4"), dtype=np.int16))


def test_nifti_with_an_extension_and_nifti2(tmp_path):
    image = nib.Nifti1Image(values(), oblique())
    image.header.extensions.append(nib.nifti1.Nifti1Extension("comment", b"x" * 1000))
    nib.save(image, tmp_path / "v.nii")
    same_as_nibabel(tmp_path / "v.nii")
    nib.save(nib.Nifti2Image(values(), oblique()), tmp_path / "w.nii.gz")
    same_as_nibabel(tmp_path / "w.nii.gz")


def test_nifti_pixdim_at_odds_with_the_sform_is_silent(tmp_path, capfd):
    same_as_nibabel(save(tmp_path / "v.nii", values(), patch={80: np.float32(9)}))
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("value", [0, -1, np.nan])
def test_nifti_pixdim_must_be_positive_where_it_counts(tmp_path, value):
    for sform, qform in [(0, 0), (0, 1)]:
        path = save(tmp_path / "v.nii", values(), sform=sform, qform=qform, patch={80: np.float32(value)})
        with pytest.raises(InputError, match="pixdim"):
            read_volume(path)
    path = save(tmp_path / "v.nii", values(), patch={80: np.float32(value)})
    np.testing.assert_allclose(read_volume(path).affine, oblique(), rtol=1e-6)


@pytest.mark.parametrize("parts", [(1, 0, 0), (0.6, 0.8, 0), (0, 0.6, -0.8), (0.57735, 0.57735, 0.57735), (0, 0, 0)])
@pytest.mark.parametrize("step", [-1, 0, 1])
def test_nifti_quaternions_near_a_half_turn(tmp_path, parts, step):
    quaternion = np.float32(parts)
    if step:
        quaternion[0] = np.nextafter(quaternion[0], np.float32(step))
    same_as_nibabel(save(tmp_path / "v.nii", values(), sform=0, qform=1, patch={256: quaternion}))


def test_nifti_impossible_quaternion(tmp_path):
    path = save(tmp_path / "v.nii", values(), sform=0, qform=1, patch={256: np.float32([0.9, 0.9, 0.9])})
    with pytest.raises(InputError, match="quaternion"):
        read_volume(path)


@pytest.mark.parametrize("code", [1, 3])
def test_units_other_than_mm_are_refused(tmp_path, code):
    path = save(tmp_path / "v.nii", values(), patch={123: np.uint8(code)})
    with pytest.raises(InputError, match=r"lengths are in (meter|micron)"):
        read_volume(path)
    with pytest.raises(InputError, match="lengths are in"):
        as_volume(nib.load(path))


@pytest.mark.parametrize("extra", [(1,), (1, 1), (1, 1, 1)])
def test_extra_axes_of_length_1_are_dropped(tmp_path, extra):
    data = values()
    path = save(tmp_path / "v.nii", data.reshape(*SHAPE, *extra))
    np.testing.assert_array_equal(read_volume(path).data, data)
    np.testing.assert_array_equal(as_volume(nib.load(path)).data, data)


@pytest.mark.parametrize("shape", [(4, 5), (4,), (4, 5, 6, 2), (4, 5, 6, 1, 3), (4, 5, 6, 3)])
def test_other_dimensions_are_refused_by_shape(tmp_path, shape):
    path = save(tmp_path / "v.nii", values(shape=shape))
    for obj in (path, nib.load(path), values(shape=shape)):
        with pytest.raises(InputError, match=r"shape \(4,"):
            as_volume(obj)


@pytest.mark.parametrize("names", ["RGB", "RGBA"])
@pytest.mark.parametrize("packages", BOTH)
def test_colour_nifti(tmp_path, monkeypatch, names, packages):
    data = values("u1", (*SHAPE, len(names)))
    pixel = np.dtype([(name, "u1") for name in names])
    nib.save(nib.Nifti1Image(data.view(pixel)[..., 0], oblique()), tmp_path / "v.nii")
    hide(monkeypatch, *({"itk", "nibabel"} - set(packages.split("+"))))
    volume = read_volume(tmp_path / "v.nii")
    np.testing.assert_array_equal(volume.data, data)
    assert volume.data.dtype == np.uint8


def test_complex_nifti_is_refused(tmp_path):
    with pytest.raises(InputError, match="complex64"):
        read_volume(save(tmp_path / "v.nii", values("f4").astype("c8")))


def test_sheared_nifti_is_refused_and_nearly_orthogonal_read(tmp_path):
    for shear, good in [(5e-4, True), (2e-3, False), (0.3, False)]:
        affine = oblique()
        affine[:3, 1] += shear * affine[:3, 0] * np.linalg.norm(affine[:3, 1]) / np.linalg.norm(affine[:3, 0])
        path = save(tmp_path / "v.nii", values(), affine)
        if good:
            same_as_nibabel(path)
        else:
            with pytest.raises(InputError, match=r"sheared.*resample"):
                read_volume(path)


rotations = st.builds(rotation, st.integers(0, 2**31))
millimetres = st.floats(0.05, 20)


@settings(max_examples=100, deadline=None)
@given(rotations, st.tuples(*[millimetres] * 3), st.tuples(*[st.floats(-500, 500)] * 3), st.booleans())
def test_any_orthogonal_affine(tmp_path_factory, turn, sizes, origin, sform):
    affine = np.eye(4)
    affine[:3, :3] = turn * sizes
    affine[:3, 3] = origin
    path = tmp_path_factory.getbasetemp() / "any.nii"
    same_as_nibabel(save(path, values("u1", (2, 3, 2)), affine, sform=int(sform), qform=int(not sform)))
    # a float32 quaternion resolves half turns to 1.2e-3 radians only
    rough = 3e-3 * max(sizes) + 1e-4
    np.testing.assert_allclose(read_volume(path).affine, affine, rtol=0, atol=1e-4 if sform else rough)
    np.testing.assert_array_equal(check_affine(affine), affine)
    write_volume(path, values("u1", (2, 3, 2)), affine)
    np.testing.assert_allclose(read_volume(path).affine, affine, rtol=0, atol=1e-4)
    np.testing.assert_allclose(nib.load(path).get_qform(), affine, rtol=0, atol=rough)


@settings(max_examples=200, deadline=None)
@given(rotations, st.permutations(range(3)), st.tuples(*[st.sampled_from([-1, 1])] * 3), st.floats(0, 1))
def test_orientation_is_nibabels(turn, order, signs, weight):
    blend = weight * turn + (1 - weight) * (np.eye(3)[:, list(order)] * signs)
    u, _, v = np.linalg.svd(blend)
    affine = np.eye(4)
    affine[:3, :3] = (u @ v) * (0.7, 1.1, 2.3)
    assert Volume(np.zeros(SHAPE), affine).orientation == "".join(nib.aff2axcodes(affine))


# -------------------------------------------------------------------------------- NRRD, MetaImage, MGH


@pytest.mark.parametrize("ending", [".nrrd", ".mha", ".nhdr", ".mhd"])
@pytest.mark.parametrize("compressed", [False, True])
def test_itk_formats_against_itk_points(tmp_path, ending, compressed):
    path, image = tmp_path / f"v{ending}", itk_image(values())
    itk.imwrite(image, str(path), compression=compressed)
    agrees_with_itk(read_volume(path), image)


def test_a_known_lps_header(tmp_path):
    data = np.arange(24, dtype="<i2")
    head = (
        "NRRD0004\ntype: short\ndimension: 3\nspace: {}\nsizes: 2 3 4\n"
        "space directions: (0,2,0) (0,0,3) (4,0,0)\nspace origin: (10,20,30)\n"
        "endian: little\nencoding: raw\n\n"
    )
    ras = np.array([[0, 0, 4, 10], [2, 0, 0, 20], [0, 3, 0, 30], [0, 0, 0, 1.0]])
    for space, flip in [("left-posterior-superior", -1), ("right-anterior-superior", 1)]:
        (tmp_path / "v.nrrd").write_bytes(head.format(space).encode() + data.tobytes())
        volume = read_volume(tmp_path / "v.nrrd")
        np.testing.assert_allclose(volume.affine, np.diag([flip, flip, 1, 1]) @ ras)
        assert volume.data[1, 2, 3] == 1 + 2 * 2 + 3 * 6
    assert volume.orientation == "ASR"
    bare = "NRRD0004\ntype: short\ndimension: 3\nsizes: 2 3 4\nspacings: 1 nan 2\n"
    bare += "endian: little\nencoding: raw\n\n"
    (tmp_path / "v.nrrd").write_bytes(bare.encode() + data.tobytes())
    with pytest.raises(InputError, match="spacings are 1 nan 2"):
        read_volume(tmp_path / "v.nrrd")


def test_itk_formats_refuse_shear_units_and_unknown_types(tmp_path):
    shear = np.array([[1, 0.5, 0], [0, 1, 0], [0, 0, 1.0]])
    for ending in (".nrrd", ".mha"):
        itk.imwrite(itk_image(values(), shear), str(tmp_path / f"s{ending}"))
        with pytest.raises(InputError, match=r"sheared.*0\.447.*resample"):
            read_volume(tmp_path / f"s{ending}")
    itk.imwrite(itk_image(values()), str(tmp_path / "v.mha"))
    itk.imwrite(itk_image(values()), str(tmp_path / "v.nrrd"))
    content = (tmp_path / "v.mha").read_bytes()
    (tmp_path / "v.mha").write_bytes(content.replace(b"DimSize", b"DistanceUnits = um\nDimSize"))
    content = (tmp_path / "v.nrrd").read_bytes()
    (tmp_path / "v.nrrd").write_bytes(content.replace(b"endian", b'space units: "um" "um" "um"\nendian'))
    for name in ("v.mha", "v.nrrd"):
        with pytest.raises(InputError, match="lengths are in um"):
            read_volume(tmp_path / name)
    content = (tmp_path / "s.mha").read_bytes()
    (tmp_path / "s.mha").write_bytes(content.replace(b"MET_SHORT", b"MET_LONG_LONG"))
    with pytest.raises(InputError, match=r"s\.mha: .*not wrapped.*Convert.*int32") as error:
        read_volume(tmp_path / "s.mha")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("ending", [".mgh", ".mgz"])
@pytest.mark.parametrize("dtype", ["u1", "i2", "i4", "f4"])
def test_mgh(tmp_path, ending, dtype):
    nib.save(nib.MGHImage(values(dtype), oblique().astype("f4")), tmp_path / f"v{ending}")
    same_as_nibabel(tmp_path / f"v{ending}")


# ------------------------------------------------------------------------------------ npy, npz, objects


def test_npy_and_npz(tmp_path):
    data, affine = np.asfortranarray(values()), oblique()
    np.save(tmp_path / "v.npy", data)
    np.savez(tmp_path / "one.npz", anything=data)
    np.savez(tmp_path / "placed.npz", data=data, affine=affine, more=np.zeros(3))
    for name, expected in [("v.npy", np.eye(4)), ("one.npz", np.eye(4)), ("placed.npz", affine)]:
        volume = read_volume(tmp_path / name)
        np.testing.assert_array_equal(volume.data, data)
        np.testing.assert_array_equal(volume.affine, expected)
    for name in ("v.npy", "one.npz"):
        np.testing.assert_array_equal(as_volume(tmp_path / name, affine=affine).affine, affine)
    with pytest.raises(InputError, match="has its own affine"):
        as_volume(tmp_path / "placed.npz", affine=affine)
    np.savez(tmp_path / "many.npz", uv=data, ids=data)
    with pytest.raises(InputError, match=r"many\.npz: .*'uv', 'ids'"):
        read_volume(tmp_path / "many.npz")


def test_pickles_are_never_loaded(tmp_path):
    trap = np.empty(SHAPE, dtype=object)
    np.save(tmp_path / "v.npy", trap, allow_pickle=True)
    np.savez(tmp_path / "v.npz", data=trap, allow_pickle=True)
    for name in ("v.npy", "v.npz"):
        with pytest.raises(InputError, match=name):
            read_volume(tmp_path / name)


def test_arrays_are_borrowed():
    for data in (values(), np.asfortranarray(values()), values()[::2, ::-1]):
        volume = as_volume(data)
        assert np.shares_memory(volume.data, data)
        assert volume.data.strides == data.strides
        np.testing.assert_array_equal(volume.affine, np.eye(4))
        assert volume.path is None
    assert as_volume(values(">f4")).data.dtype.isnative


def test_a_memmap_is_not_read(tmp_path):
    np.save(tmp_path / "v.npy", values())
    mapped = np.load(tmp_path / "v.npy", mmap_mode="r")
    assert np.shares_memory(as_volume(mapped).data, mapped)


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
    with pytest.raises(InputError, match="spacing"):
        as_volume(values(), spacing=spacing)


def test_a_place_is_given_once(tmp_path):
    with pytest.raises(InputError, match="both spacing= and affine="):
        as_volume(values(), spacing=(1, 1, 1), affine=np.eye(4))
    path = save(tmp_path / "v.nii", values())
    for obj in (path, str(path), nib.load(path), itk_image(values()), Volume(values(), oblique())):
        for extra in ({"spacing": (1, 1, 1)}, {"affine": np.eye(4)}):
            with pytest.raises(InputError, match="has its own affine"):
                as_volume(obj, **extra)


def test_nibabel_images():
    data, affine = values(), oblique()
    volume = as_volume(nib.Nifti1Image(data, affine))
    assert np.shares_memory(volume.data, data)
    np.testing.assert_array_equal(volume.affine, affine)
    with pytest.raises(InputError, match="Nifti1Image: affine has shape"):
        as_volume(nib.Nifti1Image(data, None))


def test_itk_images():
    image = itk_image(values())
    agrees_with_itk(as_volume(image), image)
    region = itk.ImageRegion[3]([1, 2, 1], [3, 2, 4])
    part = itk.region_of_interest_image_filter(image, region_of_interest=region)
    np.testing.assert_allclose(as_volume(part).affine[:3, 3], physical(image, (1, 2, 1)))


def test_itk_region_that_does_not_start_at_0():
    image = itk.Image[itk.SS, 3].New()
    image.SetRegions(itk.ImageRegion[3]([2, 3, 4], list(SHAPE)))
    image.Allocate()
    image.SetSpacing([1.0, 2.0, 3.0])
    image.SetDirection(itk.matrix_from_array(rotation(3)))
    itk.array_view_from_image(image)[:] = values().T
    agrees_with_itk(as_volume(image), image)


def test_itk_memory_outlives_the_image(tmp_path):
    data = values("i2", (40, 50, 60))
    itk.imwrite(itk_image(data), str(tmp_path / "v.nrrd"))
    volumes = [
        read_volume(tmp_path / "v.nrrd"),
        as_volume(itk_image(data)),
        as_volume(itk.array_view_from_image(itk_image(data)).T),
    ]
    gc.collect()
    others = [np.ones_like(data) for _ in range(20)]
    for volume in volumes:
        np.testing.assert_array_equal(volume.data, data)
    assert len(others) == 20


class Lazy:
    def __init__(self, data):
        self.data = data

    def __array__(self, dtype=None, copy=None):
        return self.data


def test_objects_with_array():
    data = values()
    assert as_volume(Lazy(data)).data is data
    dask = pytest.importorskip("dask.array")
    np.testing.assert_array_equal(as_volume(dask.from_array(data, chunks=2)).data, data)
    np.testing.assert_array_equal(as_volume(values("?")).data.dtype, bool)


@pytest.mark.parametrize(
    ("obj", "reason"),
    [
        (np.empty(SHAPE, dtype=object), "object"),
        (np.zeros(SHAPE, dtype=complex), "complex128"),
        (np.full(SHAPE, "a"), "<U1"),
        (None, "NoneType: .*object"),
        ([[1, 2], [3]], "list: "),
        (np.zeros((4, 0, 6)), r"\(4, 0, 6\)"),
        (np.zeros((*SHAPE, 3)), r"\(4, 5, 6, 3\)"),
        (np.zeros((*SHAPE, 5), np.uint8), r"\(4, 5, 6, 5\)"),
        (np.ma.zeros(SHAPE), "mask"),
    ],
)
def test_what_is_no_volume(obj, reason):
    with pytest.raises(InputError, match=reason):
        as_volume(obj)


def change(row, column, value):
    affine = np.diag([1.0, 2, 3, 1])
    affine[row, column] = value
    return affine


@pytest.mark.parametrize(
    ("affine", "reason"),
    [
        (np.eye(3), r"shape \(3, 3\)"),
        (None, "shape"),
        ("abc", "no array"),
        ([[1, 2], [3]], "no array"),
        (change(0, 0, np.nan), "finite"),
        (change(0, 3, np.inf), "finite"),
        (change(3, 0, 5), "last row.*transposed"),
        (change(3, 3, 2), "last row"),
        (change(1, 1, 0), r"voxel size is \[1.0, 0.0, 3.0\]"),
        (change(0, 1, 0.01), "sheared.*0.005.*resample"),
        (change(0, 1, 1e9), "sheared"),
    ],
)
def test_bad_affines(affine, reason):
    with pytest.raises(InputError, match=reason):
        check_affine(affine)
    if affine is not None:
        with pytest.raises(InputError, match=reason):
            as_volume(values(), affine=affine)


# ---------------------------------------------------------------------------------------- damaged files


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
    (tmp_path / "v.img").touch()
    with pytest.raises(InputError, match=r"'.img' is unknown; .nii, "):
        read_volume(tmp_path / "v.img")
    assert issubclass(InputError, ValueError)
    assert issubclass(InputError, VoxflatError)


# ---------------------------------------------------------------------------------------------- writing


def suiting(endings):
    """Each ending with the installed packages that can write it."""
    needed = {".nrrd": "itk", ".mha": "itk", ".mgh": "nibabel", ".mgz": "nibabel"}
    return [(ending, packages) for ending in endings for packages in BOTH if needed.get(ending, "") in packages]


@pytest.mark.parametrize(("ending", "packages"), suiting([*NIFTI, ".nrrd", ".mha", ".mgh", ".mgz", ".npz"]))
@pytest.mark.parametrize("order", ["C", "F"])
def test_round_trip(tmp_path, monkeypatch, ending, packages, order):
    hide(monkeypatch, *({"itk", "nibabel"} - set(packages.split("+"))))
    path, affine = tmp_path / f"v.1{ending}", oblique(11)
    for dtype in ("u1", "i2", "i4", "f4", "?"):
        data = np.asarray(values(dtype), order=order)
        write_volume(path, data, affine)
        volume = read_volume(path)
        np.testing.assert_array_equal(volume.data, data)
        assert volume.data.dtype == (data.dtype if ending == ".npz" or dtype != "?" else np.uint8)
        np.testing.assert_allclose(volume.affine, affine, atol=1e-4)
    assert os.listdir(tmp_path) == [path.name]


@pytest.mark.parametrize(("ending", "packages"), suiting([".nii.gz", ".nrrd", ".npz"]))
@pytest.mark.parametrize("channels", [3, 4])
def test_colour_round_trip(tmp_path, monkeypatch, ending, packages, channels):
    hide(monkeypatch, *({"itk", "nibabel"} - set(packages.split("+"))))
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


def test_what_a_format_cannot_hold_is_refused(tmp_path):
    for name, data, reason in [
        ("v.npy", values(), "keeps no affine"),
        ("v.mgz", values("f8"), "float64"),
        ("v.mgz", values("u1", (*SHAPE, 3)), "no colours"),
        ("v.mha", values("u1", (*SHAPE, 3)), "colours"),
        ("v.nrrd", values("i8"), "int64.*convert"),
        ("v.mhd", values(), "two files"),
        ("v.nhdr", values(), "two files"),
        ("v.xyz", values(), "'.xyz' is unknown"),
        ("v.nii", values(shape=(4, 5)), r"\(4, 5\)"),
        ("v.nii", values(shape=(40000, 1, 1)), "v.nii: "),
    ]:
        with pytest.raises(InputError, match=reason):
            write_volume(tmp_path / name, data, oblique())
    with pytest.raises(InputError, match="sheared"):
        write_volume(tmp_path / "v.nii", values(), change(0, 1, 1))
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
    plain = tmp_path / "plain"
    plain.touch()
    assert path.stat().st_mode == plain.stat().st_mode


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


def test_a_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "v.nii.gz"
    write_volume(path, values(), oblique())
    before = path.read_bytes()

    def half(image, name):
        Path(name).write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(nib, "save", half)
    with pytest.raises(OSError, match="No space left") as told:
        write_volume(path, values(), oblique())
    assert told.value.filename == str(path)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == [path.name]


def test_unwritable_places(tmp_path):
    (tmp_path / "file").touch()
    (tmp_path / "folder.nii").mkdir()
    for path in (tmp_path / "file" / "v.nii", tmp_path / "missing" / "v.nii", tmp_path / "folder.nii"):
        with pytest.raises(OSError, match=str(path)):
            write_volume(path, values(), oblique())
    assert sorted(os.listdir(tmp_path)) == ["file", "folder.nii"]


def test_importing_io_imports_neither_package():
    code = "import sys, voxflat.io; assert not {'itk', 'nibabel'} & set(sys.modules), 'imported'"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment)


def test_a_volume_knows_whether_its_place_was_given():
    voxels = values()
    assert not as_volume(voxels).is_placed
    assert not as_volume(as_volume(voxels)).is_placed
    assert as_volume(as_volume(voxels), spacing=(1, 2, 3)).is_placed
    assert as_volume(voxels, affine=oblique()).is_placed
    assert as_volume(Volume(voxels, oblique())).is_placed
