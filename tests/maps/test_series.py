"""Series on the flat map: each frame is what one volume would be, at its place and its time, in every file."""

import json
import warnings
from dataclasses import replace

import nibabel as nib
import numpy as np
import pytest
from brain_spaces import AFFINES, ball, header, oblique, to_scanner, write_freesurfer
from command_line import run, succeed
from mesh_files import gifti, patch
from refusals import refused, writes_nothing_half

import voxflat
from voxflat.io import Volume
from voxflat.io.channels import Timing
from voxflat.io.meshes import Mesh
from voxflat.io.provenance import portable
from voxflat.maps.sampling import Mixing
from voxflat.methods import Voxflat

COUNT, SIZE = 5, 60


@pytest.fixture(scope="module")
def tk_map(tmp_path_factory):
    """A map in tkRAS with c_ras, and its vertices in scanner RAS."""
    (points, faces), of = ball(), header(oblique())
    path = write_freesurfer(tmp_path_factory.mktemp("tk") / "lh.white", points, faces, of)
    flat = voxflat.surface(path).disk(0, 25.0).flatten(Voxflat(sources=20))
    return flat, to_scanner(points.astype(np.float64), of)


@pytest.fixture(scope="module")
def shells():
    """A map between two spheres, and noise around them with a place beyond it."""
    (points, faces) = ball()
    surface = voxflat.surface(Mesh(points, faces), pial=Mesh(1.1 * points, faces))
    flat = surface.disk(0, 20.0).flatten(Voxflat(sources=20))
    low = flat.white_points.min(axis=0) + np.array([2.0, 0, 0])  # part of the map lies outside
    affine = nib.affines.from_matvec(2.5 * np.eye(3), low)
    shape = tuple(np.ceil((flat.pial_points.max(axis=0) - low) / 2.5).astype(int) + 1)
    data = np.random.default_rng(1).normal(size=(*shape, 3))
    data[shape[0] // 2, shape[1] // 2] = np.nan
    return flat, data, affine


def nifti(path, data, affine, step=2.0, unit="sec", start=0.0):
    """Write a series."""
    image = nib.Nifti1Image(data, affine)
    image.header.set_xyzt_units("mm", unit)
    image.header.set_zooms((*image.header.get_zooms()[:3], step))
    image.header["toffset"] = start
    nib.save(image, path)
    return path


@pytest.mark.medium
@pytest.mark.parametrize("kind", AFFINES)
@pytest.mark.parametrize("name", ["bold.nii", "bold.mgz"])
def test_each_frame_lies_where_the_surface_is(tk_map, tmp_path, kind, name):
    """Values are x, y or z of scanner RAS, times the number of the frame."""
    flat, scanner = tk_map
    world = nib.affines.apply_affine(AFFINES[kind], np.moveaxis(np.indices((SIZE, SIZE, SIZE)), 0, -1))
    frames = [(axis, factor) for axis in range(3) for factor in (1, 3)]
    data = np.stack([factor * world[..., axis] for axis, factor in frames], axis=-1).astype(np.float32)
    nib.save((nib.MGHImage if name.endswith("z") else nib.Nifti1Image)(data, AFFINES[kind]), tmp_path / name)
    flat.images(tmp_path / name).save(tmp_path / "flat.nii")
    written = nib.load(tmp_path / "flat.nii").get_fdata()[:, :, 0]
    there = flat.raster().interpolate(scanner[flat.ids])
    for n, (axis, factor) in enumerate(frames):
        np.testing.assert_allclose(written[..., n], factor * there[..., axis], atol=1e-3)


@pytest.mark.parametrize(
    "how", [{}, {"depth": 1.0}, {"fraction": (0.2, 0.5, 0.9)}, {"fraction": (0.2, 0.8), "projection": "mean"}]
)
@pytest.mark.parametrize("interpolation", ["linear", "nearest"])
def test_a_frame_is_what_one_volume_is(shells, tmp_path, how, interpolation):
    """By nearest voxels bit for bit, else within rounding; NaN and the volume's ends at the same pixels."""
    flat, data, affine = shells
    alone = {name: value for name, value in how.items() if name != "projection"}
    if interpolation == "nearest":
        data, how = np.nan_to_num(100 * data).astype(np.int16), alone
    series = flat.images(nifti(tmp_path / "bold.nii", data, affine), 0.7, interpolation=interpolation, **how)
    rounding = {"rtol": 0, "atol": 0} if interpolation == "nearest" else {"rtol": 1e-12, "atol": 1e-14}
    for n in range(3):
        one = flat.images(Volume(data[..., n], affine), 0.7, interpolation=interpolation, **how)
        if len(one) == 1:
            own = flat.image(tmp_path / "bold.nii", 0.7, channel=n, interpolation=interpolation, **alone)
            np.testing.assert_array_equal(own.data, one[0].data)
        for k in range(len(one)):
            assert np.isnan(one[k].data[flat.raster(0.7).inside]).any()
            np.testing.assert_allclose(series[n * len(one) + k].data, one[k].data, **rounding)


@pytest.mark.parametrize("interpolation", ["linear", "nearest", "majority"])
def test_a_frame_is_what_one_overlay_is(shells, interpolation):
    flat, *_ = shells
    values = np.random.default_rng(2).integers(0, 9, (flat.metadata["vertices"], 3)).astype(float)
    values[:, 2] += np.where(np.arange(len(values)) % 50 == 0, np.nan, 0.0) if interpolation != "majority" else 0
    series = flat.images(values, 0.7, interpolation=interpolation)
    for n in range(3):
        one = flat.image(values[:, n], 0.7, interpolation=interpolation)
        np.testing.assert_allclose(series[n].data, one.data, rtol=1e-12, atol=1e-12)


def test_nan_that_signals_is_nan():
    values = np.array([1.5, 0.0], np.float32)
    values.view(np.uint32)[1] = 0x7FA00000  # what damaged files have: to convert it warns, and warnings are errors
    corners, weights = np.array([[0], [1]]), np.ones((2, 1))
    mixing = Mixing.of(np.array([True, True, False]), 2, 1, lambda part: (corners[part], weights[part]))
    np.testing.assert_array_equal(mixing(values), [1.5, np.nan, np.nan])


TIMES = {(2.0, "sec", 0.0): Timing(2.0), (720.0, "msec", 500.0): Timing(0.72, 0.5)}
TIMES |= {(8e5, "usec", 0.0): Timing(0.8), (0.72, "sec", 1.5): Timing(0.72, 1.5)}
TIMES |= dict.fromkeys([(2.0, "unknown", 0.0), (2.0, "hz", 0.0), (0.0, "sec", 0.0), (np.nan, "sec", 0.0)])


@pytest.mark.parametrize(("header", "times"), TIMES.items())
def test_the_time_of_nifti(shells, tmp_path, header, times):
    step, unit, start = header
    flat, data, affine = shells
    path = nifti(tmp_path / "bold.nii", data, affine, 1.0, unit, start)
    patch(path, {92: np.float32(step).tobytes()})  # pixdim[4], which nibabel would not let pass
    stack = flat.images(path)
    assert stack.timing == times
    assert flat.images(path, channel=1).timing is None  # one frame is no series
    if times is None:
        assert stack.times is None
    else:
        np.testing.assert_allclose(stack.times, times.start + times.step * np.arange(3), rtol=1e-6)


def test_the_time_of_other_files(shells, tmp_path):
    flat, data, affine = shells
    image = nib.MGHImage(data.astype(np.float32), affine)
    image.header["tr"] = 2200  # ms
    nib.save(image, tmp_path / "bold.mgz")
    assert flat.images(tmp_path / "bold.mgz").timing == Timing(2.2)
    assert flat.images(tmp_path / "bold.mgz", fraction=(0.2, 0.8)).times.tolist() == [0, 2.2, 4.4]
    count = flat.metadata["vertices"]
    values = np.ones((3, count), np.float32)
    brain = nib.cifti2.BrainModelAxis.from_surface(np.arange(count), count, "CIFTI_STRUCTURE_CORTEX_LEFT")
    for unit, timing in (("SECOND", Timing(0.72, 3.6)), ("HERTZ", None)):
        axis = nib.cifti2.SeriesAxis(3.6, 0.72, 3, unit)
        nib.save(nib.Cifti2Image(values, header=(axis, brain)), tmp_path / "bold.dtseries.nii")
        assert flat.images(tmp_path / "bold.dtseries.nii").timing == timing
    points = nifti(tmp_path / "points.nii", values.T[:, None, None], np.eye(4), 0.8)
    assert flat.images(points).timing == Timing(0.8)
    gifti(tmp_path / "bold.func.gii", [(row, "estimate") for row in values])
    assert flat.images(tmp_path / "bold.func.gii").timing is None
    assert flat.images(tmp_path / "bold.func.gii", time_step=1.5).timing == Timing(1.5)
    assert flat.images(points, time_step=2).timing == Timing(2.0)
    for wrong in (0, -1.0, np.nan, np.inf, "2"):
        refused("(the time step|time_step) is", flat.images, points, time_step=wrong)
    refused("only one image", flat.images, points, channel=0, time_step=2.0)
    refused("only one image", flat.images, values[0], time_step=2.0)


def test_other_lengths_than_mm_are_converted(shells, tmp_path, caplog):
    flat, data, affine = shells
    expected = flat.images(nifti(tmp_path / "bold.nii", data, affine))[0].data
    for code, factor in ((1, 1e-3), (3, 1e3)):
        path = nifti(tmp_path / "other.nii", data, np.diag([factor] * 3 + [1]) @ affine)
        patch(path, {123: bytes([code | 8])})
        np.testing.assert_allclose(flat.images(path)[0].data, expected, atol=1e-4)
        assert "converted to mm" in caplog.text


def test_milliseconds_that_are_called_seconds_cause_a_warning(shells, tmp_path, caplog):
    flat, data, affine = shells
    path = nifti(tmp_path / "bold.nii", data, affine, 2000.0)
    flat.images(path)
    (message,) = caplog.messages
    assert message.startswith("the header of bold.nii gives a time step of 2000 s, which may be in milliseconds")
    flat.images(path, time_step=2.0)
    assert len(caplog.messages) == 1


def test_percent_change(shells, tmp_path):
    """Of signals that change by a known share, at each depth by itself; none where the mean is not positive."""
    flat, data, affine = shells
    base = 100 + 10 * np.nan_to_num(data[..., 0])
    base[: len(base) // 3] *= -1
    share = np.array([-0.02, 0.0, 0.02])
    path = nifti(tmp_path / "bold.nii", base[..., None] * (1 + share), affine)
    for how in ({"fraction": 0.5}, {"fraction": (0.2, 0.8)}):
        raw = flat.images(path, 0.7, **how)
        changed = raw.percent_change()
        assert (changed.timing, changed.name) == (raw.timing, "bold.nii, change (%)")
        each = len(raw) // 3
        for n in range(len(raw)):
            mean = raw[each + n % each].data  # the share of the second frame is 0
            np.testing.assert_allclose(changed[n].data, np.where(mean > 0, 100 * share[n // each], np.nan), atol=1e-9)
    with pytest.raises(voxflat.Cancelled, match="while averaging"):
        raw.percent_change(lambda *_: False)


@pytest.mark.parametrize("missing", [np.nan, np.inf])
def test_percent_change_leaves_out_frames_without_a_value(missing, caplog):
    """By NumPy's nan-functions of random values; the strict way is NaN in all frames of such a pixel."""
    flat = voxflat.samples.hill().flatten()
    values = np.random.default_rng(0).uniform(50, 150, (441, 5))
    values[np.random.default_rng(1).random(values.shape) < 0.1] = missing
    values[:40] = missing
    raw = flat.images(values, 1.0)
    images = np.where(np.isfinite(raw.data), raw.data, np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # NumPy warns about pixels without any value
        mean = np.nanmean(images, axis=0)
    changed = raw.percent_change().data
    np.testing.assert_allclose(changed, 100 * (images / mean - 1), rtol=1e-9)
    known = np.isfinite(images).sum(axis=0)
    count = np.count_nonzero((known > 0) & (known < 5))
    assert count > 100
    assert f"{count:,} pixels have no value in some of the 5 frames" in caplog.text
    strict = raw.percent_change(nan_policy="propagate").data
    np.testing.assert_allclose(strict, 100 * (images / images.mean(axis=0) - 1), rtol=1e-9)


@pytest.fixture(scope="module")
def series(shells, tmp_path_factory):
    """A series of three frames at two depths, and the one in the middle."""
    flat, data, affine = shells
    path = nifti(tmp_path_factory.mktemp("series") / "bold.nii", data, affine, 1500.0, "msec", 3000.0)
    return flat.images(path, 0.7, fraction=(0.25, 0.75)), flat.images(path, 0.7, fraction=0.5)


@pytest.mark.parametrize("name", ["flat.nii", "flat.nii.gz"])
def test_nibabel_reads_mm_and_seconds(series, shells, tmp_path, name):
    thickness = np.median(np.linalg.norm(shells[0].pial_points - shells[0].white_points, axis=1))
    for stack, shape in zip(series, ((2, 3), (1, 3)), strict=True):
        stack.save(tmp_path / name)
        image = nib.load(tmp_path / name, mmap=False)  # Windows replaces no mapped file
        assert image.shape == (*stack[0].data.shape, *shape)
        assert image.header.get_xyzt_units() == ("mm", "sec")
        affine = stack[0].affine.copy()
        if len(stack.layers) > 1:  # the fractions 0.25 and 0.75 are half the thickness apart
            affine[2, 2:] = 0.5 * thickness, 0.25 * thickness
        np.testing.assert_allclose(image.header.get_zooms(), (0.7, 0.7, affine[2, 2], 1.5), rtol=1e-6)
        assert float(image.header["toffset"]) == 3.0
        np.testing.assert_allclose(image.affine, affine, rtol=1e-6)
        frames = np.moveaxis(image.get_fdata(dtype=np.float32), (3, 2), (0, 1)).reshape(-1, *image.shape[:2])
        np.testing.assert_array_equal(frames, [one.data.astype(np.float32) for one in stack])
        (extension,) = image.header.extensions
        names = {"names": list(stack.names)} if any(stack.names) else {}
        assert json.loads(extension.get_content()) == {**names, "provenance": portable(stack.provenance)}
        stack[0].save(tmp_path / "one.nii")
        np.testing.assert_array_equal(nib.load(tmp_path / "one.nii", mmap=False).affine[:2], image.affine[:2])


def test_tifffile_reads_axes_and_units(series, tmp_path):
    tifffile = pytest.importorskip("tifffile")
    for stack, axes in zip(series, ("TZYX", "TYX"), strict=True):
        stack.save(tmp_path / "flat.tif")
        with tifffile.TiffFile(tmp_path / "flat.tif") as file:
            assert file.is_ome
            (read,) = file.series
            assert read.axes == axes
            images = np.stack([image.data for image in stack]).astype(np.float32)
            np.testing.assert_array_equal(read.asarray().reshape(images.shape), images)
            pixels = tifffile.xml2dict(file.ome_metadata)["OME"]["Image"]["Pixels"]
            assert pixels["PhysicalSizeX"] == pixels["PhysicalSizeY"] == 0.7
            assert (pixels["PhysicalSizeXUnit"], pixels["TimeIncrementUnit"]) == ("mm", "s")
            assert pixels["TimeIncrement"] == 1.5
            numerator, denominator = file.pages[0].tags["XResolution"].value
            assert numerator / denominator == pytest.approx(10 / 0.7)
            assert file.pages[0].tags["ResolutionUnit"].value == 3  # cm


def test_zarr_reads_axes_and_units(series, tmp_path):
    zarr = pytest.importorskip("zarr")
    for n, (stack, axes) in enumerate(zip(series, ("tzyx", "tyx"), strict=True)):
        stack.save(tmp_path / f"{n}.zarr")
        group = zarr.open_group(tmp_path / f"{n}.zarr", mode="r")
        (scales,) = group.attrs["multiscales"]
        assert "".join(axis["name"] for axis in scales["axes"]) == axes
        assert [axis.get("unit") for axis in scales["axes"]] == ["second", *["millimeter"] * (len(axes) - 1)]
        scale, shift = (step[step["type"]] for step in scales["datasets"][0]["coordinateTransformations"])
        array = group["0"]
        assert array.chunks == (*[1] * (array.ndim - 2), *stack[0].data.shape)
        images = np.stack([image.data for image in stack]).astype(np.float32)
        np.testing.assert_array_equal(array[:].reshape(images.shape), images)
        assert (scale[0], shift[0]) == (1.5, 3.0)
        at = np.array(scale[-2:]) * (7, 11) + shift[-2:]  # of row 7, column 11: y = −v, x = u
        np.testing.assert_allclose((at[1], -at[0]), (stack[0].affine @ (7, 11, 0, 1))[:2])
        assert group.attrs["voxflat"]["provenance"] == portable(stack.provenance)
        assert len([path for path in tmp_path.iterdir() if path.name.startswith(".")]) == 0


def test_maps_without_time_are_channels(shells, tmp_path):
    tifffile, zarr = pytest.importorskip("tifffile"), pytest.importorskip("zarr")
    flat, *_ = shells
    stack = flat.images(np.arange(2.0 * flat.metadata["vertices"]).reshape(-1, 2), 0.7)
    stack = replace(stack, channels=replace(stack.channels, names=("β <1>", "t")))
    stack.save(tmp_path / "maps.tif")
    with tifffile.TiffFile(tmp_path / "maps.tif") as file:
        assert file.series[0].axes == "CYX"
        channels = tifffile.xml2dict(file.ome_metadata)["OME"]["Image"]["Pixels"]["Channel"]
        assert [channel["Name"] for channel in channels] == ["β <1>", "t"]
    stack.save(tmp_path / "maps.zarr")
    group = zarr.open_group(tmp_path / "maps.zarr", mode="r")
    assert [axis["name"] for axis in group.attrs["multiscales"][0]["axes"]] == ["c", "y", "x"]
    assert group.attrs["voxflat"]["names"] == ["β <1>", "t"]


@pytest.mark.parametrize("name", ["flat.nii.gz", "flat.tif", "flat.zarr", "flat.npy"])
def test_nothing_is_written_half(series, tmp_path, name):
    writes_nothing_half(series[1].save, tmp_path / name, 3)


def test_no_directory_is_replaced(series, tmp_path):
    pytest.importorskip("zarr")
    (tmp_path / "flat.zarr").mkdir()
    refused("exists, and voxflat does not replace directories. Delete it", series[1].save, tmp_path / "flat.zarr")
    assert list((tmp_path / "flat.zarr").iterdir()) == []


def test_the_command(shells, tmp_path, monkeypatch):
    zarr = pytest.importorskip("zarr")
    monkeypatch.chdir(tmp_path)
    flat, data, affine = shells
    flat.save("map.npz")
    bold = nifti(tmp_path / "bold.nii", data, affine)
    command = ["image", "map.npz", "--volume", "bold.nii", "--json", "-o"]
    told = json.loads(succeed(*command, "flat.zarr", "--fraction", "0.5").stdout)
    assert (told["images"], told["time_step"]) == (3, 2.0)
    expected = np.stack([image.data for image in flat.images(bold, fraction=0.5)]).astype(np.float32)
    np.testing.assert_array_equal(zarr.open_group("flat.zarr", mode="r")["0"][:], expected)
    assert json.loads(succeed(*command, "flat.nii", "--time-step", "0.8").stdout)["time_step"] == 0.8
    assert nib.load("flat.nii").header.get_zooms()[3] == pytest.approx(0.8)
    assert run(*command, "flat.nii", "--time-step", "0").exit_code == 2


def apart(a, b, period):
    """Return how far phases are apart, the short way round."""
    return np.abs((a - b + period / 2) % period - period / 2)


@pytest.mark.parametrize(("period", "low"), [(360.0, 0.0), (360.0, -180.0), (2 * np.pi, 0.0), (32.0, 0.0)])
def test_phases_go_the_short_way_round(shells, period, low):
    """Of phases that grow along x, and begin again: on vertices and in a volume, at a depth and in their mean."""
    flat, *_ = shells
    rate = period / 20  # a turn in 20 mm
    places = np.zeros(flat.metadata["vertices"])
    places[flat.ids] = flat.points[:, 0]
    expected = rate * flat.raster(0.7).interpolate(flat.points[:, 0])
    values = (rate * places - low) % period + low
    shown = flat.image(values, 0.7, period=period).data
    is_inside = np.isfinite(expected)
    assert 0 <= shown[is_inside].min() <= shown[is_inside].max() < period
    assert apart(shown, expected, period)[is_inside].max() < 0.04 * period
    assert apart(flat.image(values, 0.7).data, expected, period)[is_inside].max() > 0.2 * period  # what it is for
    around = nib.affines.from_matvec(np.eye(3), flat.space.to_scanner(flat.points).mean(axis=0) - 30)
    x = np.broadcast_to(np.arange(60.0)[:, None, None], (60, 60, 60)) + around[0, 3]
    volume = Volume((rate * x - low) % period + low, around)
    for how in ({}, {"fraction": (0.2, 0.5, 0.8)}):
        there = flat.image(Volume(x, around), 0.7, interpolation="linear", **how).data
        shown = flat.image(volume, 0.7, period=period, **how).data
        assert np.nanmax(apart(shown, rate * there, period)) < 0.01 * period


def test_phases_that_cancel_have_none(shells):
    flat, *_ = shells
    values = np.where(np.arange(flat.metadata["vertices"]) % 2, 90.0, 270.0)
    shown = flat.image(values, 0.7, period=360).data
    away = np.abs(np.sin(np.radians(shown[np.isfinite(shown)])))
    np.testing.assert_allclose(away, 1, atol=1e-6)  # one or the other, nothing between
    nearest = flat.image(values, 0.7, period=360, interpolation="nearest").data
    np.testing.assert_array_equal(nearest, flat.image(values, 0.7, interpolation="nearest").data)
    for wrong, said in ((0, "period is 0"), (np.inf, "period"), ("1", "period")):
        refused(said, flat.image, values, period=wrong)
    refused("'majority', which is for labels", flat.image, values, period=360, interpolation="majority")
