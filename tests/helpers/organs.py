"""Organs of simple shape, and what their charts contain."""

import numpy as np
import scipy

AXES = np.array([30.0, 10.0, 10.0])


def ellipsoid(count=1500):
    """Return an evenly sampled ellipsoid whose long axis is x."""
    number = np.arange(count) + 0.5
    height, angle = 1 - 2 * number / count, np.pi * (1 + 5**0.5) * number
    points = np.stack([height, *(np.sqrt(1 - height**2) * way(angle) for way in (np.cos, np.sin))], axis=1)
    faces = scipy.spatial.ConvexHull(points).simplices
    a, b, c = points[faces].transpose(1, 0, 2)
    inwards = (np.cross(b - a, c - a) * a).sum(axis=1) < 0
    faces[inwards] = faces[inwards][:, ::-1]
    return points * AXES, faces.astype(np.int64)


def nearest(points, place):
    return int(np.linalg.norm(points - place, axis=1).argmin())


def triangles(charts):
    """Return the triangles of each chart as rows of vertex numbers of the whole surface, sorted."""
    return [{tuple(row) for row in np.sort(one.surface.vertices[one.surface.faces], axis=1)} for one in charts]


def slopes(flat_map):
    """Return how the position in space changes along u and along v, by least squares."""
    uv = np.column_stack([flat_map.uv, np.ones(len(flat_map))])
    return np.linalg.lstsq(uv, flat_map.points, rcond=None)[0][:2]


def bent_tube(large=30.0, small=8.0, half=1.2, rings=60, around=40):
    """Return a part of a torus and the angle of its points around the tube, 0 on the outer side."""
    u, v = np.meshgrid(np.linspace(-half, half, rings), 2 * np.pi * np.arange(around) / around, indexing="ij")
    out = large + small * np.cos(v)
    points = np.stack([out * np.sin(u), out * np.cos(u), small * np.sin(v)], axis=-1).reshape(-1, 3)
    number = np.arange(u.size).reshape(u.shape)
    a, b, c, d = (np.roll(part, -across, axis=1) for part in (number[:-1], number[1:]) for across in (0, 1))
    faces = np.concatenate([np.stack([a, c, d], axis=-1), np.stack([a, d, b], axis=-1)]).reshape(-1, 3)
    corner, one, two = points[faces[0]]
    outwards = corner - large * np.array([np.sin(-half), np.cos(-half), 0])
    return points, faces if np.cross(one - corner, two - corner) @ outwards > 0 else faces[:, ::-1], v.ravel()
