"""A surface whose curvature lies at few vertices is cut open at them, where this improves its map clearly."""

import re

import developable_shapes
import numpy as np
import pytest
from developable_shapes import edge_ratios
from hard_shapes import turned

import voxflat


def cone(height):
    """Return a cone with a base of radius 30 mm, closed around its apex."""
    radii = [*range(30, 3, -1), 1]  # the point at the end is a third of the last step away
    return turned([(radius, -height * radius / 30) for radius in radii], 20, closed=True)


@pytest.mark.slow
@pytest.mark.parametrize("height", [30.0, 60.0])
def test_a_cone_is_cut_to_its_apex_and_nearly_exact(height):
    flat_map = voxflat.flatten(cone(height))
    assert [cut.reason for cut in flat_map.cuts] == ["cone point"]
    slant = np.hypot(30, height)
    assert abs(flat_map.cuts[0].length / slant - 1) < 0.02
    assert flat_map.distortion.best_scale.relative_error < 0.01
    assert flat_map.distortion.triangles.flipped == 0
    [warning] = flat_map.warnings
    before, after = map(float, re.search(r"from ([\d.]+) % to ([\d.]+) %", warning).groups())
    assert "nearly all of the curvature lies at one vertex" in warning
    assert 4 < before > 2 * after
    uncut = voxflat.flatten(cone(height), relax=False)
    assert uncut.cuts == ()
    assert uncut.distortion.best_scale.relative_error > 0.04


@pytest.mark.slow
def test_a_closed_cube_is_cut_along_its_edges():
    points, faces = developable_shapes.closed_cube()
    flat_map = voxflat.flatten((points, faces))
    assert [cut.reason for cut in flat_map.cuts] == 7 * ["cone point"]
    assert np.allclose([cut.length for cut in flat_map.cuts], 20.0)
    ratios = edge_ratios(flat_map.points, flat_map.faces, flat_map.uv)
    assert np.abs(ratios - 1).max() < 0.002


@pytest.mark.slow
def test_a_poor_map_of_chosen_cuts_says_what_relaxation_cuts_would_achieve():
    tall = voxflat.surface(
        turned([(30 * np.sin(a), 30 * np.cos(a)) for a in np.linspace(2.7, 0, 24)[:-1]], 48, closed=True)
    )
    flat_map = tall.flatten(cuts=[])
    [warning] = [text for text in flat_map.warnings if "even at the best scale" in text]
    before, after = map(float, re.search(r"relax=True .* from ([\d.]+) % to ([\d.]+) %", warning).groups())
    relaxed = tall.flatten(cuts=[], relax=True)
    assert not any("even at the best scale" in text for text in relaxed.warnings)
    error, better = (100 * one.distortion.best_scale.relative_error for one in (flat_map, relaxed))
    assert abs(before - error) < 0.3 * error
    assert better < 0.7 * error
    assert after < 0.7 * before
