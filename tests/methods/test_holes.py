"""A surface with holes keeps them on its map where no cut would improve the map."""

import developable_shapes
import numpy as np
import pytest
import shapes
from developable_shapes import edge_ratios
from hard_shapes import turned

import voxflat

HOLE = np.array([30.0, 30.0])  # the middle of the hole


@pytest.fixture(scope="module", params=["annulus", "plate_with_hole"])
def shape(request):
    return getattr(developable_shapes, request.param)()


@pytest.fixture(scope="module")
def flat_map(shape):
    return voxflat.flatten(shape[:2])


def loops(flat_map):
    return voxflat.measure((flat_map.points, flat_map.faces), flat_map.uv).topology["loops"]


@pytest.mark.slow
class TestADevelopableSurfaceWithAHole:
    def test_is_flattened_without_a_cut_or_a_fold(self, flat_map):
        triangles = flat_map.distortion.triangles
        assert (flat_map.cuts, flat_map.warnings, triangles.flipped, triangles.crossings) == ((), (), 0, 0)
        assert loops(flat_map) == 2
        ratios = edge_ratios(flat_map.points, flat_map.faces, flat_map.uv)
        assert np.abs(ratios - 1).max() < 0.002

    def test_has_a_hole_in_its_image_too(self, shape, flat_map):
        image = flat_map.image(shape.flat[:, 0], pixel_size=1.0)
        covered = np.isfinite(image.data)
        area = np.linalg.det(np.diff(shape.flat[shape.faces], axis=1)).sum() / 2
        assert abs(covered.sum() / area - 1) < 0.05
        middle = np.round(np.mean(np.nonzero(covered), axis=1)).astype(int)
        assert not covered[middle[0] - 5 : middle[0] + 5, middle[1] - 5 : middle[1] + 5].any()

    def test_is_saved_with_its_hole(self, flat_map, tmp_path):
        flat_map.save(tmp_path / "ring.voxflat")
        again = voxflat.load(tmp_path / "ring.voxflat")
        assert loops(again) == 2
        np.testing.assert_array_equal(again.uv, flat_map.uv)

    def test_continues_from_a_map_with_the_hole(self, shape, flat_map):
        again = voxflat.flatten(shape[:2], voxflat.methods.Voxflat(start=flat_map))
        assert loops(again) == 2
        assert again.distortion.best_scale.relative_error < 1.1 * flat_map.distortion.best_scale.relative_error

    def test_is_cut_open_by_a_method_that_requires_a_disk(self, shape):
        surface = voxflat.surface(shape[:2])
        for flat_map in (surface.flatten("zigelman2002"), surface.cut().flatten("zigelman2002")):
            assert loops(flat_map) == 1
            assert [cut.reason for cut in flat_map.cuts] == ["boundaries joined"]
            assert any("so it was cut open along 1 path" in warning for warning in flat_map.warnings)


def plate(*holes):
    """Return a flat mesh of 60 by 60 mm without the squares of 10 mm at these corners."""
    return developable_shapes.plate(
        1, lambda x, y: ~np.any([(x > a) & (x < a + 10) & (y > b) & (y < b + 10) for a, b in holes], axis=0)
    )


@pytest.mark.slow
def test_many_holes_are_kept():
    points, faces, _ = plate((10, 10), (10, 30), (40, 10), (30, 30))
    flat_map = voxflat.flatten((points, faces))
    assert (flat_map.cuts, flat_map.distortion.triangles.flipped, loops(flat_map)) == ((), 0, 5)
    assert np.abs(edge_ratios(flat_map.points, flat_map.faces, flat_map.uv) - 1).max() < 0.002


@pytest.mark.slow
def test_a_longer_boundary_of_a_hole_is_not_taken_for_the_outer_one():
    def keep(x, y):  # a hole with the outline of a comb, which is longer than the outer boundary
        is_in = (np.abs(x - 30) < 22) & (np.abs(y - 30) < 22)
        return ~(is_in & ((x % 8 < 4) | (np.abs(y - 30) < 3)))

    points, faces, _ = developable_shapes.plate(1, keep)
    flat_map = voxflat.flatten((points, faces))
    triangles = flat_map.distortion.triangles
    assert (flat_map.cuts, flat_map.warnings, loops(flat_map)) == ((), (), 2)
    assert (triangles.flipped, triangles.crossings) == (0, 0)
    assert np.abs(edge_ratios(points, faces, flat_map.uv) - 1).max() < 0.002


@pytest.mark.slow
@pytest.mark.parametrize("height", [30, 60])
def test_a_tube_is_cut_open(height):
    tube = turned([(10.0, float(z)) for z in range(0, height + 1, 2)], 48, closed=False)
    flat_map = voxflat.flatten(tube)
    assert [cut.reason for cut in flat_map.cuts] == ["boundaries joined"]
    assert np.abs(edge_ratios(flat_map.points, flat_map.faces, flat_map.uv) - 1).max() < 0.002


@pytest.mark.medium
def test_a_sheet_of_voxels_keeps_its_hole():
    sheet = shapes.sheet((30, 30))
    sheet[12:20, 12:20] = 0
    flat_map = voxflat.flatten(sheet)
    assert (flat_map.cuts, loops(flat_map)) == ((), 2)
