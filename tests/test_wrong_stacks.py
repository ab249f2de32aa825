"""Wrong input from microscopes ends in one line: other units, missing sizes and channels, damage, touching organs."""

import logging

import h5py
import nibabel as nib
import numcodecs
import numpy as np
import pytest
import tifffile
import zarr
from command_line import fail, succeed
from mesh_files import grid, icosphere
from refusals import refused

import voxflat
from voxflat.io import Mesh, write_mesh
from voxflat.methods import Voxflat

SHAPE, SIZE, RADIUS = (50, 30, 30), 0.5, 4.6  # voxels; µm
CENTRES = np.array([[7.5, 7.5, 7.5], [16.25, 7.5, 7.5]])  # µm, of two balls that touch


def balls():
    """Return a mask of each ball; the second one ends where the first begins."""
    places = np.moveaxis(np.indices(SHAPE), 0, -1) * SIZE
    first, second = (np.linalg.norm(places - centre, axis=-1) < RADIUS for centre in CENTRES)
    return first, second & ~first


def imagej(path, data, unit="um"):
    how = {"metadata": {"spacing": SIZE, "unit": unit, "axes": "ZYX"}, "resolution": (1 / SIZE, 1 / SIZE)}
    tifffile.imwrite(path, np.asarray(data, np.uint8).T, imagej=True, **how)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Write volumes of a ball in several units, and maps of it from a volume and from a mesh."""
    folder = tmp_path_factory.mktemp("stacks")
    ball, other = balls()
    imagej(folder / "ball.tif", ball)
    imagej(folder / "fused.tif", ball | other)
    imagej(folder / "labels.tif", ball + 2 * other)
    imagej(folder / "apart.tif", ball | np.roll(other, 2, axis=0))
    imagej(folder / "empty.tif", 0 * ball)
    tifffile.imwrite(folder / "plain.tif", ball.astype(np.uint8).T)
    tifffile.imwrite(folder / "cropped.tif", ball[:, :, 3:].astype(np.uint8).T)
    nib.save(nib.Nifti1Image(ball.astype(np.uint8), np.diag([SIZE, SIZE, SIZE, 1])), folder / "mm.nii")
    points, faces = icosphere(RADIUS, 3)
    write_mesh(folder / "ball.ply", Mesh(points + CENTRES[0], faces))
    method = Voxflat(sources=30)
    voxflat.surface(folder / "ball.tif").flatten(method).save(folder / "um.npz")
    voxflat.surface(folder / "mm.nii").flatten(method).save(folder / "mm.npz")
    voxflat.surface(folder / "ball.ply", unit="µm").flatten(method).save(folder / "mesh.npz")
    return folder


@pytest.mark.parametrize(
    ("flat_map", "volume", "told"),
    [
        (
            "um.npz",
            "mm.nii",
            "has voxels that are larger than the map. Compare their positions and units; the map is in µ",
        ),
        ("mesh.npz", "mm.nii", "has voxels that are larger than the map."),
        (
            "mm.npz",
            "ball.tif",
            "does not overlap the map, so the image would be empty. Compare their positions and units",
        ),
        (
            "mesh.npz",
            "plain.tif",
            "the volume does not define the size and position of its voxels, nor does the map of",
        ),
        (
            "um.npz",
            "cropped.tif",
            "has shape (50, 30, 27) and no affine, but the flattened volume has shape (50, 30, 30)",
        ),
    ],
)
def test_volumes_in_other_units_or_without_a_size(files, tmp_path, flat_map, volume, told):
    fail(1, told, "image", files / flat_map, "--volume", files / volume, "-o", tmp_path / "image.tif")
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(voxflat.errors.InputError):
        voxflat.load(files / flat_map).image(files / volume)


def test_the_same_volume_in_the_same_unit_is_sampled(files):
    for flat_map, volume in (
        ("um.npz", "ball.tif"),
        ("um.npz", "plain.tif"),
        ("mm.npz", "mm.nii"),
        ("mesh.npz", "ball.tif"),
    ):
        shown = voxflat.load(files / flat_map).image(files / volume, interpolation="linear").data
        assert np.nanmean(np.abs(shown - 0.5)) < 0.3


def test_a_stack_without_a_size_is_reported(files, tmp_path):
    result = succeed("surface", files / "plain.tif", "-o", tmp_path / "ball.ply")
    assert (
        "plain.tif does not define the size of its voxels, which is assumed to be 1 mm. Pass --spacing" in result.stderr
    )
    fail(1, "defines its voxel size in µm. Omit --unit", "check", files / "ball.tif", "--unit", "mm")


def test_channels_that_a_stack_does_not_have(files, tmp_path):
    words = ("image", files / "um.npz", "-o", tmp_path / "image.tif", "--volume")
    fail(
        1, "has only one channel, but channel is 'dna'. Omit --channel", *words, files / "ball.tif", "--channel", "dna"
    )
    two = np.stack([np.asarray(balls()[0], np.uint8).T] * 2)
    told = {"axes": "CZYX", "Channel": {"Name": ["wall", "nuclei"]}}
    tifffile.imwrite(tmp_path / "two.ome.tif", two, metadata=told)
    fail(1, "has no channel 'dna'. Choose one of wall, nuclei", *words, tmp_path / "two.ome.tif", "--channel", "dna")
    fail(
        1,
        "has no channel 2. Pass a number from 0 to 1 (wall, nuclei)",
        *words,
        tmp_path / "two.ome.tif",
        "--channel",
        2,
    )
    fail(
        1, "has 2 channels or time points (wall, nuclei). Choose one with --channel", "check", tmp_path / "two.ome.tif"
    )


def cut_off(path, share):
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])


@pytest.mark.parametrize("share", [0.2, 0.6, 0.95])
@pytest.mark.parametrize(
    "how",
    [
        {"imagej": True},
        {"ome": True},
        {"ome": True, "compression": "zlib"},
        {"photometric": "minisblack", "compression": "zlib"},
        {"photometric": "minisblack"},
    ],
)
def test_tiff_files_that_are_cut_off(tmp_path, caplog, how, share):
    """tifffile would read the first page of most of them."""
    data = np.random.default_rng(0).integers(1, 200, (20, 40, 50)).astype(np.uint8)
    tifffile.imwrite(path := tmp_path / "stack.tif", data, metadata={"axes": "ZYX"}, **how)
    np.testing.assert_array_equal(voxflat.io.read_volume(path).data, data.T)
    with caplog.at_level(logging.WARNING):
        cut_off(path, share)
        if share > 0.9 and "imagej" in how:  # all pixels are there
            np.testing.assert_array_equal(voxflat.io.read_volume(path).data, data.T)
        else:
            refused(f"^{path}: (?!.*stack.tif)", voxflat.io.read_volume, path)
            assert not [record for record in caplog.records if record.name.startswith("voxflat")]


def test_damaged_stacks_of_other_formats(files, tmp_path):
    data = np.random.default_rng(0).integers(1, 200, SHAPE[::-1]).astype(np.uint8)
    with h5py.File(tmp_path / "stack.h5", "w") as file:
        file.create_dataset("exported_data", data=data, chunks=(10, 10, 10), compression="gzip")
    group = zarr.open_group(str(tmp_path / "stack.zarr"), mode="w", zarr_format=2)
    how = {"chunks": (30, 30, 50), "dtype": np.uint8, "compressors": numcodecs.Zlib()}
    group.create_array("0", shape=data.shape, **how)[:] = data
    axes = [{"name": axis, "type": "space", "unit": "micrometer"} for axis in "zyx"]
    steps = [{"type": "scale", "scale": [SIZE] * 3}]
    group.attrs["multiscales"] = [{"axes": axes, "datasets": [{"path": "0", "coordinateTransformations": steps}]}]
    words = ("image", files / "um.npz", "-o", tmp_path / "image.tif", "--volume")
    for name, damaged in (("stack.h5", "stack.h5"), ("stack.zarr", "stack.zarr/0/0.0.0")):
        succeed(*words, tmp_path / name, "--overwrite")
        cut_off(tmp_path / damaged, 0.5)
        assert fail(1, f"{name}: ", *words, tmp_path / name, "--overwrite").stderr.count("\n") == 1


def test_an_empty_stack(files):
    fail(1, "the volume is empty: every voxel is 0", "flatten", files / "empty.tif", "-o", "never.npz")
    fail(
        1,
        "no voxel is above the threshold 0.5; the largest value is 0",
        "surface",
        files / "empty.tif",
        "--threshold",
        0.5,
        "-o",
        "never.ply",
    )


def test_organs_that_touch(files):
    """Fused organs are one surface; with one label each, both have clean closed surfaces where they should be."""
    fused = voxflat.surface(files / "fused.tif")
    assert fused.check().components == (len(fused),)
    for label, centre in zip((1, 2), CENTRES, strict=True):
        surface = voxflat.surface(files / "labels.tif", label=label)
        topology = surface.core.topology()
        assert (len(topology["components"]), topology["handles"], topology["loops"]) == (1, 0, [])
        away = np.linalg.norm(surface.points - centre, axis=1) - RADIUS
        beyond = np.abs(surface.points[:, 0] - CENTRES[:, 0].mean()) > 1  # µm from the contact
        assert np.sqrt(np.mean(away[beyond] ** 2)) < 0.3 * SIZE
        assert np.abs(away[beyond]).max() < SIZE
    fail(
        1, "pass a label or a threshold; the volume has labels 1, 2", "surface", files / "labels.tif", "-o", "never.ply"
    )


def test_two_organs_in_one_mask(files):
    told = succeed("check", files / "apart.tif").stdout
    assert "the surface has 2 components; only the largest is used" in told
    assert "To use another one, select its label or keep a part" in told


def test_surfaces_that_are_not_closed_have_no_charts():
    refused("charts require a closed surface, or a tube with two ends, but this", voxflat.surface(grid(12)).charts, 2)
    x, y, z = np.indices((24, 24, 10)) - np.array([12, 12, 5])[:, None, None, None]
    torus = (np.hypot(np.hypot(x, y) - 8, z) < 3).astype(np.uint8)
    refused(r"the surface has 1 handle\(s\), but charts require", voxflat.surface(torus, repair="none").charts, 2)
