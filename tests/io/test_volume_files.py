"""Volumes in NIfTI, NRRD, MetaImage and MGH files: values, positions and units; damaged and other files are refused."""

import gzip
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mesh_files import patch, refuses
from refusals import refused
from volume_files import NIFTI, SHAPE, agrees_with_itk, itk_image, oblique, rotation, same_as_nibabel, save, values

from voxflat.errors import InputError
from voxflat.io.grid import check_affine
from voxflat.io.readers import READERS
from voxflat.io.sources import as_volume
from voxflat.io.volumes import Volume, read_volume, write_volume

itk = pytest.importorskip("itk")
nib = pytest.importorskip("nibabel")


@pytest.mark.parametrize("ending", NIFTI)
@pytest.mark.parametrize(
    "dtype", ["u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8", ">i2", ">i4", ">f4", ">f8", ">i8"]
)
def test_nifti_values(tmp_path, dtype, ending):
    same_as_nibabel(save(tmp_path / f"v{ending}", values(dtype), endian=">" if dtype[0] == ">" else "<"))


@pytest.mark.parametrize("sform", [0, 1, 2, 3, 4])
@pytest.mark.parametrize("qform", [0, 1, 2])
def test_nifti_chooses_the_affine_as_nibabel_does(tmp_path, sform, qform, capfd):
    path = save(tmp_path / "v.nii", values(), sform=sform, qform=qform, qaffine=oblique(1, (1, 2, 0.7), (1, 200, 3)))
    same_as_nibabel(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.medium
@pytest.mark.parametrize("flip", list(np.ndindex(2, 2, 2)))
@pytest.mark.parametrize("form", ["sform", "qform"])
def test_nifti_flipped_and_permuted_axes(tmp_path, flip, form):
    affine = (np.diag([1.0, 2, 3, 1]) * (1 - 2 * np.array([*flip, 0])))[[2, 0, 1, 3]]
    codes = {"sform": 1, "qform": 0} if form == "sform" else {"sform": 0, "qform": 1}
    same_as_nibabel(save(tmp_path / "v.nii", values(), affine, **codes))


def test_a_missing_package_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "itk", None)
    (tmp_path / "v.mha").write_text("NDims = 3\nDimSize = 2 2 2\nElementDataFile = LOCAL\n")
    refuses(tmp_path / "v.mha", r"pip install 'voxflat\[lab\]'$", read_volume)


@pytest.mark.medium
@pytest.mark.parametrize(("slope", "inter"), [(2.5, -3), (1, 5), (0, 5), (np.nan, 0), (-1, 0), (1, 0)])
@pytest.mark.parametrize("dtype", ["u1", "i2", "i4", "f4"])
def test_nifti_scaling(tmp_path, slope, inter, dtype):
    same_as_nibabel(save(tmp_path / "v.nii", values(dtype), patch={112: np.float32(slope), 116: np.float32(inter)}))


def test_other_nifti_headers(tmp_path, capfd):
    same_as_nibabel(save(tmp_path / "two.nii.gz", values(), sform=1, qform=1, qaffine=oblique(5)))  # the sform is read
    same_as_nibabel(save(tmp_path / "scaled.nii.gz", values("f4"), dtype=np.int16))
    same_as_nibabel(save(tmp_path / "pixdim.nii", values(), patch={80: np.float32(9)}))  # differs from the sform
    assert capfd.readouterr() == ("", "")
    image = nib.Nifti1Image(values(), oblique())
    image.header.extensions.append(nib.nifti1.Nifti1Extension("comment", b"x" * 1000))
    nib.save(image, tmp_path / "v.nii")
    same_as_nibabel(tmp_path / "v.nii")
    nib.save(nib.Nifti2Image(values(), oblique()), tmp_path / "w.nii.gz")
    same_as_nibabel(tmp_path / "w.nii.gz")


@pytest.mark.parametrize("value", [0, -1, np.nan])
def test_nifti_pixdim_must_be_positive_where_it_counts(tmp_path, value):
    wrong = {80: np.float32(value)}
    for qform in (0, 1):
        refuses(save(tmp_path / "v.nii", values(), sform=0, qform=qform, patch=wrong), "pixdim", read_volume)
    path = save(tmp_path / "v.nii", values(), patch=wrong)
    np.testing.assert_allclose(read_volume(path).affine, oblique(), rtol=1e-6)


@pytest.mark.parametrize("parts", [(1, 0, 0), (0.6, 0.8, 0), (0, 0.6, -0.8), (0.57735, 0.57735, 0.57735), (0, 0, 0)])
@pytest.mark.parametrize("step", [-1, 0, 1])
def test_nifti_quaternions_near_a_half_turn(tmp_path, parts, step):
    quaternion = np.float32(parts)
    if step:
        quaternion[0] = np.nextafter(quaternion[0], np.float32(step))
    same_as_nibabel(save(tmp_path / "v.nii", values(), sform=0, qform=1, patch={256: quaternion}))
    wrong = {256: np.float32([0.9, 0.9, 0.9])}
    refuses(save(tmp_path / "v.nii", values(), sform=0, qform=1, patch=wrong), "quaternion", read_volume)


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
        refused(r"shape \(4,", as_volume, obj)


@pytest.mark.parametrize("names", ["RGB", "RGBA"])
def test_colour_nifti(tmp_path, names):
    data = values("u1", (*SHAPE, len(names)))
    pixel = np.dtype([(name, "u1") for name in names])
    nib.save(nib.Nifti1Image(data.view(pixel)[..., 0], oblique()), tmp_path / "v.nii")
    volume = read_volume(tmp_path / "v.nii")
    np.testing.assert_array_equal(volume.data, data)
    assert volume.data.dtype == np.uint8
    refuses(save(tmp_path / "v.nii", values("f4").astype("c8")), "complex64", read_volume)


@pytest.mark.parametrize(("shear", "good"), [(5e-4, True), (2e-3, False), (0.3, False)])
def test_sheared_nifti_is_refused_and_nearly_orthogonal_read(tmp_path, shear, good):
    affine = oblique()
    affine[:3, 1] += shear * affine[:3, 0] * np.linalg.norm(affine[:3, 1]) / np.linalg.norm(affine[:3, 0])
    path = save(tmp_path / "v.nii", values(), affine)
    same_as_nibabel(path) if good else refuses(path, r"sheared.*Resample", read_volume)


rotations = st.builds(rotation, st.integers(0, 2**31))
millimetres = st.floats(0.05, 20)


@pytest.mark.slow
@settings(max_examples=40)
@given(rotations, st.tuples(*[millimetres] * 3), st.tuples(*[st.floats(-500, 500)] * 3), st.booleans())
def test_any_orthogonal_affine(tmp_path_factory, turn, sizes, origin, sform):
    affine = nib.affines.from_matvec(turn * sizes, origin)
    path = tmp_path_factory.getbasetemp() / "any.nii"
    same_as_nibabel(save(path, values("u1", (2, 3, 2)), affine, sform=int(sform), qform=int(not sform)))
    # a float32 quaternion resolves half turns only to 1.2e-3 radians
    rough = 3e-3 * max(sizes) + 1e-4
    np.testing.assert_allclose(read_volume(path).affine, affine, rtol=0, atol=1e-4 if sform else rough)
    np.testing.assert_array_equal(check_affine(affine), affine)
    write_volume(path, values("u1", (2, 3, 2)), affine)
    np.testing.assert_allclose(read_volume(path).affine, affine, rtol=0, atol=1e-4)
    np.testing.assert_allclose(nib.load(path).get_qform(), affine, rtol=0, atol=rough)


@pytest.mark.medium
@pytest.mark.skipif(tuple(map(int, nib.__version__.split(".")[:2])) < (5, 4), reason="nibabel matched axes otherwise")
@settings(max_examples=200)
@given(rotations, st.permutations(range(3)), st.tuples(*[st.sampled_from([-1, 1])] * 3), st.floats(0, 1))
def test_orientation_is_nibabels(turn, order, signs, weight):
    u, _, v = np.linalg.svd(weight * turn + (1 - weight) * (np.eye(3)[:, list(order)] * signs))
    affine = nib.affines.from_matvec((u @ v) * (0.7, 1.1, 2.3))
    assert Volume(np.zeros(SHAPE), affine).orientation == "".join(nib.aff2axcodes(affine))


@pytest.mark.medium
@pytest.mark.parametrize("ending", [".nrrd", ".mha", ".nhdr", ".mhd"])
@pytest.mark.parametrize("compressed", [False, True])
def test_itk_formats_against_itk_points(tmp_path, ending, compressed):
    path, image = tmp_path / f"v{ending}", itk_image(values())
    itk.imwrite(image, str(path), compression=compressed)
    agrees_with_itk(read_volume(path), image)


@pytest.mark.medium
def test_a_known_lps_header(tmp_path):
    path, data = tmp_path / "v.nrrd", np.arange(24, dtype="<i2").tobytes()
    head, end = "NRRD0004\ntype: short\ndimension: 3\nsizes: 2 3 4\n{}\n", "endian: little\nencoding: raw\n\n"
    place = "space: {}\nspace directions: (0,2,0) (0,0,3) (4,0,0)\nspace origin: (10,20,30)"
    ras = np.array([[0, 0, 4, 10], [2, 0, 0, 20], [0, 3, 0, 30], [0, 0, 0, 1.0]])
    for space, flip in [("left-posterior-superior", -1), ("right-anterior-superior", 1)]:
        path.write_bytes((head.format(place.format(space)) + end).encode() + data)
        volume = read_volume(path)
        np.testing.assert_allclose(volume.affine, np.diag([flip, flip, 1, 1]) @ ras)
        assert volume.data[1, 2, 3] == 1 + 2 * 2 + 3 * 6
    assert volume.orientation == "ASR"
    path.write_bytes((head.format("spacings: 1 nan 2") + end).encode() + data)
    refuses(path, "has the spacings 1 nan 2", read_volume)


@pytest.mark.medium
@pytest.mark.parametrize("name", ["v.mha", "v.nrrd"])
def test_itk_formats_refuse_shear_and_convert_units(tmp_path, name):
    path, unit = tmp_path / name, b'space units: "um" "um" "um"\nendian'
    old, new = (b"DimSize", b"DistanceUnits = um\nDimSize") if name == "v.mha" else (b"endian", unit)
    itk.imwrite(itk_image(values(), np.array([[1, 0.5, 0], [0, 1, 0], [0, 0, 1.0]])), str(path))
    refuses(path, r"sheared.*0\.447.*Resample", read_volume)
    itk.imwrite(itk_image(values()), str(path))
    affine = read_volume(path).affine
    path.write_bytes(path.read_bytes().replace(old, new))
    np.testing.assert_allclose(read_volume(path).affine, np.diag([1e-3, 1e-3, 1e-3, 1]) @ affine)


@pytest.mark.medium
def test_a_type_that_itk_does_not_wrap(tmp_path):
    path = tmp_path / "v.mha"
    itk.imwrite(itk_image(values()), str(path))
    path.write_bytes(path.read_bytes().replace(b"MET_SHORT", b"MET_LONG_LONG"))
    refuses(path, "not wrapped.*Convert.*int32", read_volume)


@pytest.mark.parametrize("ending", [".mgh", ".mgz"])
@pytest.mark.parametrize("dtype", ["u1", "i2", "i4", "f4"])
def test_mgh(tmp_path, ending, dtype):
    nib.save(nib.MGHImage(values(dtype), oblique().astype("f4")), tmp_path / f"v{ending}")
    same_as_nibabel(tmp_path / f"v{ending}")


@pytest.mark.slow
@pytest.mark.parametrize("ending", [*NIFTI, ".mgh", ".mgz", ".nrrd", ".mha", ".npy", ".npz"])
def test_truncated_files(tmp_path, ending):
    path = tmp_path / f"v{ending}"
    write_volume(path, values("i2", (20, 20, 20)), np.eye(4) if ending == ".npy" else oblique())
    whole = path.read_bytes()
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
    whole = path.read_bytes()
    patch(path, {len(whole) // 2: bytes([whole[len(whole) // 2] ^ 4])})
    refuses(path, "", read_volume)


@pytest.mark.parametrize("ending", sorted(READERS))
def test_files_of_another_format(tmp_path, ending):
    (tmp_path / f"v{ending}").write_text("this is a text file\n" * 50)
    refused(f"v{ending}: ", read_volume, tmp_path / f"v{ending}")


def test_gz_and_nii_exchanged(tmp_path):
    plain = save(tmp_path / "v.nii", values()).read_bytes()
    for name, content in {"v.nii": gzip.compress(plain), "w.nii.gz": plain}.items():
        (tmp_path / name).write_bytes(content)
        refuses(tmp_path / name, "", read_volume)
