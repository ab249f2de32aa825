"""Flattening after Zigelman, Kimmel and Kiryati (2002), and range images."""

import composed
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused
from scipy.spatial.distance import pdist
from triangle_meshes import cylinder

import voxflat
from voxflat.methods import Zigelman2002


def waves(side=60):
    """Return the depths of a graph of sin x sin y."""
    x = np.linspace(0, 2 * np.pi, side)
    return 0.8 * np.outer(np.sin(x), np.sin(x)) * side / (2 * np.pi)


class TestFlatten:
    @pytest.mark.slow
    @pytest.mark.parametrize("sampling", [None, "decimation", "farthest", "random"])
    def test_a_cylinder_is_unrolled(self, sampling):
        mesh, truth = cylinder()
        flat = composed.flatten(mesh, method="zigelman2002", sources=200, sampling=sampling)
        chosen = np.random.default_rng(0).choice(len(truth), 400, replace=False)
        assert np.abs(pdist(flat.uv[chosen]) / pdist(truth[flat.ids[chosen]]) - 1).mean() < 0.005
        assert flat.distortion.raw.relative_error < 0.005
        assert flat.distortion.triangles.flipped == 0
        assert flat.metadata["sampling"] == (sampling or "decimation")
        assert flat.metadata["placed_by"] == "re-insertion"

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"sampling": "best"}, "is 'best'. Pass 'decimation', 'farthest', 'curvature', 'random' or 'grid'"),
            ({"sampling": "grid"}, "is not a range image. Create one with voxflat.range_image"),
            ({"sampling": "grid", "sources": [1, 5, 9]}, "chooses the sources itself"),
            ({"sources": 2}, "2 sources are too few. Pass at least 3"),
            ({"sources": [4, 4, 9]}, "source 4 is given 2 times"),
            ({"rows": "directory"}, "cannot write a store"),
            ({"method": "voxflat", "sampling": "decimation"}, "Pass 'farthest', 'curvature' or 'random'"),
        ],
    )
    def test_wrong_options_are_named(self, options, message):
        refused(message, composed.flatten, cylinder()[0], **{"method": "zigelman2002", **options})

    @pytest.mark.medium
    def test_a_map_of_a_range_image_is_kept_in_a_file(self, tmp_path):
        image = voxflat.range_image(waves(40), 1.0, jump=np.inf)
        flat = voxflat.flatten(image, Zigelman2002(sources=200), rows=True)
        flat.save(tmp_path / "map.npz")
        again = voxflat.load(tmp_path / "map.npz")
        np.testing.assert_array_equal(again.uv, flat.uv)
        np.testing.assert_array_equal(again.rows, flat.rows)
        assert again.metadata["range_image"] == {"shape": [40, 40], "spacing": [1.0, 1.0], "jump": None, "cut": 0}

    @pytest.mark.medium
    def test_a_slope_is_placed_exactly_on_a_grid(self):
        row, column = np.indices((50, 70))
        image = voxflat.range_image(0.5 * column + 0.25 * row, (2.0, 1.5))
        flat = voxflat.flatten(image, method=Zigelman2002(sources=100, sampling="grid"))
        chosen = np.arange(0, len(flat), 17)
        np.testing.assert_allclose(pdist(flat.uv[chosen]), pdist(flat.points[chosen]), rtol=1e-4)
        assert flat.distortion.triangles.flipped == 0
        assert "grid" in flat.metadata["placed_by"]

    @pytest.mark.medium
    def test_a_cut_surface_has_no_grid(self):
        row, column = np.indices((40, 40))
        ring = np.hypot(row - 20, column - 20)
        image = voxflat.range_image(np.zeros((40, 40)), 1.0, mask=(ring > 8) & (ring < 19))
        told = r"the surface is cut: pixel \(\d+, \d+\) lies on both sides"
        refused(told, voxflat.flatten, image, method=Zigelman2002(sources=64, sampling="grid"))


class TestRangeImage:
    def test_points_are_seen_upright_from_z(self):
        image = voxflat.range_image(np.arange(6.0).reshape(2, 3), (3.0, 2.0))
        assert image.points.tolist() == [[0, 0, 0], [2, 0, 1], [4, 0, 2], [0, -3, 3], [2, -3, 4], [4, -3, 5]]
        a, b, c = image.points[image.faces].transpose(1, 0, 2)
        assert (np.cross(b - a, c - a)[:, 2] > 0).all()
        assert image.ids.tolist() == list(range(6))

    @settings(max_examples=60)
    @given(st.integers(0, 2**32 - 1))
    def test_every_pixel_that_can_be_is_a_vertex(self, seed):
        rng = np.random.default_rng(seed)
        depth = rng.uniform(0, 1, size=rng.integers(2, 9, size=2))
        depth[rng.random(depth.shape) < 0.2] = np.nan
        there = np.isfinite(depth)
        squares = there[:-1, :-1].astype(int) + there[1:, :-1] + there[1:, 1:] + there[:-1, 1:]
        if squares.max() < 3:
            refused("no triangle", voxflat.range_image, depth, 1.0)
            return
        image = voxflat.range_image(depth, 1.0)
        assert len(image.faces) == np.clip(squares - 2, 0, None).sum()  # three pixels make a triangle, four make two
        row, column = np.unravel_index(image.ids, depth.shape)
        np.testing.assert_array_equal(image.points, np.stack([column, -row, depth[row, column]], axis=1))

    def test_depth_jumps_are_cut_and_told(self):
        depth = np.zeros((30, 40))
        depth[:, 20:] = 50
        image = voxflat.range_image(depth, 1.0)
        assert image.metadata["range_image"]["cut"] == 2 * 29
        assert any("58 of 2262 triangles, which span more than 8 mm" in warning for warning in image.warnings)
        assert len(voxflat.check(image).components) == 2
        whole = voxflat.range_image(depth, 1.0, jump=np.inf)
        assert whole.metadata["range_image"]["cut"] == 0
        assert len(voxflat.check(whole).components) == 1
        assert whole.warnings == ()

    def test_pieces_that_touch_in_a_pixel_are_apart(self):
        depth = np.full((5, 5), np.nan)
        depth[:3, :3], depth[2:, 2:], depth[2, 2] = 6.0, -6.0, 0.0
        image = voxflat.range_image(depth, 1.0)
        assert len(voxflat.check(image).components) == 2
        assert (image.ids == 12).sum() == 2

    def test_masks_and_masked_arrays_mean_the_same(self):
        depth = waves(20)
        there = np.random.default_rng(1).random(depth.shape) < 0.9
        by_nan = voxflat.range_image(np.where(there, depth, np.nan), 1.0)
        whole = {"mask": there.astype(np.uint8), "spacing": [1, 1]}
        for how in ({"mask": there}, whole, {"depth": np.ma.MaskedArray(depth, ~there)}):
            other = voxflat.range_image(**{"depth": depth, "spacing": 1.0, **how})
            np.testing.assert_array_equal(by_nan.points, other.points)
            np.testing.assert_array_equal(by_nan.faces, other.faces)
            assert by_nan.metadata == {**other.metadata, "provenance": by_nan.provenance}
            assert other.provenance["function"] == "range_image"

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ({"depth": np.zeros(5)}, r"depth has shape \(5,\). Pass an array"),
            ({"depth": np.zeros((1, 9))}, r"depth has shape \(1, 9\). Pass an array"),
            ({"depth": np.zeros((3, 3, 3))}, r"depth has shape \(3, 3, 3\)"),
            ({"depth": np.zeros((3, 3), complex)}, "depth has data type complex128. Pass real numbers"),
            ({"depth": np.array([["a", "b"], ["c", "d"]])}, "depth has data type <U1. Pass real numbers"),
            ({"depth": [[1, 2], [3]]}, "the rows of depth have different lengths"),
            ({"depth": np.array([[1, np.inf], [2, 3]])}, "row 0, column 1 is inf mm. Pass NaN"),
            ({"depth": np.array([[1, 2], [-1e30, 3]])}, r"row 1, column 0 is -1e\+30 mm"),
            ({"depth": np.full((4, 4), np.nan)}, r"no triangle .* \(0 of 16 pixels have a depth\)"),
            ({"depth": np.diag([1.0, 1, 1]) / np.diag([1.0, 1, 1])}, r"no triangle .* \(3 of 9 pixels"),
            ({"depth": 1e5 * np.indices((3, 3))[0]}, "spans more than 8 mm of depth. Increase jump"),
            ({"spacing": 0}, "spacing is 0 mm. Pass numbers"),
            ({"spacing": -1.0}, "spacing is -1.0 mm. Pass numbers"),
            ({"spacing": np.nan}, "spacing is nan mm. Pass numbers"),
            ({"spacing": (1, np.inf)}, r"spacing is \(1, inf\) mm. Pass numbers"),
            ({"spacing": (1, 2, 3)}, r"spacing is \(1, 2, 3\). Pass one number"),
            ({"spacing": "1"}, "spacing is '1'. Pass one number"),
            ({"mask": np.ones((2, 2))}, r"the shapes of mask \(2, 2\) and depth \(9, 9\) differ"),
            ({"mask": np.full((9, 9), 7)}, r"mask \(int64\) has values other than 0 and 1"),
            ({"mask": np.zeros((9, 9), bool)}, r"no triangle .* \(0 of 81 pixels"),
            ({"jump": 0.0}, "jump is 0.0 mm. Pass a positive"),
            ({"jump": np.nan}, "jump is nan mm. Pass a positive"),
            ({"jump": "far"}, "jump is 'far' mm. Pass a positive"),
        ],
    )
    @pytest.mark.filterwarnings("ignore:invalid value")
    def test_bad_input_is_named(self, arguments, message):
        refused(message, voxflat.range_image, **{"depth": np.zeros((9, 9)), "spacing": 1.0, **arguments})

    def test_integers_are_depths_too(self):
        image = voxflat.range_image(np.arange(16, dtype=np.uint8).reshape(4, 4), 1)
        assert image.points[5].tolist() == [1, -1, 5]
