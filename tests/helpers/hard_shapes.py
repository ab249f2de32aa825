"""Small surfaces that are hard to flatten: triangle meshes in mm, and label volumes."""

import numpy as np

import voxflat


def long_strip():
    """A wavy strip, a hundred times as long as wide."""
    return sheet(lambda u, v: (u, v, 2 * np.sin(u / 6)), (200.0, 2.0), (201, 3))


def star():
    """Seven thin rays around a dome."""
    points, faces = turned([(radius, 0.0) for radius in np.linspace(1, 1 / 12, 12)], 84, closed=True)
    x, y, _ = points.T
    reach = 8 + 30 * np.abs(np.cos(3.5 * np.arctan2(y, x))) ** 8
    return np.column_stack([reach * x, reach * y, 5 - 5 * (x**2 + y**2)]), faces


def pocket():
    """A finger 60 mm deep and 12 mm wide in a plate."""
    plate = [(radius, 0.0) for radius in np.linspace(30, 8, 9)]
    wall = [(6.0, -depth) for depth in np.linspace(2, 58, 23)]
    tip = [(6 * np.cos(angle), -58 - 6 * np.sin(angle)) for angle in np.linspace(0, np.pi / 2, 6)[1:-1]]
    return turned(plate + wall + tip, 20, closed=True)


def sphere_with_pinhole():
    """A sphere of radius 30 mm without 1 mm around its pole."""
    angles = np.linspace(1 / 30, np.pi, 28)[:-1]
    return turned([(30 * np.sin(angle), 30 * np.cos(angle)) for angle in angles], 24, closed=True)


def annulus():
    """A ring, which has two boundaries."""
    return turned([(radius, 0.2 * radius) for radius in np.linspace(30, 12, 10)], 48, closed=False)


def helix_ramp():
    """Three turns of a spiral ramp: its map must widen or overlap itself."""

    def ramp(u, v):
        return (6 + v) * np.cos(u), (6 + v) * np.sin(u), 1.2 * u

    return sheet(ramp, (6 * np.pi, 8.0), (121, 6))


def slivers():
    """Triangles a thousand times as long as wide, beside others."""
    narrow = np.concatenate([np.linspace(0, 0.2, 21), np.linspace(1, 30, 30)])
    return sheet(lambda u, v: (u, v, 0.02 * v**2), (narrow, np.linspace(0, 40, 5)))


def densities():
    """A mesh whose edges are ten times as long at one end as at the other."""
    steps = np.geomspace(0.25, 2.5, 32)
    return sheet(lambda u, v: (u, v, 4 * np.sin(u / 9)), (np.cumsum(steps), np.linspace(0, 30, 21)))


def glove():
    """A palm with four fingers, made of voxels."""
    x, y, z = np.indices((46, 16, 40))
    hand = (np.abs(x - 22.5) < 17) & (np.abs(y - 7.5) < 4) & (z > 2) & (z < 16)
    for finger in range(4):
        hand |= ((x - 8 - 9.7 * finger) ** 2 + (y - 7.5) ** 2 < 11) & (z >= 10) & (z < 36)
    return hand.astype(np.uint8)


def touching_folds():
    """A folded sheet of voxels whose halves are joined by pillars of one voxel."""
    volume = np.zeros((34, 24, 11), dtype=np.uint8)
    volume[2:32, 2:22, 2:4] = volume[2:32, 2:22, 6:8] = volume[29:32, 2:22, 2:8] = 1
    volume[8, 8, 4:6] = volume[16, 15, 4:6] = 1
    return volume


def folds_at_edges():
    """Two slabs of voxels that touch along a line of edges and are joined beyond it."""
    volume = np.zeros((28, 22, 16), dtype=np.uint8)
    volume[2:26, 2:11, 2:8] = volume[2:26, 11:20, 8:14] = 1
    volume[2:6, 2:20, 2:14] = 1
    return volume


MESHES = (long_strip, star, pocket, sphere_with_pinhole, annulus, helix_ramp, slivers, densities)
VOLUMES = (glove, touching_folds, folds_at_edges)


def surface(shape):
    """Return the surface of a shape; shapes of 1 mm voxels are repaired."""
    made = shape()
    how = {} if isinstance(made, tuple) else {"spacing": (1, 1, 1), "repair": "voxels"}
    return voxflat.surface(made, **how)


def sheet(place, size, counts=None):
    """Return a grid of triangles at place(u, v), over a rectangle with `counts` vertices or over given u and v."""
    if counts is None:
        along, across = size
    else:
        along, across = (np.linspace(0, length, count) for length, count in zip(size, counts, strict=True))
    u, v = np.meshgrid(along, across, indexing="ij")
    points = np.stack(np.broadcast_arrays(*place(u, v)), axis=-1).reshape(-1, 3).astype(float)
    number = np.arange(u.size).reshape(u.shape)
    return points, quads(number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])


def signed_areas(uv, faces):
    """Return the areas of triangles in the plane, negative for flipped ones."""
    (x, y), (u, v) = ((uv[faces[:, corner]] - uv[faces[:, 0]]).T for corner in (1, 2))
    return (x * v - y * u) / 2


def turned(profile, count, closed):
    """Return a surface of revolution that starts at its rim; if `closed`, it ends in a point on the axis."""
    angle = 2 * np.pi * np.arange(count) / count
    points = [(radius * np.cos(angle), radius * np.sin(angle), np.full(count, height)) for radius, height in profile]
    points = np.concatenate([np.stack(ring, axis=1) for ring in points])
    number = np.arange(len(points)).reshape(-1, count)
    following = np.roll(number, -1, axis=1)
    faces = quads(number[:-1], following[:-1], following[1:], number[1:])
    if not closed:
        return points, faces
    step = points[number[-1]].mean(axis=0) - points[number[-2]].mean(axis=0)
    tip = points[number[-1]].mean(axis=0) + step / 3
    fan = np.stack([number[-1], following[-1], np.full(count, len(points))], axis=1)
    return np.vstack([points, tip]), np.concatenate([faces, fan])


def quads(a, b, c, d):
    """Return two triangles for each quadrilateral."""
    a, b, c, d = (corner.ravel() for corner in (a, b, c, d))
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
