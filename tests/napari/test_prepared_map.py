"""Prepared maps without a window: intersections with rays, and measures, compared with exact values."""

from itertools import pairwise

import dask.array as da
import numpy as np
import pytest
import zarr
from napari.layers import Image
from napari_window import prepared_map_of
from numpy.testing import assert_allclose, assert_array_equal
from textures import grid

from voxflat._napari.layers.sampled import shown
from voxflat._napari.layers.volumes import LayerVolume
from voxflat._napari.map_viewer.contents import drawing
from voxflat.distortion.triangles import angle_changes


def folded():
    """A coarse grid 4 mm above a fine one, joined along a side."""
    fine, faces = grid(41, 41, 0.25)
    coarse, coarser = grid(5, 5, 2.5)
    below = np.flatnonzero(fine[:, 1] == 0)[::10]
    above = np.flatnonzero(coarse[:, 1] == 0) + len(fine)
    walls = []
    for (a, b), (c, d) in zip(pairwise(below), pairwise(above), strict=True):
        walls += [[d, c, a], *([d, n + 1, n] for n in range(a, b))]
    points = np.concatenate([fine, coarse + np.array([0, 0, 4])])
    return points, np.concatenate([faces, coarser[:, ::-1] + len(fine), walls])


def test_a_ray_meets_the_triangle_in_front_however_large_it_is():
    points, faces = folded()
    prepared = prepared_map_of(points, faces)
    rng = np.random.default_rng(4)
    for x, y in rng.uniform(0.1, 9.9, (50, 2)):
        assert_allclose(prepared.met(np.array([x, y, 50.0]), np.array([0, 0, -1.0])), [x, y, 4], atol=1e-9)
        assert_allclose(prepared.met(np.array([x, y, -50.0]), np.array([0, 0, 2.0])), [x, y, 0], atol=1e-9)
    along = np.array([3.0, 4.0, 0]) - [30, 40, 70]
    assert_allclose(prepared.met(np.array([30.0, 40, 70]), along)[2], 4, atol=1e-9)
    assert prepared.met(np.array([-3.0, -3.0, 50]), np.array([0, 0, -1.0])) is None


def test_angles_of_a_stretched_plane():
    flat_map = prepared_map_of(*grid(9, 9, 1.25)).run.flat_map
    faces = flat_map.faces
    assert_allclose(angle_changes(flat_map.points, faces, flat_map.uv), 0, atol=0.1)
    found = angle_changes(flat_map.points, faces, flat_map.points[:, :2] * [2, 1])
    inside = np.all((flat_map.points[:, :2] > 0.1) & (flat_map.points[:, :2] < 9.9), axis=1)
    # of six angles two are right and stay so; 45 degrees become atan 2 or atan 1/2
    expected = 4 * (np.degrees(np.arctan(2)) - 45) / 6
    assert_allclose(found[inside], expected, rtol=1e-6)


@pytest.mark.parametrize("kind", ["dask", "zarr"])
def test_only_chunks_at_the_surface_are_read(kind):
    """Of two channels and two scales, only chunks of one channel of the finest scale are read."""
    along = np.indices((40, 40, 40))[0].astype(np.float32)
    channels, read = np.stack([along, 100 + 2 * along]), []

    def block(values, block_info=None):
        if block_info:
            read.append(block_info[0]["chunk-location"])
        return values

    levels = [channels, channels[:, ::2, ::2, ::2]]
    if kind == "dask":
        levels = [da.from_array(level, chunks=(1, 8, 8, 8)).map_blocks(block, dtype=np.float32) for level in levels]
    else:
        levels = [zarr.array(level, chunks=(1, 8, 8, 8)) for level in levels]
    layer = Image(levels, multiscale=True, units=("pixel", *("um",) * 3), scale=(1, 250, 250, 250), name="microscope")
    volume = LayerVolume.of(layer, step=(1,)).read()
    assert_array_equal(volume.data, channels[1])  # of the finest level
    assert_allclose(volume.affine, np.diag([250, 250, 250, 1]))
    assert volume.unit == "µm"
    points, faces = grid(21, 21, 0.25)  # mm: voxels 2 to 22 of 0.25 mm
    prepared = prepared_map_of(points + np.array([0.5, 0.5, 3.1]), faces)
    read.clear()
    picture = drawing(shown(layer, "RAS", depth=0.0, step=(1,)))(prepared)
    flat_map = prepared.run.flat_map
    x = flat_map.raster(prepared.pixel_size).interpolate(flat_map.points[:, :1])[..., 0]
    assert_allclose(picture.data, 100 + 2 * x / 0.25, atol=1e-3)
    assert picture.scale.title == "microscope"
    if kind == "dask":
        assert {place[0] for place in read} == {1}
        assert {place[1] for place in read} | {place[2] for place in read} <= {0, 1, 2}  # of five
        assert {place[3] for place in read} == {1}
