"""Segmentations as ilastik and cellpose write them, made with h5py and tifffile."""

import json
import sys
from importlib import util

import h5py
import numpy as np
import pytest
import tifffile
from command_line import fail, succeed
from PIL import Image
from refusals import refused

import voxflat
from voxflat.errors import InputError
from voxflat.io import read_volume

SPACING = (0.5, 0.5, 1.0)  # µm along x, y, z
CENTRE, RADIUS = np.array([10.0, 8.0, 12.0]), 6.5  # µm
SHAPE = (25, 33, 41)  # z, y, x


def distances():
    """Return the distance of each voxel from the centre of the ball, in µm, with the axes z, y, x."""
    z, y, x = (index * size for index, size in zip(np.indices(SHAPE), SPACING[::-1], strict=True))
    return np.sqrt((x - CENTRE[0]) ** 2 + (y - CENTRE[1]) ** 2 + (z - CENTRE[2]) ** 2)


INSIDE = 1 / (1 + np.exp((distances() - RADIUS) / 0.7))  # probability
BOTH = np.stack([INSIDE, 1 - INSIDE]).astype(np.float32)


def exported(path, axes, data=BOTH, *, tags=True, name="exported_data", **storage):
    """Write an array with the axes c, z, y, x in another order, as ilastik exports it."""
    data = data.reshape(*(1,) * (len(axes) - data.ndim), *data.shape)
    own = "tczyx"[-data.ndim :]
    with h5py.File(path, "w") as file:
        made = file.create_dataset(name, data=data.transpose([own.index(axis) for axis in axes]), **storage)
        if tags:
            each = [{"key": axis, "typeFlags": 1 if axis == "c" else 2, "resolution": 0} for axis in axes]
            made.attrs["axistags"] = json.dumps({"axes": each})
            made.attrs["drange"] = (0.0, 1.0)
    return path


@pytest.mark.parametrize("axes", ["czyx", "zyxc", "tzyxc", "xyzc"])
@pytest.mark.parametrize("storage", [{}, {"chunks": True, "compression": "gzip"}])
def test_axes_of_ilastik(tmp_path, axes, storage):
    path = exported(tmp_path / "p.h5", axes, **storage)
    for n in range(2):
        volume = read_volume(path, n)
        np.testing.assert_array_equal(volume.data, BOTH[n].T)
        assert not volume.is_placed
    np.testing.assert_array_equal(read_volume(path, "c1").data, BOTH[1].T)
    refused("p.h5: has 2 channels or time points .c0, c1.. Choose one, as in", voxflat.surface, path)
    refused(r"has no channel 2. Pass a number from 0 to 1 \(c0, c1\)", read_volume, path, 2)
    refused("has no channel 'dna'. Choose one of c0, c1", read_volume, path, "dna")


def test_chunks_that_are_missing_are_reported(tmp_path, caplog):
    path = exported(tmp_path / "p.h5", "zyx", BOTH[0], chunks=(5, 11, 41), compression="gzip")
    read_volume(path)
    assert not caplog.records
    with h5py.File(path, "w") as file:
        made = file.create_dataset("exported_data", SHAPE, np.float32, chunks=(5, 11, 41))
        made.attrs["axistags"] = json.dumps({"axes": [{"key": axis} for axis in "zyx"]})
        made[:5] = 1
    assert read_volume(path).data.sum() == 5 * SHAPE[1] * SHAPE[2]
    assert f"{path}: 12 of 15 chunks (80 %) are not stored" in caplog.text
    with h5py.File(path, "a") as file:
        file.create_dataset("none", (9, 9, 9), np.float32, chunks=(9, 9, 9))
        del file["exported_data"]
    refused("contains none of its 1 chunks", read_volume, path)


@pytest.mark.medium
def test_a_probability_map_becomes_a_smooth_surface_in_its_unit(tmp_path, caplog):
    path = exported(tmp_path / "p.hdf5", "zyx", BOTH[0])
    surface = voxflat.surface(path, threshold=0.5, spacing=SPACING, unit="µm")
    assert surface.metadata["unit"] == "µm"
    assert caplog.text == ""
    away = np.linalg.norm(surface.points - CENTRE, axis=1) - RADIUS
    assert np.sqrt(np.mean(away**2)) < 0.03  # voxels of 0.5 and 1 µm
    assert len(voxflat.surface(path, threshold=0.5)) == len(surface)
    assert "p.hdf5 does not define the size of its voxels, which is assumed to be 1 mm. Pass" in caplog.text
    flat_map = surface.flatten()
    shown = flat_map.image(path, interpolation="linear").data
    np.testing.assert_allclose(shown[np.isfinite(shown)], 0.5, atol=0.03)


@pytest.mark.medium
def test_whole_numbers_are_probabilities_up_to_255(tmp_path, caplog):
    path = exported(tmp_path / "p.h5", "zyxc", (BOTH * 255).astype(np.uint8), tags=True)
    words = ("--channel", "0", "--spacing", "0.5,0.5,1", "--unit", "µm")
    told = succeed("check", path, "--threshold", "127", *words).stdout
    assert "closed sphere" in told
    assert "touches the border" not in told
    assert "For probabilities, pass 127.5" not in caplog.text
    voxflat.surface(read_volume(path, 0), threshold=0.5)
    assert "so threshold=0.5 selects all voxels except zeros. For probabilities, pass 127.5" in caplog.text


def written(path, **datasets):
    """Write datasets without axistags."""
    with h5py.File(path, "w") as file:
        for name, data in datasets.items():
            file[name] = data


def test_the_only_dataset_or_that_of_ilastik(tmp_path):
    path = tmp_path / "p.h5"
    written(path, volume=BOTH[0], notes=np.arange(3))
    np.testing.assert_array_equal(read_volume(path).data, BOTH[0].T)
    written(path, raw=BOTH[1], exported_data=BOTH[0])
    np.testing.assert_array_equal(read_volume(path).data, BOTH[0].T)
    written(path, a=BOTH[1], b=BOTH[0])
    refused(r"p.h5: contains several datasets \(a, b\), none of which is named exported_data", read_volume, path)
    fail(1, "p.h5: contains several datasets (a, b)", "check", path)


def with_tags(path, tags):
    with h5py.File(path, "r+") as file:
        file["exported_data"].attrs["axistags"] = tags


@pytest.mark.parametrize(
    ("data", "tags", "told"),
    [
        (np.arange(5), None, "contains no dataset of numbers with at least three axes"),
        (BOTH[None], None, r"without axistags \(1 x 2 x 25 x 33 x 41\). Export it from ilastik"),
        (BOTH[0], "{]", "its axistags are damaged"),
        (BOTH[0], '{"axes": 3}', "its axistags are damaged"),
        (BOTH[0], json.dumps({"axes": [{"key": axis} for axis in "zyxc"]}), "and the axes z, y, x, c. Export a vol"),
        (BOTH[0], json.dumps({"axes": [{"key": axis} for axis in "yxc"]}), "and the axes y, x, c. Export a volume"),
        (BOTH[0], json.dumps({"axes": [{"key": axis} for axis in "zyy"]}), "and the axes z, y, y. Export a volume"),
        (np.zeros((0, 4, 4)), None, r"is empty \(shape \(0, 4, 4\)"),
    ],
)
def test_files_without_a_stack(tmp_path, data, tags, told):
    path = tmp_path / "p.h5"
    written(path, exported_data=data)
    if tags:
        with_tags(path, tags)
    refused(f"^{path}: .*{told}", voxflat.surface, path, threshold=0.5)


def test_values_in_other_files_are_refused(tmp_path):
    path = tmp_path / "p.h5"
    written(tmp_path / "other.h5", data=BOTH[0])
    layout = h5py.VirtualLayout(BOTH[0].shape, "f4")
    layout[:] = h5py.VirtualSource(tmp_path / "other.h5", "data", BOTH[0].shape)
    with h5py.File(path, "w") as file:
        file.create_virtual_dataset("exported_data", layout)
    refused("stores the values of exported_data in other files", read_volume, path)


def test_damaged_files_end_in_one_line(tmp_path):
    path = exported(tmp_path / "p.h5", "zyxc", chunks=True, compression="gzip")
    whole = path.read_bytes()
    for length in (0, 10, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:length])
        refused(f"^{path}: (?!.*p.h5)", read_volume, path, 0)
    (tmp_path / "text.h5").write_text("not HDF5")
    refused("text.h5: .*file signature not found", read_volume, tmp_path / "text.h5")
    rng = np.random.default_rng(0)
    for _ in range(20):
        damaged = bytearray(whole)
        for at in rng.integers(0, len(whole), 30):
            damaged[at] = rng.integers(256)
        path.write_bytes(damaged)
        try:
            read_volume(path, 0)
        except InputError as error:
            assert "\n" not in str(error)  # noqa: PT017
            assert str(error).startswith(f"{path}: ")  # noqa: PT017


def test_a_missing_package_is_named(tmp_path, monkeypatch):
    path = exported(tmp_path / "p.h5", "czyx")
    found = util.find_spec
    monkeypatch.setattr(util, "find_spec", lambda name, *more: None if name == "h5py" else found(name, *more))
    monkeypatch.setitem(sys.modules, "h5py", None)
    refused(r"p.h5: requires h5py. Install it with pip install 'voxflat\[lab\]'", read_volume, path)


@pytest.mark.medium
def test_masks_of_cellpose(tmp_path):
    """Volumes are read as labels, and images as regions; files that hold Python objects are not loaded."""
    masks = np.where(distances() < RADIUS, 7, 0).astype(np.uint16)
    tifffile.imwrite(tmp_path / "stack_cp_masks.tif", masks, compression="zlib")
    surface = voxflat.surface(tmp_path / "stack_cp_masks.tif", label=7, spacing=SPACING, unit="µm")
    flat_map = surface.flatten()
    cells = np.where(flat_map.heat_map().data < np.inf, 3, 0).astype(np.uint16)
    Image.fromarray(cells).save(tmp_path / "flat_cp_masks.png")
    tifffile.imwrite(tmp_path / "flat_cp_masks.tif", cells, compression="zlib")
    for name in ("flat_cp_masks.png", "flat_cp_masks.tif"):
        assert flat_map.regions(tmp_path / name).keys == (3,)
    np.save(tmp_path / "stack_seg.npy", {"masks": masks}, allow_pickle=True)
    told = "stack_seg.npy: contains Python objects, which could run programs.*Save .* the masks of cellpose as TIFF"
    for call in (voxflat.surface, flat_map.regions):
        refused(told, call, tmp_path / "stack_seg.npy")
