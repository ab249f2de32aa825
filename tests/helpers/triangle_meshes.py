"""Triangle meshes of known geometry."""

import numpy as np
import pytest
from hard_shapes import sheet

from voxflat.io import meshes

ON_BOWL = {"sources": 20, "seed": 3}
"""Options of the map of a bowl that all interfaces must make alike."""


def square(size=6):
    return sheet(lambda u, v: (u, v, 0 * u), (size, size), (size + 1, size + 1))


def cylinder(shape=(81, 61), turns=0.7):
    """Return a grid of pixels curled into a cylinder, and its unrolled positions."""
    row, column = np.indices(shape).reshape(2, -1).astype(float)
    radius = shape[1] / (2 * np.pi * turns)
    ends = (shape[0] - 1, shape[1] - 1)
    mesh = sheet(lambda u, v: (radius * np.sin(v / radius), -u, radius * np.cos(v / radius)), ends, shape)
    return mesh, np.stack([column, -row], axis=1)


def torus(resolution=40):
    pv = pytest.importorskip("pyvista")
    mesh = pv.ParametricTorus(ringradius=30, crosssectionradius=10, u_res=resolution, v_res=resolution // 2, w_res=1)
    mesh = mesh.clean().triangulate()
    return np.asarray(mesh.points, dtype=float), np.asarray(mesh.regular_faces)


def bump(size=30):
    """A square mesh with a bump in its middle."""

    def place(u, v):
        return u, v, 6 * np.exp(-((u - size / 2) ** 2 + (v - size / 2) ** 2) / 30)

    return sheet(place, (size, size), (size + 1, size + 1))


def rolled(radius=10.0, angle=2.0, size=40):
    """Return a part of a cylinder as a mesh, and its unrolled positions."""
    how = ((radius * angle, 20), (size + 1, size + 1))
    flat, _ = sheet(lambda u, v: (u, v, 0 * u), *how)
    return sheet(lambda u, v: (radius * np.sin(u / radius), v, radius * np.cos(u / radius)), *how), flat[:, :2]


def singular_values(points, uv):
    """Return σ1 and σ2 of triangles in space (G, 3, 3) and in the plane (G, 3, 2), by NumPy's decomposition."""
    edges, flat = points[:, 1:] - points[:, :1], uv[:, 1:] - uv[:, :1]
    jacobian = [np.linalg.pinv(e) @ f for e, f in zip(edges, flat, strict=True)]
    return np.linalg.svd(np.array(jacobian), compute_uv=False)


def write_bowl(path):
    """Write a curved mesh of 12 by 12 points and return its path."""
    points, faces = sheet(lambda u, v: (u - 3, v - 3, 0.1 * ((u - 3) ** 2 + (v - 3) ** 2)), (6, 6), (12, 12))
    meshes.write_mesh(path, meshes.Mesh(points, faces))
    return path
