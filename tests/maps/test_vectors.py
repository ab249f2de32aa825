"""Vectors keep their lengths, angles and directions between the surface and the map."""

from dataclasses import replace

import numpy as np
import pytest
from brain_spaces import ball, header, to_scanner, write_freesurfer
from mesh_files import icosphere
from refusals import refused

import voxflat
from voxflat.methods import Voxflat

SPIN = np.array([0.2, -0.4, 0.7])


@pytest.fixture(scope="module")
def cap():
    """Return a strongly distorted map of a disk of 18 mm on a sphere."""
    m = voxflat.surface(icosphere(20.0, 4)).disk(0, 18.0).flatten(Voxflat(sources=30))
    return replace(m, uv=m.uv @ np.array([[1.6, 0.0], [0.5, 0.7]]))


@pytest.fixture(scope="module")
def middles(cap):
    """Return the centres of the triangles and their normals."""
    corners = cap.points[cap.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return corners.mean(axis=1), normals / np.linalg.norm(normals, axis=1, keepdims=True)


def test_there_and_back_is_the_tangential_part(cap, middles):
    points, normals = middles
    spin = np.cross(SPIN, points)
    uv, flat = cap.vectors_to_map(points, spin)
    again, back = cap.vectors_to_surface(uv, flat)
    np.testing.assert_allclose(again, points, atol=1e-9)
    np.testing.assert_allclose(back, spin - (spin * normals).sum(axis=1)[:, None] * normals, atol=1e-9)


def test_points_move_along_the_vectors(cap, middles):
    """A small step on the surface is the same step on the map."""
    points, normals = middles
    step = np.cross(SPIN, points) * 1e-4
    step -= (step * normals).sum(axis=1)[:, None] * normals
    uv, flat = cap.vectors_to_map(points, step)
    np.testing.assert_allclose(cap.points_to_map(points + step)[0] - uv, flat, atol=1e-8)
    moved = cap.look_up(uv + flat).points - points
    np.testing.assert_allclose(moved, step, atol=1e-8)


def test_lengths_and_angles_are_those_on_the_surface(cap):
    """Edges of triangles on the map are edges on the surface."""
    uv, points = cap.uv[cap.faces], cap.points[cap.faces]
    for a, b in ((0, 1), (0, 2), (1, 2)):
        _, along = cap.vectors_to_surface(uv.mean(axis=1), uv[:, b] - uv[:, a])
        np.testing.assert_allclose(along, points[:, b] - points[:, a], atol=1e-9)


def test_any_shape_of_arrays(cap, middles):
    points = middles[0][:6].reshape(2, 3, 3)
    uv, flat = cap.vectors_to_map(points, points)
    assert uv.shape == flat.shape == (2, 3, 2)
    assert cap.vectors_to_surface(uv, flat)[1].shape == (2, 3, 3)
    assert cap.vectors_to_surface(uv[0, 0], flat[0, 0])[1].shape == (3,)


def test_vectors_in_scanner_space_are_turned(tmp_path):
    points, faces = ball(2)
    of = header(axes=((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    write_freesurfer(tmp_path / "lh.white", points, faces, of)
    flat = voxflat.surface(tmp_path / "lh.white").disk(0, 40.0).flatten(Voxflat(sources=30))
    middle = flat.points[flat.faces].mean(axis=1)
    ends = to_scanner(middle, of), to_scanner(middle + SPIN, of)
    own = flat.vectors_to_map(middle, np.broadcast_to(SPIN, middle.shape))
    scanner = flat.vectors_to_map(ends[0], ends[1] - ends[0], space="scanner")
    np.testing.assert_allclose(scanner, own, atol=1e-5)
    assert np.abs(ends[1] - ends[0] - SPIN).max() > 0.1


def test_outside_there_is_nothing(cap):
    far = np.array([[500.0, 0, 0], cap.points[5]])
    for found in (cap.vectors_to_map(far, far), cap.vectors_to_surface(far[:, :2], far[:, :2])):
        for part in found:
            assert np.isnan(part[0]).all()
    assert np.isfinite(cap.vectors_to_map(far, far)[1][1]).all()


def test_refusals(cap):
    two, three = np.zeros((4, 2)), np.zeros((4, 3))
    refused(r"vectors has shape \(4, 2\), but points has \(4, 3\). Pass one vector", cap.vectors_to_map, three, two)
    refused(r"points has shape \(4, 2\)", cap.vectors_to_map, two, two)
    refused(r"vectors has shape \(4, 3\), but places has \(4, 2\)", cap.vectors_to_surface, two, three)
    refused(r"places has shape \(4, 3\)", cap.vectors_to_surface, three, two)
    refused("the vectors are 'a'. Pass numbers", cap.vectors_to_map, three, "a")
    refused("limit is -1", cap.vectors_to_map, three, three, -1)
    refused("space is 'MNI'", cap.vectors_to_map, three, three, space="MNI")


def test_vectors_far_from_the_surface_cause_the_same_warning_as_points(caplog):
    flat_map = voxflat.samples.hill().flatten()
    far = 1000 * (flat_map.points[:20])
    for call in (flat_map.points_to_map, lambda points: flat_map.vectors_to_map(points, np.ones_like(points))):
        caplog.clear()
        with caplog.at_level("WARNING", logger="voxflat"):
            call(far)
        assert len(caplog.messages) == 1
        assert "of 20 points are within" in caplog.messages[0]
        assert "in µm" in caplog.messages[0]
