"""Triangle meshes of known geometry."""

import numpy as np
import pytest


def square(size=6):
    """A sheet of triangles in the plane."""
    i, j = np.mgrid[: size + 1, : size + 1]
    points = np.stack([i.ravel(), j.ravel(), 0 * i.ravel()], axis=1).astype(float)
    corner = (i * (size + 1) + j)[:-1, :-1].ravel()
    a, b, c, d = corner, corner + size + 1, corner + size + 2, corner + 1
    return points, np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def cylinder(shape=(81, 61), turns=0.7):
    """Return a range image's worth of pixels curled into a cylinder, and their places on the unrolled one."""
    row, column = np.indices(shape).reshape(2, -1).astype(float)
    radius = shape[1] / (2 * np.pi * turns)
    points = np.stack([radius * np.sin(column / radius), -row, radius * np.cos(column / radius)], axis=1)
    number = np.arange(row.size).reshape(shape)
    a, b, c, d = (part.ravel() for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return (points, faces), np.stack([column, -row], axis=1)


def torus(resolution=40):
    pv = pytest.importorskip("pyvista")
    mesh = pv.ParametricTorus(ringradius=30, crosssectionradius=10, u_res=resolution, v_res=resolution // 2, w_res=1)
    mesh = mesh.clean().triangulate()
    return np.asarray(mesh.points, dtype=float), np.asarray(mesh.regular_faces)


def bump(size=30):
    """A mesh over a square with a bump in its middle."""
    i, j = np.mgrid[: size + 1, : size + 1].astype(float)
    z = 6 * np.exp(-((i - size / 2) ** 2 + (j - size / 2) ** 2) / 30)
    corner = np.arange((size + 1) ** 2).reshape(size + 1, size + 1)
    a, b, c, d = (part.ravel() for part in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]))
    points = np.stack([i.ravel(), j.ravel(), z.ravel()], axis=1)
    return points, np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def rolled(radius=10.0, angle=2.0, size=40):
    """A part of a cylinder as a mesh, and where it lies when it is unrolled."""
    s, t = np.meshgrid(np.linspace(0, radius * angle, size + 1), np.linspace(0, 20, size + 1), indexing="ij")
    points = np.stack([radius * np.sin(s / radius), t, radius * np.cos(s / radius)], axis=2).reshape(-1, 3)
    _, faces = bump(size)
    return (points, faces), np.stack([s.ravel(), t.ravel()], axis=1)


def singular_values(points, uv):
    """Return σ1 and σ2 of triangles in space (G, 3, 3) and in the plane (G, 3, 2), by numpy's own decomposition."""
    edges, flat = points[:, 1:] - points[:, :1], uv[:, 1:] - uv[:, :1]
    jacobian = [np.linalg.pinv(e) @ f for e, f in zip(edges, flat, strict=True)]
    return np.linalg.svd(np.array(jacobian), compute_uv=False)
