"""Layers of microscopy stacks at distances from a surface: values, files, and directions that do not cross."""

import logging

import nibabel as nib
import numpy as np
import pytest
import tifffile
from command_line import run, succeed
from mesh_files import icosphere
from refusals import refused

import voxflat
from voxflat.io import chunks
from voxflat.maps import sources
from voxflat.maps.depth import uncrossed

RADIUS, SIZES, SHAPE = 12.0, (0.5, 0.5, 1.0), (70, 72, 36)  # µm; x, y, z
CENTRE = np.array([17.0, 18.0, 17.5])
DEPTHS = (-2.0, -1.0, 0.0, 1.0, 2.0)
NAMES = ("membrane", "nuclei")
FILES = ("stack.ome.tif", "packed.ome.tif", "imagej.tif", "stack.zarr")


def values(radius):
    """Return the intensities of both channels at a distance from the centre."""
    return np.stack([1000 + 200 * radius, 6000 - 150 * radius])


@pytest.fixture(scope="module")
def stacks(tmp_path_factory):
    """The same stack in several formats, and a folder."""
    folder = tmp_path_factory.mktemp("stacks")
    x, y, z = (np.arange(n) * size - at for n, size, at in zip(SHAPE, SIZES, CENTRE, strict=True))
    radius = np.sqrt(z[:, None, None] ** 2 + y[:, None] ** 2 + x**2)
    data = np.round(values(radius)).astype(np.uint16)  # C, Z, Y, X
    place = {f"PhysicalSize{axis}": size for axis, size in zip("XYZ", SIZES, strict=True)}
    place |= {f"PhysicalSize{axis}Unit": "µm" for axis in "XYZ"}
    told = {"axes": "CZYX", **place, "Channel": {"Name": list(NAMES)}}
    tifffile.imwrite(folder / "stack.ome.tif", data, metadata=told)
    tifffile.imwrite(folder / "packed.ome.tif", data, metadata=told, compression="zlib", tile=(32, 32))
    of_imagej = {"axes": "ZCYX", "spacing": SIZES[2], "unit": "um"}
    across = tuple(1 / size for size in SIZES[:2])
    tifffile.imwrite(folder / "imagej.tif", data.swapaxes(0, 1), imagej=True, metadata=of_imagej, resolution=across)
    zarr = pytest.importorskip("zarr", minversion="3")
    group = zarr.open_group(folder / "stack.zarr", mode="w", zarr_format=2)
    group.create_array("0", shape=data.shape, dtype=data.dtype, chunks=(1, 16, 16, 16))[:] = data
    axes = [{"name": "c", "type": "channel"}]
    axes += [{"name": axis, "type": "space", "unit": "micrometer"} for axis in "zyx"]
    scale = [{"type": "scale", "scale": [1.0, *SIZES[::-1]]}]
    datasets = [{"path": "0", "coordinateTransformations": scale}]
    group.attrs["multiscales"] = [{"version": "0.4", "axes": axes, "datasets": datasets}]
    return folder


@pytest.fixture(scope="module")
def flat():
    """A map of the sphere in µm."""
    points, faces = icosphere(RADIUS)
    surface = voxflat.surface((points + CENTRE, faces), unit="µm")
    return surface.disk(0, 9.0).flatten()


def spread(image):
    """Return the values of an image on the map."""
    return image[np.isfinite(image)]


@pytest.mark.medium
@pytest.mark.parametrize("name", FILES)
def test_layers_of_a_sphere_have_the_values_of_their_radius(stacks, flat, name):
    layers = flat.images(stacks / name, 0.5, depth=DEPTHS).data
    assert layers.shape == (2, len(DEPTHS), *flat.raster(0.5).shape)
    for n, depth in enumerate(DEPTHS):
        for of, expected, slope in zip(layers[:, n], values(RADIUS + depth), (200, 150), strict=True):
            assert len(spread(of)) == flat.raster(0.5).inside.sum()
            assert np.abs(spread(of) - expected).max() < 0.06 * slope  # chords of triangles, curvature within a voxel


@pytest.mark.medium
@pytest.mark.parametrize("name", FILES)
def test_a_large_stack_is_sampled_in_parts_with_the_same_result(stacks, flat, name, monkeypatch):
    how = {"pixel_size": 0.5, "depth": DEPTHS}
    whole, largest = flat.images(stacks / name, **how).data, flat.images(stacks / name, projection="max", **how).data
    monkeypatch.setattr(chunks, "_WHOLE", 0)
    monkeypatch.setattr(sources, "_BATCH", 1000)
    channels, _, _ = chunks.chunked_of(stacks / name)
    assert isinstance(channels.read(1), chunks.Chunked)
    np.testing.assert_allclose(flat.images(stacks / name, **how).data, whole, rtol=1e-12)
    np.testing.assert_allclose(flat.images(stacks / name, projection="max", **how).data, largest, rtol=1e-12)
    read = voxflat.io.read_volume(stacks / name, 1)
    np.testing.assert_array_equal(read.data, tifffile.imread(stacks / "stack.ome.tif")[1].T)


@pytest.mark.medium
def test_projections_are_those_of_the_layers(stacks, flat):
    layers = flat.images(stacks / "stack.ome.tif", depth=DEPTHS).data
    for name in ("mean", "max", "sum"):
        shown = flat.images(stacks / "stack.ome.tif", depth=DEPTHS, projection=name)
        assert shown.names == NAMES
        np.testing.assert_allclose(shown.data, getattr(layers, name)(axis=1), rtol=1e-12)
        one = flat.image(stacks / "stack.ome.tif", depth=DEPTHS, projection=name, channel="nuclei")
        np.testing.assert_allclose(one.data, shown[1].data, rtol=1e-12)


def test_projections_that_do_not_exist(stacks, flat):
    path, depth = stacks / "stack.ome.tif", {"depth": DEPTHS}
    refused("projection is 'min'. Pass 'mean', 'max' or 'sum'", flat.images, path, projection="min", **depth)
    refused(
        "labels have only a mean", flat.images(path, projection="sum", interpolation="majority", **depth).save, "a.tif"
    )
    refused("phases have only a mean", flat.images, path, projection="max", period=360, **depth)
    refused(
        "may be labels, which have no max",
        flat.image,
        path,
        0.5,
        channel=0,
        projection="max",
        interpolation="nearest",
        **depth,
    )


def test_integers_in_stacks_are_labels_only_if_they_form_areas(stacks, flat, tmp_path, caplog):
    cells = np.random.default_rng(0).permutation(36 * 9 * 9).reshape(36, 9, 9) + 1
    masks = cells.repeat(8, axis=1).repeat(8, axis=2)[:, : SHAPE[1], : SHAPE[0]].astype(np.uint16)
    told = {"axes": "ZYX", **{f"PhysicalSize{axis}": size for axis, size in zip("XYZ", SIZES, strict=True)}}
    noise = np.random.default_rng(0).poisson(40, masks.shape).astype(np.uint8)
    where = np.diag([*SIZES, 1.0])
    for name, data in (("masks", masks), ("mask", (masks < 1500).astype(np.uint8)), ("noise", noise)):
        tifffile.imwrite(tmp_path / f"{name}.ome.tif", data, metadata=told)
        nib.save(nib.Nifti1Image(data.T, np.diag([1e-3] * 3 + [1]) @ where), tmp_path / f"{name}.nii")
        caplog.clear()
        shown = flat.image(tmp_path / f"{name}.ome.tif").data
        expected = "linear" if name == "noise" else "nearest"
        np.testing.assert_allclose(shown, flat.image(tmp_path / f"{name}.ome.tif", interpolation=expected).data)
        assert ("so they are sampled as labels" in caplog.text) == (name != "noise")
        nearest = flat.image(tmp_path / f"{name}.nii", interpolation="nearest").data
        np.testing.assert_array_equal(flat.image(tmp_path / f"{name}.nii").data, nearest)  # other formats: no guess


def test_files_have_channels_depths_and_their_sizes(stacks, flat, tmp_path):
    layers = flat.images(stacks / "stack.ome.tif", 0.5, depth=DEPTHS)
    layers.save(tmp_path / "layers.ome.tif")
    with tifffile.TiffFile(tmp_path / "layers.ome.tif") as file:
        assert file.series[0].axes == "CZYX"
        np.testing.assert_array_equal(file.series[0].asarray(), layers.data.astype(np.float32))
        pixels = tifffile.xml2dict(file.ome_metadata)["OME"]["Image"]["Pixels"]
    assert [pixels[f"PhysicalSize{axis}"] for axis in "XYZ"] == [0.5, 0.5, 1.0]
    assert {pixels[f"PhysicalSize{axis}Unit"] for axis in "XYZ"} == {"µm"}
    assert [channel["Name"] for channel in pixels["Channel"]] == list(NAMES)
    again = voxflat.io.read_volume(tmp_path / "layers.ome.tif", "nuclei")
    assert (again.unit, again.spacing.tolist()) == ("µm", [0.5, 0.5, 1.0])
    np.testing.assert_array_equal(again.data.T, layers.data[1].astype(np.float32))
    layers.save(tmp_path / "layers.zarr")
    zarr = pytest.importorskip("zarr", minversion="3")
    group = zarr.open_group(tmp_path / "layers.zarr", mode="r")
    (scales,) = group.attrs["multiscales"]
    assert [axis["name"] for axis in scales["axes"]] == ["c", "z", "y", "x"]
    assert [axis.get("unit") for axis in scales["axes"]] == [None, *["micrometer"] * 3]
    scale, shift = (step[step["type"]] for step in scales["datasets"][0]["coordinateTransformations"])
    assert (scale, shift[:2]) == ([1.0, 1.0, 0.5, 0.5], [0.0, -2.0])
    assert [channel["label"] for channel in group.attrs["omero"]["channels"]] == list(NAMES)
    again = voxflat.io.read_volume(tmp_path / "layers.zarr", "nuclei")
    np.testing.assert_array_equal(again.data.T, layers.data[1].astype(np.float32))
    assert group["0"].chunks == (1, 1, *flat.raster(0.5).shape)
    np.testing.assert_array_equal(group["0"][:], layers.data.astype(np.float32))
    uneven = flat.images(stacks / "stack.ome.tif", depth=(0, 1, 4), channel=0)
    uneven.save(tmp_path / "uneven.ome.tif")
    with tifffile.TiffFile(tmp_path / "uneven.ome.tif") as file:
        assert "PhysicalSizeZ=" not in file.ome_metadata
        assert file.series[0].axes == "ZYX"
    assert uneven.names[2] == "membrane, 4 µm"


@pytest.mark.parametrize("text", ["-2:2:1", "-2,-1:2:1", "-2:0:1,1:2:1"])
def test_ranges_of_depths_have_both_ends(stacks, flat, tmp_path, text):
    flat.save(tmp_path / "map.npz")
    command = ["image", tmp_path / "map.npz", "--volume", stacks / "stack.ome.tif", "-o", tmp_path / "layers.ome.tif"]
    succeed(*command, "--depth", text)
    with tifffile.TiffFile(tmp_path / "layers.ome.tif") as file:
        assert file.series[0].shape[:2] == (2, 5)


@pytest.mark.parametrize("text", ["1:2", "2:1:1", "0:1:0", "0:1:nan", "0:inf:1", "a:b:c", "0:1e9:1", "1:2:3:4"])
def test_ranges_that_do_not_exist(stacks, flat, tmp_path, text):
    flat.save(tmp_path / "map.npz")
    command = ["image", tmp_path / "map.npz", "--volume", stacks / "stack.ome.tif", "-o", tmp_path / "layers.ome.tif"]
    done = run(*command, "--depth", text)
    assert done.exit_code == 2
    assert "Invalid value for '--depth'" in done.stderr


def test_a_stack_that_is_cut_off_after_it_was_opened(stacks, flat, tmp_path, monkeypatch):
    monkeypatch.setattr(chunks, "_WHOLE", 0)
    whole = (stacks / "imagej.tif").read_bytes()
    (tmp_path / "short.tif").write_bytes(whole)
    layers = flat.images(tmp_path / "short.tif", depth=DEPTHS)
    (tmp_path / "short.tif").write_bytes(whole[:5000])
    refused("short.tif: ends after .* pixels of page", layers.save, tmp_path / "layers.zarr")
    assert not (tmp_path / "layers.zarr").exists()


def bumpy(height):
    """Return a sphere with bumps."""
    points, faces = icosphere(100.0)
    directions = points / 100
    azimuth = np.arctan2(directions[:, 1], directions[:, 0])
    bumps = np.sin(8 * np.arccos(directions[:, 2].clip(-1, 1))) * np.sin(8 * azimuth)
    return directions * (100 + height * bumps)[:, None], np.asarray(faces, dtype=np.int64)


def normals_of(points, faces):
    """Return the normals of vertices, and those of triangles, whose length is twice the area."""
    a, b, c = points[faces].swapaxes(0, 1)
    of_faces = np.cross(b - a, c - a)
    sums = np.stack([np.bincount(faces.ravel(), of_faces[:, k].repeat(3), len(points)) for k in range(3)], axis=1)
    return sums / np.linalg.norm(sums, axis=1, keepdims=True), of_faces


@pytest.mark.parametrize(("height", "depth"), [(6, 10.0), (6, 20.0), (3, 30.0)])
def test_layers_above_and_below_bumps_do_not_cross(height, depth):
    points, faces = bumpy(height)
    normals, base = normals_of(points, faces)

    def turned(directions):
        steps = np.linspace(-depth, depth, 41)
        return np.mean(
            [(normals_of(points + at * directions, faces)[1] * base).sum(axis=1) <= 0 for at in steps], axis=1
        )

    assert turned(normals).max() > 0.004
    directions, share = uncrossed(points, normals, faces, -depth, depth)
    assert share == 0
    assert turned(directions).max() == 0
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1)


def test_triangles_that_shrink_to_a_point_cross():
    points = np.concatenate([np.eye(3), -np.eye(3)])  # an octahedron of radius 1, and its normals
    faces = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]])
    for depth, share in [(-1.0, 1.0), (-0.999, 0.0)]:
        assert uncrossed(points, points, faces, depth, 0.0)[1] == share


def test_normals_are_kept_where_layers_do_not_cross():
    points, faces = bumpy(0)
    normals, _ = normals_of(points, faces)
    directions, share = uncrossed(points, normals, faces, -90.0, 500.0)
    assert share == 0
    np.testing.assert_array_equal(directions, normals)


def test_layers_that_must_cross_are_reported_once(flat, stacks, caplog):
    with caplog.at_level(logging.WARNING):
        flat.images(stacks / "stack.ome.tif", depth=(-20.0, 1.0))
        flat.images(stacks / "stack.ome.tif", depth=(-20.0, 1.0))
    told = [record.getMessage() for record in caplog.records if "cross" in record.getMessage()]
    assert len(told) == 1
    assert told[0].startswith("layers at depths of -20 µm to 1 µm cross at ")
