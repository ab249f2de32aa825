"""A series is saved and measured, and the images of its frames are files with the axes time, channel, depth, y, x."""

import json
import tracemalloc
from xml.etree import ElementTree

import numpy as np
import pytest
import tifffile
from refusals import refused, writes_nothing_half

import voxflat
from voxflat.errors import Cancelled, InputError

AFFINE = np.diag([1.0, 1.0, 1.0, 1.0])
AFFINE[:3, 3] = -20
PLACES = np.stack(np.meshgrid(*[np.arange(40.0) - 20] * 3, indexing="ij"))


def ellipsoid(scale, handle=False):
    """Return a volume whose level set at 0.5 is an ellipsoid."""
    x, y, z = PLACES / np.array([9, 7, 6]).reshape(3, 1, 1, 1) / scale
    inside = 1 - np.sqrt(x**2 + y**2 + z**2)
    if handle:
        inside = np.minimum(inside, np.hypot(x, y) - 0.4)
    return 1 / (1 + np.exp(-12 * inside))


def surface_of(volume):
    return voxflat.surface(volume, threshold=0.5, affine=AFFINE, unit="µm")


def stack(frame, *, shape=(40, 40, 40)):
    """Return a volume with the values x + 100 t."""
    values = PLACES[0][: shape[0], : shape[1], : shape[2]] + 100 * frame
    return voxflat.io.Volume(values, AFFINE, unit="µm")


@pytest.fixture(scope="module")
def series():
    return voxflat.flatten_series([surface_of(ellipsoid(scale)) for scale in (1.0, 1.1, 1.2)], reference=1)


@pytest.fixture(scope="module")
def sheets():
    hill = voxflat.samples.hill()
    return voxflat.flatten_series([hill, (1.1 * hill.points, hill.faces)])


@pytest.mark.medium
def test_a_saved_series_is_the_same(series, tmp_path):
    for name in ("movie.npz", "movie.voxflat"):
        series.save(tmp_path / name)
        found = voxflat.load_series(tmp_path / name)
        for field in ("points", "normals", "gaps", "folded"):
            assert getattr(found, field).tobytes() == getattr(series, field).tobytes()
            assert getattr(found, field).dtype == getattr(series, field).dtype
        assert found.reference == 1
        assert found.provenance == series.provenance
        assert found.flat_map.uv.tobytes() == series.flat_map.uv.tobytes()
        assert found.flat_map.description() == series.flat_map.description()
        assert found.flat_map.metadata["unit"] == "µm"
        assert np.array_equal(found[2].raster().corners, series.flat_map.raster().corners)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["movie.npz", "movie.voxflat"]


@pytest.mark.medium
def test_a_series_records_all_its_files(tmp_path):
    hill = voxflat.samples.hill()
    paths = [tmp_path / f"hill_{t:02}.ply" for t in range(34)]  # more than lists are recorded value by value
    for t, path in enumerate(paths):
        voxflat.io.write_mesh(path, voxflat.io.Mesh((1 + 0.01 * t) * hill.points, hill.faces))
    for given in ([voxflat.surface(path) for path in paths], paths[:2]):
        made = voxflat.flatten_series(given)
        made.save(tmp_path / "movie.npz", sidecar=True)
        text = (tmp_path / "movie.npz.json").read_text()
        assert json.loads(text) == voxflat.load_series(tmp_path / "movie.npz").provenance
        assert str(tmp_path) not in text
        assert all(f'"{path.name}"' in text for path in paths[: len(given)])
        assert set(json.loads(text)["parameters"]["surfaces"]) == {str(t) for t in range(len(given))}
    paths[1].rename(tmp_path / "hill.npz")
    (tmp_path / "hill_01.ply").symlink_to(tmp_path / "hill.npz")
    refused("it is an input", made.save, tmp_path / "hill.npz")


@pytest.mark.medium
def test_files_of_maps_and_series_are_told_apart(series, tmp_path):
    series.save(tmp_path / "movie.npz")
    series.flat_map.save(tmp_path / "map.npz")
    refused(
        "movie.npz holds maps of several frames. Use `voxflat image`, or read them with voxflat.load_series",
        voxflat.load,
        tmp_path / "movie.npz",
    )
    refused("map.npz holds a single map. Read it with voxflat.load", voxflat.load_series, tmp_path / "map.npz")
    refused("cannot save a series as movie.ply. Use a name that ends in .npz", series.save, tmp_path / "movie.ply")
    with pytest.raises(FileNotFoundError):
        voxflat.load_series(tmp_path / "none.npz")


@pytest.mark.medium
@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"series_points": None}, "is not a series of voxflat, or is damaged"),
        ({"series_points": np.zeros((2, 5, 3))}, "array series_points has shape"),
        ({"series_gaps": np.zeros(2)}, "array series_gaps has shape"),
        ({"series_folded": np.zeros(3)}, "array series_folded has an invalid type"),
        ({"metadata": ('"reference": 1, "prov', '"reference": 3, "prov')}, "its reference frame is 3, but it has 3"),
        ({"metadata": ('"reference": 1, "prov', '"reference": 0, "prov')}, "does not have the points of the map"),
        ({"metadata": ("series 1", "series 2")}, "was made by a newer version of voxflat"),
    ],
)
def test_damaged_files_are_refused(series, tmp_path, change, told):
    series.save(tmp_path / "movie.npz")
    with np.load(tmp_path / "movie.npz") as file:
        arrays = dict(file)
    for name, value in change.items():
        if value is None:
            del arrays[name]
        elif isinstance(value, tuple):
            assert value[0] in str(arrays[name])
            arrays[name] = np.array(str(arrays[name]).replace(*value))
        else:
            arrays[name] = value
    np.savez(tmp_path / "damaged.npz", **arrays)
    refused(told, voxflat.load_series, tmp_path / "damaged.npz")


@pytest.mark.medium
def test_the_distortion_of_any_frame_has_the_same_definition(series, sheets):
    for one in (series, sheets):
        found, known = one.measure(one.reference), one.flat_map.distortion
        assert found.figures() == known.figures()
        assert np.array_equal(found.per_point, known.per_point)
        assert np.array_equal(found.triangles.areal, known.triangles.areal)
        assert np.array_equal(found.triangles.is_flipped, known.triangles.is_flipped)
    first, grown = sheets.measure(0), sheets.measure(1)
    assert grown.best_scale.relative_error == pytest.approx(first.best_scale.relative_error, rel=1e-3)
    assert grown.mean_geodesic == pytest.approx(1.1 * first.mean_geodesic, rel=1e-3)
    assert grown.raw.relative_error > 0.08
    by_peer = voxflat.measure((sheets.points[1], sheets.flat_map.faces), sheets.flat_map.uv)
    assert grown.triangles.angle == pytest.approx(by_peer.triangles.angle, rel=1e-6)
    assert grown.raw.relative_error == pytest.approx(by_peer.raw.relative_error, rel=0.1)  # other sources, exact
    with pytest.raises(IndexError, match="numbered from 0 to 1"):
        sheets.measure(2)
    with pytest.raises(Cancelled):
        sheets.measure(1, progress=lambda *_: False)


def test_images_of_all_frames_are_those_of_each_frame(series, tmp_path):
    movie = series.images([stack(t) for t in range(3)], 0.5, depth=[-2.0, 0.0, 2.0], metric=True, time_step=30.0)
    assert repr(movie) == "<FlatMovie: 3 frames, 4 channels, 3 depths>"
    assert len(movie) == 3
    assert [len(of) for of in movie[1:]] == [12, 12]
    data = movie.data
    raster = series.flat_map.raster(0.5)
    assert data.shape == (3, 4, 3, *raster.shape)
    for t in range(3):
        own = series[t].images(stack(t), 0.5, depth=[-2.0, 0.0, 2.0]).data
        assert np.array_equal(data[t, 0], own, equal_nan=True)
        expected = 100 * t + raster.interpolate(series.points[t])[..., 0]
        assert data[t, 0, 1] == pytest.approx(expected, nan_ok=True)
        stretches = series.stretches(t)
        for depth in data[t, 1:].swapaxes(0, 1):
            assert np.array_equal(depth[0], raster.interpolate(stretches.prod(axis=1)), equal_nan=True)
            assert np.array_equal(depth[1], raster.interpolate(stretches[:, 0]), equal_nan=True)
            assert np.array_equal(depth[2], raster.interpolate(stretches[:, 1]), equal_nan=True)
        sides = np.diff(series.points[t][series.flat_map.faces], axis=1)
        area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum() / 2
        assert np.nansum(data[t, 1, 0]) * 0.5**2 == pytest.approx(area, rel=0.02)
    ratio = data[2, 1, 0] / data[0, 1, 0]
    assert np.nanpercentile(ratio, [5, 50, 95]) == pytest.approx([1.44] * 3, rel=0.15)


def test_files_have_all_axes_units_and_names(series, tmp_path):
    movie = series.images([stack(t) for t in range(3)], 0.5, depth=[-2.0, 0.0, 2.0], metric=True, time_step=30.0)
    data = movie.data.astype(np.float32)
    for name in ("movie.ome.tif", "movie.zarr", "movie.npy"):
        movie.save(tmp_path / name)
    with tifffile.TiffFile(tmp_path / "movie.ome.tif") as file:
        assert file.series[0].axes == "TCZYX"
        assert np.array_equal(file.series[0].asarray(), data, equal_nan=True)
        pixels = ElementTree.fromstring(file.ome_metadata).find(".//{*}Pixels")
        assert file.pages[1].aspage().tags["PageName"].value.startswith("frame 0, 0")
    told = pixels.attrib
    assert (told["PhysicalSizeX"], told["PhysicalSizeY"], told["PhysicalSizeZ"]) == ("0.5", "0.5", "2")
    assert told["PhysicalSizeXUnit"] == told["PhysicalSizeZUnit"] == "µm"
    assert (told["TimeIncrement"], told["TimeIncrementUnit"]) == ("30", "s")
    names = [channel.get("Name") for channel in pixels.findall("{*}Channel")]
    assert names == [None, "area factor", "largest stretch", "smallest stretch"]
    assert np.array_equal(np.load(tmp_path / "movie.npy"), data, equal_nan=True)
    zarr = pytest.importorskip("zarr")
    group = zarr.open_group(str(tmp_path / "movie.zarr"), mode="r")
    assert np.array_equal(group["0"][:], data, equal_nan=True)
    (scales,) = group.attrs["multiscales"]
    assert [(axis["name"], axis.get("unit")) for axis in scales["axes"]] == [
        ("t", "second"),
        ("c", None),
        *((axis, "micrometer") for axis in "zyx"),
    ]
    assert scales["datasets"][0]["coordinateTransformations"][0]["scale"] == [30.0, 1.0, 2.0, 0.5, 0.5]
    assert [channel["label"] for channel in group.attrs["omero"]["channels"]][1:] == names[1:]
    assert group["0"].chunks == (1, 1, 1, *data.shape[3:])
    refused("NIfTI cannot hold 4 channels", movie.save, tmp_path / "movie.nii")
    refused("movie.png can hold only one image", movie.save, tmp_path / "movie.png")


def test_axes_without_a_length_are_omitted_and_a_single_channel_fits_nifti(series, tmp_path):
    movie = series.images([stack(t) for t in range(3)])
    height, width = series.flat_map.raster().shape
    assert movie.data.shape == (3, height, width)
    movie.save(tmp_path / "movie.ome.tif")
    with tifffile.TiffFile(tmp_path / "movie.ome.tif") as file:
        assert file.series[0].axes == "TYX"
        assert "TimeIncrement" not in file.ome_metadata
    movie.save(tmp_path / "movie.nii.gz")
    nibabel = pytest.importorskip("nibabel")
    found = nibabel.load(tmp_path / "movie.nii.gz")
    assert found.shape == (height, width, 1, 3)
    assert np.array_equal(found.get_fdata()[:, :, 0].transpose(2, 0, 1), movie.data.astype(np.float32), equal_nan=True)
    assert series.images(metric=True).data.shape == (3, 3, height, width)


def test_a_movie_is_written_completely_or_not_at_all(series, tmp_path):
    (tmp_path / "out").mkdir()
    movie = series.images(metric=True)
    for name in ("movie.ome.tif", "movie.zarr", "movie.npy"):

        def save(path, progress):
            movie.save(path, progress=lambda stage, *of: stage == "checking the volumes" or progress(stage, *of))

        writes_nothing_half(save, tmp_path / "out" / name, 9)
    with pytest.raises(Cancelled, match="checking"):
        movie.save(tmp_path / "out" / "movie.npy", progress=lambda *_: False)
    assert list((tmp_path / "out").iterdir()) == []


def test_frames_are_read_on_demand_and_one_at_a_time(series, tmp_path):
    paths = [tmp_path / f"frame_{t}.npy" for t in range(3)]
    for t, path in enumerate(paths):
        np.save(path, stack(t).data)
    movie = series.images(paths, 0.5)
    assert movie[1].data == pytest.approx(series.images([stack(t) for t in range(3)], 0.5)[1].data, nan_ok=True)
    movie.save(tmp_path / "movie.ome.tif")
    with tifffile.TiffFile(tmp_path / "movie.ome.tif") as file:
        assert all(f"frame_{t}.npy" in file.ome_metadata for t in range(3))
    refused("it is an input", movie.save, paths[1])
    paths[2].unlink()
    assert len(movie[0]) == 1
    for fail in (lambda: movie[2], lambda: movie.save(tmp_path / "other.npy")):
        with pytest.raises(FileNotFoundError, match=r"frame_2\.npy"):
            fail()
    assert not (tmp_path / "other.npy").exists()


@pytest.mark.medium
def test_memory_does_not_grow_with_the_number_of_frames(sheets, tmp_path):
    def peak(count):
        many = voxflat.FlatSeries(
            sheets.flat_map, *(np.repeat(values[:1], count, 0) for values in (sheets.points, sheets.normals)), 0,
            np.zeros(count), np.zeros(count, dtype=np.int64),
        )  # fmt: skip
        movie = many.images(metric=True, pixel_size=0.1)
        tracemalloc.start()
        movie.save(tmp_path / f"{count}.npy")
        found = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return found

    assert peak(16) < 1.2 * peak(2)


@pytest.mark.medium
def test_integers_are_labels_in_all_frames_or_in_none(series, tmp_path, caplog):
    rng = np.random.default_rng(0)
    noise = [rng.integers(1, 200, (40, 40, 40)).astype(np.uint16) for _ in range(2)]
    volumes = [*noise, np.full((40, 40, 40), 7, dtype=np.uint16)]
    how = {"imagej": True, "resolution": (1, 1), "metadata": {"axes": "ZYX", "spacing": 1.0, "unit": "um"}}
    for t, volume in enumerate(volumes):
        tifffile.imwrite(tmp_path / f"{t}.tif", np.pad(volume, 1).T, **how)
    paths = [tmp_path / f"{t}.tif" for t in range(3)]
    moved = voxflat.flatten_series([voxflat.surface(ellipsoid(s), threshold=0.5, unit="µm") for s in (1.0, 1.1, 1.2)])
    for order in (paths, paths[::-1]):
        expected = "nearest" if order[0] == paths[2] else "linear"
        caplog.clear()
        found = moved.images(order, 1.0).data
        assert np.array_equal(found, moved.images(order, 1.0, interpolation=expected).data, equal_nan=True)
        assert sum("labels" in record.message for record in caplog.records) == (order[0] == paths[2])


@pytest.mark.medium
def test_points_of_other_frames_are_not_painted_into_the_voxels_of_the_reference(series):
    ball = voxflat.samples.ball()
    made = voxflat.flatten_series([ball, np.roll(ball, 1, axis=0)])
    labels = np.arange(len(made.flat_map))
    assert made[0].paint(labels).shape == ball.shape
    refused("not voxels of the flattened volume", made[1].paint, labels)


@pytest.mark.parametrize(
    ("volumes", "options", "told"),
    [
        (None, {}, "volumes is missing. Pass a list of one volume per frame, or metric=True"),
        (None, {"metric": True, "depth": 1.0}, "depth does not apply without volumes"),
        ([stack(0)] * 2, {}, "got 2 volumes for 3 frames"),
        ("frame.tif", {}, "volumes is 'frame.tif'. Pass a list"),
        (
            [stack(0), stack(1), stack(2, shape=(40, 39, 40))],
            {},
            "frame 2 has 40 x 39 x 40 voxels and 1 channels?, but",
        ),
        ([np.zeros((40, 40, 40, n)) for n in (2, 2, 3)], {}, "frame 2 has 40 x 40 x 40 voxels and 3 channels, but"),
        ([stack(0), None, stack(2)], {}, "frame 1: "),
        ([stack(0)] * 3, {"time_step": -1.0}, "time_step is -1. Pass the time between frames"),
        ([stack(0)] * 3, {"metric": "yes"}, "metric is 'yes'"),
        ([stack(0)] * 3, {"interpolation": "cubic"}, "interpolation is 'cubic'"),
    ],
)
def test_volumes_that_do_not_belong_together_are_refused(series, tmp_path, volumes, options, told):
    def save():
        series.images(volumes, **options).save(tmp_path / "movie.npy")

    refused(told, save)
    assert list(tmp_path.iterdir()) == []


def test_the_same_volume_may_be_given_twice(series):
    data = series.images([stack(0)] * 3, 1.0).data
    assert len(data) == 3


@pytest.mark.parametrize(
    ("surfaces", "told"),
    [
        ([ellipsoid(1), ellipsoid(1, handle=True)], "frame 1 has 1 component, 1 handle, 0 boundary loops, but frame 0"),
        ([ellipsoid(1), np.maximum(ellipsoid(0.5), np.roll(ellipsoid(0.5), 14, 0))], "frame 1 has 2 components"),
        (
            [np.maximum(ellipsoid(0.5), np.roll(ellipsoid(0.5), 14, 0))] * 2,
            "frame 0 has 2 components with areas of",
        ),
    ],
)
def test_organs_that_touch_or_part_are_refused(surfaces, told):
    with pytest.raises(InputError) as error:
        voxflat.flatten_series([surface_of(one) for one in surfaces])
    assert told in str(error.value)
    assert "\n" not in str(error.value)


def test_a_refusal_names_the_file(tmp_path):
    hill = voxflat.samples.hill()
    for name, points in (("a.ply", hill.points), ("b.ply", 1e-3 * hill.points)):
        voxflat.io.write_mesh(tmp_path / name, voxflat.io.Mesh(points, hill.faces))
    surfaces = [voxflat.surface(tmp_path / "a.ply", unit="µm"), voxflat.surface(tmp_path / "b.ply", unit="mm")]
    refused(r"frame 1 \(b\.ply\) is in mm, but frame 0 is in µm", voxflat.flatten_series, surfaces)
