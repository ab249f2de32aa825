"""`voxflat movie-map` flattens all frames, and `voxflat image` shows their volumes; other commands name the remedy."""

import json
from unittest.mock import Mock

import numpy as np
import pytest
import tifffile
from command_line import fail, succeed

import voxflat

PLACES = np.stack(np.meshgrid(*[np.arange(30.0) - 14.5] * 3, indexing="ij"))
HOW = {"imagej": True, "resolution": (1, 1)}


def write(path, volume):
    """Write a volume (x, y, z) or its channels (c, x, y, z) as a TIFF stack in µm."""
    axes = "ZYX" if volume.ndim == 3 else "ZCYX"
    pages = volume.T if volume.ndim == 3 else volume.transpose(3, 0, 2, 1)
    tifffile.imwrite(path, pages.astype(np.float32), metadata={"axes": axes, "spacing": 1.0, "unit": "um"}, **HOW)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Write the surfaces and the volumes of three frames, and the map of all frames."""
    made = tmp_path_factory.mktemp("movie")
    for t in range(3):
        far = np.linalg.norm(PLACES / np.array([10, 8, 7]).reshape(3, 1, 1, 1), axis=0) / (1 + 0.1 * t)
        write(made / f"seg_{t:02}.tif", 1 / (1 + np.exp(12 * (far - 1))))
        write(made / f"frame_{t:02}.tif", np.stack([PLACES[0] + 100 * t, PLACES[2]]))
    told = succeed("movie-map", *of(made, "seg"), "--threshold", 0.5, "--smooth", 4, "-o", made / "movie.npz")
    assert "3, flattened: 0 (seg_00.tif)" in told.stdout
    assert "µm" in told.stdout
    assert "missing" not in told.stderr
    succeed("flatten", made / "seg_00.tif", "--threshold", 0.5, "-o", made / "map.npz")
    write(made / "empty.tif", 0 * PLACES[0])
    write(made / "two.tif", (np.abs(PLACES) < 6).all(axis=0) & (np.abs(PLACES[0]) > 2))
    flat = voxflat.load(made / "map.npz").raster().inside
    labels = np.where(flat & (np.indices(flat.shape)[0] < len(flat) / 2), 1, 2 * flat)
    tifffile.imwrite(made / "labels.tif", labels.astype(np.uint8))
    return made


def of(folder, name):
    return sorted(folder.glob(f"{name}_*.tif"))


@pytest.mark.medium
def test_the_map_is_that_of_the_function(folder):
    surfaces = [voxflat.surface(path, threshold=0.5).smooth(4) for path in of(folder, "seg")]
    expected, found = voxflat.flatten_series(surfaces), voxflat.load_series(folder / "movie.npz")
    assert np.array_equal(found.points, expected.points)
    assert np.array_equal(found.flat_map.uv, expected.flat_map.uv)
    record = json.dumps(found.provenance)
    assert all(record.count(path.name) for path in of(folder, "seg"))


@pytest.mark.medium
@pytest.mark.parametrize(("kind", "names"), [("1", [""]), ("2", ["front.", "back."]), ("cylinder", ["cylinder."])])
def test_charts_have_one_map_each(folder, tmp_path, kind, names):
    words = [*of(folder, "seg"), "--threshold", 0.5, "--smooth", 4, "--charts", kind, "--quiet"]
    succeed("movie-map", *words, "--reference", 1, "-o", tmp_path / "movie.npz")
    surfaces = [voxflat.surface(path, threshold=0.5).smooth(4) for path in of(folder, "seg")]
    charts = surfaces[1].charts(kind if kind == "cylinder" else int(kind))
    for name, chart in zip(names, charts, strict=False):
        series = voxflat.load_series(tmp_path / f"{name}movie.npz")
        expected = voxflat.flatten_series(surfaces, reference=1, cuts=chart)
        assert np.array_equal(series.points, expected.points)
        assert series.flat_map.period == expected.flat_map.period
    told = "--charts cannot be combined with --cuts"
    fail(2, told, "movie-map", *words, "--cuts", "automatic", "-o", tmp_path / "other.npz")


@pytest.mark.medium
def test_regions_are_written_for_a_volume_of_several_channels(folder, tmp_path):
    words = ["regions", folder / "map.npz", "--image", folder / "labels.tif", "--depth", "-2,2"]
    succeed(*words, "--volume", folder / "frame_00.tif", "-o", tmp_path / "cells.nii.gz")
    found = voxflat.io.read_volume(tmp_path / "cells.nii.gz")
    assert found.data.shape == PLACES.shape[1:]
    assert set(np.unique(found.data)) == {0, 1, 2}


@pytest.mark.medium
def test_units_have_several_names(folder, tmp_path):
    words = ["movie-map", *of(folder, "seg")[:2], "--threshold", 0.5, "--quiet"]
    succeed(*words, "--unit", "um", "-o", tmp_path / "movie.npz")
    fail(2, "'ell' is not one of", *words, "--unit", "ell", "-o", tmp_path / "other.npz")


@pytest.mark.medium
def test_images_of_all_frames(folder, tmp_path):
    words = ["image", folder / "movie.npz", "--volume", *of(folder, "frame"), "--depth", "-2:2:2", "--metric"]
    told = succeed(*words, "--time-step", 60, "-o", tmp_path / "movie.ome.tif", "--json")
    content = json.loads(told.stdout)
    assert (content["frames"], content["channels"], content["depths"], content["time_step"]) == (3, 5, 3, 60)
    assert len(content["provenance"]["files"]) >= 2
    series = voxflat.load_series(folder / "movie.npz")
    expected = series.images(of(folder, "frame"), depth=[-2, 0, 2], metric=True).data.astype(np.float32)
    with tifffile.TiffFile(tmp_path / "movie.ome.tif") as file:
        assert file.series[0].axes == "TCZYX"
        assert np.array_equal(file.series[0].asarray(), expected, equal_nan=True)
        assert all(path.name in file.ome_metadata for path in of(folder, "frame"))
    succeed("image", folder / "movie.npz", "--metric", "-o", tmp_path / "metric.npy", "--quiet")
    assert np.array_equal(np.load(tmp_path / "metric.npy"), expected[:, 2:, 0], equal_nan=True)
    succeed(*words[:-3], "--channel", 1, "-o", tmp_path / "one.npy")
    surface = series.flat_map.raster().interpolate(series.points[2])
    assert np.load(tmp_path / "one.npy")[2] == pytest.approx(surface[..., 2] - 14.5, abs=1e-3, nan_ok=True)


@pytest.mark.medium
@pytest.mark.parametrize(
    ("words", "status", "told"),
    [
        ("image movie.npz --volume frame_00.tif frame_01.tif -o a.tif", 1, "got 2 volumes for 3 frames"),
        ("image movie.npz --volume frame_00.tif -o a.tif", 1, "got 1 volumes for 3 frames"),
        ("image movie.npz -o a.tif", 2, "for the map of a movie, --volume or --metric"),
        ("image nothing.npz --metric -o a.tif", 1, "nothing.npz"),
        ("movie-map seg_00.tif empty.tif --threshold 0.5 -o a.npz", 1, "frame 1 (empty.tif): no voxel is above"),
        ("movie-map seg_00.tif two.tif --threshold 0.5 -o a.npz", 1, "frame 1 (two.tif) has 2 components with areas"),
        ("image movie.npz --volume frame_00.tif frame_01.tif seg_02.tif -o a.tif", 1, "frame 2 (seg_02.tif) has"),
        ("regions map.npz --image labels.tif -o a.nii.gz --volume frame_00.tif", 1, "a range in µm such as"),
        ("image movie.npz --heat-map -o a.tif", 2, "--heat-map applies to single maps. Pass --metric"),
        ("image movie.npz --metric -o a.png", 1, "Choose a name that ends in .tif"),
        ("image movie.npz --metric --depth 2 -o a.tif", 1, "--depth does not apply without volumes"),
        (
            "image map.npz --volume frame_00.tif frame_01.tif -o a.tif",
            1,
            "2 volumes are given, but map.npz is a single",
        ),
        ("image map.npz --metric -o a.tif", 1, "--metric is given, but map.npz is a single map"),
        (
            "figure movie.npz -o a.png",
            1,
            "movie.npz holds maps of several frames. Use `voxflat image`",
        ),
        ("worst movie.npz", 1, "movie.npz holds maps of several frames"),
        ("movie-map seg_00.tif --threshold 0.5 -o a.npz", 1, "is a single frame. Pass two or more frames"),
        ("movie-map seg_00.tif seg_01.tif --threshold 0.5 -o a.ply", 1, "unknown file format"),
        ("movie-map seg_00.tif seg_01.tif --threshold 0.5 -o seg_01.tif", 1, "unknown file format"),
        ("movie-map seg_00.tif seg_07.tif --threshold 0.5 -o a.npz", 1, "seg_07.tif"),
        ("movie-map seg_00.tif seg_01.tif --threshold 0.5 --reference 2 -o a.npz", 1, "reference is 2"),
        ("movie-map map.npz movie.npz -o movie.npz", 1, "cannot write movie.npz: it is an input"),
        ("movie-map --threshold 0.5 -o a.npz", 2, "FRAME"),
    ],
)
def test_wrong_use_is_refused_in_one_line(folder, monkeypatch, words, status, told):
    monkeypatch.chdir(folder)
    before = sorted(folder.iterdir())
    result = fail(status, told, *words.split())
    assert status == 2 or result.stderr.splitlines()[-1].startswith("voxflat: error: ")
    assert sorted(folder.iterdir()) == before


@pytest.mark.medium
def test_a_movie_can_be_cited(folder):
    assert "voxflat" in succeed("cite", folder / "movie.npz").stdout


@pytest.mark.medium
@pytest.mark.parametrize(
    ("names", "told"),
    [
        (["s_00.ply", "s_01.ply", "s_03.ply"], "warning: frames are missing: s_02.ply"),
        (["t2_s_9.ply", "t2_s_10.ply", "t2_s_11.ply", "t2_s_15.ply"], "frames are missing: t2_s_12.ply to t2_s_14.ply"),
        (["s_1.ply", "s_10.ply", "s_2.ply"], "s_10.ply comes before s_2.ply, so the frames are not in the order of"),
        (["s_00.ply", "s_05.ply", "s_10.ply"], None),
        (["s_00.ply", "s_00.ply"], None),
        (["early.ply", "late.ply"], None),
        (["t1_a2.ply", "t2_a4.ply"], None),
    ],
)
def test_numbers_in_file_names_are_checked(tmp_path, monkeypatch, names, told):
    monkeypatch.chdir(tmp_path)
    hill = voxflat.samples.hill()
    for n, name in enumerate(names):
        voxflat.io.write_mesh(name, voxflat.io.Mesh((1 + 0.01 * n) * hill.points, hill.faces))
    stderr = succeed("movie-map", *names, "-o", "movie.npz").stderr
    assert told in stderr if told else "missing" not in stderr and "order" not in stderr


@pytest.mark.medium
def test_a_cancelled_command_leaves_no_file(folder, tmp_path, monkeypatch):
    monkeypatch.setattr("voxflat.pipeline.series.Follower.onto", Mock(side_effect=KeyboardInterrupt))
    fail(130, "cancelled", "movie-map", *of(folder, "seg"), "--threshold", 0.5, "-o", tmp_path / "movie.npz")
    monkeypatch.setattr("voxflat.pipeline.flat_series.FlatSeries.stretches", Mock(side_effect=KeyboardInterrupt))
    for name in ("a.ome.tif", "a.zarr"):
        fail(130, "cancelled", "image", folder / "movie.npz", "--metric", "-o", tmp_path / name)
    assert list(tmp_path.iterdir()) == []
