"""Triangles of a textured surface are divided where the map tears or bends."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused
from textures import areas, grid, side_counts

from voxflat.maps.textures.textured import TexturedSurface


class TestSubdivision:
    def flat(self, picture, rows=3, columns=3, step=4.0, repeat=False):
        points, faces = grid(rows, columns, step)
        return TexturedSurface(points, faces, points[:, :2] / points[:, :2].max(), picture, repeat)

    def test_nothing_is_split_where_colours_carry_the_picture(self):
        even = np.full((64, 64, 3), 90, dtype=np.uint8)
        assert len(self.flat(even).subdivided().faces) == 8
        ramp = np.repeat(np.arange(64, dtype=np.uint8)[:, None, None] * 4, 64, axis=1)
        assert len(self.flat(ramp, 9, 9).subdivided().faces) == 128

    def test_only_what_needs_it_is_split(self):
        """A black spot at the centre of one of 128 triangles: all that are far from it stay."""
        picture = np.full((128, 128, 3), 255, dtype=np.uint8)
        picture[70:74, 20:24] = 0  # at (22, 128 − 72) of 128
        before = self.flat(picture, 9, 9)
        after = before.subdivided()
        whole = {tuple(face) for face in after.faces.tolist()}
        split = np.array([tuple(face) not in whole for face in before.faces.tolist()])
        centres = 128 * before.texture_coordinates[before.faces].mean(axis=1)
        assert 1 <= split.sum() <= 24
        assert np.linalg.norm(centres[split] - [22, 56], axis=1).max() < 3 * 16
        assert len(after.faces) > 128 + 32

    @pytest.mark.slow
    @given(st.integers(0, 2**32 - 1), st.sampled_from([4.0, 16.0, 100.0]), st.booleans())
    def test_the_surface_stays_and_carries_the_picture(self, seed, tolerance, repeat):
        rng = np.random.default_rng(seed)
        points, faces = grid(4, 5)
        coordinates = (points[:, :2] + rng.uniform(-0.2, 0.2, (20, 2))) / 5 * (2 if repeat else 1)
        points = points + rng.normal(size=points.shape)
        picture = np.kron(rng.integers(0, 256, (5, 6, 3)), np.ones((4, 4, 1))).astype(np.uint8)
        before = TexturedSurface(points, faces, coordinates, picture, repeat)
        after = before.subdivided(tolerance)
        n = len(points)
        assert_array_equal(after.points[:n], points)
        assert_array_equal(after.texture_coordinates[:n], coordinates)
        # no cracks: every side has two triangles but those of the boundary, which is as long as before; one disk
        sides, counts = side_counts(after.faces)
        sides_before, counts_before = side_counts(faces)
        assert counts.max() == 2
        length = lambda p, s: np.linalg.norm(p[s[:, 0]] - p[s[:, 1]], axis=1).sum()  # noqa: E731
        assert_allclose(length(after.points, sides[counts == 1]), length(points, sides_before[counts_before == 1]))
        assert len(after.points) - len(sides) + len(after.faces) == 1
        # the same shape: area and volume below it, and each triangle's way round
        assert_allclose(areas(after.points, after.faces).sum(), areas(points, faces).sum())
        a, b, c = after.texture_coordinates[after.faces].transpose(1, 2, 0)
        turn = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        assert (turn > 0).all()
        # halfway along the sides of triangles longer than a texel; colours are rounded
        corners = after.texture_coordinates[after.faces]
        ahead = np.roll(corners, -1, axis=1)
        is_long = np.linalg.norm((ahead - corners) * picture.shape[1::-1], axis=2).max(axis=1) > 1
        colours = after.colours.astype(float)[after.faces]
        true = replace(after, texture_coordinates=((corners + ahead) / 2).reshape(-1, 2)).colours.reshape(-1, 3)
        off = np.abs((colours + np.roll(colours, -1, axis=1)).reshape(-1, 3) / 2 - true)
        assert off[np.repeat(is_long, 3)].max(initial=0) <= tolerance + 1

    def test_angles_stay(self, textured):
        def least_angle(surface):
            corners = surface.texture_coordinates[surface.faces]
            ahead = np.roll(corners, -1, axis=1) - corners
            back = np.roll(corners, 1, axis=1) - corners
            cosine = (ahead * back).sum(axis=2) / np.linalg.norm(ahead, axis=2) / np.linalg.norm(back, axis=2)
            return np.arccos(cosine).min()

        assert least_angle(textured.subdivided()) >= least_angle(textured) / 2 - 1e-9

    @pytest.mark.parametrize("tolerance", [0, -1, np.nan, np.inf])
    def test_tolerances(self, textured, tolerance):
        refused(r"tolerance is .*; give a positive number", textured.subdivided, tolerance)

    def test_too_fine_a_picture_is_refused(self, textured, monkeypatch):
        monkeypatch.setattr("voxflat.maps.textures.subdivision._MOST_FACES", 5000)
        refused(r"64 x 64 texels need more than 5000 triangles; give a greater tolerance", textured.subdivided)
