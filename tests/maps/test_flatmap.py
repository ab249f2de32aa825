import json
from dataclasses import asdict, replace
from functools import partial

import composed
import numpy as np
import pytest
import shapes
from refusals import refused
from scipy.spatial.transform import Rotation

import voxflat
from voxflat.io.volumes import Volume
from voxflat.maps.sampling import sample

grossmann2002 = partial(composed.flatten, method="grossmann2002")

AFFINE = np.array([[0, -0.5, 0, 12], [0.5, 0, 0, -7], [0, 0, 0.5, 1], [0, 0, 0, 1]], dtype=float)
OTHER = np.array([[0.8, 0, 0, -10], [0, 0, 0.7, -10], [0, -0.9, 0, 8], [0, 0, 0, 1]])


@pytest.fixture(scope="module")
def sheet_map():
    return grossmann2002(shapes.sheet((40, 30)), affine=AFFINE, sources=300)


@pytest.fixture(scope="module")
def ball():
    return shapes.ball(14)


@pytest.fixture(scope="module")
def ball_map(ball):
    return grossmann2002(ball, seed_point=(28, 16, 16), radius=15.0, sources=200, rows=True)


def linear(points):
    return points @ [1.0, -2.0, 3.0] + 4


def linear_volume(shape, affine):
    return linear(np.moveaxis(np.indices(shape), 0, -1) @ affine[:3, :3].T + affine[:3, 3])


class TestRaster:
    def test_pixels_lie_on_the_surface(self, sheet_map):
        ids, points = sheet_map.locate(0.25)
        inside = sheet_map.raster(0.25).inside
        np.testing.assert_array_equal(inside, ids[..., 0] >= 0)
        np.testing.assert_array_equal(inside, ~np.isnan(points).any(axis=-1))
        assert (shapes.sheet((40, 30))[tuple(ids[inside].T)] == 1).all()
        np.testing.assert_allclose(points[inside][:, 2], 1.5)  # the sheet is at k = 1
        # a place between voxels is about half a diagonal from the nearest
        nearest = ids[inside] @ AFFINE[:3, :3].T + AFFINE[:3, 3]
        assert np.linalg.norm(points[inside] - nearest, axis=1).max() < 0.6 * np.sqrt(0.5)

    def test_every_point_has_a_pixel_where_it_lies(self, sheet_map):
        raster = sheet_map.raster(0.1)
        column, row = np.round((sheet_map.uv - raster.origin) / [0.1, -0.1]).astype(int).T
        found = raster.nearest[row, column]
        hit = found == np.arange(len(sheet_map))
        rim = found < 0  # the pixel's centre lies just outside
        assert (hit | rim).all()
        assert rim.mean() < 0.1

    def test_the_map_covers_its_area(self, sheet_map):
        area = sheet_map.raster(0.1).inside.sum() * 0.1**2
        assert area == pytest.approx(39 * 29 * 0.25, rel=0.12)  # the estimator shrinks along the axes

    def test_a_raster_is_drawn_once_a_size(self, sheet_map):
        assert sheet_map.raster(0.3) is sheet_map.raster(0.3)
        assert sheet_map.raster().pixel_size == 0.25  # half a voxel

    @pytest.mark.parametrize("size", [0, -1, np.nan, np.inf, 1e-9])
    def test_bad_pixel_sizes(self, sheet_map, size):
        refused(r"pixel size|pixels", sheet_map.raster, size)


class TestImage:
    @pytest.mark.parametrize(("shape", "affine"), [((42, 32, 3), AFFINE), ((60, 20, 60), OTHER)])
    def test_a_linear_volume_is_sampled_exactly(self, sheet_map, shape, affine):
        volume = Volume(linear_volume(shape, affine), affine)
        image = sheet_map.image(volume, 0.2)
        _, points = sheet_map.locate(0.2)
        inside = sheet_map.raster(0.2).inside
        np.testing.assert_allclose(image.data[inside], linear(points[inside]), atol=1e-5)
        assert np.isnan(image.data[~inside]).all()
        assert image.data.shape == inside.shape
        if affine is AFFINE:
            bare = sheet_map.image(volume.data, 0.2)  # an array lies where the flattened volume lies
            np.testing.assert_array_equal(bare.data, image.data)

    @pytest.mark.parametrize("dtype", [np.float16, np.longdouble])
    def test_floats_of_any_width(self, sheet_map, dtype):
        values = np.random.default_rng(0).integers(0, 100, (42, 32, 3))  # which half precision holds
        expected = sheet_map.image(values.astype(np.float64), 0.2).data
        np.testing.assert_array_equal(sheet_map.image(values.astype(dtype), 0.2).data, expected)

    def test_a_file_without_a_place_lies_where_the_flattened_volume_lies(self, sheet_map, tmp_path):
        values = linear_volume((42, 32, 3), AFFINE)
        expected = sheet_map.image(values, 0.2).data
        np.save(tmp_path / "a.npy", values)
        np.savez(tmp_path / "a.npz", values)
        for name in ("a.npy", "a.npz"):
            np.testing.assert_array_equal(sheet_map.image(tmp_path / name, 0.2).data, expected)
        np.savez(tmp_path / "b.npz", data=values, affine=np.eye(4))  # says that it lies elsewhere
        assert not np.array_equal(sheet_map.image(tmp_path / "b.npz", 0.2).data, expected, equal_nan=True)

    def test_labels_are_never_mixed(self, sheet_map):
        labels = np.zeros((42, 32, 3), dtype=np.int16)
        labels[:20], labels[20:] = 10, 500
        shown, mixed = (sheet_map.image(labels, interpolation=how).data for how in (None, "linear"))
        assert set(np.unique(shown[~np.isnan(shown)])) == {10, 500}
        assert ((mixed > 10) & (mixed < 500)).any()

    def test_colours(self, sheet_map):
        colours = np.zeros((42, 32, 3, 3), dtype=np.uint8)
        colours[..., 0], colours[..., 1] = 200, np.arange(42)[:, None, None]
        image = sheet_map.image(colours)
        inside, (ids, _) = sheet_map.raster().inside, sheet_map.locate()
        assert image.is_colour
        assert image.data.dtype == np.uint8
        np.testing.assert_array_equal(image.data[..., 3], np.where(inside, 255, 0))
        assert (image.data[inside][:, 0] == 200).all()
        assert np.abs(image.data[inside][:, 1].astype(int) - ids[inside][:, 0]).max() <= 1

    def test_outside_the_volume_is_nan(self, sheet_map):
        affine = AFFINE.copy()
        affine[1, 3] += 10  # half of the sheet is not in it
        image = sheet_map.image(Volume(np.ones((42, 32, 3)), affine))
        assert 0.3 < np.isnan(image.data[sheet_map.raster().inside]).mean() < 0.7

    @pytest.mark.parametrize("spacing", [1.0, 0.1])
    def test_a_volume_ends_at_the_outer_faces_of_its_voxels(self, spacing):
        affine = np.diag([spacing] * 3 + [1.0])
        affine[:3, 3] = 0.7
        volume = Volume(np.ones((4, 3, 1)), affine)
        middle = np.array([1.5, 1.0, 0.0])
        for axis, half in enumerate((2.0, 1.5, 0.5)):  # in voxels, from the middle to the faces
            for way in (-half, half):
                indices = np.array([middle + np.eye(3)[axis] * way * by for by in (1, 1.001)])
                assert np.isnan(sample(volume, affine[:3, 3] + spacing * indices)).tolist() == [False, True]

    def test_depth_goes_outward(self, ball, ball_map):
        radius = np.linalg.norm(np.indices(ball.shape) - (ball.shape[0] - 1) / 2, axis=0)
        means = [np.nanmean(ball_map.image(radius, depth=depth).data) for depth in (-3, 0, 2)]
        np.testing.assert_allclose(np.diff(means), [3, 2], atol=0.1)

    def test_a_sheet_has_no_depth(self, sheet_map):
        told = "depth is 1 mm, but a surface that is one voxel thick has no outside"
        refused(told, sheet_map.image, np.ones((42, 32, 3)), depth=1)

    def test_unfit_volumes(self, sheet_map):
        told = r"shape \(5, 5, 5\) and no affine, but the flattened volume has shape \(42, 32, 3\)"
        refused(told, sheet_map.image, np.ones((5, 5, 5)))
        refused("interpolation is 'cubic'", sheet_map.image, np.ones((42, 32, 3)), interpolation="cubic")

    def test_heat_map(self, ball_map):
        image = ball_map.heat_map(0.3)
        raster = ball_map.raster(0.3)
        inside, corners = raster.inside, ball_map.distortion.per_point[raster.corners[raster.inside]]
        assert (image.data[inside] >= corners.min(axis=1) - 1e-6).all()
        assert (image.data[inside] <= corners.max(axis=1) + 1e-6).all()
        assert np.isnan(image.data[~inside]).all()
        assert image.data.shape == ball_map.image(np.ones(ball_map.volume_shape), 0.3).data.shape

    def test_the_affine_places_pixels_in_the_plane(self, ball_map):
        image = ball_map.heat_map(0.5)
        place = image.affine @ [3, 7, 0, 1]  # of row 3, column 7
        np.testing.assert_allclose(place[:2], [image.origin[0] + 3.5, image.origin[1] - 1.5])
        left, right, bottom, top = image.extent
        np.testing.assert_allclose([right - left, top - bottom], np.array(image.data.shape)[::-1] * 0.5)
        np.testing.assert_allclose([left, top], (image.affine @ [-0.5, -0.5, 0, 1])[:2])  # the corner of pixel (0, 0)


class TestTexture:
    def test_a_picture_is_laid_over_the_map(self, sheet_map):
        low, high = sheet_map.uv.min(axis=0), sheet_map.uv.max(axis=0)
        found = sheet_map.texture(np.stack(np.mgrid[:400, :400][::-1], axis=-1).astype(float))
        expected = (sheet_map.uv - (low + high) / 2) * [1, -1] * 400 / (high - low).max() + 199.5
        np.testing.assert_allclose(found, np.clip(expected, 0, 399), atol=1e-6)

    def test_types_are_kept(self, sheet_map):
        found = sheet_map.texture(np.full((20, 30, 3), 77, dtype=np.uint8))
        assert (found.dtype, found.shape) == (np.uint8, (len(sheet_map), 3))
        assert (found == 77).all()
        assert sheet_map.texture(np.ones((4, 4), dtype=np.float32)).shape == (len(sheet_map),)

    @pytest.mark.parametrize("picture", [np.zeros(5), np.zeros((0, 4)), np.zeros((2, 2, 2, 2)), np.array([["a"]])])
    def test_what_is_no_picture(self, sheet_map, picture):
        refused("the picture has shape .* and data type", sheet_map.texture, picture)

    def test_painting_puts_values_at_their_voxels(self, ball_map):
        painted = ball_map.paint(np.arange(1, len(ball_map) + 1), background=-1)
        assert painted.shape == ball_map.volume_shape
        np.testing.assert_array_equal(painted[tuple(ball_map.ids.T)], np.arange(1, len(ball_map) + 1))
        assert (painted == -1).sum() == painted.size - len(ball_map)
        refused("values has shape", ball_map.paint, [1, 2, 3])


class TestFile:
    def test_a_saved_map_comes_back(self, ball_map, tmp_path):
        ball_map.save(tmp_path / "map.npz")
        loaded = voxflat.load(tmp_path / "map.npz")
        for name in ("uv", "points", "normals", "ids", "faces", "torn", "sources", "eigenvalues", "rows"):
            before, after = getattr(ball_map, name), getattr(loaded, name)
            np.testing.assert_array_equal(after, before)
            assert after.dtype == before.dtype, name
        np.testing.assert_array_equal(loaded.distortion.per_point, ball_map.distortion.per_point)
        np.testing.assert_equal(asdict(loaded.distortion.raw), asdict(ball_map.distortion.raw))
        assert loaded.metadata == ball_map.metadata
        np.testing.assert_array_equal(loaded.heat_map().data, ball_map.heat_map().data)
        assert [path.name for path in tmp_path.iterdir()] == ["map.npz"]

    def test_metadata_and_files_tell_the_fields(self, tmp_path):
        flat_map = voxflat.samples.hill().flatten(relax=False)
        origin = replace(flat_map.origin, unit="µm", measured_on=None)
        replace(flat_map, origin=origin, seed=7, warnings=("odd",), cuts_by="start").save(tmp_path / "map.npz")
        loaded = voxflat.load(tmp_path / "map.npz")
        assert (loaded.origin.unit, loaded.origin.measured_on) == ("µm", None)
        assert (loaded.seed, loaded.warnings, loaded.cuts_by) == (7, ("odd",), "start")
        back = replace(loaded, origin=flat_map.origin, seed=0, warnings=(), cuts_by=flat_map.cuts_by)
        assert back.metadata == flat_map.metadata
        with pytest.raises(TypeError, match="metadata"):  # which would change nothing
            replace(flat_map, metadata={})

    def test_metadata_says_how_the_map_came_about(self, ball_map):
        metadata = ball_map.metadata
        assert metadata["method"] == "grossmann2002"
        assert (metadata["seed_point"], metadata["radius"], metadata["sources"]) == ([28, 16, 16], 15.0, 200)
        assert metadata["shape"] == list(ball_map.volume_shape)
        assert metadata["versions"]["voxflat"] == voxflat.__version__
        assert len(metadata["input_sha256"]) == 64
        assert metadata["memory_need_bytes"] > 8 * 200**2
        assert metadata["warnings"] == []


def test_torn_faces_are_those_that_the_surface_does_not_have():
    # two parallel sheets, joined at one end: folded flat upon each other they would tear everywhere
    flat = grossmann2002(shapes.curled_sheet(60, 30, 1.4, Rotation.random(None, np.random.default_rng(1))), sources=100)
    links = np.abs(flat.ids[flat.faces][:, [0, 1, 2]] - flat.ids[flat.faces][:, [1, 2, 0]]).max(axis=2).max(axis=1)
    assert (flat.torn >= (links > 2)).all()  # two links reach two voxels at most
    assert not flat.torn[links <= 1].any()


class TestWarnings:
    def test_what_the_user_should_know_is_logged_and_kept(self, caplog):
        lonely = np.pad(shapes.sheet((30, 30)), [(0, 8), (0, 0), (0, 0)])
        lonely[10:14, 10:14] = 0  # a hole
        lonely[35:38, 5:9, 1] = 1  # and a second component
        components, holes = grossmann2002(lonely, sources=50).metadata["warnings"]
        assert components == "only the largest of 2 components is used (884 of 896 voxels)"
        assert holes.startswith("the patch is not a disk: its Euler characteristic is 0 instead of 1")
        logged = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
        assert logged == [components, holes]

    def test_a_seed_point_off_the_surface_is_told(self, ball):
        near = grossmann2002(ball, seed_point=(31, 16, 16), radius=12.0, sources=50)  # two voxels away
        assert near.metadata["warnings"] == []
        assert near.metadata["seed_found"] == [29, 16, 16]
        far = grossmann2002(ball, seed_point=(32, 16, 16), radius=12.0, sources=50)
        assert far.metadata["warnings"][0].startswith("the seed point [32, 16, 16] is 3.0 mm away from the surface;")
        np.testing.assert_array_equal(far.uv, near.uv)
        assert far.metadata["warnings"][0] in voxflat.check(ball, part=lambda s: s.disk((32, 16, 16), 12.0)).advice

    def test_a_torn_map_says_so(self):
        # an open cylinder cannot lie in the plane: its two halves come to lie upon each other
        i, j = np.mgrid[:24, :24]
        ring = np.abs(np.hypot(i - 11.5, j - 11.5) - 9) < 0.75
        flat = grossmann2002(np.repeat(ring[..., None], 30, axis=2), sources=200)
        assert flat.metadata["torn_faces"] > 0.3
        assert any("of the map is torn" in warning for warning in flat.metadata["warnings"])


def test_undefined_figures_are_null_in_json_and_nan_in_python(tmp_path):
    flat = grossmann2002(shapes.sheet((6, 6)), spacing=(40, 40, 40), sources=10)  # no pair is nearer than 30 mm
    assert np.isnan(flat.distortion.raw.relative_error_30mm)
    told = json.loads(json.dumps(flat.description(), allow_nan=False))
    assert told["distortion"]["raw"]["relative_error_30mm"] is None
    flat.save(tmp_path / "map.npz")
    assert np.isnan(voxflat.load(tmp_path / "map.npz").distortion.raw.relative_error_30mm)
