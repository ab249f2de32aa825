"""NRRD, MetaImage and MGH."""

import numpy as np
import pytest
from volume_files import agrees_with_itk, itk_image, oblique, same_as_nibabel, values

from voxflat.errors import InputError
from voxflat.io.volumes import read_volume

itk = pytest.importorskip("itk")
nib = pytest.importorskip("nibabel")


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


def test_itk_formats_refuse_shear_and_unknown_types_and_convert_units(tmp_path):
    shear = np.array([[1, 0.5, 0], [0, 1, 0], [0, 0, 1.0]])
    for ending in (".nrrd", ".mha"):
        itk.imwrite(itk_image(values(), shear), str(tmp_path / f"s{ending}"))
        with pytest.raises(InputError, match=r"sheared.*0\.447.*resample"):
            read_volume(tmp_path / f"s{ending}")
    itk.imwrite(itk_image(values()), str(tmp_path / "v.mha"))
    itk.imwrite(itk_image(values()), str(tmp_path / "v.nrrd"))
    affine = read_volume(tmp_path / "v.mha").affine
    content = (tmp_path / "v.mha").read_bytes()
    (tmp_path / "v.mha").write_bytes(content.replace(b"DimSize", b"DistanceUnits = um\nDimSize"))
    content = (tmp_path / "v.nrrd").read_bytes()
    (tmp_path / "v.nrrd").write_bytes(content.replace(b"endian", b'space units: "um" "um" "um"\nendian'))
    in_mm = np.diag([1e-3, 1e-3, 1e-3, 1]) @ affine
    for name in ("v.mha", "v.nrrd"):
        np.testing.assert_allclose(read_volume(tmp_path / name).affine, in_mm)
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
