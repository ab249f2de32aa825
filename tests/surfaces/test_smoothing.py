"""A smoothed surface has lost its short waves, and nothing else."""

import numpy as np
import pytest
import pyvista as pv
import tifffile
from command_line import succeed
from refusals import refused

import voxflat


def wave(length, size=81):
    """Return a sheet with a wave along x, of length `length` and height 0.1, sampled at steps of 1."""
    x = np.arange(size) - size // 2
    return voxflat.range_image(np.tile(0.1 * np.cos(2 * np.pi * x / length)[:, None], (1, size)), 1.0)


def height(surface):
    """Return the height of the wave in the middle of the sheet."""
    x, y, z = (surface.points - surface.points.mean(axis=0)).T
    return np.ptp(z[(abs(x) < 21) & (abs(y) < 21)]) / 2


@pytest.mark.medium
@pytest.mark.parametrize(("of", "kept"), [(10, 1 / 17), (20, 1 / 2), (40, 16 / 17)])
def test_waves_shorter_than_the_length_are_removed(of, kept):
    sheet = wave(of)
    assert height(sheet.smooth(20.0)) / height(sheet) == pytest.approx(kept, abs=0.03)


def test_a_tilted_plane_keeps_its_shape_and_its_boundary():
    x, y = np.meshgrid(np.arange(20.0), np.arange(15.0), indexing="ij")
    sheet = voxflat.range_image(0.4 * x - 0.2 * y, 1.0)
    np.testing.assert_allclose(sheet.smooth(10.0).points, sheet.points, atol=1e-9)


def test_a_sphere_does_not_shrink():
    sphere = voxflat.surface(pv.Icosphere(radius=50.0, nsub=4), unit="µm")
    told = sphere.smooth(50.0).metadata["smoothed"]
    assert -0.008 < told["volume_change"] < 0  # (50 / (2 π · 50))⁴ · 4 · 3
    assert told["mean"] < 0.15


def noisy(spacing=(0.5, 0.5, 1.5), axes=(20.0, 14.0, 12.0)):
    """Return noisy labels of an ellipsoid, and its centre."""
    shape = [int(2 * (axis + 3) / step) for axis, step in zip(axes, spacing, strict=True)]
    centre = (np.array(shape) - 1) / 2 * spacing
    places = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1) * spacing - centre
    depth = (1 - np.linalg.norm(places / axes, axis=-1)) * 12 + np.random.default_rng(0).normal(scale=0.4, size=shape)
    return (depth > 0).astype(np.uint8), centre


def errors(surface, centre, axes=(20.0, 14.0, 12.0)):
    """Return the distance from the ellipsoid (root mean square), and the 95th percentile of the angle of normals."""
    places = (surface.points - centre) / axes
    radius = np.linalg.norm(places, axis=1)
    normals = places / axes / np.linalg.norm(places / axes, axis=1, keepdims=True)
    distance = (radius - 1) * radius / np.linalg.norm(places / axes, axis=1)
    angles = np.degrees(np.arccos(np.clip((normals * surface.core.normals).sum(axis=1), -1, 1)))
    return np.sqrt((distance**2).mean()), np.percentile(angles, 95)


@pytest.mark.medium
def test_noisy_labels_with_long_voxels_become_smooth(tmp_path):
    labels, centre = noisy()
    how = {"metadata": {"spacing": 1.5, "unit": "um", "axes": "CZYX"[1:]}, "resolution": (2, 2)}
    tifffile.imwrite(tmp_path / "labels.tif", labels.T, imagej=True, **how)
    rough = voxflat.surface(tmp_path / "labels.tif", repair="voxels")
    smooth = rough.smooth(6.0)
    assert "µm on average (95 %: " in smooth.warnings[-1]
    assert " mm" not in smooth.warnings[-1]
    (before, rough_angle), (after, angle) = errors(rough, centre), errors(smooth, centre)
    assert after < 0.8 * before
    assert angle < 0.5 * rough_angle
    told = smooth.metadata["smoothed"]
    moved = np.linalg.norm(smooth.points - rough.points, axis=1)
    assert 0 < told["mean"] < told["p95"] < moved.max()
    np.testing.assert_array_equal(smooth.ids, rough.ids)
    assert smooth.provenance["parameters"]["length"] == 6.0
    np.testing.assert_array_equal(rough.smooth(6.0).points, smooth.points)
    assert smooth.flatten().metadata["smoothed"] == told


@pytest.mark.medium
def test_the_command_line_smooths_a_channel(tmp_path):
    labels, _ = noisy()
    stack = np.stack([np.zeros_like(labels.T), labels.T])
    sizes = {f"PhysicalSize{axis}": size for axis, size in zip("XYZ", (0.5, 0.5, 1.5), strict=True)}
    tifffile.imwrite(tmp_path / "s.ome.tif", stack, metadata={"axes": "CZYX", "Channel": {"Name": ["a", "b"]}, **sizes})
    given = ["surface", tmp_path / "s.ome.tif", "--smooth", "6", "--repair", "voxels"]
    for channel in ("1", "b"):
        output = succeed(*given, "--channel", channel, "-o", tmp_path / f"{channel}.ply").output
        assert "µm on average" in output
    np.testing.assert_array_equal(
        voxflat.surface(tmp_path / "1.ply").points, voxflat.surface(tmp_path / "b.ply").points
    )


def test_what_cannot_be_smoothed_is_refused():
    sheet = wave(20)
    for length in (0, -1.0, np.nan, np.inf):
        refused("length is .*Pass the length of the shortest waves", sheet.smooth, length)
    refused("the length is 'x'. Pass a number", sheet.smooth, "x")
    refused("length is 999 mm, but the surface is only 113 mm long. Pass a smaller length", sheet.smooth, 999.0)
    refused("is a part of another one", sheet.disk(3000, 9.0).smooth, 5.0)
    points, faces = sheet.points, sheet.faces
    pair = voxflat.surface((points, faces), pial=(points + np.array([0, 0, 2.0]), faces))
    refused("lies between a white and a pial surface", pair.smooth, 5.0)
    with pytest.raises(voxflat.Cancelled):
        sheet.smooth(9.0, progress=lambda *_: False)


def test_the_report_gives_mean_and_95th_percentile_of_the_distances_moved():
    sheet = voxflat.range_image(np.random.default_rng(0).normal(scale=0.02, size=(60, 60)), 1.0)
    smooth = sheet.smooth(20.0)
    moved = np.abs(smooth.points - sheet.points)[:, 2]  # the sheet is nearly level
    told = smooth.metadata["smoothed"]
    assert told["mean"] == pytest.approx(moved.mean(), rel=0.01)
    assert told["p95"] == pytest.approx(np.sort(moved)[int(0.95 * len(moved))], rel=0.01)


@pytest.mark.parametrize("turned", [False, True])
def test_squares_of_a_range_image_are_split_along_the_shorter_diagonal(turned):
    heights = np.array([[0.0, 1.0], [5.0, 0.0]])
    shared = {0, 3}  # pixels of equal depth
    if turned:
        heights, shared = heights[:, ::-1], {1, 2}
    faces = voxflat.range_image(heights, 1.0).faces.tolist()
    assert len(faces) == 2
    assert all(shared < set(face) for face in faces)


def test_range_images_are_cut_at_steps_of_more_than_eight_pixels():
    assert len(voxflat.range_image([[0.0, 0.0], [15.9, 15.9]], 2.0).faces) == 2
    refused("more than 16 mm", voxflat.range_image, [[0.0, 0.0], [16.1, 16.1]], 2.0)
