import anatomy
import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial import ConvexHull

pytestmark = pytest.mark.slow  # what its fixtures make takes seconds

CENTRE = np.array([3.3, -20.1, 7.7])


def hull(points):
    """Return the convex hull of points as an outward mesh, and the equations of its planes."""
    solid = ConvexHull(points)
    corners = points[solid.simplices]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum("ij,ij->i", normals, solid.equations[:, :3]) < 0
    faces = solid.simplices.copy()
    faces[inward] = faces[inward, ::-1]
    return points, faces, solid


def blocks(mask):
    """Return the outward faces of unit cubes at integer corners, an exact reference for any shape."""
    points, faces = [], []
    padded = np.pad(mask, 1)
    for axis in range(3):
        u, v = np.eye(3)[[(axis + 1) % 3, (axis + 2) % 3]]
        for side in (0, 1):
            bare = mask & ~np.roll(padded, 1 - 2 * side, axis=axis)[1:-1, 1:-1, 1:-1]
            for corner in np.argwhere(bare) + side * np.eye(3)[axis]:
                start = len(points)
                points += [corner, corner + u, corner + u + v, corner + v]
                quad = np.array([[0, 1, 2], [0, 2, 3]]) + start
                faces += list(quad if side else quad[:, ::-1])
    return np.array(points, dtype=float), np.array(faces)


def centres(labels, affine):
    """Return the centres of the voxels in mm."""
    return np.moveaxis(np.indices(labels.shape), 0, -1) @ affine[:3, :3].T + affine[:3, 3]


def components(mask):
    return ndimage.label(mask)[1]


@pytest.mark.parametrize("spacing", [0.8, (0.5, 0.9, 1.3)])
def test_polyhedron_lies_where_its_affine_says(spacing):
    rng = np.random.default_rng(3)
    points, faces, solid = hull(CENTRE + rng.normal(size=(60, 3)) * [4, 6, 9])
    labels, affine, fraction = anatomy.voxelise(points, faces, spacing, pad=2)
    normals, offsets = solid.equations[:, :3], solid.equations[:, 3]
    depth = (centres(labels, affine) @ normals.T + offsets).max(axis=-1)
    sure = np.abs(depth) > 1e-6
    np.testing.assert_array_equal(labels[sure] == 1, depth[sure] < 0)
    np.testing.assert_allclose(np.diag(affine)[:3], spacing)
    assert fraction.sum(dtype=float) * np.prod(np.diag(affine)) == pytest.approx(solid.volume, rel=2e-3)
    assert labels[:2].sum() == labels[:, :2].sum() == labels[:, :, :2].sum() == 0
    assert labels[-2:].sum() == labels[:, -2:].sum() == labels[:, :, -2:].sum() == 0


@pytest.mark.parametrize("seed", range(3))
def test_folded_shapes_with_handles_and_cavities(seed):
    mask = np.random.default_rng(seed).random((7, 8, 9)) < 0.6
    largest = anatomy.largest_component(mask)
    labels, _, fraction = anatomy.voxelise(*blocks(mask), 0.5, pad=1)
    occupied = np.argwhere(mask)
    box = tuple(map(slice, occupied.min(axis=0), occupied.max(axis=0) + 1))
    expected = np.pad(np.kron(largest[box], np.ones((2, 2, 2), dtype=bool)), [(1, 2)] * 3)
    np.testing.assert_array_equal(labels == 1, expected)
    assert fraction.sum(dtype=float) / 8 == pytest.approx(mask.sum(), rel=1e-6)  # all components


def test_parts_inside_parts_and_faces_that_are_all_inward():
    outer, inner = blocks(np.ones((7, 7, 7), dtype=bool)), blocks(np.ones((3, 3, 3), dtype=bool))
    points = np.vstack([outer[0], inner[0] + 2]) + 0.1
    alone = anatomy.voxelise(points, outer[1], 0.5)[0]
    np.testing.assert_array_equal(alone, anatomy.voxelise(points, outer[1][:, ::-1], 0.5)[0])
    filled = anatomy.voxelise(points, np.vstack([outer[1], inner[1] + len(outer[0])]), 0.5)[0]
    np.testing.assert_array_equal(filled, alone)
    shell = anatomy.voxelise(points, np.vstack([outer[1], inner[1][:, ::-1] + len(outer[0])]), 0.5)[0]
    hollow = np.zeros_like(alone)
    corner = np.argwhere(alone).min(axis=0) + 4
    hollow[tuple(slice(at, at + 6) for at in corner)] = 1
    np.testing.assert_array_equal(shell, alone - hollow)


@pytest.mark.slow
def test_mni152_hemispheres_have_no_cerebellum():
    pytest.importorskip("nilearn", reason="the template comes with nilearn")
    (left, affine, probability), (right, _, _) = map(anatomy.mni152_white_matter, anatomy.SIDES)
    np.testing.assert_array_equal(left, right[::-1])  # the template is symmetric
    np.testing.assert_array_equal(left == 1, probability > 0.5)
    assert left.sum() == 298_820
    assert components(left) == 1
    x, y, z = (np.argwhere(left) @ affine[:3, :3].T + affine[:3, 3]).T
    assert x.max() == -1
    assert not ((y < -50) & (z < -25)).any()
    assert z[x > -20].min() > -32  # no stem; what there is belongs to the frontal and the temporal lobe
